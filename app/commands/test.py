"""Tests of a vehicle: acceleration, gradeability, top speed, a cycle at a charge that is kept, test procedures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from halfshaft.app.options import Checks, Gradient, Json, Mass, Shown, Values, VehicleName, number_or_text
from halfshaft.app.output import busy, console, gradient_table, new_table, print_json, print_line
from halfshaft.app.program import app
from halfshaft.cosim.units import SYSTEMS, Units
from halfshaft.cosim.ways import Mode

if TYPE_CHECKING:
    from halfshaft.studies.task import Outcome, Task

EFFORT = ("acceleration", "gradeability", "top-speed")
#: Which options belong to which tests; all others are for all.
OWN: Mapping[str, tuple[str, ...]] = {
    "--routine": ("acceleration", "gradeability"),
    "--from-to": ("acceleration",),
    "--speed": ("gradeability",),
    "--grade": ("gradeability",),
    "--gear": ("gradeability",),
    "--duration": ("acceleration", "gradeability"),
    "--soc": EFFORT,
    "--add-mass": EFFORT,
    "--without": EFFORT,
    "--correction": ("a cycle",),
}


def _tests(incomplete: str) -> list[str]:
    from halfshaft.cosim.cycle import cycle_names
    from halfshaft.studies.procedure_file import procedure_names

    return [name for name in (*EFFORT, *procedure_names(), *cycle_names()) if name.startswith(incomplete)]


TestName = Annotated[
    str,
    typer.Argument(
        metavar="TEST",
        help="acceleration, gradeability, top-speed; a procedure of the library (ftp, city-highway, nedc, wltp, j1711, electric-range) or "
        "a TOML file; or a cycle, which a hybrid drives at a charge that is kept.",
        show_default=False,
        autocompletion=_tests,
    ),
]


@app.command(
    "test",
    help="""Test a vehicle.

    \b
    Examples:
      halfshaft test small-car-parallel acceleration --from-to 0-100 --from-to 80-120
      halfshaft test small-car-series gradeability --routine 1999
      halfshaft test small-car-conventional gradeability --speed 90 --grade 6.5 --add-mass 272
      halfshaft test small-car-electric top-speed --units us
      halfshaft test small-car-power-split us06 --correction linear
      halfshaft test small-car-electric acceleration --gradient body.m
      halfshaft test small-car-plug-in-series wltp --json
      halfshaft test my-car.toml my-procedure.toml
    """,
)
def _test(
    vehicle: VehicleName,
    test: TestName,
    routine: Annotated[Literal["1999", "2000"] | None, typer.Option(help="The routine of ADVISOR; 2000 unless said.")] = None,
    from_to: Annotated[
        list[str] | None,
        typer.Option("--from-to", metavar="A-B", help="Speeds of an acceleration: km/h, or with --units us mph; repeatable."),
    ] = None,
    speed: Annotated[
        float | None, typer.Option(metavar="SPEED", help="Speed to keep on a grade: km/h, or with --units us mph; 55 mph.")
    ] = None,
    grade: Annotated[float | None, typer.Option(metavar="PERCENT", help="Test one grade, in place of a search.")] = None,
    gear: Annotated[int | None, typer.Option(metavar="N", help="Gear to keep on a grade; the best one unless said.")] = None,
    duration: Annotated[float | None, typer.Option(metavar="S", help="How long an acceleration is held, or a grade driven.")] = None,
    soc: Annotated[
        str | None, typer.Option(metavar="X", help="State of charge at the start: 0 to 1, low, middle, high, full or own.")
    ] = None,
    mass: Mass = None,
    add_mass: Annotated[float | None, typer.Option("--add-mass", metavar="KG", help="Load beside the vehicle's mass.")] = None,
    without: Annotated[
        Literal["battery", "converter", "nothing"] | None,
        typer.Option(
            help="Let the batteries of a hybrid rest, or its engine or fuel cell; a grade is climbed without battery unless said."
        ),
    ] = None,
    correction: Annotated[
        Literal["zero-delta", "linear"] | None,
        typer.Option(help="How a hybrid drives a cycle at a charge that is kept; zero-delta unless said."),
    ] = None,
    mode: Annotated[Mode | None, typer.Option(help="How each step is solved; as the test has it unless said.")] = None,
    gradient: Gradient = None,
    values: Values = None,
    units: Shown = "metric",
    as_json: Json = False,
) -> None:
    checks = Checks()
    car = checks.vehicle(vehicle, mass, values, None)
    given = {
        "--routine": routine, "--from-to": from_to or None, "--speed": speed, "--grade": grade, "--gear": gear, "--duration": duration,
        "--soc": soc, "--add-mass": add_mass, "--without": without, "--correction": correction,
    }  # fmt: skip
    kind = test if test in EFFORT else "a procedure" if _is_procedure(test) else "a cycle"
    for option, value in given.items():
        if value is not None and kind not in OWN[option]:
            checks.problem(f"{option} is for {' and '.join(OWN[option])}, not for {kind if kind != test else test}")
    makers: Mapping[str, Callable[..., Task | None]] = {
        "acceleration": _acceleration, "gradeability": _gradeability, "top-speed": _top_speed, "a procedure": _procedure, "a cycle": _cycle,
    }  # fmt: skip
    task = checks.take(lambda: makers[kind](checks, test, given, mode, units))
    checks.numbers(car, gradient, "--gradient")
    car, task = checks.done(car), checks.done(task)
    with busy(f"{test}: {car.name}"):
        found, slopes = task(car), dict[str, Any]()
        if gradient:
            from halfshaft.studies.probes import task_gradient

            slopes = task_gradient(task, car, gradient)
    if as_json:
        print_json({"vehicle": car.name, "test": test, **_plain(found), **({"gradient": slopes} if gradient else {})})
    else:
        _print(car.name, test, found, units)
        if gradient:
            console().print(gradient_table(found.figures, slopes, car.values))


def _is_procedure(test: str) -> bool:
    from halfshaft.studies.procedure_file import procedure_names

    return test in procedure_names() or test.lower().endswith(".toml")


def _conditions(given: Mapping[str, Any]) -> dict[str, Any]:
    soc = given["--soc"]
    resting = {None: None, "nothing": "none"}.get(given["--without"], given["--without"])
    return {"soc": None if soc is None else number_or_text(soc), "added_mass": given["--add-mass"] or 0.0, "resting": resting}


def _some(**options: Any) -> dict[str, Any]:
    """Return the options that were given."""
    return {k: x for k, x in options.items() if x is not None}


def _acceleration(checks: Checks, _: str, given: Mapping[str, Any], mode: Mode | None, units: Units) -> Task | None:
    from halfshaft.studies.acceleration import AccelerationTest

    pairs = None
    if given["--from-to"]:
        found = [_pair(checks, text) for text in given["--from-to"]]
        pairs = tuple(pair for pair in found if pair)
    elif units == "metric":
        pairs = ((0.0, 50.0), (0.0, 100.0), (80.0, 120.0))
    unit: Literal["mph", "km/h"] = "mph" if units == "us" else "km/h"
    own = _some(pairs=pairs, routine=given["--routine"], duration=given["--duration"])
    return _sound(checks, AccelerationTest(**own, unit=unit, mode=mode, **_conditions(given)))


def _pair(checks: Checks, text: str) -> tuple[float, float] | None:
    low, _, high = text.partition("-")
    try:
        return float(low), float(high)
    except ValueError:
        checks.problem(f"--from-to {text}: must be two speeds such as 0-100")
        return None


def _gradeability(checks: Checks, _: str, given: Mapping[str, Any], mode: Mode | None, units: Units) -> Task | None:
    from halfshaft.cosim.cycle import FASTEST
    from halfshaft.studies.gradeability import GradeabilityTest

    unit, speed, grade = SYSTEMS[units]["speed"], given["--speed"], given["--grade"]
    if speed is not None and not 0 < speed / unit.of(1.0) <= FASTEST:
        checks.problem(f"--speed {speed:g} {unit.name}, must be > 0 {unit.name} and <= {unit.of(FASTEST):.0f} {unit.name}")
        speed = None
    if grade is not None and not -100 <= grade <= 100:
        checks.problem(f"--grade {grade:g} %, must be >= -100 % and <= 100 %")
        grade = None
    own = _some(
        speed=None if speed is None else speed / unit.of(1.0),
        grade=None if grade is None else grade / 100,
        gear=given["--gear"],
        duration=given["--duration"],
        routine=given["--routine"],
    )
    return _sound(checks, GradeabilityTest(**own, mode=mode, **_conditions(given)))


def _top_speed(checks: Checks, _: str, given: Mapping[str, Any], mode: Mode | None, __: Units) -> Task | None:
    from halfshaft.studies.acceleration import TopSpeedTest

    return _sound(checks, TopSpeedTest(mode=mode, **_conditions(given)))


def _sound(checks: Checks, task: Any) -> Task | None:
    """Return a task whose options are right, or None and note what is wrong."""
    problems = task.problems()
    checks.problem(*problems)
    return None if problems else task


def _procedure(_: Checks, test: str, __: Mapping[str, Any], mode: Mode | None, ___: Units) -> Task:
    from halfshaft.studies.procedure import Procedure
    from halfshaft.studies.procedure_file import Plan

    return Procedure(Plan.load(test), **_some(mode=mode))


def _cycle(_: Checks, test: str, given: Mapping[str, Any], mode: Mode | None, __: Units) -> Task:
    from halfshaft.cosim.cycle import Cycle, cycle_names
    from halfshaft.library.base.errors import InputError, nearest
    from halfshaft.studies.procedure_file import procedure_names
    from halfshaft.studies.soc_correction import Linear, ZeroDelta

    if not test.lower().endswith(".csv") and test.lower() not in cycle_names():
        known = [*EFFORT, *procedure_names(), *cycle_names()]
        raise InputError(f"test '{test}'", [f"no test, procedure or cycle is called so{nearest(test, known)}"])
    kind = Linear if given["--correction"] == "linear" else ZeroDelta
    return kind(cycle=Cycle.load(test), **_some(mode=mode))


def _plain(found: Outcome) -> dict[str, Any]:
    """Return an outcome as JSON has it."""
    record = getattr(found, "record", None)
    more = {"status": getattr(found, "status", None), "record": record and [vars(trial) for trial in record]}
    trials = getattr(found, "trials", None)
    more["trials"] = trials and [{"grade_percent": 100 * grade, "held": held} for grade, held in trials]
    return {"figures": found.figures, **{k: x for k, x in more.items() if x is not None}, "notes": found.notes}


def _print(car: str, test: str, found: Outcome, units: Units) -> None:
    from rich.markup import escape

    from halfshaft.app.figures import figure_rows

    out = console()
    out.print(f"[bold]{escape(car)}[/]: {escape(test)}", highlight=False, soft_wrap=True)
    table = new_table()
    table.add_column("figure")
    table.add_column("value", justify="right")
    reported = getattr(found, "reported", ()) or tuple(found.figures)
    for row in figure_rows({name: found.figures[name] for name in reported}, units):
        table.add_row(*map(escape, row))
    out.print(table)
    if more := len(found.figures) - len(reported):
        print_line(f"  {more} more figures with --json", "dim")
    if record := getattr(found, "record", ()):
        table = new_table()
        for heading in ("run", "charge at the start", "change", "fuel \\[L/100 km]", "battery over fuel"):
            table.add_column(heading, justify="right")
        for i, t in enumerate(record, 1):
            fuel, ratio = ("-" if x is None else x for x in (t.fuel_L_per_100km, t.energy_ratio))
            shown = (x if isinstance(x, str) else f"{x:.{n}f}" for x, n in ((fuel, 3), (ratio, 4)))
            table.add_row(str(i), f"{t.soc:.4f}", f"{t.change:+.4f}", *shown)
        out.print(table)
    for note in found.notes:
        print_line(f"  ! {note}", "yellow")
