"""Batches against single runs: the same numbers to the last bit, whatever the vehicles differ in."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from halfshaft import Cycle, InputError, Vehicle, run
from halfshaft.studies.batch import run_batch

RNG = np.random.default_rng(1)
CAR = Vehicle.load("small-car-electric")
SHORT = Cycle(name="short", time=[0.0, 10.0, 25.0, 40.0], speed=[0.0, 12.0, 25.0, 0.0])


def spread(vehicle, n):
    """Return values that make `n` vehicles: heavy and light, strong and weak."""
    names = {"body.m": (800, 3000), "body.c_d": (0.2, 0.6), "motor.torque_scale": (0.3, 1.5), "engine.torque_scale": (0.4, 1.5)}
    return {name: RNG.uniform(*ends, n) for name, ends in names.items() if name in vehicle.values}


def single(vehicle, values, i):
    return vehicle.with_values({name: float(x[i]) for name, x in values.items()})


@pytest.mark.parametrize(
    "name",
    [
        "small-car-electric",
        "small-car-conventional",
        "small-car-fuel-cell",
        "small-car-series",
        "small-car-two-motor",
        "small-car-power-split",
    ],
)
def test_figures_are_those_of_single_runs(name):
    car = Vehicle.load(name)
    values = spread(car, 5)
    found = run_batch(car, values, Cycle.load("us06"))
    for i in range(5):
        figures = run(single(car, values, i), Cycle.load("us06"), history=False).figures
        left_out = {"balance_relative", "speed_mismatch_relative", "fuel_equivalent_basis"}
        expected = {k: x for k, x in figures.items() if k not in left_out and x is not None}
        assert expected == {k: float(found[k][i]) for k in expected}
        assert all(k in expected or np.isnan(x[i]) for k, x in found.items() if k in figures)
    assert not found.status.any()


@pytest.mark.parametrize("mode", ["refined", "iteration"])
def test_summaries_and_histories_are_those_of_single_runs(mode):
    values = spread(CAR, 4)
    cycle = Cycle.load("us06").scaled(1.3)
    asked = ["integral", "max", "min", "last", 60.0, 599.5]
    found = run_batch(CAR, values, cycle, mode=mode, summary={"motor.P_in": asked, "body.v": "first"}, history=["body.v", "motor.P_in"])
    for i in range(4):
        result = run(single(CAR, values, i), cycle, mode=mode)
        power = result["motor.P_in"]
        assert np.array_equal(found["body.v"][i], result["body.v"])
        assert np.array_equal(found["motor.P_in"][i], power)
        in_c = run(single(CAR, values, i), cycle, mode=mode, history=False)
        assert found["motor.P_in.integral"][i] == in_c.energies["motor.P_in"]
        assert found["motor.P_in.max"][i] == power.max()
        assert found["motor.P_in.min"][i] == power.min()
        assert found["motor.P_in.last"][i] == power[-1]
        assert found["motor.P_in.at_60s"][i] == power[59]
        assert found["motor.P_in.at_599.5s"][i] == power[599]
        assert found["body.v.first"][i] == 0
    assert set(found.data_vars) >= {"unsolved", "status"}
    assert found["motor.P_in.integral"].units == "J"


def test_each_run_may_have_a_cycle_of_its_own():
    cycles = [SHORT, Cycle.load("udds"), SHORT.scaled(0.5)]
    found = run_batch(CAR, {"body.m": [900.0, 1200.0, 1500.0]}, cycles, history=["body.v"])
    for i, cycle in enumerate(cycles):
        result = run(CAR.with_values({"body.m": float(found["body.m"][i])}), cycle)
        n = len(result.time)
        assert found.distance_m[i] == result.figures["distance_m"]
        assert found.duration_s[i] == cycle.duration
        assert np.array_equal(found["body.v"][i, :n], result["body.v"])
        assert np.array_equal(found["time"][i, :n], result.time)
        assert np.isnan(found["body.v"][i, n:]).all()


def test_a_number_that_is_lost_is_lost_in_its_run_alone():
    start = np.full(20, 0.7)
    start[[3, 11]] = np.nan
    found = run_batch(CAR, {"body.m": np.linspace(900, 1500, 20)}, SHORT, initial={"battery.soc": start}, history=["body.v"])
    assert np.flatnonzero(found.status).tolist() == [3, 11]
    assert np.isfinite(found.lost_by.values).tolist() == (found.status.values == 1).tolist()
    assert np.isnan(found.distance_m[[3, 11]]).all()
    assert np.isnan(found["body.v"][3]).all()
    sound = found.isel(run=[i for i in range(20) if i not in (3, 11)])
    alone = run_batch(CAR, {"body.m": sound["body.m"].values}, SHORT, initial={"battery.soc": 0.7}, history=["body.v"])
    for name in alone.data_vars:
        assert np.array_equal(alone[name], sound[name], equal_nan=True)


def test_any_number_of_threads_gives_the_same():
    values = spread(CAR, 50)
    one, three = (run_batch(CAR, values, SHORT, threads=n) for n in (1, 3))
    assert one.identical(three)


def test_a_dataset_spreads_over_its_dimensions():
    values = xr.Dataset({"body.m": ("mass", [900.0, 1100.0, 1300.0]), "body.c_d": ("drag", [0.2, 0.3])}, {"mass": [1, 2, 3]})
    found = run_batch(CAR, values, SHORT)
    assert found.distance_m.shape == (3, 2)
    lone = run(CAR.with_values({"body.m": 1300.0, "body.c_d": 0.3}), SHORT, history=False)
    assert found.energy_from_battery_J[2, 1] == lone.figures["energy_from_battery_J"]


def test_rules_and_ratings_follow_for_all():
    car = Vehicle.load("small-car-series")
    values = {"motor.P_max": np.array([40e3, 75e3]), "wheel.r": np.array([0.25, 0.3]), "battery.n_modules": np.array([20.0, 30.0])}
    fleet = car.with_arrays(values)
    for i in range(2):
        one = single(car, values, i)
        assert {k: float(np.broadcast_to(x, 2)[i]) for k, x in fleet.values.items()} == one.values
    assert len(set(fleet.values["body.m"])) == 2


def test_everything_that_is_wrong_is_said_at_once():
    m = np.full(30, 1000.0)
    m[7], m[9] = -5.0, np.nan
    with pytest.raises(InputError) as caught:
        run_batch(CAR, {"body.m": m, "body.mas": np.ones(30), "wheel.r": 0.0}, SHORT)
    text = str(caught.value)
    assert "body.mas is not known" in text
    assert "wheel.r = 0, must be" in text
    assert "body.m = -5 kg at index 7 and 1 more" in text
    with pytest.raises(InputError) as caught:
        run_batch(CAR, {"body.m": m, "body.h": np.linspace(0.1, 9, 30), "battery.soc_empty": np.full(30, 0.99)}, SHORT)
    text = str(caught.value)
    assert "body.m = -5 kg at index 7 and 1 more, must be >= 10 kg" in text
    assert "must be below half of wheelbase" in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"values": {"body.m": [1.0, 2.0], "body.c_d": [0.1]}}, "not of one length: body.m has 2 entries, body.c_d has 1"),
        ({"values": {"body.m": [[1.0, 2.0]]}}, r"body.m has the shape \(1, 2\)"),
        ({"values": {"body.m": ["heavy", "light"]}}, "body.m must be a number, or a row"),
        ({"values": {"motor.P_electric": np.ones(3)}}, "motor.P_electric is a map"),
        ({"cycle": [SHORT, SHORT]}, "not of one length"),
        ({"cycle": []}, "there are no cycles"),
        ({"cycle": "udds"}, "cycle must be a Cycle"),
        ({"cycle": Cycle(name="point", time=[0.0], speed=[0.0])}, "cycle point has no step"),
        ({"mode": "fast"}, "mode = 'fast'"),
        ({"dt": 0}, "dt = 0 s"),
        ({"threads": 0}, "threads = 0"),
        ({"summary": {"body.speed": "max"}}, "body.speed is no output"),
        ({"summary": {"body.v": "mean"}}, "'mean' must be a time or one of integral"),
        ({"summary": {"motor.P_in": "first"}}, "motor.P_in shows no state"),
        ({"summary": {"body.v": np.inf}}, "a time must be a finite number"),
        ({"history": ["body.vv"]}, "body.vv is no output, did you mean 'body.v'"),
        ({"initial": {"battery.charge": 0.5}}, "battery.charge is no state"),
        ({"initial": {"battery.soc": np.inf}}, "must start at a finite number"),
        ({"vehicle": "car"}, "vehicle must be a Vehicle"),
    ],
)
def test_what_cannot_be_run_is_said(arguments, message):
    with pytest.raises(InputError, match=message):
        run_batch(**{"vehicle": CAR, "values": {"body.m": [1000.0, 1100.0, 1200.0]}, "cycle": SHORT, **arguments})


def test_another_process_finds_the_code_of_this_one(tmp_path):
    text = """if True:
        from halfshaft import Cycle, Vehicle, run_batch
        cycle = Cycle(name="short", time=[0.0, 5.0], speed=[0.0, 5.0])
        summary = {name: ["integral", "max"] for name in ("motor.P_in", "body.v", "battery.soc")}
        run_batch(Vehicle.load("small-car-electric"), {"body.m": [1000.0, 1100.0]}, cycle, summary=summary)
    """
    found = []
    for seed in ("1", "2"):
        environment = {**os.environ, "HALFSHAFT_CACHE": str(tmp_path), "PYTHONHASHSEED": seed}
        subprocess.run([sys.executable, "-c", text], env=environment, check=True)
        found.append(sorted(path.name for path in tmp_path.iterdir()))
    assert found[0] == found[1] != []


def test_one_run_needs_no_arrays():
    assert run_batch(CAR, {"body.m": "1.2 t"}, SHORT).distance_m.shape == (1,)


def test_a_map_that_a_rule_makes_follows_for_each_run():
    car = Vehicle.load("small-car-series")
    values = {"generator.torque_scale": np.linspace(0.3, 0.9, 6), "battery.soc_start": np.full(6, 0.45)}
    found = run_batch(car, values, Cycle.load("us06"))
    assert len({run_of.parameters["control"].omega_locus.key for run_of in (single(car, values, i) for i in range(6))}) > 1
    for i in range(6):
        figures = run(single(car, values, i), Cycle.load("us06"), history=False).figures
        assert found.fuel_L[i] == figures["fuel_L"] > 0
        assert found.soc_end[i] == figures["soc_end"]


def test_examples_of_the_manual_run():
    page = (Path(__file__).parents[2] / "docs" / "batches.md").read_text()
    space = {}
    for block in re.findall(r"^```python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL):
        exec(compile(block, "batches.md", "exec"), space)
    assert space["found"]["body.v.at_100s"].shape == (1000,)
