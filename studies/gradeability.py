"""Gradeability: the steepest grade on which a vehicle keeps a speed.

The vehicle starts at the speed V, in a gear that it keeps.  The grade rises to its value within five seconds, in which engines start
and rotors come to their speeds; then V is asked for over ten seconds.  The grade is held if it no longer
gets slower or faster and has the speed: of its last three speeds, each differs from the next by less than 0.01 mph, and the last two from
V.  (The original's code puts a bracket wrongly, so that any falling speed passes the first half of that.)  Nor may the speed need power
from nowhere: a part that turns beyond its speed lets the step keep a speed that no force keeps.

The gear is that in which the steepest grade is held.  (The original asks the largest torque of the engine, or of a motor that drives
alone; this asks the whole powertrain, whatever it is.)

A hybrid climbs on engine or fuel cell alone unless told otherwise, and its genset takes no time to give more.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from halfshaft.cosim.compiled import Array, Mode
from halfshaft.cosim.cycle import Samples
from halfshaft.cosim.simulate import parameters_of, stepper_of
from halfshaft.library.base.errors import InputError, number
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.conditions import AT_ONCE, MPH, Conditions, Place, Routine, best_mode, is_hybrid

#: Speeds closer than this are the same [m/s].
SAME = 0.01 * MPH
#: Time in which the grade rises [s].
RISE = 5.0
#: Power from nowhere that is only rounding [W].
NOWHERE = 1.0
#: Steepest grade that is tried [1].
STEEPEST = 1.0
#: Bounds of the search of 1999 [1]; the first step upward of that of 2000 [1], and the growth of its steps.
BOUNDS, STEP, GROWTH = (0.0, 0.10), 0.01, 1.618
#: Bracket at which a search ends [1], and most halvings.
TOLERANCES: Mapping[Routine, float] = {"1999": 5e-6, "2000": 5e-4}
MOST_HALVINGS = 25
#: Time for which a gear is kept [s].
KEPT = 1e12
#: Longest test of a grade [s].
LONGEST = 1e5


@dataclass(frozen=True)
class Climbed:
    """What a gradeability test found.

    Parameters
    ----------
    figures
        ``grade_percent``, None where no grade is held; ``speed_mps`` and ``gear``, None where the vehicle has none to choose.
    trials
        The grades that were tried [1], in their order, and whether each was held.
    notes
        What a user should know.

    """

    figures: Mapping[str, float | None]
    trials: tuple[tuple[float, bool], ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class GradeabilityTest(Conditions):
    """The task to find the steepest grade on which a vehicle keeps a speed.

    Its own charge is the middle of the window, or 0.5 for an electric vehicle by the routine of ``1999``; where it can, the
    battery rests.

    Parameters
    ----------
    speed
        Speed to keep [m/s].
    grade
        One grade to test [1], in place of a search.
    duration
        How long it is driven on the whole grade [s].
    gear
        The gear to keep; without it, the one in which the steepest grade is held.
    routine
        ``1999`` halves 0 to 10 % down to 0.0005 %; ``2000`` steps upward from 0, each step 1.618 times the one before, and then
        halves down to 0.05 %.
    tolerance
        Bracket at which the search ends [1], in place of the routine's.
    dt
        Length of the step [s].
    mode
        How the steps are solved; without it, hybrid and where that fails refined: a speed that is held is the same in both, but
        neither finds to it from every start.

    """

    speed: float = 55 * MPH
    grade: float | None = None
    duration: float = 10.0
    gear: int | None = None
    routine: Routine = "2000"
    tolerance: float | None = None
    dt: float = 1.0
    mode: Mode | None = None
    name: str = "gradeability"

    def problems(self) -> list[str]:
        """Return what is wrong with the options, whatever the vehicle."""
        problems = super().problems()
        if self.routine not in TOLERANCES:
            problems.append(f"routine = {self.routine!r}, must be 1999 or 2000")
        if not 0 < number(self.speed) <= 1000:
            problems.append(f"speed = {self.speed} m/s, must be > 0 m/s and <= 1000 m/s")
        if self.grade is not None and not -1 <= number(self.grade) <= 1:
            problems.append(f"grade = {self.grade}, must be >= -1 and <= 1")
        if not 0 < number(self.dt) <= LONGEST:
            problems.append(f"dt = {self.dt} s, must be > 0 s")
        elif not 3 * self.dt <= number(self.duration) <= LONGEST:
            problems.append(f"duration = {self.duration} s, must be three steps of {self.dt} s at least and {LONGEST:g} s at most")
        if self.tolerance is not None and not 0 < number(self.tolerance) < 1:
            problems.append(f"tolerance = {self.tolerance}, must be > 0 and < 1")
        return problems

    def __call__(self, vehicle: Vehicle) -> Climbed:
        """Find it.

        Raises
        ------
        InputError
            If an option is not what it must be, or the vehicle cannot be tested so.

        """
        hybrid = is_hybrid(vehicle)
        soc: float | Place = 0.5 if self.routine == "1999" and not hybrid else "middle"
        free = dict.fromkeys(vehicle.tags.all_of("hold time"), KEPT) | dict.fromkeys(vehicle.tags.all_of("source rise"), AT_ONCE)
        car = self.applied(vehicle, soc, "battery" if hybrid else "none", free)
        road = Road(car, self)
        steepest, notes = self.grade, tuple[str, ...]()
        if self.grade is not None:
            held = self.grade if road.holds(self.grade) else None
        else:
            held, steepest = (halve if self.routine == "1999" else grow)(road.holds, self.tolerance or TOLERANCES[self.routine])
        if held is None:
            notes = (f"a grade of {100 * (self.grade or 0.0):g} % is not held at {self.speed / MPH:.4g} mph",)
        elif self.grade is None and held == steepest:
            notes = (f"a grade of {100 * held:g} % is held; steeper ones were not tried",)
        figures = {"grade_percent": None if held is None else 100 * held, "speed_mps": self.speed, "gear": road.gears[0]}
        return Climbed(figures, tuple(road.trials), notes)


class Road:
    """A vehicle on a road of some grade, in one gear; `trials` keeps what was found, `gears` begins with the one that last held a grade."""

    def __init__(self, car: Vehicle, test: GradeabilityTest) -> None:
        self.trials: list[tuple[float, bool]] = []
        self._speed, self._stepper = test.speed, stepper_of(car)
        self._modes: list[Mode] = [test.mode] if test.mode else ["hybrid", "refined"] if best_mode(car) == "refined" else ["hybrid"]
        step = self._stepper.step
        self._parameters = parameters_of(car, step, test.speed)
        self._v = step.output_index[step.tags.the("speed")]
        self._unused = [i for i, d in enumerate(step.outputs) if d.booking == "limit"]
        self._start_gear = [step.parameter_index[name] for name in car.tags.all_of("start gear")]
        ratios = (name.split(".") for name in car.tags.all_of("gear ratios"))
        n_gears = max((len(getattr(car.parameters[part], own)) for part, own in ratios), default=1) if self._start_gear else 0
        self.gears: list[int | None] = [test.gear] if test.gear is not None else [*range(1, n_gears + 1)] or [None]
        if test.gear is not None and not 1 <= test.gear <= n_gears:
            have = f"the gears 1 to {n_gears}" if n_gears else "no gears to choose from"
            raise InputError("test", [f"gear = {test.gear}: vehicle '{car.name}' has {have}"])
        n_rise, n = round(RISE / test.dt), round((RISE + test.duration) / test.dt)
        self._share = np.minimum(np.arange(1, n + 1) / max(n_rise, 1), 1.0)
        key_on = 0.0 if test.resting == "converter" else 1.0
        dt, v, key = (np.full(n, x) for x in (test.dt, test.speed, key_on))
        self._samples = Samples(np.cumsum(dt), dt, v, np.zeros(n), key, test.speed, None)

    def holds(self, grade: float) -> bool:
        """Return whether the vehicle holds a grade in any of its gears."""
        best = max((g for g, held in self.trials if held), default=None)
        held = False
        for gear in list(self.gears):
            # What does not even hold the grade that another gear holds is not asked again.
            if best is not None and gear != self.gears[0] and not self._holds_in(gear, best):
                self.gears.remove(gear)
            elif held := self._holds_in(gear, grade):
                self.gears = [gear, *(g for g in self.gears if g != gear)]
                break
        self.trials.append((grade, held))
        return held

    def _holds_in(self, gear: int | None, grade: float) -> bool:
        """Return whether the vehicle holds a grade in a gear."""
        return any(self._driven(grade, gear, mode) for mode in self._modes)

    def _driven(self, grade: float, gear: int | None, mode: Mode) -> bool:
        """Return whether it does if the steps are solved in a mode."""
        if gear is not None:
            self._parameters[self._start_gear] = gear
        march = self._stepper.march(self._samples._replace(grade=grade * self._share), self._parameters, mode=mode)
        assert march.history is not None
        return sustained(march.history[:, self._v], self._speed) and march.last[self._unused].sum() > -NOWHERE


def sustained(v: Array, wanted: float) -> bool:
    """Return whether a run has settled at the speed wanted."""
    return bool(np.all(np.abs(np.diff(v[-3:])) < SAME) and np.all(np.abs(v[-2:] - wanted) < SAME))


def halve(holds: Callable[[float], bool], tolerance: float) -> tuple[float | None, float]:
    """Return the steepest grade that is held, by the search of 1999, or None; and the steepest that it finds."""
    low, high = BOUNDS
    if holds(high):
        return high, high
    return (_between(holds, low, high, tolerance) if holds(low) else None), high


def grow(holds: Callable[[float], bool], tolerance: float) -> tuple[float | None, float]:
    """Return the steepest grade that is held, by the search of 2000, or None; and the steepest that it finds."""
    if not holds(0.0):
        return None, STEEPEST
    low, high, step = 0.0, STEP, STEP
    while holds(high):
        if high == STEEPEST:
            return high, STEEPEST
        step *= GROWTH
        low, high = high, min(high + step, STEEPEST)
    return _between(holds, low, high, tolerance), STEEPEST


def _between(holds: Callable[[float], bool], low: float, high: float, tolerance: float) -> float:
    """Return a grade that is held, no more than the tolerance below one that is not."""
    for _ in range(MOST_HALVINGS):
        if high - low <= tolerance:
            break
        middle = (low + high) / 2
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low
