"""Ratings typed in place of factors, and a mass that follows."""

import numpy as np
import pytest

from halfshaft.library.base.errors import InputError
from halfshaft.models.vehicle import Vehicle, vehicle_names

ELECTRIC, SERIES = Vehicle.load("small-car-electric"), Vehicle.load("small-car-series")


def problems(make, *arguments):
    with pytest.raises(InputError) as e:
        make(*arguments)
    return list(e.value.problems)


@pytest.mark.parametrize(("role", "factor"), [("motor", "torque_scale"), ("engine", "torque_scale"), ("generator", "torque_scale")])
def test_a_machine_has_the_power_that_was_typed(role, factor):
    car = SERIES.with_values({f"{role}.P_max": "60 kW"})
    envelope, scale = car.parameters[role].tau_max, getattr(car.parameters[role], factor)
    # By hand: the best of speed times torque, along the envelope; of engines and generators at its points.
    omega = np.linspace(0, envelope.points[0][-1], 100_001) if role == "motor" else envelope.points[0]
    peak = (omega * np.interp(omega, envelope.points[0], envelope.values)).max()
    assert peak * scale * getattr(car.parameters[role], "overtorque", 1.0) == pytest.approx(60e3, rel=1e-6)
    assert car.values[f"{role}.{factor}"] != SERIES.values[f"{role}.{factor}"]


def test_twice_the_power_is_twice_the_factor():
    one, two = (ELECTRIC.with_values({"motor.P_max": f"{P} kW"}).values["motor.torque_scale"] for P in (50, 100))
    assert two == pytest.approx(2 * one)


def test_a_typed_power_holds_whatever_else_sets_the_size():
    car = ELECTRIC.with_values({"motor.P_max": "75 kW", "motor.speed_scale": 1.25, "motor.overtorque": 1.0})
    plain = ELECTRIC.with_values({"motor.P_max": "75 kW"})
    ratio = ELECTRIC.values["motor.overtorque"] / 1.25
    assert car.values["motor.torque_scale"] == pytest.approx(plain.values["motor.torque_scale"] * ratio)


@pytest.mark.parametrize(("name", "limit"), [("engine.e_max", 0.4), ("motor.e_max", 0.93)])
def test_a_machine_has_the_efficiency_that_was_typed(name, limit):
    p = SERIES.with_values({name: limit}).parameters[name.partition(".")[0]]
    if name.startswith("engine"):
        table, into = p.fuel, p.H_fuel
    else:
        table, into = p.P_electric, 1.0
    rows = zip(table.points[0], table.values, strict=True)
    best = max(w * t / (into * x) for w, row in rows for t, x in zip(table.points[1], row, strict=True) if w * t > 0 and x > 0)
    assert best * p.efficiency_scale == pytest.approx(limit)


def test_a_pack_has_the_energy_that_was_typed():
    p = ELECTRIC.with_values({"battery.E": "10 kWh"}).parameters["battery"]
    assert p.ratings()["energy"] == pytest.approx(3.6e7)
    assert p.capacity_scale > 1


def test_a_rating_and_its_factor_cannot_both_be_set():
    assert problems(ELECTRIC.with_values, {"motor.P_max": 7e4, "motor.torque_scale": 2.0}) == [
        "motor.P_max and motor.torque_scale both say how large it is; set one of them"
    ]
    # The later one counts.
    assert ELECTRIC.with_values({"motor.P_max": 7e4}).with_values({"motor.torque_scale": 2.0}).values["motor.torque_scale"] == 2.0
    again = ELECTRIC.with_values({"motor.torque_scale": 2.0}).with_values({"motor.P_max": 7e4})
    assert again.values["motor.torque_scale"] == ELECTRIC.with_values({"motor.P_max": 7e4}).values["motor.torque_scale"]


@pytest.mark.parametrize("value", [0.0, -5.0])
def test_a_rating_has_bounds(value):
    (found,) = problems(ELECTRIC.with_values, {"motor.P_max": value})
    assert found == f"motor.P_max = {value:g}, must be > 0 W"


def test_a_rating_is_written_and_read_back(tmp_path):
    car = SERIES.with_values({"motor.P_max": "60 kW", "engine.e_max": 0.38})
    again = Vehicle.load(car.save(tmp_path / "car.toml"))
    assert again.values == car.values
    assert again.given == car.given


def test_the_published_masses_are_the_sums():
    assert {name: Vehicle.load(name).values["body.m"] for name in ("small-car-electric", "small-car-series", "small-car-conventional")} == {
        "small-car-electric": 1144,
        "small-car-series": 1373,
        "small-car-conventional": 984,
    }


@pytest.mark.parametrize(
    ("values", "more"),
    [
        ({"motor.torque_scale": 2.0}, 91.0),
        ({"motor.speed_scale": 2.0}, 91.0),
        ({"battery.n_modules": 30.0}, 55.0),
        ({"battery.capacity_scale": 2.0}, 275.0),
    ],
)
def test_the_mass_follows_what_is_scaled(values, more):
    assert ELECTRIC.with_values(values).values["body.m"] == pytest.approx(1144.4 + more, abs=0.5)


def test_the_mass_follows_another_part_and_can_be_set():
    assert ELECTRIC.with_parts({"motor": "pm-8kw"}).values["body.m"] == pytest.approx(1144.4 - 91 + 14.1, abs=0.5)
    fixed = ELECTRIC.with_values({"body.m": 1000.0})
    assert fixed.with_values({"motor.torque_scale": 2.0}).values["body.m"] == 1000


@pytest.mark.parametrize("name", [n for n in vehicle_names() if n.startswith("small-car")])
def test_every_small_car_weighs_its_parts(name):
    car = Vehicle.load(name)
    assert "body.m" in car.rules
    assert car.values["body.m"] == pytest.approx(car.rules["body.m"].rest + sum(p.weight for p in car.parameters.values()), abs=0.5)
