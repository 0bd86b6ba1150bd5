"""What is done at each point of a sweep, in this process or another one."""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

from halfshaft.library.base.errors import HalfshaftError
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.design import VEHICLE, Axis, Value

if TYPE_CHECKING:
    from halfshaft.studies.task import Task

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
            prefix, said = (f"{task.name}.", f"{task.name}: ") if len(self.tasks) > 1 else ("", "")
            try:
                outcome = task(car)
                figures |= {prefix + name: x if x is None else float(x) for name, x in outcome.figures.items()}
                notes += [said + note for note in outcome.notes]
            # A task of the user's own may raise anything; that is no reason to lose the other points.
            except Exception as error:
                failures.append(f"{said}{error}" if isinstance(error, HalfshaftError) else f"{said}{type(error).__name__}: {error}")
        return Point(figures, tuple(notes), "\n".join(failures))


class Done(NamedTuple):
    """Points that were worked out, by their index, and the time that it took [s]."""

    points: dict[int, Point]
    seconds: float


def work(job: bytes, rows: Sequence[tuple[int, tuple[Value, ...]]], stopped: Callable[[], bool] = lambda: False) -> Done:
    """Return the points of some rows, indices and values; fewer if it is stopped before the end."""
    own, begin = _loaded(job), time.perf_counter()
    found: dict[int, Point] = {}
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
