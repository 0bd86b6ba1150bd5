"""Measures speed: against the forward-facing model, FASTSim and hand-written C, and the cost of what goes around a step.

All times are medians over repeats, on one core, which the process is pinned to where the system allows.  They are
processor times of the one thread that works, so that other programs disturb little; the notes give the wall's clock.
"""

from __future__ import annotations

import importlib.util
import itertools
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from halfshaft.cosim.compiled import InterpretedStep, Mode
from halfshaft.cosim.cycle import Cycle, Samples, acceleration_cycle
from halfshaft.cosim.gradient import rates, slopes
from halfshaft.cosim.result import Result
from halfshaft.cosim.simulate import parameters_of, run, stepper_of
from halfshaft.fmu_build.code import compiled_tables
from halfshaft.fmu_build.compiler import find_compiler
from halfshaft.fmu_build.lanes import widths
from halfshaft.library.base.errors import CompileError, SolveError
from halfshaft.library.base.tags import part_of
from halfshaft.models.assembly import assemble
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.acceleration import DT, prepared
from halfshaft.studies.batch import run_batch
from halfshaft.validation import paper
from halfshaft.validation.handwritten import Twin
from halfshaft.validation.powertrains import first_of_each
from halfshaft.validation.reproduce import speed_tasks


class Peer(NamedTuple):
    """A vehicle of FASTSim, and how many times as fast as it a simulation with history shall be."""

    file: str
    wanted: int


#: Vehicles of FASTSim that come nearest to ours: by whether there is a store, and whether fuel is burnt.
PEERS = {
    (True, False): Peer("2022_Renault_Zoe_ZE50_R135.yaml", 6),
    (False, True): Peer("2012_Ford_Fusion.yaml", 4),
    (True, True): Peer("2016_TOYOTA_Prius_Two.yaml", 6),
}
#: Vehicles of which a batch runs over UDDS: how many nanoseconds a step and vehicle may take, and how many times as fast as FASTSim it
#: shall be on a core.
BATCHES = {"small-car-electric": (25, 30), "small-car-conventional": (28, 20), "small-car-series": (45, 25)}
#: How many vehicles such a batch has.
CARS = 10_000
#: Vehicles whose first build is timed.
BUILT = ("small-car-electric", "small-car-conventional")
#: Vehicles whose derivatives are timed.
DERIVED = ("small-car-electric", "small-car-series")

Row = dict[str, Any]


class Times(NamedTuple):
    """Medians per call [s]: by the wall's clock, and of this thread's processor."""

    wall: float
    cpu: float


def measured(call: Callable[[], Any], seconds: float = 0.6, repeats: int = 9, prepare: Callable[[], Any] | None = None) -> Times:
    """Return the median times of a call; `prepare` runs before each and is not timed."""
    make = prepare or (lambda: None)
    make()
    call()
    make()
    start = time.perf_counter()
    call()
    n = max(1, int(seconds / repeats / max(time.perf_counter() - start, 1e-7)))
    walls, cpus = [], []
    for _ in range(repeats):
        wall = cpu = 0
        for _ in range(n):
            make()
            w, c = time.perf_counter_ns(), time.thread_time_ns()
            call()
            cpu += time.thread_time_ns() - c
            wall += time.perf_counter_ns() - w
        walls.append(1e-9 * wall / n)
        cpus.append(1e-9 * cpu / n)
    return Times(statistics.median(walls), statistics.median(cpus))


@contextmanager
def one_core() -> Iterator[set[int]]:
    """Pin this thread to one core, where the system allows; gives the cores that there were."""
    if not hasattr(os, "sched_setaffinity"):
        yield set(range(os.cpu_count() or 1))
        return
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(cores)})
    try:
        yield cores
    finally:
        os.sched_setaffinity(0, cores)


def bench(progress: Callable[[str], None] | None = None) -> dict[str, Any]:
    """Measure everything.

    Parameters
    ----------
    progress
        Is told what is being measured.

    Returns
    -------
    dict
        ``rows``: dicts of ``name``, ``value`` (None if it could not be measured), ``unit``, ``target`` and ``note``.

    Raises
    ------
    CompileError
        If there is no C compiler, or it fails: the interpreter would take minutes.

    """
    find_compiler()
    if isinstance(stepper_of(Vehicle.load("small-car-electric")), InterpretedStep):
        raise CompileError("what is timed is compiled code: the C compiler must work")
    say = progress or (lambda _: None)
    rows: list[Row] = []
    with one_core() as cores:
        for title, measure in (
            ("forward-facing model", _forward),
            ("FASTSim", _fastsim),
            ("hand-written step", _twin),
            ("refined mode", _refined),
            ("one vehicle", _around),
            ("gradients", _gradients),
            ("start-up", _start),
        ):
            say(title)
            rows += measure()
        say("batches")
        rows += _batches()
    say("threads")
    return {"rows": rows + _threads(len(cores)) + _batches_on(sorted(cores))}


def _row(name: str, value: float | None, unit: str, target: str = "", note: str = "") -> Row:
    return {"name": name, "value": value, "unit": unit, "target": target, "note": note}


def _forward() -> list[Row]:
    """Return the paper's table 5: whole runs with history."""
    rows = []
    printed = dict(zip(paper.TABLE_5.rows, paper.TABLE_5.ratio, strict=True))
    note = "small-car-conventional; whole runs with history, models built before"
    for name, task in speed_tasks().items():
        hybrid = measured(lambda task=task: task("step")).cpu  # type: ignore[misc]
        rows.append(_row(f"{name}: hybrid", 1e3 * hybrid, "ms", note=note))
        try:
            forward = measured(lambda task=task: task("forward"), 0.0, 1).cpu  # type: ignore[misc]
        except SolveError as error:
            rows.append(_row(f"{name}: forward-facing", None, "s", note=f"did not finish: {error}"))
            continue
        rows.append(_row(f"{name}: forward-facing", forward, "s", note=f"{note}; one run, IDAS, controls each 0.1 s"))
        rows.append(_row(f"{name}: hybrid faster by", forward / hybrid, "times", f">= 50; {printed[name]} in the paper"))
    return rows


def _fastsim() -> list[Row]:
    """Return UDDS by one vehicle of each powertrain and by FASTSim's nearest, with and without history."""
    rows, times = [], dict[str, dict[str, Times]]()
    cycle = Cycle.load("udds")
    samples = cycle.sampled(1.0)
    for name in first_of_each():
        car = Vehicle.load(name)
        compiled = stepper_of(car)
        parameters = parameters_of(car, compiled.step, samples.v_start)
        bookings = {d.booking for d in compiled.step.outputs}
        peer = PEERS["stored" in bookings, "fuel" in bookings]
        known = peer.file in times
        if not known:
            try:
                times[peer.file] = _fastsim_times(peer.file)
            except ImportError:
                times[peer.file] = {}
        theirs = times[peer.file]
        ready, whole = "vehicle and trace ready before, as for FASTSim", "trace sampled, parameters collected and result built in each call"
        for what, note, call in (
            ("simulation, history", ready, lambda c=compiled, p=parameters: c.march(samples, p)),
            ("simulation, no history", ready, lambda c=compiled, p=parameters: c.march(samples, p, history=False)),
            ("whole call, history", whole, lambda car=car: run(car, cycle)),
        ):
            ours, other = measured(call), theirs.get(what)
            note = f"{note}; {len(compiled.step.outputs)} outputs; wall {1e6 * ours.wall:.0f} us"
            rows.append(_row(f"{name}: {what}", 1e6 * ours.cpu, "us", f"< {1e6 * other.cpu:.0f} us (FASTSim)" if other else "", note))
            if other:
                target = f">= {peer.wanted}" if what == "simulation, history" else "> 1"
                rows.append(_row(f"{name}: {what}, faster than FASTSim by", other.cpu / ours.cpu, "times", target))
        if known:
            continue
        shown = peer.file.removesuffix(".yaml")
        rows += [
            _row(f"FASTSim {shown}: {what}", 1e6 * t.cpu, "us", note=f"a fresh SimDrive in each run; wall {1e6 * t.wall:.0f} us")
            for what, t in theirs.items()
        ]
        if not theirs:
            rows.append(_row(f"FASTSim {shown}", None, "us", note="FASTSim is not installed: halfshaft[bench] brings it"))
    return rows


def _fastsim_times(name: str) -> dict[str, Times]:
    """Return the times of one pass of FASTSim over UDDS; only the whole call makes its SimDrive inside."""
    # Its errors on ordinary paths each capture a backtrace when these are set, which makes it about ten times slower.
    for variable in ("RUST_BACKTRACE", "RUST_LIB_BACKTRACE"):
        os.environ.pop(variable, None)
    import fastsim

    cycle = fastsim.Cycle.from_resource("udds.csv")
    drives: list[Any] = []
    go = next(getattr(fastsim.SimDrive, method) for method in ("run_once", "walk_once") if hasattr(fastsim.SimDrive, method))
    times = {}
    for what, interval in (("simulation, history", 1), ("simulation, no history", None)):
        vehicle = fastsim.Vehicle.from_resource(name)
        vehicle.set_save_interval(interval)

        def prepare(vehicle: Any = vehicle) -> None:
            drives[:] = [fastsim.SimDrive(vehicle, cycle)]

        times[what] = measured(lambda: go(drives[0]), prepare=prepare)
        if interval:
            times["whole call, history"] = measured(lambda vehicle=vehicle: go(fastsim.SimDrive(vehicle, cycle)))  # type: ignore[misc]
    return times


def _twin() -> list[Row]:
    """Return the cost of the generated step beside hand-written C of the same physics."""
    car = Vehicle.load("small-car-electric")
    samples = Cycle.load("udds").sampled(1.0)
    compiled = stepper_of(car)
    parameters = parameters_of(car, compiled.step, samples.v_start)
    try:
        twin = Twin(car)
    except CompileError as error:
        return [_row("electric step", None, "ns", note=f"no compiler: {error}")]
    n = len(samples.t)
    by_hand, generated = measured(lambda: twin.march(samples, totals=False)).cpu, measured(lambda: compiled.march(samples, parameters)).cpu
    note = "UDDS with history"
    return [
        _row(
            "electric step: generated", 1e9 * generated / n, "ns", "<= 1.5 times by hand", f"{len(compiled.step.outputs)} outputs; {note}"
        ),
        _row("electric step: by hand", 1e9 * by_hand / n, "ns", note=f"{len(twin.outputs)} outputs; {note}"),
        _row("electric step: generated over by hand", generated / by_hand, "times", note="equal results, see the tests"),
    ]


def _refined() -> list[Row]:
    """Return what the refined mode costs where limits act everywhere, sometimes, and never."""
    heavy, light = Vehicle.load("paper-series-2393"), Vehicle.load("small-car-electric")
    cases = {
        "acceleration": (prepared(heavy), acceleration_cycle(), DT, "limits act in every step"),
        "US06": (heavy, Cycle.load("us06").scaled(paper.SPEED_1999), 1.0, "limits act in some steps"),
        "UDDS": (light, Cycle.load("udds"), 1.0, "no limit acts"),
    }
    rows = []
    for name, (car, cycle, dt, note) in cases.items():
        samples, compiled = cycle.sampled(dt), stepper_of(car)
        parameters = parameters_of(car, compiled.step, samples.v_start)
        modes: tuple[Mode, ...] = ("hybrid", "refined")
        hybrid, refined = (
            measured(lambda m=mode, c=compiled, p=parameters, s=samples: c.march(s, p, mode=m)).cpu  # type: ignore[misc]
            for mode in modes
        )
        calls = compiled.march(samples, parameters, mode="refined").evaluations / max(len(samples.t), 1)
        note = f"{car.name}; {note}; {calls:.2f} evaluations a step; hybrid {1e6 * hybrid:.0f} us"
        rows.append(_row(f"refined over hybrid: {name}", refined / hybrid, "times", note=note))
    return rows


def _around() -> list[Row]:
    """Return what goes around the march of a vehicle: setting a number, a run's own part, its dataset."""
    cycle, samples, rows = Cycle.load("udds"), Cycle.load("udds").sampled(1.0), []
    for name in BUILT:
        car = Vehicle.load(name)
        compiled, mass = stepper_of(car), car.tags.the("vehicle mass")
        parameters = parameters_of(car, compiled.step, samples.v_start)
        masses = itertools.count(1500)
        change = measured(lambda car=car, mass=mass, m=masses: car.with_values({mass: next(m)})).cpu  # type: ignore[misc]
        march = measured(lambda c=compiled, p=parameters: c.march(samples, p)).cpu  # type: ignore[misc]
        kept, summed = (measured(lambda car=car, h=history: run(car, cycle, history=h)).cpu for history in (True, False))  # type: ignore[misc]
        made: list[Result] = []

        def remake(car: Vehicle = car, made: list[Result] = made) -> None:
            made[:] = [run(car, cycle)]

        dataset = measured(lambda made=made: made[0].dataset, prepare=remake).cpu  # type: ignore[misc]
        rows += [
            _row(f"{name}: setting a number", 1e6 * change, "us", "< 100", "with_values, the mass"),
            _row(f"{name}: run besides its march", 1e6 * (kept - march), "us", "<= 60", "a warm vehicle, with history"),
            _row(f"{name}: run without history over run with it", summed / kept, "times", "<= 1", "UDDS"),
            _row(f"{name}: dataset", 1e3 * dataset, "ms", "< 1", f"{len(compiled.step.outputs)} outputs over UDDS"),
        ]
    return rows


def _gradients() -> list[Row]:
    """Return what the derivatives of a run cost, by eight numbers and by all, beside those of CasADi's virtual machine."""
    cycle, samples, rows = Cycle.load("udds"), Cycle.load("udds").sampled(1.0), []
    for name in DERIVED:
        car = Vehicle.load(name)
        step = stepper_of(car).step
        every = [n for n in car.values if n != step.tags.the("start speed")]
        eight = sorted(every, key=lambda n: not n.endswith("_scale"))[:8]
        wanted: list[tuple[str, str | float]] = [(d.name, "integral") for d in step.outputs if d.booking in ("fuel", "stored")]
        once = measured(lambda car=car: run(car, cycle, history=False)).cpu  # type: ignore[misc]
        ours = {len(names): measured(partial(slopes, car, cycle, names, wanted)).cpu for names in (eight, every)}
        theirs = {len(names): _casadi_gradient(car, samples, names, wanted) for names in (eight, every)}
        note = "UDDS; integrals of fuel and energy; CasADi: the same step unrolled, maps compiled"
        for n, seconds in ours.items():
            target = "<= 4" if n == 8 else ""
            rows.append(_row(f"{name}: derivatives by {n} numbers", 1e3 * seconds, "ms", note=note))
            rows.append(_row(f"{name}: derivatives by {n} numbers, over a run", seconds / once, "times", target, "run without history"))
            way = "forward" if n == 8 else "adjoint"
            rows.append(_row(f"{name}: derivatives by {n} numbers, faster than CasADi's {way} by", theirs[n] / seconds, "times"))
    return rows


def _casadi_gradient(car: Vehicle, samples: Samples, names: Sequence[str], wanted: Sequence[tuple[str, str | float]]) -> float:
    """Return how long CasADi takes for derivatives of an unrolled cycle: forward for eight numbers, else adjoint, of one integral."""
    step = assemble(car.model(), car.title, compiled_tables)
    n, p = len(samples.t), parameters_of(car, step, samples.v_start)
    requests = ca.DM(np.array([samples.v, samples.grade, samples.key_on, samples.dt, np.zeros(n)]))
    free = ca.MX.sym("free", len(names))
    moved = ca.DM(p) + ca.mtimes(ca.DM(rates(car, step, names)), free)
    _, outputs = step.function.mapaccum(n)(step.start(moved), requests, ca.repmat(moved, 1, n))
    total = ca.sum2(outputs[step.output_index[wanted[0][0]], :])
    found = ca.jtimes(total, free, ca.DM.eye(8)) if len(names) == 8 else ca.gradient(total, free)
    function = ca.Function("derivatives", [free], [found])
    return measured(lambda: function(np.zeros(len(names))), 0.0, 3).cpu


def _start() -> list[Row]:
    """Return the times of import and of the first compilation."""
    importing = "import halfshaft.cosim.simulate"
    whole = statistics.median(_timed_python(f"{importing}") for _ in range(5))
    empty = statistics.median(_timed_python("pass") for _ in range(5))
    rows = [_row("import", 1e3 * (whole - empty), "ms", note="halfshaft.cosim.simulate, less the start of Python")]
    for name in BUILT:
        code = (
            f"{importing}; import time; from halfshaft.models.vehicle import Vehicle; v = Vehicle.load({name!r}); "
            "t = time.perf_counter(); halfshaft.cosim.simulate.stepper_of(v); print(time.perf_counter() - t)"
        )
        with tempfile.TemporaryDirectory() as cache:
            cold, warm = (float(_python(code, cache)) for _ in range(2))
        rows.append(_row(f"{name}: first build", cold, "s", note="assembly, code and compiler, empty cache"))
        rows.append(_row(f"{name}: build from the cache", warm, "s", note="in a new process"))
    return rows


def _python(code: str, cache: str) -> str:
    environment = {**os.environ, "HALFSHAFT_CACHE": cache}
    return subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True).stdout


def _timed_python(code: str) -> float:
    start = time.perf_counter()
    subprocess.run([sys.executable, "-c", code], check=True)
    return time.perf_counter() - start


def _threads(n_cores: int) -> list[Row]:
    """Return how the throughput of many vehicles grows with a second thread."""
    if n_cores < 2:
        return [_row("throughput of two threads over one", None, "times", ">= 1.7", "there is only one core")]
    samples = Cycle.load("udds").sampled(1.0)
    base = Vehicle.load("small-car-electric")
    compiled = stepper_of(base)
    fleet = [parameters_of(base.with_values({base.tags.the("vehicle mass"): 1000.0 + i}), compiled.step) for i in range(200)]

    def throughput(threads: int) -> tuple[float, float]:
        """Return runs per second, and how many cores the system gave."""
        with ThreadPoolExecutor(threads) as pool:
            wall, cpu = time.perf_counter(), time.process_time()
            for _ in pool.map(lambda p: compiled.march(samples, p, history=False), fleet):
                pass
            wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        return len(fleet) / wall, cpu / wall

    throughput(2)
    # Other programs can only take away from two threads: the best of several counts.
    one, two = (max(throughput(threads) for _ in range(9)) for threads in (1, 2))
    note = f"electric car over UDDS, no history: {one[0]:.0f} and {two[0]:.0f} runs a second; the system gave {two[1]:.2f} cores"
    return [_row("throughput of two threads over one", two[0] / one[0], "times", ">= 1.7", note)]


def _fleet(name: str) -> tuple[Callable[..., Any], Peer, int]:
    """Return the call that runs many that differ in mass, drag and the size of what drives, FASTSim's nearest, and the number of steps."""
    car, cycle, random = Vehicle.load(name), Cycle.load("udds"), np.random.default_rng(0)
    driving = [n for n in car.values if n.endswith(".torque_scale")]
    scale = next((n for n in driving if "traction power" in car.parameters[part_of(n)].ratings()), driving[0])
    own = {car.tags.the("vehicle mass"): (0.8, 1.4), next(n for n in car.values if n.endswith(".c_d")): (0.7, 1.5), scale: (0.7, 1.5)}
    values = {n: car.values[n] * random.uniform(*ends, CARS) for n, ends in own.items()}
    bookings = {d.booking for d in stepper_of(car).step.outputs}
    return partial(run_batch, car, values, cycle), PEERS["stored" in bookings, "fuel" in bookings], len(cycle.sampled(1.0).t)


def _batches() -> list[Row]:
    """Return what a batch costs on one core, summaries only, beside FASTSim one vehicle after the other."""
    rows = []
    width = next(iter(widths()), "no")
    for name, (nanoseconds, faster) in BATCHES.items():
        call, peer, n = _fleet(name)
        times = {mode: measured(partial(call, threads=1, mode=mode), 0.0, 5).cpu for mode in ("hybrid", "refined")}
        note = f"{CARS} cars over UDDS, mass, drag and torque varied; main figures kept; {width} vectors"
        rows.append(_row(f"{name}: batch, a step and car", 1e9 * times["hybrid"] / n / CARS, "ns", f"<= {nanoseconds} (avx512)", note))
        rows.append(_row(f"{name}: batch, refined, a step and car", 1e9 * times["refined"] / n / CARS, "ns", note=note))
        rows.append(_row(f"{name}: batch, one core", CARS / times["hybrid"], "cars/s", note=note))
        try:
            other = _fastsim_times(peer.file)["simulation, no history"].cpu
        except ImportError:
            continue
        for mode, target in (("hybrid", f">= {faster}"), ("refined", "")):
            row = f"{name}: batch, {mode}, faster than FASTSim one by one by"
            rows.append(_row(row, other * CARS / times[mode], "times", target, f"{peer.file}, no history, SimDrive made before"))
    return rows


def _batches_on(cores: Sequence[int]) -> list[Row]:
    """Return the throughput of batches on all cores, beside FASTSim with a process on each."""
    rows = []
    for name in BATCHES:
        call, peer, _ = _fleet(name)

        def throughput(threads: int, call: Callable[..., Any] = call) -> tuple[float, float]:
            """Return cars per second, and how many cores the system gave."""
            wall, cpu = time.perf_counter(), time.process_time()
            call(threads=threads)
            wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
            return CARS / wall, cpu / wall

        throughput(len(cores))
        # Other programs can only take away: the best of several counts.
        one, every = (max(throughput(n) for _ in range(7)) for n in (1, len(cores)))
        note = f"best of 7; the system gave {one[1]:.2f} and {every[1]:.2f} cores"
        rows.append(_row(f"{name}: batch, {len(cores)} cores", every[0], "cars/s", note=note))
        if len(cores) > 1:
            target = ">= 1.8" if len(cores) == 2 else ""
            rows.append(_row(f"{name}: batch, {len(cores)} cores over one", every[0] / one[0], "times", target, note))
        theirs = _fastsim_processes(peer.file, cores)
        if theirs:
            note = f"{peer.file}, a process on each core, no history"
            rows.append(_row(f"{name}: FASTSim, {len(cores)} processes", theirs, "cars/s", note=note))
            rows.append(_row(f"{name}: batch faster than FASTSim on {len(cores)} cores by", every[0] / theirs, "times", note=note))
    return rows


def _fastsim_processes(name: str, cores: Sequence[int]) -> float | None:
    """Return how many cars a second FASTSim runs with a process on each core; the best of several; None if it is not installed."""
    if importlib.util.find_spec("fastsim") is None:
        return None
    environment = {k: v for k, v in os.environ.items() if k not in ("RUST_BACKTRACE", "RUST_LIB_BACKTRACE")}
    best = 0.0
    for _ in range(3):
        command = [sys.executable, "-c", _FASTSIM_LOOP, name]
        running = [subprocess.Popen([*command, str(core)], env=environment, stdout=subprocess.PIPE, text=True) for core in cores]
        best = max(best, sum(float(process.communicate()[0]) for process in running))
    return best


#: Prints how many times a second a vehicle drives UDDS.
_FASTSIM_LOOP = """
import os, sys, time
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {int(sys.argv[2])})
import fastsim
cycle, vehicle = fastsim.Cycle.from_resource("udds.csv"), fastsim.Vehicle.from_resource(sys.argv[1])
vehicle.set_save_interval(None)
go = getattr(fastsim.SimDrive, "run_once", None) or fastsim.SimDrive.walk_once
drives = [fastsim.SimDrive(vehicle, cycle) for _ in range(300)]
start = time.perf_counter()
for drive in drives:
    go(drive)
print(len(drives) / (time.perf_counter() - start))
"""
