"""Best-effort acceleration: the paper's test.

The request is zero until t = 5 s, then 322 km/h; steps of 0.1 s.  The time counts from the start of the first
accelerating step, with linear interpolation between samples.  As in the 1999 routine, shifts take 0.2 s, the clutch
slips up to 0.4 of the engine's highest speed, and a hybrid starts at the upper end of its window.

The paper's hybrid method errs most where a limit acts all the time, as here: up to 8 % of the time.  So the refined mode is
what runs unless another is asked for, and the hybrid method's time stands beside.
"""

from __future__ import annotations

from html import escape
from typing import NamedTuple

import numpy as np

from halfshaft.cosim.compiled import CompiledStep, Mode
from halfshaft.cosim.cycle import acceleration_cycle
from halfshaft.cosim.result import Result
from halfshaft.cosim.simulate import Via, run, stepper_of
from halfshaft.library.base.errors import InputError, not_a, number
from halfshaft.models.vehicle import Vehicle

#: Speed that is asked for [m/s].
REQUEST = 322 / 3.6
T_START = 5.0
DT = 0.1


#: Time that the request is held at first, and at most [s]; each try holds it four times as long as the one before.
DURATIONS = (50.0, 200.0, 800.0, 3200.0)
#: A vehicle that gains no more than this over the last tenth of a run gets no faster [m/s].
STEADY = 0.05


class Acceleration(NamedTuple):
    """Time from rest to the target speed [s], or None if it was never reached; the run; and the time by the hybrid method."""

    time: float | None
    result: Result
    time_hybrid: float | None

    def __repr__(self) -> str:
        top = f"never reached, highest speed {self.result.highest[self.result.tags.the('speed')] * 3.6:.1f} km/h"
        said = top if self.time is None else f"{self.time:.3f} s"
        beside = "" if self.time_hybrid is None else f" (hybrid method {self.time_hybrid:.3f} s)"
        inputs = self.result.inputs
        return f"<Acceleration {inputs.vehicle}, {inputs.mode if inputs.via == 'step' else inputs.via}: {said}{beside}>"

    def _repr_html_(self) -> str:
        return f"<b>{escape(repr(self)[1:-1])}</b><br>{self.result._repr_html_()}"


def prepared(vehicle: Vehicle) -> Vehicle:
    """Return the vehicle as the 1999 routine sets it for this test."""
    tags, window = vehicle.tags, vehicle.tags.all_of("highest charge")
    values = dict.fromkeys(tags.all_of("shift time"), 0.2) | dict.fromkeys(tags.all_of("launch share"), 0.4)
    values |= dict.fromkeys(tags.all_of("electric launch speed"), 0.0)
    if window:
        values |= dict.fromkeys(tags.all_of("start charge"), vehicle.values[window[0]])
    return vehicle.with_values(values)


def time_to(result: Result, v: float) -> float | None:
    """Return the time from the start of the first accelerating step to a speed [s]."""
    speed, time = result.the("speed"), result.time
    above = np.flatnonzero(speed >= v)
    if not len(above):
        return None
    i = int(above[0])
    if i == 0:
        return float(time[0] * v / speed[0]) - T_START
    share = (v - speed[i - 1]) / (speed[i] - speed[i - 1])
    return float(time[i - 1] + share * (time[i] - time[i - 1])) - T_START


def accelerate(
    vehicle: Vehicle, *, to: float = 100 / 3.6, mode: Mode | None = None, via: Via = "step", duration: float | None = None
) -> Acceleration:
    """Accelerate from rest as fast as the vehicle can.

    Parameters
    ----------
    vehicle
        What accelerates.
    to
        Target speed [m/s].
    mode, via
        As in `run`.  Without a mode, the compiled step runs refined, all else in its only mode, ``hybrid``.
    duration
        Time until which the request is held [s].  Without it, 50 s, and longer while the vehicle still gains speed.

    Raises
    ------
    InputError
        If the vehicle is none, or the target is not above zero and below the request of 322 km/h.

    """
    to, duration = number(to), None if duration is None else number(duration)
    problems = not_a(Vehicle, vehicle=vehicle)
    if not 0 < to < REQUEST:
        problems.append(f"target speed {to * 3.6:g} km/h, must be > 0 and < 322 km/h")
    if problems:
        raise InputError("acceleration", problems)
    car = prepared(vehicle)
    if mode is None:
        mode = "refined" if via == "step" and isinstance(stepper_of(car), CompiledStep) else "hybrid"
    time, result = _reach(car, to, mode, via, duration)
    hybrid = None
    if via == "step":
        hybrid = time if mode == "hybrid" else _reach(car, to, "hybrid", via, duration)[0]
    return Acceleration(time, result, hybrid)


def _reach(car: Vehicle, to: float, mode: Mode, via: Via, duration: float | None) -> tuple[float | None, Result]:
    """Return the time to a speed and the run, held as long as it takes unless a duration is given."""
    for held in DURATIONS if duration is None else (duration,):
        result = run(car, acceleration_cycle(REQUEST, t_start=T_START, duration=held), via=via, dt=DT, mode=mode)
        time = time_to(result, to)
        v = result.the("speed")
        late = len(v) - len(v) // 10
        if time is not None or v[late:].max() - v[:late].max() < STEADY:
            break
    return time, result
