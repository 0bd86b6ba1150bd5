"""Best-effort acceleration: the paper's test.

The request is zero until t = 5 s, then 322 km/h; steps of 0.1 s.  The time counts from the start of the first
accelerating step, with linear interpolation between samples.  As in the 1999 routine, shifts take 0.2 s, the clutch
slips up to 0.4 of the engine's highest speed, and a hybrid starts at the upper end of its window.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from halfshaft.cosim.compiled import Mode
from halfshaft.cosim.cycle import acceleration_cycle
from halfshaft.cosim.result import Result
from halfshaft.cosim.simulate import Via, run
from halfshaft.library.errors import InputError
from halfshaft.models.vehicle import Vehicle

T_START = 5.0
DT = 0.1


class Acceleration(NamedTuple):
    """Time from rest to the target speed [s], or None if it was never reached, and the run."""

    time: float | None
    result: Result


def prepared(vehicle: Vehicle) -> Vehicle:
    """Return the vehicle as the 1999 routine sets it for this test."""
    overrides = {
        "shift.t_shift": 0.2,
        "control.launch_share": 0.4,
        "battery.soc_start": vehicle.values.get("control.soc_high"),
    }
    return vehicle.with_values({name: x for name, x in overrides.items() if name in vehicle.values and x is not None})


def time_to(result: Result, v: float) -> float | None:
    """Return the time from the start of the first accelerating step to a speed [s]."""
    speed, time = result["body.v"], result.time
    above = np.flatnonzero(speed >= v)
    if not len(above):
        return None
    i = int(above[0])
    if i == 0:
        return float(time[0] * v / speed[0]) - T_START
    share = (v - speed[i - 1]) / (speed[i] - speed[i - 1])
    return float(time[i - 1] + share * (time[i] - time[i - 1])) - T_START


def accelerate(
    vehicle: Vehicle, *, to: float = 100 / 3.6, mode: Mode = "hybrid", via: Via = "step", duration: float = 50.0
) -> Acceleration:
    """Accelerate from rest as fast as the vehicle can.

    Parameters
    ----------
    vehicle
        What accelerates.
    to
        Target speed [m/s].
    mode, via
        As in `run`.
    duration
        Time that the request is held [s].

    Raises
    ------
    InputError
        If the target is not above zero and below the request of 322 km/h.

    """
    if not 0 < to < 322 / 3.6:
        raise InputError("acceleration", [f"target speed {to * 3.6:g} km/h, must be > 0 and < 322 km/h"])
    result = run(prepared(vehicle), acceleration_cycle(t_start=T_START, duration=duration), via=via, dt=DT, mode=mode)
    return Acceleration(time_to(result, to), result)
