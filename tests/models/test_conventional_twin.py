import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from halfshaft.cosim.cycle import Cycle, acceleration_cycle
from halfshaft.cosim.simulate import run
from halfshaft.models.vehicle import Vehicle

TWIN = runpy.run_path(str(Path(__file__).with_name("conventional_twin.py")))

CAR = Vehicle.load("small-car-conventional")
#: Cars that meet other limits and branches of the controls.
CARS = {
    "as it is": {},
    "heavy, with a heavy rotor": {"body.m": 1800.0, "engine.J": 0.4},
    "takes time to shift": {"shift.t_shift": 0.2, "shift.t_hold": 2.0, "control.launch_share": 0.4},
    "off at stops, open when braking": {"control.idle_at_stop": 0.0, "control.open_when_braking": 1.0, "accessories.tau_on": 2.0},
    "scaled": {"engine.speed_scale": 0.7, "engine.torque_scale": 1.3, "engine.efficiency_scale": 1.1, "gearbox.torque_scale": 0.8},
    "kept in first gear": {"shift.t_hold": 1e9},
}
US06 = Cycle.load("us06")
CYCLES = {
    "udds": (Cycle.load("udds"), 1.0),
    "us06": (replace(US06, time=US06.time[:150], speed=US06.speed[:150]), 0.1),
    "acceleration": (acceleration_cycle(), 0.05),
}
ROAD = ("gearbox.tau_required", "gearbox.omega_required", "wheel.v_limited", "wheel.slip_limited", "body.v", "wheel.v_driveline")


@pytest.mark.parametrize("car", CARS)
@pytest.mark.parametrize("cycle", CYCLES)
def test_compiled_driveline_is_that_by_hand(car, cycle):
    vehicle, (trace, dt) = CAR.with_values(CARS[car]), CYCLES[cycle]
    result = run(vehicle, trace, dt=dt)
    tau, omega, v_limited, slips, v, v_driveline = (result[name] for name in ROAD)
    before = np.concatenate([[0.0], v[:-1]])
    road = zip(tau, omega, before, v_limited, slips, v, v_driveline, result["body.trace_miss"], strict=True)
    by_hand = np.array(TWIN["drive"](vehicle.parameters, road, dt))
    for i, name in enumerate(TWIN["COLUMNS"]):
        scale = max(np.abs(result[name]).max(), 1e-12)
        # Some ten operations in another order, and memories that feed them on.
        np.testing.assert_allclose(by_hand[:, i] / scale, result[name] / scale, rtol=0, atol=1e-9, err_msg=name)
