"""What a vehicle must be able to do: a figure of a task that is to be at most, or at least, a target.

A goal is told in words, such as ``0-60mph=12`` (seconds), ``6%@55mph`` or ``90mph``, or made of any task of this package.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

from halfshaft.cosim.ways import Mode
from halfshaft.library.base.errors import number
from halfshaft.studies.acceleration import IN_MPS, NAMES, REQUEST, AccelerationTest
from halfshaft.studies.conditions import MPH, Routine
from halfshaft.studies.gradeability import GradeabilityTest
from halfshaft.studies.task import Task

#: A grade is found this finely [1].
FINE = 5e-6
#: How far a grade [%] and a top speed [m/s] may be missed.
GRADE_TOLERANCE, SPEED_TOLERANCE = 0.05, 0.4 * MPH
_NUMBER, _UNIT = r"(-?\d+(?:\.\d*)?|-?\.\d+)", r"(mph|km/h)"
_ACCELERATION = re.compile(rf"{_NUMBER}-{_NUMBER} *{_UNIT} *= *{_NUMBER} *s?")
_GRADE = re.compile(rf"{_NUMBER} *% *@ *{_NUMBER} *{_UNIT}")
_SPEED = re.compile(rf"{_NUMBER} *{_UNIT}")


@dataclass(frozen=True, kw_only=True)
class Goal:
    """A figure that must be at most, or at least, a target.

    Parameters
    ----------
    title
        What is shown of it, with its unit.
    task, figure
        What finds it, and which of the figures that are found it is.
    target
        What it must reach.
    sense
        Whether it must be at most that, or at least.
    tolerance
        How far it may be missed.
    sustained
        Whether it must be met for any length of time, so that engine or fuel cell of a hybrid must meet it.
    scale
        Factor from the figure to what is shown.

    """

    title: str
    task: Task
    figure: str
    target: float
    sense: Literal["at most", "at least"] = "at most"
    tolerance: float = 0.0
    sustained: bool = False
    scale: float = 1.0

    def margin(self, value: float | None) -> float:
        """Return by how much a value is better than the target, over the larger of the two; -1 for what was never reached."""
        if value is None or not math.isfinite(value):
            return -1.0
        better = self._better(value)
        # However bad a time is, a better one must have a larger margin.
        return max(better / max(abs(self.target), abs(value), 1e-300), -1.0)

    def met(self, value: float | None) -> bool:
        """Return whether a value is within the tolerance, but for rounding."""
        return value is not None and math.isfinite(value) and self._better(value) >= -self.tolerance - 1e-9 * abs(self.target)

    def _better(self, value: float) -> float:
        return self.target - value if self.sense == "at most" else value - self.target

    @property
    def slack(self) -> float:
        """The tolerance over the target."""
        return self.tolerance / abs(self.target or 1.0)

    @property
    def relaxed(self) -> Goal:
        """The goal missed by no more than its tolerance."""
        return self.giving_way(self.target)

    def giving_way(self, value: float) -> Goal:
        """Return the goal to come so near to a value as the tolerance says."""
        return replace(self, target=value + self.tolerance if self.sense == "at most" else value - self.tolerance)

    @property
    def wanted(self) -> str:
        """Sense and target as they are shown."""
        return f"{'<=' if self.sense == 'at most' else '>='} {self.target * self.scale:.4g}"

    def shown(self, value: float | None) -> str:
        """Return a value as it is shown."""
        return "never" if value is None else f"{value * self.scale:.4g}"

    def problems(self) -> list[str]:
        """Return what is wrong with it."""
        problems = [] if math.isfinite(number(self.target)) else [f"goal {self.title}: target {self.target:g}, must be a finite number"]
        if self.sense not in ("at most", "at least"):
            problems.append(f"goal {self.title}: sense = {self.sense!r}, must be at most or at least")
        if not 0 <= number(self.tolerance) < math.inf:
            problems.append(f"goal {self.title}: tolerance = {self.tolerance:g}, must be >= 0 and finite")
        return problems


class _Time(NamedTuple):
    """Speeds in the unit, and the time between them [s]."""

    low: float
    high: float
    unit: str
    time: float


def read_goals(
    accelerations: Iterable[str], grades: Iterable[str], top_speed: str | None, routine: Routine, mode: Mode | None,
    tolerance: Sequence[float],
) -> tuple[list[Goal], list[str]]:  # fmt: skip
    """Return the goals that texts tell, and what is wrong with these.

    Parameters
    ----------
    accelerations, grades, top_speed
        The texts, such as ``0-60mph=12``, ``6%@55mph`` and ``90mph``.
    routine, mode
        Of the tests.
    tolerance
        How far each time may be missed [s]; the last one serves all further times too.

    """
    problems: list[str] = []
    accelerations, grades = ((x,) if isinstance(x, str) else x for x in (accelerations, grades))
    times = list(_times(accelerations, problems))
    top = _top(top_speed, problems)
    goals: list[Goal] = []
    for text in grades:
        if not (found := _GRADE.fullmatch(text.strip())):
            problems.append(f"grade {text!r}: must be like 6%@55mph or 6%@90km/h")
            continue
        grade, speed = float(found[1]), float(found[2]) * IN_MPS[found[3]]
        if not 0 < grade <= 100:
            problems.append(f"grade {text!r}: must be > 0 % and <= 100 %")
        if not 0 < speed < REQUEST:
            problems.append(f"grade {text!r}: the speed must be > 0 and < 322 km/h")
        task = GradeabilityTest(speed=speed, routine=routine, tolerance=FINE)
        title = f"grade at {found[2]} {found[3]} [%]"
        goals.append(Goal(
            title=title, task=task, figure="grade_percent", target=grade, sense="at least", tolerance=GRADE_TOLERANCE, sustained=True,
        ))  # fmt: skip
    # One run per unit serves all times, and the first one the top speed: it lasts until that is reached, or nothing is gained any more.
    units = list(dict.fromkeys([t.unit for t in times] + ([top[1]] if top and not times else [])))
    for unit in units:
        pairs = tuple((t.low, t.high) for t in times if t.unit == unit)
        if top and unit == units[0]:
            pairs = (*pairs, (0.0, top[0] * IN_MPS[top[1]] / IN_MPS[unit]))
        test = AccelerationTest(pairs=pairs, unit="mph" if unit == "mph" else "km/h", within=(), over=(), routine=routine, mode=mode)
        for t in (t for t in times if t.unit == unit):
            figure = f"time_{t.low:g}_to_{t.high:g}_{NAMES[unit]}_s"
            missed = tolerance[min(times.index(t), len(tolerance) - 1)]
            goals.append(Goal(title=f"{t.low:g} to {t.high:g} {unit} [s]", task=test, figure=figure, target=t.time, tolerance=missed))
        if top and unit == units[0]:
            v = top[0] * IN_MPS[top[1]]
            goals.append(Goal(
                title=f"top speed [{top[1]}]", task=test, figure="speed_max_mps", target=v, sense="at least",
                tolerance=SPEED_TOLERANCE, scale=1 / IN_MPS[top[1]],
            ))  # fmt: skip
    return goals, problems


def _times(texts: Iterable[str], problems: list[str]) -> Iterator[_Time]:
    for text in texts:
        if not (found := _ACCELERATION.fullmatch(text.strip())):
            problems.append(f"acceleration {text!r}: must be like 0-60mph=12 or 80-120km/h=9.5, in seconds")
            continue
        low, high, unit, time = float(found[1]), float(found[2]), found[3], float(found[4])
        if not 0 <= low < high < REQUEST / IN_MPS[unit]:
            problems.append(f"acceleration {text!r}: the speeds must rise from >= 0 to < 322 km/h")
        if time <= 0:
            problems.append(f"acceleration {text!r}: the time must be > 0 s")
        yield _Time(low, high, unit, time)


def _top(text: str | None, problems: list[str]) -> tuple[float, str] | None:
    if text is None:
        return None
    if not (found := _SPEED.fullmatch(text.strip())):
        problems.append(f"top speed {text!r}: must be like 90mph or 145km/h")
        return None
    if not 0 < float(found[1]) * IN_MPS[found[2]] < REQUEST:
        problems.append(f"top speed {text!r}: must be > 0 and < 322 km/h")
    return float(found[1]), found[2]
