"""The command line: ``halfshaft run``, ``accelerate``, ``fmu``, ``reproduce``, ``bench``, ``list`` and ``show``.

What a user did wrong ends with exit code 2 and one message on standard error that names everything that is wrong.
Results go to standard output, warnings and progress to standard error.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeVar

import typer

from halfshaft.cosim.cli_output import (
    VIA,
    Commands,
    busy,
    print_acceleration,
    print_bench,
    print_json,
    print_line,
    print_run,
    print_run_json,
    print_written,
)
from halfshaft.cosim.units import SYSTEMS, Units
from halfshaft.cosim.ways import Mode, Via
from halfshaft.library.base.errors import HalfshaftError
from halfshaft.library.files.writing import target_problem

if TYPE_CHECKING:
    # Each command imports what it runs: the help needs none of it.
    from halfshaft.cosim.acceleration import Acceleration
    from halfshaft.cosim.cycle import Cycle
    from halfshaft.models.vehicle import Vehicle

T = TypeVar("T")

#: What the library has.
Shelf = Literal["vehicles", "components", "cycles"]

#: Ways of a compared full acceleration, in the order in which they are shown.
COMPARED: tuple[Mode | Literal["forward"], ...] = ("hybrid", "iteration", "refined", "forward")

#: More steps than this do not fit into the memory of a small machine, all outputs kept.
MOST_STEPS = 2_000_000

app = typer.Typer(
    cls=Commands,
    help="Vehicle powertrains: cycle runs, full acceleration, FMUs.",
    epilog="A vehicle or a cycle is a name of the library (halfshaft list) or the path of a TOML or CSV file.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        from halfshaft import __version__

        typer.echo(f"halfshaft {__version__}")
        raise typer.Exit


@app.callback()
def _main(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")] = False,
) -> None:
    pass


def _vehicles(incomplete: str) -> list[str]:
    from halfshaft.models.vehicle import vehicle_names

    return [name for name in vehicle_names() if name.startswith(incomplete)]


def _cycles(incomplete: str) -> list[str]:
    from halfshaft.cosim.cycle import cycle_names

    return [name for name in cycle_names() if name.startswith(incomplete)]


VehicleName = Annotated[
    str, typer.Argument(metavar="VEHICLE", help="Name in the library, or a TOML file.", show_default=False, autocompletion=_vehicles)
]
GradeFile = Annotated[str | None, typer.Option("--grade", metavar="CSV", help="Grade of the road over distance, with --cycle.")]
Smooth = Annotated[float | None, typer.Option(metavar="S", help="Smooth the trace of a recorder over windows of so many seconds.")]
Mass = Annotated[float | None, typer.Option(metavar="KG", help="Mass of the vehicle, body.m.")]
Values = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help='A number with unit, motor.J="0.05 kg m^2", or in SI; repeatable.'),
]
Soc = Annotated[float | None, typer.Option(metavar="X", help="State of charge at the start, 0 to 1.")]
Shown = Annotated[Units, typer.Option("--units", help="What to show: km and L/100 km, or miles, mph and mpg.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]


@app.command(
    "run",
    help="""Run a vehicle over a cycle.

    \b
    Examples:
      halfshaft run small-car-series --cycle us06
      halfshaft run small-car-electric --cycle udds --soc 0.9 --plot udds.png
      halfshaft run small-car-electric --cycle udds --mass 1500 --units us
      halfshaft run my-car.toml --cycle trip.csv --grade road.csv --out trip.nc
      halfshaft run my-car.toml --cycle us06 --set engine.J="0.2 kg m^2" --json
    """,
)
def _run(
    vehicle: VehicleName,
    cycle: Annotated[
        str, typer.Option(metavar="CYCLE", help="Name in the library, or a CSV file.", show_default=False, autocompletion=_cycles)
    ],
    via: Annotated[Via, typer.Option(help="The compiled step, an FMU of it through FMPy, or the forward-facing model.")] = "step",
    mode: Annotated[Mode, typer.Option(help="The paper's method; solved for the best end speed; the paper's benchmark.")] = "hybrid",
    dt: Annotated[float, typer.Option(metavar="S", help="Length of the step [s].")] = 1.0,
    grade: GradeFile = None,
    smooth: Smooth = None,
    mass: Mass = None,
    values: Values = None,
    soc: Soc = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE.nc", help="Write all time series to a netCDF file.")] = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE.png", help="Draw the run (.png, .svg, .pdf).")] = None,
    units: Shown = "metric",
    as_json: Json = False,
) -> None:
    from halfshaft.cosim.cycle import Cycle
    from halfshaft.cosim.simulate import run

    checks = _Checks()
    car = checks.vehicle(vehicle, mass, values, soc)
    trace = checks.take(lambda: Cycle.load(cycle, grade) if smooth is None else Cycle.load(cycle, grade).smoothed(smooth))
    checks.step(dt, trace)
    if mode != "hybrid" and via != "step":
        checks.problem(f"mode {mode} runs via step only, not via {via}")
    if via in ("fmu2", "fmu3") and trace is not None and checks.step_fits:
        from halfshaft.cosim.fmu import fmu_problems

        checks.problem(*fmu_problems(3, trace, dt))
    checks.target(out, "--out")
    checks.target(plot, "--plot")
    if plot is not None:
        from halfshaft.cosim.plot import plot_problems  # matplotlib takes a quarter of a second

        checks.problem(*(f"--plot {plot}: {p}" for p in plot_problems(plot)))
    car, trace = checks.done(car), checks.done(trace)
    with busy(f"{VIA[via]}: {car.name} over {trace.name}"):
        result = run(car, trace, via=via, dt=dt, mode=mode)
    if out is not None:
        with busy(f"writing {out}"):
            result.save(out)
    if plot is not None:
        from halfshaft.cosim.plot import plot_run

        with busy(f"drawing {plot}"):
            plot_run(result, path=plot)
    if as_json:
        print_run_json(result)
        return
    print_run(result, units)
    print_written(out, plot)


@app.command(
    "accelerate",
    help="""Accelerate from rest as fast as the vehicle can.

    \b
    Examples:
      halfshaft accelerate small-car-electric --units us
      halfshaft accelerate paper-series-1936 --to 96.6 --compare
      halfshaft accelerate small-car-conventional --mass 1600 --json
    """,
)
def _accelerate(
    vehicle: VehicleName,
    to: Annotated[
        float | None, typer.Option(metavar="SPEED", help="Speed to reach: km/h, 100 unless given; with --units us mph, 60.")
    ] = None,
    mode: Annotated[Mode | None, typer.Option(help="How each step is solved; refined where there is a compiler.")] = None,
    mass: Mass = None,
    values: Values = None,
    compare: Annotated[bool, typer.Option("--compare", help="Also by iteration, refined, and with the forward-facing model.")] = False,
    units: Shown = "metric",
    as_json: Json = False,
) -> None:
    from halfshaft.cosim.acceleration import REQUEST, accelerate

    checks = _Checks()
    found = checks.vehicle(vehicle, mass, values, None)
    speed = SYSTEMS[units]["speed"]
    wanted = (100.0 if units == "metric" else 60.0) if to is None else to
    highest = speed.of(REQUEST)
    if not 0 < wanted < highest:
        checks.problem(f"--to {wanted:g} {speed.name}, must be > 0 and < {highest:.0f} {speed.name}")
    car, v = checks.done(found), wanted / speed.of(1.0)
    runs: dict[str, Acceleration] = {}

    def go(title: str, mode: Mode | None, via: Via) -> Acceleration:
        with busy(f"{title}: full acceleration of {car.name}"):
            return accelerate(car, to=v, mode=mode, via=via)

    best = go(mode or "best effort", mode, "step")
    runs[best.result.inputs.mode] = best
    for title in COMPARED if compare else ("hybrid",):
        if title not in runs:
            runs[title] = go(title, None, "forward") if title == "forward" else go(title, title, "step")
    if as_json:
        print_json({"time_s": best.time, "mode": best.result.inputs.mode} | {f"{title}_s": runs[title].time for title in sorted(runs)})
    else:
        print_acceleration(car, v, runs, units)


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
def _fmu(
    vehicle: VehicleName,
    fmi: Annotated[Literal["2", "3"], typer.Option(help="Version of the standard.", show_default=False)],
    output: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="The FMU to write.", show_default=False)],
    cycle: Annotated[str | None, typer.Option(metavar="CYCLE", help="Name in the library, or a CSV file.", autocompletion=_cycles)] = None,
    dt: Annotated[float, typer.Option(metavar="S", help="Length of the internal steps [s].")] = 1.0,
    grade: GradeFile = None,
    mass: Mass = None,
    values: Values = None,
    soc: Soc = None,
) -> None:
    from halfshaft.cosim.cycle import Cycle
    from halfshaft.cosim.fmu import build_fmu, fmu_problems

    version: Literal[2, 3] = 2 if fmi == "2" else 3
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
    with busy(f"building {output}"):
        path = build_fmu(car, output, fmi=version, cycle=trace, dt=dt)
    what = f"drives {trace.name}" if trace else "driven by requested speed, grade and key"
    print_line(f"{path}: FMI {fmi}.0, {path.stat().st_size / 1024:.0f} KiB, {what}")


@app.command(
    "reproduce",
    help="""Reproduce the tables and figures of the paper.

    \b
    Examples:
      halfshaft reproduce
      halfshaft reproduce --out build/reproduce
    """,
)
def _reproduce(
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Write figures, tables and a report to this folder.")] = None,
    as_json: Json = False,
) -> None:
    from halfshaft.validation.report import print_report
    from halfshaft.validation.reproduce import reproduce

    checks = _Checks()
    checks.folder(out, "--out")
    checks.raise_problems()
    with busy("reproducing the paper") as progress:
        found = reproduce(out, progress)
    if as_json:
        print_json(found)
        return
    print_report(found)
    print_written(out)


@app.command(
    "bench",
    help="""Time the step, and compare it with FASTSim where that is installed.

    \b
    Examples:
      halfshaft bench
      halfshaft bench --json
    """,
)
def _bench(as_json: Json = False) -> None:
    from halfshaft.validation.bench import bench

    with busy("timing") as progress:
        found = bench(progress)
    if as_json:
        print_json(found)
    else:
        print_bench(found["rows"])


@app.command(
    "list",
    help="""List what the library has.

    \b
    Examples:
      halfshaft list vehicles
      halfshaft list components --kind motor
    """,
)
def _list(
    what: Annotated[Shelf, typer.Argument(show_default=False)],
    kind: Annotated[str | None, typer.Option(metavar="KIND", help="Only components of this kind.")] = None,
) -> None:
    from halfshaft.cosim.cli_show import print_list

    if kind is not None and what != "components":
        raise HalfshaftError(f"--kind {kind}: goes with components, not with {what}")
    print_list(what, kind)


@app.command(
    "show",
    help="""Show a vehicle, a component or a cycle with all its numbers.

    \b
    Examples:
      halfshaft show small-car-series
      halfshaft show si-41kw
      halfshaft show us06
      halfshaft show si-41kw --plot map.png
      halfshaft show small-car-series --toml > my-car.toml
    """,
)
def _show(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name in the library, or a file.", show_default=False)],
    toml: Annotated[bool, typer.Option("--toml", help="Print it as a file to edit.")] = False,
    plot: Annotated[Path | None, typer.Option(metavar="FILE.png", help="Draw the maps of a component (.png, .svg, .pdf).")] = None,
) -> None:
    from halfshaft.cosim.cli_show import draw, print_named, print_toml

    checks = _Checks()
    checks.target(plot, "--plot")
    checks.raise_problems()
    if plot is not None:
        draw(name, plot)
    if toml:
        print_toml(name)
        return
    print_named(name)
    print_written(plot)


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
        from halfshaft.models.vehicle import Vehicle

        car = self.take(lambda: Vehicle.load(name))
        given: list[tuple[str, float | str]] = [] if mass is None or car is None else [(car.tags.the("vehicle mass"), mass)]
        for text in values or ():
            key, sign, value = text.partition("=")
            if not (key.strip() and sign and value.strip()):
                self.problem(f"--set {text}: must be NAME=VALUE, such as body.m=1500 or motor.J='0.05 kg m^2'")
                continue
            given.append((key.strip(), _number_or_text(value.strip())))
        if soc is not None:
            stores = [] if car is None else car.tags.all_of("start charge")
            if car is not None and not stores:
                self.problem(f"--soc {soc:g}: vehicle '{car.name}' has no battery")
            given += [(name, soc) for name in stores]
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
        if path is not None and (problem := target_problem(path)):
            self.problem(f"{option} {path}: {problem}")

    def folder(self, path: Path | None, option: str) -> None:
        """Note a folder that cannot be made or written to."""
        if path is None:
            return
        try:
            there = next(p for p in (path.absolute(), *path.absolute().parents) if p.exists())
        except OSError as error:
            self.problem(f"{option} {path}: cannot be written: {error.strerror}")
            return
        if not there.is_dir():
            self.problem(f"{option} {path}: {there} is a file, must be a folder")
        elif not os.access(there, os.W_OK | os.X_OK):
            self.problem(f"{option} {path}: the folder {there} cannot be written to")

    def done(self, value: T | None) -> T:
        """Return what was loaded, or raise one error with everything that is wrong."""
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


if __name__ == "__main__":
    app()
