from itertools import pairwise

import numpy as np
import pytest

from halfshaft import Cycle, InputError, Vehicle
from halfshaft.cosim.gradient import slopes
from halfshaft.cosim.simulate import parameters_of, stepper_of
from halfshaft.cosim.smooth import smoothed

CYCLE = Cycle.load("nycc")
CAR = Vehicle.load("small-car-electric")


@pytest.fixture(scope="module")
def form():
    return smoothed(CAR, CYCLE)


@pytest.fixture(scope="module")
def exact():
    stepper, samples = stepper_of(CAR), CYCLE.sampled(1.0)
    return stepper.march(samples, parameters_of(CAR, stepper.step, samples.v_start))


def apart(march, exact):
    """How far outputs lie apart at most, over the largest of their unit; and the charge at the end."""
    step = stepper_of(CAR).step
    size = np.abs(exact.history).max(axis=0)
    unit = np.array([max(s for s, other in zip(size, step.outputs, strict=True) if other.unit == d.unit) for d in step.outputs])
    kept = (unit > 0) & [d.kind == "real" for d in step.outputs]
    soc = step.output_index["battery.soc"]
    return np.max(np.abs(march.history - exact.history)[:, kept] / unit[kept]), abs(march.last[soc] / exact.last[soc] - 1)


def test_it_comes_to_the_exact_step_as_the_width_goes_to_zero(form, exact):
    furthest, charge = zip(*(apart(form.march(w), exact) for w in (1e-1, 1e-3, 1e-5, 1e-7)), strict=True)
    assert charge[0] < 2e-3
    assert [a / b for a, b in pairwise(charge)] == pytest.approx([100, 100, 100], rel=0.1)
    # Where a torque passes zero just at the end of a step, a single value comes as the root of the width.
    assert furthest[1] < 1e-2
    assert furthest[3] < 1e-4


def test_it_decides_as_the_exact_run_and_bends_where_both_sides_meet(form, exact):
    """What an electric car decides is whether it stands; whether a machine drives or brakes bends."""
    decided = [form.record.of(op.name) for op in form.form.compared if form.roles[op.name] == "decides"]
    moves = form.record.u[0] + form.record.x[0] > 0
    assert sum(np.array_equal(flag, moves) for flag in decided) > 2
    P = form.step.output_index["motor.P_map"]
    drives = exact.history[:, P] >= 0
    bent = [form.record.of(op.name) for op in form.form.compared if form.roles[op.name] == "bends"]
    assert any(np.array_equal(flag, drives) for flag in bent)


def test_across_a_kink_the_slope_passes_smoothly(form):
    """A motor that is too weak for a step gives what it can; by how much is a bend in the exact step."""
    step, stepper = form.step, stepper_of(CAR)
    k, i = int(np.argmax(np.diff(form.samples.v))) + 1, step.parameter_index["motor.torque_scale"]
    p = form.parameters(0.1)
    x, u = form.record.x[:, k], form.record.u[:, k]

    def slopes_over(scales, smooth):
        speeds = []
        for p[i] in scales:
            if smooth:
                speeds.append(form.compiled(x, np.concatenate([u, form.weights[k]]), p)[0][0])
            else:
                speeds.append(stepper(x, u, p[: len(stepper.step.parameters)])[0][0])
        return np.diff(speeds) / np.diff(scales)

    wide = np.linspace(0.05, 1, 1001)
    bend = wide[np.argmax(np.abs(np.diff(slopes_over(wide, smooth=False)))) + 1]
    near = bend + np.linspace(-0.01, 0.01, 2001)
    exact, smooth = slopes_over(near, smooth=False), slopes_over(near, smooth=True)
    steepest = exact.max()
    assert np.abs(np.diff(exact)).max() > 0.4 * steepest
    assert np.abs(np.diff(smooth)).max() < 0.05 * steepest
    # On both sides of the bend it is nearly the exact one: maps are rounded there as well.
    assert smooth[[0, -1]] == pytest.approx(exact[[0, -1]], abs=2e-2 * steepest)


def test_its_derivatives_come_to_those_of_the_exact_step(form):
    names, wanted = ["motor.torque_scale", "body.c_d", "wheel.r"], [("battery.soc", "last")]
    expected = slopes(CAR, CYCLE, names, wanted).gradient[wanted[0]]
    assert form.slopes(names, wanted, 1e-6).gradient[wanted[0]] == pytest.approx(expected, rel=1e-5)
    found = form.slopes(names, wanted, 1e-2)
    assert found.values[wanted[0]] == form.march(1e-2).last[form.step.output_index["battery.soc"]]
    near = [form.march(1e-2, CAR.with_values({"body.c_d": CAR.values["body.c_d"] + h})).last for h in (-1e-5, 1e-5)]
    slope = (near[1] - near[0])[form.step.output_index["battery.soc"]] / 2e-5
    assert found.gradient[wanted[0]][1] == pytest.approx(slope, rel=1e-6)


def test_relaxed_decisions_come_to_the_exact_step_too(exact):
    form = smoothed(CAR, CYCLE, decisions="relaxed")
    assert apart(form.march(1e-7), exact)[1] < 1e-6


def test_what_is_wrong_is_told_at_once():
    with pytest.raises(InputError) as error:
        smoothed("car", CYCLE, decisions="free")
    assert len(error.value.problems) == 2


def test_what_is_wrong_with_slopes_is_told_at_once(form):
    with pytest.raises(InputError) as error:
        form.slopes(["motor.size"], [("battery.soc", "least"), ("battery.so", "last")], 1e-3)
    assert len(error.value.problems) == 3
