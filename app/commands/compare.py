"""Several vehicles or saved runs beside each other."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

from halfshaft.app.options import Checks, CycleNameOrNone, GradeFile, Json, Shown
from halfshaft.app.output import busy, console, new_table, print_json, print_line, print_written
from halfshaft.app.program import app
from halfshaft.cosim.ways import Mode
from halfshaft.library.base.errors import HalfshaftError

if TYPE_CHECKING:
    from halfshaft.cosim.result import Result
    from halfshaft.models.vehicle import Vehicle


@app.command(
    "compare",
    help="""Put vehicles, or runs that were saved, beside each other.

    A vehicle is a name or a TOML file, and may have numbers set behind it:
    NAME@body.m=1500@motor.torque_scale=1.2. A saved run is a file of
    "halfshaft run --out".

    \b
    Examples:
      halfshaft compare small-car-electric small-car-series --cycle us06
      halfshaft compare my-car.toml my-car.toml@body.m=1500 --cycle udds
      halfshaft compare a.nc b.nc --plot both.png --output battery.T
      halfshaft compare before.nc after.nc --bars bars.png --json
    """,
)
def _compare(
    things: Annotated[list[str], typer.Argument(metavar="A B...", help="Vehicles, or .nc files of runs.", show_default=False)],
    cycle: CycleNameOrNone = None,
    grade: GradeFile = None,
    mode: Annotated[Mode, typer.Option(help="How vehicles are run.")] = "hybrid",
    dt: Annotated[float, typer.Option(metavar="S", help="Length of the step of vehicles that are run [s].")] = 1.0,
    output: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="What --plot draws: speed, charge, energy, ... or any output, battery.T; repeatable."),
    ] = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE.png", help="Draw the runs over each other (.png, .svg, .pdf).")] = None,
    bars: Annotated[Path | None, typer.Option(metavar="FILE.png", help="Draw the main numbers as bars.")] = None,
    points: Annotated[Path | None, typer.Option(metavar="FILE.png", help="Draw the operating points of machines on their maps.")] = None,
    flows: Annotated[Path | None, typer.Option(metavar="FILE.png", help="Draw where the energy of each flowed.")] = None,
    csv: Annotated[Path | None, typer.Option(metavar="FILE.csv", help="Write the main numbers to a CSV file.")] = None,
    units: Shown = "metric",
    as_json: Json = False,
) -> None:
    from halfshaft.cosim.cycle import Cycle
    from halfshaft.studies.compare import compare

    checks = Checks()
    found = [checks.take(partial(_thing, text)) for text in things]
    trace = None if cycle is None else checks.take(lambda: Cycle.load(cycle, grade))
    vehicles = [text for text in things if not text.lower().endswith(".nc")]
    if len(things) < 2:
        checks.problem(f"{len(things)} to compare, must be at least 2")
    if vehicles and cycle is None:
        checks.problem(f"--cycle is missing: {vehicles[0]} is a vehicle, which must be run")
    if grade is not None and cycle is None:
        checks.problem("--grade goes with --cycle")
    if output and plot is None:
        checks.problem("--output goes with --plot")
    checks.step(dt, trace)
    for option, picture in (("--plot", plot), ("--bars", bars), ("--points", points), ("--flows", flows)):
        checks.picture(picture, option)
    checks.target(csv, "--csv")
    checks.raise_problems()
    with busy("running"):
        both = compare(*(x for x in found if x is not None), cycle=trace, mode=mode, dt=dt)
    if plot is not None:
        both.plot(output or None, units=units, path=plot)
    if bars is not None:
        both.plot_metrics(units=units, path=bars)
    if points is not None:
        both.plot_points(units=units, path=points)
    if flows is not None:
        both.plot_flows(path=flows)
    if csv is not None:
        from halfshaft.library.files.writing import written_whole

        with written_whole(csv) as part:
            both.to_pandas(units).to_csv(part)
    if as_json:
        differing = {row.name: {"unit": row.unit, "values": row.values} for row in both.differences(all_parameters=True)}
        print_json({"labels": both.labels, "differences": differing, "summaries": [r.summary for r in both.results]})
        return
    from halfshaft.cosim.remarks import remarks

    for title, rows in zip(("What differs", "What came of it"), both.tables(units), strict=True):
        print_line(title, "bold")
        _print_table(both.labels, rows)
    for label, result in zip(both.labels, both.results, strict=True):
        for text in remarks(result, units):
            print_line(f"  ! {label}: {text}", "yellow")
    print_written(plot, bars, points, flows, csv)


def _thing(text: str) -> Vehicle | Result:
    """Return what an argument names."""
    from halfshaft.app.options import number_or_text
    from halfshaft.cosim.result import Result
    from halfshaft.models.vehicle import Vehicle

    # A name of a file may have the sign too.
    name, *given = re.split(r"@(?=[\w.]+\s*=)", text)
    if name.lower().endswith(".nc"):
        if given:
            raise HalfshaftError(f"{text}: no numbers can be set in a run that was made")
        return Result.load(name)
    pairs = [(key.strip(), sign, value.strip()) for key, sign, value in (part.partition("=") for part in given)]
    if not all(key and sign and value for key, sign, value in pairs):
        raise HalfshaftError(f"{text}: must be NAME or NAME@body.m=1500, a number or one with its unit")
    return Vehicle.load(name).with_values({key: number_or_text(value) for key, _, value in pairs})


def _print_table(labels: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    if not rows:
        print_line("  nothing", "dim")
        return
    grid = new_table()
    for i, heading in enumerate(("", *labels)):
        grid.add_column(escape(heading), justify="right" if i else "left", overflow="fold")
    for row in rows:
        grid.add_row(*map(escape, row))
    console().print(grid)
