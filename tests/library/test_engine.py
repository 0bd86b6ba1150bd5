import numpy as np
import pytest
from faces import in_turn

from halfshaft.library.base.ports import Shaft
from halfshaft.library.files.component_file import read_component


def engine(name="si-41kw", **values):
    file = read_component(name)
    return file.component(file.build(**values))


GEARED = {"geared": 1.0, "clutch_open": 0.0, "engine_on": 1.0}


def geared(part, tau, omega, *, dt=1.0, own=None, v=10.0, v_limited=10.0, **signals):
    """Return what a face gives for an engine behind an engaged clutch."""
    own = omega if own is None else own
    known = {**GEARED, "omega_engine": omega, "omega_command": omega, "fuel_used": 0.0, **signals}
    return in_turn(part, "torque", "burn", shaft=Shaft(tau, omega, 0.0), omega_own=own, dt=dt, v=v, v_limited=v_limited, **known)


def number(x):
    return float(x)


def test_an_engine_holds_what_is_geared_to_it_to_its_top_speed():
    part = engine()
    above = geared(part, 20.0, 1.3 * part.omega_max, omega_engine=part.omega_max)
    assert number(above["shaft"].omega) == pytest.approx(part.omega_max)
    assert number(above["speed_limited"]) == 1
    below = geared(part, 20.0, 300.0)
    assert number(below["shaft"].omega) == 300.0
    assert number(below["speed_limited"]) == 0


def test_load_and_rotor_share_a_torque_that_is_too_small_for_both():
    part = engine(J=0.5)
    omega, dt, v, v_limited = 300.0, 0.1, 10.0, 10.4
    alpha = 2 * (v_limited - v) / dt * omega / v_limited
    tau = number(geared(part, 60.0, omega, dt=dt, v=v, v_limited=v_limited)["shaft"].tau)
    # The acceleration falls with the torque, and with it what the rotor takes.
    assert 0 < tau < 60.0
    assert tau + 0.5 * alpha * tau / 60.0 == pytest.approx(number(part.tau_max(omega)))
    # A slipping clutch leaves the rotor alone.
    slipping = geared(part, 60.0, omega, dt=dt, v=v, v_limited=v_limited, clutch_slipping=1.0)
    assert number(slipping["shaft"].tau) == 60.0


def test_no_step_is_so_short_that_the_rotor_takes_all_torque():
    part = engine()
    given = []
    for dt in (1.0, 0.1, 0.01, 1e-4):
        # What grip allows at any step: 5 m/s^2, in first gear.
        given.append(number(geared(part, 300.0, 470.0, dt=dt, v=10.0 - 5 * dt / 2, v_limited=10.0)["shaft"].tau))
    assert given == pytest.approx([given[-1]] * 4)
    assert given[-1] > 0.9 * number(part.tau_max(470.0))


@pytest.mark.parametrize("dt", [1.0, 0.1, 0.01])
@pytest.mark.parametrize("jump", [150.0, -150.0])
def test_a_jump_of_speed_costs_the_rotor_its_momentum_at_any_step_and_the_vehicle_nothing(dt, jump):
    part, asked, omega = engine(), 30.0, 300.0
    own, momentum = omega - jump, 0.0
    for _ in range(round(1 / dt) if dt < 1 else 1):
        step = geared(part, asked, omega, dt=dt, own=own)
        assert number(step["shaft"].tau) == asked
        assert number(part.tau_closed(omega)) - 1e-9 <= number(step["tau_map"]) <= number(part.tau_max(omega)) + 1e-9
        momentum += (number(step["tau_map"]) - asked) * dt
        own = number(step["next_omega_own"])
    assert own == pytest.approx(omega)
    assert momentum == pytest.approx(part.p.J * jump)


def test_after_a_missed_trace_the_engine_turns_as_it_was_reached_in_the_gear_of_today():
    part = engine()
    missed = {"trace_missed": 1.0, "speed_ratio": 0.9, "command_before": 400.0, "omega_own": 380.0, "omega_free": 0.0, "dt": 1.0}
    known = {**missed, "omega_command": 500.0, "engine_on": 1.0, "omega_idle": 80.0, "clutch_open": 0.0, "geared": 1.0}
    assert number(in_turn(part, "spin", "speed", **known, ratio=5.0, ratio_before=5.0)["omega_engine"]) == pytest.approx(360.0)
    assert number(in_turn(part, "spin", "speed", **known, ratio=5.0, ratio_before=8.0)["omega_engine"]) == pytest.approx(225.0)
    # A slipping clutch does not tie it to the wheels.
    assert number(in_turn(part, "spin", "speed", **known, ratio=5.0, ratio_before=8.0, clutch_slipping=1.0)["omega_engine"]) == 500.0


def test_a_genset_speeds_up_no_faster_than_with_all_its_torque():
    part = engine(J=0.8)
    known = {"omega_command": 400.0, "engine_on": 1.0, "omega_idle": 0.0, "clutch_open": 0.0, "omega_free": 0.0, "command_before": 400.0}
    known |= {"trace_missed": 0.0, "speed_ratio": 1.0, "ratio_before": 1.0, "J_shaft": 0.01}
    omega = number(in_turn(part, "spin", "speed", **known, dt=0.1, omega_own=200.0)["omega_engine"])
    assert omega == pytest.approx(200.0 + 0.1 * number(part.tau_max(200.0)) / 0.81)
    assert number(in_turn(part, "spin", "speed", **known, dt=100.0, omega_own=200.0)["omega_engine"]) == 400.0


@pytest.mark.parametrize("dt", [1.0, 0.1])
def test_an_engine_on_its_own_comes_down_to_the_command_and_not_below(dt):
    part, J = engine(), 0.1
    known = {"engine_on": 1.0, "omega_idle": 0.0, "clutch_open": 1.0, "geared": 1.0, "command_before": 0.0, "trace_missed": 0.0}
    known |= {"speed_ratio": 1.0, "ratio_before": 1.0, "dt": dt, "tau_accessory_before": 2.0}

    def next_speed(own, command):
        return number(in_turn(part, "spin", "speed", **known, omega_own=own, omega_free=own, omega_command=command)["omega_engine"])

    # The command of a shaft that turns ever slower is met; with closed throttle the engine would fall far below.
    assert next_speed(178.4, 178.1) == pytest.approx(178.1, abs=1e-9)
    # What is too far away is come to with closed throttle, and the accessories.
    assert next_speed(400.0, 0.0) == pytest.approx(max(400.0 + dt / J * (number(part.tau_closed(400.0)) - 2.0), 0.0), rel=1e-12)


def test_the_plant_gives_no_torque_above_the_top_speed():
    part = engine()
    known = {"throttle_engine": 1.0, "omega_command": 300.0, "omega_idle": 80.0, "engine_on": 1.0, "clutch_open": 0.0, "geared": 1.0}

    def tau(omega):
        return number(part.turn(Shaft(0.0, omega, 0.0), omega, turning=lambda speed: speed > 0, **known)["tau_map"])

    assert tau(0.99 * part.omega_max) == pytest.approx(number(part.tau_max(0.99 * part.omega_max)))
    assert tau(part.omega_max) == 0
    assert np.all(np.diff([tau(x * part.omega_max) for x in (0.995, 0.997, 0.999, 1.0)]) < 0)
