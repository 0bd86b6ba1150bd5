import numpy as np
import pytest

from halfshaft.cosim.compiled import InterpretedStep
from halfshaft.cosim.cycle import Cycle
from halfshaft.cosim.simulate import parameters_of, stepper_of
from halfshaft.fmu_build.code import compiled_tables
from halfshaft.library.base.errors import SolveError
from halfshaft.models.assembly import REQUESTED, assemble
from halfshaft.models.vehicle import Vehicle

VEHICLES = {
    "electric": "small-car-electric",
    "series": "small-car-series-follower",
    "conventional": "small-car-conventional",
    "fuel cell": "small-car-fuel-cell",
    "power split": "small-car-power-split",
    "fuel cell by polarisation": "small-car-fuel-cell-polarisation",
}
UDDS = Cycle.load("udds").sampled(1.0)

every_powertrain = pytest.mark.parametrize("powertrain", VEHICLES)


@pytest.fixture(scope="module")
def marches():
    """Return compiled step, parameters and march over UDDS by powertrain."""
    found = {}
    for powertrain, name in VEHICLES.items():
        vehicle = Vehicle.load(name)
        compiled = stepper_of(vehicle)
        parameters = parameters_of(vehicle, compiled.step, UDDS.v_start)
        found[powertrain] = compiled, parameters, compiled.march(UDDS, parameters)
    return found


def request(k):
    return np.array([UDDS.v[k], UDDS.grade[k], UDDS.key_on[k], UDDS.dt[k], 0.0])


@every_powertrain
def test_compiled_step_equals_the_virtual_machine_bit_for_bit(powertrain, marches):
    # The compiler may neither contract nor reorder; the tables are the same code in both.
    compiled, parameters, march = marches[powertrain]
    virtual = InterpretedStep(assemble(Vehicle.load(VEHICLES[powertrain]).model(), functions=compiled_tables)).march(UDDS, parameters)
    differs = np.flatnonzero(np.any(virtual.history != march.history, axis=0))
    assert [compiled.step.outputs[i].name for i in differs] == []
    assert np.array_equal(virtual.state, march.state)


@every_powertrain
def test_step_by_step_is_the_march(powertrain, marches):
    compiled, parameters, march = marches[powertrain]
    x = compiled.first(parameters)
    for k in range(200):
        x, y = compiled(x, request(k), parameters)
        assert np.array_equal(y, march.history[k])


@every_powertrain
def test_a_march_in_two_halves_is_the_march(powertrain, marches):
    compiled, parameters, march = marches[powertrain]
    halves = [
        UDDS._replace(**{f: getattr(UDDS, f)[part] for f in ("t", "dt", "v", "grade", "key_on")})
        for part in (slice(0, 700), slice(700, None))
    ]
    first = compiled.march(halves[0], parameters)
    second = compiled.march(halves[1], parameters, state=first.state)
    assert np.array_equal(second.state, march.state)
    assert np.array_equal(np.vstack([first.history, second.history]), march.history)


@every_powertrain
def test_sums_and_maxima_are_those_of_the_history(powertrain, marches):
    _, _, march = marches[powertrain]
    # Another order of summation.
    np.testing.assert_allclose(march.sums, march.history.T @ UDDS.dt, rtol=1e-10, atol=1e-9)
    assert np.array_equal(march.highest, march.history.max(axis=0))


@every_powertrain
def test_without_a_compiler_the_step_is_the_same_to_rounding(powertrain, marches):
    _, parameters, march = marches[powertrain]
    alone = InterpretedStep(assemble(Vehicle.load(VEHICLES[powertrain]).model())).march(UDDS, parameters)
    # Interpolants round otherwise than the C; nothing in a cycle amplifies that.
    scale = np.abs(march.history).max(axis=0).clip(1)
    np.testing.assert_allclose(alone.history / scale, march.history / scale, rtol=0, atol=1e-9)
    assert alone.state == pytest.approx(march.state, rel=1e-9, abs=1e-9)


@every_powertrain
def test_every_variable_has_a_name_of_its_own_a_unit_and_a_meaning(powertrain, marches):
    step = marches[powertrain][0].step
    for described in (step.states, step.requests, step.parameters, step.outputs):
        names = [d.name for d in described]
        assert len(names) == len(set(names))
        assert [d.name for d in described if not d.unit or len(d.doc) < 4] == []
    # A state that is shown is an output of the same name; else a name means one thing.
    shown = {d.name for d in step.outputs if d.state is not None}
    everything = [d.name for described in (step.states, step.requests, step.parameters, step.outputs) for d in described]
    assert {n for n in everything if everything.count(n) > 1} == shown


@every_powertrain
def test_an_output_that_shows_a_state_has_its_next_value(powertrain, marches):
    compiled, _, march = marches[powertrain]
    for i, d in enumerate(compiled.step.outputs):
        if d.state is not None:
            assert march.history[-1, i] == march.state[d.state]
            assert compiled.step.states[d.state].name == d.name


@every_powertrain
def test_the_vectors_fit_their_descriptions(powertrain, marches):
    step = marches[powertrain][0].step
    assert step.function.size1_in("state") == len(step.states) == step.function.size1_out("next_state")
    assert step.function.size1_in("request") == len(step.requests) == len(REQUESTED)
    assert step.function.size1_in("parameters") == len(step.parameters)
    assert step.function.size1_out("outputs") == len(step.outputs)


def refused(stepper, state, request, parameters):
    try:
        stepper(state, request, parameters)
    except SolveError:
        return True
    return False


@every_powertrain
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_request_that_is_not_a_number_is_refused(powertrain, value, marches):
    compiled, parameters, march = marches[powertrain]
    for stepper in (compiled, InterpretedStep(compiled.step)):
        for i, d in enumerate(REQUESTED):
            u = request(190)
            u[i] = value
            assert refused(stepper, march.state, u, parameters), d.name


@every_powertrain
@pytest.mark.parametrize("made_by", ["compiler", "virtual machine"])
@pytest.mark.parametrize("where", ["states", "parameters"])
def test_no_state_or_parameter_that_is_not_a_number_goes_unseen(powertrain, made_by, where, marches):
    compiled, parameters, _ = marches[powertrain]
    stepper = compiled if made_by == "compiler" else InterpretedStep(compiled.step)
    state = compiled.first(parameters)
    for k in range(190):
        state, _ = compiled(state, request(k), parameters)
    unseen = []
    for i, d in enumerate(getattr(compiled.step, where)):
        x, p = state.copy(), parameters.copy()
        (x if where == "states" else p)[i] = np.nan
        if not refused(stepper, x, request(190), p):
            unseen.append(d.name)
    assert unseen == []


@every_powertrain
def test_a_lost_number_stops_the_march_and_says_when(powertrain, marches):
    compiled, parameters, _ = marches[powertrain]
    v = UDDS.v.copy()
    v[99] = np.nan
    for stepper in (compiled, InterpretedStep(compiled.step)):
        with pytest.raises(SolveError, match=r"by t = 100 s a result is not a number"):
            stepper.march(UDDS._replace(v=v), parameters)


@every_powertrain
def test_a_march_with_a_parameter_that_is_not_a_number_is_refused(powertrain, marches):
    compiled, parameters, _ = marches[powertrain]
    unseen = []
    for i, d in enumerate(compiled.step.parameters):
        p = parameters.copy()
        p[i] = np.nan
        try:
            compiled.march(UDDS, p)
            unseen.append(d.name)
        except SolveError:
            pass
    assert unseen == []
