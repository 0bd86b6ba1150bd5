import json

import pytest
from typer.testing import CliRunner

from halfshaft import Vehicle
from halfshaft.app.cli import app
from halfshaft.app.figures import figure_rows
from halfshaft.studies.acceleration import AccelerationTest
from halfshaft.studies.conditions import MPH
from halfshaft.studies.gradeability import GradeabilityTest
from halfshaft.studies.procedure_file import procedure_names


@pytest.fixture(autouse=True)
def wide(monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")


def call(*arguments):
    return CliRunner().invoke(app, ["test", *(str(a) for a in arguments)])


def done(*arguments):
    result = call(*arguments)
    assert result.exit_code == 0, result.stderr
    return result.stdout


def figures(*arguments):
    return json.loads(done(*arguments, "--json"))["figures"]


def refused(*arguments):
    result = call(*arguments)
    assert result.exit_code == 2, result.output
    assert "Traceback" not in result.stderr
    return result.stderr


def test_an_acceleration_in_the_readers_units():
    car = Vehicle.load("small-car-parallel")
    metric = AccelerationTest(pairs=((0, 50), (0, 100), (80, 120)), unit="km/h")(car).figures
    assert figures("small-car-parallel", "acceleration") == metric
    us = AccelerationTest(routine="1999", resting="battery", added_mass=100)(car).figures
    options = ("--units", "us", "--routine", "1999", "--without", "battery", "--add-mass", 100)
    assert figures("small-car-parallel", "acceleration", *options) == us
    own = figures("small-car-parallel", "acceleration", "--from-to", "20-80")
    assert [n for n in own if n.startswith("time_") and "_to_" in n] == ["time_20_to_80_kmh_s"]
    assert "time 0 to 100 km/h" in done("small-car-parallel", "acceleration")


def test_a_grade_with_its_options():
    car = Vehicle.load("small-car-conventional")
    found = json.loads(done("small-car-conventional", "gradeability", "--units", "us", "--speed", 60, "--gear", 3, "--json"))
    assert found["figures"] == pytest.approx(GradeabilityTest(speed=60 * MPH, gear=3)(car).figures)
    assert found["trials"][0] == {"grade_percent": 0.0, "held": True}
    one = json.loads(done("small-car-conventional", "gradeability", "--grade", 30, "--json"))
    assert one["figures"]["grade_percent"] is None
    assert one["notes"] == ["a grade of 30 % is not held at 55 mph"]


def test_a_cycle_tells_how_the_charge_was_kept():
    found = json.loads(done("small-car-series", "hwfet", "--json"))
    assert found["status"] == "converged"
    assert found["record"][0].keys() == {"soc", "change", "fuel_L_per_100km", "energy_ratio"}
    assert len(found["record"]) == found["figures"]["runs"]
    text = done("small-car-series", "hwfet", "--correction", "linear")
    assert "charge at the start" in text
    assert "! time series and warnings are those of the last run" in text


def test_a_procedure_shows_what_it_reports(tmp_path):
    text = done("small-car-conventional", "city-highway", "--units", "us")
    assert "combined fuel economy" in text
    assert "45.83 mpg" in text
    assert "more figures with --json" in text
    assert "bag" not in text
    path = tmp_path / "mine.toml"
    path.write_text(
        'schema = 1\nkind = "procedure"\nname = "mine"\ntitle = "T"\nsource = "S"\n[tests.a]\ndrive = [{cycle = "nycc"}]\n',
        encoding="utf-8",
    )
    assert figures("small-car-electric", path)["a_energy_kWh_per_100km"] > 0
    assert "top speed" in done("small-car-electric", "top-speed")


def test_the_procedures_are_listed():
    shown = CliRunner().invoke(app, ["list", "procedures"]).stdout
    assert all(f" {name} " in shown for name in procedure_names())


def test_all_that_is_wrong_is_named_at_once():
    said = refused("small-car-conventional", "top-speed", "--grade", 3, "--soc", 2, "--set", "engine.x=1", "--correction", "linear")
    for text in (
        "--grade is for gradeability, not for top-speed", "--correction is for a cycle, not for top-speed",
        "soc = 2.0, must be >= 0 and <= 1", "engine.x is not known",
    ):  # fmt: skip
        assert text in said
    said = refused("small-car-conventional", "gradeability", "--speed", -30, "--grade", 300)
    assert "--speed -30 km/h, must be > 0 km/h and <= 3600 km/h" in said
    assert "--grade 300 %, must be >= -100 % and <= 100 %" in said
    assert "must be two speeds such as 0-100" in refused("small-car-electric", "acceleration", "--from-to", "fast")
    assert "did you mean 'gradeability'?" in refused("small-car-electric", "gradeabilty")
    assert "--soc is for acceleration and gradeability and top-speed, not for a procedure" in refused(
        "small-car-electric", "nedc", "--soc", 0.5
    )
    assert "has nothing that burns fuel" in refused("small-car-electric", "hwfet")
    assert "cannot be read" in refused("small-car-electric", "none.toml")


def test_figures_are_shown_by_the_endings_of_their_names():
    shown = dict(figure_rows({"a_mps": 10.0, "b_range_m": 16093.44, "c_L_per_100km": 5.0, "c_mpg": 47.0, "d_kWh_per_100km": 10.0}, "us"))
    assert shown == {"a": "22.37 mph", "b range": "10 mi", "c": "47.04 mpg", "d": "16.093 kWh/100 mi"}
    plain = {"x_percent": 3.0, "gear": 3, "y_s": None, "z_mps2": 1.5, "way_m": 12.0, "runs": 2.0}
    assert dict(figure_rows(plain, "metric")) == {"x": "3 %", "gear": "3", "y": "-", "z": "1.5 m/s2", "way": "12.0 m", "runs": "2"}
