"""What a run says does not hang on the length of its steps, nor on the inertia of a rotor."""

from functools import cache

import numpy as np
import pytest

from halfshaft.cosim.cycle import Cycle, acceleration_cycle
from halfshaft.cosim.simulate import run
from halfshaft.models.vehicle import Vehicle, vehicle_names
from halfshaft.studies.acceleration import prepared, time_to

vehicle_of, cycle_of = cache(Vehicle.load), cache(Cycle.load)
CONVENTIONAL = "small-car-conventional"
both_modes = pytest.mark.parametrize("mode", ["hybrid", "refined"])


@pytest.mark.parametrize("cycle", ["udds", "us06", "hwfet"])
@both_modes
def test_fuel_of_a_conventional_car_converges(cycle, mode):
    fuel, distance = {}, {}
    for dt in (1.0, 0.1, 0.05, 0.02, 0.01):
        result = run(vehicle_of(CONVENTIONAL), cycle_of(cycle), dt=dt, mode=mode, history=False)
        fuel[dt], distance[dt] = result.last["engine.fuel_used"], result.last["body.distance"]
    for dt in fuel:
        # On US06 the car is short of torque for a fifth of the time, and the hybrid method asks for spinning wheels then.
        tolerance = (0.055 if dt == 1 else 0.02) if mode == "hybrid" else (0.03 if dt == 1 else 0.003)
        assert fuel[dt] == pytest.approx(fuel[0.01], rel=tolerance), dt
        assert distance[dt] == pytest.approx(distance[0.01], rel=2e-3), dt


@both_modes
def test_full_acceleration_of_a_conventional_car_converges(mode):
    times = []
    # Shifts of 0.2 s take a whole number of these steps.
    for dt in (0.1, 0.05, 0.02, 0.01):
        times.append(time_to(run(prepared(vehicle_of(CONVENTIONAL)), acceleration_cycle(), dt=dt, mode=mode), 100 / 3.6))
    assert times == pytest.approx([times[-1]] * 4, rel=3e-3)
    assert times[-1] == pytest.approx(18.2, abs=0.2)


@pytest.mark.parametrize("J", [0.0, 0.5, 5.0])
@both_modes
def test_an_engine_of_any_inertia_drives_its_car_at_any_step(J, mode):
    # From the rotor of a small car's engine to that of a bus; body and torque grow with it.
    size = 1 + 3 * J
    car = vehicle_of(CONVENTIONAL).with_values({"engine.J": J, "body.m": 984 * size, "engine.torque_scale": size})
    reached = [run(car, acceleration_cycle(), dt=dt, mode=mode).last["body.v"] for dt in (0.1, 0.02, 0.01)]
    assert reached[0] > 20
    assert reached == pytest.approx([reached[-1]] * 3, rel=0.01)


def test_gears_do_not_change_more_often_in_shorter_steps():
    shifts = [int((np.diff(run(vehicle_of(CONVENTIONAL), cycle_of("udds"), dt=dt)["shift.gear"]) != 0).sum()) for dt in (1.0, 0.1, 0.01)]
    assert shifts[0] == 206
    assert max(shifts) < 1.15 * shifts[0]


@pytest.mark.parametrize("car", ["small-car-series", "small-car-series-follower"])
@both_modes
def test_a_series_hybrid_burns_the_same_at_any_step(car, mode):
    start = {"battery.soc_start": 0.41 if car == "small-car-series" else 0.7}
    runs = [run(vehicle_of(car).with_values(start), cycle_of("us06"), dt=dt, mode=mode, history=False) for dt in (1.0, 0.1, 0.01)]
    fuel = [r.last["engine.fuel_used"] for r in runs]
    # The control decides once a step, and a step of 1 s starts and stops the engine by whole seconds.
    assert fuel == pytest.approx([fuel[-1]] * 3, rel=0.005)


@pytest.mark.parametrize("dt", [1.0, 0.1])
@pytest.mark.parametrize("name", vehicle_names())
def test_gearbox_clutch_engine_and_generator_lose_power_in_every_step(name, dt):
    for cycle in ("udds", "us06", "rep05"):
        result = run(vehicle_of(name), cycle_of(cycle), dt=dt)
        for part in {"gearbox", "clutch", "engine", "generator"} & vehicle_of(name).parts.keys():
            assert result[f"{part}.P_loss"].min() > -1e-6, (part, cycle)


@pytest.mark.parametrize("dt", [1.0, 0.1, 0.02])
@pytest.mark.parametrize("J", [0.02, 0.8, 3.0])
def test_a_genset_of_any_inertia_loses_power_in_every_step(J, dt):
    car = vehicle_of("small-car-series-follower").with_values({"engine.J": J, "battery.soc_start": 0.45})
    result = run(car, cycle_of("us06"), dt=dt)
    assert result.last["engine.fuel_used"] > 0
    assert result["generator.P_loss"].min() > -1e-6
