"""The forward-facing model where a physicist would look first: on hills, at standstill, on ice, and when it is interrupted."""

import signal
import subprocess
import sys
from functools import cache

import numpy as np
import pytest

from halfshaft.cosim.acceleration import accelerate
from halfshaft.cosim.cycle import Cycle
from halfshaft.cosim.simulate import run
from halfshaft.models.vehicle import Vehicle

vehicle_of = cache(Vehicle.load)
ELECTRIC, SERIES, CONVENTIONAL = "small-car-electric", "small-car-series", "small-car-conventional"
every_powertrain = pytest.mark.parametrize("name", [ELECTRIC, SERIES, CONVENTIONAL])


def trace(*points, grade=0.0):
    """Return a cycle through points of time [s] and speed [m/s]."""
    time, speed = np.array(points, dtype=float).T
    return Cycle(name="trace", time=time, speed=speed, grade=np.full(len(time), grade))


def forward(car, cycle):
    result = run(car, cycle, via="forward")
    assert abs(result.account.balance_relative) < 1e-6
    return result


@every_powertrain
@pytest.mark.parametrize("grade", [0.2, -0.2, 0.05])
def test_a_car_starts_on_a_hill_and_never_rolls_back(name, grade):
    result = forward(vehicle_of(name), trace((0, 0), (2, 0), (10, 8), (30, 8), grade=grade))
    assert result["body.v"].min() > -1e-3
    # The small engine in first gear takes longer to come back from its launch.
    assert result["body.v"][-1] == pytest.approx(8, abs=0.15)


@every_powertrain
@pytest.mark.parametrize("grade", [0.2, -0.2])
def test_a_car_that_shall_stand_on_a_hill_stands(name, grade):
    result = forward(vehicle_of(name), trace((0, 0), (60, 0), grade=grade))
    assert abs(result["body.distance"][-1]) < 5e-3


def test_a_car_comes_to_rest_on_a_hill_that_is_too_steep():
    # 41 kW and 1 in 2.9: more torque than first gear has.
    result = forward(vehicle_of(CONVENTIONAL), trace((0, 5), (5, 8), (40, 8), grade=0.35))
    v = result["body.v"]
    assert v[-1] == pytest.approx(0, abs=1e-2)
    assert v.min() > -1e-2


@pytest.mark.parametrize("name", [ELECTRIC, CONVENTIONAL])
def test_on_ice_no_car_accelerates_faster_than_its_grip(name):
    mu = 0.1
    car = vehicle_of(name).with_values({"wheel.mu_max": mu, "body.c_d": 0.0})
    p = car.values
    v = forward(car, trace((0, 0), (1, 30), (8, 30)))["body.v"]
    # m a + roll = mu (a_f m g - h / L m a), on the front axle alone.
    highest = (mu * p["body.front_share"] - p["wheel.f_0"]) * p["body.g"] / (1 + mu * p["body.h"] / p["body.wheelbase"])
    # Rolling resistance sets in over the first 0.1 m/s.
    assert np.diff(v)[v[:-1] > 0.3].max() / 0.1 <= highest * (1 + 1e-4)
    assert v[-1] > 0.8 * highest * 7


def test_drag_opposes_motion_backward_too():
    body = vehicle_of(ELECTRIC).components()["body"]
    ahead, back = (body.motion(v, 0.0, 0.0, (0.01, 0.0), np.sign) for v in (20.0, -20.0))
    assert back["tyre"].F == -ahead["tyre"].F
    assert back["P_aero"] == ahead["P_aero"] > 0
    assert back["P_roll"] == ahead["P_roll"] > 0


def test_an_engine_that_stops_at_its_top_speed_does_not_stop_the_integrator():
    # With the shift lines of another engine it never leaves first gear.
    car = vehicle_of(CONVENTIONAL).with_parts({"engine": "ci-88kw"})
    ahead, step = accelerate(car, via="forward", duration=20.0).result, accelerate(car, mode="refined", duration=20.0).result
    assert ahead["body.v"].max() == pytest.approx(step["body.v"].max(), rel=0.01)


def test_the_integrator_keeps_its_messages_to_itself(capfd):
    forward(vehicle_of(CONVENTIONAL), trace((0, 0), (10, 12), (20, 12), (26, 0), (30, 0)))
    said = capfd.readouterr()
    assert (said.out, said.err) == ("", "")


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_an_interrupt_ends_a_forward_run():
    program = "import halfshaft as h; c = h.Vehicle.load('small-car-conventional'); u = h.Cycle.load('udds'); print(1, flush=True)\n"
    program += "try: h.run(c, u, via='forward')\nexcept KeyboardInterrupt: print('interrupted')"
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        running.stdout.readline()
        with pytest.raises(subprocess.TimeoutExpired):
            running.wait(4)  # well within the run, which takes longer than that
        running.send_signal(signal.SIGINT)
        out, err = running.communicate(timeout=20)
    assert out == "interrupted\n", err
