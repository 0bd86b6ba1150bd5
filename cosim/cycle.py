"""Driving cycles: a speed over time, with grade and key where a cycle has them.

A cycle file is a CSV with a line of column names: a time, a speed whose name gives its unit (``speed_mps``,
``speed [km/h]``), and where wanted a ``grade`` or an ``elevation`` (by time) and ``key_on``.  Lines before it may say
``# name: ...``, ``# title: ...`` and ``# source: ...``.  A grade over distance is a second CSV, with a distance and a
grade or an elevation.  `halfshaft.cosim.cycle_file` reads both.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from halfshaft.cosim.cycle_file import GRADE, TRACE, read_csv, rows_of
from halfshaft.cosim.units import Units, shown
from halfshaft.library.base.errors import InputError, nearest, number
from halfshaft.library.files.notebook import Grid, card
from halfshaft.library.files.texts import NAME, cleaned, name_problem
from halfshaft.library.files.writing import written_whole

Array: TypeAlias = npt.NDArray[np.float64]
Grades: TypeAlias = tuple[Array, Array]

#: Times closer than this are the same [s].
TIME_STEP = 1e-9
#: No cycle is longer [s], has a later time [s], a higher speed [m/s] or, of a run, more steps.
LONGEST, LATEST, FASTEST, MOST_STEPS = 1e9, 1e12, 1000.0, 100_000_000
#: An elevation becomes the slope between points so far apart [m]; nearer ones show the noise of the recorder.
SLOPE_LENGTH = 50.0
#: More than 1 % of the points with more than this, or more stops than one in this time, is the noise of a recorder [m/s^2, s].
DOUBTFUL_ACCELERATION, DOUBTFUL_STOPS = 6.0, 15.0
#: Work of acceleration over that of the trace smoothed over two seconds from which the difference is noise.
DOUBTFUL_WORK = 1.5


class Samples(NamedTuple):
    """What each step k of a run takes: the request at its end, and grade and key there."""

    t: Array
    dt: Array
    v: Array
    grade: Array
    key_on: Array
    v_start: float
    grade_by_distance: Grades | None


class Statistics(NamedTuple):
    """Figures of a cycle, in SI; `grade_min`, `grade_max` and `climb` are None where the cycle says nothing of the road."""

    duration: float
    distance: float
    v_max: float
    v_mean: float
    a_max: float
    a_min: float
    t_idle: float
    stops: int
    a_mean: float
    d_mean: float
    t_key_off: float
    grade_min: float | None
    grade_max: float | None
    climb: float | None


@dataclass(frozen=True, kw_only=True, eq=False)
class Cycle:
    """A requested speed over time; between the points it is linear.

    All rows may be lists or arrays of any kind of number; they are kept as arrays of floats that cannot be changed.

    Parameters
    ----------
    name, title, source
        What it is called, and where it is from.
    time
        Rising [s].
    speed
        Requested speed at each time [m/s].
    grade
        Rise over run at each time [1].
    key_on
        Above 0 while the key is on, at most 1, at each time.
    grade_by_distance
        Rising distances [m] and the grade at each [1], in place of `grade`.
    notes
        What a user should know about where the figures are from.

    Raises
    ------
    InputError
        If the rows do not fit each other, or hold what no cycle can have; everything that is wrong is named at once.

    """

    name: str
    title: str = ""
    source: str = ""
    time: Array
    speed: Array
    grade: Array | None = None
    key_on: Array | None = None
    grade_by_distance: Grades | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check what was given, and keep it in the form that compiled code reads."""
        problems = [problem] if (problem := name_problem(self.name)) else []
        rows: dict[str, Any] = {
            n: _row(x, n, problems) for n in ("time", "speed", "grade", "key_on") if (x := getattr(self, n)) is not None
        }
        for name, x in rows.items():
            if x is not None and rows["time"] is not None and len(x) != len(rows["time"]):
                problems.append(f"{name} has {len(x)} points, time has {len(rows['time'])}")
        _axis(rows["time"], "time", "s", problems)
        if (time := rows["time"]) is not None and len(time) and abs(time[-1] - time[0]) > LONGEST:
            problems.append(f"lasts {time[-1] - time[0]:g} s, must be at most {LONGEST:g} s")
        _within(rows["speed"], "speed", 0, FASTEST, " m/s", problems)
        _within(rows.get("grade"), "grade", -1, 1, GRADE_CURE, problems)
        _within(rows.get("key_on"), "key_on", 0, 1, "", problems)
        if (pair := self.grade_by_distance) is not None:
            if not isinstance(pair, tuple | list) or len(pair) != 2:
                problems.append("grade_by_distance must be a pair of rows, the distances and the grades")
            else:
                distance, grade = (_row(x, f"grade_by_distance: {n}", problems) for x, n in zip(pair, ("distance", "grade"), strict=True))
                if distance is not None and grade is not None and len(distance) != len(grade):
                    problems.append(f"grade_by_distance: grade has {len(grade)} points, distance has {len(distance)}")
                _axis(distance, "grade_by_distance: distance", "m", problems)
                _within(grade, "grade_by_distance: grade", -1, 1, GRADE_CURE, problems)
                rows["grade_by_distance"] = distance, grade
        if problems:
            raise InputError(f"cycle '{self.name}'", problems)
        for name, x in {**rows, "title": cleaned(self.title), "source": cleaned(self.source)}.items():
            object.__setattr__(self, name, x)

    def __repr__(self) -> str:
        """Return name, duration and distance."""
        return f"<Cycle {self.name}: {self.duration:g} s, {self.statistics().distance / 1000:.2f} km>"

    def _repr_html_(self) -> str:
        return card(self.name, self.title, {"source": self.source}, Grid(("figure", "value", "unit", "meaning"), self.figures()))

    def figures(self, units: Units = "metric") -> list[tuple[str, str, str, str]]:
        """Return the figures of the cycle as texts, in km and km/h or in miles and mph: name, value, unit and meaning."""
        s = self.statistics()
        rows = [
            ("duration", "time", s.duration, "time from the first point to the last"),
            ("distance", "distance", s.distance, "distance driven if the trace is met"),
            ("v_max", "speed", s.v_max, "top speed"),
            ("v_mean", "speed", s.v_mean, "mean speed, stops included"),
            ("a_max", "acceleration", s.a_max, "largest acceleration"),
            ("a_mean", "acceleration", s.a_mean, "mean acceleration, while the speed rises"),
            ("a_min", "acceleration", s.a_min, "largest deceleration"),
            ("d_mean", "acceleration", s.d_mean, "mean deceleration, while the speed falls"),
            ("t_idle", "time", s.t_idle, "time at rest"),
        ]
        if s.t_key_off:
            rows.append(("t_key_off", "time", s.t_key_off, "time with the key off"))
        found = [(name, *shown(quantity, value, units, form=".5g").split(" ", 1), meaning) for name, quantity, value, meaning in rows]
        found.append(("stops", f"{s.stops}", "1", "number of stops"))
        if s.grade_min is not None and s.grade_max is not None:
            over = "time" if self.grade_by_distance is None else "distance"
            found.append(("grade", f"{100 * s.grade_min:.3g} to {100 * s.grade_max:.3g}", "%", f"grade of the road, by {over}"))
            found.append(("climb", *shown("way", s.climb, units, form=".4g").split(" ", 1), "height of all rises together"))
        return [(name, value, unit, meaning) for name, value, unit, meaning in found]

    @property
    def duration(self) -> float:
        """Time from the first point to the last [s]."""
        return float(self.time[-1] - self.time[0])

    @classmethod
    def load(cls, source: str | Path, grade: float | str | Path | None = None, *, others: bool = False) -> Cycle:
        """Return a cycle of the library by name, or of a CSV file.

        Parameters
        ----------
        source
            Name, in any case of letters, or path ending in ``.csv``.
        grade
            Its road, as in `graded`.
        others
            Whether a file may have columns that are none of a cycle, which are left out.

        """
        if grade is not None:
            return cls.load(source, others=others).graded(grade)
        path: Path | Traversable = Path(source)
        grade_path: Path | Traversable | None = None
        if isinstance(source, str) and not source.lower().endswith(".csv"):
            library = _library("cycles")
            if source.lower() not in library:
                raise InputError(f"cycle '{source}'", [f"not in the library{nearest(source.lower(), library)}"])
            path = library[source.lower()]
            grade_path = _library("grades").get(source.lower())
        notes, columns = read_csv(path, TRACE, "time", (lambda _: None) if others else None)
        speed = columns["speed"]
        below = speed < 0
        zeroed = (f"{np.sum(below)} speeds below zero, down to {speed.min():.2g} m/s, were set to 0",) if below.any() else ()
        by_distance = None
        if grade_path is not None:
            by_distance = _road(grade_path)
        elif "elevation" in columns:
            travelled = _integral(columns["time"], np.maximum(speed, 0))
            forth = np.append(True, np.diff(travelled) > 0)
            by_distance = _slopes(travelled[forth], columns["elevation"][forth])
        try:
            return cls(
                name=notes.get("name", _named(path.name.removesuffix(".csv"))),
                title=notes.get("title", ""),
                source=notes.get("source", ""),
                time=columns["time"],
                speed=np.maximum(speed, 0),
                grade=columns.get("grade"),
                key_on=columns.get("key_on"),
                grade_by_distance=by_distance,
                notes=(*filter(None, notes.get("note", "").split("\n")), *zeroed),
            )
        except InputError as e:
            raise InputError(str(path), e.problems) from None

    def save(self, path: str | Path, grade: str | Path | None = None) -> None:
        """Write the cycle to a CSV file that `load` reads as the same numbers, to the last bit.

        Parameters
        ----------
        path
            The file, ending in ``.csv``.
        grade
            A second one for a grade over distance, where the cycle has one.

        Raises
        ------
        InputError
            If a file cannot be written, or the cycle has a grade over distance and no file for it was given.

        """
        problems = [] if str(path).lower().endswith(".csv") else [f"a cycle is written as .csv, not as '{Path(path).suffix}'"]
        if self.grade_by_distance is not None and grade is None:
            problems.append("has a grade over distance, which needs a file of its own")
        if problems:
            raise InputError(str(path), problems)
        trace, road = self.texts()
        for target, text in ((path, trace), (grade, road)):
            if text and target is not None:
                with written_whole(target) as part:
                    part.write_text(text, encoding="utf-8", newline="\n")

    def texts(self) -> tuple[str, str]:
        """Return the cycle as the text of its file, and that of a second one for a grade over distance; empty without one."""
        told = [("name", self.name), ("title", self.title), ("source", self.source), *(("note", note) for note in self.notes)]
        columns = {"time_s": self.time, "speed_mps": self.speed, "grade": self.grade, "key_on": self.key_on}
        lines = [f"# {key}: {' '.join(text.split())}" for key, text in told]
        lines += rows_of({title: x for title, x in columns.items() if x is not None})
        road = [] if self.grade_by_distance is None else rows_of(dict(zip(("distance_m", "grade"), self.grade_by_distance, strict=True)))
        trace, profile = ("".join(f"{line}\n" for line in text) for text in (lines, road))
        return trace, profile

    def sampled(self, dt: float) -> Samples:
        """Return the steps of a run; the last one is shorter where `dt` does not divide the duration.

        A step asks for the speed of the trace at its end.  Where steps are longer than the trace's points are apart (half
        of them nearer than `dt`), it asks for the mean over half a step before and after, and starts at that over half a
        step: so nothing between is lost, and the distance is the trace's.  Grades are read in the same way.
        """
        dt = number(dt)
        kept: tuple[float, Samples] | None = self.__dict__.get("_sampled")
        if kept is None or kept[0] != dt:
            kept = dt, self._sample(dt)
            # Runs ask for the same again and again.
            self.__dict__["_sampled"] = kept
        return kept[1]

    def _sample(self, dt: float) -> Samples:
        if not (math.isfinite(dt) and dt > TIME_STEP):
            raise InputError(f"cycle '{self.name}'", [f"dt = {dt:g} s, must be > {TIME_STEP:g} s"])
        if self.duration / dt > MOST_STEPS:
            raise InputError(
                f"cycle '{self.name}'", [f"dt = {dt:g} s makes {self.duration / dt:.3g} steps, at most {MOST_STEPS:g} are run"]
            )
        n = math.ceil(self.duration / dt - TIME_STEP)
        # Rounding keeps k dt from falling just behind a point of the cycle.
        t = np.minimum(self.time[0] + np.round(np.arange(1, n + 1) * dt, 9), self.time[-1])
        steps = np.full(n, float(dt))
        rest = self.duration - (n - 1) * dt
        if n and abs(rest - dt) > TIME_STEP:
            steps[-1] = rest

        v_start = float(self.speed[0])
        if n and self._spacing < dt * (1 - 1e-6):
            ends = np.append(self.time[0], t)
            edges = np.concatenate([ends[:1], (ends[1:] + ends[:-1]) / 2, ends[-1:]])
            v_start, *_ = v = np.maximum(_means(self.time, self.speed, edges), 0)
            v = v[1:]
            grade = np.zeros(n) if self.grade is None else _means(self.time, self.grade, edges)[1:]
        else:
            v = np.interp(t, self.time, self.speed)
            grade = np.zeros(n) if self.grade is None else np.interp(t, self.time, self.grade)
        # Between a point with the key on and one with it off, the key is on.
        key_on = np.ones(n) if self.key_on is None else (np.interp(t, self.time, self.key_on) > 0).astype(float)
        for x in (t, steps, v, grade, key_on):
            x.flags.writeable = False
        return Samples(t, steps, v, grade, key_on, float(v_start), self.grade_by_distance)

    def smoothed(self, width: float = 3.0) -> Cycle:
        """Return the cycle with its speeds smoothed by a moving mean; `halfshaft.cosim.recording` does more for a recorder's trace.

        Each speed becomes the mean of the trace over a window of `width` seconds around its time, cut at both sides alike
        where it would reach beyond the first or the last point.  Distance and rests longer than `width` stay.
        """
        if not (math.isfinite(width) and width > 0):
            raise InputError(f"cycle '{self.name}'", [f"width of smoothing = {width:g} s, must be > 0 s"])
        half = np.minimum(width / 2, np.minimum(self.time - self.time[0], self.time[-1] - self.time))
        low, high = self.time - half, self.time + half
        inside = half > TIME_STEP
        speed = self.speed.copy()
        total = _integral_at(self.time, self.speed, high[inside]) - _integral_at(self.time, self.speed, low[inside])
        speed[inside] = np.maximum(total / (high - low)[inside], 0)
        return replace(self, name=f"{self.name[:80]}-smoothed-{width:g}", speed=speed)

    @cached_property
    def doubts(self) -> tuple[str, ...]:
        """What of this trace no car drives: gaps and noise of a recorder, with their numbers; empty for a good one."""
        from halfshaft.cosim.recording import gaps  # which makes cycles

        told = list(self.notes)
        if self._spacing <= 1 + 1e-6:
            told += [f"{gap}, taken for a straight line" for gap in gaps(self) if gap.moving]
        noise, dt = list[str](), np.diff(self.time)
        s = self.statistics()
        steep = np.abs(np.diff(self.speed)) > DOUBTFUL_ACCELERATION * dt
        if np.sum(steep) >= max(3, len(dt) / 100):
            worst = max(s.a_max, -s.a_min)
            noise.append(
                f"the trace asks for more than {DOUBTFUL_ACCELERATION:g} m/s2 at {np.sum(steep)} of {len(dt)} points, for up to {worst:.3g}"
            )
        if s.stops > max(4.0, self.duration / DOUBTFUL_STOPS):
            noise.append(f"the trace stops {s.stops} times, every {self.duration / s.stops:.2g} s")
        if self._spacing < 1 - 1e-6:
            work, smooth = _work(self.speed), _work(self.smoothed(2.0).speed)
            if work > DOUBTFUL_WORK * smooth:
                noise.append(f"the trace accelerates {work / smooth:.3g} times as much as smoothed over 2 s: noise, which costs energy")
        if noise:
            noise[-1] += " (smooth it: --smooth 2 or Cycle.smoothed(2))"
        return (*told, *noise)

    @cached_property
    def _spacing(self) -> float:
        """Time between two points, the half of them nearer [s]."""
        return float(np.median(np.diff(self.time))) if len(self.time) > 1 else math.inf

    def scaled(self, factor: float) -> Cycle:
        """Return the cycle with all speeds multiplied."""
        factor = number(factor)
        if not (math.isfinite(factor) and factor >= 0):
            raise InputError(f"cycle '{self.name}'", [f"factor = {factor:g}, must be >= 0"])
        return replace(self, name=f"{self.name[:80]}-x{factor:g}", speed=self.speed * factor)

    def graded(self, grade: float | str | Path) -> Cycle:
        """Return the cycle on another road than its own.

        Parameters
        ----------
        grade
            A constant grade as rise over run, ``0.03`` or ``"3 %"``; or a CSV file with a grade over distance.

        """
        if isinstance(grade, Path) or (isinstance(grade, str) and not re.fullmatch(r"\s*[-+.\d][-+.\de]*\s*%?\s*", grade)):
            return replace(self, grade=None, grade_by_distance=_road(Path(grade)))
        text = str(grade).strip()
        constant = number(text.removesuffix("%")) * (0.01 if text.endswith("%") else 1.0)
        if not -1 <= constant <= 1:
            raise InputError(f"cycle '{self.name}'", [f"grade = {text}, must be >= -1 and <= 1{GRADE_CURE}"])
        name = f"{self.name[:80]}-grade{100 * constant:+g}"
        return replace(self, name=name, grade=np.full(len(self.time), constant), grade_by_distance=None)

    def between(self, begin: float, end: float) -> Cycle:
        """Return the part of the cycle from one time to another [s], which keeps its times."""
        begin, end = number(begin), number(end)
        first, last = self.time[[0, -1]]
        if not first <= begin < end <= last:
            allowed = f"must rise and lie within {first:g} and {last:g} s"
            raise InputError(f"cycle '{self.name}'", [f"the part from {begin:g} to {end:g} s {allowed}"])
        inside = (self.time > begin + TIME_STEP) & (self.time < end - TIME_STEP)
        time = np.concatenate([[begin], self.time[inside], [end]])
        speed = np.interp(time, self.time, self.speed)
        grade = None if self.grade is None else np.interp(time, self.time, self.grade)
        key_on = None if self.key_on is None else (np.interp(time, self.time, self.key_on) > 0).astype(float)
        road = self.grade_by_distance
        if road is not None:
            start, stop = _integral_at(self.time, self.speed, np.array([begin, end]))
            road = cut(*road, start, stop) if stop > start else None
        name = f"{self.name[:80]}-{begin:g}-{end:g}"
        return replace(self, name=name, time=time, speed=speed, grade=grade, key_on=key_on, grade_by_distance=road)

    def time_at(self, edges: npt.ArrayLike) -> Array:
        """Return the time that the cycle drives at speeds between rising edges [m/s], the lower one included [s]."""
        dt, low, high = np.diff(self.time), np.minimum(self.speed[1:], self.speed[:-1]), np.maximum(self.speed[1:], self.speed[:-1])
        even = high == low
        rise = np.where(even, 1.0, high - low)
        below = [np.where(even, low < v, np.clip((v - low) / rise, 0, 1)) @ dt for v in np.asarray(edges, dtype=float)]
        return np.diff(below)

    def statistics(self) -> Statistics:
        """Return the figures of the cycle."""
        dt, v = np.diff(self.time), self.speed
        dv = np.diff(v)
        a = dv / dt
        distance = float(np.sum((v[1:] + v[:-1]) / 2 * dt))
        still = (v[1:] == 0) & (v[:-1] == 0)
        up, down = dv > 0, dv < 0
        road = self.grade_by_distance and cut(*self.grade_by_distance, 0.0, max(distance, 1.0))
        if self.grade is not None:
            road = _integral(self.time, v), self.grade
        sine = None if road is None else np.maximum(np.sin(np.arctan(road[1])), 0)
        off = 0.0 if self.key_on is None else float(dt @ ((self.key_on[1:] <= 0) & (self.key_on[:-1] <= 0)))
        return Statistics(
            duration=self.duration,
            distance=distance,
            v_max=float(v.max()),
            v_mean=distance / self.duration if self.duration else 0.0,
            a_max=float(a.max(initial=0.0)),
            a_min=float(a.min(initial=0.0)),
            t_idle=float(dt[still].sum()),
            stops=int(np.sum((v[1:] == 0) & (v[:-1] > 0))),
            a_mean=float(dv[up].sum() / dt[up].sum()) if up.any() else 0.0,
            d_mean=float(dv[down].sum() / dt[down].sum()) if down.any() else 0.0,
            t_key_off=off,
            grade_min=None if road is None else float(road[1].min()),
            grade_max=None if road is None else float(road[1].max()),
            climb=None if road is None or sine is None else float(np.sum((sine[1:] + sine[:-1]) / 2 * np.diff(road[0]))),
        )


def acceleration_cycle(v: float = 322 / 3.6, t_start: float = 5.0, duration: float = 50.0) -> Cycle:
    """Return rest up to and with `t_start`, and a request of `v` right after; no vehicle reaches it at once."""
    return Cycle(
        name="acceleration",
        title="Full acceleration",
        source="Wipke, Cuddy, Burch (1999): 322 km/h requested from 5 s on",
        time=np.array([0.0, t_start, t_start + TIME_STEP, duration]),
        speed=np.array([0.0, 0.0, v, v]),
    )


def cycle_names() -> list[str]:
    """Return the names of the library's cycles."""
    return sorted(_library("cycles"))


def _library(kind: str) -> dict[str, Traversable]:
    folder = files("halfshaft.cosim") / "data" / kind
    return {p.name.removesuffix(".csv"): p for p in folder.iterdir() if p.name.endswith(".csv")}


#: Ends a message about a grade.
GRADE_CURE = " (rise over run: 5 % is 0.05, or 5 in a column grade_percent)"


def _named(stem: str) -> str:
    """Return the name of a cycle that says none: that of its file, as far as a name may have its characters."""
    return "".join(c if NAME.fullmatch(f"x{c}") else "_" for c in stem).lstrip(" .+()-")[:80] or "cycle"


def _row(values: Any, name: str, problems: list[str]) -> Array | None:
    """Return numbers as an array of floats of its own, or None and say why not."""
    try:
        given = np.asarray(values)
        if given.dtype.kind not in "biufO":
            raise TypeError
        row = np.array(given, dtype=float, order="C")
    except (TypeError, ValueError, OverflowError):
        problems.append(f"{name} must be a row of numbers")
        return None
    if row.ndim != 1:
        problems.append(f"{name} must be one row of numbers, has {row.ndim} dimensions")
        return None
    if not len(row):
        problems.append(f"{name} has no points")
    elif not np.all(np.isfinite(row)):
        problems.append(f"{name} has a point that is not a finite number")
    else:
        row.flags.writeable = False
        return row
    return None


def _axis(row: Array | None, name: str, unit: str, problems: list[str]) -> None:
    if row is not None and np.any(np.diff(row) < TIME_STEP / 2):
        problems.append(f"{name} must rise")
    if row is not None and np.any(np.abs(row) > LATEST):
        problems.append(f"{name} = {row[np.argmax(np.abs(row))]:g} {unit}, must be within {LATEST:g} {unit}")


def _within(row: Array | None, name: str, low: float, high: float, unit: str, problems: list[str]) -> None:
    if row is not None and (np.any(row < low) or np.any(row > high)):
        worst = row[np.argmax(np.maximum(low - row, row - high))]
        problems.append(f"{name} = {worst:g}, must be >= {low:g} and <= {high:g}{unit}")


def _integral(x: Array, y: Array) -> Array:
    """Return the integral of a piecewise linear row from its first point to each."""
    return np.append(0.0, np.cumsum((y[1:] + y[:-1]) / 2 * np.diff(x)))


def _integral_at(x: Array, y: Array, places: Array) -> Array:
    """Return the same integral to any place between the first and the last point."""
    i = np.minimum(np.searchsorted(x, places, side="right") - 1, len(x) - 1)
    total: Array = _integral(x, y)[i] + (y[i] + np.interp(places, x, y)) / 2 * (places - x[i])
    return total


def _means(x: Array, y: Array, edges: Array) -> Array:
    """Return the means of a piecewise linear row between edges."""
    return np.diff(_integral_at(x, y, edges)) / np.diff(edges)


def cut(x: Array, y: Array, begin: float, end: float) -> Grades:
    """Return a profile between two places, counted from the first; before its start and beyond its end it stays as it is there."""
    places = np.concatenate([[begin], x[(x > begin) & (x < end)], [end]])
    return places - begin, np.interp(places, x, y)


def _road(path: Path | Traversable) -> Grades | None:
    """Return the grade over distance that a file holds."""
    _, over = read_csv(path, GRADE, "distance")
    return (over["distance"], over["grade"]) if "grade" in over else _slopes(over["distance"], over["elevation"])


def _slopes(distance: Array, elevation: Array) -> Grades | None:
    """Return the grade over distance of a profile of elevation; None for one without length."""
    n = int((distance[-1] - distance[0]) // SLOPE_LENGTH)
    if n < 1:
        return None
    points = np.linspace(distance[0], distance[-1], n + 1)
    edges = np.concatenate([points[:1], (points[1:] + points[:-1]) / 2, points[-1:]])
    middles = (edges[1:] + edges[:-1]) / 2
    return points, np.gradient(_means(distance, elevation, edges), middles)


def _work(speed: Array) -> float:
    """Return the work of all accelerations, for a mass of one [J/kg]."""
    return float(np.maximum(np.diff(speed**2), 0).sum()) / 2
