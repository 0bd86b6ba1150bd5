"""What parallel hybrids of all forms do that others do not."""

from functools import cache

import numpy as np
import pytest

from halfshaft.cosim.cycle import Cycle
from halfshaft.cosim.simulate import run
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.acceleration import accelerate

vehicle_of = cache(Vehicle.load)
UDDS, US06 = Cycle.load("udds"), Cycle.load("us06")
CARS = (
    "small-car-parallel",
    "small-car-parallel-balanced",
    "small-car-parallel-post",
    "small-car-plug-in-parallel",
    "small-car-mild-hybrid",
)
every_car = pytest.mark.parametrize("name", CARS)


def repeated(cycle, n):
    time = np.concatenate([cycle.time[:-1] + k * cycle.time[-1] for k in range(n)])
    return Cycle(name="repeated", time=np.append(time, n * cycle.time[-1]), speed=np.append(np.tile(cycle.speed[:-1], n), 0.0))


@every_car
@pytest.mark.parametrize("dt", [1.0, 0.1])
def test_the_refined_mode_misses_no_more_than_the_plain_step(name, dt):
    # What the search keeps: engine on, clutch, gear.  What it moves: both torques, which follow the request.
    hybrid, refined = (run(vehicle_of(name), US06, dt=dt, mode=mode) for mode in ("hybrid", "refined"))
    # All in all: where the trace is out of reach for long, other speeds let the gears change in other steps.
    missed = [result["body.trace_miss"].clip(0).sum() for result in (hybrid, refined)]
    assert missed[1] <= missed[0] + 1e-6
    assert not refined.audit.failures


@every_car
def test_the_refined_mode_accelerates_no_slower_than_the_plain_step(name):
    refined, best = accelerate(vehicle_of(name)), accelerate(vehicle_of(name), mode="iteration")
    assert refined.time <= refined.time_hybrid + 1e-6
    assert refined.time == pytest.approx(best.time, rel=1e-4)


@pytest.mark.fmu
@every_car
@pytest.mark.parametrize("via", ["fmu2", "fmu3"])
def test_an_fmu_is_the_step(name, via):
    step, fmu = (run(vehicle_of(name), US06, via=v) for v in ("step", via))
    np.testing.assert_allclose(fmu.history, step.history, rtol=1e-12, atol=1e-9)


def test_a_plug_in_uses_its_battery_up_and_then_keeps_its_charge():
    car = vehicle_of("small-car-plug-in-parallel")
    result = run(car, repeated(UDDS, 12))
    ends = np.arange(1, 13) * 1369 - 1
    soc, fuel = result["battery.soc"][ends], np.diff(result["engine.fuel_used"][ends], prepend=0.0)
    low = car.values["control.soc_low"]
    assert fuel[0] == 0
    assert np.all(np.diff(soc[:7]) < -0.03)
    assert np.all(np.diff(fuel[:8]) >= 0)
    assert soc[7:] == pytest.approx(np.full(5, low), abs=1e-3)
    assert fuel[8:] == pytest.approx(np.full(4, fuel[-1]), rel=2e-3)
    # Without the switch the engine charges as soon as the charge is below the window, also at low speed.
    kept, depleting = (
        run(car.with_values({"battery.soc_start": 0.25, "control.charge_depleting": on}), UDDS)["control.engine_on"] for on in (0.0, 1.0)
    )
    slow = (result["body.v_mean"][:1369] < 5) & (result["body.a_request"][:1369] > 0.1) & (result.time[:1369] < 300)
    assert kept[slow].all()
    assert not depleting[slow].any()


@pytest.mark.parametrize("name", ["small-car-parallel", "small-car-mild-hybrid"])
def test_an_engine_that_is_off_burns_nothing_and_gives_nothing(name):
    result = run(vehicle_of(name), UDDS)
    off = result["control.engine_on"] == 0
    assert off.sum() > 100
    assert np.all(result["engine.fuel_flow"][off] == 0)
    assert np.all(result["clutch.tau"][off] == 0)
    assert off[(result["body.v_mean"] == 0) & (result.time > 1)].all()


def test_the_machine_of_a_mild_hybrid_starts_its_engine():
    result = run(vehicle_of("small-car-mild-hybrid"), UDDS, dt=0.1)
    on, J = result["control.engine_on"], vehicle_of("small-car-mild-hybrid").values["engine.J"]
    starts = np.flatnonzero((np.diff(on) > 0) & (result["engine.omega_engine"][:-1] == 0)) + 1
    assert len(starts) > 10
    assert np.all(result["motor.P_in"][starts] > 0)
    # A good part of what the rotor takes comes from the machine, up to its largest torque; the rest is the engine's own.
    taken = J * result["engine.omega_engine"][starts] / 0.1
    given = result["control.tau_machine"][starts]
    assert np.all(given > 0.2 * taken)
    assert np.all(given <= taken * (1 + 1e-12))


def test_the_rotor_of_a_machine_on_the_crankshaft_is_turned_in_the_forward_facing_model_too():
    car = vehicle_of("small-car-mild-hybrid")
    launch = Cycle(name="launch", time=np.array([0.0, 1.0, 1.001, 4.0]), speed=np.array([0.0, 0.0, 30.0, 30.0]))
    result = run(car, launch, via="forward")
    start, end = car.values["control.omega_idle"], result["engine.omega_engine"][-1]
    J = car.values["engine.J"] + car.values["coupler.n"] ** 2 * car.values["motor.J"]
    assert end > start + 100
    assert result.energies["engine.P_kinetic"] == pytest.approx(J * (end**2 - start**2) / 2, rel=1e-5)


def test_the_machine_of_a_mild_hybrid_helps_as_long_as_its_engine_is_below_its_top_speed():
    # Also where the trace asks for more than that in the gear that is in.
    result = accelerate(vehicle_of("small-car-mild-hybrid"), mode="hybrid").result
    top = float(vehicle_of("small-car-mild-hybrid").parameters["engine"].tau_max.points[0][-1])
    asked = (result["clutch.omega_required"] > top) & (result["clutch.tau"] > 0)
    assert asked.sum() > 5
    assert np.all(result["engine.omega_engine"][asked] < 0.99 * top)
    assert np.all(result["motor.tau"][asked] > 0)


@pytest.mark.parametrize(("name", "pulls"), [("small-car-parallel", False), ("small-car-parallel-post", True)])
def test_only_a_motor_behind_the_gearbox_pulls_while_a_gear_is_changed(name, pulls):
    result = run(vehicle_of(name).with_values({"shift.t_shift": 0.5}), UDDS, dt=0.1)
    changing = (result["shift.shifting"] > 0) & (result["body.F_required"] > 500)
    assert changing.sum() > 50
    share = result["wheel.F"][changing] / result["body.F_required"][changing]
    assert np.median(share) == (pytest.approx(1, abs=1e-6) if pulls else pytest.approx(0, abs=0.15))


@every_car
@pytest.mark.parametrize("mu", [0.1, 0.3])
def test_in_the_forward_facing_model_two_machines_share_what_the_tyres_hold(name, mu):
    # At one limit the balances of both would be the same.
    launch = Cycle(name="launch", time=np.array([0.0, 1.0, 1.001, 12.0, 12.001, 16.0]), speed=np.array([0.0, 0.0, 30.0, 30.0, 0.0, 0.0]))
    result = run(vehicle_of(name).with_values({"wheel.mu_max": mu}), launch, via="forward")
    p = vehicle_of(name).values
    a = np.diff(result["body.v"]) / np.diff(result.time)
    # m a = mu (m g share - m a h / L), resistances left out.
    highest = mu * p["body.g"] * p["body.front_share"] / (1 + mu * p["body.h"] / p["body.wheelbase"])
    assert a.max() < highest * 1.001
    assert abs(result.account.balance_relative) < 1e-6


def test_the_forward_facing_model_accelerates_more_slowly_by_what_the_engine_s_rotor_takes_between_gears():
    # After a change of gear the plant's clutch must slow the engine down first; with a light rotor both models agree.
    gaps = []
    for J in (0.1, 0.002):
        car = vehicle_of("small-car-parallel").with_values({"engine.J": J})
        gaps.append(accelerate(car, via="forward", duration=20).time / accelerate(car).time - 1)
    assert gaps[0] == pytest.approx(0.037, abs=0.01)
    assert abs(gaps[1]) < 0.01
