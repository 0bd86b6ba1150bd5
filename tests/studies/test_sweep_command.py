"""The command that sweeps."""

import json
import os
import pty
import signal
import subprocess
import sys
import time
from contextlib import suppress

from typer.testing import CliRunner

from halfshaft import Cycle, Vehicle, sweep
from halfshaft.app.cli import app
from halfshaft.studies.sweep import table
from halfshaft.studies.task import Drive

AXIS = ("--axis", "body.m=1000..1600:4")
CAR = ("sweep", "small-car-electric", "--cycle", "nycc")


def called(*arguments, code=0):
    done = CliRunner().invoke(app, [str(a) for a in arguments])
    assert done.exit_code == code, done.output
    return done.stdout if code == 0 else done.stderr


def test_json_is_the_table_of_the_sweep():
    said = json.loads(called(*CAR, *AXIS, "--axis", "motor=ac-75kw,ac-83kw", "--soc", 0.9, "--json"))
    car = Vehicle.load("small-car-electric")
    car = car.with_values(dict.fromkeys(car.tags.all_of("start charge"), 0.9))
    found = sweep(car, {"body.m": "1000..1600:4", "motor": ["ac-75kw", "ac-83kw"]}, Drive(Cycle.load("nycc")), workers=1)
    assert said["table"] == table(found)
    assert (said["tasks"], said["points"], said["failed"]) == (["nycc"], 8, 0)


def test_tests_and_corrections_are_responses():
    cars = ("small-car-electric", "small-car-parallel")
    said = json.loads(called("sweep", *cars, "--cycle", "nycc", "--correction", "linear", "--test", "acceleration", "--json"))
    assert said["tasks"] == ["nycc-linear", "acceleration"]
    electric, parallel = said["table"]["acceleration.time_0_to_100_kmh_s"]
    assert 5 < parallel < electric < 20
    # An electric car has nothing to correct, and its acceleration is there all the same.
    assert said["failed"] == 1
    assert said["table"]["failure"][0].startswith("nycc-linear: ")
    assert [x is None for x in said["table"]["nycc-linear.fuel_L"]] == [True, False]
    assert "--correction linear goes with --cycle" in called("sweep", *cars, "--correction", "linear", "--test", "x", code=2)


def test_few_points_are_printed_one_by_one_and_of_many_the_ends():
    few = called(*CAR, *AXIS)
    assert "small-car-electric over nycc  4 points" in few
    assert [line.split()[0] for line in few.splitlines() if line.strip()[:1].isdigit()] == ["1000", "1200", "1400", "1600"]
    many = called(*CAR, "--axis", "body.m=1000..1600", "--sample", "lhs:41", "--response", "soc_end")
    assert "lowest" in many
    assert "highest" in many


def test_failing_points_are_named(tmp_path):
    said = called("sweep", "small-car-series", "--cycle", "nycc", "--axis", "control.soc_low=0.3,0.5", "--axis", "control.soc_high=0.4,0.6")
    assert "4 points, 1 of them failed" in said
    assert "! control.soc_low 0.5, control.soc_high 0.4" in said


def test_a_picture_and_a_folder_are_written(tmp_path):
    picture, folder = tmp_path / "x.png", tmp_path / "study"
    said = called(*CAR, *AXIS, "--plot", picture, "--out", folder, "--constraint", "soc_end>=0.94")
    assert f"wrote {picture}" in said
    assert f"wrote {folder}" in said
    assert picture.stat().st_size > 1000
    assert (folder / "sweep.nc").exists()


def test_all_that_is_wrong_is_said_at_once_before_anything_runs(tmp_path):
    picture = tmp_path / "x.gif"
    said = called(*CAR, *AXIS, *AXIS, "--axis", "x", "--plot", picture, "--constraint", "y", "--kind", "contours", "--cycle", "nyc", code=2)
    parts = ["--axis body.m is given twice", "--axis x: must be NAME=VALUES", ".gif", "constraint y: must be", "cycle 'nyc'"]
    for part in [*parts, "--kind contours need 2"]:
        assert part in said
    assert "--kind goes with --plot" in called(*CAR, *AXIS, "--kind", "lines", code=2)
    assert "name a cycle or a test" in called("sweep", "small-car-electric", *AXIS, code=2)
    assert "response soc_ned is not known, did you mean 'soc_end'?" in called(*CAR, *AXIS, "--response", "soc_ned", code=2)


def test_an_interrupt_says_where_it_goes_on(tmp_path):
    study = ["nycc", "--test", "acceleration", "--axis", "body.m=1000..1600:4000", "--workers", "1", "--out", str(tmp_path)]
    command = [sys.executable, "-m", "halfshaft", *CAR[:3], *study]
    terminal, other = pty.openpty()
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=other, text=True)
    os.close(other)
    while not (tmp_path / "parts").is_dir() or not list((tmp_path / "parts").glob("*.nc")):
        assert process.poll() is None
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    process.communicate()
    said = b""
    # The end of a terminal is an error.
    with suppress(OSError):
        while some := os.read(terminal, 10000):
            said += some
    os.close(terminal)
    assert process.returncode == 130
    assert f"what is finished is in {tmp_path}" in said.decode()
    assert "/4000" in said.decode()
