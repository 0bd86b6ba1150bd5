import numpy as np

from halfshaft import Cycle, Vehicle
from halfshaft.cosim.simulate import parameters_of, stepper_of
from halfshaft.fmu_build.evaluate import evaluate, of_names
from halfshaft.fmu_build.graph import step_graph


def test_arrays_have_the_bits_of_the_compiled_step():
    car, samples = Vehicle.load("small-car-electric"), Cycle.load("us06").sampled(1.0)
    stepper = stepper_of(car)
    p, n = parameters_of(car, stepper.step, samples.v_start), 200
    u = np.zeros((n, 5))
    u[:, 0], u[:, 2], u[:, 3] = samples.v[:n], 1, 1
    x, states, following, outputs = stepper.first(p), [], [], []
    for request in u:
        states.append(x)
        x, y = stepper(x, request, p)
        following.append(x)
        outputs.append(y)
    found = step_graph(stepper.step)
    values = evaluate(found, np.array(states).T, u.T, p)
    assert np.array_equal(of_names(values, found.following, n).T, following)
    assert np.array_equal(of_names(values, found.outputs, n).T, outputs)


def test_a_value_can_be_given_for_some_columns():
    car = Vehicle.load("small-car-electric")
    stepper = stepper_of(car)
    found, p = step_graph(stepper.step), parameters_of(car, stepper.step)
    x, u = np.column_stack([stepper.first(p)] * 2), np.column_stack([[1.0, 0.0, 1.0, 1.0, 0.0]] * 2)
    flag = next(op.name for op in found.stepped if op.kind == "flag" and evaluate(found, x, u, p)[op.name].all())
    turned = evaluate(found, x, u, p, {flag: np.array([np.nan, 0.0])})[flag]
    assert turned.tolist() == [1.0, 0.0]
