"""The compiled step against the power split by hand, and what a power split must show."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from halfshaft.cosim.cycle import Cycle
from halfshaft.cosim.simulate import run
from halfshaft.models.vehicle import Vehicle

TWIN = runpy.run_path(str(Path(__file__).with_name("power_split_twin.py")))

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
    "another gear": {"gear.r": 60.0, "gear.s": 36.0, "final_drive.i": 4.3, "final_drive.tau_loss": 2.0, "final_drive.J": 0.02},
    "another control": {
        "control.P_on": 9000.0, "control.v_on": 20.0, "control.soc_on": 0.57, "control.t_off_min": 8.0, "control.soc_target": 0.65,
        "control.I_charge": 200.0, "control.eta_charge": 0.7, "control.P_full": 18e3, "control.omega_lowest": 140.0, "control.t_inertia": 1.5,
    },
    "window of its own": {"battery.soc_empty": 0.55, "battery.soc_full": 0.62, "battery.capacity_scale": 0.5},
}  # fmt: skip
#: Launches beyond the grip, hard stops, creeping, requests beyond top speed and power, and half a minute with the key off.
LIMITS = Cycle(
    name="limits",
    time=[0, 3, 3.5, 14, 14.5, 19, 30, 42, 50, 56, 57, 63, 80, 92, 94, 110, 112, 118, 122, 126],
    speed=[0, 0, 25, 25, 0, 0, 1.5, 1.5, 14, 14, 0, 0, 75, 75, 20, 20, 0, 0, 10, 0],
    key_on=[1] * 14 + [0] * 2 + [1] * 4,
)
RUNS = {"udds": (Cycle.load("udds"), 1.0), "us06": (Cycle.load("us06"), 1.0), "limits": (LIMITS, 1.0), "limits, short": (LIMITS, 0.1)}


@pytest.mark.parametrize("car", CARS)
@pytest.mark.parametrize("cycle", RUNS)
def test_compiled_step_is_the_power_split_by_hand(car, cycle):
    vehicle, (trace, dt) = CAR.with_values(CARS[car]), RUNS[cycle]
    result = run(vehicle, trace, dt=dt)
    by_hand = TWIN["drive"](vehicle.parameters, trace.sampled(dt))
    for i, name in enumerate(TWIN["COLUMNS"]):
        scale = max(np.abs(result[name]).max(), 1.0)
        # Operations in another order, fed back through the achieved speed, whose error a force takes over the step's length, and
        # the rotor of the engine, whose speed follows the power of that force, once more.
        np.testing.assert_allclose(by_hand[:, i] / scale, result[name] / scale, rtol=0, atol=1e-9 / dt**2, err_msg=name)
