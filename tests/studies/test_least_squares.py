"""Least squares, its statistics, and what it says that the data cannot tell."""

import numpy as np
import pytest
from scipy.optimize import curve_fit

from halfshaft.library.base.errors import InputError
from halfshaft.studies.calibration.least_squares import LOSSES, Measured, Unknown, fit

TIME = np.linspace(0, 5, 80)
TRUTH = np.array([2.0, 0.7, 0.3])
UNKNOWNS = (Unknown("a", "1", 1.0, 0.0, 10.0, 10.0), Unknown("b", "1/s", 0.2, 0.0, 5.0, 5.0), Unknown("c", "1", 0.0, -1.0, 1.0, 2.0))


def decay(x):
    a, b, c = x
    fall = np.exp(-b * TIME)
    return a * fall + c, np.column_stack([fall, -a * TIME * fall, np.ones_like(TIME)])


def noisy(seed, size=0.05):
    return decay(TRUTH)[0] + size * np.random.default_rng(seed).normal(size=len(TIME))


@pytest.mark.parametrize("stated", [True, False])
def test_values_and_covariance_are_those_of_scipy(stated):
    y, sigma = noisy(1), np.full(len(TIME), 0.05)
    found = fit(UNKNOWNS, decay, [Measured("y", y, sigma if stated else None)])
    curve = lambda t, a, b, c: a * np.exp(-b * t) + c  # noqa: E731
    x, covariance = curve_fit(curve, TIME, y, [1.0, 0.2, 0.0], sigma if stated else None, absolute_sigma=stated)
    np.testing.assert_allclose(found.x, x, rtol=1e-6)
    # scipy differentiates by differences, and ends earlier.
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-4)
    assert found.converged
    assert (found.doubts, found.blind) == ((), ())


def test_two_instruments_get_uncertainties_of_their_own():
    draw = np.random.default_rng(3)
    model = lambda x: tuple(np.concatenate([part, part]) for part in decay(x))  # noqa: E731
    good, bad = (decay(TRUTH)[0] + size * draw.normal(size=len(TIME)) for size in (0.01, 0.3))
    found = fit(UNKNOWNS, model, [Measured("good", good), Measured("bad", bad)])
    spread = [found.sigma[found.rows(i)][0] for i in (0, 1)]
    # The standard deviation of 80 numbers is known to 8 %.
    assert spread == pytest.approx([0.01, 0.3], rel=0.25)
    assert found.dof == pytest.approx(2 * len(TIME) - 3)
    assert np.all(np.abs(found.x - TRUTH) < 4 * found.std)


@pytest.mark.parametrize("loss", [loss for loss in LOSSES if loss != "linear"])
def test_outliers_count_less_with_a_robust_loss(loss):
    y = noisy(2)
    y[::10] += 3.0
    plain, robust = (fit(UNKNOWNS, decay, [Measured("y", y)], how) for how in ("linear", loss))
    assert np.all(np.abs(robust.x - TRUTH) < 5 * robust.std)
    assert np.linalg.norm(robust.x - TRUTH) < 0.2 * np.linalg.norm(plain.x - TRUTH)


@pytest.mark.parametrize("loss", ["linear", "soft_l1"])
def test_intervals_hold_the_truth_as_often_as_they_say(loss):
    inside = np.mean([
        [low <= x <= high for x, (low, high) in zip(TRUTH, fit(UNKNOWNS, decay, [Measured("y", noisy(seed))], loss).intervals, strict=True)]
        for seed in range(25)
    ])  # fmt: skip
    # 75 of them, three of one draw: the share's standard deviation is 3 % or a little more.
    assert 0.86 <= inside <= 1.0


def test_what_cannot_be_told_apart_is_named_with_what_makes_up_for_it():
    def product(x):
        a, b, c, _ = x
        fall = np.exp(-0.7 * TIME)
        return a * b**2 * fall + c, np.column_stack([b**2 * fall, 2 * a * b * fall, np.ones_like(TIME), 0 * TIME])

    start = (Unknown("a", "1", 1.0, 0.0, 10.0, 10.0), Unknown("b", "1", 1.0, 0.1, 5.0, 5.0), UNKNOWNS[2], Unknown("d", "m", 0.0, -1.0, 1.0))
    found = fit(start, product, [Measured("y", noisy(1))])
    dead, pair = found.blind
    assert dead == "d changes nothing that was measured"
    # 2 % of a is what 1 % of b does, whichever is named first.
    assert pair in (
        "a and b cannot be told apart: less of b by 0.5 % makes up for 1 % more of a",
        "b and a cannot be told apart: less of a by 2 % makes up for 1 % more of b",
    )
    assert np.isinf(found.std).tolist() == [True, True, False, True]
    assert found.std[2] < 0.1


def test_a_weak_parameter_is_said_to_be_hardly_told():
    def weak(x):
        return decay([x[0], 0.7, 0.3])[0] + 3e-5 * x[1] * TIME, np.column_stack([np.exp(-0.7 * TIME), 3e-5 * TIME])

    found = fit((UNKNOWNS[0], Unknown("slope", "1/s", 0.0, -100.0, 100.0, 200.0)), weak, [Measured("y", noisy(1))])
    assert found.blind == ("slope is hardly told: its interval is as wide as its range",)


def test_a_bound_wrong_uncertainties_and_a_wrong_model_are_told():
    at_bound = (UNKNOWNS[0], UNKNOWNS[1], Unknown("c", "1", 0.0, -1.0, 0.1, 1.1))
    found = fit(at_bound, decay, [Measured("y", noisy(1), np.full(len(TIME), 0.01))])
    bound, wrong, serial = found.doubts
    assert bound == "c stands at its highest allowed value, 0.1, and has no interval"
    assert found.intervals[2].tolist() == [found.x[2]] * 2
    assert "times as large as the stated uncertainty says" in wrong
    assert "follow one another" in serial


def test_too_little_data_are_refused():
    few = lambda x: tuple(part[:3] for part in decay(x))  # noqa: E731
    with pytest.raises(InputError, match="3 measurements for 3 parameters, there must be more"):
        fit(UNKNOWNS, few, [Measured("y", np.ones(3))])
    with pytest.raises(InputError, match="must be one of linear, soft_l1, huber, cauchy"):
        fit(UNKNOWNS, decay, [Measured("y", noisy(1))], "square")
    both = lambda x: tuple(np.concatenate([part, part[:1]]) for part in decay(x))  # noqa: E731
    with pytest.raises(InputError, match="total: 1 rows do not tell their own uncertainty"):
        fit(UNKNOWNS, both, [Measured("y", noisy(1)), Measured("total", np.array([50.0]))])
