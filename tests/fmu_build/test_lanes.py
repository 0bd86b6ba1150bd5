"""Lanes against the scalar march, to the last bit: on every powertrain, whatever the lanes drive and whether they come to an end."""

import numpy as np
import pytest

from halfshaft import Cycle, Vehicle
from halfshaft.cosim.simulate import parameters_of, stepper_of
from halfshaft.fmu_build import lanes
from halfshaft.models.vehicle import vehicle_names
from halfshaft.studies import batch

#: Not a whole number of groups, so that the last one is filled up; and some runs that begin without a number.
RUNS, LOST = 29, [4, 20, 21]
HILL = Cycle(
    name="hill", time=[0.0, 30.0, 90.0, 120.0], speed=[0.0, 22.0, 22.0, 0.0],
    grade_by_distance=([0.0, 300.0, 600.0, 5000.0], [0.0, 0.07, -0.05, 0.02]),
)  # fmt: skip
PARKED = Cycle(name="parked", time=[0.0, 8.0, 21.0, 40.0], speed=[5.0, 14.0, 0.0, 0.0], key_on=[1.0, 1.0, 0.0, 0.0])
CYCLES = (Cycle.load("us06").scaled(1.2), HILL, PARKED, Cycle.load("nedc"))
ENDS = {"body.m": (700, 6000), "body.c_d": (0.2, 0.6), "motor.torque_scale": (0.3, 1.5), "engine.torque_scale": (0.4, 1.5)}


def first_of_each():
    powertrains = {Vehicle.load(name).powertrain: name for name in reversed(vehicle_names())}
    return sorted(powertrains.values())


def bits(x):
    return np.ascontiguousarray(x, dtype=float).view(np.int64)


def check(name, mode, dt, width, monkeypatch):
    """Hold a batch in lanes of a width against marches of its runs, one by one."""
    monkeypatch.setattr(batch, "widths", lambda: (width,))
    car, rng = Vehicle.load(name), np.random.default_rng(3)
    values = {number: rng.uniform(*ends, RUNS) for number, ends in ENDS.items() if number in car.values}
    cycles = [CYCLES[i] for i in rng.integers(0, len(CYCLES), RUNS)]
    compiled = stepper_of(car)
    step = compiled.step
    state = next(d.name for d in step.states if d.tag in ("charge", "fuel mass"))
    begin = np.full(RUNS, 0.6 if step.tags.all_of("charge") else 0.0)
    begin[LOST] = np.nan
    outputs = [d.name for d in step.outputs]
    summary = {output: ["integral", "max", "min", "last"] for output in outputs}
    found = batch.run_batch(car, values, cycles, mode=mode, dt=dt, initial={state: begin}, summary=summary, history=outputs[::7])
    assert np.flatnonzero(found.status).tolist() == LOST
    columns = {how: np.column_stack([found[f"{output}.{how}"].values for output in outputs]) for how in ("integral", "max", "min", "last")}
    histories = np.stack([found[output].values for output in outputs[::7]], axis=-1)
    missed = 0
    for i in set(range(RUNS)) - set(LOST):
        samples = cycles[i].sampled(dt)
        parameters = parameters_of(car.with_values({number: float(x[i]) for number, x in values.items()}), step, samples.v_start)
        first = compiled.first(parameters)
        first[step.state_index[state]] = begin[i]
        march = compiled.march(samples, parameters, first, mode)
        for how, x in (("integral", march.sums), ("max", march.highest), ("last", march.last)):
            assert np.array_equal(bits(columns[how][i]), bits(x))
        assert np.array_equal(columns["min"][i], march.history.min(axis=0))
        assert np.array_equal(bits(histories[i, : len(samples.t)]), bits(march.history[:, ::7]))
        assert mode == "hybrid" or found.unsolved[i] == march.unsolved
        missed += march.highest[step.output_index[step.tags.the("miss")]] > 0.1
    # Some of them are too weak for their cycles.
    assert 0 < missed < RUNS - len(LOST)


@pytest.mark.skipif(not lanes.widths(), reason="the processor has no wide vectors")
@pytest.mark.parametrize("name", first_of_each())
@pytest.mark.parametrize("mode", ["hybrid", "refined"])
def test_each_lane_has_the_bits_of_a_scalar_march(name, mode, monkeypatch):
    check(name, mode, 1.0, lanes.widths()[0], monkeypatch)


@pytest.mark.skipif(len(lanes.widths()) < 2, reason="the processor has vectors of one width at most")
@pytest.mark.parametrize("name", ["small-car-series", "small-car-automatic"])
def test_so_it_has_in_narrower_vectors_and_odd_steps(name, monkeypatch):
    check(name, "iteration", 0.7, lanes.widths()[1], monkeypatch)


@pytest.mark.skipif(not lanes.widths(), reason="the processor has no wide vectors")
def test_so_it_has_where_steps_are_no_power_of_two(monkeypatch):
    check("small-car-electric", "refined", 0.3, lanes.widths()[0], monkeypatch)
