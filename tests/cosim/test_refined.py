"""The search of the refined mode: the end speed nearest to the request that is reached when it is asked for."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from halfshaft.cosim.compiled import InterpretedStep
from halfshaft.cosim.cycle import Cycle, Samples, acceleration_cycle
from halfshaft.cosim.simulate import parameters_of, run, stepper_of
from halfshaft.models.vehicle import Vehicle, vehicle_names
from halfshaft.studies.acceleration import prepared, time_to

vehicle_of = cache(Vehicle.load)
ELECTRIC = "small-car-electric"
#: How near refined end speeds are to the best ones [m/s].
CLOSE = 1e-5


def part(samples: Samples, a: int, b: int) -> Samples:
    return samples._replace(**{f: getattr(samples, f)[a:b] for f in ("t", "dt", "v", "grade", "key_on")})


@pytest.mark.parametrize("dt", [0.1, 0.01])
def test_a_heavy_rotor_accelerates_as_in_iteration_at_any_step(dt):
    # Its kink is a jump: where the grip ends, the power of spinning wheels is beyond the battery's.
    car = prepared(vehicle_of(ELECTRIC).with_values({"motor.J": 0.05}))
    refined, best = (time_to(run(car, acceleration_cycle(), dt=dt, mode=mode), 100 / 3.6) for mode in ("refined", "iteration"))
    assert refined == pytest.approx(best, rel=1e-4)


@st.composite
def hills(draw):
    """Return a trace of ramps from rest to 40 m/s over hills of up to 15 %."""
    points = draw(st.lists(st.tuples(st.floats(1, 15), st.floats(0, 40), st.floats(-0.15, 0.15)), min_size=3, max_size=8))
    length, speed, grade = np.array([(1, 0, 0), *points]).T
    return Cycle(name="hills", time=np.cumsum(length) - 1, speed=speed, grade=grade)


@pytest.mark.parametrize(("name", "mu"), [*((name, None) for name in vehicle_names()), (ELECTRIC, 0.1), ("small-car-series-follower", 0.1)])
@settings(max_examples=12, deadline=None, derandomize=True)
@given(cycle=hills(), dt=st.sampled_from([1.0, 0.1, 0.02]))
def test_every_search_finds_what_bisection_finds(name, mu, cycle, dt):
    car = vehicle_of(name) if mu is None else vehicle_of(name).with_values({"wheel.mu_max": mu})
    compiled, samples = stepper_of(car), cycle.sampled(dt)
    parameters, n = parameters_of(car, compiled.step, samples.v_start), len(samples.t)
    v, missed = (compiled.step.state_index[f"body.{s}"] for s in ("v", "trace_missed"))
    assert compiled.march(samples, parameters, mode="refined").unsolved == 0
    state = compiled.first(parameters)
    for a, b in zip(range(0, n, 1 + n // 30), [*range(1 + n // 30, n, 1 + n // 30), n], strict=True):
        # The next step by both from one state, then on to the next place.
        refined, best = (compiled.march(part(samples, a, a + 1), parameters, state=state, mode=m).state for m in ("refined", "iteration"))
        assert refined[v] == pytest.approx(best[v], abs=CLOSE)
        # The memory of (10) speaks of the cycle's request, and only of a vehicle that is too slow for it.
        assert refined[missed] == (samples.v[a] - refined[v] > car.values["body.v_miss"])
        state = compiled.march(part(samples, a, b), parameters, state=state, mode="refined").state


def test_too_fast_is_searched_for_as_well():
    # 15 m/s^2 are asked for; the front wheels hold half of it.
    stop = Cycle(name="stop", time=np.array([0.0, 2.0, 4.0, 10.0]), speed=np.array([30.0, 30.0, 0.0, 0.0]))
    hybrid, refined, best = (run(vehicle_of(ELECTRIC), stop, mode=mode) for mode in ("hybrid", "refined", "iteration"))
    assert best["body.overspeed"].max() > 14
    assert np.abs(refined["body.v"] - best["body.v"]).max() < CLOSE
    assert np.abs(hybrid["body.v"] - best["body.v"]).max() < 0.01
    k = int(np.argmax(best["body.overspeed"]))
    for result in (hybrid, refined, best):
        assert any(f"too fast for the trace by up to {3.6 * result['body.overspeed'][k]:.1f} km/h at t = 4 s" in w for w in result.warnings)
        assert np.array_equal(result["body.overspeed"], -result["body.trace_miss"])
    # Where it stopped at the request's bound, nothing is in error: brakes and drag take what the body gives.
    assert np.abs(best["body.P_limit"]).max() < 1e-3 * np.abs(best["body.P_kinetic"]).max()


def test_steps_without_a_reachable_speed_are_counted_and_said(monkeypatch):
    compiled = stepper_of(vehicle_of(ELECTRIC))
    march = type(compiled).march

    def some_lost(*args, **options):
        done = march(*args, **options)
        assert done.unsolved == 0
        return replace(done, unsolved=3)

    monkeypatch.setattr(type(compiled), "march", some_lost)
    assert any("3 steps reach no speed at all" in w for w in run(vehicle_of(ELECTRIC), acceleration_cycle(), mode="refined").warnings)


def test_a_grade_over_distance_is_read_where_the_car_is():
    # Points before the start, between steps and at the very end of what is driven.
    hill = (np.array([50.0, 100.0, 137.0, 400.0, 420.0]), np.array([0.02, 0.08, -0.03, -0.06, 0.05]))
    cycle = Cycle(name="hill", time=np.array([0.0, 20.0, 60.0]), speed=np.array([0.0, 12.0, 12.0]), grade_by_distance=hill)
    result = run(vehicle_of(ELECTRIC), cycle)
    before = np.append(0.0, result["body.distance"][:-1])
    assert before.max() > 500
    grade = np.interp(before, *hill)
    climbed = np.cumsum(np.diff(np.append(0.0, result["body.distance"])) * grade / np.sqrt(1 + grade**2))
    np.testing.assert_allclose(result["body.elevation"], climbed, rtol=1e-12)
    compiled, samples = stepper_of(vehicle_of(ELECTRIC)), cycle.sampled(1.0)
    alone = InterpretedStep(compiled.step).march(samples, parameters_of(vehicle_of(ELECTRIC), compiled.step))
    np.testing.assert_allclose(alone.history, result.history, rtol=1e-12, atol=1e-9)


def test_a_step_after_a_solved_one_estimates_no_speed():
    hybrid, refined = (run(vehicle_of(ELECTRIC), acceleration_cycle(), dt=0.1, mode=mode) for mode in ("hybrid", "refined"))
    assert refined["body.trace_miss"].max() > 10
    # Equation (10) takes the map at another speed than the shaft's after a miss; a solved step has reached what it asked for.
    assert np.abs(hybrid["motor.P_mismatch"]).max() > 100
    assert np.abs(refined["motor.P_mismatch"]).max() < 1e-6
