"""``halfshaft compare``, and what ``halfshaft run`` writes to be compared."""

import csv
import json

import pytest
from typer.testing import CliRunner

from halfshaft.app.cli import app


def call(*arguments):
    return CliRunner().invoke(app, [*map(str, arguments)], env={"COLUMNS": "140"})


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    pictures = [f"--{what}={folder / what}.png" for what in ("plot", "flows", "points")]
    done = call(
        "run", "small-car-electric", "--cycle", "us06", "--out", folder / "a.nc", "--csv", folder / "a.csv", "--units", "us", *pictures
    )
    assert done.exit_code == 0, done.stderr
    return folder


def test_a_run_writes_its_series_and_pictures(saved):
    assert all((saved / f"{what}.png").stat().st_size > 20000 for what in ("plot", "flows", "points"))
    with (saved / "a.csv").open() as file:
        head, *rows = csv.reader(file)
    assert head[:2] == ["time [s]", "body.v [m/s]"]
    assert len(rows) == 600
    from halfshaft import Result

    result = Result.load(saved / "a.nc")
    assert [float(row[1]) for row in rows] == result["body.v"].tolist()
    assert result.to_pandas()["motor.P_in"].to_numpy().tolist() == result["motor.P_in"].tolist()


def test_a_saved_run_and_a_vehicle_are_put_beside_each_other(saved, tmp_path):
    arguments = ("compare", saved / "a.nc", "small-car-electric@body.m=1500", "--cycle", "us06")
    result = call(*arguments, "--units", "us", "--bars", tmp_path / "b.png", "--csv", tmp_path / "m.csv")
    assert result.exit_code == 0, result.stderr
    for text in ("What differs", "body.m [kg]", "1500", "What came of it", "Wh/mi", "MPGe", "mph at t ="):
        assert text in result.stdout
    with (tmp_path / "m.csv").open() as file:
        assert next(csv.reader(file)) == ["metric", "body.m = 1144", "body.m = 1500"]
    found = json.loads(call(*arguments, "--json").stdout)
    assert found["labels"] == ["body.m = 1144", "body.m = 1500"]
    assert found["differences"] == {"body.m": {"unit": "kg", "values": [1144.0, 1500.0]}}
    assert found["summaries"][1]["energy_Wh_per_km"] > found["summaries"][0]["energy_Wh_per_km"]


def test_any_output_is_drawn(saved, tmp_path):
    path = tmp_path / "p.png"
    result = call("compare", saved / "a.nc", saved / "a.nc", "--plot", path, "--output", "speed", "--output", "motor.P_in")
    assert result.exit_code == 0, result.stderr
    assert path.exists()
    refused = call("compare", saved / "a.nc", saved / "a.nc", "--plot", path, "--output", "motor.P_inn")
    assert refused.exit_code == 2
    assert "did you mean 'motor.P_in'" in refused.stderr


def test_all_that_is_wrong_is_one_message(saved, tmp_path):
    result = call(
        "compare",
        "small-car-electrik",
        "small-car-series@body.m=",
        f"{saved / 'a.nc'}@body.m=1",
        "--output",
        "speed",
        "--bars",
        tmp_path / "b.txt",
    )
    assert result.exit_code == 2
    assert result.stdout == ""
    for text in (
        "did you mean 'small-car-electric'", "small-car-series@body.m=: must be NAME", "no numbers can be set in a run",
        "--cycle is missing",
        "--output goes with --plot", "a plot is written as",
    ):  # fmt: skip
        assert text in result.stderr
    assert "must be at least 2" in call("compare", saved / "a.nc").stderr


@pytest.mark.parametrize("command", ["run", "cycle", "compare"])
def test_help_fits_a_terminal_of_80_columns(command):
    lines = CliRunner().invoke(app, [command, "--help"], env={"COLUMNS": "80"}).stdout.splitlines()
    assert max(map(len, lines)) <= 80
