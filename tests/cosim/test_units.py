import pint
import pytest

from halfshaft.cosim.units import SYSTEMS, mpg, mpge, shown

UNIT = pint.UnitRegistry()


@pytest.mark.parametrize(
    ("quantity", "si", "ours", "theirs"),
    [
        ("distance", "m", "km", "mile"),
        ("way", "m", "m", "foot"),
        ("range", "m", "km", "mile"),
        ("speed", "m/s", "km/hour", "mile/hour"),
        ("energy", "J", "kW*hour", "kW*hour"),
        ("small energy", "J", "W*hour", "W*hour"),
        ("power", "W", "kW", "kW"),
        ("volume", "liter", "liter", "US_liquid_gallon"),
        ("consumption", "W*hour/km", "W*hour/km", "W*hour/mile"),
    ],
)
def test_units_are_those_of_an_independent_library(quantity, si, ours, theirs):
    for units, unit in (("metric", ours), ("us", theirs)):
        assert SYSTEMS[units][quantity].of(12.3) == pytest.approx(UNIT.Quantity(12.3, si).to(unit).magnitude, rel=1e-12)


def test_miles_per_gallon():
    # 235.215 is the factor that everybody uses.
    assert mpg(10.0) == pytest.approx(23.5215, abs=1e-4)
    assert mpg(100 / UNIT.Quantity(30.0, "mile/US_liquid_gallon").to("km/liter").magnitude) == pytest.approx(30.0)


def test_miles_per_gallon_equivalent():
    # A car that takes 33.705 kWh for 100 miles is one of 100 MPGe (EPA: 33.705 kWh a gallon).
    assert mpge(33705 / 160.9344) == pytest.approx(100.0)
    # The 2011 Nissan Leaf: 34 kWh for 100 miles, 99 MPGe on its label.
    assert mpge(34000 / 160.9344) == pytest.approx(99, abs=0.5)


def test_what_there_is_not_is_a_dash():
    assert shown("economy", None) == "-"
    assert shown("economy", 0.0, "us") == "-"
    assert shown("economy", 0.0) == "0.000 L/100 km"
    assert shown("economy", 5.0, "us") == "47.04 mpg"
    assert shown("speed", 10.0, "us", 0) == "22 mph"
