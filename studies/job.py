"""What is done at each point of a sweep, in this process or another one."""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np

from halfshaft.library.base.errors import CompileError, HalfshaftError
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.design import VEHICLE, Axis, Value
from halfshaft.studies.task import Drive

if TYPE_CHECKING:
    from halfshaft.studies.task import Task

#: A point: its index, and the values of all axes there.
Row: TypeAlias = tuple[int, tuple[Value, ...]]
#: Variables of a result that are no figures.
FAILURE, NOTES = "failure", "notes"


class Point(NamedTuple):
    """What was found at a point: the figures of all tasks, what to know about them, and what went wrong."""

    figures: Mapping[str, float | None]
    notes: tuple[str, ...] = ()
    failure: str = ""


@dataclass(frozen=True, eq=False)
class Job:
    """What is done at each point: all that another process needs to know."""

    vehicles: tuple[Vehicle, ...]
    axes: tuple[Axis, ...]
    tasks: tuple[Task, ...]
    #: Whether its points are plain runs, so many that they are made in batches.
    batch: bool = False

    def structure(self, values: Sequence[Value]) -> tuple[str, ...]:
        """Return which vehicle and parts the point has."""
        return tuple(str(value) for axis, value in zip(self.axes, values, strict=True) if not axis.numeric)

    def vehicle(self, values: Sequence[Value]) -> Vehicle:
        """Return the vehicle of a point."""
        car = self._built(self.structure(values))
        numbers = {axis.name: value for axis, value in zip(self.axes, values, strict=True) if axis.numeric}
        return car.with_values(numbers) if numbers else car

    @lru_cache(maxsize=64)  # noqa: B019 - a job lives as long as its process
    def _built(self, chosen: tuple[str, ...]) -> Vehicle:
        named = [axis for axis in self.axes if not axis.numeric]
        car, parts = self.vehicles[0], {}
        for axis, value in zip(named, chosen, strict=True):
            i = axis.values.index(value)
            if axis.name == VEHICLE:
                car = self.vehicles[i]
            else:
                parts[axis.name] = axis.parts[i]
        return car.with_parts(parts) if parts else car

    def at(self, values: Sequence[Value]) -> Point:
        """Return what the tasks find at a point."""
        try:
            car = self.vehicle(values)
        except HalfshaftError as error:
            return Point({}, failure=str(error))
        figures: dict[str, float | None] = {}
        notes: list[str] = []
        failures: list[str] = []
        for task in self.tasks:
            prefix, said = self._told(task)
            try:
                outcome = task(car)
                figures |= {prefix + name: x if x is None else float(x) for name, x in outcome.figures.items() if not isinstance(x, str)}
                notes += [said + note for note in outcome.notes]
            # A task of the user's own may raise anything; that is no reason to lose the other points.
            except Exception as error:
                failures.append(f"{said}{error}" if isinstance(error, HalfshaftError) else f"{said}{type(error).__name__}: {error}")
        return Point(figures, tuple(notes), "\n".join(failures))

    def many(self, rows: Sequence[Row], threads: int | None = None) -> dict[int, Point]:
        """Return what plain runs find at some points, each structure in one call: the same figures, without account and notes."""
        groups: dict[tuple[str, ...], list[Row]] = {}
        for row in rows:
            groups.setdefault(self.structure(row[1]), []).append(row)
        found: dict[int, Point] = {}
        for group in groups.values():
            found |= self._together(group, threads)
        return found

    def _together(self, rows: Sequence[Row], threads: int | None) -> dict[int, Point]:
        from halfshaft.studies.batch import run_batch

        points = [values for _, values in rows]
        figures: list[dict[str, float | None]] = [{} for _ in rows]
        failures: list[list[str]] = [[] for _ in rows]
        try:
            car = self._built(self.structure(points[0]))
            numbers = {
                axis.name: np.array([values[i] for values in points], dtype=float) for i, axis in enumerate(self.axes) if axis.numeric
            }
            for task in self.tasks:
                assert isinstance(task, Drive)
                prefix, said = self._told(task)
                data = run_batch(car, numbers, task.cycle, mode=task.mode, dt=task.dt, threads=threads)
                own = {str(name): x.to_numpy().tolist() for name, x in data.data_vars.items() if "." not in str(name)}
                lost, by = own.pop("status"), own.pop("lost_by")
                own.pop("unsolved", None)
                for k in range(len(rows)):
                    figures[k] |= {prefix + name: None if x[k] != x[k] else x[k] for name, x in own.items()}
                    if lost[k]:
                        failures[k].append(f"{said}{car.title}: by t = {by[k]:g} s a result is not a number; check the inputs")
        except CompileError:
            return {i: self.at(values) for i, values in rows}
        except HalfshaftError:
            # One that cannot be keeps all others of its call from running: halves find it.
            if len(rows) == 1:
                return {i: self.at(values) for i, values in rows}
            middle = len(rows) // 2
            return self._together(rows[:middle], threads) | self._together(rows[middle:], threads)
        return {i: Point(figures[k], (), "\n".join(failures[k])) for k, (i, _) in enumerate(rows)}

    def _told(self, task: Task) -> tuple[str, str]:
        """Return what the figures of a task begin with, and what is said of it."""
        return (f"{task.name}.", f"{task.name}: ") if len(self.tasks) > 1 else ("", "")


class Done(NamedTuple):
    """Points that were worked out, by their index, and the time that it took [s]."""

    points: dict[int, Point]
    seconds: float


def work(job: bytes, rows: Sequence[Row], stopped: Callable[[], bool] = lambda: False) -> Done:
    """Return the points of some rows, indices and values; fewer if it is stopped before the end."""
    own, begin = _loaded(job), time.perf_counter()
    found: dict[int, Point] = {}
    if own.batch:
        return Done(own.many(rows, threads=1), time.perf_counter() - begin)
    for i, values in rows:
        if stopped():
            break
        found[i] = own.at(values)
    return Done(found, time.perf_counter() - begin)


# A job comes again with each of its portions; its vehicles are built once.
@lru_cache(maxsize=4)
def _loaded(job: bytes) -> Job:
    found = pickle.loads(job)
    assert isinstance(found, Job)
    return found
