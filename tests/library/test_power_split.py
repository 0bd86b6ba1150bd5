"""Rules of the power split's parts that a whole vehicle shows only now and then."""

import casadi as ca
import numpy as np
import pytest

from halfshaft.cosim.cycle import Cycle, acceleration_cycle
from halfshaft.cosim.simulate import run
from halfshaft.library.base.ports import Electric, Shaft
from halfshaft.library.electric.motor import Motor
from halfshaft.models.assembly import step_turning
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.acceleration import prepared, time_to

CAR = Vehicle.load("small-car-power-split")
PARTS = CAR.components()
NODE, GEAR, GENERATOR = PARTS["node"], PARTS["planetary"], PARTS["generator"]


@pytest.mark.parametrize(
    ("first", "second", "supply", "given"),
    [
        (30.0, -10.0, 20.0, (30.0, -10.0)),
        # What is missing is the motor's while it drives, and then the generator's.
        (30.0, -10.0, 5.0, (15.0, -10.0)),
        (30.0, 10.0, 5.0, (0.0, 5.0)),
        (-5.0, 10.0, 0.0, (-5.0, 5.0)),
        # What nothing takes is the motor's while it brakes, and then the generator's.
        (-30.0, -10.0, -15.0, (-5.0, -10.0)),
        (-30.0, -10.0, -5.0, (0.0, -5.0)),
        (5.0, -20.0, -10.0, (5.0, -15.0)),
    ],
)
def test_the_motor_gives_way_to_the_generator(first, second, supply, given):
    asked = NODE.required(Electric(first), Electric(second))
    got = NODE.available(Electric(supply), asked["_asked"])
    assert (float(got["load"].P), float(got["other"].P)) == given


def test_speeds_of_the_gear_are_those_of_its_teeth():
    # 78 and 30 teeth: the carrier held, the ring turns the sun 2.6 times backward; all as fast as each other turn as one.
    assert GEAR.omega_sun(0.0, 100.0) == pytest.approx(-260.0)
    assert GEAR.omega_sun(120.0, 120.0) == pytest.approx(120.0)
    assert GEAR.omega_carrier(GEAR.omega_sun(150.0, 40.0), 40.0) == pytest.approx(150.0)


def test_torques_of_the_gear_balance_and_give_the_published_shares():
    ring, carrier = Shaft(50.0, 200.0, 3.0), Shaft(90.0, 250.0, 40.0)
    sun = GEAR.sun_of(ring, carrier)
    motor = GEAR.ask_motor(ring, sun.tau)
    assert sun.tau == pytest.approx(-90 * 30 / 108)
    assert motor.tau == pytest.approx(50 - 90 * 78 / 108)
    assert carrier.P + sun.P + motor.P == pytest.approx(ring.P)


def sent(part, shaft, **signals):
    (required,) = (f for f in part.faces() if f.name == "required")
    known = {"shaft": shaft, "turning": step_turning, "U_supply": 1e6, **signals}
    return required.run(**{n: known[n] for n in required.takes})


@pytest.mark.parametrize("tau", [-80.0, -20.0, 20.0, 80.0])
@pytest.mark.parametrize("omega", [30.0, 300.0, 700.0])
def test_backward_a_generator_is_its_mirror_image_and_forward_a_motor(tau, omega):
    ahead, back = (sent(GENERATOR, Shaft(k * tau, k * omega, k * 50.0)) for k in (1, -1))
    assert back["dc"] == ahead["dc"]
    assert back["throttle_motor"] == -ahead["throttle_motor"]
    assert back["tau_able"] == -ahead["tau_able"]
    motor = Motor(GENERATOR.p)
    as_motor = sent(motor, Shaft(tau, omega, 50.0), trace_missed=0.0, speed_ratio=0.0, omega_before=0.0, shifting=0.0)
    assert as_motor["dc"] == ahead["dc"]


class Control:
    """The control, fed with a demand at the ring; `step` returns what it decided."""

    def __init__(self, dt=1.0, **values):
        parts = CAR.with_values({f"control.{name}": x for name, x in values.items()}).components()
        self.part, self.dt, self.own = parts["control"], dt, 0.0
        self.known = {"gear": parts["planetary"], "engine": parts["engine"], "generator": parts["generator"], "key_on": 1.0, "dt": dt}
        self.state = {name: float(x) for name, x in self.part.start().items()}

    def step(self, P, omega=100.0, v=5.0, soc=0.6, decided=0.0, U=300.0):
        known = {
            **self.known, **self.state, "tau_ring": P / omega, "omega_ring": omega, "omega_ring_turning": omega, "v": v, "soc_before": soc,
            "U_supply": U, "omega_own": self.own, "decided": decided,
        }  # fmt: skip
        for face in ("want", "decide", "operate"):
            run = next(f for f in self.part.faces() if f.name == face)
            known |= run.run(**{n: known[n] for n in run.takes})
        self.state = {name: float(known[f"next_{name}"]) for name in self.state}
        self.own = float(known["omega_command"])
        return {name: float(known[name]) for name in (v.name for v in self.part.variables)}


@pytest.mark.parametrize("on", [{"P": 6001.0}, {"P": 100.0, "v": 12.5}, {"P": 100.0, "soc": 0.5}])
def test_the_engine_runs_for_power_speed_or_charge(on):
    control = Control()
    for _ in range(3):
        assert not control.step(5999.0, v=12.4, soc=0.501)["engine_on"]
    assert not control.step(5999.0, v=12.4, soc=0.501)["engine_on"]
    assert control.step(**on)["engine_on"]


@pytest.mark.parametrize("dt", [1.0, 0.5, 0.1])
def test_a_stopped_engine_stays_off_for_its_time(dt):
    control = Control(dt)
    off = 0
    while not control.step(2e4)["engine_on"]:
        off += 1
    assert off * dt == pytest.approx(3.0)
    assert not control.step(0.0)["engine_on"]
    off = 1
    while not control.step(2e4)["engine_on"]:
        off += 1
    assert off * dt == pytest.approx(3.0)


def settled(P, **more):
    control = Control(t_off_min=0.0)
    for _ in range(30):
        done = control.step(P, **more)
    return done


def test_the_engine_runs_on_its_line_and_charges_toward_the_target():
    done = settled(15e3, omega=300.0)
    # 15 kW at 1843 rpm, as published; at the target nothing is charged.
    assert done["omega_command"] == pytest.approx(192.998508686)
    assert done["omega_command"] * done["tau_command"] == pytest.approx(15e3)
    charging = settled(10e3, omega=300.0, soc=0.55)
    assert charging["P_engine_request"] == pytest.approx(10e3 + 88 * 0.05 * 300 / 0.85)


def test_above_25_kilowatts_the_engine_gives_all_that_the_generator_holds():
    slow, fast = settled(26e3, omega=200.0), settled(26e3, omega=450.0)
    assert slow["engine_full"]
    # The sun at its top speed.
    assert float(GEAR.omega_sun(slow["omega_command"], 200.0)) == pytest.approx(GENERATOR.omega_max)
    assert slow["tau_command"] == pytest.approx(26 * 108 / 30)
    # The engine's own top speed and torque.
    assert fast["omega_command"] == pytest.approx(4000 * np.pi / 30)
    assert fast["tau_command"] == pytest.approx(float(PARTS["engine"].tau_max(fast["omega_command"])))


def test_the_engine_turns_as_slowly_and_as_fast_as_the_generator_lets_it():
    # At 400 rad/s the ring would turn the sun beyond its top speed if the engine ran at 1200 rpm.
    done = settled(7e3, omega=420.0, v=30.0)
    assert float(GEAR.omega_sun(done["omega_command"], 420.0)) == pytest.approx(-GENERATOR.omega_max)
    assert settled(3e3, omega=100.0, v=15.0)["omega_command"] == pytest.approx(1200 * np.pi / 30)


def test_an_engine_that_stops_slows_down_by_closed_throttle_and_both_rotors():
    control = Control(0.1, t_off_min=0.0)
    for _ in range(100):
        control.step(2e4, omega=300.0)
    before = control.own
    done = control.step(0.0, omega=300.0)
    J = CAR.values["engine.J"] + CAR.values["generator.J"] * 3.6**2
    assert not done["engine_on"]
    assert before - done["omega_command"] == pytest.approx(0.1 * 40 / J)


def test_a_search_moves_the_motor_alone():
    control = Control(t_off_min=0.0)
    control.step(2e4)
    first = control.step(2e4)
    searched = control.step(2e3, decided=1.0)
    assert searched["engine_on"] == first["engine_on"] == 1
    assert searched["P_engine_request"] == first["P_engine_request"]


def test_refined_misses_no_more_than_plain():
    us06 = Cycle.load("us06")
    plain, refined = (run(CAR, us06, mode=mode) for mode in ("hybrid", "refined"))
    for of in (lambda r: r.highest["body.trace_miss"], lambda r: r.energies["body.trace_miss"]):
        assert of(refined) < of(plain)
    car = prepared(CAR)
    plain, refined = (time_to(run(car, acceleration_cycle(), dt=0.1, mode=mode), 100 / 3.6) for mode in ("hybrid", "refined"))
    assert refined < plain


def test_the_battery_keeps_its_window():
    low, high = (run(CAR.with_values({"battery.soc_start": soc}), Cycle.load("us06"))["battery.soc"] for soc in (0.46, 0.74))
    # One step goes beyond by what it draws.
    assert low.min() > 0.45 - 0.005
    assert high.max() < 0.75 + 0.005


def test_plant_and_step_ask_the_generator_for_the_same():
    shaft = Shaft(-20.0, -150.0, 30.0)
    power = GENERATOR.flow(shaft, step_turning)
    assert float(ca.DM(power["dc"].P)) == pytest.approx(float(sent(GENERATOR, shaft)["dc"].P))
