"""Recordings: noise and gaps are laid over a cycle that is known, and it is found again."""

import numpy as np
import pytest

from halfshaft import Cycle, InputError
from halfshaft.cosim.recording import gaps, restored

UDDS = Cycle.load("udds")


def recorded(cycle, *, noise=0.2, holes=((300.0, 304.0), (340.0, 345.0)), seed=1):
    """Return what a receiver of 10 Hz writes: noise, no negative speeds, wild points, single points and whole times lost."""
    rng = np.random.default_rng(seed)
    t = np.arange(0, cycle.duration + 0.01, 0.1)
    v = np.interp(t, cycle.time, cycle.speed) + rng.normal(0, noise, len(t))
    wild = rng.random(len(t)) < 0.003
    v[wild] += rng.normal(0, 6, wild.sum())
    kept = rng.random(len(t)) > 0.02
    for begin, end in holes:
        kept &= ~((t > begin) & (t < end))
    kept[[0, -1]] = True
    return Cycle(name="recorded", time=t[kept], speed=np.clip(np.abs(v[kept]), 0, 60))


@pytest.mark.parametrize(("noise", "rms", "seed"), [(0.1, 0.05, 1), (0.2, 0.075, 2), (0.3, 0.11, 3)])
def test_the_truth_is_found_under_noise_and_dropouts(noise, rms, seed):
    given = recorded(UDDS, noise=noise, seed=seed)
    assert given.statistics().stops == 0
    assert given.doubts
    found, truth = restored(given), UDDS.statistics()
    s = found.statistics()
    assert s.distance == pytest.approx(truth.distance, rel=1e-3)
    # One of its crawls is slower than the noise, and one of its stops two seconds long.
    assert abs(s.stops - truth.stops) <= 1
    assert s.t_idle == pytest.approx(truth.t_idle, abs=15)
    assert s.duration == truth.duration
    wrong = found.speed - np.interp(found.time, UDDS.time, UDDS.speed)
    assert np.sqrt(np.mean(wrong**2)) < rms
    assert s.a_max < 2.6
    assert not [text for text in found.doubts if text not in found.notes]


def test_a_clean_trace_stays_as_it_is():
    t = np.arange(0, 1369.01, 0.1)
    clean = Cycle(name="clean", time=t, speed=np.interp(t, UDDS.time, UDDS.speed))
    found = restored(clean)
    assert np.sqrt(np.mean((found.speed - clean.speed) ** 2)) < 0.06
    assert found.statistics().distance == pytest.approx(UDDS.statistics().distance, rel=5e-4)
    assert np.abs(found.speed - clean.speed).max() < 0.6


def test_gaps_are_found_reported_and_filled_by_straight_lines():
    given = recorded(UDDS, noise=0.1)
    one, two = gaps(given)
    assert (one.begin, one.end) == (pytest.approx(300, abs=0.3), pytest.approx(304, abs=0.3))
    assert one.moving
    assert not two.moving
    found = restored(given)
    told = [note for note in found.notes if note.startswith("filled by a straight line")]
    assert len(told) == 2
    assert "s without points from t = 3" in told[0]
    inside = (found.time > 300.5) & (found.time < 303.5)
    assert np.abs(np.diff(found.speed[inside], 2)).max() < 0.03
    assert found.speed[(found.time > 340) & (found.time < 345)].max() == 0


def test_long_gaps_are_filled_at_rest_and_refused_in_motion():
    # The vehicle stands from 129 to 163 s, and moves from 195 to 330.
    parked = recorded(UDDS, holes=((132.0, 160.0),))
    assert restored(parked).statistics().distance == pytest.approx(UDDS.statistics().distance, rel=1e-3)
    driving = recorded(UDDS, holes=((200.0, 215.0), (240.0, 290.0)))
    with pytest.raises(InputError) as e:
        restored(driving)
    assert len(e.value.problems) == 3
    assert e.value.problems[0].startswith("15")
    assert e.value.problems[1].startswith("50")
    assert restored(driving, longest_gap=60).duration == UDDS.duration


def test_a_trace_of_one_hertz_and_even_steps_has_no_gaps():
    assert gaps(UDDS) == ()
    assert gaps(Cycle(name="one", time=[0.0], speed=[0.0])) == ()


def test_grade_and_key_stay_beside_the_speed():
    t = np.arange(0, 60, 0.1)
    given = Cycle(name="c", time=t, speed=np.full(600, 10.0), grade=t / 1000, key_on=(t > 3).astype(float))
    found = restored(given)
    np.testing.assert_allclose(found.grade, given.grade, atol=1e-12)
    assert np.array_equal(found.key_on, given.key_on)


def test_bad_input_is_said_at_once():
    with pytest.raises(InputError) as e:
        restored(Cycle(name="c", time=[0.0, 1.0], speed=[0.0, 1.0]), window=-1, longest_gap=float("nan"))
    assert [p.partition(",")[0] for p in e.value.problems] == ["window = -1 s", "longest_gap = nan s", "has 2 points"]
    t = np.append(np.arange(0, 60, 0.1), 1e8)
    with pytest.raises(InputError, match="1e\\+09 of its usual steps long"):
        restored(Cycle(name="c", time=t, speed=np.zeros(601)))


def test_a_run_is_told_of_gaps_in_motion():
    given = recorded(UDDS, noise=0.0)
    (told,) = [text for text in given.doubts if "without points" in text]
    assert told.startswith("4")
    assert told.endswith("taken for a straight line")
    assert not UDDS.doubts
    hand_made = Cycle(name="c", time=[0, 10, 20, 200, 210], speed=[0, 20, 20, 20, 0])
    assert not hand_made.doubts
