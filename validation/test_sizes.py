"""Published sizes against those found here with all sizes open; some seconds."""

from __future__ import annotations

from itertools import pairwise

import pytest

from halfshaft.validation.sizes import CARS, CURVE, sized


@pytest.mark.parametrize(("name", "modules"), [("series", 0), ("parallel", 1)])
def test_engine_and_modules_are_near_the_published_ones(name: str, modules: int) -> None:
    own, published = sized(name), CARS[name].sizes
    assert own.status == "met"
    assert own.vehicle.values["engine.torque_scale"] == pytest.approx(published["engine.torque_scale"], rel=0.01)
    assert own.after["store"] == pytest.approx(published["battery.n_modules"], abs=modules)
    # The original left motors larger than its goals need; docs/autosize.md.
    assert own.vehicle.values["motor.torque_scale"] < 0.65 * published["motor.torque_scale"]


def test_the_engine_gives_way_to_battery_and_motor_as_hybridisation_grows() -> None:
    curve = [sized("parallel", hybridisation=h).vehicle.values for h in CURVE]
    for a, b in pairwise(curve):
        assert a["engine.torque_scale"] > b["engine.torque_scale"]
        assert a["battery.n_modules"] <= b["battery.n_modules"]
        assert a["motor.torque_scale"] < b["motor.torque_scale"]
