"""What vehicles do at the ends of what they can: what a physicist would expect of each."""

from functools import cache

import numpy as np
import pytest

from halfshaft.cosim.cycle import Cycle
from halfshaft.cosim.simulate import run
from halfshaft.library.electric.store import SOC_FULL
from halfshaft.models.vehicle import Vehicle

vehicle_of, cycle_of = cache(Vehicle.load), cache(Cycle.load)
ELECTRIC, SERIES, CONVENTIONAL = "small-car-electric", "small-car-series", "small-car-conventional"
every_powertrain = pytest.mark.parametrize("name", [ELECTRIC, SERIES, CONVENTIONAL])
both_modes = pytest.mark.parametrize("mode", ["hybrid", "refined"])


def trace(*points, grade=0.0):
    """Return a cycle through points of time [s] and speed [m/s]."""
    time, speed = np.array(points, dtype=float).T
    return Cycle(name="trace", time=time, speed=speed, grade=np.full(len(time), grade))


def balanced(result):
    return abs(result.account.balance_relative) < 1e-9


def warned(result, text):
    return any(text in warning for warning in result.warnings)


@every_powertrain
@both_modes
def test_a_trace_out_of_reach_is_missed_from_below_and_met_again(name, mode):
    result = run(vehicle_of(name), trace((0, 0), (10, 60), (60, 60), (70, 10), (90, 10), (95, 0), (100, 0)), mode=mode)
    assert warned(result, "trace missed")
    assert balanced(result)
    # Never faster than asked, and slower by more than rounding only while it is out of reach.
    assert result["body.trace_miss"].min() > -1e-9
    assert np.abs(result["body.trace_miss"][-15:]).max() < 1e-9
    assert result["body.v"].min() >= 0


@every_powertrain
def test_refined_and_hybrid_agree_where_nothing_limits(name):
    calm = trace((0, 0), (20, 10), (40, 10), (60, 0))
    hybrid, refined = run(vehicle_of(name), calm), run(vehicle_of(name), calm, mode="refined")
    assert np.array_equal(hybrid.history, refined.history)


@pytest.mark.parametrize("mu", [0.05, 0.2])
@both_modes
def test_on_ice_the_front_wheels_accelerate_as_their_grip_allows(mu, mode):
    car = vehicle_of(ELECTRIC).with_values({"wheel.mu_max": mu, "body.c_d": 0.0})
    p = car.values
    result = run(car, trace((0, 0), (1, 30), (5, 30)), dt=0.1, mode=mode)
    assert warned(result, "grip limit")
    # m a + roll = mu (a_f m g - h / L m a)
    a = (mu * p["body.front_share"] - p["wheel.f_0"]) * p["body.g"] / (1 + mu * p["body.h"] / p["body.wheelbase"])
    # Refining stops within 1e-5 m/s of the best speed.
    assert np.diff(result["body.v"])[1:] == pytest.approx(np.full(48, a * 0.1), abs=2e-5)


AXLES = {"front": (1.0, 0.0), "rear": (0.0, 1.0), "all": (1.0, 1.0)}


@pytest.mark.parametrize("axles", AXLES)
@pytest.mark.parametrize("soc", [0.5, 1.0], ids=["half full", "full"])
@pytest.mark.parametrize("front_share", [0.3, 0.6, 0.85])
@both_modes
def test_no_axle_brakes_harder_than_its_tyres_hold(axles, soc, front_share, mode):
    front, rear = AXLES[axles]
    set_to = {"wheel.front_driven": front, "wheel.rear_driven": rear, "body.front_share": front_share, "battery.soc_start": soc}
    car = vehicle_of(ELECTRIC).with_values({**set_to, "wheel.mu_max": 0.15})
    p = car.values
    r = run(car, trace((0, 0), (40, 25), (46, 0), (60, 0), (80, 20), (84, 0), (90, 0)), mode=mode)
    F_driveline = r["wheel.F"] - r["wheel.F_brake_front"] - r["wheel.F_brake_rear"]
    v_before = np.append(0.0, r["body.v"][:-1])
    shift = p["body.h"] / p["body.wheelbase"] * p["body.m"] * 2 * (r["wheel.v_limited"] - v_before)
    W = p["body.m"] * p["body.g"]
    W_front, W_rear = front_share * W - shift, (1 - front_share) * W + shift
    for driven, braking, weight in ((front, "wheel.F_brake_front", W_front), (rear, "wheel.F_brake_rear", W_rear)):
        F = driven / (front + rear) * F_driveline + r[braking]
        assert np.all(r[braking] <= 0)
        assert np.all(F[r[braking] < 0] > -p["wheel.mu_max"] * weight[r[braking] < 0] - 1e-6)
    # Some braking is at the limit.
    assert r["wheel.slip_limited"][r["wheel.F"] < 0].any()
    assert warned(r, "too fast for the trace")
    assert balanced(r)


@both_modes
def test_a_stop_takes_no_more_from_the_car_than_its_motion(mode):
    car = vehicle_of(ELECTRIC)
    stop = trace((0, 30), (20, 30), (22, 0), (30, 0))
    result = run(car, stop, mode=mode)
    braking = result.time > 20
    p = car.values
    rotors = (p["wheel.J"] + p["motor.J"] * (p["gearbox.ratios_1"] * p["final_drive.i"]) ** 2) / p["wheel.r"] ** 2
    motion = 0.5 * (p["body.m"] + rotors) * 30**2
    lost = result["wheel.P_brake"][braking].sum()
    # The motor's share and the drag are not the pads'.
    assert 0.5 * motion < lost < motion
    given = result["battery.P_stored"][braking].sum()
    losses = sum(result[d.name][braking].sum() for d in result.outputs if d.booking == "loss")
    # Rotors slip, and their work is one of difference quotients.
    assert losses - given == pytest.approx(motion, rel=0.02)


@both_modes
def test_a_light_tyre_does_not_multiply_the_work_of_the_brakes(mode):
    result = run(vehicle_of(ELECTRIC).with_values({"wheel.mu_max": 0.1}), cycle_of("us06"), mode=mode)
    lost = sum(E for E in result.account.losses.values())
    # Force that no tyre holds was 1124 Wh, more than the car used.
    assert abs(result.account.speed_limit) < 1e-3 * lost
    assert 0 < result.energies["wheel.P_brake"] < 110 * 3600


def test_a_car_that_is_too_fast_is_not_one_that_missed_its_trace_from_below():
    result = run(vehicle_of(ELECTRIC).with_values({"wheel.mu_max": 0.15}), trace((0, 20), (2, 20), (6, 0), (40, 0)), history=False)
    assert result.highest["body.overspeed"] > 5
    assert warned(result, f"too fast for the trace by up to {3.6 * result.highest['body.overspeed']:.1f} km/h")
    assert not warned(result, "trace missed")
    assert result.summary["overspeed_max_mps"] == result.highest["body.overspeed"]


@pytest.mark.parametrize("via", ["step", "fmu3"])
def test_a_battery_beyond_the_ends_of_its_maps_says_so(via, tmp_path):
    car = vehicle_of(ELECTRIC).with_parts({"battery": "li-7ah"}).with_values({"battery.capacity_scale": 10.0})
    short = trace((0, 0), (20, 10), (40, 0))
    cold = run(car.with_values({"battery.T_start": 263.15}), short, via=via)
    assert warned(cold, "battery as cold as -10.0 degC, but maps of it are read at 0 degC, their end")
    assert warned(type(cold).load(cold.save(tmp_path / "cold.nc")), "battery as cold as -10.0 degC")
    warm = run(car.with_values({"battery.T_start": 323.15, "battery.T_ambient": 323.15}), short, via=via)
    assert warned(warm, "battery as warm as 50.0 degC, but maps of it are read at 41 degC, their end")
    assert not warned(run(car, short, via=via), "maps")
    # Maps that do not depend on the temperature have no end.
    assert not warned(run(vehicle_of(ELECTRIC).with_values({"battery.T_start": 263.15}), short, via=via), "maps")


@both_modes
def test_a_car_with_an_empty_battery_stays_where_it_is(mode):
    result = run(vehicle_of(ELECTRIC).with_values({"battery.soc_start": 0.0005}), cycle_of("udds"), mode=mode)
    assert np.all(result["body.v"] == 0)
    assert result["battery.soc"] == pytest.approx(np.full(1369, 0.0005), rel=1e-12)
    assert np.all(result["battery.P_stored"] == 0)
    assert balanced(result)
    for text in ("trace missed", "battery limit reached", "battery empty"):
        assert warned(result, text)


@both_modes
def test_a_car_drives_until_its_battery_is_empty_and_then_rolls_out(mode):
    result = run(vehicle_of(ELECTRIC).with_values({"battery.soc_start": 0.02}), trace((0, 0), (60, 10), (600, 10)), mode=mode)
    soc, v = result["battery.soc"], result["body.v"]
    empty = int(np.argmax(soc <= 1e-3))
    assert 60 < empty < 500
    assert np.abs(result["body.trace_miss"][:empty]).max() < 1e-9
    assert soc.min() > 0
    assert np.all(result["battery.P_stored"][empty + 1 :] <= 0)
    assert np.all(np.diff(v[empty + 1 :]) <= 1e-9)
    assert v[-1] == 0
    assert balanced(result)


def test_an_engine_drives_a_series_hybrid_whose_battery_is_empty():
    result = run(vehicle_of(SERIES).with_values({"battery.soc_start": 0.0005}), trace((0, 0), (60, 15), (300, 15)))
    assert result["engine.fuel_used"][-1] > 0
    assert result["battery.soc"][-1] > 0.0005
    assert result["body.v"][-1] == pytest.approx(15, abs=1e-9)
    assert balanced(result)


@both_modes
def test_a_full_battery_leaves_the_braking_to_the_friction_brakes(mode):
    stop = trace((0, 30), (60, 0))
    full, half = (run(vehicle_of(ELECTRIC).with_values({"battery.soc_start": soc}), stop, mode=mode) for soc in (1.0, 0.5))
    before = np.append(1.0, full["battery.soc"][:-1])
    assert np.all(full["battery.P_stored"][before >= SOC_FULL] >= 0)
    assert np.all(full["battery.soc"] <= 1)
    # The car brakes all the same, and what the motor does not take the pads do.
    assert np.abs(full["body.trace_miss"]).max() < 1e-9
    assert warned(full, "battery limit reached")
    assert not half.warnings
    assert half.energies["battery.P_stored"] < 0
    assert full.energies["wheel.P_brake"] - half.energies["wheel.P_brake"] > -half.energies["battery.P_stored"]
    assert balanced(full)
    assert balanced(half)


def test_a_braking_motor_feeds_the_accessories_though_the_battery_is_full():
    result = run(vehicle_of(ELECTRIC).with_values({"battery.soc_start": 1.0}), trace((0, 30), (20, 0)))
    k = 10
    assert result["battery.P_stored"][k] == 0
    assert result["motor.P_in"][k] == pytest.approx(-700, rel=1e-12)


@every_powertrain
@pytest.mark.parametrize("via", ["step", "forward"])
def test_a_cycle_without_length_gives_a_result_without_rows(name, via):
    result = run(vehicle_of(name), trace((0, 0)), via=via)
    assert result.history.shape == (0, len(result.outputs))
    assert result.warnings == ("the cycle has no length: nothing was run",)
    assert result.summary["distance_m"] == 0
    assert result.account.residual == 0
    assert result.dataset.sizes["time"] == 0


@every_powertrain
def test_a_cycle_may_start_at_speed(name):
    result = run(vehicle_of(name), trace((0, 20), (30, 20)))
    assert np.all(np.abs(result["body.v"] - 20) < 1e-9)
    assert result["body.distance"][-1] == pytest.approx(600, rel=1e-12)
    assert result.energies["body.P_kinetic"] == pytest.approx(0, abs=1e-6)
    assert balanced(result)


@every_powertrain
def test_a_last_step_may_be_shorter(name):
    result = run(vehicle_of(name), trace((0, 0), (10.25, 5)))
    assert result.time[-1] == 10.25
    assert result["body.v"][-1] == pytest.approx(5, abs=1e-9)
    assert result["body.distance"][-1] == pytest.approx(10.25 * 2.5, rel=1e-9)
    assert balanced(result)


HILL = ((0, 0), (20, 10), (60, 10), (80, 0))


@every_powertrain
@both_modes
def test_a_steep_hill_costs_its_height(name, mode):
    vehicle = vehicle_of(name)
    result = run(vehicle, trace(*HILL, grade=0.2), mode=mode)
    weight = vehicle.values["body.m"] * vehicle.values["body.g"]
    height = result["body.elevation"][-1]
    assert height == pytest.approx(result["body.distance"][-1] * 0.2 / np.sqrt(1.04), rel=1e-12)
    assert result.energies["body.P_climb"] == pytest.approx(weight * height, rel=1e-9)
    assert result.account.fuel + result.account.battery > weight * height
    assert balanced(result)


@every_powertrain
def test_a_steep_descent_is_braked_and_gives_back_less_than_its_height(name):
    vehicle = vehicle_of(name)
    charged = {"battery.soc_start": 0.5} if "battery.soc_start" in vehicle.values else {}
    result = run(vehicle.with_values(charged), trace(*HILL, grade=-0.2))
    height = -result["body.elevation"][-1]
    assert np.abs(result["body.trace_miss"]).max() < 1e-9
    assert result.energies["wheel.P_brake"] > 0
    gained = -result.account.battery
    assert gained < vehicle.values["body.m"] * vehicle.values["body.g"] * height
    assert gained > 0 or name == CONVENTIONAL
    assert balanced(result)


@every_powertrain
@pytest.mark.parametrize("grade", [0.2, -0.2])
def test_a_car_that_stands_on_a_hill_does_not_roll(name, grade):
    result = run(vehicle_of(name), trace((0, 0), (60, 0), grade=grade))
    assert np.all(result["body.v"] == 0)
    assert np.all(result["body.distance"] == 0)
    if name != CONVENTIONAL:
        assert np.all(result["motor.P_in"] == 0)
    assert balanced(result)


HOUR = trace((0, 0), (3600, 0))


@pytest.mark.parametrize("dt", [1.0, 10.0])
@pytest.mark.parametrize("name", [ELECTRIC, SERIES])
def test_an_hour_at_rest_costs_the_accessories_and_no_more(name, dt):
    vehicle = vehicle_of(name)
    result = run(vehicle, HOUR, dt=dt)
    P = vehicle.values["accessories.P_on"] / vehicle.values["accessories.eta"]
    # A sum of equal numbers.
    assert result.energies["accessories.P_loss"] == pytest.approx(P * 3600, rel=1e-12)
    assert result.energies["bus.P_out"] == pytest.approx(P * 3600, rel=1e-12)
    assert result.energies["motor.P_in"] == 0
    assert result.account.battery == pytest.approx(P * 3600 + result.energies["battery.P_loss"], rel=1e-12)
    assert result.energies["battery.P_loss"] < 0.01 * P * 3600


def test_an_hour_at_rest_costs_a_conventional_car_its_idling_fuel():
    vehicle = vehicle_of(CONVENTIONAL)
    result = run(vehicle, HOUR)
    engine, idle = vehicle.components()["engine"], vehicle.values["control.omega_idle"]
    tau = vehicle.values["accessories.tau_on"] + vehicle.values["accessories.P_on"] / (vehicle.values["accessories.eta"] * idle)
    flow = engine.fuel_flow(tau, idle)
    # After the first step, which brings the engine to idling speed.
    assert result["engine.fuel_flow"][1:] == pytest.approx(np.full(3599, flow), rel=1e-12)
    assert result["engine.fuel_used"][-1] == pytest.approx(3600 * flow, rel=1e-3)
    assert np.all(result["control.clutch_state"] == 1)


@pytest.mark.parametrize("name", [ELECTRIC, SERIES, CONVENTIONAL, "small-car-series-follower"])
def test_with_the_key_off_nothing_is_used(name):
    cycle = cycle_of("ftp")
    off = cycle.sampled(1.0).key_on == 0
    assert off.sum() == 600
    result = run(vehicle_of(name), cycle)
    outputs = {d.name for d in result.outputs}
    for used in ("accessories.P_loss", "motor.P_in", "engine.P_fuel", "engine.fuel_flow"):
        if used in outputs:
            assert np.all(result[used][off] == 0), used
    if "battery.P_stored" in outputs:
        # A genset that was running when the key was turned still spins down, into the battery.
        assert np.all(result["battery.P_stored"][off] <= 0)
        assert np.all(result["battery.P_stored"][off][2:] == 0)
    assert balanced(result)


@pytest.mark.parametrize("cycle", ["us06", "nycc"])
@pytest.mark.parametrize(
    "name",
    [ELECTRIC, "paper-series-2393", CONVENTIONAL, "small-car-series-follower"],
)
def test_no_part_gives_more_than_it_gets_in_any_step(name, cycle):
    # Refined: in hybrid steps that miss the trace, powers belong to two speeds.
    result = run(vehicle_of(name), cycle_of(cycle), mode="refined")
    lowest = {d.name: result[d.name].min() for d in result.outputs if d.booking == "loss"}
    # Rounding of powers up to 100 kW.
    assert {loss: P for loss, P in lowest.items() if P < -1e-6} == {}


@pytest.mark.parametrize("dt", [1.0, 0.1])
@both_modes
def test_an_engine_at_its_top_speed_holds_the_car(mode, dt):
    # Kept in first gear the engine would have to turn at twice its top speed.
    car = vehicle_of(CONVENTIONAL).with_values({"shift.t_hold": 1e9})
    result = run(car, cycle_of("udds"), dt=dt, mode=mode)
    top = float(car.components()["engine"].omega_max)
    assert result.highest["engine.omega"] == pytest.approx(top)
    rolling = top / car.values["gearbox.ratios_1"] * car.values["wheel.r"]
    # Braked tyres slip a little; the end speed of a step may exceed its mean speed, which the engine holds.
    assert result.highest["body.v_mean"] <= 1.01 * rolling
    assert result.highest["body.v"] < 1.02 * rolling
    assert "engine at its top speed" in str(result.warnings)
    assert "engine at its top speed" not in str(run(vehicle_of(CONVENTIONAL), cycle_of("udds"), dt=dt, mode=mode).warnings)
    # What it cannot use is no longer booked as a difference of speeds.
    assert abs(result.account.mismatch_relative) < 1e-3


def test_an_engine_at_its_top_speed_holds_the_car_forward_facing():
    car = vehicle_of(CONVENTIONAL).with_values({"shift.t_hold": 1e9})
    result = run(car, trace((0, 0), (10, 20), (12, 20)), via="forward")
    top = float(car.components()["engine"].omega_max)
    assert 0.99 * top < result.highest["engine.omega_engine"] <= top
    assert "engine at its top speed" in str(result.warnings)
