"""Batches at length: over every cycle of the library, and a million runs."""

import subprocess
import sys

import numpy as np
import pytest

from halfshaft.cosim.cycle import Cycle, cycle_names
from halfshaft.cosim.ways import Mode
from halfshaft.fmu_build.lanes import widths
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies import batch
from halfshaft.validation.powertrains import first_of_each

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


@pytest.mark.parametrize("name", first_of_each())
@pytest.mark.parametrize("mode", ["hybrid", "refined"])
def test_lanes_give_the_bits_of_the_scalar_march_over_every_cycle(name: str, mode: Mode, monkeypatch: pytest.MonkeyPatch) -> None:
    car = Vehicle.load(name)
    cycles = [Cycle.load(cycle) for cycle in cycle_names() for _ in range(3)]
    mass = car.mass * np.tile([0.7, 1.0, 2.5], len(cycles) // 3)
    found = []
    for width in (widths()[:1], ()):
        monkeypatch.setattr(batch, "widths", lambda width=width: width)
        found.append(batch.run_batch(car, {car.tags.the("vehicle mass"): mass}, cycles, mode=mode))
    assert not found[0].status.any()
    assert found[0].identical(found[1])
