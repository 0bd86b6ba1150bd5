import pytest

from halfshaft import Vehicle, accelerate
from halfshaft.cosim.compiled import InterpretedStep
from halfshaft.studies import acceleration

CAR = Vehicle.load("small-car-electric")


def test_refined_is_the_default_and_the_hybrid_time_stands_beside():
    found = accelerate(CAR)
    iteration, hybrid = (accelerate(CAR, mode=mode) for mode in ("iteration", "hybrid"))
    assert found.result.inputs.mode == "refined"
    assert found.time == pytest.approx(iteration.time, abs=1e-3)
    assert found.time_hybrid == hybrid.time == hybrid.time_hybrid
    # The hybrid method is 8 % too slow for this car.
    assert hybrid.time > 1.05 * found.time
    assert iteration.time_hybrid == hybrid.time


def test_without_a_compiler_the_default_is_the_hybrid_method(monkeypatch):
    from halfshaft.models.assembly import assemble

    interpreted = InterpretedStep(assemble(CAR.model()))
    for place in ("studies.acceleration", "cosim.simulate"):
        monkeypatch.setattr(f"halfshaft.{place}.stepper_of", lambda _: interpreted)
    found = accelerate(CAR)
    assert found.result.inputs.mode == "hybrid"
    assert not found.result.inputs.compiled
    assert found.time == found.time_hybrid


def test_a_slow_car_gets_the_time_that_it_needs():
    slow = CAR.with_values({"body.m": 6000})
    assert accelerate(slow, duration=50).time is None
    found = accelerate(slow)
    assert 50 < found.time < 100
    assert found.time == accelerate(slow, duration=300).time
    assert found.result.time[-1] == 200


def test_a_car_that_gets_no_faster_is_not_waited_for():
    assert accelerate(CAR, to=300 / 3.6).result.time[-1] == 50
    assert accelerate(CAR.with_values({"body.m": 12000})).time is None


def test_a_longer_run_does_not_move_the_time():
    assert accelerate(CAR).time == accelerate(CAR, duration=acceleration.DURATIONS[-1]).time


def test_an_acceleration_is_shown_in_one_line():
    text = repr(accelerate(CAR))
    assert text == "<Acceleration small-car-electric, refined: 10.430 s (hybrid method 11.259 s)>"
    assert "never reached, highest speed 158.0 km/h" in repr(accelerate(CAR, to=300 / 3.6))
    assert "10.430 s" in accelerate(CAR)._repr_html_()
