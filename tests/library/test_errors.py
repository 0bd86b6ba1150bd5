import pytest

from halfshaft.library.base.errors import nearest
from halfshaft.models.vehicle import Vehicle

CAR = Vehicle.load("small-car-series")


@pytest.mark.parametrize(
    ("given", "meant"),
    [
        ("battery.sok", "battery.soc_start"),
        ("battery.charge", "battery.soc_start"),
        ("battery.temperature", "battery.T_start"),
        ("body.mass", "body.m"),
        ("body.drag", "body.c_d"),
        ("motor.inertia", "motor.J"),
        ("wheel.radius", "wheel.r"),
        ("motr.J", "motor.J"),
        ("boddy.mass", "body.m"),
        ("gearbox.ratio", "gearbox.ratios_1"),
    ],
)
def test_what_was_meant_is_found_by_letters_and_by_meaning(given, meant):
    assert nearest(given, CAR.specs) == f", did you mean '{meant}'?"


@pytest.mark.parametrize("given", ["body.q", "motor.K", "engine.displacement", "bus.x", ""])
def test_what_is_far_from_all_is_told_nothing(given):
    assert nearest(given, CAR.specs) == ""
