import pytest

from halfshaft.cosim.cycle import Cycle
from halfshaft.cosim.simulate import run
from halfshaft.models.vehicle import Vehicle
from halfshaft.validation.hostile import attempt, attempt_result


@pytest.mark.parametrize("first", [0, 100])
def test_whatever_a_file_holds_it_runs_or_is_refused(first, tmp_path):
    outcomes = {attempt(tmp_path, seed) for seed in range(first, first + 60)}
    assert outcomes >= {"ran", "InputError"}


def test_a_broken_result_loads_or_is_refused(tmp_path):
    path = run(Vehicle.load("small-car-electric"), Cycle.load("im240")).save(tmp_path / "run.nc")
    outcomes = {attempt_result(path.read_bytes(), tmp_path / "broken.nc", seed) for seed in range(150)}
    assert outcomes == {"loaded", "refused"}
