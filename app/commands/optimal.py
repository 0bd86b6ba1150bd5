"""The best that a hybrid can do on a cycle that is known."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer
from rich.markup import escape

from halfshaft.app.options import Checks, CycleName, GradeFile, Json, Mass, Shown, Soc, Values, VehicleName
from halfshaft.app.output import busy, console, new_table, print_json, print_line, print_written
from halfshaft.app.program import app
from halfshaft.cosim.units import SYSTEMS, Units

if TYPE_CHECKING:
    from halfshaft.studies.optimal import Optimum
    from halfshaft.studies.optimal.optimum import Charge


@app.command(
    "optimal",
    help="""Hold a hybrid's control against the least fuel that a cycle takes.

    Dynamic programming and ECMS look for the best times to run the engine or
    fuel cell, the best power, and the best gears, on the vehicle's own step.
    All start and end with the same charge.

    \b
    Examples:
      halfshaft optimal small-car-series --cycle udds
      halfshaft optimal small-car-parallel --cycle udds --keep shift
      halfshaft optimal small-car-fuel-cell --cycle us06 --plot best.png
      halfshaft optimal small-car-plug-in-series --cycle us06 --soc 0.3 --json
    """,
)
def _optimal(
    vehicle: VehicleName,
    cycle: CycleName,
    grade: GradeFile = None,
    charge: Annotated[
        str | None,
        typer.Option(metavar="HOW", help="kept, as far as the control can; used, as it does, of a plug-in hybrid or with --soc."),
    ] = None,
    keep: Annotated[
        list[str] | None, typer.Option(metavar="PART", help="What keeps its own law: shift leaves the gears alone; repeatable.")
    ] = None,
    window: Annotated[str | None, typer.Option(metavar="A..B", help="Charge that is not left on the way, 0.4..0.8.")] = None,
    places: Annotated[int, typer.Option(metavar="N", help="Charges that are told apart.")] = 100,
    points: Annotated[int, typer.Option(metavar="N", help="Values that are tried of a power or torque.")] = 21,
    dt: Annotated[float, typer.Option(metavar="S", help="Length of the step [s].")] = 1.0,
    mass: Mass = None,
    soc: Soc = None,
    values: Values = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE.png", help="Draw power split, charge and fuel (.png, .svg, .pdf).")] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", metavar="FILE.nc", help="Save the best run.")] = None,
    units: Shown = "metric",
    as_json: Json = False,
) -> None:
    from halfshaft.cosim.cycle import Cycle
    from halfshaft.studies.optimal import optimal

    checks = Checks()
    found = checks.vehicle(vehicle, mass, values, soc)
    trace = checks.take(lambda: Cycle.load(cycle, grade))
    checks.step(dt, trace)
    checks.picture(plot, "--plot")
    checks.target(out, "--out")
    between = None if window is None else _window(window, checks)
    # A charge that is typed is where all begin.
    charge = charge or (None if soc is None else "used")
    car, driven = checks.done(found), checks.done(trace)
    with busy(f"optimal: {car.name}"):
        # What is not allowed is found by the study, with all else that is wrong.
        both = optimal(
            car, driven, charge=cast("Charge | None", charge), keep=keep or (), window=between, places=places, points=points, dt=dt
        )
    if plot is not None:
        both.plot(units=units, path=plot)
    if out is not None:
        both.best.result.save(out)
    if as_json:
        print_json(_json(both))
        return
    _print(both, units)
    print_written(plot, out)


def _window(text: str, checks: Checks) -> tuple[float, float] | None:
    """Return the ends of a window."""
    low, _, high = text.partition("..")
    try:
        return float(low), float(high)
    except ValueError:
        checks.problem(f"--window {text}: must be like 0.4..0.8")
        return None


def _json(optimum: Optimum) -> dict[str, object]:
    return {
        "vehicle": optimum.vehicle.name,
        "cycle": optimum.cycle.name,
        "ways": optimum.figures(),
        "equivalence_factor": optimum.price,
        "passes": [p._asdict() for p in optimum.passes],
        "commands": {name: row.tolist() for name, row in optimum.best.commands.items()},
        "notes": optimum.notes,
    }


def _print(optimum: Optimum, units: Units) -> None:
    """Print the three ways beside each other."""
    out = console()
    how = f"{optimum.cycle.name}, a store's energy is worth {optimum.price:.2f} of fuel"
    out.print(f"[bold]{escape(optimum.vehicle.name)}[/]  [dim]{escape(how)}[/]", highlight=False, soft_wrap=True)
    table = new_table()
    headings = ("way", f"fuel [{SYSTEMS[units]['economy'].name}]", "over best [%]", "charge [%]", "to [%]", "source on [%]", "starts")
    for i, heading in enumerate(headings):
        table.add_column(escape(heading), justify="right" if i else "left")
    for row in optimum.rows(units):
        table.add_row(*map(escape, row))
    out.print(table)
    for note in optimum.notes:
        print_line(f"  ! {note}", "yellow")
