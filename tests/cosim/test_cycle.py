import os
from dataclasses import replace

import numpy as np
import pytest

from halfshaft.cosim.cycle import Cycle, acceleration_cycle, cycle_names
from halfshaft.cosim.simulate import run
from halfshaft.library.base.errors import InputError
from halfshaft.models.vehicle import Vehicle


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
    assert s == (12.0, 16 + 16 + 16, 8.0, 4.0, 2.0, -2.0, 2.0, 1, 2.0, -2.0, 0.0, None, None, None)


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


ROAD = np.array([0.0, 500.0, 1000.0]), np.array([0.0, 0.05, 0.0])


@pytest.mark.parametrize(
    ("distance", "grade"),
    [
        (np.arange(6.0)[::2] * 250, np.array([0.0, 9, 0.05, 9, 0, 9])[::2]),
        ([0, 500, 1000], [0, np.float32(0.05), 0.0]),
        (np.array([0, 500, 1000]), [0.0, 0.05, 0.0]),
        (np.array([0, 500, 1000], dtype=np.float32), np.array([0, 0.05, 0])),
        (np.array([[0.0, 0.0], [500.0, 0.05], [1000.0, 0.0]])[:, 0], np.array([[0.0, 0.0], [500.0, 0.05], [1000.0, 0.0]])[:, 1]),
    ],
)
def test_rows_of_any_kind_of_number_run_as_floats_do(distance, grade):
    cycle = Cycle.load("hwfet")
    car = Vehicle.load("small-car-electric")
    one = run(car, replace(cycle, grade_by_distance=ROAD), history=False)
    other = run(car, replace(cycle, grade_by_distance=(distance, grade), time=list(range(766)), speed=cycle.speed.tolist()), history=False)
    assert other.energies["motor.P_in"] == pytest.approx(one.energies["motor.P_in"], rel=1e-7)
    assert other.last["body.distance"] == pytest.approx(one.last["body.distance"])


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ({"grade_by_distance": (np.arange(3.0), np.zeros(2))}, "grade_by_distance: grade has 2 points, distance has 3"),
        ({"grade_by_distance": (np.zeros(2), np.zeros(2))}, "grade_by_distance: distance must rise"),
        ({"grade_by_distance": ([0.0, np.nan], [0.0, 0.0])}, "distance has a point that is not a finite number"),
        ({"grade_by_distance": ([], [])}, "distance has no points"),
        ({"grade_by_distance": 3}, "must be a pair of rows"),
        ({"grade_by_distance": ([0, 1], [0, 5])}, "grade = 5, must be >= -1 and <= 1 (rise over run: 5 % is 0.05"),
        ({"speed": "fast"}, "speed must be a row of numbers"),
        ({"speed": [[0.0], [1.0]]}, "speed must be one row of numbers"),
        ({"speed": [0, [1]]}, "speed must be a row of numbers"),
        ({"speed": [0, 10**400]}, "speed must be a row of numbers"),
        ({"speed": [0, 1e300]}, "speed = 1e+300, must be >= 0 and <= 1000 m/s"),
        ({"time": [0, float("inf")]}, "time has a point that is not a finite number"),
        ({"time": [0, 1e11]}, "lasts 1e+11 s, must be at most 1e+09 s"),
        ({"time": [0, 5e-324]}, "time must rise"),
        ({"key_on": [0, 7]}, "key_on = 7, must be >= 0 and <= 1"),
        ({"name": "a\x1b[31m"}, "name = "),
    ],
)
def test_rows_that_no_cycle_has_are_refused(rows, message):
    with pytest.raises(InputError) as e:
        Cycle(**{"name": "c", "time": [0, 1], "speed": [0, 1], **rows})
    assert any(message in problem for problem in e.value.problems)
    assert all(problem.isprintable() for problem in e.value.problems)


def test_a_cycle_keeps_rows_of_its_own():
    speed = np.array([0.0, 1.0])
    cycle = Cycle(name="c", time=[0, 1], speed=speed)
    speed[:] = -1
    assert cycle.speed.tolist() == [0, 1]
    with pytest.raises(ValueError, match="read-only"):
        cycle.speed[0] = -1


def test_too_many_steps_are_refused():
    with pytest.raises(InputError, match=r"makes 1\.37e\+11 steps"):
        Cycle.load("udds").sampled(1e-8)


def test_texts_of_a_cycle_lose_control_characters(tmp_path):
    cycle = Cycle.load(write(tmp_path, "# title: a\x1b[31m\u202e b\x85\x07\ntime_s,speed_mps\n0,0\n"))
    assert cycle.title == "a [31m b"
    assert problems(write(tmp_path, "# name: a\x1b\ntime_s,speed_mps\n0,0\n"))[0].startswith('name = "a\\x1b", must be letters')


def noisy(sigma, dt=0.1):
    udds = Cycle.load("udds")
    time = np.arange(0, 1369 + dt / 2, dt)
    speed = np.interp(time, udds.time, udds.speed) + sigma * np.random.default_rng(0).standard_normal(len(time))
    return Cycle(name="noisy", time=time, speed=np.maximum(speed, 0))


@pytest.mark.parametrize("dt", [0.7, 1.0, 2.0, 7.0])
def test_steps_longer_than_the_points_are_apart_keep_the_distance(dt):
    cycle = noisy(0.3)
    s = cycle.sampled(dt)
    v = np.append(s.v_start, s.v)
    assert np.sum((v[1:] + v[:-1]) / 2 * s.dt) == pytest.approx(cycle.statistics().distance, rel=1e-12)


@pytest.mark.parametrize("dt", [1.0, 0.5, 0.1])
@pytest.mark.parametrize("name", cycle_names())
def test_steps_not_longer_than_that_ask_for_the_points_themselves(name, dt):
    cycle = Cycle.load(name)
    s = cycle.sampled(dt)
    assert s.v.tolist() == np.interp(s.t, cycle.time, cycle.speed).tolist()
    assert s.v_start == cycle.speed[0]


def test_noise_is_told_and_smoothed():
    car = Vehicle.load("small-car-electric")
    noise, clean = noisy(0.3), run(car, Cycle.load("udds")).energies["motor.P_in"]
    assert [text[:16] for text in noise.doubts] == ["the trace asks f", "the trace stops ", "the trace accele"]
    assert f"for up to {noise.statistics().a_max:.3g}" in noise.doubts[0]
    assert f"stops {noise.statistics().stops} times, every 2.1 s" in noise.doubts[1]
    assert noise.doubts[2].endswith("(smooth it: --smooth 2 or Cycle.smoothed(2))")
    assert run(car, noise, dt=0.1).energies["motor.P_in"] > 2.5 * clean
    smooth = noise.smoothed(2)
    assert not smooth.doubts
    assert smooth.name == "noisy-smoothed-2"
    assert smooth.statistics().distance == pytest.approx(noise.statistics().distance, rel=1e-4)
    # Noise cut at rest, where no speed is below zero, leaves 0.1 m/s: some per cent remain.
    for mended, dt in ((noise, 1.0), (smooth, 1.0), (smooth, 0.1)):
        assert run(car, mended, dt=dt).energies["motor.P_in"] == pytest.approx(clean, rel=0.05)


@pytest.mark.parametrize(("stops", "every", "doubted"), [(4, 2.5, False), (5, 2.5, True), (40, 16.0, False), (40, 14.0, True)])
def test_more_than_four_stops_are_told_where_they_come_every_quarter_of_a_minute(stops, every, doubted):
    trace = Cycle(name="stops", time=np.arange(2 * stops + 1) * every / 2, speed=np.resize([0.0, 5.0], 2 * stops + 1))
    told = f"the trace stops {stops} times, every {every:.2g} s (smooth it: --smooth 2 or Cycle.smoothed(2))"
    assert trace.doubts == ((told,) if doubted else ())


@pytest.mark.parametrize("name", cycle_names())
def test_no_cycle_of_the_library_is_doubted(name):
    assert Cycle.load(name).doubts == ()
    assert acceleration_cycle().doubts == ()


def test_smoothing_keeps_rests_and_straight_lines():
    cycle = Cycle(name="c", time=np.arange(101) / 2, speed=np.r_[np.zeros(40), np.arange(61) / 10])
    smooth = cycle.smoothed(4)
    assert smooth.speed[:37].tolist() == [0] * 37
    np.testing.assert_allclose(smooth.speed[44:], cycle.speed[44:], rtol=1e-12)
    for width in (0, -1, float("nan")):
        with pytest.raises(InputError, match="width of smoothing"):
            cycle.smoothed(width)


#: What the units of columns are in SI, by hand.
UNITS = {
    "time": {"s": 1, "sec": 1, "secs": 1, "second": 1, "seconds": 1, "ms": 0.001, "min": 60, "h": 3600},
    "speed": {
        "mps": 1, "m_per_s": 1, "meters_per_second": 1, "kmh": 0.2777778, "kph": 0.2777778, "kmph": 0.2777778, "mph": 0.44704,
        "kn": 0.5144444, "knots": 0.5144444,
    },
    "grade": {"1": 1, "percent": 0.01, "pct": 0.01, "%": 0.01},
}  # fmt: skip


@pytest.mark.parametrize(("column", "unit", "factor"), [(c, unit, x) for c, units in UNITS.items() for unit, x in units.items()])
def test_every_unit_of_a_column_is_known(tmp_path, column, unit, factor):
    titles = {"time": "s", "speed": "mps", "grade": "1"} | {column: unit}
    text = ",".join(f"{c} [{u}]" for c, u in titles.items())
    cycle = Cycle.load(write(tmp_path, f"{text}\n0,0,0\n0.5,0.5,0.5\n"))
    assert getattr(cycle, column).tolist() == pytest.approx([0, 0.5 * factor], rel=1e-6)


SAME = {
    "fastsim": "cycSecs,cycMps,cycGrade,cycRoadType\n0,0,0,0\n10,10,0.02,0\n",
    "semicolons": "Time [s];Speed (km/h);Grade [%]\n0;0;0\n10;36,0;2,0\n",
    "tabs": "t\tv (m/s)\tslope_percent\n0\t0\t0\n10\t10,0\t2\n",
    "vecto": "<t>,<v>,<grad>\n0,0,0\n10,36,2\n",
    "logger": '"time (s)","latitude","longitude","GPS speed (Meters/second)","grade"\n0,48.1,"11.5",0,0\n10,x,11.6,10,0.02\n',
    "excel": "\ufeffsep=;\nelapsed time [min];vehicle_speed_kph;gradient\n0;0;0\n0,16666666666666666;36;0,02\n",
}


@pytest.mark.parametrize("name", SAME)
def test_files_of_other_tools_are_read(tmp_path, name):
    cycle = Cycle.load(write(tmp_path, SAME[name]))
    assert cycle.time.tolist() == pytest.approx([0, 10])
    assert cycle.speed.tolist() == pytest.approx([0, 10])
    assert cycle.grade.tolist() == pytest.approx([0, 0.02])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,speed\n0,0\n", "line 1: column 'speed' does not tell its unit: call it speed_mps or speed_kmh or speed_mph"),
        ("time,speed_ly\n0,0\n", "line 1: column 'speed_ly' has a unit that is not known, must be one of mps,"),
        (
            "time_s,mps,colour\n0,0,0\n",
            "line 1: column 'colour' is not known; if it is none of time, speed, grade, elevation, key_on, delete it",
        ),
        ("time_s,mps\n0,0\n10,2,5\n", "line 3 has 3 entries, must have 2; decimal commas need semicolons between the columns"),
        ("0,0\n1,5\n", "line 1 holds numbers; a line with the names of the columns must come first: time_s, speed_mps"),
        ("time_s,mps\n0,0\n1,5,2,5\n", "line 3 has 4 entries, must have 2; decimal commas need semicolons between the columns"),
        ("time,mps\n2024-01-01T10:00:00Z,0\n", "line 2: time = '2024-01-01T10:00:00Z', must be a number; write seconds since the start"),
        (
            "time,mps,grade\n0,0,5\n",
            "line 2: grade = 5, must be >= -1 and <= 1 (rise over run: 5 % is 0.05, or 5 in a column grade_percent)",
        ),
        ("time,mps\n0,0\n1,-0.6\n", "line 3: mps = -0.6, must be >= 0 and <= 1000 m/s (what is above -0.5 m/s"),
        ("time,mps,grade,alt\n0,0,0,0\n", "line 1: grade and elevation say the same, delete one of them"),
        ("time,mps\n0,1_0\n", "line 2: mps = '1_0', must be a number"),
    ],
)
def test_what_cannot_be_read_names_the_cure(tmp_path, text, message):
    (found,) = [p for p in problems(write(tmp_path, text)) if "missing" not in p]
    assert found.startswith(message) or found.replace("speed_mps", "mps").startswith(message)


def test_small_speeds_below_zero_are_set_to_zero_and_told(tmp_path):
    cycle = Cycle.load(write(tmp_path, "time_s,speed_mps\n0,-0.1\n1,-0.25\n2,3\n"))
    assert cycle.speed.tolist() == [0, 0, 3]
    assert cycle.doubts == ("2 speeds below zero, down to -0.25 m/s, were set to 0",)


def test_an_elevation_becomes_a_grade_over_distance(tmp_path):
    # 20 m/s for 100 s, 5 % up in the first half and down in the second.
    lines = [f"{t},20,{100 + min(t, 100 - t)}" for t in range(101)]
    distance, grade = Cycle.load(write(tmp_path, "\n".join(["time_s,speed_mps,elevation_m", *lines]))).grade_by_distance
    assert distance[-1] == 2000
    np.testing.assert_allclose(grade[:19], 0.05, atol=1e-12)
    np.testing.assert_allclose(grade[-19:], -0.05, atol=1e-12)
    climb = np.sum((grade[1:] + grade[:-1]) / 2 * np.diff(distance))
    assert climb == pytest.approx(0, abs=1e-9)
    over = write(tmp_path, "distance [km],elevation [ft]\n0,0\n1,100\n", "g.csv")
    assert Cycle.load("udds", over).grade_by_distance[1] == pytest.approx(np.full(21, 0.03048))


def test_what_is_no_regular_file_is_refused_at_once(tmp_path):
    pipe, sparse = tmp_path / "pipe.csv", tmp_path / "sparse.csv"
    os.mkfifo(pipe)
    with sparse.open("wb") as file:
        file.truncate(10**10)
    assert problems(pipe) == ["is not a regular file"]
    assert problems(tmp_path) == ["cannot be read: Is a directory"]
    assert problems(sparse) == ["has more than 500 MB, which is the most that is read"]
    assert problems("a\0.csv") == ["cannot be read: embedded null byte"]
    (tmp_path / "zero.csv").symlink_to("/dev/zero")
    assert problems(tmp_path / "zero.csv") == ["is not a regular file"]


def test_a_million_lines_are_read_by_the_fast_parser(tmp_path, monkeypatch):
    text = "time_s,speed_mps\n" + "\n".join(f"{t / 10},{t % 30}" for t in range(20_000))
    monkeypatch.setattr("halfshaft.cosim.cycle_file._wrong", None)
    assert len(Cycle.load(write(tmp_path, text)).time) == 20_000


@pytest.mark.parametrize(("stem", "name"), [("trip [1]", "trip _1_"), ("(a) b", "a) b"), ("---", "cycle"), ("x" * 200, "x" * 80)])
def test_a_cycle_without_a_name_has_that_of_its_file(tmp_path, stem, name):
    cycle = Cycle.load(write(tmp_path, "time_s,speed_mps\n0,0\n9,1\n", f"{stem}.csv"))
    assert cycle.name == name
    assert cycle.smoothed(2).scaled(2).name.endswith("-x2")
