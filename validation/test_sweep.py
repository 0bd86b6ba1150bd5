"""A sweep that is killed at ten random moments and resumed each time equals the uninterrupted one exactly."""

import random
import subprocess
import sys
import time
from pathlib import Path

import pytest

from halfshaft.cosim.cycle import Cycle
from halfshaft.models.vehicle import Vehicle
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

folder.PERIOD, folder.SHARE, sweep.PORTION = 0.01, 0.0, 0.02
workers = int(sys.argv[2])
if not workers:
    sweep.BATCHED, sweep.BATCH = 100, 8
if __name__ == "__main__":
    axes = {"body.m": "1000..1600:50", "motor": "ac-75kw,ac-83kw", "body.c_d": "0.2..0.4:5"}
    sweep.sweep(Vehicle.load("small-car-electric"), axes, Drive(Cycle.load("nycc")), folder=sys.argv[1], workers=workers or 1)
"""


# Without workers it goes in batches.
@pytest.mark.parametrize("workers", [0, 1, 2])
def test_ten_kills_change_nothing(tmp_path: Path, workers: int, monkeypatch: pytest.MonkeyPatch) -> None:
    if not workers:
        monkeypatch.setattr(sys.modules[sweep.__module__], "BATCHED", 100)
    script, folder = tmp_path / "study.py", tmp_path / "study"
    script.write_text(SCRIPT)
    chance = random.Random(workers)

    def parts() -> int:
        return len(list((folder / "parts").glob("*.nc")))

    before = [parts()]
    for _ in range(KILLS):
        process = subprocess.Popen([sys.executable, str(script), str(folder), str(workers)])
        wanted = before[-1] + chance.randint(0, 5)
        while parts() < wanted and process.poll() is None:
            time.sleep(0.002)
        time.sleep(chance.uniform(0.0, 0.1))
        process.kill()
        process.wait()
        before.append(parts())
    # They fell into the work, not only before or after it.
    assert before == sorted(before)
    assert len(set(before)) > KILLS / 3
    car, task = Vehicle.load("small-car-electric"), Drive(Cycle.load("nycc"))
    assert sweep(car, AXES, task, folder=folder, workers=1).equals(sweep(car, AXES, task, workers=1))
