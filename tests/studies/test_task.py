from halfshaft import Cycle, Vehicle, run
from halfshaft.studies.task import Drive


def test_a_drive_finds_the_numbers_of_the_run():
    car, cycle = Vehicle.load("small-car-series"), Cycle.load("hwfet")
    found, result = Drive(cycle)(car), run(car, cycle)
    assert found.figures["fuel_L"] == result.figures["fuel_L"]
    assert "fuel_equivalent_basis" not in found.figures
    assert found.notes == result.warnings
    assert Drive(cycle).name == "hwfet"
