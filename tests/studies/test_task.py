from halfshaft import Cycle, Vehicle, run
from halfshaft.studies.task import Drive


def test_a_drive_finds_the_numbers_of_the_run():
    car, cycle = Vehicle.load("small-car-series"), Cycle.load("hwfet")
    found, result = Drive(cycle)(car), run(car, cycle)
    assert found.figures["fuel_L"] == result.figures["fuel_L"]
    assert "fuel_equivalent_basis" not in found.figures
    assert found.notes == result.warnings
    assert Drive(cycle).name == "hwfet"


def test_every_test_is_a_task_with_flat_figures():
    from halfshaft.studies.acceleration import AccelerationTest, TopSpeedTest
    from halfshaft.studies.gradeability import GradeabilityTest
    from halfshaft.studies.procedure import Procedure
    from halfshaft.studies.soc_correction import Linear, ZeroDelta

    car, cycle = Vehicle.load("small-car-series"), Cycle.load("hwfet")
    tasks = (AccelerationTest(), TopSpeedTest(), GradeabilityTest(), ZeroDelta(cycle=cycle), Linear(cycle=cycle), Procedure.load("nedc"))
    assert len({task.name for task in tasks}) == len(tasks)
    for task in tasks:
        found = task(car)
        assert found.figures
        assert all(x is None or type(x) in (int, float) for x in found.figures.values()), found.figures
        assert all(isinstance(note, str) for note in found.notes)
