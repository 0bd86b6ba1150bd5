"""The plug-in series hybrid on one UDDS after the other: it depletes its battery, then sustains the charge."""

import numpy as np
import pytest
from twins.vehicles import TWINS, columns

from halfshaft import Cycle, Vehicle, run

UDDS = Cycle.load("udds")
CAR = Vehicle.load("small-car-plug-in-series")
N = 8


@pytest.fixture(scope="module")
def days():
    length = UDDS.time[-1] + 1
    time = np.concatenate([UDDS.time + k * length for k in range(N)])
    cycle = Cycle(name="8 x udds", time=time, speed=np.tile(UDDS.speed, N))
    result = run(CAR, cycle)
    return cycle, result, [int((k + 1) * length) - 2 for k in range(N)]


def test_it_depletes_first_and_then_sustains(days):
    _, result, ends = days
    soc, fuel = result["battery.soc"][ends], result["engine.fuel_used"][ends]
    burnt, p = np.diff(fuel, prepend=0.0), CAR.parameters["control"]
    middle = (p.soc_high + p.soc_low) / 2
    # Five cycles on the battery, each of which takes about as much.
    assert burnt[:5].tolist() == [0] * 5
    assert np.all(np.diff(soc[:5]) < -0.09)
    assert soc[4] > middle
    # One in which it begins to burn, and from then on each cycle ends where it began.
    assert 0 < burnt[5] < burnt[6]
    assert burnt[7] == pytest.approx(burnt[6], rel=2e-3)
    assert soc[6:] == pytest.approx([middle] * 2, abs=1e-3)
    assert soc.min() > middle - 2e-3


def test_what_it_burns_when_it_sustains_is_what_it_burns_when_it_starts_there(days):
    _, result, ends = days
    burnt = np.diff(result["engine.fuel_used"][ends])[-1]
    alone = run(CAR.with_values({"battery.soc_start": 0.45}), UDDS)
    assert alone["engine.fuel_used"][-1] == pytest.approx(burnt, rel=0.01)


def test_compiled_step_is_the_car_by_hand(days):
    cycle, result, _ = days
    units = {d.name: d.unit for d in result.outputs}
    for name, x in columns(TWINS["series"](CAR.parameters, cycle.sampled(1.0))).items():
        scale = max(np.abs(result[name]).max(), 1.0 if units[name] in ("W", "N", "N.m", "m/s") else 1e-12)
        np.testing.assert_allclose(x / scale, result[name] / scale, rtol=0, atol=1e-9, err_msg=name)


def test_the_account_is_closed(days):
    _, result, _ = days
    assert abs(result.account.balance_relative) < 1e-9
    assert result.summary["energy_from_battery_J"] / result.summary["pack_energy_J"] == pytest.approx(0.95 - 0.45, abs=0.02)
