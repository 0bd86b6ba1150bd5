import runpy
from pathlib import Path

import numpy as np
import pytest

from halfshaft.cosim.cycle import Cycle, acceleration_cycle
from halfshaft.cosim.simulate import run
from halfshaft.models.vehicle import Vehicle

TWIN = runpy.run_path(str(Path(__file__).with_name("twin.py")))

CAR = Vehicle.load("small-car-electric")
#: Cars that meet other limits: grip and envelope, an exhausted pack, current, top speed.
CARS = {
    "as it is": {},
    "heavy": {"body.m": 2400.0},
    "map read as the original does": {"gearbox.omega_lookup": 0.0, "gearbox.e_lowest": 0.0},
    "half empty": {"battery.soc_start": 0.3},
    "half the pack": {"battery.soc_start": 0.9, "battery.capacity_scale": 0.5},
    "little current": {"motor.I_max": 80.0},
    "on ice": {"wheel.mu_max": 0.15},
    "on ice, light at the rear and full": {"wheel.mu_max": 0.2, "body.front_share": 0.85, "battery.soc_start": 1.0},
    "slow motor": {"motor.speed_scale": 0.6, "motor.torque_scale": 1.4, "motor.efficiency_scale": 0.9, "gearbox.ratios_1": 6.0},
    "losses in the final drive": {
        "final_drive.i": 2.0,
        "gearbox.ratios_1": 3.3,
        "final_drive.tau_loss": 3.0,
        "final_drive.J": 0.02,
        "gearbox.J": 0.01,
    },
}


@pytest.mark.parametrize("car", CARS)
@pytest.mark.parametrize("cycle", ["us06", "acceleration"])
def test_compiled_step_is_the_car_by_hand(car, cycle):
    vehicle = CAR.with_values(CARS[car])
    trace, dt = (Cycle.load("us06"), 1.0) if cycle == "us06" else (acceleration_cycle(), 0.1)
    result = run(vehicle, trace, dt=dt)
    by_hand = TWIN["drive"](vehicle.parameters, trace.sampled(dt).v, dt)
    names = [d.name for d in result.outputs]
    for i, name in enumerate(TWIN["COLUMNS"]):
        name = name if name in names else "bus.P_in"
        compiled = result[name]
        scale = max(np.abs(compiled).max(), 1.0)
        # Some hundred operations in another order, fed back through the achieved speed.
        np.testing.assert_allclose(by_hand[:, i] / scale, compiled / scale, rtol=0, atol=1e-11, err_msg=name)
