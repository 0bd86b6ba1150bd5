"""A sweep that is killed at ten random moments and resumed each time equals the uninterrupted one exactly."""

import random
import subprocess
import sys
import time
from pathlib import Path

import pytest

from halfshaft.cosim.cycle import Cycle
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.folder import MANIFEST
from halfshaft.studies.sweep import sweep
from halfshaft.studies.task import Drive

KILLS = 10
AXES = {"body.m": "1000..1600:50", "motor": "ac-75kw,ac-83kw", "body.c_d": "0.2..0.4:5"}
SCRIPT = """
import sys
from halfshaft.cosim.cycle import Cycle
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies import folder, sweep
from halfshaft.studies.task import Drive

folder.PERIOD = sweep.PORTION = 0.05
if __name__ == "__main__":
    axes = {"body.m": "1000..1600:50", "motor": "ac-75kw,ac-83kw", "body.c_d": "0.2..0.4:5"}
    sweep.sweep(Vehicle.load("small-car-electric"), axes, Drive(Cycle.load("nycc")), folder=sys.argv[1], workers=int(sys.argv[2]))
"""


@pytest.mark.parametrize("workers", [1, 2])
def test_ten_kills_change_nothing(tmp_path: Path, workers: int) -> None:
    script, folder = tmp_path / "study.py", tmp_path / "study"
    script.write_text(SCRIPT)
    chance = random.Random(workers)
    killed, resumed = 0, []
    for _ in range(KILLS):
        process = subprocess.Popen([sys.executable, str(script), str(folder), str(workers)])
        # From the moment that it has begun; the first ones fall into its very start, the later ones find more and more finished.
        while not (folder / MANIFEST).exists() and process.poll() is None:
            time.sleep(0.01)
        try:
            process.wait(chance.uniform(0.0, 2.5))
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            killed += 1
        resumed.append(len(list((folder / "parts").glob("*.nc"))))
    assert killed > KILLS / 2
    assert resumed == sorted(resumed)
    car, task = Vehicle.load("small-car-electric"), Drive(Cycle.load("nycc"))
    assert sweep(car, AXES, task, folder=folder, workers=1).equals(sweep(car, AXES, task, workers=1))
