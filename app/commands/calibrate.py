"""Numbers of a vehicle from what was measured on drives."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape

from halfshaft.app.options import Checks, Json, Mass, Soc, Values
from halfshaft.app.output import busy, console, new_table, print_json, print_line, print_written
from halfshaft.app.program import app
from halfshaft.cosim.ways import Mode

if TYPE_CHECKING:
    from halfshaft.studies.calibration.calibrate import Calibration
    from halfshaft.studies.calibration.record import Reading


@app.command(
    "calibrate",
    help="""Fit numbers of a vehicle to what was measured on drives.

    A drive is a CSV file with the columns of a cycle, time_s and speed_kmh, and columns called like outputs with their units,
    such as battery.P_out [kW]; halfshaft run --csv shows which outputs there are.

    \b
    Examples:
      halfshaft calibrate small-car-electric drive.csv --fit body.c_d=0.2..0.5 --fit wheel.f_0=0.004..0.02
      halfshaft calibrate small-car-electric drive.csv --fit body.c_d=0.2..0.5 --series "battery.P_out=HV power [kW]" --plot fit.png
      halfshaft calibrate car.toml monday.csv friday.csv --fit body.m="1000..1600 kg" --sigma engine.fuel_flow="0.02 g/s" --out mine.toml
      halfshaft calibrate problem.toml --json
    """,
)
def _calibrate(
    given: Annotated[
        list[str],
        typer.Argument(
            metavar="VEHICLE RUN.csv... | PROBLEM.toml", help="A vehicle and drives, or a file with it all.", show_default=False
        ),
    ],
    fit: Annotated[list[str] | None, typer.Option(metavar="NAME=A..B", help="A number to fit and its range; repeatable.")] = None,
    series: Annotated[
        list[str] | None,
        typer.Option(metavar="OUTPUT=COLUMN", help="An output and its column; all that are called like outputs; repeatable."),
    ] = None,
    sigma: Annotated[
        list[str] | None,
        typer.Option(metavar="OUTPUT=X", help="Standard uncertainty, '0.5 kW + 2 %'; else the residuals tell; repeatable."),
    ] = None,
    how: Annotated[
        list[str] | None, typer.Option(metavar="OUTPUT=HOW", help="How it was read: instant, mean, counted; repeatable.")
    ] = None,
    offset: Annotated[
        list[str] | None, typer.Option(metavar="OUTPUT=S", help="Added to its times [s], below 0 if late; repeatable.")
    ] = None,
    cycle: Annotated[str | None, typer.Option(metavar="CYCLE", help="The trace of all drives, if not their own.")] = None,
    loss: Annotated[str | None, typer.Option(help="How residuals count: linear, soft_l1, huber, cauchy.")] = None,
    starts: Annotated[int | None, typer.Option(metavar="N", help="Places of the ranges tried before the fit; 16 unless given.")] = None,
    mode: Annotated[Mode | None, typer.Option(help="How each step is solved; hybrid unless given.")] = None,
    dt: Annotated[float | None, typer.Option(metavar="S", help="Length of the step [s]; 1 unless given.")] = None,
    mass: Mass = None,
    values: Values = None,
    soc: Soc = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", metavar="FILE", help="Write the vehicle to this TOML file.")] = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE", help="Draw measured and fitted: .png, .svg or .pdf.")] = None,
    as_json: Json = False,
) -> None:
    from halfshaft.cosim.cycle import Cycle
    from halfshaft.studies.calibration.calibrate import calibrate
    from halfshaft.studies.calibration.problem import Problem
    from halfshaft.studies.calibration.record import Record

    checks = Checks()
    checks.target(out, "--out")
    if out is not None and out.suffix != ".toml":
        checks.problem(f"--out {out}: must end in .toml")
    checks.picture(plot, "--plot")
    of_drives: dict[str, Any] = {"--fit": fit, "--series": series, "--sigma": sigma, "--how": how, "--offset": offset, "--cycle": cycle}
    of_drives |= {"--loss": loss, "--starts": starts, "--mode": mode, "--dt": dt, "--mass": mass, "--set": values, "--soc": soc}
    if len(given) == 1 and not given[0].endswith(".toml"):
        checks.problem(f"{given[0]} alone: name a vehicle and at least one drive, such as drive.csv, or a problem.toml")
        checks.raise_problems()
    if len(given) == 1:
        checks.problem(*(f"{option} does not go with a problem, which says it itself" for option, x in of_drives.items() if x is not None))
        problem = checks.done(checks.take(partial(Problem.load, given[0])))
        with busy(f"calibrate: {problem.name}"):
            found = problem.solve()
    else:
        car = checks.vehicle(given[0], mass, values, soc)
        ranges = _pairs(fit, "--fit", "body.c_d=0.2..0.5", checks)
        readings = _readings(series, sigma, how, offset, checks)
        trace = None if cycle is None else checks.take(partial(Cycle.load, cycle))

        # How a series was read does not choose the series.
        def load(path: str) -> Record:
            return Record.load(path, readings if series else None, cycle=trace).read(readings)

        records = [checks.take(partial(load, path)) for path in given[1:]]
        checks.raise_problems()
        vehicle = checks.done(car)
        with busy(f"calibrate: {vehicle.name}"):
            options: dict[str, Any] = {"loss": loss, "starts": starts, "mode": mode, "dt": dt}
            said = {name: x for name, x in options.items() if x is not None}
            found = calibrate(vehicle, [r for r in records if r is not None], ranges, **said)
    if out is not None:
        found.vehicle.save(out)
    if plot is not None:
        found.plot(plot)
    if as_json:
        print_json(_json(found))
        return
    _print(found)
    print_written(out, plot)


def _pairs(texts: list[str] | None, option: str, example: str, checks: Checks) -> dict[str, str]:
    """Return what repeated options say of names."""
    found: dict[str, str] = {}
    for text in texts or ():
        name, sign, value = (part.strip() for part in text.partition("="))
        if not (name and sign and value):
            checks.problem(f"{option} {text}: must be like {example}")
        elif name in found:
            checks.problem(f"{option} {name} is given twice")
        else:
            found[name] = value
    return found


def _readings(
    series: list[str] | None, sigma: list[str] | None, how: list[str] | None, offset: list[str] | None, checks: Checks
) -> dict[str, Reading]:
    """Return how outputs were measured; empty if nothing is said."""
    from halfshaft.studies.calibration.record import Reading

    columns = _pairs(series, "--series", "'battery.P_out=HV power [kW]'", checks)
    sigmas = _pairs(sigma, "--sigma", "'battery.P_out=0.5 kW'", checks)
    hows = _pairs(how, "--how", "engine.fuel_used=counted", checks)
    offsets = _pairs(offset, "--offset", "battery.P_out=-0.4", checks)
    found = {}
    for name in dict.fromkeys((*columns, *sigmas, *hows, *offsets)):
        late = offsets.get(name, "0").removesuffix("s").strip()
        try:
            found[name] = Reading(columns.get(name, ""), sigmas.get(name), hows.get(name), float(late))  # type: ignore[arg-type]
        except ValueError:
            checks.problem(f"--offset {name}={late}: must be a number [s]")
    return found


def _json(found: Calibration) -> dict[str, object]:
    f = found.fit
    return {
        "vehicle": found.base.name,
        "drives": [record.name for record in found.records],
        "found": {
            u.name: {"unit": u.unit, "before": u.start, "value": x, "std": s, "low": low, "high": high, "bound": bound}
            for u, x, s, (low, high), bound in zip(f.unknowns, f.x, f.std, f.intervals, f.at_bound, strict=True)
        },
        "correlation": f.correlation,
        "series": [m._asdict() for m in found.matched],
        "loss": f.loss,
        "converged": f.converged,
        "evaluations": f.evaluations,
        "notes": list(found.notes),
    }


def _print(found: Calibration) -> None:
    from halfshaft.studies.calibration.calibrate import FOUND, MATCHED

    out = console()
    how = f"{', '.join(record.name for record in found.records)}; {found.fit.evaluations} evaluations"
    out.print(f"[bold]{escape(found.base.name)}[/]  [dim]{escape(how)}[/]", highlight=False, soft_wrap=True)
    for headings, rows, left in ((FOUND, found.rows(), (0, 4)), (MATCHED, found.series_rows(), (0, 3, 6))):
        table = new_table()
        for i, heading in enumerate(headings):
            table.add_column(heading, justify="left" if i in left else "right")
        for row in rows:
            table.add_row(*map(escape, row))
        out.print(table)
    names = [u.name for u in found.fit.unknowns]
    for i, row in enumerate(found.fit.correlation):
        for j in (j for j in range(i) if row[j] == row[j]):
            print_line(f"  correlation of {names[j]} and {names[i]}: {row[j]:.2f}", "dim")
    for note in found.notes:
        print_line(f"  ! {note}", "yellow")
