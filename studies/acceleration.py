"""Best-effort acceleration: the paper's test.

The request is zero until t = 5 s, then 322 km/h; steps of 0.1 s.  The time counts from the start of the first
accelerating step, with linear interpolation between samples.  As in the 1999 routine, shifts take 0.2 s, the clutch
slips up to 0.4 of the engine's highest speed, and a hybrid starts at the upper end of its window.

The paper's hybrid method errs most where a limit acts all the time, as here: up to 8 % of the time.  So the refined mode is
what runs unless another is asked for, and the hybrid method's time stands beside.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from html import escape
from typing import Literal, NamedTuple

import numpy as np

from halfshaft.cosim.compiled import Array, Mode
from halfshaft.cosim.cycle import acceleration_cycle
from halfshaft.cosim.remarks import acted
from halfshaft.cosim.result import Result
from halfshaft.cosim.simulate import Via, run
from halfshaft.cosim.units import M_PER_MILE
from halfshaft.library.base.errors import InputError, not_a, number
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.conditions import MPH, Conditions, Routine, best_mode

#: Speed that is asked for [m/s].
REQUEST = 322 / 3.6
T_START = 5.0
DT = 0.1


#: Time that the request is held at first, and at most [s]; each try holds it four times as long as the one before.
DURATIONS = (50.0, 200.0, 800.0, 3200.0)
#: The request is not held longer [s].
LONGEST = 1e5
#: A vehicle that gains no more than this over the last tenth of a run gets no faster [m/s].
STEADY = 0.05
#: The same where the top speed is what is asked for [m/s].
STEADIEST = 1e-4
#: Length of the classical drag race [m].
QUARTER_MILE = M_PER_MILE / 4
#: Units of speeds that are told, in m/s, and as names of figures have them.
IN_MPS = {"mph": MPH, "km/h": 1 / 3.6}
NAMES = {"mph": "mph", "km/h": "kmh"}


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


def shifting(vehicle: Vehicle) -> dict[str, float]:
    """Return how a vehicle shifts in this test."""
    return dict.fromkeys(vehicle.tags.all_of("shift time"), 0.2)


def launching(vehicle: Vehicle) -> dict[str, float]:
    """Return how it drives off by the 1999 routine."""
    tags = vehicle.tags
    return dict.fromkeys(tags.all_of("launch share"), 0.4) | dict.fromkeys(tags.all_of("electric launch speed"), 0.0)


def prepared(vehicle: Vehicle) -> Vehicle:
    """Return the vehicle as the 1999 routine sets it for this test."""
    return Conditions().applied(vehicle, "high", more=shifting(vehicle) | launching(vehicle))


def time_to(result: Result, v: float) -> float | None:
    """Return the time from the start of the first accelerating step to a speed [s]."""
    return crossing(result.time, result.the("speed"), v)


def crossing(time: Array, speed: Array, v: float) -> float | None:
    """Return the same from times and speeds at the ends of steps."""
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
    mode = mode or (best_mode(car) if via == "step" else "hybrid")

    def reach(mode: Mode) -> tuple[float | None, Result]:
        result = full_effort(car, mode, lambda r: time_to(r, to) is not None, via=via, duration=duration)
        return time_to(result, to), result

    time, result = reach(mode)
    hybrid = None
    if via == "step":
        hybrid = time if mode == "hybrid" else reach("hybrid")[0]
    return Acceleration(time, result, hybrid)


def full_effort(
    car: Vehicle,
    mode: Mode,
    done: Callable[[Result], bool],
    *,
    via: Via = "step",
    duration: float | None = None,
    steady: float = STEADY,
    key_on: float = 1.0,
) -> Result:
    """Return a run at full effort, held as long as it takes unless a duration is given."""
    for held in DURATIONS if duration is None else (duration,):
        cycle = acceleration_cycle(REQUEST, t_start=T_START, duration=held)
        result = run(car, cycle if key_on else replace(cycle, key_on=np.zeros(len(cycle.time))), via=via, dt=DT, mode=mode)
        v = result.the("speed")
        late = len(v) - len(v) // 10
        if done(result) or v[late:].max() - v[:late].max() < steady:
            break
    return result


@dataclass(frozen=True)
class Accelerated:
    """What an acceleration test found, and its run."""

    figures: Mapping[str, float | None]
    result: Result
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class AccelerationTest(Conditions):
    """The task to accelerate from rest, and to tell times, distances and rates.

    Its own charge is the middle of the window by the routine of ``2000``, the upper end by that of ``1999``.

    Parameters
    ----------
    pairs
        Speeds between which the time is taken, in the `unit`.
    unit
        ``mph`` or ``km/h``.
    within
        Times in which the distance is told [s].
    over
        Distances for which the time is told [m].
    routine
        Both shift in 0.2 s; that of ``1999`` also lets the clutch slip up to 0.4 of the engine's highest speed, and no hybrid drive
        off electrically by choice.
    mode
        How the steps are solved; without it refined, or hybrid where there is no compiler or the battery rests.
    duration
        Time until which the request is held [s].  Without it 50 s, and longer while something is still to be reached.

    """

    pairs: tuple[tuple[float, float], ...] = ((0, 60), (40, 60), (0, 85))
    unit: Literal["mph", "km/h"] = "mph"
    within: tuple[float, ...] = (5.0,)
    over: tuple[float, ...] = (QUARTER_MILE,)
    routine: Routine = "2000"
    mode: Mode | None = None
    duration: float | None = None
    name: str = "acceleration"

    def problems(self) -> list[str]:
        """Return what is wrong with the options, whatever the vehicle."""
        problems = super().problems()
        if self.routine not in ("1999", "2000"):
            problems.append(f"routine = {self.routine!r}, must be 1999 or 2000")
        if self.unit not in IN_MPS:
            return [*problems, f"unit = {self.unit!r}, must be {' or '.join(IN_MPS)}"]
        highest = REQUEST / IN_MPS[self.unit]
        for low, high in self.pairs:
            if not 0 <= number(low) < number(high) < highest:
                problems.append(f"speeds {low} to {high} {self.unit}, must rise from >= 0 to < {highest:.0f} {self.unit}")
        for what, unit, values in (("time", "s", self.within), ("distance", "m", self.over)):
            problems += [f"{what} {x} {unit}, must be > 0 {unit} and finite" for x in values if not 0 < number(x) < math.inf]
        if self.duration is not None and not T_START < number(self.duration) <= LONGEST:
            problems.append(f"duration = {self.duration} s, must be > {T_START:g} s and <= {LONGEST:g} s")
        return problems

    def __call__(self, vehicle: Vehicle) -> Accelerated:
        """Accelerate.

        Raises
        ------
        InputError
            If an option is not what it must be, or the vehicle cannot be tested so.

        """
        old = self.routine == "1999"
        car = self.applied(vehicle, "high" if old else "middle", more=shifting(vehicle) | (launching(vehicle) if old else {}))
        mode, highest = self.solved(car, self.mode), max((high for _, high in self.pairs), default=0.0) * IN_MPS[self.unit]

        def done(result: Result) -> bool:
            driven, held = float(travelled(result)[-1]), float(result.time[-1]) - T_START
            reached = time_to(result, highest) is not None and held >= max(self.within, default=0.0)
            return reached and driven >= max(self.over, default=0.0)

        result = full_effort(car, mode, done, duration=self.duration, key_on=self.resting != "converter")
        figures: dict[str, float | None] = {}
        for low, high in self.pairs:
            start, end = (time_to(result, v * IN_MPS[self.unit]) if v else 0.0 for v in (low, high))
            figures[f"time_{low:g}_to_{high:g}_{NAMES[self.unit]}_s"] = None if start is None or end is None else end - start
        time, way = np.append(T_START, result.time), np.append(0.0, travelled(result))
        for t in self.within:
            figures[f"distance_in_{t:g}_s_m"] = float(np.interp(T_START + t, time, way)) if time[-1] >= T_START + t else None
        for s in self.over:
            figures[f"time_over_{s:g}_m_s"] = float(np.interp(s, way, time)) - T_START if way[-1] >= s else None
        figures["acceleration_max_mps2"] = float(np.diff(result.the("speed"), prepend=0.0).max() / DT)
        figures["speed_max_mps"] = result.highest[result.tags.the("speed")]
        return Accelerated(figures, result, acted(result))


@dataclass(frozen=True, kw_only=True)
class TopSpeedTest(Conditions):
    """The task to find the highest speed that the vehicle reaches on the level, from rest; held until it gains no more.

    Its own charge is the middle of the window.

    Parameters
    ----------
    mode
        How the steps are solved; without it refined, or hybrid where there is no compiler or the battery rests.

    """

    mode: Mode | None = None
    name: str = "top-speed"

    def __call__(self, vehicle: Vehicle) -> Accelerated:
        """Find it.

        Raises
        ------
        InputError
            If an option is not what it must be, or the vehicle cannot be tested so.

        """
        car = self.applied(vehicle, "middle", more=shifting(vehicle))
        result = full_effort(car, self.solved(car, self.mode), lambda _: False, steady=STEADIEST, key_on=self.resting != "converter")
        v = result.the("speed")
        i = int(v.argmax())
        figures = {"top_speed_mps": float(v[i]), "reached_after_s": float(result.time[i]) - T_START}
        lost = v[i] - v[-1]
        notes = (f"not held: {lost * 3.6:.3g} km/h slower at the end of {result.time[-1]:g} s",) if lost > STEADY else ()
        return Accelerated(figures, result, (*notes, *acted(result)))


def travelled(result: Result) -> Array:
    """Return the distance from the start of the test at the end of each step [m]: the trapezoids of the speed."""
    v = result.the("speed")
    return np.cumsum((v + np.append(0.0, v[:-1])) / 2 * result.dt)
