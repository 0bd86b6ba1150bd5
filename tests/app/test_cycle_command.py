"""``halfshaft cycle``: figures, trips, recorders' traces, files and pictures."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from halfshaft.app.cli import app
from halfshaft.cosim.cycle import Cycle
from halfshaft.cosim.trip import join, rest


def call(*arguments):
    return CliRunner().invoke(app, ["cycle", *map(str, arguments)], env={"COLUMNS": "120"})


def told(*arguments):
    result = call(*arguments, "--json")
    assert result.exit_code == 0, result.stderr
    return json.loads(result.stdout)


def test_the_figures_are_a_table_in_the_units_asked_for():
    text = call("us06", "--units", "us").stdout
    assert "80.3   mph" in text
    assert "number of stops" in text
    found = told("us06")
    assert found["statistics"]["stops"] == 5
    assert sum(found["time_at_speed"]["time_s"]) == pytest.approx(600)


def test_a_trip_is_built_of_words(tmp_path):
    path = tmp_path / "trip.csv"
    found = told("udds*2", "soak=600", "hwfet@1%", "-o", path, "--name", "mine")
    udds = Cycle.load("udds")
    same = join(udds, udds, rest(600, key_on=False), Cycle.load("hwfet", "1%"))
    read = Cycle.load(path)
    assert read.name == found["name"] == "mine"
    assert all(np.array_equal(getattr(read, n), getattr(same, n)) for n in ("time", "speed", "grade", "key_on"))
    assert found["statistics"]["t_key_off"] == pytest.approx(600)
    between = told("nycc", "nycc*2", "--pause", 15)["statistics"]
    assert between["duration"] == 3 * 598 + 2 * 15
    assert between["t_key_off"] == 0


def test_window_grade_filter_and_scale_change_it():
    plain = Cycle.load("udds")
    found = told("udds", "--window", "0:505", "--grade", "3%", "--filter", "3", "--scale", "0.5")["statistics"]
    same = plain.between(0, 505).graded(0.03).smoothed(3).scaled(0.5).statistics()
    assert found == pytest.approx(same._asdict())


def test_a_road_over_distance_is_written_beside(tmp_path):
    path = tmp_path / "trip.csv"
    result = call("hwfet-mtn*2", "--pause", "5", "-o", path, "--plot", tmp_path / "trip.png")
    assert result.exit_code == 0, result.stderr
    assert "trip-grade.csv" in result.stdout
    read = Cycle.load(path, tmp_path / "trip-grade.csv")
    mountain = Cycle.load("hwfet-mtn")
    assert np.array_equal(read.grade_by_distance, join(mountain, mountain, between=rest(5)).grade_by_distance)
    assert (tmp_path / "trip.png").exists()


def test_a_recording_is_restored_or_its_gaps_are_told(tmp_path):
    t = np.delete(np.arange(0, 600, 0.1), range(3000, 3040))
    us06 = Cycle.load("us06")
    rng = np.random.default_rng(1)
    gps = Cycle(name="gps", time=t, speed=np.abs(np.interp(t, us06.time, us06.speed) + rng.normal(0, 0.2, len(t))))
    path = tmp_path / "gps.csv"
    gps.save(path)
    before = told(path)
    assert before["gaps"] == [pytest.approx({"begin": 299.9, "end": 304.0, "v_begin": 33, "v_end": 33}, abs=1.5)]
    assert before["warnings"][0].startswith("4.1 s without points from t = 299.9 s on")
    found = told(path, "--restore")
    assert found["statistics"]["stops"] == 5
    assert found["gaps"] == []
    assert any("filled by a straight line" in text for text in found["warnings"])
    refused = call(path, "--restore", "--longest-gap", "2")
    assert refused.exit_code == 2
    assert "must be at most 2 s" in refused.stderr


def test_all_that_is_wrong_is_one_message(tmp_path):
    arguments = ("udds*0", "foo", "pause=-3", "us06@300%", "--window", "5", "--out", tmp_path / "x.txt", "--pause", "1", "--soak", "2")
    result = call(*arguments)
    assert result.exit_code == 2
    assert result.stdout == ""
    for text in (
        "--pause and --soak", "--window 5", "'udds*0'", "cycle 'foo': not in the library", "duration = -3 s", "grade = 300%",
        "a cycle is written as .csv",
    ):  # fmt: skip
        assert text in result.stderr
    assert call("udds*9999999").exit_code == 2
    assert "duration = abc s, must be a number" in call("udds", "pause=abc").stderr
    assert "--restore goes with CSV files" in call("udds", "--restore").stderr
