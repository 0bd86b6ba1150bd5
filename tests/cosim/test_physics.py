"""Runs against what can be worked out without the package."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from halfshaft.cosim.account import account
from halfshaft.cosim.compiled import stepper
from halfshaft.cosim.cycle import Cycle, cycle_names
from halfshaft.cosim.forward import Forward
from halfshaft.cosim.simulate import run
from halfshaft.library.base.ports import Electric, Tyre
from halfshaft.library.base.tables import Table
from halfshaft.library.driveline.gearbox import PolynomialGearbox, PolynomialGearboxParameters
from halfshaft.library.electric.battery import Battery
from halfshaft.models.assembly import step_turning
from halfshaft.models.powertrains.electric import electric
from halfshaft.models.vehicle import Vehicle, vehicle_names
from halfshaft.studies.acceleration import accelerate

CAR = Vehicle.load("small-car-electric")


def constant(value, axes=1, clip=True):
    return Table.of(*([0.0],) * axes, values=np.full((1,) * axes, float(value)), clip=clip)


def lossless():
    """Return the parts of an electric car in which nothing is lost but to the road."""
    parts = CAR.components()

    def changed(role, **values):
        parts[role] = replace(parts[role], p=replace(parts[role].p, **values))

    none = dict.fromkeys(("c1", "c2", "c3", "c4", "c5", "c6"), 0.0)
    parts["gearbox"] = PolynomialGearbox(PolynomialGearboxParameters(ratios=(6.0,), **none))
    changed("wheel", J=0.0, mu_max=2.0, slip=constant(0), tau_bearing=constant(0, clip=False))
    changed("wheel", share_driveline=constant(1), share_front=constant(0))
    # tau * omega is bilinear: four points give it exactly.
    square = Table.of([0.0, 1000.0], [-1000.0, 1000.0], values=[[0.0, 0.0], [-1e6, 1e6]], clip=False)
    changed("motor", P_electric=square, tau_max=constant(1e5, clip=False), tau_min=constant(-1e5, clip=False))
    changed("motor", J=0.0, I_max=1e9, omega_max=1e4)
    changed("accessories", P_on=0.0)
    changed("battery", **ideal_battery())
    return parts


def ideal_battery(u=400.0, r=1e-9, eta=1.0, Q=1e6, soc=0.6):
    """Return parameters of a pack of one module with constant voltage and resistance."""
    circuit = {"u_oc": constant(u, 2), "r_discharge": constant(r, 2), "r_charge": constant(r, 2)}
    return {**circuit, "Q": constant(Q), "eta_coulomb": constant(eta), "n_modules": 1.0, "u_min": 0.0, "u_max": 1e4, "soc_start": soc}


class Made:
    """A model that no vehicle file describes, ready to run."""

    def __init__(self, parts):
        self.stepper = stepper(electric.model(parts))
        self.parameters = np.array([d.start for d in self.stepper.step.parameters])

    def run(self, cycle, dt):
        samples = cycle.sampled(dt)
        march = self.stepper.march(samples, self.parameters)
        names = [d.name for d in self.stepper.step.outputs]
        self.energies = dict(zip(names, march.sums.tolist(), strict=True))
        return {n: march.history[:, i] for i, n in enumerate(names)} | {"t": samples.t, "v_request": samples.v}


@pytest.fixture(scope="module")
def ideal():
    return Made(lossless())


V, T_UP, T_FLAT, T_DOWN = 20.0, 16.0, 20.0, 12.0
TRAPEZOID = Cycle(name="trapezoid", time=np.cumsum([0.0, T_UP, T_FLAT, T_DOWN]), speed=np.array([0.0, V, V, 0.0]))


def road(parts):
    body, wheel = parts["body"].p, parts["wheel"].p
    return body.m, body.m * body.g * wheel.f_0, 0.5 * body.rho * body.c_d * body.A


@pytest.mark.parametrize("dt", [1.0, 0.5, 0.1])
def test_a_lossless_car_draws_the_energy_of_its_road_load(ideal, dt):
    _, roll, aero = road(lossless())
    series = ideal.run(TRAPEZOID, dt)
    # Forces are those at the mean speed of a step: of v^3 on a ramp the mean is  v^3 + v (a dt)^2 / 4.
    distance = V * (T_FLAT + (T_UP + T_DOWN) / 2)
    cubes = V**3 * (T_FLAT + (T_UP + T_DOWN) / 4) - sum(0.25 * (V / T * dt) ** 2 * V * T / 2 for T in (T_UP, T_DOWN))
    assert ideal.energies["battery.P_stored"] == pytest.approx(roll * distance + aero * cubes, rel=1e-9)
    assert series["body.distance"][-1] == pytest.approx(distance, rel=1e-12)
    # What the chemistry gave is what the account says.
    assert (0.6 - series["battery.soc"][-1]) * 1e6 * 400 == pytest.approx(ideal.energies["battery.P_stored"], rel=1e-9)


def test_the_energy_of_a_lossless_car_converges_to_the_continuous_one_with_the_square_of_the_step(ideal):
    _, roll, aero = road(lossless())
    exact = roll * V * (T_FLAT + (T_UP + T_DOWN) / 2) + aero * V**3 * (T_FLAT + (T_UP + T_DOWN) / 4)
    errors = []
    for dt in (1.0, 0.5, 0.25, 0.02):
        ideal.run(TRAPEZOID, dt)
        errors.append(exact - ideal.energies["battery.P_stored"])
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=1e-3)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(2, abs=1e-3)
    assert abs(errors[-1]) < 1e-6 * exact


def test_a_hill_costs_its_potential_energy_and_gives_it_back(ideal):
    m, roll, _ = road(lossless())
    grade = 0.05
    climb = Cycle(name="hill", time=TRAPEZOID.time, speed=TRAPEZOID.speed, grade=np.full(4, grade))
    cos = 1 / np.sqrt(1 + grade**2)
    up = ideal.run(climb, 0.5)
    stored = ideal.energies["battery.P_stored"]
    s = up["body.distance"][-1]
    assert up["body.elevation"][-1] == pytest.approx(s * grade * cos, rel=1e-12)
    ideal.run(TRAPEZOID, 0.5)
    flat = ideal.energies["battery.P_stored"]
    assert stored - flat == pytest.approx(m * 9.81 * s * grade * cos - roll * (1 - cos) * s, rel=1e-9)
    ideal.run(replace(climb, grade=-climb.grade), 0.5)
    assert ideal.energies["battery.P_stored"] + stored == pytest.approx(2 * (flat - roll * (1 - cos) * s), rel=1e-9)


def test_coasting_follows_the_closed_solution_to_second_order():
    body, wheel = CAR.components()["body"], CAR.components()["wheel"]
    m, roll, aero = body.p.m, body.p.m * body.p.g * wheel.p.f_0, 0.5 * body.p.rho * body.p.c_d * body.p.A
    resistance = body.resistance(0.0, wheel)
    v_start, duration = 30.0, 60.0

    def coasted(dt):
        v = v_start
        for _ in range(round(duration / dt)):
            # Nothing at the tyres, and no driveline that bounds the speed.
            v = float(
                body.available(Tyre(0.0, 1e3, 0.0), 1e3, v, 0.0, 0.0, v, 0.0, dt, step_turning, resistance, Tyre(1.0, 0.0, 0.0))["next_v"]
            )
        return v

    a, b = roll / m, aero / m
    exact = np.sqrt(a / b) * np.tan(np.arctan(v_start * np.sqrt(b / a)) - np.sqrt(a * b) * duration)
    errors = [abs(coasted(dt) - exact) for dt in (4.0, 2.0, 1.0)]
    assert 5 < exact < 25
    # At the mean speed of the step: the midpoint rule.
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.05)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(2, abs=0.05)
    assert errors[2] < 2e-4


def test_a_coasting_body_comes_to_rest_and_stays():
    body = CAR.components()["body"]
    resistance = body.resistance(0.0, CAR.components()["wheel"])
    v = 1.0
    for _ in range(30):
        v = float(
            body.available(Tyre(0.0, 1e3, 0.0), 1e3, v, 0.0, 0.0, v, 0.0, 1.0, step_turning, resistance, Tyre(1.0, 0.0, 0.0))["next_v"]
        )
    assert v == 0


def pack(**values):
    base = CAR.components()["battery"].p
    return Battery(replace(base, **{**ideal_battery(r=0.1, eta=0.9), **values}))


def idle(battery, P=0.0):
    """Return the electric car with this pack, whose only load is that of the accessories."""
    parts = CAR.components()
    parts["battery"] = battery
    parts["accessories"] = replace(parts["accessories"], p=replace(parts["accessories"].p, P_on=P, eta=1.0))
    return parts


STILL = Cycle(name="still", time=np.array([0.0, 600.0]), speed=np.zeros(2))


@pytest.mark.parametrize("P", [500.0, 20e3])
def test_a_pack_under_constant_power_empties_in_a_straight_line(P):
    made = Made(idle(pack(), P))
    series = made.run(STILL, 1.0)
    U, R = 400.0, 0.1
    current = (U - np.sqrt(U**2 - 4 * R * P)) / (2 * R)
    np.testing.assert_allclose(series["battery.soc"], 0.6 - current * series["t"] / 1e6, rtol=1e-12)
    assert made.energies["battery.P_loss"] == pytest.approx(R * current**2 * 600, rel=1e-9)
    assert series["battery.U"][-1] == pytest.approx(U - R * current, rel=1e-12)


@pytest.mark.parametrize(("soc", "out", "into"), [(0.00105, 0.5, 1.0), (0.5, 1.0, 1.0), (0.998975, 1.0, 0.25)])
def test_forward_facing_the_room_of_a_pack_fades_where_it_is_empty_or_full(soc, out, into):
    battery, U_min = pack(), (CAR.components()["motor"].p.U_min,)
    source = battery.source((1 - soc) * 1e6, 293.15)
    limits, room = battery.limits_at(source, U_min), battery.flow(Electric(1e3), source, U_min)
    assert float(limits.P_min) < -1e4
    assert float(limits.P_max) > 1e4
    assert float(room["P_room_out"]) == pytest.approx(out * float(limits.P_max) - 1e3, rel=1e-6)
    assert float(room["P_room_in"]) == pytest.approx(1e3 - into * float(limits.P_min), rel=1e-6)


def test_a_pack_stores_the_coulombic_share_of_what_it_is_charged_with():
    battery, U_min = pack(), (CAR.components()["motor"].p.U_min,)
    source = battery.source(5e5, 293.15)
    given = battery.available(Electric(-10e3), battery.limits_at(source, U_min), source)
    given |= battery.store(source, given["U"], given["I"], 5e5, 293.15, 1.0)
    given = {n: float(x) for n, x in given.items() if n != "dc"}
    current = (400 - np.sqrt(400**2 + 4 * 0.1 * 10e3)) / 0.2
    assert given["I"] == pytest.approx(current, rel=1e-12)
    assert given["next_charge_drawn"] - 5e5 == pytest.approx(0.9 * current, rel=1e-9)
    assert given["next_soc"] - 0.5 == pytest.approx(-0.9 * current / 1e6, rel=1e-9)
    assert given["P_loss"] == pytest.approx(0.1 * current**2 + 0.1 * 400 * abs(current), rel=1e-9)


def test_a_pack_that_warms_has_the_charge_of_its_present_capacity():
    # A quarter of 5e5 C is drawn; of 1e6 C, when the pack is warm, that is an eighth.
    capacity = Table.of([273.15, 313.15], values=[5e5, 1e6])
    battery = pack(Q=capacity, soc_start=0.75, T_start=273.15, T_ambient=313.15, mass=1.0, R_th_still=1e-2, T_fan=400.0)
    made = Made(idle(battery))
    series = made.run(STILL, 1.0)
    assert np.all(series["battery.charge_drawn"] == 0.25 * 5e5)
    assert series["battery.T"][-1] == pytest.approx(313.15, abs=1e-9)
    np.testing.assert_allclose(series["battery.soc"], 1 - 0.25 * 5e5 / (5e5 + 5e5 * (series["battery.T"] - 273.15) / 40), rtol=1e-12)
    assert series["battery.soc"][-1] == pytest.approx(0.875, abs=1e-9)
    # Forward-facing the same.
    forward = Forward(electric.model(idle(battery)))
    done = forward.run(STILL.between(0, 160).sampled(forward.driver.dt), made.parameters)
    soc = done.history[:, [d.name for d in forward.plant.shown].index("battery.soc")]
    assert soc[-1] == pytest.approx(0.875, abs=1e-6)


def test_more_modules_side_by_side_have_more_charge_and_less_resistance():
    # Two strings of the pack: each carries half of the current.
    one, two = (Made(idle(pack(capacity_scale=n), P=n * 10e3)) for n in (1.0, 2.0))
    series_1, series_2 = one.run(STILL, 1.0), two.run(STILL, 1.0)
    np.testing.assert_allclose(series_2["battery.I"], 2 * series_1["battery.I"], rtol=1e-12)
    np.testing.assert_allclose(series_2["battery.U"], series_1["battery.U"], rtol=1e-12)
    np.testing.assert_allclose(series_2["battery.soc"], series_1["battery.soc"], rtol=1e-12)
    np.testing.assert_allclose(series_2["battery.charge_drawn"], 2 * series_1["battery.charge_drawn"], rtol=1e-12)
    assert series_1["battery.soc"][-1] < 0.59


def test_a_pack_warms_exponentially_with_first_order_in_the_step():
    P, battery = 20e3, pack(T_fan=400.0)
    made, p = Made(idle(battery, P)), battery.p
    current = (400 - np.sqrt(400**2 - 4 * 0.1 * P)) / 0.2
    tau = p.R_th_still * p.mass * p.c_p
    exact = 293.15 + 0.1 * current**2 * p.R_th_still * (1 - np.exp(-600 / tau))
    errors = [abs(made.run(STILL, dt)["battery.T"][-1] - exact) for dt in (40.0, 20.0, 10.0)]
    assert exact > 294
    assert np.log2(errors[0] / errors[1]) == pytest.approx(1, abs=0.1)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(1, abs=0.1)


_TIME = np.arange(0, 80.005, 0.01)
#: Smooth in speed and acceleration, driven and braked, and never at a limit or at rest.
SMOOTH = Cycle(name="smooth", time=_TIME, speed=5 + 12 * np.sin(np.pi * _TIME / 80) ** 4 + 3 * np.sin(2 * np.pi * _TIME / 80) ** 4)


def at_steps(dt):
    """Return the smooth cycle with its points at the steps: nearer ones would be averaged."""
    time = np.arange(0, 80 + dt / 2, dt)
    return replace(SMOOTH, time=time, speed=np.interp(time, SMOOTH.time, SMOOTH.speed))


def smooth_car():
    """Return a car without a map gearbox, whose kinks would hide the order."""
    return CAR.with_parts({"gearbox": "single-polynomial", "motor": "pm-32kw"})


def met(series):
    return np.abs(series["body.trace_miss"]).max() < 1e-9


def test_energy_converges_with_first_order_in_the_step():
    def drawn(dt):
        result = run(smooth_car(), at_steps(dt), dt=dt)
        assert met(result)
        return result.energies["battery.P_stored"]

    fine = drawn(0.005)
    errors = np.array([drawn(dt) - fine for dt in (1.0, 0.5, 0.25, 0.125)])
    # Inertia works by the difference quotient of the past, voltage and temperature are those of the start of the step;
    # the forces, of second order, still show at 1 s.
    assert np.log2(errors[:-1] / errors[1:]) == pytest.approx(np.ones(3), abs=0.3)
    assert errors[0] < 1e-3 * fine


def test_the_step_goes_over_into_the_forward_facing_model_with_first_order():
    # The plant neglects the slip's rate; without slip nothing is left between the two but the step's length.
    parts = smooth_car().components()
    parts["wheel"] = replace(parts["wheel"], p=replace(parts["wheel"].p, slip=constant(0)))
    made, forward = Made(parts), Forward(electric.model(parts))
    made.parameters[made.stepper.step.parameter_index["body.v_start"]] = SMOOTH.speed[0]
    samples = SMOOTH.sampled(forward.driver.dt)
    done = forward.run(samples, made.parameters)
    v = done.history[:, [d.name for d in forward.plant.shown].index("body.v")]
    assert np.abs(v - samples.v).max() < 1e-3
    reference = done.energies["battery.P_stored"]
    errors = []
    for dt in (1.0, 0.5, 0.25, 0.125, 0.01):
        assert met(made.run(at_steps(dt), dt))
        errors.append(made.energies["battery.P_stored"] - reference)
    assert np.log2(np.array(errors[:3]) / errors[1:4]) == pytest.approx(np.ones(3), abs=0.2)
    # The driver's error of speed, and the smooth switches of the plant.
    assert abs(errors[-1]) < 2e-5 * reference


def test_a_library_car_needs_the_same_forward_facing():
    step, forward = run(CAR, SMOOTH, dt=0.1), run(CAR, SMOOTH, via="forward")
    assert met(step)
    # Slip's rate, and a map gearbox that is smoothed where it turns from driving to braking: 0.15 %.
    assert forward.account.battery == pytest.approx(step.account.battery, rel=0.002)


vehicle_of, cycle_of = cache(Vehicle.load), cache(Cycle.load)
every_vehicle = pytest.mark.parametrize("vehicle", vehicle_names())


@every_vehicle
@pytest.mark.parametrize("cycle", cycle_names())
@pytest.mark.parametrize("mode", ["hybrid", "refined"])
def test_energy_balances_for_every_vehicle_on_every_cycle(vehicle, cycle, mode):
    result = run(vehicle_of(vehicle), cycle_of(cycle), mode=mode, history=False)
    # Sums over some thousand steps of a hundred roundings each: 1e-11; the design asks for 1e-9.
    assert abs(result.account.balance_relative) < 1e-9


@every_vehicle
@pytest.mark.parametrize("cycle", ["udds", "us06"])
def test_power_balances_in_every_single_step(vehicle, cycle):
    result = run(vehicle_of(vehicle), cycle_of(cycle))
    sign = {"": 0, "fuel": 1, "stored": 1}
    rest = sum(sign.get(d.booking, -1) * result[d.name] for d in result.outputs)
    assert np.abs(rest).max() < 1e-9 * np.abs(result["body.P_kinetic"]).max()


@every_vehicle
def test_kinetic_and_stored_energies_are_the_differences_of_their_states(vehicle):
    vehicle = vehicle_of(vehicle)
    cycle = cycle_of("us06")
    result = run(vehicle, replace(cycle, time=cycle.time[:300], speed=cycle.speed[:300]))
    v = result["body.v"][-1]
    assert result.energies["body.P_kinetic"] == pytest.approx(0.5 * vehicle.values["body.m"] * v**2, rel=1e-9)
    if "engine" in vehicle.parts:
        burnt = result["engine.fuel_used"][-1] * vehicle.values["engine.H_fuel"]
        assert result.energies["engine.P_fuel"] == pytest.approx(burnt, rel=1e-9, abs=1e-6)


@every_vehicle
def test_losses_of_a_run_are_not_negative(vehicle):
    result = run(vehicle_of(vehicle), cycle_of("us06"))
    assert {n: e for n, e in result.account.losses.items() if e < -1e-6} == {}


@every_vehicle
def test_the_refined_step_leaves_no_speed_mismatch(vehicle):
    vehicle = vehicle_of(vehicle)
    assert abs(run(vehicle, cycle_of("us06"), mode="refined").account.mismatch_relative) < 1e-3
    assert abs(accelerate(vehicle, mode="refined").result.account.mismatch_relative) < 1e-3


def test_the_account_of_the_lossless_car_has_no_losses_but_those_of_the_road(ideal):
    ideal.run(TRAPEZOID, 0.5)
    losses = account(ideal.stepper.step.outputs, ideal.energies).losses
    assert {n for n, e in losses.items() if abs(e) > 1e-2} == {"body.P_aero", "body.P_roll"}
