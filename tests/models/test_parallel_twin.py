"""The compiled step of the parallel hybrids against the same cars by hand."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from parallel_twin import mild, parallel
from twins.vehicles import columns

from halfshaft import Cycle, Vehicle, run

UDDS, US06 = Cycle.load("udds"), Cycle.load("us06")
#: Launches that no tyre holds, stops harder than any brake, requests beyond top speed and power, hills, and the key off for a while.
LIMITS = Cycle(
    name="limits",
    time=[0, 3, 3.5, 14, 14.5, 19, 30, 42, 50, 56, 57, 63, 80, 92, 94, 110, 112, 118, 122, 126],
    speed=[0, 0, 25, 25, 0, 0, 1.5, 1.5, 14, 14, 0, 0, 75, 75, 20, 20, 0, 0, 10, 0],
    key_on=[1] * 14 + [0] * 2 + [1] * 4,
    grade_by_distance=([0, 150, 250, 400, 480, 900, 1400, 2000], [0, 0, 0.25, 0.25, -0.2, 0.06, -0.08, 0.01]),
)
MOVING = replace(US06, name="moving", time=US06.time[60:140], speed=US06.speed[60:140])
START = replace(UDDS, name="start of UDDS", time=UDDS.time[:346], speed=UDDS.speed[:346])
RUNS = {"udds": (UDDS, 1.0), "limits": (LIMITS, 1.0), "limits, short steps": (LIMITS, 0.1), "moving": (MOVING, 0.2)}

CARS = {
    "as it is": {},
    "below its window": {"battery.soc_start": 0.58, "electric_accessories.P_on": 1500.0, "electric_accessories.eta": 0.8},
    "empty": {"battery.soc_start": 0.02, "battery.capacity_scale": 0.3},
    "full": {"battery.soc_start": 1.0},
    "launches electrically": {
        "control.v_launch_low": 5.0, "control.v_launch_high": 14.0, "battery.soc_start": 0.64, "control.v_decel": 6.0,
        "motor.torque_scale": 0.4, "coupler.tau_loss": 1.5,
    },
    "weak motor that must help": {"control.v_launch_low": 9.0, "control.v_launch_high": 30.0, "battery.n_modules": 14.0, "motor.J": 0.05},
    "takes time to shift": {"shift.t_shift": 0.3, "shift.t_hold": 2.0, "control.launch_share": 0.4},
    "idles, clutch closed on overrun": {
        "control.omega_idle": 90.0, "control.idle_at_stop": 1.0, "control.open_when_braking": 0.0, "mechanical_accessories.P_on": 700.0,
        "mechanical_accessories.tau_on": 2.0,
    },
    "off below idling speed": {"control.omega_idle": 90.0, "control.open_when_braking": 0.0},
    "depletes": {
        "control.charge_depleting": 1.0, "control.v_launch_low": 8.0, "control.v_launch_high": 27.0, "control.soc_low": 0.3,
        "control.soc_high": 0.8, "battery.soc_start": 0.28, "control.min_share": 0.8,
    },
    "heavy, with a heavy rotor": {"body.m": 2400.0, "engine.J": 0.4, "gearbox.J": 0.02, "final_drive.J": 0.05, "final_drive.tau_loss": 3.0},
    "scaled": {
        "engine.speed_scale": 0.7, "engine.torque_scale": 1.3, "engine.efficiency_scale": 1.1, "motor.speed_scale": 0.8,
        "motor.overtorque": 1.1, "motor.efficiency_scale": 0.9, "coupler.n": 2.4,
    },
    "on ice, rear-driven": {"wheel.mu_max": 0.2, "wheel.front_driven": 0.0, "wheel.rear_driven": 1.0},
}  # fmt: skip
ASSIST = {
    "no engine at small loads": {"control.off_share": 0.5, "battery.soc_start": 0.66, "control.v_launch_high": 3.0},
    "charges hard": {"control.charge_share": 1.0, "control.min_share": 0.9, "battery.soc_start": 0.61},
}
BALANCED = {
    "short of charge": {"battery.soc_start": 0.61},
    "rich in charge": {"battery.soc_start": 0.69, "control.load_low": 0.3, "control.load_high": 0.5, "control.load_weight": 0.5},
}
MILD = {
    "as it is": {},
    "short of charge": {"battery.soc_start": 0.22, "battery.capacity_scale": 0.3, "electric_accessories.P_on": 1500.0},
    "full": {"battery.soc_start": 0.82, "control.v_decel": 9.0},
    "helps much": {
        "control.tau_assist": 8.0, "control.a_assist": -1.0, "control.v_assist": 0.0, "control.share_low": 0.5, "control.share_high": 0.9,
        "control.slope": 0.5, "control.tau_full": 60.0, "control.P_full": 9000.0, "control.tau_regen": -3.0, "control.slope_regen": 1.0,
    },
    "belt-driven, opens when braking": {
        "coupler.n": 1.4, "coupler.tau_loss": 0.8, "control.open_when_braking": 1.0, "mechanical_accessories.tau_on": 2.0,
        "motor.speed_scale": 1.5,
    },
    "takes time to shift": {"shift.t_shift": 0.3, "shift.t_hold": 2.0, "control.launch_share": 0.4, "control.omega_idle": 70.0},
    "heavy, with a heavy rotor": {"body.m": 2000.0, "engine.J": 0.4, "gearbox.J": 0.02, "motor.torque_scale": 2.0},
    "weak": {"motor.torque_scale": 0.3, "motor.I_max": 20.0, "battery.n_modules": 12.0},
    "on ice, rear-driven": {"wheel.mu_max": 0.2, "wheel.front_driven": 0.0, "wheel.rear_driven": 1.0},
}  # fmt: skip
VEHICLES = {
    "small-car-parallel": (parallel, {**CARS, **ASSIST}),
    "small-car-parallel-balanced": (parallel, {**CARS, **BALANCED}),
    "small-car-parallel-post": (partial(parallel, behind_gearbox=True), CARS),
    "small-car-plug-in-parallel": (parallel, {"as it is": {}, "nearly empty": {"battery.soc_start": 0.32}}),
    "small-car-mild-hybrid": (mild, MILD),
}
#: On its climb at the limit the grade hangs on the distance, so that rounding grows: 2e-9 over the length of a step.
FED_BACK = ("small-car-mild-hybrid", "short of charge", "limits, short steps")
CASES = [(name, car) for name, (_, cars) in VEHICLES.items() for car in cars]


@pytest.mark.parametrize("cycle", RUNS)
@pytest.mark.parametrize(("name", "car"), CASES)
def test_the_step_is_the_car_by_hand(name, car, cycle):
    twin, cars = VEHICLES[name]
    vehicle, (trace, dt) = Vehicle.load(name).with_values(cars[car]), RUNS[cycle]
    if trace is UDDS and cars[car]:
        # The rest of it takes no branch by hand that the start and the limits do not; the cars as they are run all of it.
        trace = START
    result = run(vehicle, trace, dt=dt)
    by_hand = columns(twin(vehicle.parameters, trace.sampled(dt)))
    assert len(by_hand) > 50
    units = {d.name: d.unit for d in result.outputs}
    for column, values in by_hand.items():
        # What is nothing but rounding is measured by one unit.  Operations in another order are fed back through the achieved speed,
        # whose error a force takes over the step's length.
        scale = max(np.abs(result[column]).max(), 1.0 if units[column] in ("W", "N", "N.m", "m/s") else 1e-12)
        apart = 1e-8 if (name, car, cycle) == FED_BACK else 1e-9
        np.testing.assert_allclose(values / scale, result[column] / scale, rtol=0, atol=apart / dt, err_msg=column)
