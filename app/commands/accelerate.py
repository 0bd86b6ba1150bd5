"""Full acceleration from rest."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

import typer

from halfshaft.app.options import Checks, Json, Mass, Shown, Values, VehicleName
from halfshaft.app.output import busy, print_acceleration, print_json
from halfshaft.app.program import app
from halfshaft.cosim.units import SYSTEMS
from halfshaft.cosim.ways import Mode, Via

if TYPE_CHECKING:
    from halfshaft.studies.acceleration import Acceleration

#: Ways of a compared full acceleration, in the order in which they are shown.
COMPARED: tuple[Mode | Literal["forward"], ...] = ("hybrid", "iteration", "refined", "forward")


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
    from halfshaft.studies.acceleration import REQUEST, accelerate

    checks = Checks()
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
