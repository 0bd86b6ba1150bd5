"""The command line: ``halfshaft run``, ``accelerate``, ``fmu``, ``reproduce``, ``bench``, ``list`` and ``show``.

What a user did wrong ends with exit code 2 and one message on standard error that names everything that is wrong.
Results go to standard output, warnings and progress to standard error.
"""

from __future__ import annotations

import io
import json
import math
import os
import sys
import tomllib
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
import typer
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.padding import Padding
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table
from typer.core import TyperGroup

from halfshaft import __version__
from halfshaft.cosim.acceleration import accelerate
from halfshaft.cosim.compiled import Mode
from halfshaft.cosim.cycle import Cycle, cycle_names
from halfshaft.cosim.fmu import build_fmu, fmu_problems
from halfshaft.cosim.result import Result
from halfshaft.cosim.simulate import Via, run
from halfshaft.fmu_build.variables import Version
from halfshaft.library.catalog import KINDS
from halfshaft.library.errors import HalfshaftError, InputError, nearest
from halfshaft.library.files import ComponentFile, component_names, read_component
from halfshaft.library.parameters import Parameters, numbers, spec_of, tables
from halfshaft.library.tables import Table as Map
from halfshaft.models.vehicle import RULES, Vehicle, vehicle_names

T = TypeVar("T")

#: More steps than this do not fit into the memory of a small machine, all outputs kept.
MOST_STEPS = 2_000_000


class Commands(TyperGroup):
    """The commands, with errors and warnings shown as one message each."""

    def invoke(self, ctx: Any) -> Any:
        """Run a command."""
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, io.TextIOWrapper) and not stream.encoding.lower().startswith("utf"):
                stream.reconfigure(errors="replace")
        seen: set[str] = set()
        stderr = sys.stderr

        def show(message: Warning | str, *_: Any, **__: Any) -> None:
            text = " ".join(str(message).split())
            if text not in seen:
                # A running progress line is overwritten.
                clear = "\r\033[K" if stderr.isatty() else ""
                typer.secho(f"{clear}warning: {text}", fg="yellow", file=stderr)
            seen.add(text)

        with warnings.catch_warnings():
            warnings.simplefilter("always", UserWarning)
            warnings.showwarning = show
            try:
                return super().invoke(ctx)
            except HalfshaftError as error:
                typer.secho(f"error: {error}", fg="red", err=True)
                raise typer.Exit(2) from None


app = typer.Typer(
    cls=Commands,
    help="Vehicle powertrains: cycle runs, full acceleration, FMUs.",
    epilog="A vehicle or a cycle is a name of the library (halfshaft list) or the path of a TOML or CSV file.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"halfshaft {__version__}")
        raise typer.Exit


@app.callback()
def _main(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")] = False,
) -> None:
    pass


VehicleName = Annotated[str, typer.Argument(metavar="VEHICLE", help="Name in the library, or a TOML file.", show_default=False)]
GradeFile = Annotated[str | None, typer.Option("--grade", metavar="CSV", help="Grade of the road over distance, with --cycle.")]
Mass = Annotated[float | None, typer.Option(metavar="KG", help="Mass of the vehicle, body.m.")]
Values = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help='A number with unit, motor.J="0.05 kg m^2", or in SI; repeatable.'),
]
Soc = Annotated[float | None, typer.Option(metavar="X", help="State of charge at the start, 0 to 1.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]


@app.command(
    "run",
    help="""Run a vehicle over a cycle.

    \b
    Examples:
      halfshaft run small-car-series --cycle us06
      halfshaft run small-car-electric --cycle udds --mass 1500 --soc 0.9 --plot udds.png
      halfshaft run my-car.toml --cycle trip.csv --grade road.csv --out trip.nc
      halfshaft run small-car-conventional --cycle hwfet --set engine.J="0.2 kg m^2" --json
    """,
)
def run_command(
    vehicle: VehicleName,
    cycle: Annotated[str, typer.Option(metavar="CYCLE", help="Name in the library, or a CSV file.", show_default=False)],
    via: Annotated[Via, typer.Option(help="The compiled step, an FMU of it through FMPy, or the forward-facing model.")] = "step",
    mode: Annotated[Mode, typer.Option(help="The paper's method; solved for the best end speed; the paper's benchmark.")] = "hybrid",
    dt: Annotated[float, typer.Option(metavar="S", help="Length of the step [s].")] = 1.0,
    grade: GradeFile = None,
    mass: Mass = None,
    values: Values = None,
    soc: Soc = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE.nc", help="Write all time series to a netCDF file.")] = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE.png", help="Draw the run (.png, .svg, .pdf).")] = None,
    as_json: Json = False,
) -> None:
    """Run a vehicle over a cycle."""
    checks = _Checks()
    car = checks.vehicle(vehicle, mass, values, soc)
    trace = checks.take(lambda: Cycle.load(cycle, grade))
    checks.step(dt, trace)
    if mode != "hybrid" and via != "step":
        checks.problem(f"mode {mode} runs via step only, not via {via}")
    if via in ("fmu2", "fmu3") and trace is not None and checks.step_fits:
        checks.problem(*fmu_problems(3, trace, dt))
    checks.target(out, "--out")
    checks.target(plot, "--plot")
    if plot is not None:
        from halfshaft.cosim.plot import plot_problems  # matplotlib takes a quarter of a second

        checks.problem(*(f"--plot {plot}: {p}" for p in plot_problems(plot)))
    car, trace = checks.done(car), checks.done(trace)
    with _busy(f"{_VIA[via]}: {car.name} over {trace.name}"), _solver_noise():
        result = run(car, trace, via=via, dt=dt, mode=mode)
    if out is not None:
        with _busy(f"writing {out}"):
            result.save(out)
    if plot is not None:
        from halfshaft.cosim.plot import plot_run

        with _busy(f"drawing {plot}"):
            plot_run(result, plot)
    if as_json:
        _print_json({**result.summary, "account": _account(result)})
        return
    console = _console()
    _print_run(console, car, trace, result)
    for path in (out, plot):
        if path is not None:
            console.print(f"  wrote {path}", style="dim", markup=False, highlight=False, soft_wrap=True)


_VIA = {"step": "compiled step", "fmu2": "FMI 2.0", "fmu3": "FMI 3.0", "forward": "forward-facing model"}


@app.command(
    "accelerate",
    help="""Accelerate from rest as fast as the vehicle can.

    \b
    Examples:
      halfshaft accelerate small-car-electric
      halfshaft accelerate paper-series-1936 --to 96.6 --compare
      halfshaft accelerate small-car-conventional --mass 1600 --json
    """,
)
def accelerate_command(
    vehicle: VehicleName,
    to: Annotated[float, typer.Option(metavar="KMH", help="Speed to reach [km/h].")] = 100.0,
    mass: Mass = None,
    values: Values = None,
    compare: Annotated[bool, typer.Option("--compare", help="Also by iteration, refined, and with the forward-facing model.")] = False,
    as_json: Json = False,
) -> None:
    """Accelerate from rest as fast as the vehicle can."""
    checks = _Checks()
    found = checks.vehicle(vehicle, mass, values, None)
    if not 0 < to < 322:
        checks.problem(f"--to {to:g} km/h, must be > 0 and < 322 km/h")
    car = checks.done(found)
    ways: dict[str, tuple[str, Mode, Via]] = {"time_s": ("hybrid", "hybrid", "step")}
    if compare:
        ways["iteration_s"] = ("iteration", "iteration", "step")
        ways["refined_s"] = ("refined", "refined", "step")
        ways["forward_s"] = ("forward-facing", "hybrid", "forward")
    times: dict[str, float | None] = {}
    last: Result | None = None
    for key, (title, mode, via) in ways.items():
        with _busy(f"{title}: full acceleration of {car.name}"), _solver_noise():
            done = accelerate(car, to=to / 3.6, mode=mode, via=via)
        times[key] = done.time
        last = last or done.result
    if as_json:
        _print_json(times)
        return
    console = _console()
    console.print(f"[bold]{escape(car.name)}[/] from 0 to {to:g} km/h", highlight=False, soft_wrap=True)
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1))
    table.add_column("method")
    table.add_column("time \\[s]", justify="right")
    if compare:
        table.add_column("against iteration", justify="right")
    for key, (title, _, _) in ways.items():
        t, reference = times[key], times.get("iteration_s")
        row = [title, "not reached" if t is None else f"{t:.3f}"]
        if compare:
            row.append("" if t is None or reference is None or key == "iteration_s" else f"{100 * (t / reference - 1):+.2f} %")
        table.add_row(*row)
    console.print(table)
    if last is not None and times["time_s"] is None:
        console.print(f"  [yellow]highest speed {last['body.v'].max() * 3.6:.1f} km/h after {last.summary['duration_s']:g} s[/]")


@app.command(
    "fmu",
    help="""Write a vehicle as a co-simulation FMU.

    Without --cycle, requested speed, grade and key are inputs; with it, the FMU drives the cycle by itself.

    \b
    Examples:
      halfshaft fmu small-car-series --fmi 3 -o car.fmu
      halfshaft fmu small-car-electric --fmi 2 --cycle udds --dt 0.5 -o udds.fmu
    """,
)
def fmu_command(
    vehicle: VehicleName,
    fmi: Annotated[Literal["2", "3"], typer.Option(help="Version of the standard.", show_default=False)],
    output: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="The FMU to write.", show_default=False)],
    cycle: Annotated[str | None, typer.Option(metavar="CYCLE", help="Name in the library, or a CSV file.")] = None,
    dt: Annotated[float, typer.Option(metavar="S", help="Length of the internal steps [s].")] = 1.0,
    grade: GradeFile = None,
    mass: Mass = None,
    values: Values = None,
    soc: Soc = None,
) -> None:
    """Write a vehicle as a co-simulation FMU."""
    version: Version = 2 if fmi == "2" else 3
    checks = _Checks()
    found = checks.vehicle(vehicle, mass, values, soc)
    trace = None if cycle is None else checks.take(lambda: Cycle.load(cycle, grade))
    if grade is not None and cycle is None:
        checks.problem("--grade goes with --cycle; without a cycle the grade is an input of the FMU")
    checks.step(dt, trace)
    if checks.step_fits:
        checks.problem(*fmu_problems(version, trace, dt))
    checks.target(output, "--out")
    if output.suffix.lower() != ".fmu":
        checks.problem(f"--out {output}: the name of an FMU ends in .fmu")
    car = checks.done(found)
    with _busy(f"building {output}"):
        path = build_fmu(car, output, fmi=version, cycle=trace, dt=dt)
    what = f"drives {trace.name}" if trace else "driven by requested speed, grade and key"
    console = _console()
    console.print(f"{path}: FMI {fmi}.0, {path.stat().st_size / 1024:.0f} KiB, {what}", markup=False, highlight=False, soft_wrap=True)


@app.command(
    "reproduce",
    help="""Reproduce the tables and figures of the paper.

    \b
    Examples:
      halfshaft reproduce
      halfshaft reproduce --out build/reproduce
    """,
)
def reproduce_command(
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Write figures, tables and a report to this folder.")] = None,
    as_json: Json = False,
) -> None:
    """Reproduce the tables and figures of the paper."""
    from halfshaft.validation.reproduce import reproduce

    checks = _Checks()
    checks.folder(out, "--out")
    checks.raise_problems()
    with _busy("reproducing the paper") as progress, _solver_noise():
        found = reproduce(out, progress)
    if as_json:
        _print_json(found)
        return
    console = _console()
    _print_group(console, _plain(found), [])
    if out is not None:
        console.print(f"  wrote {out}", style="dim", markup=False, highlight=False, soft_wrap=True)


@app.command(
    "bench",
    help="""Time the step, and compare it with FASTSim where that is installed.

    \b
    Examples:
      halfshaft bench
      halfshaft bench --json
    """,
)
def bench_command(as_json: Json = False) -> None:
    """Time the step."""
    from halfshaft.validation.bench import bench

    with _busy("timing") as progress, _solver_noise():
        found = bench(progress)
    if as_json:
        _print_json(found)
    else:
        _print_bench(_console(), found["rows"])


@app.command(
    "list",
    help="""List what the library has.

    \b
    Examples:
      halfshaft list vehicles
      halfshaft list components
    """,
)
def list_command(what: Annotated[Literal["vehicles", "components", "cycles"], typer.Argument(show_default=False)]) -> None:
    """List what the library has."""
    headings, rows = {"vehicles": _vehicle_rows, "components": _component_rows, "cycles": _cycle_rows}[what]()
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1))
    for i, heading in enumerate(headings):
        table.add_column(heading, justify="right" if "[" in heading else "left", no_wrap=i == 0, overflow="fold")
    for row in rows:
        table.add_row(*(escape(text) for text in row))
    _console().print(table)


Rows = tuple[list[str], list[list[str]]]


def _vehicle_rows() -> Rows:
    vehicles = [Vehicle.load(name) for name in vehicle_names()]
    return ["vehicle", "powertrain", "mass \\[kg]", "title"], [[v.name, v.powertrain, f"{v.values['body.m']:g}", v.title] for v in vehicles]


def _component_rows() -> Rows:
    components = [_component(name) for name in component_names()]
    return ["component", "kind", "title"], [[c.name, c.kind, c.title] for c in sorted(components, key=lambda c: c.kind)]


def _cycle_rows() -> Rows:
    cycles = [Cycle.load(name) for name in cycle_names()]
    rows = []
    for c in cycles:
        s = c.statistics()
        rows.append([c.name, f"{s.duration:g}", f"{s.distance / 1000:.2f}", f"{s.v_max * 3.6:.1f}", c.title])
    return ["cycle", "time \\[s]", "distance \\[km]", "top \\[km/h]", "title"], rows


@app.command(
    "show",
    help="""Show a vehicle, a component or a cycle with all its numbers.

    \b
    Examples:
      halfshaft show small-car-series
      halfshaft show si-41kw
      halfshaft show us06
      halfshaft show my-car.toml
    """,
)
def show_command(name: Annotated[str, typer.Argument(metavar="NAME", help="Name in the library, or a file.", show_default=False)]) -> None:
    """Show a vehicle, a component or a cycle."""
    console, found = _console(), _find(name)
    if isinstance(found, Vehicle):
        _show_vehicle(console, found)
    elif isinstance(found, Cycle):
        _show_cycle(console, found)
    else:
        _show_component(console, found)


def _find(name: str) -> Vehicle | Cycle | ComponentFile:
    if name.lower().endswith(".csv"):
        return Cycle.load(name)
    if name.endswith(".toml"):
        return _component(name) if _is_component(Path(name)) else Vehicle.load(name)
    if name in vehicle_names():
        return Vehicle.load(name)
    if name in component_names():
        return _component(name)
    if name.lower() in cycle_names():
        return Cycle.load(name)
    known = [*vehicle_names(), *component_names(), *cycle_names()]
    raise InputError(f"'{name}'", [f"no vehicle, component or cycle of the library is called so{nearest(name, known)}"])


def _is_component(path: Path) -> bool:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8")).get("kind") in KINDS
    except (OSError, ValueError):
        return False  # the reader of vehicles says what is wrong


def _component(name: str) -> ComponentFile:
    try:
        return read_component(name)
    except InputError:
        # What other parts of a vehicle decide may be left open.
        return read_component(name, [rule.target.partition(".")[2] for rule in RULES.values()])


class _Checks:
    """Collects what is wrong with the input, so that one message names it all."""

    def __init__(self) -> None:
        self._errors: list[HalfshaftError] = []
        self.step_fits = True

    def problem(self, *texts: str) -> None:
        """Note what is wrong."""
        self._errors.extend(HalfshaftError(text) for text in texts)

    def take(self, load: Callable[[], T]) -> T | None:
        """Return what is loaded, or None and note why."""
        try:
            return load()
        except HalfshaftError as error:
            self._errors.append(error)
            return None

    def vehicle(self, name: str, mass: float | None, values: Sequence[str] | None, soc: float | None) -> Vehicle | None:
        """Return a vehicle with the numbers that were set."""
        car = self.take(lambda: Vehicle.load(name))
        given: list[tuple[str, float | str]] = [] if mass is None else [("body.m", mass)]
        for text in values or ():
            key, sign, value = text.partition("=")
            if not (key.strip() and sign and value.strip()):
                self.problem(f"--set {text}: must be NAME=VALUE, such as body.m=1500 or motor.J='0.05 kg m^2'")
                continue
            given.append((key.strip(), _number_or_text(value.strip())))
        if soc is not None:
            if car is not None and "battery.soc_start" not in car.values:
                self.problem(f"--soc {soc:g}: vehicle '{car.name}' has no battery")
            else:
                given.append(("battery.soc_start", soc))
        names = [key for key, _ in given]
        self.problem(*(f"{key} is set {names.count(key)} times" for key in dict.fromkeys(names) if names.count(key) > 1))
        return None if car is None else self.take(lambda: car.with_values(dict(given)))

    def step(self, dt: float, trace: Cycle | None) -> None:
        """Note a length of step that no run can have."""
        if not (math.isfinite(dt) and dt > 0):
            self.problem(f"--dt {dt:g} s, must be > 0 s")
        elif trace is not None and trace.duration / dt > MOST_STEPS:
            self.problem(f"--dt {dt:g} s makes {trace.duration / dt:.3g} steps of cycle '{trace.name}', must be at most {MOST_STEPS}")
        else:
            return
        self.step_fits = False

    def target(self, path: Path | None, option: str) -> None:
        """Note a file that cannot be written."""
        if path is None:
            return
        if path.is_dir():
            self.problem(f"{option} {path}: is a folder, must be a file")
        elif not path.parent.is_dir():
            self.problem(f"{option} {path}: there is no folder {path.parent}")
        elif not os.access(path.parent, os.W_OK | os.X_OK):
            self.problem(f"{option} {path}: the folder {path.parent} cannot be written to")

    def folder(self, path: Path | None, option: str) -> None:
        """Note a folder that cannot be made or written to."""
        if path is None:
            return
        there = next(p for p in (path.absolute(), *path.absolute().parents) if p.exists())
        if not there.is_dir():
            self.problem(f"{option} {path}: {there} is a file, must be a folder")
        elif not os.access(there, os.W_OK | os.X_OK):
            self.problem(f"{option} {path}: the folder {there} cannot be written to")

    def done(self, value: T | None) -> T:
        """Return what was loaded, now that all is known to be right.

        Raises
        ------
        HalfshaftError
            With everything that is wrong.

        """
        self.raise_problems()
        if value is None:
            raise HalfshaftError("nothing was loaded")
        return value

    def raise_problems(self) -> None:
        """Raise one error if anything was wrong."""
        if len(self._errors) == 1:
            raise self._errors[0]
        if self._errors:
            raise HalfshaftError("\n  ".join(["several things are wrong:", *(str(e).replace("\n", "\n  ") for e in self._errors)]))


def _number_or_text(text: str) -> float | str:
    """Return a number where there is no unit, which is SI then."""
    try:
        return float(text)
    except ValueError:
        return text


def _console() -> Console:
    # In a pipe or a file, lines may be longer than on the narrowest terminal.
    narrow = sys.stdout.isatty() or "COLUMNS" in os.environ
    return Console(file=sys.stdout, width=None if narrow else 120)


@contextmanager
def _busy(what: str) -> Iterator[Callable[[str], None]]:
    """Show on a terminal what is being done; yields what takes the name of each further task."""
    console = Console(file=sys.stderr)
    if not console.is_terminal:
        yield lambda _: None
        return
    columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn())
    with Progress(*columns, console=console, transient=True, redirect_stdout=False, redirect_stderr=False) as progress:
        task = progress.add_task(what, total=None)
        yield lambda text: progress.update(task, description=text)


@contextmanager
def _solver_noise() -> Iterator[None]:
    """Keep what the integrator says to itself from the terminal; what matters is in the error."""
    with redirect_stderr(io.StringIO()):
        yield


def _plain(value: Any) -> Any:
    """Return what JSON can hold; what is not a finite number becomes null."""
    if isinstance(value, Mapping):
        return {str(k): _plain(x) for k, x in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(x) for x in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _print_json(found: Mapping[str, Any]) -> None:
    typer.echo(json.dumps(_plain(found), indent=2, allow_nan=False))


def _account(result: Result) -> dict[str, Any]:
    a = result.account
    return {
        "fuel_J": a.fuel,
        "battery_J": a.battery,
        "parts": {part.name: {"in_J": part.received, "out_J": part.delivered, "loss_J": part.lost} for part in a.parts},
        "losses_J": dict(a.losses),
        "kinetic_J": a.kinetic,
        "potential_J": a.potential,
        "speed_mismatch_J": a.speed_mismatch,
        "inertia_discretisation_J": a.inertia_discretisation,
        "speed_limit_J": a.speed_limit,
        "residual_J": a.residual,
    }


def _print_run(console: Console, car: Vehicle, trace: Cycle, result: Result) -> None:
    s = result.summary
    how = "forward-facing" if result.inputs.via == "forward" else f"{_VIA[result.inputs.via]}, {result.inputs.mode}, {result.inputs.dt:g} s"
    console.print(f"[bold]{escape(car.name)}[/] over [bold]{escape(trace.name)}[/]  [dim]{escape(how)}[/]", highlight=False, soft_wrap=True)
    facts = [("distance", f"{s['distance_m'] / 1000:.3f} km"), ("duration", f"{s['duration_s']:g} s")]
    if s["fuel_L"] is not None:
        economy = s["fuel_economy_L_per_100km"]
        facts += [("fuel", f"{s['fuel_L']:.4f} L"), ("economy", "-" if economy is None else f"{economy:.3f} L/100 km")]
    if s["motor_input_J"] is not None:
        facts.append(("motor input", f"{s['motor_input_J'] / 3.6e6:.4f} kWh"))
    if s["soc_end"] is not None:
        facts.append(("state of charge", f"{s['soc_start']:.4f} -> {s['soc_end']:.4f}"))
    facts.append(("largest trace miss", f"{s['trace_miss_max_mps'] * 3.6:.2f} km/h"))
    facts += [("", "")] * (len(facts) % 2)
    grid = Table.grid(padding=(0, 3))
    for (name, value), (other, also) in zip(facts[::2], facts[1::2], strict=True):
        grid.add_row(f"[dim]{name}[/]", value, f"[dim]{other}[/]", also)
    console.print(Padding(grid, (1, 0, 0, 2), expand=False), highlight=False)
    console.print(_account_table(car, result))
    for text in result.warnings:
        console.print(f"  ! {text}", style="yellow", markup=False, highlight=False, soft_wrap=True)


def _account_table(car: Vehicle, result: Result) -> Table:
    """Return the energies in Wh, from the source to the wheel, and what became of them."""
    a = result.account
    rows = {part.name: part for part in a.parts}
    order = sorted((role for role in reversed(list(car.parts)) if role in rows), key=lambda role: role != "engine")
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1))
    table.add_column("energy \\[Wh]", no_wrap=True)
    for heading in ("in", "out", "loss"):
        table.add_column(heading, justify="right", no_wrap=True, min_width=9)
    for name in order:
        part = rows[name]
        table.add_row(name.replace("_", " "), *(_wh(x) for x in (part.received, part.delivered, part.lost)))
    table.add_section()
    if a.fuel:
        table.add_row("fuel", _wh(a.fuel), "", "")
    if a.battery:
        table.add_row("battery store", _wh(a.battery), "", "")
    table.add_row("losses", "", "", _wh(sum(a.losses.values())))
    for name, x in (("kinetic", a.kinetic), ("potential", a.potential)):
        table.add_row(f"{name} energy", "", _wh(x), "")
    lines = (
        ("speed mismatch", a.speed_mismatch),
        ("inertia discretisation", a.inertia_discretisation),
        ("limit and standstill", a.speed_limit),
    )
    for name, x in lines:
        table.add_row(f"[dim]method's error: {name}[/]", "", f"[dim]{_wh(x)}[/]", "")
    table.add_row(f"balance [dim]({a.balance_relative:.0e} of the turnover)[/]", "", "", _wh(a.residual))
    return table


def _wh(energy: float) -> str:
    """Return an energy [J] in Wh; what is rounding is zero."""
    return f"{energy / 3600:.2f}".replace("-0.00", "0.00")


def _print_bench(console: Console, rows: Sequence[Mapping[str, Any]]) -> None:
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1))
    for heading in ("measured", "value", "unit", "target", "note"):
        table.add_column(heading, justify="right" if heading == "value" else "left", overflow="fold", no_wrap=heading in ("value", "unit"))
    for row in rows:
        table.add_row(*(escape(_cell(row[key])) for key in ("name", "value", "unit", "target", "note")))
    console.print(table)


def _print_group(console: Console, found: Mapping[str, Any], above: list[str]) -> None:
    """Print a nested result: one table for each group, one line for each value or list."""
    groups = {k: x for k, x in found.items() if isinstance(x, dict)}
    single = {k: x for k, x in found.items() if k not in groups}
    if single:
        table = Table(box=box.SIMPLE_HEAD, show_header=False, padding=(0, 1), title=" ".join(above).replace("_", " ") or None)
        table.title_justify, table.title_style = "left", "bold"
        widest = max((len(x) for x in single.values() if isinstance(x, list)), default=1)
        table.add_column(no_wrap=True)
        for _ in range(widest if widest <= 8 else 1):
            table.add_column(justify="right", overflow="fold")
        for key, x in single.items():
            cells = x if isinstance(x, list) and widest <= 8 else [", ".join(map(_cell, x))] if isinstance(x, list) else [x]
            table.add_row(escape(key.replace("_", " ")), *(escape(_cell(cell)) for cell in cells))
        console.print(table)
    for key, group in groups.items():
        _print_group(console, group, [*above, key])


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _head(console: Console, name: str, title: str, facts: Iterable[tuple[str, str]]) -> None:
    console.print(f"[bold]{escape(name)}[/]  {escape(title)}", highlight=False, soft_wrap=True)
    grid = Table.grid(padding=(0, 2))
    grid.add_column(no_wrap=True)
    grid.add_column(overflow="fold")
    for key, value in facts:
        grid.add_row(f"[dim]{key}[/]", escape(value))
    console.print(Padding(grid, (0, 0, 0, 2)))


def _value_table(*headings: str) -> Table:
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1))
    table.add_column(headings[0], no_wrap=True)
    table.add_column("value", justify="right", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    table.add_column("meaning", overflow="fold", min_width=18)
    for heading in headings[1:]:
        table.add_column(heading, no_wrap=True)
    return table


def _show_vehicle(console: Console, v: Vehicle) -> None:
    _head(console, v.name, v.title, [("powertrain", v.powertrain), ("source", v.source)])
    parts = Table(box=box.SIMPLE_HEAD, padding=(0, 1))
    for heading in ("role", "component", "kind", "title"):
        parts.add_column(heading, no_wrap=heading == "role", overflow="fold")
    for role, part in v.parts.items():
        parts.add_row(role, escape(part.name), part.kind, escape(part.title))
    console.print(parts)
    ruled = {target: type(rule).__name__ for target, rule in v.rules.items()}
    table = _value_table("parameter", "from")
    for role, p in v.parameters.items():
        for name, spec, value in numbers(p):
            full = f"{role}.{name}"
            origin = "set" if full in v.explicit else "rule" if full in ruled or full.rpartition("_")[0] in ruled else ""
            table.add_row(full, f"{value:g}", spec.unit, escape(spec.doc), origin)
        _add_tables(table, f"{role}.", p)
        table.add_section()
    console.print(table)


def _show_component(console: Console, c: ComponentFile) -> None:
    _head(console, c.name, c.title, [("kind", c.kind), ("source", c.source)])
    table = _value_table("parameter")
    for f in fields(c.component.parameters):
        spec = spec_of(f)
        value = c.values.get(f.name, f.default)
        if value is MISSING:
            table.add_row(f.name, "open", spec.unit, escape(f"{spec.doc}; follows from other parts of a vehicle"))
        elif spec.axes:
            table.add_row(f.name, "map", spec.unit, escape(f"{spec.doc}; {_extent(value)}"))
        elif spec.row:
            for i, x in enumerate(value, 1):
                table.add_row(f"{f.name}_{i}", f"{x:g}", spec.unit, escape(spec.doc))
        else:
            table.add_row(f.name, f"{value:g}", spec.unit, escape(spec.doc))
    console.print(table)


def _add_tables(table: Table, prefix: str, p: Parameters) -> None:
    specs = {f.name: spec_of(f) for f in fields(p)}
    for name, t in tables(p):
        table.add_row(f"{prefix}{name}", "map", specs[name].unit, escape(f"{specs[name].doc}; {_extent(t)}"), "")


def _extent(t: Map) -> str:
    return f"{' x '.join(str(n) for n in t.values.shape)} values, {t.values.min():.4g} to {t.values.max():.4g}"


def _show_cycle(console: Console, c: Cycle) -> None:
    s = c.statistics()
    _head(console, c.name, c.title, [("source", c.source)])
    table = _value_table("figure")
    for name, value, unit, doc in (
        ("duration", s.duration, "s", "time from the first point to the last"),
        ("distance", s.distance / 1000, "km", "distance driven if the trace is met"),
        ("v_max", s.v_max * 3.6, "km/h", "top speed"),
        ("v_mean", s.v_mean * 3.6, "km/h", "mean speed, stops included"),
        ("a_max", s.a_max, "m/s^2", "largest acceleration"),
        ("a_min", s.a_min, "m/s^2", "largest deceleration"),
        ("t_idle", s.t_idle, "s", "time at rest"),
        ("stops", float(s.stops), "1", "number of stops"),
    ):
        table.add_row(name, f"{value:.5g}", unit, doc)
    if c.grade_by_distance is not None:
        low, high = (100 * float(x) for x in (c.grade_by_distance[1].min(), c.grade_by_distance[1].max()))
        table.add_row("grade", f"{low:.3g} to {high:.3g}", "%", "grade of the road, by distance")
    elif c.grade is not None:
        table.add_row("grade", f"{100 * c.grade.min():.3g} to {100 * c.grade.max():.3g}", "%", "grade of the road, by time")
    console.print(table)


if __name__ == "__main__":
    app()
