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
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
import typer
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.padding import Padding
from rich.table import Table
from typer.core import TyperGroup

import halfshaft
from halfshaft.cosim.acceleration import accelerate
from halfshaft.cosim.compiled import Mode
from halfshaft.cosim.cycle import Cycle, cycle_names
from halfshaft.cosim.fmu import build_fmu, fmu_problems
from halfshaft.cosim.result import Result
from halfshaft.cosim.simulate import Via, run
from halfshaft.fmu_build.variables import Version
from halfshaft.library.errors import HalfshaftError, InputError, SolveError, nearest
from halfshaft.library.files import ComponentFile, component_names, read_component
from halfshaft.library.parameters import Parameters, numbers, tables
from halfshaft.models.vehicle import Vehicle, vehicle_names

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

        def show(message: Warning | str, *_: Any, **__: Any) -> None:
            text = " ".join(str(message).split())
            if text not in seen:
                typer.secho(f"warning: {text}", fg="yellow", err=True)
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
        typer.echo(f"halfshaft {halfshaft.__version__}")
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
    list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help='A number with its unit, motor.J="0.05 kg m^2", or in SI. Repeatable.')
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
    table = Table(title=f"{escape(car.name)}: 0 to {to:g} km/h", title_justify="left", title_style="bold", box=box.SIMPLE_HEAD)
    table.add_column("method")
    table.add_column("time [s]", justify="right")
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
    _print_found(found, as_json)
    if out is not None and not as_json:
        _console().print(f"  wrote {out}", style="dim", markup=False, highlight=False, soft_wrap=True)


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
    _print_found(found, as_json)


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
    derived = ("ratios", "omega_locus")
    components = [c for name in component_names() for c in [_component(name, derived)]]
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
        return _component(name, _OPEN) if _is_component(Path(name)) else Vehicle.load(name)
    if name in vehicle_names():
        return Vehicle.load(name)
    if name in component_names():
        return _component(name, _OPEN)
    if name.lower() in cycle_names():
        return Cycle.load(name)
    known = [*vehicle_names(), *component_names(), *cycle_names()]
    raise InputError(f"'{name}'", [f"no vehicle, component or cycle of the library is called so{nearest(name, known)}"])
