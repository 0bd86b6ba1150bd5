"""What the bounds of numbers allow can be run: finite outputs, sane speeds and a closed account, at every edge."""

import random
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from halfshaft.cosim.cycle import Cycle
from halfshaft.cosim.simulate import run
from halfshaft.library.base.errors import InputError
from halfshaft.library.files.component_file import component_names
from halfshaft.models.vehicle import Vehicle, vehicle_names

US06 = Cycle.load("us06")
#: The start of the hardest cycle: rest, full acceleration, 48 m/s^2 of braking in all.
TRACE = replace(US06, time=US06.time[:200], speed=US06.speed[:200])
#: Pairs and triples of edges, for each vehicle.
MIXED = 20


def edges(spec):
    low = np.nextafter(spec.gt, np.inf) if spec.ge is None and spec.gt is not None else spec.ge
    high = np.nextafter(spec.lt, -np.inf) if spec.le is None and spec.lt is not None else spec.le
    return low, high


def runs_well(car, values):
    """Return whether a run is as it should be; False where the numbers are refused together."""
    try:
        result = run(car.with_values(values), TRACE)
    except InputError:
        return False
    assert np.all(np.isfinite(result.history)), values
    assert result["body.v"].min() >= 0, values
    # Nothing pushes a car beyond its trace but a hill.
    assert result["body.v"].max() <= TRACE.speed.max() + 1e-6, values
    assert abs(result.account.balance_relative) < 1e-6, values
    return True


#: Cars of other parts than those before them.
DIFFERENT = list({tuple((role, part.kind) for role, part in Vehicle.load(n).parts.items()): n for n in reversed(vehicle_names())}.values())


@pytest.mark.parametrize("name", DIFFERENT)
def test_numbers_at_the_edges_of_their_bounds_run_or_are_refused(name):
    car = Vehicle.load(name)
    ends = {name: edges(spec) for name, spec in car.specs.items()}
    assert not [name for name, pair in ends.items() if None in pair]
    ran = {name: [runs_well(car, {name: float(x)}) for x in pair] for name, pair in ends.items()}
    # What is refused contradicts another number, such as the window of the charge, at one end only; but a motor's top speed, by which the
    # gear ratio is derived, and a number between two others.
    neither = {name.partition(".")[2] for name, either in ran.items() if not any(either)}
    assert neither <= {"omega_max", "soc_assist"}
    rng = random.Random(name)
    for _ in range(MIXED):
        runs_well(car, {x: float(rng.choice(ends[x])) for x in rng.sample(sorted(ends), rng.choice([2, 3]))})


@cache
def series():
    return Vehicle.load("small-car-series")


@pytest.mark.parametrize("generator", component_names("generator"))
@pytest.mark.parametrize("engine", component_names("engine"))
def test_every_pair_of_engine_and_generator_has_a_locus(engine, generator):
    locus = series().with_parts({"engine": engine, "generator": generator}).parameters["control"].omega_locus
    speeds = component_speeds(engine)
    assert np.all(np.diff(locus.points[0]) > 0)
    assert locus.values.min() >= speeds[0]
    assert locus.values.max() <= speeds[-1]


@cache
def component_speeds(engine):
    return series().with_parts({"engine": engine}).parameters["engine"].fuel.points[0]


@pytest.mark.parametrize("generator", component_names("generator"))
def test_an_engine_too_strong_for_its_generator_runs(generator):
    car = series().with_parts({"engine": "ci-330kw", "generator": generator}).with_values({"battery.soc_start": 0.3})
    result = run(car, TRACE)
    assert result["engine.fuel_used"][-1] > 0
    assert np.all(np.isfinite(result.history))


def test_machines_without_a_speed_in_common_are_refused():
    with pytest.raises(InputError, match=r"control.omega_locus: engine and generator have no range of speeds in common: engine 104 to"):
        series().with_values({"generator.speed_scale": 0.1})
