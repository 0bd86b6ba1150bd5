import csv
import json

import pytest
from typer.testing import CliRunner

from halfshaft import Cycle, Vehicle, run
from halfshaft.app.cli import app


@pytest.fixture
def cars(tmp_path):
    path = tmp_path / "cars.csv"
    path.write_text("body.m\n1000\n1400\n")
    return path


def call(*arguments):
    return CliRunner().invoke(app, [str(a) for a in ("batch", "small-car-electric", "--cycle", "hwfet", *arguments)])


def test_each_vehicle_is_its_own_run(cars, tmp_path):
    out = tmp_path / "found.csv"
    done = call("--table", cars, "--out", out)
    assert done.exit_code == 0, done.stderr
    assert "2 vehicles small-car-electric over hwfet" in done.stdout
    rows = list(csv.DictReader(out.read_text().splitlines()))
    for row, m in zip(rows, (1000, 1400), strict=True):
        expected = run(Vehicle.load("small-car-electric").with_values({"body.m": m}), Cycle.load("hwfet")).figures
        assert float(row["energy_Wh_per_km"]) == pytest.approx(expected["energy_Wh_per_km"], rel=1e-12)


def test_json_has_a_column_for_each_figure(cars):
    found = json.loads(call("--table", cars, "--json").stdout)
    assert (found["vehicles"], found["lost"]) == (2, 0)
    assert len(found["table"]["distance_m"]) == 2


def test_all_that_is_wrong_is_one_message(tmp_path):
    path = tmp_path / "cars.csv"
    path.write_text("body.x\n1\n")
    done = call("--table", path, "--out", tmp_path / "found.txt", "--dt", "-1")
    assert done.exit_code == 2
    for text in ("body.x is no number", "must end in .csv or .nc", "--dt -1 s, must be > 0 s"):
        assert text in done.stderr
    assert done.stdout == ""
