"""Road load from coast-downs or published coefficients, and vehicles that have it."""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape

from halfshaft.app.options import Checks, Json
from halfshaft.app.output import console, new_table, print_json, print_line, print_written
from halfshaft.app.program import app
from halfshaft.library.base.errors import InputError, number

if TYPE_CHECKING:
    from halfshaft.studies.calibration.coast_down import CoastedDown
    from halfshaft.studies.calibration.road_load import RoadLoad, Shaped

_SPEED = re.compile(r"[\d.]+")


@app.command(
    "road-load",
    help="""Find the road load that coast-downs tell, or take published coefficients, and put it into a vehicle.

    A coast-down is a CSV file with a time and a speed, such as time_s and speed_kmh. Runs in both directions also tell wind and slope.

    \b
    Examples:
      halfshaft road-load there.csv --back back.csv --mass 1500 --plot load.png
      halfshaft road-load there.csv --back back.csv --mass 1500 --vehicle small-car-electric --out my-car.toml
      halfshaft road-load --target "30.1 0.21 0.0185" --weight 3500
      halfshaft road-load --target "30.1 0.21 0.0185" --weight 3500 --vehicle small-car-electric --shape --out my-car.toml
    """,
)
def _road_load(
    runs: Annotated[list[Path] | None, typer.Argument(metavar="RUN.csv", help="Coast-downs.", show_default=False)] = None,
    back: Annotated[list[Path] | None, typer.Option(metavar="RUN.csv", help="A coast-down the other way; repeatable.")] = None,
    mass: Annotated[float | None, typer.Option(metavar="KG", help="Mass of the car that rolled out.")] = None,
    rotating: Annotated[str, typer.Option(metavar="X", help="What turns with the wheels as a mass: 45kg, or per cent of the mass.")] = "3%",
    between: Annotated[str, typer.Option(metavar="A..B", help="Speeds that are looked at, 15..115km/h or 10..70mph.")] = "15..km/h",
    sigma: Annotated[
        str | None, typer.Option(metavar="V", help="Standard uncertainty of a speed, 0.1km/h; else the residuals tell.")
    ] = None,
    loss: Annotated[str, typer.Option(help="How residuals count: linear, soft_l1, huber, cauchy.")] = "linear",
    no_linear: Annotated[bool, typer.Option("--no-linear", help="Without the part B that grows with speed.")] = False,
    target: Annotated[
        str | None, typer.Option(metavar="'A B C'", help="Target coefficients in lbf, lbf/mph, lbf/mph2, in place of coast-downs.")
    ] = None,
    weight: Annotated[float | None, typer.Option(metavar="LB", help="Equivalent test weight; with --target.")] = None,
    vehicle: Annotated[str | None, typer.Option(metavar="VEHICLE", help="What gets the load: a name, or a TOML file.")] = None,
    shape: Annotated[
        bool,
        typer.Option("--shape", help="Fit drag and rolling resistance of its own body and wheels, in place of a body by coefficients."),
    ] = False,
    fit: Annotated[list[str] | None, typer.Option(metavar="NAME", help="With --shape, what is fitted, body.c_d; repeatable.")] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", metavar="FILE", help="Write the vehicle to this TOML file.")] = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE", help="Draw it: .png, .svg or .pdf.")] = None,
    as_json: Json = False,
) -> None:
    from halfshaft.studies.calibration.coast_down import CoastDown, coast_down
    from halfshaft.studies.calibration.road_load import RoadLoad

    checks = Checks()
    taken = [(path, 1) for path in runs or ()] + [(path, -1) for path in back or ()]
    found = [checks.take(partial(CoastDown.load, path, direction)) for path, direction in taken]
    numbers = [] if target is None else re.split(r"[\s,;]+", target.strip())
    if bool(taken) == (target is not None):
        checks.problem("give coast-downs, or target coefficients with --target, one of both")
    elif taken and mass is None:
        checks.problem("--mass is missing: what did the car weigh?")
    if target is not None and len(numbers) != 3:
        checks.problem(f"--target {target}: must be three numbers, '30.1 0.21 0.0185'")
    if target is not None and weight is None:
        checks.problem("--weight is missing: the equivalent test weight in lb")
    speeds = checks.take(partial(_range, between))
    noise = None if sigma is None else checks.take(partial(_speed, sigma, "--sigma"))
    car = None if vehicle is None else checks.vehicle(vehicle, None, None, None)
    for option, given in (("--shape", shape), ("--out", out)):
        if given and vehicle is None:
            checks.problem(f"{option} goes with --vehicle")
    if fit and not shape:
        checks.problem("--fit goes with --shape")
    if out is not None and out.suffix != ".toml":
        checks.problem(f"--out {out}: must end in .toml")
    checks.target(out, "--out")
    checks.picture(plot, "--plot")
    checks.raise_problems()
    told: CoastedDown | None = None
    if target is None:
        options: dict[str, Any] = {"rotating": rotating, "between": speeds, "sigma": noise, "loss": loss, "linear": not no_linear}
        told = coast_down([run for run in found if run is not None], mass or 0.0, **options)
        load = told.load
    else:
        A, B, C = (number(x) for x in numbers)
        load = RoadLoad.of_pounds(A, B, C, number(weight), f"target coefficients {target} at {weight:g} lb")
    shaped = None if car is None or not shape else load.by_shape(car, fit or ())
    changed = shaped.vehicle if shaped is not None else None if car is None else load.exactly(car)
    if out is not None and changed is not None:
        changed.save(out)
    if plot is not None:
        from halfshaft.studies.calibration.pictures import plot_coast_down, plot_load

        if told is not None and shaped is None:
            plot_coast_down(told, path=plot)
        else:
            plot_load(load, *filter(None, [shaped]), path=plot)
    if as_json:
        print_json(_json(load, told, shaped))
        return
    _print(load, told, shaped)
    print_written(out, plot)


def _range(text: str) -> tuple[float, float]:
    """Return speeds in m/s, the upper one infinite if there is none."""
    match = re.fullmatch(r"\s*([\d.]*)\s*\.\.\s*([\d.]*)\s*([a-z/]*)\s*", text)
    if not match or not (match[1] or match[2]):
        raise InputError(f"--between {text}", ["must be a range such as 15..115km/h"])
    low, high = (_speed(f"{x} {match[3] or 'm/s'}", "--between") if x else None for x in match.groups()[:2])
    return low or 0.0, float("inf") if high is None else high


def _speed(text: str, option: str) -> float:
    """Return a speed in m/s."""
    from halfshaft.library.files.component_file import parse_quantity

    return float(text) if _SPEED.fullmatch(text.strip()) else parse_quantity(text, "m/s", option)


def _json(load: RoadLoad, told: CoastedDown | None, shaped: Shaped | None) -> dict[str, object]:
    std = load.std
    found: dict[str, object] = {
        "A_N": load.A, "B_N_s_per_m": load.B, "C_N_s2_per_m2": load.C, "mass_kg": load.m, "pounds": list(load.pounds),
        "source": load.source,
        "std": None if std is None else std.tolist(), "covariance": None if load.covariance is None else load.covariance.tolist(),
    }  # fmt: skip
    if told is not None:
        found |= {"inertia_kg": told.inertia, "wind_mps": told.wind, "grade": told.grade, "rms_mps": told.rms, "notes": list(told.notes)}
    if shaped is not None:
        worst, at = shaped.worst
        found["shape"] = {"values": shaped.values, "rms_N": shaped.rms, "worst_N": worst, "worst_at_mps": at}
    return found


def _print(load: RoadLoad, told: CoastedDown | None, shaped: Shaped | None) -> None:
    out = console()
    out.print(f"[bold]road load[/]  [dim]{escape(load.source)}[/]", highlight=False, soft_wrap=True)
    table = new_table()
    for heading in ("", "value", "95 %", "unit", "in lbf, mph"):
        table.add_column(heading, justify="left" if heading in ("", "unit") else "right")
    for row in load.rows():
        table.add_row(*map(escape, row))
    out.print(table)
    if told is not None:
        if told.wind is not None and told.grade is not None:
            print_line(f"  wind {told.wind:.2g} m/s along the track, slope {100 * told.grade:.2g} %")
        print_line(f"  residuals {3.6 * told.rms:.2g} km/h")
    if shaped is not None:
        worst, at = shaped.worst
        for name, x in shaped.values.items():
            print_line(f"  {name} = {x:.4g}")
        low, high = 3.6 * shaped.v[0], 3.6 * shaped.v[-1]
        print_line(f"  misfit {shaped.rms:.2g} N between {low:.0f} and {high:.0f} km/h, at most {worst:+.2g} N at {3.6 * at:.0f} km/h")
    for note in told.notes if told is not None else ():
        print_line(f"  ! {note}", "yellow")
