import pytest

from halfshaft import InputError, Vehicle, accelerate
from halfshaft.cosim.compiled import InterpretedStep
from halfshaft.studies import acceleration
from halfshaft.studies.acceleration import AccelerationTest, TopSpeedTest
from halfshaft.studies.conditions import MPH

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
    for place in ("studies.conditions", "cosim.simulate"):
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


def test_the_task_finds_what_accelerate_finds():
    for name in ("small-car-electric", "small-car-parallel", "small-car-conventional"):
        car = Vehicle.load(name)
        found = AccelerationTest(pairs=((0, 100), (50, 100)), unit="km/h", routine="1999")(car)
        assert found.figures["time_0_to_100_kmh_s"] == accelerate(car).time
        assert found.figures["time_50_to_100_kmh_s"] == accelerate(car).time - accelerate(car, to=50 / 3.6).time


def test_the_routines_differ_by_charge_and_launch():
    car = Vehicle.load("small-car-series")
    one, two = (AccelerationTest(routine=r)(car) for r in ("1999", "2000"))
    assert (one.result.figures["soc_start"], two.result.figures["soc_start"]) == (0.8, pytest.approx(0.6))
    assert AccelerationTest(soc=0.8)(car).figures == one.figures
    assert AccelerationTest(soc="own")(car).result.figures["soc_start"] == 0.7
    conventional = Vehicle.load("small-car-conventional")
    launched = conventional.with_values({"control.launch_share": 0.4})
    assert AccelerationTest(routine="1999")(conventional).figures == AccelerationTest()(launched).figures


def test_what_is_never_reached_is_none():
    found = AccelerationTest(pairs=((0, 60), (0, 190)), over=(1e6,), within=(5.0, 60.0), duration=50)(CAR).figures
    assert found["time_0_to_60_mph_s"] > 0
    assert [found[n] for n in ("time_0_to_190_mph_s", "time_over_1e+06_m_s", "distance_in_60_s_m")] == [None] * 3


def test_a_run_is_held_until_all_is_reached():
    slow = CAR.with_values({"body.m": 6000})
    found = AccelerationTest(pairs=((0, 30),), over=(2000.0,))(slow)
    assert found.figures["time_over_2000_m_s"] > 50


def test_without_one_source_a_hybrid_is_slower():
    car = Vehicle.load("small-car-parallel")
    both, engine, motor = (AccelerationTest(resting=r)(car) for r in ("none", "battery", "converter"))
    times = [x.figures["time_0_to_60_mph_s"] for x in (both, engine, motor)]
    assert times[0] < min(times[1:])
    assert engine.result.account.battery <= 0 < motor.result.account.battery
    assert motor.result.account.fuel == 0
    assert max(engine.result.the("traction input")) <= 0


def test_a_genset_alone_accelerates_as_its_power_allows():
    # A mass m at a power P needs m v^2 / (2 P) to a speed v; losses, drag and the start of the engine come on top.
    car = Vehicle.load("small-car-series")
    found = AccelerationTest(resting="battery")(car)
    least = car.mass * (60 * MPH) ** 2 / 2 / max(found.result["generator.P_out"])
    assert least < found.figures["time_0_to_60_mph_s"] < 2 * least
    assert found.result.inputs.mode == "hybrid"
    assert max(found.result["battery.P_out"]) <= 0


def test_a_battery_that_rests_never_gives_what_it_took():
    # While it waits, the engine of this car charges.
    battery = AccelerationTest(resting="battery")(Vehicle.load("small-car-power-split")).result["battery.P_out"]
    assert battery.min() < 0
    assert battery.max() <= 0


def test_top_speed_is_where_it_gains_no_more():
    found = TopSpeedTest()(CAR)
    assert found.figures["top_speed_mps"] == found.result.the("speed").max()
    assert found.notes[0].startswith("not held: 1.2")
    conventional = TopSpeedTest()(Vehicle.load("small-car-cvt"))
    assert not any(n.startswith("not held") for n in conventional.notes)
    assert conventional.result.the("speed")[-1] == pytest.approx(conventional.figures["top_speed_mps"], abs=1e-3)


def test_all_problems_of_the_options_are_named_at_once():
    with pytest.raises(InputError) as error:
        AccelerationTest(pairs=((60, 40), (0, 400), ("x", 3)), within=(0,), over=(-1,), routine="1998", soc="top", duration=5)(CAR)
    assert len(error.value.problems) == 8
    with pytest.raises(InputError, match="unit = 'knots', must be mph or km/h"):
        AccelerationTest(unit="knots")(CAR)
