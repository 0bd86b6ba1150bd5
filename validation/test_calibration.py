"""The 95 % intervals of calibrations and coast-downs hold the truth in 90 to 99 % of 200 repeats."""

import numpy as np
import pytest

from halfshaft.cosim.cycle import Cycle
from halfshaft.cosim.simulate import run
from halfshaft.models.vehicle import Vehicle, vehicle_names
from halfshaft.studies.calibration.calibrate import calibrate
from halfshaft.studies.calibration.coast_down import CoastDown, coast_down
from halfshaft.studies.calibration.least_squares import Loss
from halfshaft.studies.calibration.record import Reading, Record, Series
from halfshaft.studies.calibration.roll_out import rolled

REPEATS = 200
TRUTH = {"body.c_d": 0.29, "wheel.f_0": 0.0115}
RANGES = {"body.c_d": "0.2..0.5", "wheel.f_0": "0.004..0.02"}
POWER, CHARGE, FUEL = {"battery.P_out": 500.0}, {"battery.soc": 1e-3}, {"engine.fuel_flow": 5e-5}
CARS: dict[str, tuple[dict[str, float], dict[str, float], dict[str, str]]] = {
    "small-car-electric": (POWER | CHARGE, {"motor.torque_scale": 1.02}, {"motor.torque_scale": "0.8..1.2"}),
    "small-car-conventional": (FUEL, {"engine.torque_scale": 1.05}, {"engine.torque_scale": "0.8..1.3"}),
    "small-car-parallel": (FUEL | POWER, {}, {}),
    "small-car-series": (FUEL | CHARGE, {}, {}),
    # Its fuel cell switches so that a step more or less is a jump of hundreds of standard uncertainties.
    "small-car-fuel-cell": ({"motor.P_in": 500.0}, {}, {}),
}


def check(inside: list[list[bool]]) -> None:
    """Check in what share of the repeats the interval of each number holds the truth."""
    shares = np.mean(inside, axis=0)
    assert np.all((shares >= 0.90) & (shares <= 0.99)), shares


@pytest.mark.parametrize(("stated", "loss"), [(True, "linear"), (False, "linear"), (False, "soft_l1")])
@pytest.mark.parametrize("name", CARS)
def test_intervals_of_calibrations(name: str, stated: bool, loss: Loss) -> None:
    noises, more, wider = CARS[name]
    truth, car, cycle = TRUTH | more, Vehicle.load(name), Cycle.load("udds").between(0, 505)
    result = run(car.with_values(truth), cycle)
    draw, inside = np.random.default_rng(5), list[list[bool]]()
    for _ in range(REPEATS):
        series = tuple(
            Series(
                output=output, time=result.time, values=result[output] + noise * draw.normal(size=len(result.time)),
                reading=Reading(sigma=noise if stated else None),
            )
            for output, noise in noises.items()
        )  # fmt: skip
        found = calibrate(car, Record(name="drive", cycle=cycle, series=series), RANGES | wider, loss=loss, starts=1)
        inside.append([low <= truth[n] <= high for n, (low, high) in found.intervals.items()])
    check(inside)


def test_a_jump_within_the_intervals_is_told() -> None:
    car, cycle, draw = Vehicle.load("small-car-fuel-cell"), Cycle.load("udds").between(0, 505), np.random.default_rng(5)
    result = run(car.with_values(TRUTH), cycle)
    flow = result["fuel_cell.fuel_flow"] + 3e-6 * draw.normal(size=len(result.time))
    series = Series(output="fuel_cell.fuel_flow", time=result.time, values=flow, reading=Reading(sigma=3e-6))
    found = calibrate(car, Record(name="drive", cycle=cycle, series=(series,)), RANGES)
    assert any("jump" in note for note in found.notes), found.notes


@pytest.mark.parametrize("name", vehicle_names())
def test_every_vehicle_of_the_library_is_recovered_from_its_stores(name: str) -> None:
    """What is left of charge and used of fuel tells drag and mass, if there is no noise."""
    car, cycle = Vehicle.load(name), Cycle.load("udds").between(0, 505)
    truth = {"body.c_d": 1.1 * car.values["body.c_d"], "body.m": 1.05 * car.mass}
    result = run(car.with_values(truth), cycle)
    outputs = [output for tag in ("charge", "fuel mass") for output in result.tags.all_of(tag)]
    series = tuple(Series(output=output, time=result.time, values=result[output]) for output in outputs)
    ranges = {output: (0.8 * x, 1.3 * x) for output, x in truth.items()}
    found = calibrate(car, Record(name="drive", cycle=cycle, series=series), ranges)
    assert found.values == pytest.approx(truth, rel=1e-4), found.notes


def test_intervals_of_coast_downs() -> None:
    load, wind, grade, m, turning = np.array([140.0, 1.5, 0.42]), 2.0, 0.003, 1500.0, 45.0
    draw, time, inside = np.random.default_rng(6), np.arange(0, 90, 0.5), list[list[bool]]()
    for _ in range(REPEATS):
        runs = []
        for d in (1, -1):
            own = load[0] + load[2] * wind**2 + d * m * 9.81 * grade, load[1] + 2 * d * load[2] * wind, load[2]
            speed = rolled(time, 33.0, own, m + turning)[0] + 0.1 * draw.normal(size=len(time))
            runs.append(CoastDown(name=f"run{d}", time=time, speed=speed, direction=d))
        found = coast_down(runs, m, rotating=turning, between=(0, 100)).fit.intervals[:5]
        inside.append([low <= x <= high for x, (low, high) in zip((*load, wind, grade), found, strict=True)])
    check(inside)
