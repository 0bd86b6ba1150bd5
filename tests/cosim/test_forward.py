"""The forward-facing model at its edges: hills, grip, a full battery, interrupts."""

import signal
import subprocess
import sys
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from halfshaft.cosim.cycle import Cycle
from halfshaft.cosim.forward import Forward, Interrupts
from halfshaft.cosim.simulate import run
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.acceleration import accelerate
from halfshaft.validation.powertrains import first_of_each

vehicle_of = cache(Vehicle.load)
#: One car of each powertrain, and the heaviest of the paper's.
CARS = (*first_of_each(), "paper-series-2393")


def hill(grade, *points, key_on=None):
    time, speed = map(np.array, zip(*points, strict=True))
    key = None if key_on is None else np.array(key_on, dtype=float)
    return Cycle(name="hill", time=time, speed=speed, grade=np.full(len(time), float(grade)), key_on=key)


def forward(name, cycle, **values):
    car = vehicle_of(name).with_values({k.replace("__", "."): x for k, x in values.items()})
    result = run(car, cycle, via="forward")
    assert abs(result.account.balance_relative) < 1e-6
    # Nothing is gained in any part.  The smallest loss is that of a gearbox which turns round.
    assert min(result.account.losses.values()) > -1e-6 * result.account.turnover
    return result


@pytest.mark.parametrize(("name", "grade"), [*((name, 0.2) for name in CARS), ("small-car-electric", -0.2), ("small-car-automatic", -0.2)])
def test_a_vehicle_stands_on_a_hill(name, grade):
    # It creeps: by less than 2 mm in a minute.
    result = forward(name, hill(grade, (0, 0), (15, 0)))
    assert abs(result["body.distance"][-1]) < 5e-4


@pytest.mark.parametrize("grade", [0.15, -0.05, -0.2])
@pytest.mark.parametrize("name", CARS)
def test_every_vehicle_starts_on_a_hill(name, grade):
    v = forward(name, hill(grade, (0, 0), (2, 0), (2.001, 8), (16, 8)))["body.v"]
    assert v.min() > -1e-3
    # The conventional car shifts to and fro: each time it has no torque for 0.2 s, and loses 0.3 m/s.
    assert v[-10:] == pytest.approx(np.full(10, 8), abs=0.5)


@pytest.mark.parametrize(
    ("name", "weak"), [("small-car-electric", "motor__torque_scale"), ("small-car-conventional", "engine__torque_scale")]
)
def test_a_car_that_cannot_climb_stays_where_it_is(name, weak):
    result = forward(name, hill(0.3, (0, 0), (2, 0), (2.001, 8), (30, 8)), **{weak: 0.15})
    assert np.abs(result["body.v"]).max() < 1e-3


def test_a_car_that_comes_to_rest_on_a_hill_does_not_roll_back():
    v = forward("small-car-electric", hill(0.3, (0, 10), (30, 10)), motor__torque_scale=0.15)["body.v"]
    assert v[0] > 9
    assert abs(v[-1]) < 1e-3
    assert v.min() > -1e-3


@pytest.mark.parametrize("name", ["small-car-electric", "small-car-conventional", "small-car-series"])
def test_where_the_tyres_cannot_hold_a_car_slides_and_all_resistances_oppose_it(name):
    result = forward(name, hill(0.25, (0, 0), (2, 0), (2.001, 8), (30, 8)), wheel__mu_max=0.1)
    v, cos = result["body.v"], 1 / np.hypot(1, 0.25)
    assert v[-1] < -10
    for power in ("body.P_aero", "body.P_roll", "wheel.P_brake"):
        assert result[power].min() > -1e-9
    # All four wheels brake with 0.1 of the weight, and the road drags.
    m, g = (vehicle_of(name).values[f"body.{x}"] for x in "mg")
    drag = (result["body.P_aero"] + result["body.P_roll"]) / np.abs(v) / m
    expected = -g * cos * (0.25 - 0.1) + drag
    rotors = np.diff(v)[50:] / 0.1 / expected[51:]
    assert rotors.min() > 0.75
    assert rotors.max() < 1.005


@pytest.mark.parametrize("name", ["small-car-electric", "small-car-conventional"])
def test_no_car_accelerates_beyond_its_grip(name):
    mu = 0.1
    car = vehicle_of(name)
    v = forward(name, hill(0, (0, 0), (1, 0), (1.001, 60), (20, 60)), wheel__mu_max=mu)["body.v"]
    p = {n: car.values[f"body.{n}"] for n in ("g", "front_share", "h", "wheelbase")}
    assert car.values["wheel.front_driven"] == 1
    # m a = mu (m g share - m a h / L), resistances left out.
    highest = mu * p["g"] * p["front_share"] / (1 + mu * p["h"] / p["wheelbase"])
    a = np.diff(v) / 0.1
    assert a.max() < highest
    assert a.max() > 0.75 * highest


def test_a_car_comes_to_rest_on_a_hill_that_is_too_steep():
    # 41 kW and 1 in 2.9: more torque than first gear has.
    v = forward("small-car-conventional", hill(0.35, (0, 5), (5, 8), (40, 8)))["body.v"]
    assert v[-1] == pytest.approx(0, abs=1e-2)
    assert v.min() > -1e-2


def test_drag_opposes_motion_backward_too():
    parts = vehicle_of("small-car-electric").components()
    body, wheel = parts["body"], parts["wheel"]
    ahead, back = (body.motion(v, 0.0, 0.0, wheel, np.sign) for v in (20.0, -20.0))
    assert back["tyre"].F == -ahead["tyre"].F
    assert back["P_aero"] == ahead["P_aero"] > 0
    assert back["P_roll"] == ahead["P_roll"] > 0


def test_brakes_stop_no_shorter_than_the_tyres_allow():
    v = forward("small-car-electric", hill(0, (0, 20), (0.5, 20), (0.6, 0), (25, 0)), wheel__mu_max=0.2)["body.v"]
    a = np.diff(v) / 0.1
    # 0.2 g, some resistance, and what the rotors and the weight's shift add.
    assert a.min() > -0.2 * 9.81 - 0.4
    assert abs(v[-1]) < 1e-3


@pytest.mark.parametrize("soc", [0.0, 0.002, 0.998, 1.0])
def test_an_electric_car_with_an_empty_or_full_battery(soc):
    result = forward("small-car-electric", hill(-0.1, (0, 0), (10, 10), (40, 10), (50, 0), (55, 0)), battery__soc_start=soc)
    assert np.all((result["battery.soc"] > -5e-3) & (result["battery.soc"] < 1 + 1e-6))
    assert abs(result["body.v"][-1]) < 1e-3


@pytest.mark.parametrize("name", ["small-car-electric", "small-car-conventional", "small-car-series-follower"])
def test_key_off_and_a_start_at_speed(name):
    result = forward(name, hill(0.02, (0, 15), (5, 15), (5.1, 15), (20, 15), (20.1, 15), (30, 15)))
    assert result["body.v"][0] == pytest.approx(15, abs=0.2)
    rolling = forward(name, hill(0.0, (0, 15), (5, 15), (5.1, 0), (25, 0), (30, 0), key_on=(1, 1, 0, 0, 0)))
    assert abs(rolling["body.v"][-1]) < 1e-3


def test_grade_over_distance():
    flat = Cycle.load("udds")
    cycle = replace(
        flat, time=flat.time[:60], speed=flat.speed[:60], grade_by_distance=(np.array([0.0, 50.0, 300.0]), np.array([0.0, 0.1, 0.1]))
    )
    result = forward("small-car-electric", cycle)
    assert result["body.elevation"][-1] > 1
    assert result.account.potential == pytest.approx(
        vehicle_of("small-car-electric").values["body.m"] * 9.81 * result["body.elevation"][-1], rel=1e-6
    )


def test_the_last_interval_is_as_long_as_its_sample():
    result = run(vehicle_of("small-car-electric"), hill(0, (0, 10), (1.25, 10)), via="forward")
    assert result["body.distance"][-1] == pytest.approx(12.5, abs=0.01)


@pytest.mark.parametrize("engine", ["ci-88kw", "si-41kw", "ci-330kw"])
def test_other_engines_run_to_the_end(engine):
    result = accelerate(vehicle_of("small-car-conventional").with_parts({"engine": engine}), via="forward").result
    assert abs(result.account.balance_relative) < 1e-6


def test_nothing_is_said_by_the_integrator(capfd):
    accelerate(vehicle_of("small-car-conventional"), via="forward")
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("start", [0.5, 3.0, -40.0])
def test_a_step_to_the_balance_is_cut_where_a_whole_one_leads_away_from_it(start):
    # From beyond 1.39 whole steps of Newton's method swing out further and further.
    bent = SimpleNamespace(_balance=lambda z, x, p: (np.arctan(z - 1), np.diag(1 / (1 + (z - 1) ** 2))))
    nothing = np.array([])
    assert Forward._newton(bent, np.array([1 + start]), nothing, nothing, 0.0) == pytest.approx([1], abs=1e-9)


INTERRUPTED = """
import numpy as np, os, signal, sys, threading, time
from halfshaft.cosim.cycle import Cycle
from halfshaft.cosim.simulate import run
from halfshaft.models.vehicle import Vehicle
car = Vehicle.load("small-car-electric")
run(car, Cycle(name="warm", time=np.array([0.0, 1.0]), speed=np.array([0.0, 1.0])), via="forward")
threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()
try:
    run(car, Cycle.load("wltc-class3"), via="forward")
except KeyboardInterrupt:
    print("interrupted")
else:
    print("went on")
"""


def test_an_interrupt_ends_the_run():
    done = subprocess.run([sys.executable, "-c", INTERRUPTED], capture_output=True, text=True, timeout=120, check=False)
    assert (done.stdout, done.stderr) == ("interrupted\n", "")


def test_a_cycle_without_length_leaves_all_powers_at_zero():
    rest = Cycle(name="rest", time=np.array([0.0]), speed=np.array([0.0]))
    result = run(Vehicle.load("small-car-electric"), rest, via="forward")
    assert len(result.time) == 0
    assert {x for name, x in result.last.items() if ".P_" in name} == {0.0}
    assert result.last["battery.soc"] == result.first["battery.soc"] > 0.5


THREADS = """
from concurrent.futures import ThreadPoolExecutor
from halfshaft import Cycle, Vehicle, run
car, us06 = Vehicle.load("small-car-electric"), Cycle.load("us06")
cycles = [us06.between(0, 10), us06.between(20, 30)]

def last(cycle):
    return run(car, cycle, via="forward")["body.v"][-1]

alone = list(map(last, cycles))
with ThreadPoolExecutor(2) as pool:
    print(list(pool.map(last, cycles)) == alone)
"""


def test_runs_in_two_threads_do_not_meet():
    # In a process of their own: where they meet it crashes.
    done = subprocess.run([sys.executable, "-c", THREADS], capture_output=True, text=True, timeout=120, check=False)
    assert (done.stdout, done.stderr) == ("True\n", "")


def test_where_interrupts_are_ignored_they_stay_so():
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        with Interrupts().listened_to():
            assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)
