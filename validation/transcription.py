"""Direct transcription against sizing by tangents of whole runs: the same car, and a hybrid with and without the control in use.

python -m halfshaft.validation.transcription         # minutes; prints the tables of the manual
python -m halfshaft.validation.transcription UDDS    # a quarter of an hour: the hybrid on all of its cycle
"""

from __future__ import annotations

import sys
import time
from functools import cache
from typing import NamedTuple

from halfshaft.cosim.cycle import Cycle
from halfshaft.cosim.simulate import run
from halfshaft.cosim.units import M_PER_MILE
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.optimal.optimum import Optimum, Way, optimal
from halfshaft.studies.size import size
from halfshaft.studies.sizing.optimum import Optimum as Sized
from halfshaft.studies.sizing.problem import Problem
from halfshaft.studies.soc_correction import Linear
from halfshaft.studies.task import Drive, Task
from halfshaft.studies.transcription import Transcribed, transcribe

#: The only limit: a speed [m/s] from rest within a time [s].
REACH = (60 * M_PER_MILE / 3600, 12.0)
LIMIT = "0-60 mph <= 12 s"
UDDS = Cycle.load("udds")
#: The first two hills of a cycle, which end at rest, and all of it.
TRIPS = {"UDDS to 330 s": UDDS.between(0, 330), "UDDS": UDDS}
SHORT = "UDDS to 330 s"
#: What is free of an electric car, and of a series hybrid.
ELECTRIC = {"motor.torque_scale": (0.3, 3.0), "final_drive.i": (0.5, 2.0)}
SERIES = {"motor.torque_scale": (0.3, 1.5), "engine.torque_scale": (0.5, 1.5)}


#: Most iterations of a stage where the split is sought with sizes.
ITERATIONS = 25


class Case(NamedTuple):
    """A car that was sized in both ways, how long each took [s], and the tables' goal of both."""

    sized: Sized
    transcribed: Transcribed
    seconds: tuple[float, float]


def compared(name: str, sizes: dict[str, tuple[float, float]], minimise: str, task: Task, cycle: Cycle) -> Case:
    """Return a car sized by tangents of whole runs, and by direct transcription."""
    car = Vehicle.load(name)
    vary = {number: f"{low}..{high}" for number, (low, high) in sizes.items()}
    began = time.perf_counter()
    sized = size(Problem(vehicle=car, vary=vary, minimise=minimise, limits=(LIMIT,), tasks={"trip": task}))
    between = time.perf_counter()
    found = transcribe(car, cycle, sizes, reach=[REACH], iterations=ITERATIONS)
    return Case(sized, found, (between - began, time.perf_counter() - between))


@cache
def electric(cycle: str = "nycc") -> Case:
    """Return an electric car of least energy."""
    trip = Cycle.load(cycle)
    return compared("small-car-electric", ELECTRIC, "energy", Drive(trip), trip)


@cache
def series(trip: str = SHORT) -> Case:
    """Return a series hybrid of least fuel: with the control in use, and with the split sought together with sizes."""
    return compared("small-car-series", SERIES, "fuel", Linear(cycle=TRIPS[trip]), TRIPS[trip])


def energy(car: Vehicle, cycle: str = "nycc") -> float:
    """Return what an electric car takes on the exact step [Wh/km]."""
    return float(run(car, Cycle.load(cycle)).figures["energy_Wh_per_km"])


@cache
def ways(trip: str = SHORT) -> dict[str, Optimum]:
    """Return the best known drive of the series hybrid as it is, as sized, and as transcribed: one judge for all three."""
    found = series(trip)
    cars = {"as it is": Vehicle.load("small-car-series"), "`size`": found.sized.vehicle, "`transcribe`": found.transcribed.vehicle}
    return {name: optimal(car, TRIPS[trip]) for name, car in cars.items()}


def kept(optimum: Optimum, way: Way) -> float:
    """Return the energy of the fuel, less the price of what the charge rose by [J]."""
    charge = optimum.charge(optimum.in_use)
    rise = float(charge[-1]) - optimum.figures()["best"]["soc_start"]
    return optimum.fuel(way) - optimum.price * rise * float(optimum.in_use.result.figures["pack_energy_J"])


def table() -> str:
    """Return the comparison of the electric car as Markdown."""
    e = electric()
    rows = ["| electric car, NYCC | " + " | ".join(ELECTRIC) + " | 0-60 mph [s] | Wh/km | time [s] |", "|---" * 6 + "|"]
    own, sized, found = Vehicle.load("small-car-electric"), e.sized.vehicle, e.transcribed.vehicle
    for name, car, reached, seconds in (
        ("as it is", own, e.sized.limits[0].before, ""), ("`size`", sized, e.sized.limits[0].after, f"{e.seconds[0]:.1f}"),
        ("`transcribe`", found, e.transcribed.reached[0], f"{e.seconds[1]:.0f}"),
    ):  # fmt: skip
        sizes = " | ".join(f"{car.values[x]:.4f}" for x in ELECTRIC)
        rows.append(f"| {name} | {sizes} | {reached:.3f} | {energy(car):.3f} | {seconds} |")
    return "\n".join(rows)


def series_table(trip: str = SHORT) -> str:
    """Return the comparison of the series hybrid as Markdown."""
    s = series(trip)
    rows = [f"| series hybrid, {trip} | " + " | ".join(SERIES) + " | 0-60 mph [s] | control in use | best split | time [s] |"]
    rows += ["|---" * 7 + "|"]
    assert s.transcribed.optimum is not None
    per_gram = 1e-3 * s.transcribed.optimum.best.fuel / s.transcribed.before
    to_speed = (s.sized.limits[0].before, s.sized.limits[0].after, s.transcribed.reached[0])
    times = ["", *(f"{x:.0f}" for x in s.seconds)]
    for (name, optimum), t, seconds in zip(ways(trip).items(), to_speed, times, strict=True):
        sizes = " | ".join(f"{optimum.vehicle.values[x]:.4f}" for x in SERIES)
        in_use, best = (kept(optimum, way) / per_gram for way in (optimum.in_use, optimum.best))
        rows.append(f"| {name} | {sizes} | {t:.3f} | {in_use:.2f} g | {best:.2f} g | {seconds} |")
    program = s.transcribed
    rows += ["", f"transcribed: {1e3 * program.before:.2f} g before, {1e3 * program.goal:.2f} g, holds: {program.holds}"]
    rows += [str(stage) for stage in program.stages]
    return "\n".join(rows)


if __name__ == "__main__":
    trips = sys.argv[1:]
    print("\n\n".join([series_table(trip) for trip in trips] or [table(), series_table()]))  # noqa: T201
