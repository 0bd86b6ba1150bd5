import os

import numpy as np
import pytest

from halfshaft.cosim.by_fmu import march_fmu
from halfshaft.cosim.cycle import Cycle
from halfshaft.cosim.simulate import parameters_of, run, stepper_of
from halfshaft.library.base.errors import CompileError, InputError, SolveError
from halfshaft.models.vehicle import Vehicle

CARS = (
    "small-car-electric", "small-car-series", "small-car-conventional", "small-car-fuel-cell", "small-car-fuel-cell-polarisation",
    "small-car-power-split", "small-car-automatic", "small-car-cvt", "small-car-two-motor",
)  # fmt: skip
# Compiler, flags and arithmetic are the same, so the results are; the bound leaves room for other compilers.
TOLERANCE = {"rtol": 1e-12, "atol": 1e-12}


@pytest.mark.parametrize("via", ["fmu2", "fmu3"])
@pytest.mark.parametrize("car", CARS)
def test_an_fmu_drives_as_the_compiled_step_does(car, via):
    vehicle, us06 = Vehicle.load(car), Cycle.load("us06")
    step, fmu = run(vehicle, us06), run(vehicle, us06, via=via)
    assert fmu.inputs.via == via
    for name in ("body.v", "battery.soc", "engine.fuel_used", "body.distance"):
        if name in {d.name for d in step.outputs}:
            np.testing.assert_allclose(fmu[name], step[name], **TOLERANCE)
    np.testing.assert_allclose(fmu.history, step.history, **TOLERANCE)


@pytest.mark.parametrize("via", ["fmu2", "fmu3"])
def test_parameters_are_those_of_the_vehicle_not_of_the_build(via):
    us06 = Cycle.load("us06")
    built, heavier = Vehicle.load("small-car-electric"), Vehicle.load("small-car-electric").with_values({"body.m": 1500.0})
    run(built, us06, via=via)
    np.testing.assert_allclose(run(heavier, us06, via=via).history, run(heavier, us06).history, **TOLERANCE)


def test_grade_follows_the_distance_that_was_driven():
    car, road = Vehicle.load("small-car-conventional"), Cycle.load("hwfet-mtn")
    assert road.grade_by_distance is not None
    step = run(car, road)
    assert step.account.potential != 0
    np.testing.assert_allclose(run(car, road, via="fmu3").history, step.history, **TOLERANCE)


def test_other_steps_and_a_start_at_speed():
    car = Vehicle.load("small-car-electric")
    cycle = Cycle(name="coast", time=np.array([3.0, 8.0, 13.0]), speed=np.array([12.0, 15.0, 0.0]))
    step = run(car, cycle, dt=0.25)
    np.testing.assert_allclose(run(car, cycle, dt=0.25, via="fmu2").history, step.history, **TOLERANCE)


def test_a_shorter_last_step_is_refused():
    with pytest.raises(InputError, match=r"dt = 0.7 s leaves a last step of 0.1 s"):
        run(Vehicle.load("small-car-electric"), Cycle.load("us06"), via="fmu2", dt=0.7)


def test_a_cycle_without_length_gives_no_rows():
    point = Cycle(name="point", time=np.array([0.0]), speed=np.array([0.0]))
    assert run(Vehicle.load("small-car-electric"), point, via="fmu3").history.shape[0] == 0


@pytest.mark.parametrize(("name", "value"), [("body.h", 1.4), ("control.soc_low", 0.9), ("wheel.front_driven", 0.0)])
def test_an_fmu_refuses_what_a_vehicle_refuses_in_the_same_words(name, value):
    car, samples = Vehicle.load("small-car-series"), Cycle.load("us06").sampled(1.0)
    with pytest.raises(InputError) as refused:
        car.with_values({name: value})
    step = stepper_of(car).step
    parameters = parameters_of(car, step)
    parameters[step.parameter_index[name]] = value
    with pytest.raises(SolveError) as failed:
        march_fmu(step, samples, parameters, 1.0, 3)
    assert str(failed.value).endswith(f": {refused.value.problems[0]}")


@pytest.mark.parametrize("fmi", [2, 3])
def test_what_an_fmu_says_is_in_the_error(fmi):
    car = Vehicle.load("small-car-electric")
    step = stepper_of(car).step
    samples = Cycle.load("us06").sampled(1.0)
    parameters = parameters_of(car, step)
    samples = samples._replace(v=np.where(np.arange(len(samples.v)) == 3, np.nan, samples.v))
    with pytest.raises(SolveError, match=r"step from t = 3 s.*v_request .*finite number"):
        march_fmu(step, samples, parameters, 1.0, fmi)
    parameters[0] = -1.0
    with pytest.raises(SolveError, match=r"initialization.*body\.m = -1 kg, must be >"):
        march_fmu(step, samples, parameters, 1.0, fmi)


def test_a_folder_where_nothing_may_be_executed_is_said(monkeypatch):
    def refuse(path):
        raise OSError(f"{path}: failed to map segment from shared object")

    car, us06, here = Vehicle.load("small-car-electric"), Cycle.load("us06"), os.getcwd()
    run(car, us06)
    monkeypatch.setattr("fmpy.fmi1.cdll.LoadLibrary", refuse)
    with pytest.raises(CompileError, match=r"electric\.fmu cannot be loaded: .*failed to map segment.*set TMPDIR"):
        run(car, us06, via="fmu3")
    assert os.getcwd() == here
