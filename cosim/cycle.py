"""Driving cycles: a speed over time, with grade and key where a cycle has them.

A cycle file is a CSV with a line of column names: ``time_s``, a speed whose name gives its unit (``speed_mps``,
``speed_kmh``, ``speed_mph``, also ``speed [km/h]``), and where wanted ``grade`` (rise over run, by time) and ``key_on``.
Lines before it may say ``# name: ...``, ``# title: ...`` and ``# source: ...``.  A grade over distance is a second CSV
with ``distance_m`` and ``grade``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from importlib.resources.abc import Traversable
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from halfshaft.library.errors import InputError, nearest
from halfshaft.library.notebook import Grid, card

Array: TypeAlias = npt.NDArray[np.float64]
Grades: TypeAlias = tuple[Array, Array]

#: What a column is and its factor to SI.
COLUMNS = {
    "time_s": ("time", 1.0),
    "speed_mps": ("speed", 1.0),
    "speed_kmh": ("speed", 1 / 3.6),
    "speed_mph": ("speed", 0.44704),
    "grade": ("grade", 1.0),
    "key_on": ("key_on", 1.0),
}
GRADE_COLUMNS = {"distance_m": ("distance", 1.0), "grade": ("grade", 1.0)}
#: At most so many bad lines are named.
NAMED = 20
#: Times closer than this are the same [s].
TIME_STEP = 1e-9


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
    """Figures of a cycle, in SI."""

    duration: float
    distance: float
    v_max: float
    v_mean: float
    a_max: float
    a_min: float
    t_idle: float
    stops: int


@dataclass(frozen=True, kw_only=True, eq=False)
class Cycle:
    """A requested speed over time; between the points it is linear."""

    name: str
    title: str = ""
    source: str = ""
    time: Array
    speed: Array
    grade: Array | None = None
    key_on: Array | None = None
    grade_by_distance: Grades | None = None

    def __post_init__(self) -> None:
        """Check what was given."""
        with_time = {"speed": self.speed, "grade": self.grade, "key_on": self.key_on}
        given = {"time": self.time} | {name: x for name, x in with_time.items() if x is not None}
        problems = [f"{name} has {len(x)} points, time has {len(self.time)}" for name, x in given.items() if len(x) != len(self.time)]
        problems += [f"{name} has a point that is not a finite number" for name, x in given.items() if not np.all(np.isfinite(x))]
        if len(self.time) == 0:
            problems.append("has no points")
        if np.any(np.diff(self.time) <= 0):
            problems.append("time must rise")
        if np.any(self.speed < 0):
            problems.append("speed must be >= 0 m/s")
        if problems:
            raise InputError(f"cycle '{self.name}'", problems)

    def __repr__(self) -> str:
        """Return name, duration and distance."""
        return f"<Cycle {self.name}: {self.duration:g} s, {self.statistics().distance / 1000:.2f} km>"

    def _repr_html_(self) -> str:
        return card(self.name, self.title, {"source": self.source}, Grid(("figure", "value", "unit", "meaning"), self.figures()))

    def figures(self) -> list[tuple[str, str, str, str]]:
        """Return the figures of the cycle as texts, in km and km/h: name, value, unit and meaning."""
        s = self.statistics()
        rows = [
            ("duration", f"{s.duration:.5g}", "s", "time from the first point to the last"),
            ("distance", f"{s.distance / 1000:.5g}", "km", "distance driven if the trace is met"),
            ("v_max", f"{s.v_max * 3.6:.5g}", "km/h", "top speed"),
            ("v_mean", f"{s.v_mean * 3.6:.5g}", "km/h", "mean speed, stops included"),
            ("a_max", f"{s.a_max:.5g}", "m/s^2", "largest acceleration"),
            ("a_min", f"{s.a_min:.5g}", "m/s^2", "largest deceleration"),
            ("t_idle", f"{s.t_idle:.5g}", "s", "time at rest"),
            ("stops", f"{s.stops}", "1", "number of stops"),
        ]
        grade, over = (self.grade_by_distance[1], "distance") if self.grade_by_distance is not None else (self.grade, "time")
        if grade is not None:
            rows.append(("grade", f"{100 * grade.min():.3g} to {100 * grade.max():.3g}", "%", f"grade of the road, by {over}"))
        return rows

    @property
    def duration(self) -> float:
        """Time from the first point to the last [s]."""
        return float(self.time[-1] - self.time[0])

    @classmethod
    def load(cls, source: str | Path, grade: str | Path | None = None) -> Cycle:
        """Return a cycle of the library by name, or of a CSV file.

        Parameters
        ----------
        source
            Name, in any case of letters, or path ending in ``.csv``.
        grade
            CSV file with a grade over distance.

        """
        path: Path | Traversable = Path(source)
        grade_path: Path | Traversable | None = Path(grade) if grade is not None else None
        if isinstance(source, str) and not source.lower().endswith(".csv"):
            library = _library("cycles")
            if source.lower() not in library:
                raise InputError(f"cycle '{source}'", [f"not in the library{nearest(source.lower(), library)}"])
            path = library[source.lower()]
            grade_path = grade_path or _library("grades").get(source.lower())
        notes, columns = _read(path, COLUMNS, "time", {"time": "time_s", "speed": "speed_mps"})
        by_distance = None
        if grade_path is not None:
            _, over = _read(grade_path, GRADE_COLUMNS, "distance", {"distance": "distance_m", "grade": "grade"})
            by_distance = over["distance"], over["grade"]
        return cls(
            name=notes.get("name", path.name.removesuffix(".csv")),
            title=notes.get("title", ""),
            source=notes.get("source", ""),
            time=columns["time"],
            speed=columns["speed"],
            grade=columns.get("grade"),
            key_on=columns.get("key_on"),
            grade_by_distance=by_distance,
        )

    def sampled(self, dt: float) -> Samples:
        """Return the steps of a run; the last one is shorter where `dt` does not divide the duration."""
        if not (math.isfinite(dt) and dt > TIME_STEP):
            raise InputError(f"cycle '{self.name}'", [f"dt = {dt:g} s, must be > {TIME_STEP:g} s"])
        n = math.ceil(self.duration / dt - TIME_STEP)
        # Rounding keeps k dt from falling just behind a point of the cycle.
        t = np.minimum(self.time[0] + np.round(np.arange(1, n + 1) * dt, 9), self.time[-1])
        steps = np.full(n, float(dt))
        rest = self.duration - (n - 1) * dt
        if n and abs(rest - dt) > TIME_STEP:
            steps[-1] = rest

        v = np.interp(t, self.time, self.speed)
        grade = np.zeros(n) if self.grade is None else np.interp(t, self.time, self.grade)
        # Between a point with the key on and one with it off, the key is on.
        key_on = np.ones(n) if self.key_on is None else (np.interp(t, self.time, self.key_on) > 0).astype(float)
        return Samples(t, steps, v, grade, key_on, float(self.speed[0]), self.grade_by_distance)

    def scaled(self, factor: float) -> Cycle:
        """Return the cycle with all speeds multiplied."""
        if not (math.isfinite(factor) and factor >= 0):
            raise InputError(f"cycle '{self.name}'", [f"factor = {factor:g}, must be >= 0"])
        return replace(self, name=f"{self.name}-x{factor:g}", speed=self.speed * factor)

    def statistics(self) -> Statistics:
        """Return the figures of the cycle."""
        dt, v = np.diff(self.time), self.speed
        a = np.diff(v) / dt
        distance = float(np.sum((v[1:] + v[:-1]) / 2 * dt))
        still = (v[1:] == 0) & (v[:-1] == 0)
        return Statistics(
            duration=self.duration,
            distance=distance,
            v_max=float(v.max()),
            v_mean=distance / self.duration if self.duration else 0.0,
            a_max=float(a.max(initial=0.0)),
            a_min=float(a.min(initial=0.0)),
            t_idle=float(dt[still].sum()),
            stops=int(np.sum((v[1:] == 0) & (v[:-1] > 0))),
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


def _column(title: str) -> str:
    """Return the plain name of a column: ``Speed [km/h]`` is ``speed_kmh``."""
    plain = title.strip().lower().replace("km/h", "kmh").replace("m/s", "mps")
    return re.sub(r"[\s_\[\]()]+", "_", plain).strip("_")


def _read(
    path: Path | Traversable, known: Mapping[str, tuple[str, float]], axis: str, needed: Mapping[str, str]
) -> tuple[dict[str, str], dict[str, Array]]:
    """Return notes and columns in SI of a CSV; `axis` must rise and all `needed` columns be there."""
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError as e:
        raise InputError(str(path), ["not a text file in UTF-8"]) from e
    except OSError as e:
        raise InputError(str(path), [f"cannot be read: {e.strerror}"]) from e
    notes = {m[1]: m[2].strip() for line in lines if (m := re.match(r"#\s*(name|title|source):(.*)", line))}
    numbered = [(i, line) for i, line in enumerate(lines, 1) if line.strip() and not line.startswith("#")]
    if not numbered:
        raise InputError(str(path), ["is empty"])
    rows = [[entry.strip(' "') for entry in line.split(",")] for _, line in numbered]
    titles, first = [_column(title) for title in rows[0]], f"line {numbered[0][0]}"
    found = [known[title][0] for title in titles if title in known]
    problems = [f"{first}: column '{t}' is not known{nearest(t, known)}" for t in titles if t not in known]
    problems += [f"{first}: column {title} is missing" for name, title in needed.items() if name not in found]
    problems += [f"{first}: there are several columns with the {name}" for name in sorted(set(found)) if found.count(name) > 1]
    if problems:
        raise InputError(str(path), problems)
    if len(rows) == 1:
        raise InputError(str(path), ["has no line with numbers"])
    values = np.full((len(rows) - 1, len(titles)), np.nan)
    for k, ((i, _), row) in enumerate(zip(numbered[1:], rows[1:], strict=True)):
        if len(row) != len(titles):
            problems.append(f"line {i} has {len(row)} entries, must have {len(titles)}")
            continue
        for j, (title, text) in enumerate(zip(titles, row, strict=True)):
            try:
                values[k, j] = float(text)
            except ValueError:
                problems.append(f"line {i}: {title} = '{text}', must be a number")
                continue
            if not math.isfinite(values[k, j]):
                problems.append(f"line {i}: {title} = {text}, must be a finite number")
            elif known[title][0] == "speed" and values[k, j] < 0:
                problems.append(f"line {i}: {title} = {text}, must be >= 0")
    columns = {known[title][0]: values[:, j] * known[title][1] for j, title in enumerate(titles)}
    problems += _falls(columns[axis], titles[found.index(axis)], [i for i, _ in numbered[1:]])
    if problems:
        more = [f"and {len(problems) - NAMED} more like these"] if len(problems) > NAMED else []
        raise InputError(str(path), problems[:NAMED] + more)
    return notes, {name: np.ascontiguousarray(x) for name, x in columns.items()}


def _falls(points: Array, title: str, lines: Sequence[int]) -> list[str]:
    pairs = zip(lines[1:], pairwise(points), strict=True)
    return [f"line {i}: {title} = {b:g} follows {a:g}, it must rise" for i, (a, b) in pairs if b <= a]
