"""Many vehicles of one structure over a cycle, or each over its own: one call of compiled code on all cores.

The vehicles differ by numbers.  What rules derive follows for all of them at once, bounds are checked for all of them at once,
and what is wrong is said before the first one runs.  Of each run its figures are kept, or what was asked for of any output;
the memory that a batch takes grows with those alone.  A run in which a number is lost is marked, the others are untouched.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from functools import lru_cache, partial
from importlib.resources import files
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from halfshaft import __version__
from halfshaft.cosim.compiled import MODES, Mode, address, march_code, read_by_c
from halfshaft.cosim.cycle import TIME_STEP, Cycle
from halfshaft.cosim.figures import end_states, figures, needs, unit_of
from halfshaft.cosim.memory import available
from halfshaft.cosim.simulate import Build, stepper_of
from halfshaft.fmu_build.compiler import shared_library
from halfshaft.fmu_build.lanes import WIDTHS, lanes_code, lanes_header, widths
from halfshaft.library.base.errors import CompileError, InputError, nearest, not_a, number
from halfshaft.library.base.parameters import spec_of
from halfshaft.models.assembly import Step
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.crew import cores

if TYPE_CHECKING:
    import xarray as xr

Array: TypeAlias = npt.NDArray[np.float64]
#: What may be asked of an output besides its value at a time [s]; the first value only of one that shows a state.
HOWS = ("integral", "max", "min", "last", "first")
#: What C calls these, and the values at times.
IN_C = ("sum", "max", "min", "last", "begin", "seen")
#: So many runs are prepared together; their parameters take a few megabytes.
CHUNK = 8192
#: At most so many cycles, values or names of a kind are told to be wrong.
NAMED = 5


class Wanted(NamedTuple):
    """What is wanted of an output: one of `HOWS`, or its value in the step that holds a time [s]."""

    output: str
    how: str | float

    @property
    def name(self) -> str:
        """What the variable of a result is called."""
        return f"{self.output}.{self.how}" if isinstance(self.how, str) else f"{self.output}.at_{self.how:g}s"

    @property
    def place(self) -> tuple[int, float]:
        """Place in the order in which C has them: by `IN_C`, then by time."""
        return (HOWS.index(self.how), 0.0) if isinstance(self.how, str) else (len(HOWS), self.how)


def run_batch(
    vehicle: Vehicle,
    values: Mapping[str, Any] | xr.Dataset,
    cycle: Cycle | Sequence[Cycle],
    *,
    mode: Mode = "hybrid",
    dt: float = 1.0,
    initial: Mapping[str, Any] | None = None,
    summary: Mapping[str, str | float | Sequence[str | float]] | None = None,
    history: Sequence[str] = (),
    threads: int | None = None,
) -> xr.Dataset:
    """Run many vehicles that differ in numbers.

    Parameters
    ----------
    vehicle
        What all have in common.
    values
        Numbers by ``role.parameter`` as for `Vehicle.with_values`: one for all, or an array with one for each run [SI].  The variables
        of an `xarray.Dataset` are spread over all of its dimensions, which the result then has too.
    cycle
        One for all runs, or one for each.
    mode, dt
        As for `run`.
    initial
        Start values of states by name, one for all or one for each run [SI], in place of those that the parameters give.
    summary
        What to keep of outputs, by their names: ``integral``, ``max``, ``min``, ``last``, ``first`` (the start value of what shows a
        state), a time [s], or several of these; a variable is then called ``motor.P_in.integral`` or ``body.v.at_60s``.  Without it
        the main figures of `Result.summary` are kept, under the same names, and the last values of what shows a state.
    history
        Outputs of which all values are kept.
    threads
        How many; without it as many as this program may use cores.

    Returns
    -------
    xarray.Dataset
        What was kept, over the runs.  ``status`` is 0 where the run was finished, and 1 where a number was lost, by the time
        ``lost_by``: all else of such a run is NaN.

    Raises
    ------
    InputError
        If names, numbers or arguments are not what they must be; everything that is wrong is named at once.
    CompileError
        If there is no C compiler.

    """
    cycles, problems = _checked(vehicle, cycle, mode, dt, threads)
    given, dims = _spread(values, problems)
    starts, _ = _spread(initial or {}, problems)
    lengths = {name: len(x) for name, x in (*given.items(), *starts.items()) if isinstance(x, np.ndarray)}
    lengths |= {"cycle": len(cycles)} if len(cycles) > 1 else {}
    if len(set(lengths.values())) > 1:
        problems.append(f"not of one length: {', '.join(f'{name} has {n} entries' for name, n in lengths.items())}")
    if problems:
        raise InputError("batch", problems)
    runs = next(iter(lengths.values()), 1)
    fleet, step, traces = vehicle.with_arrays(given), stepper_of(vehicle).step, _Traces(cycles, float(dt), runs)
    wanted = _main(step) if summary is None else _wanted(summary)
    maps = _own_maps(step, fleet, problems)
    problems += [*_unknown(step, wanted, starts, history), *traces.problems]
    if (size := 8 * runs * traces.longest * len(history)) > available():
        problems.append(f"the histories of {len(history)} outputs take {size / 2**30:.1f} GiB, more than there is; ask for summaries")
    if problems:
        raise InputError("batch", problems)

    # In an order that is the same in every process, so that the compiled code is found again.
    wanted = sorted(dict.fromkeys(wanted), key=lambda w: w.place)
    plan = _plan(Build(vehicle), tuple(wanted), tuple(dict.fromkeys(history)), tuple(maps), next(iter(widths()), ""), traces.halved)
    shown = _Figures(step, fleet, traces) if summary is None else None
    rows = np.full((runs, traces.longest, len(plan.history)), np.nan)
    columns = _Columns(runs)
    for done in plan.march(fleet, maps, traces, starts, rows, mode, threads or cores()):
        lost = done.lost > 0
        columns.put("status", done.part, lost.astype(np.int8))
        columns.put("lost_by", done.part, traces.ends(done) if lost.any() else np.nan)
        if mode != "hybrid":
            columns.put("unsolved", done.part, done.unsolved)
        for name, x in (shown(done) if shown else done.found).items():
            columns.put(name, done.part, np.where(lost, np.nan, x) if lost.any() else x)
    driven = cycles[0].name if len(traces.cycles) == 1 else f"{len(traces.cycles)} cycles"
    made = f"halfshaft {__version__}, batch, {mode}, steps of {float(dt):g} s"
    data = _dataset(vehicle, plan, given, dims or {"run": runs}, columns.whole(), traces, rows)
    return data.assign_attrs(title=f"{vehicle.name} over {driven}", source=made, vehicle=vehicle.name, cycle=driven)


class _Columns:
    """What is found of all runs; a number that all have in common takes no more room than one."""

    def __init__(self, runs: int) -> None:
        self.runs = runs
        self.found: dict[str, Any] = {}

    def put(self, name: str, part: slice, x: Any) -> None:
        """Take what was found of some of them."""
        before = self.found.get(name, x)
        if np.ndim(x) == np.ndim(before) == 0:
            self.found[name] = x
            return
        if np.ndim(before) == 0:
            self.found[name] = np.full(self.runs, before)
        elif name not in self.found:
            self.found[name] = np.empty(self.runs, dtype=x.dtype)
        self.found[name][part] = x

    def whole(self) -> dict[str, Any]:
        """Return an array for each, of which the entries may be one and the same."""
        return {name: np.broadcast_to(x, (self.runs,)) for name, x in self.found.items()}


class _Traces:
    """The cycles of a batch, each sampled once, and which of them each run has."""

    def __init__(self, cycles: Sequence[Cycle], dt: float, runs: int) -> None:
        distinct = {id(c): c for c in cycles}
        places = {key: i for i, key in enumerate(distinct)}
        self.cycles = list(distinct.values())
        self.samples = [read_by_c(c.sampled(dt)) for c in self.cycles]
        self.of = np.array([places[id(c)] for c in cycles] if len(cycles) > 1 else [0] * runs, dtype=np.intc)
        self.longest = max(len(s.t) for s in self.samples)
        self.problems = [f"cycle {c.name} has no step" for c in self.cycles if not c.duration]

    @property
    def halved(self) -> bool:
        """Whether all steps last a power of two, in seconds."""
        return all(np.all(np.frexp(s.dt)[0] == 0.5) for s in self.samples)

    def of_each(self, found: Sequence[float], part: slice) -> Any:
        """Return for some runs what their cycles have; one number where there is one cycle."""
        return np.array(found)[self.of[part]] if len(found) > 1 else found[0]

    def ends(self, done: _Done) -> Array:
        """Return the times by which runs lost a number; NaN for those that did not."""
        steps = zip(self.of[done.part], done.lost, strict=True)
        return np.array([self.samples[i].t[k - 1] if k else np.nan for i, k in steps])

    def in_c(self, times: Sequence[float]) -> tuple[Any, list[Any]]:
        """Return the traces as C reads them, with the steps of the times at which outputs are looked at; and what must live so long."""
        traces, kept = (_Trace * len(self.samples))(), []
        for i, (cycle, s) in enumerate(zip(self.cycles, self.samples, strict=True)):
            at = np.searchsorted(s.t, np.array(times) - TIME_STEP).astype(ctypes.c_long)
            at[np.array(times) < cycle.time[0] + TIME_STEP] = -1
            distance, grade = s.grade_by_distance or (None, None)
            n_grade = 0 if distance is None else len(distance)
            traces[i] = _Trace(len(s.t), *map(address, (s.dt, s.v, s.grade, s.key_on)), n_grade, *map(address, (distance, grade, at)))
            kept.append((s, at))
        return traces, kept


class _Trace(ctypes.Structure):
    """``trace`` in ``batch.c``."""

    _fields_ = (
        ("n", ctypes.c_long), *((name, ctypes.c_void_p) for name in ("dt", "v", "grade", "key_on")),
        ("n_grade", ctypes.c_long), *((name, ctypes.c_void_p) for name in ("grade_distance", "grade_value", "at")),
    )  # fmt: skip


class _Job(ctypes.Structure):
    """``batch`` in ``batch.c``."""

    _fields_ = (
        ("runs", ctypes.c_long), ("next", ctypes.c_long),
        *((name, ctypes.c_void_p) for name in ("order", "traces", "trace_of", "p", "x", "x_of")),
        ("n_x", ctypes.c_long), ("found", ctypes.c_void_p), ("history", ctypes.c_void_p), ("rows", ctypes.c_long),
        ("lost", ctypes.c_void_p), ("unsolved", ctypes.c_void_p), ("mode", ctypes.c_int),
    )  # fmt: skip


class _Done(NamedTuple):
    """Runs that are done: which, what was found of them, the step by which a number was lost, and searches without success."""

    part: slice
    found: Mapping[str, Array]
    lost: npt.NDArray[np.intc]
    unsolved: npt.NDArray[np.intc]


class _Plan(NamedTuple):
    """What is compiled: a structure, and what is wanted of its outputs."""

    library: ctypes.CDLL
    step: Step
    wanted: tuple[Wanted, ...]
    history: tuple[str, ...]

    def march(
        self, fleet: Vehicle, maps: Mapping[str, Any], traces: _Traces, starts: Mapping[str, Any], rows: Array, mode: Mode, threads: int
    ) -> Iterator[_Done]:
        """Run all, some thousands at a time; histories are written to the rows."""
        numbers, start_speed = fleet.values, self.step.parameter_index[self.step.tags.the("start speed")]
        varied = {i: x for i, d in enumerate(self.step.parameters) if isinstance(x := numbers[d.name], np.ndarray)}
        same = [0.0 if i in varied else numbers[d.name] for i, d in enumerate(self.step.parameters)]
        # Behind the parameters stand the values of maps.
        p: Array = np.empty((min(CHUNK, len(traces.of)), len(same) + sum(len(own[0].values) for own in maps.values())))
        p[:, : len(same)] = same
        places = np.array([self.step.state_index[name] for name in starts], dtype=np.intc)
        in_c, _kept = traces.in_c([w.how for w in self.wanted if isinstance(w.how, float)])
        lengths = np.array([len(s.t) for s in traces.samples])
        for k in range(0, len(traces.of), CHUNK):
            part = slice(k, min(k + CHUNK, len(traces.of)))
            n = part.stop - k
            # Runs that last equally long go together.
            order = np.argsort(lengths[traces.of[part]], kind="stable").astype(np.intc)
            x, found = np.empty((n, len(starts))), np.empty((n, len(self.wanted)))
            lost, unsolved = np.empty(n, np.intc), np.empty(n, np.intc)
            for i, values in varied.items():
                p[:n, i] = values[part]
            p[:n, start_speed] = traces.of_each([s.v_start for s in traces.samples], part)
            if maps:
                p[:n, len(same) :] = np.hstack([[t.values for t in own[part]] for own in maps.values()])
            for i, values in enumerate(starts.values()):
                x[:, i] = values[part] if isinstance(values, np.ndarray) else values
            job = _Job(
                n, 0, address(order), ctypes.addressof(in_c), address(traces.of[part]), address(p), address(x), address(places),
                len(starts), address(found), address(rows[part]), traces.longest, address(lost), address(unsolved), MODES.index(mode),
            )  # fmt: skip
            self.library.hs_batch(ctypes.byref(job), threads)
            yield _Done(part, {w.name: found[:, i] for i, w in enumerate(self.wanted)}, lost, unsolved)


@lru_cache(maxsize=32)
def _plan(build: Build, wanted: tuple[Wanted, ...], history: tuple[str, ...], maps: tuple[str, ...], width: str, halved: bool) -> _Plan:
    whole = stepper_of(build.vehicle).step
    # The march itself needs the request and what is missed of it.
    step = whole.only({*(w.output for w in wanted), *history, *(whole.tags.the(tag) for tag in ("request", "miss", "overspeed"))})
    lines = []
    for i, name in enumerate((*IN_C, "kept")):
        index = step.state_index if name == "begin" else step.output_index
        places = [str(index[o]) for o in (history if name == "kept" else [w.output for w in wanted if w.place[0] == i])]
        lines.append(f"#define HS_{name.upper()} {len(places)}\nstatic const int at_{name}[] = {{{', '.join(places) or '0'}}};")
    own = {name: files("halfshaft.studies").joinpath(name).read_text(encoding="utf-8") for name in ("batch.c", "march_lanes.h")}
    lengths = [len(step.tables[name].values) for name in maps]
    rows = {name: len(step.parameters) + sum(lengths[:i]) for i, name in enumerate(maps)}
    code = "\n".join([march_code(step, rows), *lines, lanes_code(step, rows, halved=halved) if width else "", own.pop("batch.c")])
    flags = ("-pthread", *(("-O1", *WIDTHS[width][0]) if width else ()))
    try:
        library = shared_library(code, f"{step.name}_batch", own | lanes_header() if width else {}, flags)
    except CompileError:
        if not width:
            raise
        # The compiler does not know these instructions, or there is none: then the next try says so.
        return _plan(build, wanted, history, maps, "", halved)
    return _Plan(ctypes.CDLL(str(library)), step, wanted, history)


class _Figures:
    """Makes the main figures of runs that are done."""

    def __init__(self, step: Step, fleet: Vehicle, traces: _Traces) -> None:
        self.step, self.numbers = step, fleet.values
        self.ratings = {role: p.ratings() for role, p in fleet.parameters.items()}
        ends = [float(s.t[-1]) - float(c.time[0]) for c, s in zip(traces.cycles, traces.samples, strict=True)]
        self.duration = partial(traces.of_each, ends)

    def __call__(self, done: _Done) -> dict[str, Any]:
        def part(values: Mapping[str, Any]) -> dict[str, Any]:
            return {name: x[done.part] if isinstance(x, np.ndarray) else x for name, x in values.items()}

        def get(output: str, how: str) -> Array:
            return done.found[Wanted(output, how).name]

        ratings = {role: part(rated) for role, rated in self.ratings.items()}
        main = figures(self.step, get, part(self.numbers), ratings, self.duration(done.part))
        return main | {Wanted(output, how).name: get(output, how) for output, how in end_states(self.step)}


def _main(step: Step) -> list[Wanted]:
    """Return what the main figures need."""
    return [Wanted(output, how) for output, how in (*needs(step), *end_states(step))]


def _wanted(summary: Mapping[str, Any]) -> list[Wanted]:
    """Return what was asked for."""
    several = {name: hows if isinstance(hows, Sequence) and not isinstance(hows, str) else [hows] for name, hows in summary.items()}
    return [Wanted(name, how if isinstance(how, str) else number(how)) for name, hows in several.items() for how in hows]


def _own_maps(step: Step, fleet: Vehicle, problems: list[str]) -> dict[str, Any]:
    """Return the maps that each run has of its own, since a rule makes them, by their names in the step."""
    found = {}
    for role, p in fleet.parameters.items():
        for f in fields(p):
            if not (spec_of(f).axes and isinstance(own := getattr(p, f.name), np.ndarray)):
                continue
            found[name := f"{step.name}_{role}_{f.name}"] = own
            points = step.tables[name].points
            if len(points) > 1 or any(not np.array_equal(t.points[0], points[0]) for t in {id(t): t for t in own}.values()):
                problems.append(f"{role}.{f.name} differs in more than the values over one axis: run these one by one")
    return found


def _unknown(step: Step, wanted: Sequence[Wanted], starts: Mapping[str, Any], history: Sequence[str]) -> Iterator[str]:
    """Yield what was asked for that there is not."""
    for name in dict.fromkeys((*(w.output for w in wanted), *history)):
        if name not in step.output_index:
            yield f"{name} is no output{nearest(name, {d.name: d for d in step.outputs})}"
    for w in wanted:
        if isinstance(w.how, str) and w.how not in HOWS:
            yield f"{w.output}: {w.how!r} must be a time or one of {', '.join(HOWS)}{nearest(w.how, HOWS)}"
        elif not isinstance(w.how, str) and not np.isfinite(w.how):
            yield f"{w.output}: a time must be a finite number"
        elif w.how == "first" and w.output in step.output_index and w.output not in step.state_index:
            yield f"{w.output} shows no state, so it has no first value"
    for name, x in starts.items():
        if name not in step.state_index:
            yield f"{name} is no state{nearest(name, {d.name: d for d in step.states})}"
        elif isinstance(x, str) or np.isinf(x).any():
            yield f"{name} must start at a finite number"


def _checked(vehicle: Any, cycle: Any, mode: Any, dt: Any, threads: Any) -> tuple[list[Cycle], list[str]]:
    """Return the cycles, and what is wrong with the arguments."""
    problems = not_a(Vehicle, vehicle=vehicle)
    many = isinstance(cycle, Sequence) and not isinstance(cycle, str)
    cycles = list(cycle) if many else [cycle]
    problems += [p for i, c in enumerate(cycles) for p in not_a(Cycle, **{f"cycle[{i}]" if many else "cycle": c})][:NAMED]
    if not cycles:
        problems.append("there are no cycles")
    if not (isinstance(mode, str) and mode in MODES):
        problems.append(f"mode = {mode!r}, must be one of {', '.join(MODES)}{nearest(str(mode), MODES)}")
    if not 0 < number(dt) < np.inf:
        problems.append(f"dt = {dt} s, must be a number > 0 s")
    if threads is not None and not (isinstance(threads, int | np.integer) and threads >= 1):
        problems.append(f"threads = {threads!r}, must be a whole number >= 1")
    if problems:
        raise InputError("batch", problems)
    return cycles, problems


def _spread(values: Any, problems: list[str]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return single values, and arrays of an entry for each run; and the dimensions that a dataset spreads the runs over."""
    dims: dict[str, Any] = {}
    if hasattr(values, "data_vars"):
        import xarray as xr

        frame = xr.broadcast(values)[0]
        dims, values = dict(frame.sizes), {str(name): x.values.ravel() for name, x in frame.data_vars.items()}
    spread = {}
    for name, x in values.items():
        if isinstance(x, str) or np.ndim(x) == 0:
            spread[name] = x.item() if isinstance(x, np.generic | np.ndarray) else x
            continue
        try:
            spread[name] = np.ascontiguousarray(x, dtype=float)
        except (TypeError, ValueError):
            problems.append(f"{name} must be a number, or a row of numbers")
            continue
        if spread[name].ndim != 1 or not len(spread[name]):
            problems.append(f"{name} has the shape {spread[name].shape}, must be one row with an entry for each run")
    return spread, dims


def _dataset(
    vehicle: Vehicle, plan: _Plan, given: Mapping[str, Any], dims: Mapping[str, int], columns: Mapping[str, Any], traces: _Traces,
    rows: Array,
) -> xr.Dataset:  # fmt: skip
    """Return what was found, with units and the values that the runs differ in."""
    import xarray as xr  # takes a fifth of a second

    shape, described, wanted = tuple(dims.values()), {d.name: d for d in plan.step.outputs}, {w.name: w for w in plan.wanted}

    def over_runs(x: Any, **attributes: Any) -> Any:
        return tuple(dims), x.reshape(shape), attributes

    def about_column(name: str) -> dict[str, Any]:
        if name in own:
            return own[name]
        if name not in wanted:
            return {"units": unit_of(name)}
        unit, doc = described[wanted[name].output].unit, described[wanted[name].output].doc
        units = {"W": "J", "1": "s"}.get(unit, f"{unit} s") if wanted[name].how == "integral" else unit
        return {"units": units, "long_name": f"{doc}, {name.removeprefix(wanted[name].output + '.')}"}

    own: dict[str, dict[str, Any]] = {
        "status": {"flag_values": np.array([0, 1], np.int8), "flag_meanings": "done lost", "long_name": "whether a number was lost"},
        "lost_by": {"units": "s", "long_name": "time by which a number was lost"},
        "unsolved": {"units": "1", "long_name": "steps in which no speed is reached"},
    }
    data = {name: over_runs(x, **about_column(name)) for name, x in columns.items()}
    coords = {
        name: over_runs(x, units=spec.unit, long_name=spec.doc)
        for name, x in given.items()
        if isinstance(x, np.ndarray) and (spec := vehicle.specs.get(name) or vehicle.rated[name].spec)
    }
    if plan.history:
        one = len(traces.cycles) == 1
        time = np.full((len(traces.samples), traces.longest), np.nan)
        for row, s in zip(time, traces.samples, strict=True):
            row[: len(s.t)] = s.t
        along = "time" if one else "step"
        attributes = {"units": "s", "long_name": "end of the step"}
        coords["time"] = ("time", time[0], attributes) if one else ((*dims, "step"), time[traces.of].reshape((*shape, -1)), attributes)
        for i, name in enumerate(plan.history):
            unit, doc = described[name].unit, described[name].doc
            data[name] = ((*dims, along), rows[:, :, i].reshape((*shape, -1)), {"units": unit, "long_name": doc})
    return xr.Dataset(data, coords)
