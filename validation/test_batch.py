"""The memory of a batch does not grow with the number of runs, but for what is kept of each."""

import subprocess
import sys

import pytest

#: Prints how much memory a batch took at most [bytes].
MEASURE = """
import resource, sys
import numpy as np
from halfshaft import Cycle, Vehicle
from halfshaft.studies.batch import run_batch
n = int(sys.argv[1])
car = Vehicle.load(sys.argv[2])
cycle = Cycle(name="short", time=[0.0, 3.0, 6.0], speed=[0.0, 5.0, 0.0])
values = {name: np.linspace(0.9, 1.1, n) * car.values[name] for name in ("body.m", "body.c_d", "motor.torque_scale")}
found = run_batch(car, values, cycle)
assert not found.status.any()
print(1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


@pytest.mark.parametrize("vehicle", ["small-car-electric", "small-car-series"])
def test_a_million_runs_take_200_megabytes_more_than_a_thousand(vehicle: str) -> None:
    few, many = (int(subprocess.check_output([sys.executable, "-c", MEASURE, str(n), vehicle])) for n in (1000, 1_000_000))
    assert many - few < 200e6
