"""Bodies by coast-down coefficients and wheels after SAE J2452: cars by hand, whose road load is worked out apart, and the laws."""

from types import SimpleNamespace

import numpy as np
import pytest
from twins.vehicles import TWINS, columns

from halfshaft import Cycle, Vehicle, run
from halfshaft.library.base.ports import Tyre
from halfshaft.library.files.component_file import read_component

UDDS, US06 = Cycle.load("udds"), Cycle.load("us06")
CAR = Vehicle.load("small-car-electric")
CARS = {
    "road load": ({"body": "small-car-coast-down"}, {"body.m": 1144.0}),
    "road load, heavier than in the test": ({"body": "small-car-coast-down"}, {"body.m": 1500.0, "wheel.f_1": 1e-5}),
    "road load that grows with speed": ({"body": "small-car-coast-down"}, {"body.F_1": 2.0, "body.F_2": 0.3, "body.m_test": 1300.0}),
    "J2452": ({"wheel": "suv-wheels-j2452"}, {"body.m": 1144.0}),
    "J2452, soft and heavy": ({"wheel": "suv-wheels-j2452"}, {"body.m": 2200.0, "wheel.pressure": 1.6e5, "body.front_share": 0.45}),
    "road load on J2452": (
        {"body": "small-car-coast-down", "wheel": "suv-wheels-j2452"}, {"body.m": 1700.0, "wheel.b": 4e-4, "wheel.beta": 0.95}
    ),
}  # fmt: skip


def car_of(name):
    parts, values = CARS[name]
    return CAR.with_parts(parts).with_values(values)


def tyres(wheel, load, share):
    """Return the rolling resistance of a vehicle of a load [N] at 0, and by speed in m/s and its square."""
    if hasattr(wheel, "f_0"):
        return load * wheel.f_0, load * wheel.f_1, 0.0
    each = [share * load / 2] * 2 + [(1 - share) * load / 2] * 2
    on_drum = sum((wheel.pressure / 1e3) ** wheel.alpha * x**wheel.beta for x in each)
    on_road = on_drum * (1 / (1 + wheel.r / wheel.r_drum)) ** 0.5
    return on_road * wheel.a, on_road * wheel.b * 3.6, on_road * wheel.c * 12.96


def flat_road(body, wheel):
    """Return body and wheel of a plain car whose forces on a flat road are the same."""
    load = body.m * body.g
    roll = tyres(wheel, load, body.front_share)
    if hasattr(body, "F_0"):
        tested = tyres(wheel, body.m_test * body.g, body.front_share)
        bearings = np.interp(body.m_test, wheel.tau_bearing.points[0], wheel.tau_bearing.values) / wheel.r
        measured = (body.F_0 - bearings, body.F_1, body.F_2)
        roll = [m - t + r for m, t, r in zip(measured, tested, roll, strict=True)]
    else:
        roll = [roll[0], roll[1], roll[2] + 0.5 * body.rho * body.c_d * body.A]
    plain = {"rho": 2.0, "c_d": roll[2], "A": 1.0}
    return SimpleNamespace(**{**vars(body), **plain}), SimpleNamespace(**{**vars(wheel), "f_0": roll[0] / load, "f_1": roll[1] / load})


@pytest.mark.parametrize("name", CARS)
def test_compiled_step_is_the_car_by_hand(name):
    vehicle = car_of(name)
    body, wheel = flat_road(vehicle.parameters["body"], vehicle.parameters["wheel"])
    for cycle in (UDDS, US06):
        result = run(vehicle, cycle)
        hand = columns(TWINS["electric"]({**vehicle.parameters, "body": body, "wheel": wheel}, cycle.sampled(1.0)))
        # What is rolling resistance and what is drag is told apart otherwise.
        shown = [n for n in hand if n not in ("body.P_aero", "body.P_roll")]
        units = {d.name: d.unit for d in result.outputs}
        for column in shown:
            scale = max(np.abs(result[column]).max(), 1.0 if units[column] in ("W", "N", "N.m", "m/s") else 1e-12)
            np.testing.assert_allclose(hand[column] / scale, result[column] / scale, rtol=0, atol=1e-9, err_msg=f"{column}, {cycle.name}")
        both = hand["body.P_aero"] + hand["body.P_roll"]
        np.testing.assert_allclose(both, result["body.P_aero"] + result["body.P_roll"], rtol=1e-9, atol=1e-6)
        assert abs(result.account.balance_relative) < 1e-9


@pytest.mark.parametrize("wheel", ["small-car-wheels", "suv-wheels", "suv-wheels-j2452"])
def test_a_car_of_the_tested_mass_needs_the_measured_road_load_on_any_wheels(wheel):
    parts = CAR.with_parts({"body": "small-car-coast-down", "wheel": wheel}).with_values({"body.F_1": 0.7}).components()
    body, tyre = parts["body"], parts["wheel"]
    for v in (0.5, 10.0, 40.0):
        force = float(body.resistance(0.0, tyre).at(v, 1.0)) + float(tyre.p.tau_bearing(body.p.m)) / tyre.p.r
        assert force == pytest.approx(body.p.F_0 + body.p.F_1 * v + body.p.F_2 * v**2, rel=1e-12)


def test_a_car_by_its_road_load_is_the_car_whose_road_load_it_is():
    own, measured = run(CAR, US06), run(car_of("road load"), US06)
    for name in ("motor.P_in", "battery.soc", "body.F_required"):
        np.testing.assert_allclose(measured[name], own[name], rtol=1e-9, atol=1e-6)
    forward = run(car_of("road load"), Cycle(name="short", time=UDDS.time[:120], speed=UDDS.speed[:120]), via="forward")
    assert abs(forward.account.balance_relative) < 1e-6


def test_rolling_resistance_of_the_tyres_follows_the_slope_and_the_rest_does_not():
    parts = CAR.with_parts({"body": "small-car-coast-down"}).with_values({"body.F_1": 0.0}).components()
    body, tyre, grade = parts["body"], parts["wheel"], 0.3
    flat, steep = body.resistance(0.0, tyre), body.resistance(grade, tyre)
    weight = body.p.m * body.p.g
    assert float(flat.roll_0 - steep.roll_0) == pytest.approx(tyre.p.f_0 * weight * (1 - 1 / np.sqrt(1 + grade**2)), rel=1e-9)
    assert float(steep.climb) == pytest.approx(weight * np.sin(np.arctan(grade)), rel=1e-12)


def test_a_road_load_may_be_typed_in_pounds_and_miles():
    car = car_of("road load").with_values({"body.F_0": "27.63 lbf", "body.F_1": "0.1 lbf/mph", "body.F_2": "0.01806 lbf/mph^2"})
    pound, mile = 4.4482216152605, 0.44704
    expected = (27.63 * pound, 0.1 * pound / mile, 0.01806 * pound / mile**2)
    assert [car.values[f"body.F_{i}"] for i in range(3)] == pytest.approx(list(expected), rel=1e-12)


def test_a_soft_tyre_and_a_loaded_one_roll_harder():
    wheel = read_component("suv-wheels-j2452").build()
    part = car_of("J2452").components()["wheel"]
    at = lambda W, **values: float(type(part)(read_component("suv-wheels-j2452").build(**values)).rolling(W, 0.6)[0])  # noqa: E731
    assert at(2e4) == pytest.approx(wheel.a * 240**-0.3191 * 2 * (6000**0.9076 + 4000**0.9076) * np.sqrt(0.85 / 1.193), rel=1e-12)
    assert at(2e4, pressure=1.8e5) > at(2e4)
    assert at(2e4) / at(1e4) == pytest.approx(2**0.9076, rel=1e-9)


@pytest.mark.parametrize(("F", "a"), [(900.0, 2.0), (-2500.0, -3.0)])
def test_forward_facing_the_room_of_a_driveline_ends_where_the_tyres_do(F, a):
    parts = CAR.with_values({"wheel.rear_driven": 1.0}).components()
    body, wheel, brakes = parts["body"], parts["wheel"], (-600.0, -250.0)
    p, loads = wheel.p, body.loads(a, 0.02)
    out = wheel.flow(Tyre(F, 15.0, a), *brakes, 0.02, body, lambda speed: 1.0)
    # What bearings and inertia take of the driveline's torque, half of it on each axle.
    taken = float(out["axle"].tau) - p.r * (F - sum(brakes))
    for axle, brake, load in zip(("front", "rear"), brakes, loads, strict=True):
        for tau, grip in ((out[f"tau_{axle}_out"], load), (-out[f"tau_{axle}_in"], -load)):
            assert (float(tau) - taken / 2) / p.r + brake == pytest.approx(p.mu_max * float(grip), rel=1e-12)
    more, less = (float(out[f"tau_grip_{way}"]) / p.r for way in ("out", "in"))
    assert (F + more, F - less) == pytest.approx((p.mu_max * float(sum(loads)), -p.mu_max * float(sum(loads))), rel=1e-12)
