"""Trips: cycles one after the other, with rests and grades between; their files; and the tools that they are made with."""

import numpy as np
import pytest

from halfshaft import Cycle, InputError, Vehicle, run
from halfshaft.cosim.cycle_plot import plot_cycle
from halfshaft.cosim.trip import join, rest

UDDS = Cycle.load("udds")


def test_the_ftp_is_a_trip():
    """The federal test is the urban cycle, a soak of 600 s, and the first 505 s of it again."""
    trip, ftp = join(UDDS, rest(3), rest(600, key_on=False), UDDS.between(0, 505)), Cycle.load("ftp")
    assert np.array_equal(np.interp(ftp.time, trip.time, trip.speed), ftp.speed)
    assert trip.duration == ftp.duration
    ours, theirs = trip.sampled(1.0), ftp.sampled(1.0)
    # Its file has the key off one second later, and on one second earlier.
    assert np.flatnonzero(ours.key_on == 0).tolist() == list(range(1372, 1972))
    assert set(np.flatnonzero(theirs.key_on == 0)) < set(range(1372, 1974))


def test_a_repeated_cycle_burns_what_one_burns_as_often():
    car = Vehicle.load("small-car-conventional")
    one, three = run(car, UDDS, history=False), run(car, join(UDDS, UDDS, UDDS), history=False)
    assert three.figures["distance_m"] == pytest.approx(3 * one.figures["distance_m"])
    assert three.figures["fuel_L"] == pytest.approx(3 * one.figures["fuel_L"], rel=2e-3)


def test_cycles_that_agree_share_a_point_and_others_change_at_once():
    one = Cycle(name="a", time=[0, 1, 2], speed=[0, 3, 0])
    assert join(one, one).time.tolist() == [0, 1, 2, 3, 4]
    assert join(one, one).speed.tolist() == [0, 3, 0, 3, 0]
    assert join(one, one).grade is None
    steep = join(one, one.graded(0.05), one)
    assert steep.time.tolist() == [0, 1, 2, 2 + 1e-6, 3, 4, 4 + 1e-6, 5, 6]
    assert steep.grade.tolist() == [0, 0, 0, 0.05, 0.05, 0.05, 0, 0, 0]
    assert steep.sampled(1.0).grade.tolist() == [0, 0, 0.05, 0.05, 0, 0]
    assert join(one, one, between=rest(5)).duration == 9
    assert join(one, one, between=rest(5)).name == "a + pause 5 s + a"
    assert join(one, one, one).name == "3 a"


def test_a_trip_with_a_road_over_distance_drives_each_road_where_it_lies():
    mountain = Cycle.load("hwfet-mtn")
    length, climb = mountain.statistics().distance, mountain.statistics().climb
    trip = join(mountain, rest(20), UDDS.graded("2 %"), mountain)
    x, grade = trip.grade_by_distance
    hill = UDDS.statistics().distance
    assert x[-1] == pytest.approx(2 * length + hill)
    places = np.linspace(1, length - 1, 400)
    alone = np.interp(places, *mountain.grade_by_distance)
    np.testing.assert_allclose(np.interp(places, x, grade), alone, atol=1e-12)
    np.testing.assert_allclose(np.interp(places + length + hill, x, grade), alone, atol=1e-9)
    np.testing.assert_allclose(np.interp(places[:100] + length, x, grade), 0.02, atol=1e-12)
    assert trip.statistics().climb == pytest.approx(2 * climb + hill * np.sin(np.arctan(0.02)), rel=1e-6)
    driven = run(Vehicle.load("small-car-electric"), trip)
    up = mountain.statistics()
    assert driven.the("elevation")[-1] - 2 * run(Vehicle.load("small-car-electric"), mountain).the("elevation")[-1] == pytest.approx(
        hill * np.sin(np.arctan(0.02)), rel=1e-3
    )
    assert (up.grade_min, up.grade_max) == (-0.02, 0.02)


@pytest.mark.parametrize("with_road", [False, True])
def test_a_saved_cycle_is_read_to_the_last_bit(tmp_path, with_road):
    odd = UDDS.scaled(1 / 3).smoothed(2.7)
    trip = join(odd, rest(np.pi, key_on=False), odd if with_road else odd.graded(1 / 7), *([Cycle.load("hwfet-mtn")] * with_road))
    trip = trip.between(0.1, 2000.3)
    path, road = tmp_path / "trip.csv", tmp_path / "road.csv"
    trip.save(path, road if with_road else None)
    read = Cycle.load(path, road) if with_road else Cycle.load(path)
    for name in ("time", "speed", "key_on", *([] if with_road else ["grade"])):
        assert np.array_equal(getattr(read, name), getattr(trip, name)), name
    if with_road:
        assert all(np.array_equal(a, b) for a, b in zip(read.grade_by_distance, trip.grade_by_distance, strict=True))
    assert (read.name, read.title, read.source, read.notes) == (trip.name, trip.title, trip.source, trip.notes)


def test_notes_are_kept_in_the_file(tmp_path):
    path = tmp_path / "c.csv"
    Cycle(name="c", time=[0, 1], speed=[0, 1], notes=("one of them", "and another")).save(path)
    assert Cycle.load(path).notes == ("one of them", "and another")


@pytest.mark.parametrize("dt", [1.0, 0.1])
def test_a_constant_grade_is_the_climb_of_the_run(dt):
    hill = Cycle.load("hwfet", "3%")
    result = run(Vehicle.load("small-car-conventional"), hill, dt=dt)
    assert result.the("elevation")[-1] / result.the("distance")[-1] == pytest.approx(np.sin(np.arctan(0.03)), rel=1e-9)
    assert Cycle.load("hwfet", 0.03).name == hill.name == "hwfet-grade+3"


def test_a_part_of_a_cycle_keeps_its_times_its_speeds_and_its_road():
    part = UDDS.between(100.25, 300.5)
    assert part.time[[0, -1]].tolist() == [100.25, 300.5]
    assert np.array_equal(part.speed, np.interp(part.time, UDDS.time, UDDS.speed))
    mountain = Cycle.load("hwfet-mtn")
    later = mountain.between(150, 765)
    ahead = mountain.statistics().distance - later.statistics().distance
    x, grade = later.grade_by_distance
    np.testing.assert_allclose(grade, np.interp(x + ahead, *mountain.grade_by_distance), atol=1e-12)


def test_means_idle_and_the_time_at_each_speed_by_hand():
    c = Cycle(name="c", time=[0, 2, 6, 8, 12, 13], speed=[0, 0, 8, 8, 0, 0])
    s = c.statistics()
    assert (s.a_mean, s.d_mean, s.t_idle) == (2.0, -2.0, 3.0)
    # Four seconds up and four down pass each metre per second in half a second; two seconds hold 8 m/s.
    assert c.time_at([0, 2, 4, 8, 10]).tolist() == [3 + 2, 2, 4, 2]
    brute = np.histogram(np.interp(np.arange(0, 1369, 0.001) + 0.0005, UDDS.time, UDDS.speed), bins=np.arange(0, 27, 2.0))[0] * 0.001
    np.testing.assert_allclose(UDDS.time_at(np.arange(0, 27, 2.0)), brute, atol=0.02)
    assert UDDS.time_at([0, 100]).sum() == pytest.approx(1369)


def test_figures_are_told_in_the_units_asked_for():
    metric, us = ({name: (value, unit) for name, value, unit, _ in Cycle.load("hwfet-mtn").figures(units)} for units in ("metric", "us"))
    assert metric["distance"] == ("16.507", "km")
    assert us["distance"] == ("10.257", "mi")
    assert us["v_max"] == ("59.9", "mph")
    assert float(us["a_max"][0]) == pytest.approx(float(metric["a_max"][0]) / 0.3048, rel=1e-4)
    assert us["climb"][1] == "ft"


def test_what_cannot_be_joined_is_said_at_once():
    fast = UDDS.between(0, 200)
    graded = Cycle(name="by-time", time=[0, 1], speed=[0, 0], grade=[0, 0.1])
    with pytest.raises(InputError) as e:
        join(fast, UDDS, Cycle.load("hwfet-mtn"), graded)
    assert e.value.problems[0].startswith("udds-0-200 ends at 67.8 km/h and udds starts at 0 km/h")
    assert e.value.problems[1] == "by-time has a grade by time, another one has it over distance"
    for call, said in (
        (lambda: join(), "nothing to join"),
        (lambda: join("udds"), "must be a Cycle"),
        (lambda: rest(-1), "duration = -1 s"),
        (lambda: UDDS.between(5, 2000), "must rise and lie within 0 and 1369 s"),
        (lambda: UDDS.graded("3"), "grade = 3, must be >= -1 and <= 1"),
        (lambda: UDDS.graded("steep"), "steep"),
        (lambda: Cycle.load("hwfet-mtn").save("x.csv"), "needs a file of its own"),
        (lambda: UDDS.save("x.txt"), "is written as .csv"),
    ):
        with pytest.raises(InputError, match=said):
            call()


def test_the_picture_has_trace_road_histogram_and_accelerations(tmp_path):
    trip = join(UDDS, rest(600, key_on=False), Cycle.load("hwfet-mtn"))
    figure = plot_cycle(trip, units="us", path=tmp_path / "c.png")
    labels = [(ax.get_xlabel(), ax.get_ylabel()) for ax in figure.axes]
    assert labels == [
        ("", "speed [mph]"),
        ("time [min]", "grade [%]"),
        ("speed [mph]", "time [%]"),
        ("speed [mph]", "acceleration [ft/s\u00b2]"),
    ]
    shares = [bar.get_height() for bar in figure.axes[2].patches]
    assert sum(shares) == pytest.approx(100)
    assert shares[-1] == pytest.approx(100 * trip.statistics().t_idle / trip.duration)
    assert (tmp_path / "c.png").stat().st_size > 20000
    assert len(plot_cycle(UDDS, before=UDDS).axes) == 3
