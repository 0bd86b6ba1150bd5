"""Motors with a temperature: cars by hand, and what the temperature changes."""

import numpy as np
import pytest
import twins.vehicles
from twins.thermal_motor import ThermalMotor
from twins.vehicles import TWINS, columns

from halfshaft import Cycle, InputError, Vehicle, accelerate, run

UDDS, US06 = Cycle.load("udds"), Cycle.load("us06")
HOT = {"motor.T_start": 315.0, "motor.T_derate": 316.0, "motor.T_stop": 330.0, "motor.Q_coolant_max": 300.0}
CARS = {
    "as it is": {},
    "hot": HOT,
    "small and hot": {**HOT, "motor.mass": 10.0, "motor.c_p": 300.0, "motor.A": 0.1, "motor.torque_scale": 0.5, "motor.speed_scale": 0.9},
    "coolant early, cold air": {"motor.T_coolant": 296.0, "motor.T_ambient": 263.0, "motor.J": 0.05, "motor.overtorque": 1.0},
}  # fmt: skip


def car_of(base, **values):
    return Vehicle.load(base).with_parts({"motor": "ac-75kw-thermal"}).with_values(values)


@pytest.mark.parametrize("car", CARS)
@pytest.mark.parametrize("base", ["small-car-electric", "small-car-series-follower"])
def test_compiled_step_is_the_car_by_hand(base, car, monkeypatch):
    monkeypatch.setattr(twins.vehicles, "Motor", ThermalMotor)
    vehicle = car_of(base, **CARS[car])
    for cycle in (UDDS, US06):
        result, hand = run(vehicle, cycle), columns(TWINS[vehicle.powertrain](vehicle.parameters, cycle.sampled(1.0)))
        units = {d.name: d.unit for d in result.outputs}
        for name, x in hand.items():
            scale = max(np.abs(result[name]).max(), 1.0 if units[name] in ("W", "N", "N.m", "m/s") else 1e-12)
            np.testing.assert_allclose(x / scale, result[name] / scale, rtol=0, atol=1e-9, err_msg=f"{name}, {cycle.name}")
        assert abs(result.account.balance_relative) < 1e-9


@pytest.mark.parametrize("base", ["small-car-electric", "small-car-fuel-cell"])
def test_the_temperature_changes_nothing_unless_it_is_told_to(base):
    plain, warm = run(Vehicle.load(base), US06), run(car_of(base), US06)
    for d in plain.outputs:
        np.testing.assert_array_equal(plain[d.name], warm[d.name])
    # The coolant holds it at its threshold.
    assert 318.15 < warm["motor.T"].max() < 318.3


@pytest.mark.parametrize("mode", ["hybrid", "refined"])
def test_a_hot_motor_is_slower(mode):
    cold, hot = (accelerate(car_of("small-car-electric", **values), mode=mode) for values in ({}, {**HOT, "motor.T_start": 325.0}))
    assert hot.time > 1.3 * cold.time
    assert abs(hot.result.account.balance_relative) < 1e-9


def test_forward_facing_it_warms_and_derates_as_in_the_step():
    car, short = car_of("small-car-electric", **HOT), Cycle(name="short", time=US06.time[:100], speed=US06.speed[:100])
    forward, step = run(car, short, via="forward"), run(car, short, dt=0.1, mode="refined")
    assert abs(forward.account.balance_relative) < 1e-6
    assert forward["motor.T"][-1] == pytest.approx(step["motor.T"][-1], abs=0.02)
    assert forward["motor.T"][-1] > 317
    assert forward["body.distance"][-1] == pytest.approx(step["body.distance"][-1], rel=2e-3)


def test_a_motor_that_only_loses_heat_by_a_known_law_cools_as_that_says():
    # Standing, without wind and losses; 20 K above the air.
    still = Cycle(name="still", time=[0.0, 600.0], speed=[0.0, 0.0])
    result = run(car_of("small-car-electric", **{"motor.T_start": 313.15}), still, dt=1.0)
    T, p = 313.15, result.inputs.parameters
    for _ in range(600):
        h = 6 + 6 * ((T - 293.15) / 1000) ** 0.25
        T -= (h * p["motor.A"] * (T - 293.15) + 0.9 * 5.67e-8 * p["motor.A"] * (T**4 - 293.15**4)) / (p["motor.mass"] * p["motor.c_p"])
    assert result["motor.T"][-1] == pytest.approx(T, abs=1e-3)
    assert T < 312.7


def test_temperatures_must_be_in_their_order_and_a_mass_must_be_there():
    with pytest.raises(InputError, match="T_derate = 400 K must be below T_stop = 390 K"):
        car_of("small-car-electric", **{"motor.T_derate": 400.0, "motor.T_stop": 390.0})
    with pytest.raises(InputError, match="mass = 0 kg must be above 0"):
        car_of("small-car-electric", **{"motor.mass": 0.0})
