"""The compiled step of fuel cell hybrids against the same vehicles by hand."""

import numpy as np
import pytest
from twins.fuel_cell import drive

from halfshaft import Cycle, InputError, Vehicle, run

UDDS = Cycle.load("udds")
#: Launches at full power, stops harder than the brakes take, a long climb and descent, a request beyond top speed, key off and on.
LIMITS = Cycle(
    name="limits",
    time=[0, 4, 4.5, 30, 31, 36, 50, 60, 140, 150, 152, 160, 175, 240, 244, 250, 252, 262, 300],
    speed=[0, 0, 30, 30, 0, 0, 3, 25, 25, 70, 70, 8, 22, 22, 0, 0, 12, 12, 0],
    key_on=[1] * 14 + [0] * 2 + [1] * 3,
    grade_by_distance=([0, 700, 900, 2600, 2700, 4500, 5000], [0, 0, 0.12, 0.12, -0.1, -0.1, 0]),
)
#: Cars that meet other limits of fuel cell and control.
CARS = {
    "as it is": {},
    "on at the start, low": {"control.on_start": 1.0, "battery.soc_start": 0.38},
    "high, small pack": {"battery.soc_start": 0.82, "control.on_start": 1.0, "battery.capacity_scale": 0.1},
    "full": {"battery.soc_start": 1.0, "battery.capacity_scale": 0.2, "control.always_on": 1.0},
    "empty": {"battery.soc_start": 0.03, "battery.capacity_scale": 0.15, "accessories.P_on": 6000.0},
    "always on": {"control.always_on": 1.0, "control.P_min_share": 0.3, "battery.u_max": 13.4},
    "depletes first": {
        "control.charge_depleting": 1.0, "control.soc_high": 0.72, "control.soc_low": 0.64, "control.on_start": 1.0,
        "battery.capacity_scale": 0.1, "control.t_off_min": 8.0, "control.P_min_share": 0.05,
    },
    "quick": {
        "control.P_rise": 3e4, "control.P_fall": 2e4, "control.t_off_min": 3.0, "control.P_min_share": 0.02, "control.P_charge": 9e3,
        "control.P_max_share": 0.5, "body.m": 1900.0,
    },
}  # fmt: skip
SYSTEMS = {
    "small-car-fuel-cell": {"fuel_cell.P_scale": 0.7, "fuel_cell.efficiency_scale": 0.9, "fuel_cell.H_fuel": 1.3e8},
    "small-car-fuel-cell-polarisation": {
        "fuel_cell.n_cells": 110.0, "fuel_cell.A_cell": 0.06, "fuel_cell.utilisation": 0.8, "fuel_cell.H_fuel": 1.3e8,
    },
}  # fmt: skip


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("car", [*CARS, "another fuel cell"])
def test_compiled_step_is_the_fuel_cell_hybrid_by_hand(name, car):
    vehicle = Vehicle.load(name).with_values(CARS.get(car, {**SYSTEMS[name], "control.on_start": 1.0}))
    for cycle, dt in ((UDDS, 1.0), (LIMITS, 1.0), (LIMITS, 0.1)):
        result, by_hand = run(vehicle, cycle, dt=dt), drive(vehicle.parameters, cycle.sampled(dt))
        units = {d.name: d.unit for d in result.outputs}
        for column, x in by_hand.items():
            compiled = result[column]
            # What is nothing but rounding is measured by one unit; the achieved speed feeds it back, the more the shorter the step.
            scale = max(np.abs(compiled).max(), 1.0 if units[column] in ("W", "N", "N.m", "m/s") else 1e-12)
            np.testing.assert_allclose(x / scale, compiled / scale, rtol=0, atol=1e-9 / dt**2, err_msg=f"{column}, {cycle.name}, {dt} s")


@pytest.mark.parametrize("name", SYSTEMS)
def test_every_parameter_of_fuel_cell_and_control_moves_what_is_compared(name):
    vehicle = Vehicle.load(name)
    still = {n for n in vehicle.values if n.startswith(("fuel_cell.", "control."))} - {"fuel_cell.mass", "fuel_cell.rho_fuel"}
    for car in ("quick", "depletes first", "as it is"):
        base = vehicle.with_values(CARS[car])
        first = run(base, LIMITS)
        for n in tuple(still):
            changed = run(other(base, n), LIMITS)
            if any(np.abs(first[d.name] - changed[d.name]).max() > 1e-6 * np.abs(first[d.name]).max() for d in first.outputs):
                still.discard(n)
    assert not still


def other(vehicle, name):
    """Return the vehicle with another number: a flag turned, anything else larger or, where that is not allowed, smaller."""
    x = vehicle.values[name]
    for value in ((1 - x,) if x in (0.0, 1.0) else ()) + (1.1 * x, 0.9 * x):
        try:
            return vehicle.with_values({name: value})
        except InputError:
            continue
    raise AssertionError(name)
