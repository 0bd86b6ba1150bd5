"""Sweeps: tasks at all points of a grid or a sample over numbers, parts and vehicles.

Each point is a vehicle of its own.  What its tasks find are the variables of the result, and what is wrong with a point
is kept as its failure and stops no other one.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, is_dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from halfshaft.library.base.errors import HalfshaftError, InputError, nearest, not_a
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.design import VEHICLE, Design, Given, Sample, Value, design_of

if TYPE_CHECKING:
    import xarray as xr

    from halfshaft.studies.task import Task

#: Unit of a figure by the end of its name, the longest that fits.
UNITS = {
    "_m": "m", "_s": "s", "_L": "L", "_J": "J", "_W": "W", "_kg": "kg", "_mps": "m/s", "_mps2": "m/s^2", "_kmh": "km/h", "_mph": "mph",
    "_L_per_100km": "L/100 km", "_mpg": "mpg", "_MPGe": "MPGe", "_Wh_per_km": "Wh/km", "_kWh_per_100km": "kWh/100 km", "_pct": "%",
    "_g_per_km": "g/km",
}  # fmt: skip
#: Variables of the result that are no figures.
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
    names: tuple[str, ...]
    tasks: tuple[Task, ...]

    def structure(self, values: Sequence[Value]) -> tuple[Value, ...]:
        """Return which vehicle and parts the point has."""
        return tuple(value for name, value in zip(self.names, values, strict=True) if "." not in name)

    def vehicle(self, values: Sequence[Value]) -> Vehicle:
        """Return the vehicle of a point."""
        given = dict(zip(self.names, values, strict=True))
        car = self._with_parts(tuple((name, str(x)) for name, x in given.items() if "." not in name))
        numbers = {name: x for name, x in given.items() if "." in name}
        return car.with_values(numbers) if numbers else car

    @lru_cache(maxsize=64)  # noqa: B019  a job lives as long as its process
    def _with_parts(self, chosen: tuple[tuple[str, str], ...]) -> Vehicle:
        parts = dict(chosen)
        name = parts.pop(VEHICLE, self.vehicles[0].name)
        car = next(car for car in self.vehicles if car.name == name)
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


def sweep(
    vehicle: Vehicle | Sequence[Vehicle],
    axes: Mapping[str, Given],
    tasks: Task | Sequence[Task],
    *,
    sample: str | Sample | None = None,
    seed: int = 0,
    responses: Sequence[str] = (),
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> xr.Dataset:
    """Run tasks at all points of a grid or a sample.

    Parameters
    ----------
    vehicle
        What is varied; several vehicles are an axis of their own, ``vehicle``.
    axes
        What varies, by name: a number of the vehicle (``body.m``) or a role whose part is replaced (``motor``).  A list of
        values, or a text: ``"1000, 1200, 1500"``, or a range ``"50..100 kW:6"`` of six values.  Numbers are SI or have a unit.
    tasks
        What is done with each vehicle, such as ``Drive(cycle)``.  The figures of several tasks are told apart by their names.
    sample
        Without it, all values of each axis are combined with all of the others.  ``lhs:64`` draws 64 points of a Latin
        hypercube, ``sobol:64`` of a Sobol sequence, ``saltelli:64`` the points for Sobol's indices; a range has no number of
        values then.
    seed
        The same one draws the same points.
    responses
        Which figures to keep; all that the tasks find, if none is named.
    progress
        Is told how many points are finished, and of how many.

    Returns
    -------
    xarray.Dataset
        The figures over the axes, or over ``point`` for a sample; ``failure`` says why a point has none, ``notes`` what to know.

    Raises
    ------
    InputError
        If vehicles, axes, sample or responses are not what they must be; everything that is wrong is named at once.

    """
    job, design = _planned(vehicle, axes, tasks, sample, seed)
    found: dict[int, Point] = {}
    points = design.points
    for i, values in _probing(job, points):
        found[i] = job.at(values)
        progress(len(found), len(points))
        if not (problems := _lacking(job, responses, found.values())):
            break
    else:
        raise InputError("sweep", problems)
    for i, values in enumerate(points):
        if i not in found:
            found[i] = job.at(values)
            progress(len(found), len(points))
    return dataset(design, found, responses)


def _planned(
    vehicle: Vehicle | Sequence[Vehicle],
    axes: Mapping[str, Given],
    tasks: Task | Sequence[Task],
    sample: str | Sample | None,
    seed: int,
) -> tuple[Job, Design]:
    """Return what to do and where, or raise one error with all that is wrong."""
    vehicles = tuple(vehicle) if isinstance(vehicle, list | tuple) else (vehicle,)
    work = tuple(tasks) if isinstance(tasks, list | tuple) else (tasks,)
    problems = [] if vehicles else ["has no vehicle"]
    for car in vehicles:
        problems += not_a(Vehicle, vehicle=car)
    if not work:
        problems.append("has no task, must have at least one, such as Drive(cycle)")
    wrong = [task for task in work if not (is_dataclass(task) and callable(task))]
    problems += [f"task {task!r:.60} must be a frozen dataclass that is called with a vehicle, such as Drive(cycle)" for task in wrong]
    names = [task.name for task in work if task not in wrong]
    problems += [f"has {names.count(name)} tasks called '{name}'" for name in dict.fromkeys(names) if names.count(name) > 1]
    try:
        drawn = Sample.read(sample, seed) if isinstance(sample, str) else sample
    except InputError as error:
        problems += [f"{error.where} {problem}" for problem in error.problems]
        drawn = Sample("lhs", 2)
    if any(problem.startswith("vehicle must") for problem in problems):
        raise InputError("sweep", problems)
    design = design_of(vehicles, axes, drawn, problems)
    if problems:
        raise InputError("sweep", problems)
    return Job(vehicles, tuple(axis.name for axis in design.axes), work), design


def _probing(job: Job, points: Sequence[tuple[Value, ...]]) -> Iterator[tuple[int, tuple[Value, ...]]]:
    """Yield points that together show what the tasks find: the first one of each structure, and the last one of all."""
    seen = set()
    for i, values in enumerate(points):
        structure = job.structure(values)
        if structure not in seen:
            seen.add(structure)
            yield i, values
    if len(points) > 1:
        yield len(points) - 1, points[-1]


def _lacking(job: Job, responses: Sequence[str], found: Collection[Point]) -> list[str]:
    """Return which responses no point has that was tried."""
    names = dict.fromkeys(name for point in found for name in point.figures)
    known = [name for name in names if any(point.figures.get(name) is not None for point in found)]
    cars = ", ".join(f"{car.name} ({car.powertrain})" for car in job.vehicles)
    problems = []
    for name in responses if known else ():
        if name not in names:
            problems.append(f"response {name} is not known{nearest(name, known) or ', must be one of ' + ', '.join(known)}")
        elif name not in known:
            at = "the point that was" if len(found) == 1 else f"all {len(found)} points that were"
            problems.append(f"response {name}: {cars} has none at {at} tried")
    return problems


def dataset(design: Design, found: Mapping[int, Point], responses: Sequence[str] = ()) -> xr.Dataset:
    """Return what was found as a labelled dataset; without `responses` all that any point has."""
    import xarray as xr  # takes half a second

    dims, shape = design.dims, design.shape
    order = range(len(design.points))
    names = tuple(responses) or tuple(dict.fromkeys(name for i in order for name in found[i].figures))
    variables: dict[str, Any] = {}
    for name in names:
        row = np.array([np.nan if (x := found[i].figures.get(name)) is None else x for i in order])
        if responses or not np.isnan(row).all():
            variables[name] = (dims, row.reshape(shape), {"units": unit_of(name), "long_name": title_of(name)})
    told = {FAILURE: [found[i].failure for i in order], NOTES: ["\n".join(found[i].notes) for i in order]}
    doc = {FAILURE: "what went wrong", NOTES: "what to know about the figures"}
    variables |= {name: (dims, np.array(row, dtype=object).reshape(shape), {"long_name": doc[name]}) for name, row in told.items()}
    coordinates: dict[str, Any] = {}
    for i, axis in enumerate(design.axes):
        values = [point[i] for point in design.points] if design.sample else list(axis.values)
        attributes = {"units": axis.unit, "long_name": axis.doc} if axis.numeric else {"long_name": axis.doc}
        row = np.array(values, dtype=float if axis.numeric else object)
        coordinates[axis.name] = (dims[0] if design.sample else axis.name, row, attributes)
    return xr.Dataset(variables, coords=coordinates)


def table(found: xr.Dataset) -> dict[str, list[Any]]:
    """Return axes, figures, failures and notes of all points, column by column."""
    rows = found.to_dataframe(dim_order=list(found.sizes)).reset_index()
    return {str(name): rows[name].tolist() for name in (*found.coords, *found.data_vars)}


def unit_of(figure: str) -> str:
    """Return the unit of a figure, which its name ends with; ``1`` where it has none."""
    return next((UNITS[end] for end in sorted(UNITS, key=len, reverse=True) if figure.endswith(end)), "1")


def title_of(figure: str) -> str:
    """Return a figure's name in words, without its unit."""
    end = next((end for end in sorted(UNITS, key=len, reverse=True) if figure.endswith(end)), "")
    return figure.removesuffix(end).replace("_", " ").replace(".", ": ")
