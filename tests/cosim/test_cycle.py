import numpy as np
import pytest

from halfshaft.cosim.cycle import Cycle, acceleration_cycle, cycle_names
from halfshaft.library.errors import InputError


def write(folder, text, name="c.csv"):
    path = folder / name
    path.write_text(text)
    return path


def problems(*arguments):
    with pytest.raises(InputError) as e:
        Cycle.load(*arguments)
    return list(e.value.problems)


@pytest.mark.parametrize("name", cycle_names())
def test_every_cycle_loads_and_says_where_it_is_from(name):
    cycle = Cycle.load(name)
    assert cycle.name == name
    assert cycle.title
    assert cycle.source
    assert cycle.statistics().distance > 500


# Published distances in km, durations in s, highest speeds in km/h.
@pytest.mark.parametrize(
    ("name", "distance", "duration", "v_max"),
    [
        ("udds", 11.99, 1369, 91.25),
        ("ftp", 17.77, 2477, 91.25),
        ("hwfet", 16.51, 765, 96.4),
        ("us06", 12.89, 600, 129.23),
        ("sc03", 5.76, 600, 88.19),
        ("nycc", 1.90, 598, 44.58),
        ("la92", 15.80, 1435, 108.15),
        ("nedc", 10.93, 1184, 120.0),
        ("japan-10-15", 4.16, 660, 69.97),
        ("im240", 3.15, 240, 91.25),
        ("rep05", 32.25, 1400, 129.23),
        ("wltc-class3", 23.27, 1800, 131.3),
    ],
)
def test_cycles_have_their_published_figures(name, distance, duration, v_max):
    s = Cycle.load(name).statistics()
    assert s.distance / 1000 == pytest.approx(distance, abs=0.006)
    assert s.duration == duration
    assert s.v_max * 3.6 == pytest.approx(v_max, abs=0.02)


def test_wltc_has_the_sum_of_speeds_of_the_regulation():
    assert Cycle.load("wltc-class3").speed.sum() * 3.6 == pytest.approx(83758.6)


def test_the_case_of_a_name_does_not_matter():
    assert Cycle.load("UDDS").name == "udds"


def test_a_misspelt_cycle_names_the_nearest():
    with pytest.raises(InputError, match="did you mean 'udds'"):
        Cycle.load("uds")


def test_the_ftp_has_its_key_off_for_the_soak():
    cycle = Cycle.load("ftp")
    s = cycle.sampled(0.5)
    assert set(s.key_on) == {0.0, 1.0}
    assert s.dt[s.key_on == 0].sum() == pytest.approx(600, abs=1)
    assert s.v[s.key_on == 0].max() == 0


def test_the_mountain_cycle_has_a_grade_over_distance():
    distance, grade = Cycle.load("hwfet-mtn").sampled(1.0).grade_by_distance
    assert np.interp(2253.0816, distance, grade) == 0.02
    assert Cycle.load("hwfet").sampled(1.0).grade_by_distance is None


def test_steps_request_the_speed_at_their_end():
    cycle = Cycle(name="c", time=np.array([0.0, 10.0]), speed=np.array([1.0, 6.0]))
    s = cycle.sampled(4.0)
    assert s.v_start == 1.0
    assert s.t.tolist() == [4.0, 8.0, 10.0]
    assert s.dt.tolist() == [4.0, 4.0, 2.0]
    assert s.v.tolist() == [3.0, 5.0, 6.0]
    assert s.grade.tolist() == [0.0] * 3
    assert s.key_on.tolist() == [1.0] * 3


@pytest.mark.parametrize("dt", [1.0, 0.5, 0.1, 0.05, 1 / 3, 0.003])
def test_sampling_meets_the_points_of_a_cycle_exactly(dt):
    cycle = Cycle.load("us06")
    s = cycle.sampled(dt)
    assert s.dt.sum() == pytest.approx(600, abs=1e-8)
    at_points = np.isclose(s.t, np.round(s.t), rtol=0, atol=1e-12)
    assert np.array_equal(s.v[at_points], cycle.speed[np.round(s.t[at_points]).astype(int)])


@pytest.mark.parametrize("dt", [0.1, 0.01, 0.7, 1 / 3, 1.0])
def test_acceleration_is_asked_for_right_after_the_start(dt):
    s = acceleration_cycle().sampled(dt)
    assert set(s.v) == {0.0, 322 / 3.6}
    assert np.array_equal(s.v == 0, s.t <= 5)


def test_the_first_accelerating_step_ends_one_step_after_the_start():
    s = acceleration_cycle().sampled(0.1)
    assert s.t[s.v > 0][0] == 5.1


@pytest.mark.parametrize("rows", ["0,0\n", "3,7\n"])
def test_a_cycle_without_length_has_no_steps(tmp_path, rows):
    s = Cycle.load(write(tmp_path, "time_s,speed_mps\n" + rows)).sampled(0.1)
    assert len(s.t) == len(s.v) == len(s.dt) == 0


@pytest.mark.parametrize("dt", [0.0, -1.0, float("nan"), float("inf")])
def test_a_step_must_have_a_length(dt):
    with pytest.raises(InputError, match="dt = "):
        Cycle.load("udds").sampled(dt)


def test_scaling_multiplies_distance_and_accelerations():
    one, two = Cycle.load("udds"), Cycle.load("udds").scaled(2)
    assert two.statistics().distance == pytest.approx(2 * one.statistics().distance)
    assert two.statistics().a_min == pytest.approx(2 * one.statistics().a_min)
    with pytest.raises(InputError, match="factor"):
        one.scaled(-1)


def test_statistics_of_a_trapezoid():
    s = Cycle(name="c", time=np.array([0.0, 2.0, 6.0, 8.0, 12.0]), speed=np.array([0.0, 0.0, 8.0, 8.0, 0.0])).statistics()
    assert s == (12.0, 16 + 16 + 16, 8.0, 4.0, 2.0, -2.0, 2.0, 1)


@pytest.mark.parametrize(
    ("title", "factor"), [("speed_mps", 1), ("speed_kmh", 1 / 3.6), ("speed_mph", 0.44704), ("Speed [km/h]", 1 / 3.6), ("speed (m/s)", 1)]
)
def test_the_name_of_the_speed_column_gives_its_unit(tmp_path, title, factor):
    cycle = Cycle.load(write(tmp_path, f"# title: Mine\n\ntime [s], {title}\n0,0\n10,36\n"))
    assert cycle.speed.tolist() == pytest.approx([0, 36 * factor])
    assert (cycle.name, cycle.title) == ("c", "Mine")


def test_grade_comes_by_time_or_over_distance(tmp_path):
    path = write(tmp_path, "time_s,speed_mps,grade\n0,0,0\n10,1,0.1\n")
    over = write(tmp_path, "distance_m,grade\n0,0\n100,0.02\n", "g.csv")
    assert Cycle.load(path).sampled(5.0).grade.tolist() == [0.05, 0.1]
    assert np.interp(50, *Cycle.load(path, grade=over).grade_by_distance) == 0.01


def test_every_bad_line_is_named(tmp_path):
    text = "# name: c\ntime_s,speed_mps\n0,0\n1,nan\n1,2\n0.5,-3\n2,x\n3\n"
    assert problems(write(tmp_path, text)) == [
        "line 4: speed_mps = nan, must be a finite number",
        "line 6: speed_mps = -3, must be >= 0 and <= 1000 m/s (what is above -0.5 m/s, of a logger at rest, is set to 0)",
        "line 7: speed_mps = 'x', must be a number",
        "line 8 has 1 entries, must have 2",
        "line 5: time_s = 1 follows 1, it must rise",
        "line 6: time_s = 0.5 follows 1, it must rise",
    ]


def test_missing_and_unknown_columns_are_named(tmp_path):
    assert problems(write(tmp_path, "time_s,sped_kmh\n0,0\n")) == [
        "line 1: column 'sped_kmh' is not known, did you mean 'speed_kmh'?",
        "line 1: column speed_mps is missing",
    ]
    assert problems(write(tmp_path, "time_s,speed_kmh,speed_mph\n0,0,0\n")) == ["line 1: there are several columns with the speed"]


@pytest.mark.parametrize(
    ("text", "message"), [("", "is empty"), ("# name: c\n", "is empty"), ("time_s,speed_mps\n", "has no line with numbers")]
)
def test_an_empty_file_is_refused(tmp_path, text, message):
    assert problems(write(tmp_path, text)) == [message]


def test_a_missing_file_is_refused(tmp_path):
    assert problems(tmp_path / "c.csv") == ["cannot be read: No such file or directory"]


def test_a_distance_that_falls_is_refused(tmp_path):
    path = write(tmp_path, "time_s,speed_mps\n0,0\n")
    assert problems(path, write(tmp_path, "distance_m,grade\n0,0\n0,1\n", "g.csv")) == ["line 3: distance_m = 0 follows 0, it must rise"]


def test_arrays_that_do_not_fit_are_refused():
    with pytest.raises(InputError) as e:
        Cycle(name="c", time=np.array([0.0, 0.0]), speed=np.array([-1.0]))
    assert e.value.problems == ("speed has 1 points, time has 2", "time must rise", "speed = -1, must be >= 0 and <= 1000 m/s")
