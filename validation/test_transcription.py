"""Direct transcription over whole cycles, against dynamic programming and against the exact step."""

import pytest

from halfshaft.cosim.cycle import Cycle
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.transcription import transcribe


@pytest.mark.parametrize(
    ("name", "cycle"), [("small-car-fuel-cell", "udds"), ("small-car-fuel-cell-polarisation", "udds"), ("small-car-series", "nycc")]
)
def test_a_split_is_no_worse_than_dynamic_programming(name: str, cycle: str) -> None:
    found = transcribe(Vehicle.load(name), Cycle.load(cycle))
    assert found.holds
    assert found.goal <= found.before
    # What IPOPT found by itself, not only the way that it set out from.
    assert min(stage.exact for stage in found.stages if stage.holds) <= 1.0002 * found.before
    assert all(stage.status != "maximum iterations exceeded" for stage in found.stages)
    for stage in found.stages:
        # What the program says comes true on the exact step.
        assert stage.smooth == pytest.approx(stage.exact, rel=3e-2)


def test_an_electric_car_is_sized_to_just_reach_its_speed() -> None:
    sizes, limit = {"motor.torque_scale": (0.3, 3.0), "final_drive.i": (0.5, 2.0)}, 12.0
    found = transcribe(Vehicle.load("small-car-electric"), Cycle.load("nycc"), sizes, reach=[(26.8, limit)])
    assert found.holds
    assert found.goal < 0.9 * found.before
    assert found.reached[0] == pytest.approx(limit, rel=5e-3)
