import math

import pytest

from halfshaft.studies.search import by_halving, by_root


class Scripted:
    """A margin that is known, and what was asked of it."""

    def __init__(self, margin):
        self.margin, self.asked = margin, []

    def __call__(self, k):
        assert isinstance(k, int)
        self.asked.append(k)
        return self.margin(k)


@pytest.mark.parametrize("start", [5, 310, 337, 338, 500, 4000])
@pytest.mark.parametrize("shape", [lambda x: x, lambda x: math.copysign(1, x), lambda x: x**3, lambda x: min(x, 0.01)])
def test_the_root_is_the_smallest_number_that_does(start, shape):
    margin = Scripted(lambda k: shape((k - 337.6) / 337.6))
    assert by_root(margin, 5, 4000, start) == (338, True)
    assert {337, 338} <= set(margin.asked)


def test_the_root_of_a_smooth_margin_takes_fewer_trials_than_halving():
    smooth, halved = (Scripted(lambda k: 1 - 650 / k) for _ in range(2))
    assert by_root(smooth, 100, 10000, 1000) == (650, True)
    assert by_halving(halved, 100, 10000).does
    assert len(set(smooth.asked)) < len(set(halved.asked))


def test_a_margin_of_exactly_nothing_does():
    assert by_root(lambda k: float(k - 40), 1, 100, 70) == (40, True)
    assert by_root(lambda k: max(0.0, k - 60) if k >= 40 else -1.0, 1, 100, 70) == (40, True)


@pytest.mark.parametrize("find", [by_root, by_halving])
def test_the_lowest_is_enough_or_the_highest_is_not(find):
    assert find(lambda k: 1.0, 13, 60, 25) == (13, True)
    assert find(lambda k: -1 / k, 13, 60, 25) == (60, False)


def test_what_nothing_reaches_is_best_where_the_margin_is_largest():
    tried = Scripted(lambda k: -1 - abs(k - 40) / 40)
    found = by_root(tried, 13, 100, 25)
    assert not found.does
    assert abs(found.k - 40) <= 0.3 * 40
    # Where nothing helps, the smallest is as good as any.
    assert by_root(lambda k: -1.0, 13, 100, 25) == (13, False)


def test_halving_ends_within_the_slack_or_after_ten_steps():
    rough = Scripted(lambda k: k / 1000 - 1)
    found = by_halving(rough, 0, 4000, slack=0.05)
    assert 0 <= rough(found.k) <= 0.05
    assert len(rough.asked) < 8
    fine = Scripted(lambda k: k / 1000 - 1)
    found = by_halving(fine, 0, 40000)
    assert len(fine.asked) == 2 + 10
    assert 1000 <= found.k < 1000 + 40000 / 2**10 + 1
