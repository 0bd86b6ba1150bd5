"""The compiled step of the power split against the same vehicle by hand."""

import numpy as np
import pytest
from twins.power_split import drive

from halfshaft import Cycle, InputError, Vehicle, run

CAR = Vehicle.load("small-car-power-split")
#: Cars that meet other limits and branches of the control.
CARS = {
    "as it is": {},
    "heavy, on snow": {"body.m": 2200.0, "wheel.mu_max": 0.3},
    "nearly empty": {"battery.soc_start": 0.455, "accessories.P_on": 2000.0},
    "nearly full": {"battery.soc_start": 0.745, "battery.capacity_scale": 0.3, "control.soc_target": 0.9},
    "little current": {"motor.I_max": 70.0, "generator.I_max": 25.0},
    "slow generator": {"generator.speed_scale": 0.7, "generator.torque_scale": 0.6, "generator.efficiency_scale": 0.9, "generator.J": 0.05},
    "weak motor": {"motor.torque_scale": 0.6, "motor.speed_scale": 0.8, "motor.J": 0.06, "motor.overtorque": 1.1},
    "scaled engine": {"engine.speed_scale": 0.8, "engine.torque_scale": 1.3, "engine.efficiency_scale": 1.1, "engine.J": 0.3},
    "another gear": {"planetary.r": 60.0, "planetary.s": 36.0, "final_drive.i": 4.3, "final_drive.tau_loss": 2.0, "final_drive.J": 0.02},
    "another control": {
        "control.P_on": 9000.0, "control.v_on": 20.0, "control.soc_on": 0.57, "control.t_off_min": 8.0, "control.soc_target": 0.65,
        "control.I_charge": 200.0, "control.eta_charge": 0.7, "control.P_full": 18e3, "control.omega_lowest": 140.0,
        "control.t_inertia": 1.5,
    },
    "motor that needs voltage": {"motor.U_min": 262.0},
    "generator that needs voltage": {"generator.U_min": 258.0},
    "window of its own": {"battery.soc_empty": 0.55, "battery.soc_full": 0.62, "battery.capacity_scale": 0.5},
}  # fmt: skip
#: Launches beyond the grip, hard stops, creeping, requests beyond top speed and power, up and down hill, half a minute without key.
LIMITS = Cycle(
    name="limits",
    time=[0, 3, 3.5, 14, 14.5, 19, 30, 42, 50, 56, 57, 63, 80, 92, 94, 110, 112, 118, 122, 126],
    speed=[0, 0, 25, 25, 0, 0, 1.5, 1.5, 14, 14, 0, 0, 75, 75, 20, 20, 0, 0, 10, 0],
    key_on=[1] * 14 + [0] * 2 + [1] * 4,
    grade_by_distance=([0, 150, 250, 400, 480, 900, 1400, 2000], [0, 0, 0.15, 0.15, -0.15, 0.06, -0.08, 0.01]),
)
RUNS = [(Cycle.load("udds"), 1.0), (Cycle.load("us06"), 1.0), (LIMITS, 1.0), (LIMITS, 0.1)]


@pytest.mark.parametrize("car", CARS)
def test_compiled_step_is_the_power_split_by_hand(car):
    vehicle = CAR.with_values(CARS[car])
    for cycle, dt in RUNS:
        result, by_hand = run(vehicle, cycle, dt=dt), drive(vehicle.parameters, cycle.sampled(dt))
        units = {d.name: d.unit for d in result.outputs}
        for column, x in by_hand.items():
            compiled = result[column]
            # What is nothing but rounding is measured by one unit; the achieved speed feeds it back, the more the shorter the step.
            scale = max(np.abs(compiled).max(), 1.0 if units[column] in ("W", "N", "N.m", "m/s", "rad/s") else 1e-12)
            np.testing.assert_allclose(x / scale, compiled / scale, rtol=0, atol=1e-9 / dt**2, err_msg=f"{column}, {cycle.name}, {dt} s")


#: For reports only.
WITHOUT_EFFECT = {f"{role}.mass" for role in ("engine", "motor", "generator")} | {"engine.rho_fuel"}


def test_every_parameter_moves_what_is_compared():
    still = {
        n for n in CAR.values if n.startswith(("planetary.", "generator.", "engine.", "control.", "motor.", "battery.soc_"))
    } - WITHOUT_EFFECT
    for car in CARS:
        base = CAR.with_values(CARS[car])
        firsts = {cycle: run(base, cycle) for cycle, dt in RUNS[:3]}
        for name in tuple(still):
            changed = other(base, name)
            if any(np.abs(first.history - run(changed, cycle).history).max() > 1e-3 for cycle, first in firsts.items()):
                still.discard(name)
    assert not still


def other(vehicle, name):
    """Return the vehicle with another number, larger or, where that is not allowed, smaller."""
    try:
        return vehicle.with_values({name: 1.1 * vehicle.values[name]})
    except InputError:
        return vehicle.with_values({name: 0.9 * vehicle.values[name]})
