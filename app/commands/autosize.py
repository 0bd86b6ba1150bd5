"""The smallest parts with which a vehicle does what it must."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape

from halfshaft.app.options import Checks, Json, Mass, Values, VehicleName
from halfshaft.app.output import busy, console, new_table, print_json, print_line, print_written
from halfshaft.app.program import app

if TYPE_CHECKING:
    from halfshaft.studies.autosize import Sized

#: What an option says to leave a goal out.
NONE = "none"
_LIMIT = re.compile(r"(\w+) *= *([\d.]+) *\.\. *([\d.]+) *(kW)?")


@app.command(
    "autosize",
    help="""Find the smallest engine, battery and motors with which a vehicle does what it must.

    Whatever the powertrain: its source (engine or fuel cell), store (battery) and drive (motors) are made as small as a grade, full
    acceleration and top speed allow; the mass follows.

    \b
    Examples:
      halfshaft autosize small-car-series
      halfshaft autosize small-car-parallel --hybridisation 0.8 --plot sizes.png
      halfshaft autosize small-car-electric --accel 0-100km/h=9 --grade none --out quick.toml
      halfshaft autosize small-car-conventional --preset 1999 --json
    """,
)
def _autosize(
    vehicle: VehicleName,
    accel: Annotated[
        list[str] | None,
        typer.Option(metavar="V-V=S", help="Time [s] between speeds, 0-60mph=12; repeatable; none. In place of 12, 5.3, 23.4 s."),
    ] = None,
    grade: Annotated[
        list[str] | None, typer.Option(metavar="G@V", help="Grade to hold at a speed, 6%@55mph unless given; repeatable; none.")
    ] = None,
    top_speed: Annotated[str, typer.Option(metavar="V", help="Speed to reach; none.")] = "90mph",
    preset: Annotated[
        str, typer.Option(metavar="NAME", help="exact, or 1999: procedure, limits and tolerances of the original.")
    ] = "exact",
    hybridisation: Annotated[
        float | None, typer.Option(metavar="H", help="Of a parallel hybrid, from 0 (large engine) to 1 (large motor).")
    ] = None,
    size: Annotated[
        list[str] | None, typer.Option(metavar="KIND", help="What may change: source, store, drive; all unless given; repeatable.")
    ] = None,
    limit: Annotated[
        list[str] | None, typer.Option(metavar="KIND=A..B", help="Limits of a size: source=20..80kW or store=10..40 modules; repeatable.")
    ] = None,
    ratio: Annotated[bool, typer.Option("--ratio", help="Also choose the ratio of the final drive.")] = False,
    mass: Mass = None,
    values: Values = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", metavar="FILE", help="Write the vehicle to this TOML file.")] = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE", help="Draw how it went: .png, .svg or .pdf.")] = None,
    trials: Annotated[bool, typer.Option("--trials", help="Show every vehicle that was tried.")] = False,
    as_json: Json = False,
) -> None:
    from halfshaft.studies.autosize import Autosize

    checks = Checks()
    found = checks.vehicle(vehicle, mass, values, None)
    checks.target(out, "--out")
    if out is not None and out.suffix != ".toml":
        checks.problem(f"--out {out}: must end in .toml")
    checks.picture(plot, "--plot")
    limits = _limits(limit or [], checks)
    # What is not allowed is found by the task, with all else that is wrong.
    given: dict[str, Any] = {"preset": preset, "sizes": tuple(size or ()), "limits": limits, "ratio": ratio}
    given |= {name: _goals(texts) for name, texts in (("accelerations", accel), ("grades", grade)) if texts}
    task = Autosize(top_speed=None if top_speed == NONE else top_speed, hybridisation=hybridisation, **given)
    checks.problem(*task.problems(), *(task.misfits(found) if found is not None else ()))
    car = checks.done(found)
    with busy(f"autosize: {car.name}"):
        sized = task(car)
    if out is not None:
        sized.vehicle.save(out)
    if plot is not None:
        sized.plot(plot)
    if as_json:
        print_json(_json(sized))
        return
    _print(sized, trials=trials)
    print_written(out, plot)


def _goals(texts: list[str]) -> tuple[str, ...]:
    return () if texts == [NONE] else tuple(texts)


def _limits(texts: list[str], checks: Checks) -> dict[str, tuple[float, float]]:
    """Return limits by kind, in W where they are in kW."""
    limits = {}
    for text in texts:
        if not (found := _LIMIT.fullmatch(text.strip())):
            checks.problem(f"--limit {text}: must be like source=20..80kW or store=10..40")
            continue
        factor = 1e3 if found[4] else 1.0
        limits[found[1]] = float(found[2]) * factor, float(found[3]) * factor
        if (found[1] == "store") == bool(found[4]):
            checks.problem(f"--limit {text}: a store is limited by its number of modules, source and drive in kW")
    return limits


def _json(sized: Sized) -> dict[str, object]:
    return {
        "vehicle": sized.base.name,
        "status": sized.status,
        "preset": sized.preset,
        "sizes": {kind: {"before": sized.before[kind], "after": x, "binds": sized.binds[kind]} for kind, x in sized.after.items()},
        "values": {name: sized.vehicle.values[name] for name in sized.changed},
        "mass_kg": {"before": sized.base.mass, "after": sized.vehicle.mass},
        "goals": [
            {
                "goal": r.goal.title, "sense": r.goal.sense, "target": r.goal.target, "tolerance": r.goal.tolerance, "before": r.before,
                "after": r.after, "margin": r.margin, "met": r.met,
            }
            for r in sized.goals
        ],
        "notes": sized.notes,
        "trials": [
            {"aim": t.aim, "sizes": t.sizes, "mass_kg": t.mass, "values": t.values, "margins": t.margins} for t in sized.trials
        ],
    }  # fmt: skip


def _print(sized: Sized, *, trials: bool) -> None:
    """Print sizes, goals, what binds and, if wanted, all trials."""
    out = console()
    how = f"preset {sized.preset}, {len(sized.trials)} vehicles tried"
    out.print(f"[bold]{escape(sized.base.name)}[/]  [dim]{how}[/]", highlight=False, soft_wrap=True)
    table = new_table()
    for i, heading in enumerate(("size", "", "before", "after", "what binds")):
        table.add_column(heading, justify="right" if i in (2, 3) else "left")
    for row in sized.size_rows():
        table.add_row(*map(escape, row))
    out.print(table)
    table = new_table()
    for i, heading in enumerate(("goal", "target", "before", "after", "better by [%]", "")):
        table.add_column(escape(heading), justify="right" if 0 < i < 5 else "left")
    for row, reached in zip(sized.goal_rows(), sized.goals, strict=True):
        table.add_row(*map(escape, row), style=None if reached.met else "yellow")
    out.print(table)
    if trials:
        out.print(_trial_table(sized))
    for note in sized.notes:
        print_line(f"  ! {note}", "yellow")


def _trial_table(sized: Sized) -> object:
    from halfshaft.studies.sizes import NAMED

    table = new_table()
    table.add_column("sized")
    for kind in sized.after:
        table.add_column(escape(f"{kind} [{NAMED[kind][1]}]"), justify="right")
    table.add_column(escape("mass [kg]"), justify="right")
    for reached in sized.goals:
        table.add_column(escape(reached.goal.title), justify="right")
    for trial in sized.trials:
        sizes = (f"{x / NAMED[kind][2]:.{NAMED[kind][3]}f}" for kind, x in trial.sizes.items())
        reached_by = (r.goal.shown(trial.values[r.goal.title]) if r.goal.title in trial.values else "" for r in sized.goals)
        table.add_row(escape(trial.aim.partition(" for ")[0]), *sizes, f"{trial.mass:.0f}", *reached_by)
    return table
