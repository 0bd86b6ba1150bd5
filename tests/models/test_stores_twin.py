"""The compiled step of cars with other stores against the same vehicles by hand, and what every store must do in every powertrain."""

from dataclasses import replace

import numpy as np
import pytest
import twins.vehicles
from twins.fuel_cell import drive
from twins.stores import store_of
from twins.vehicles import TWINS, columns

from halfshaft import Cycle, InputError, Vehicle, run
from halfshaft.library.base.tables import Table

UDDS, US06 = Cycle.load("udds"), Cycle.load("us06")
STORES = ("nimh-7ah-rc", "li-7ah-rc", "uc-2900f", "uc-3000f")
CARS = ("small-car-electric", "small-car-series-follower", "small-car-fuel-cell")
#: What meets other limits of the store, but for the point of its largest power, where a square root takes half of all digits.
VALUES = {
    "as it is": {},
    "nearly empty": {"battery.soc_start": 0.36, "battery.capacity_scale": 0.7},
    "nearly full": {"battery.soc_start": 0.99, "battery.capacity_scale": 1.7},
    "warm": {
        "battery.T_start": 309.0, "battery.T_ambient": 303.0, "battery.T_fan": 309.5, "battery.mass": 0.1, "battery.c_p": 500.0,
        "battery.R_th_fan": 0.2, "battery.R_th_still": 9.0, "battery.airflow": 0.002,
    },
    "window of its own": {"battery.soc_empty": 0.55, "battery.soc_full": 0.72},
    "cold, few": {"battery.T_start": 270.0, "battery.T_ambient": 270.0, "battery.n_modules": 80.0},
}  # fmt: skip


def car_of(car, store, values="as it is"):
    vehicle = Vehicle.load(car).with_parts({"battery": store})
    # Each pack somewhere in the middle, unless it is told otherwise.
    return vehicle.with_values({"battery.soc_start": 0.7, **VALUES[values]})


def by_hand(vehicle, samples):
    return (
        drive(vehicle.parameters, samples)
        if vehicle.powertrain == "fuel_cell"
        else columns(TWINS[vehicle.powertrain](vehicle.parameters, samples))
    )


@pytest.mark.parametrize(("car", "values"), [(CARS[0], values) for values in VALUES] + [(car, "as it is") for car in CARS[1:]])
@pytest.mark.parametrize("store", STORES)
def test_compiled_step_is_the_car_by_hand(car, store, values, monkeypatch):
    monkeypatch.setattr(twins.vehicles, "Battery", store_of)
    vehicle = car_of(car, store, values)
    for cycle in (UDDS, US06) if values == "as it is" else (US06,):
        result, hand = run(vehicle, cycle), by_hand(vehicle, cycle.sampled(1.0))
        units = {d.name: d.unit for d in result.outputs}
        for name, x in hand.items():
            compiled = result[name]
            # What is nothing but rounding is measured by one unit.
            scale = max(np.abs(compiled).max(), 1.0 if units[name] in ("W", "N", "N.m", "m/s") else 1e-12)
            np.testing.assert_allclose(x / scale, compiled / scale, rtol=0, atol=1e-9, err_msg=f"{name}, {cycle.name}")


@pytest.mark.parametrize("mode", ["hybrid", "refined", "iteration"])
@pytest.mark.parametrize("store", STORES)
@pytest.mark.parametrize("car", CARS)
def test_every_store_closes_the_account_in_every_powertrain(car, store, mode):
    result = run(car_of(car, store), US06, mode=mode)
    assert abs(result.account.balance_relative) < 1e-9
    assert min(result.account.losses.values()) > -1e-6
    assert result.summary["pack_energy_J"] > 0


@pytest.mark.parametrize("store", ["li-7ah-rc", "uc-2900f"])
def test_forward_facing_the_store_ends_where_it_ends_in_the_step(store):
    # As long as there is enough in it.
    car = car_of("small-car-electric", store).with_values({"battery.capacity_scale": 3.0})
    short = Cycle(name="start of UDDS", time=UDDS.time[:125], speed=UDDS.speed[:125])
    step, forward = run(car, short, dt=0.1), run(car, short, via="forward")
    assert abs(forward.account.balance_relative) < 1e-6
    used = step["battery.soc"][0] - step["battery.soc"][-1]
    assert used > 0.01
    assert forward["battery.soc"][-1] == pytest.approx(step["battery.soc"][-1], abs=0.01 * used)


@pytest.mark.parametrize("store", STORES)
def test_what_leaves_the_store_is_the_energy_of_its_capacitors(store):
    vehicle = car_of("small-car-series-follower", store)
    p, result = vehicle.parameters["battery"], run(vehicle, US06)
    size, T = p.n_modules * p.capacity_scale, p.T_start
    if "battery.v" in [d.name for d in result.outputs]:
        parts = [(p.C, result["battery.v"], 0.7 * p.u_max)]
    else:
        v = p.u_oc(T, 0.7)
        parts = [(p.C_bulk, result["battery.v_bulk"], v), (p.C_surface, result["battery.v_surface"], v)]
    # The capacity of a warmer cell differs; the work of a step is that at the temperature at its start.
    before = np.concatenate([[T], result["battery.T"][:-1]])
    energy = sum(size * np.array([C(float(x)) for x in before]) * (np.concatenate([[v_0], v[:-1]]) ** 2 - v**2) / 2 for C, v, v_0 in parts)
    np.testing.assert_allclose(result["battery.P_stored"], energy, rtol=1e-9, atol=1e-5)


@pytest.mark.parametrize("store", ["nimh-7ah-rc", "uc-2900f"])
def test_every_parameter_of_a_store_moves_what_is_compared(store):
    still = {n for n in car_of(CARS[0], store).values if n.startswith("battery.")}
    for values in VALUES:
        base = car_of(CARS[0], store, values)
        first = run(base, US06)
        for name in tuple(still):
            # A state of charge may not rise above 1.
            changed = run(base.with_values({name: 0.9 * base.values[name] or 1.0}), US06)
            if any(np.abs(first[d.name] - changed[d.name]).max() > 1e-6 * np.abs(first[d.name]).max() for d in first.outputs):
                still.discard(name)
    assert not still


def test_numbers_and_curves_of_a_store_must_fit():
    for store in ("nimh-7ah-rc", "uc-2900f", "pb-25ah"):
        with pytest.raises(InputError, match=r"soc_empty = 0\.8 must be below soc_full = 0\.7"):
            car_of(CARS[0], store).with_values({"battery.soc_empty": 0.8, "battery.soc_full": 0.7})
        with pytest.raises(InputError, match=r"soc_start = 1\.01, must be >= 0 and <= 1"):
            car_of(CARS[0], store).with_values({"battery.soc_start": 1.01})
    p = car_of(CARS[0], "nimh-7ah-rc").parameters["battery"]
    flat = Table.of(*p.u_oc.points, values=np.full_like(p.u_oc.values, 7.0))
    with pytest.raises(InputError, match="u_oc must rise with the state of charge"):
        replace(p, u_oc=flat)
