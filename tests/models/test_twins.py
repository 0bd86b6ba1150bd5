"""The compiled step against the vehicles by hand, and whether that covers every parameter."""

from dataclasses import replace

import numpy as np
import pytest
from twins.vehicles import TWINS, columns

from halfshaft import Cycle, InputError, Vehicle, run

UDDS, US06 = Cycle.load("udds"), Cycle.load("us06")
#: Launches that no tyre holds, stops harder than any brake, creeping, requests beyond top speed and power, up and down hill, a stop
#: on a slope, and half a minute with the key off.
LIMITS = Cycle(
    name="limits",
    time=[0, 3, 3.5, 14, 14.5, 19, 30, 42, 50, 56, 57, 63, 80, 92, 94, 110, 112, 118, 122, 126],
    speed=[0, 0, 25, 25, 0, 0, 1.5, 1.5, 14, 14, 0, 0, 75, 75, 20, 20, 0, 0, 10, 0],
    key_on=[1] * 14 + [0] * 2 + [1] * 4,
    grade_by_distance=([0, 150, 250, 400, 480, 900, 1400, 2000], [0, 0, 0.25, 0.25, -0.2, 0.06, -0.08, 0.01]),
)
MOVING = replace(US06, name="moving", time=US06.time[60:140], speed=US06.speed[60:140])
#: Cycle and length of the step; short steps feed an error back the more, so that they run a piece of it.
RUNS = {
    "udds": (UDDS, 1.0),
    "us06": (US06, 1.0),
    "limits": (LIMITS, 1.0),
    "limits, short steps": (LIMITS, 0.1),
    "moving": (MOVING, 0.2),
}

CHASSIS = {
    "as it is": {},
    "heavy": {"body.m": 2400.0},
    "on ice": {"wheel.mu_max": 0.15},
    "on ice, light at the rear": {"wheel.mu_max": 0.2, "body.front_share": 0.85, "body.h": 0.9, "body.wheelbase": 2.1},
    "rear-driven, weak brakes": {
        "wheel.front_driven": 0.0, "wheel.rear_driven": 1.0, "wheel.F_brake_front_max": 700.0, "wheel.F_brake_rear_max": 200.0,
    },
    "weak brakes": {"wheel.F_brake_front_max": 1500.0, "wheel.F_brake_rear_max": 300.0},
    "all-wheel-driven on snow": {"wheel.rear_driven": 1.0, "wheel.mu_max": 0.3, "wheel.J": 6.0},
    "draggy": {
        "body.c_d": 0.6, "body.A": 2.5, "body.rho": 1.4, "body.g": 9.6, "body.v_miss": 0.1, "wheel.f_0": 0.02,
        "wheel.f_1": 3e-4, "wheel.r": 0.33,
        "final_drive.i": 1.3, "final_drive.tau_loss": 3.0, "final_drive.J": 0.05, "gearbox.J": 0.02, "gearbox.speed_scale": 0.9,
        "gearbox.torque_scale": 0.8,
    },
    "no air": {"body.rho": 0.0},
}  # fmt: skip
MAPPED = {
    "map read as the original does": {"gearbox.omega_lookup": 0.0, "gearbox.e_lowest": 0.0},
    "poor gearbox": {"gearbox.efficiency_scale": 0.8, "gearbox.omega_lookup": 20.0, "gearbox.e_lowest": 0.5},
}
ELECTRIC = {
    "half the pack": {"battery.soc_start": 0.9, "battery.capacity_scale": 0.5},
    "empty": {"battery.soc_start": 0.02, "battery.capacity_scale": 0.3, "accessories.P_on": 2500.0, "accessories.eta": 0.8},
    "full": {"battery.soc_start": 1.0, "battery.capacity_scale": 100.0, "body.m": 1144.0},
    "kept in a window": {
        "battery.soc_start": 0.895, "battery.soc_empty": 0.6, "battery.soc_full": 0.9, "battery.capacity_scale": 0.2,
    },
    "charged at low voltage": {"battery.soc_start": 0.9, "battery.u_max": 13.0},
    "down to half its voltage": {"battery.soc_start": 0.9, "battery.capacity_scale": 0.15, "battery.u_min": 1.0, "motor.U_min": 0.0},
    "little current": {"motor.I_max": 80.0, "motor.U_min": 290.0},
    "few modules": {"battery.n_modules": 18.0, "battery.u_min": 11.2, "battery.soc_start": 0.5},
    "hot": {
        "battery.T_start": 309.0, "battery.T_ambient": 303.0, "battery.T_fan": 309.5, "battery.mass": 2.0, "battery.c_p": 500.0,
        "battery.R_th_fan": 0.2, "battery.R_th_still": 9.0, "battery.airflow": 0.002,
    },
    "slow motor": {
        "motor.speed_scale": 0.6, "motor.torque_scale": 1.4, "motor.efficiency_scale": 0.9, "motor.J": 0.1, "motor.overtorque": 0.8,
        "motor.omega_max": 700.0, "gearbox.ratios_1": 6.0,
    },
}  # fmt: skip
SERIES = {
    "starts empty": {"battery.soc_start": 0.38, "battery.capacity_scale": 0.2},
    "starts full, on": {"battery.soc_start": 0.81, "control.on_start": 1.0, "battery.capacity_scale": 0.1},
    "little generator current": {"generator.I_max": 40.0, "control.on_start": 1.0},
    "slow to change": {
        "control.on_start": 1.0, "control.P_min_share": 0.1, "control.P_max_share": 0.9, "control.P_rise": 1500.0, "control.P_fall": 900.0,
        "control.P_charge": 6000.0, "control.soc_high": 0.75, "control.soc_low": 0.3,
    },
    "restarts by demand": {"control.t_off_min": 20.0, "control.P_min_share": 0.12, "control.P_rise": 3000.0, "control.P_fall": 4000.0},
    "depletes first": {
        "control.charge_depleting": 1.0, "control.on_start": 1.0, "battery.soc_start": 0.62, "battery.capacity_scale": 0.1,
        "control.soc_high": 0.65, "control.soc_low": 0.55, "control.t_off_min": 5.0, "control.P_min_share": 0.05,
    },
    "no room": {"control.on_start": 1.0, "battery.soc_start": 0.79, "battery.u_max": 13.2, "control.P_min_share": 0.2},
    "heavy generator at low power": {
        "control.on_start": 1.0, "control.P_min_share": 0.12, "control.P_max_share": 0.3, "control.P_rise": 1e5, "control.P_fall": 1e5,
        "engine.J": 0.03, "generator.J": 1.5,
    },
    "scaled genset": {
        "control.on_start": 1.0, "engine.J": 0.6, "generator.J": 0.4, "engine.speed_scale": 0.8, "engine.torque_scale": 1.2,
        "engine.efficiency_scale": 0.9, "generator.speed_scale": 0.9, "generator.omega_max": 250.0, "generator.overtorque": 0.5,
        "generator.torque_scale": 0.6, "control.P_min_share": 0.6, "control.P_max_share": 0.9, "engine.H_fuel": 4e7,
    },
}  # fmt: skip
CONVENTIONAL = {
    "heavy rotor": {"body.m": 1800.0, "engine.J": 0.4},
    "takes time to shift": {"shift.t_shift": 0.25, "shift.t_hold": 2.0, "control.launch_share": 0.4},
    "shifts down at once": {"shift.t_raised": 0.0, "shift.t_shift": 1.2},
    "shifts down late": {"shift.t_raised": 6.0, "control.launch_share": 0.1},
    "off at stops, open when braking": {"control.idle_at_stop": 0.0, "control.open_when_braking": 1.0, "accessories.tau_on": 2.0},
    "idles fast": {"control.omega_idle": 130.0, "accessories.P_on": 2500.0, "accessories.eta": 0.7, "accessories.tau_on": 1.0},
    "scaled": {
        "engine.speed_scale": 0.7, "engine.torque_scale": 1.3, "engine.efficiency_scale": 1.1, "gearbox.torque_scale": 0.8,
        "engine.H_fuel": 4e7,
    },
    "close gears": {
        "gearbox.ratios_1": 9.0, "gearbox.ratios_2": 8.5, "gearbox.ratios_3": 6.0, "gearbox.ratios_4": 5.5, "gearbox.ratios_5": 3.5,
    },
    "kept in third gear": {"shift.t_hold": 1e9, "shift.gear_start": 3.0},
}  # fmt: skip
POLYNOMIAL = {f"c{i}": {f"gearbox.c{i}": c} for i, c in enumerate((0.9, 3.0, 0.3, 0.5, 0.05, 150.0), 1)}
WEAK = {
    "weak in all": {
        "motor.U_min": 300.0, "battery.T_start": 309.0, "battery.T_fan": 308.5, "battery.R_th_fan": 0.2, "battery.airflow": 0.002,
        "wheel.F_brake_front_max": 1500.0, "wheel.F_brake_rear_max": 300.0, "motor.I_max": 120.0,
    },
}  # fmt: skip
#: Shares of a braking force that come to more than 1, and a driveline that takes all of it.
ODD_WHEELS = """schema = 1
kind = "wheel"
name = "odd-wheels"
title = "Wheels whose brake shares overlap"
source = "made up for this test"

[parameters]
r = "0.3 m"
J = "2 kg m^2"
f_0 = 0.01
mu_max = 0.9

[parameters.slip]
adhesion = [0, 0.4, 0.9]
values = [0, 0.03, 0.12]

[parameters.tau_bearing]
m = {unit = "kg", values = [0, 2000]}
values = {unit = "N m", values = [2, 7]}

[parameters.share_driveline]
v = {unit = "m/s", values = [0, 4, 15, 18]}
values = [0, 0.6, 0.8, 1]

[parameters.share_front]
v = {unit = "m/s", values = [0, 4, 15, 18]}
values = [0.7, 0.6, 0.3, 0]
"""
OVERLAPPING = {
    "front-driven": {},
    "rear-driven": {"wheel.front_driven": 0.0, "wheel.rear_driven": 1.0},
    "all-wheel-driven": {"wheel.rear_driven": 1.0, "motor.I_max": 60.0},
}
SHIFTING = {
    "shifts": {},
    "kept in second gear": {"shift.t_hold": 1e9, "shift.gear_start": 2.0},
    "shifts slowly": {"shift.t_shift": 0.4, "gearbox.speed_scale": 0.8, "gearbox.torque_scale": 1.3, "gearbox.J": 0.02},
}
COLD = {
    "cold": {"battery.T_start": 275.0, "battery.T_ambient": 270.0, "battery.mass": 0.2},
    "warms up": {"battery.T_start": 285.0, "battery.T_ambient": 300.0, "battery.mass": 0.1, "battery.capacity_scale": 0.6},
}
AUTOMATIC = {
    "heavy rotor": {"body.m": 1800.0, "engine.J": 0.4},
    "takes time to lock": {"shift.t_shift": 2.5, "shift.t_hold": 3.0, "shift.t_raised": 5.0},
    "locks in all gears": {"shift.lockup_1": 1.0, "shift.lockup_2": 1.0, "shift.lockup_3": 1.0, "gearbox.J": 0.02},
    "never locks": {"shift.lockup_4": 0.0},
    "kept in third gear": {"shift.t_hold": 1e9, "shift.gear_start": 3.0},
    "large converter": {"converter.capacity_scale": 1.0, "accessories.P_on": 2500.0, "accessories.eta": 0.7, "accessories.tau_on": 1.0},
    "idles fast": {"control.omega_idle": 130.0, "converter.capacity_scale": 0.2},
    "scaled": {
        "engine.speed_scale": 0.7, "engine.torque_scale": 1.3, "engine.efficiency_scale": 1.1, "gearbox.torque_scale": 0.8,
        "engine.H_fuel": 4e7, "gearbox.speed_scale": 0.9,
    },
    "close gears": {"gearbox.ratios_1": 9.0, "gearbox.ratios_2": 8.0, "gearbox.ratios_3": 6.5, "gearbox.ratios_4": 2.0},
}  # fmt: skip
CVT = {
    "heavy rotor": {"body.m": 1800.0, "engine.J": 0.4},
    "changes slowly": {"shift.rate": 0.05, "gearbox.J": 0.02, "control.launch_share": 0.4},
    "changes at once": {"shift.rate": 1e6},
    "poor": {"gearbox.efficiency_scale": 0.7, "gearbox.speed_scale": 1.3, "gearbox.torque_scale": 0.6},
    "narrow": {"gearbox.ratios_1": 9.0, "gearbox.ratios_2": 4.0, "engine.H_fuel": 4e7},
    "off at stops, open when braking": {"control.idle_at_stop": 0.0, "control.open_when_braking": 1.0, "accessories.tau_on": 2.0},
    "idles fast": {"control.omega_idle": 130.0, "accessories.P_on": 2500.0, "accessories.eta": 0.7, "accessories.tau_on": 1.0},
    "scaled": {"engine.speed_scale": 0.7, "engine.torque_scale": 1.3, "engine.efficiency_scale": 1.1},
}  # fmt: skip
TWO_MOTOR = {
    "half the pack": ELECTRIC["half the pack"],
    "full": ELECTRIC["full"],
    "hot": ELECTRIC["hot"],
    "weak in all": {
        "motor_front.U_min": 300.0, "wheel.F_brake_front_max": 1500.0, "wheel.F_brake_rear_max": 300.0, "motor_front.I_max": 120.0,
    },
    "needs voltage at the rear": {"motor_rear.U_min": 300.0},
    "polynomials": {f"gearbox_{axle}.{name}": c for axle in ("front", "rear") for name, c in (("c1", 0.9), ("c3", 0.3), ("c6", 150.0))},
    "few modules": {"battery.n_modules": 18.0, "battery.u_min": 11.2, "battery.soc_start": 0.5},
    "weak at the rear": {"motor_rear.torque_scale": 0.3, "motor_front.I_max": 80.0, "motor_front.efficiency_scale": 0.9},
    "weak at the front": {"motor_front.torque_scale": 0.3, "motor_rear.I_max": 60.0, "motor_rear.efficiency_scale": 0.9},
    "slow at the rear": {"motor_rear.omega_max": 500.0, "motor_rear.J": 0.1, "gearbox_rear.ratios_1": 7.0, "gearbox_rear.J": 0.02},
    "slow at the front": {"motor_front.omega_max": 500.0, "motor_front.J": 0.1, "gearbox_front.ratios_1": 7.0, "gearbox_front.J": 0.02},
    "other reductions": {
        "final_drive_front.i": 1.3, "final_drive_front.tau_loss": 3.0, "final_drive_front.J": 0.05, "final_drive_rear.i": 0.8,
        "final_drive_rear.tau_loss": 2.0, "final_drive_rear.J": 0.03,
    },
    "front-driven": {"wheel.rear_driven": 0.0},
}  # fmt: skip
#: Vehicle of the library, other parts for it, and the values that it is run with.
FLEET = [
    ("small-car-electric", {}, CHASSIS | MAPPED | ELECTRIC),
    ("small-car-electric", {"gearbox": "five-speed-polynomial", "shift": "shift-conventional"}, SHIFTING),
    ("small-car-electric", {"battery": "nizn-22ah"}, COLD),
    ("small-car-electric", {"wheel": "odd-wheels"}, OVERLAPPING),
    (
        "small-car-conventional",
        {},
        {name: CHASSIS[name] for name in ("as it is", "on ice", "weak brakes", "draggy")} | MAPPED | CONVENTIONAL,
    ),
    ("small-car-conventional", {"gearbox": "five-speed-polynomial", "engine": "si-95kw-fuel-cut"}, SHIFTING),
    ("small-car-series", {}, {"as it is": {}} | WEAK | SERIES),
    ("small-car-series-follower", {}, {"as it is": {}, "gives and takes": SERIES["starts empty"] | {"control.t_off_min": 5.0}}),
    ("paper-series-1459", {}, POLYNOMIAL),
    ("small-car-automatic", {}, {name: CHASSIS[name] for name in ("as it is", "on ice", "weak brakes", "draggy")} | MAPPED | AUTOMATIC),
    ("small-car-cvt", {}, {name: CHASSIS[name] for name in ("as it is", "on ice", "weak brakes")} | CVT),
    ("small-car-two-motor", {}, {name: CHASSIS[name] for name in ("as it is", "on ice, light at the rear")} | TWO_MOTOR),
]
CARS = {
    f"{vehicle}{', ' * bool(parts)}{', '.join(parts.values())}: {name}": (vehicle, parts, values)
    for vehicle, parts, sets in FLEET
    for name, values in sets.items()
}


@pytest.fixture(scope="module")
def car_of(tmp_path_factory):
    """Return the vehicle of a name."""
    odd = tmp_path_factory.mktemp("parts") / "odd-wheels.toml"
    odd.write_text(ODD_WHEELS, encoding="utf-8")

    def car_of(name):
        vehicle, parts, values = CARS[name]
        parts = {role: odd if part == odd.stem else part for role, part in parts.items()}
        return Vehicle.load(vehicle).with_parts(parts).with_values(values)

    return car_of


def both(vehicle, cycle, dt):
    """Return the columns by hand, those of the compiled step, and by what to measure each."""
    result = run(vehicle, cycle, dt=dt)
    by_hand = columns(TWINS[vehicle.powertrain](vehicle.parameters, cycle.sampled(dt)))
    units = {d.name: d.unit for d in result.outputs}
    compiled = {name: result[name] for name in by_hand}
    # What is nothing but rounding is measured by one unit.
    scales = {n: max(np.abs(x).max(), 1.0 if units[n] in ("W", "N", "N.m", "m/s") else 1e-12) for n, x in compiled.items()}
    return by_hand, compiled, scales


@pytest.mark.parametrize("car", CARS)
def test_compiled_step_is_the_vehicle_by_hand(car_of, car):
    vehicle = car_of(car)
    # US06 brings nothing that UDDS and the limits do not; the cars as they are run it, to keep the tests fast.
    for name, (cycle, dt) in RUNS.items():
        if name == "us06" and CARS[car][2]:
            continue
        by_hand, compiled, scales = both(vehicle, cycle, dt)
        for column, scale in scales.items():
            # Operations in another order, fed back through the achieved speed, whose error a force takes over the step's length.
            np.testing.assert_allclose(
                by_hand[column] / scale, compiled[column] / scale, rtol=0, atol=1e-9 / dt, err_msg=f"{column}, {name}"
            )


def test_a_conventional_car_without_its_key_does_not_move():
    off = Cycle(name="off", time=[0, 5, 20, 40], speed=[0, 0, 15, 15], key_on=[0, 0, 0, 0])
    assert not np.any(run(Vehicle.load("small-car-conventional"), off)["body.v"])


def test_a_heavy_generator_gets_its_torque_from_the_engine(car_of):
    result = run(car_of("small-car-series: heavy generator at low power"), US06)
    assert not result.audit.failures
    assert result["generator.P_loss"].min() > -1e-6


#: The cycle sets the first, the axles tell the forward-facing model alone, the others are for reports only.
#: The window of the charge acts in a set of its own, "kept in a window".
WITHOUT_EFFECT = {
    "battery.soc_empty", "battery.soc_full",
    "body.v_start", "axle_front.rear", "axle_rear.rear", "motor_front.mass",
    "motor_rear.mass", "motor.mass", "generator.mass", "engine.mass", "engine.rho_fuel",
}  # fmt: skip


def other_value(vehicle, name):
    """Return the vehicle with another number, larger or, where that is not allowed, smaller."""
    x = vehicle.values[name]
    try:
        return vehicle.with_values({name: 1.25 * x or 0.01})
    except InputError:
        return vehicle.with_values({name: 0.8 * x})


def moved(first, second):
    """Return the largest difference of an output, as a share of its largest value."""
    a, b = first.history, second.history
    return np.max(np.abs(a - b).max(axis=0) / np.maximum(np.abs(a).max(axis=0), 1e-12))


@pytest.mark.parametrize("powertrain", TWINS)
def test_every_parameter_moves_what_is_compared(car_of, powertrain):
    cars = [(car_of(car), set(values)) for car, (_, _, values) in CARS.items()]
    cars = [(vehicle, values or set(vehicle.values)) for vehicle, values in cars if vehicle.powertrain == powertrain]
    still = {name for _, names in cars for name in names} - WITHOUT_EFFECT
    for vehicle, names in cars:
        firsts = {cycle: run(vehicle, cycle) for cycle in (LIMITS, US06)}
        for name in still & names:
            other = other_value(vehicle, name)
            # Far above what the comparison lets pass.
            if any(moved(first, run(other, cycle)) > 1e-6 for cycle, first in firsts.items()):
                still.discard(name)
    assert not still
