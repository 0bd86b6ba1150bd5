"""Sweeps: tasks at all points of a grid or a sample over numbers, parts and vehicles.

Each point is a vehicle of its own.  What its tasks find are the variables of the result, and what is wrong with a point
is kept as its failure and stops no other one.
"""

from __future__ import annotations

import json
import pickle
import time
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, nullcontext
from dataclasses import is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from halfshaft.cosim.figures import title_of, unit_of
from halfshaft.library.base.errors import HalfshaftError, InputError, nearest, not_a
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.crew import Crew, cluster, cores, processes
from halfshaft.studies.design import Design, Given, Sample, Value, design_of
from halfshaft.studies.distributions import Correlation
from halfshaft.studies.folder import Kept, kept
from halfshaft.studies.identity import manifest
from halfshaft.studies.job import FAILURE, NOTES, Done, Job, Point, Row
from halfshaft.studies.task import Drive

if TYPE_CHECKING:
    import xarray as xr

    from halfshaft.studies.task import Task

Points: TypeAlias = Sequence[tuple[Value, ...]]
Add: TypeAlias = Callable[[Mapping[int, Point]], None]
#: A sweep that takes no longer than this needs no other processes: they take as long to start [s].
ALONE = 1.0
#: A portion of work takes so long [s].
PORTION = 1.0
#: So many plain runs are made in batches, so many at a time: there an interrupt is looked at.
BATCHED, BATCH = 1000, 1024
MOST_WORKERS = 1000


def sweep(
    vehicle: Vehicle | Sequence[Vehicle],
    axes: Mapping[str, Given],
    tasks: Task | Sequence[Task],
    *,
    sample: str | None = None,
    seed: int = 0,
    correlation: Correlation | None = None,
    truncate: bool = False,
    responses: Sequence[str] = (),
    folder: str | Path | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
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
        Of a sample also a distribution: ``"normal(1300, 40)"``, or a frozen one of `scipy.stats`.
    tasks
        What is done with each vehicle, such as ``Drive(cycle)``.  The figures of several tasks are told apart by their names.
    sample
        Without it, all values of each axis are combined with all of the others.  ``lhs:64`` draws 64 points of a Latin
        hypercube, ``sobol:64`` of a Sobol sequence, ``saltelli:64`` the points for Sobol's indices; a range has no number of
        values then.
    seed
        The same one draws the same points.
    correlation
        Of distributions, by pairs of names or as a matrix.
    truncate
        Cut distributions at the bounds of their numbers; without it, a point outside is an error.
    responses
        Which figures to return; all that the tasks find, if none is named.
    folder
        Keeps what is finished: after an interrupt or a crash the same call goes on where it was.  At the end it has all
        of it as ``sweep.nc``.
    workers
        How many processes work; as many as there are cores, if it takes longer than their start.
    scheduler
        Address of a `dask.distributed` cluster whose workers do the work instead, such as ``tcp://10.0.0.1:8786``.
    progress
        Is told how many points are finished, and of how many.

    Returns
    -------
    xarray.Dataset
        The figures over the axes, or over ``point`` for a sample; ``failure`` says why a point has none, ``notes`` what to
        know.  Its attribute ``sweep`` is a JSON text of all that it was made of.

    Raises
    ------
    InputError
        If vehicles, axes, sample or responses are not what they must be, the folder is that of another sweep or in use, or the
        cluster is not there; everything that is wrong is named at once.
    HalfshaftError
        If a worker was lost; what was finished before is in the folder.

    """
    job, design = _planned(vehicle, axes, tasks, sample, seed, workers, scheduler, correlation, truncate)
    points = design.points
    responses = (responses,) if isinstance(responses, str) else responses
    with kept(manifest(job.vehicles, design, job.tasks), folder, len(points)) as keeper:
        _carry_out(job, points, keeper, responses, workers, scheduler, progress)
        whole = dataset(design, keeper.found, keeper.manifest)
        keeper.finish(whole)
    return dataset(design, keeper.found, keeper.manifest, responses) if responses else whole


def _planned(
    vehicle: Vehicle | Sequence[Vehicle],
    axes: Mapping[str, Given],
    tasks: Task | Sequence[Task],
    sample: str | None,
    seed: int,
    workers: int | None,
    scheduler: str | None,
    correlation: Correlation | None = None,
    truncate: bool = False,
) -> tuple[Job, Design]:
    """Return what to do and where, or raise one error with all that is wrong."""
    vehicles = tuple(vehicle) if isinstance(vehicle, list | tuple) else (vehicle,)
    work = tuple(tasks) if isinstance(tasks, list | tuple) else (tasks,)
    problems = [] if vehicles else ["has no vehicle"]
    for car in vehicles:
        problems += not_a(Vehicle, vehicle=car)
    if not work:
        problems.append("has no task, must have at least one, such as Drive(cycle)")
    wrong = [task for task in work if isinstance(task, type) or not (is_dataclass(task) and callable(task) and hasattr(task, "name"))]
    problems += [f"task {task!r:.60} must be a frozen dataclass that is called with a vehicle, such as Drive(cycle)" for task in wrong]
    names = [task.name for task in work if task not in wrong]
    problems += [f"has {names.count(name)} tasks called '{name}'" for name in dict.fromkeys(names) if names.count(name) > 1]
    for task in work:
        # The tests know what is wrong with their options, whatever the vehicle.
        problems += [f"{task.name}: {problem}" for problem in getattr(task, "problems", tuple)()] if task not in wrong else []
    try:
        drawn = None if sample is None else Sample.read(str(sample), seed)
    except InputError as error:
        problems += [f"{error.where} {problem}" for problem in error.problems]
        drawn = Sample("lhs", 2)
    if any(problem.startswith("vehicle must") for problem in problems):
        raise InputError("sweep", problems)
    if workers is not None and scheduler is not None:
        problems.append("takes workers on this machine or the scheduler of a cluster, not both")
    if workers is not None and not (isinstance(workers, int) and 1 <= workers <= MOST_WORKERS):
        problems.append(f"workers = {workers!r}, must be a whole number from 1 to {MOST_WORKERS}")
    design = design_of(vehicles, axes, drawn, problems, correlation, truncate)
    if problems:
        raise InputError("sweep", problems)
    plain = all(type(task) is Drive for task in work) and any(axis.numeric for axis in design.axes)
    return Job(vehicles, design.axes, work, plain and len(design.points) >= BATCHED), design


def _carry_out(
    job: Job,
    points: Points,
    keeper: Kept,
    responses: Sequence[str],
    workers: int | None,
    scheduler: str | None,
    progress: Callable[[int, int], None],
) -> None:
    """Work out all points that are not finished yet."""

    def add(found: Mapping[int, Point]) -> None:
        keeper.add(found)
        progress(len(keeper.found), len(points))

    progress(len(keeper.found), len(points))
    with nullcontext() if scheduler is None else cluster(scheduler) as remote:
        _probe(job, points, keeper, responses, add)
        # Those of one structure together: its code is loaded once, and each worker meets few of them.
        left = sorted((i for i in range(len(points)) if i not in keeper.found), key=lambda i: job.structure(points[i]))
        rows = deque((i, points[i]) for i in left)
        if remote is not None:
            _share_out(job, rows, remote, add)
            return
        while rows and job.batch:
            add(job.many([rows.popleft() for _ in range(min(BATCH, len(rows)))], threads=workers))
        hands = workers or cores()
        if workers is None or hands == 1:
            begin = time.monotonic()
            while rows and (hands == 1 or time.monotonic() < begin + ALONE):
                i, values = rows.popleft()
                add({i: job.at(values)})
        if rows:
            with processes(min(hands, len(rows))) as crew:
                _share_out(job, rows, crew, add)


def _share_out(job: Job, rows: deque[Row], crew: Crew, add: Add) -> None:
    """Hand out rows in portions of about a second, the last ones smaller so that all end together."""
    try:
        content = pickle.dumps(job)
    # What pickle raises has no common base.
    except Exception as error:
        raise InputError("sweep", [f"the tasks cannot be sent to other processes, only workers=1 can do them: {error}"]) from error
    pending: set[Future[Done]] = set()
    done, seconds = 0, 0.0

    def take(futures: Iterable[Future[Done]]) -> None:
        nonlocal done, seconds
        for future in futures:
            with _loss_said():
                found = future.result()
            done, seconds = done + len(found.points), seconds + found.seconds
            add(found.points)

    try:
        while rows or pending:
            while rows and len(pending) < 2 * crew.size:
                fitting = int(PORTION * done / seconds) if done else 1
                n = max(1, min(fitting, len(rows) // (2 * crew.size)))
                with _loss_said():
                    pending.add(crew.submit(content, [rows.popleft() for _ in range(n)]))
            finished, pending = wait(pending, return_when=FIRST_COMPLETED)
            take(finished)
    except KeyboardInterrupt:
        crew.stop()
        take([future for future in pending if not future.cancel()])
        raise


@contextmanager
def _loss_said() -> Iterator[None]:
    """Say that a worker was lost; what a lost process or cluster raises has no common base."""
    try:
        yield
    except BrokenProcessPool as error:
        text = "a process was lost: killed, out of memory, or started by a script that calls sweep above if __name__ == '__main__'"
        raise HalfshaftError(f"sweep: {text}; with a folder, the same call goes on from what was finished") from error
    except Exception as error:
        text = f"a worker was lost ({type(error).__name__}: {error}); with a folder, the same call goes on from what was finished"
        raise HalfshaftError(f"sweep: {text}") from error


def _probe(job: Job, points: Points, keeper: Kept, responses: Sequence[str], add: Add) -> None:
    """Work out points until every response was found at one of them; if one never is, raise an error."""
    tried: list[Point] = []
    problems: list[str] = []
    for i, values in _probing(job, points):
        if i not in keeper.found:
            add(job.many([(i, values)], threads=1) if job.batch else {i: job.at(values)})
        tried.append(keeper.found[i])
        problems = _lacking(job, responses, tried)
        # Points that failed tell nothing.
        if not problems and (not responses or any(point.figures for point in tried)):
            return
    if problems:
        raise InputError("sweep", problems)


def _probing(job: Job, points: Points) -> Iterator[Row]:
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


def dataset(design: Design, found: Mapping[int, Point], made: Mapping[str, Any], responses: Sequence[str] = ()) -> xr.Dataset:
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
    origin, what = made["origin"], made["sweep"]
    attributes = {
        "Conventions": "CF-1.11",
        "title": f"{', '.join(what['vehicles'])}: {', '.join(what['tasks'])} over {', '.join(what['axes'])}",
        "source": f"halfshaft {what['version']}",
        "history": f"{origin['date']}: made on {origin['machine']}",
        "sweep": json.dumps(made),
    }
    return xr.Dataset(variables, coords=coordinates, attrs=attributes)


def table(found: xr.Dataset) -> dict[str, list[Any]]:
    """Return axes, figures, failures and notes of all points, column by column."""
    rows = found.to_dataframe(dim_order=list(found.sizes)).reset_index()
    return {str(name): rows[name].tolist() for name in (*found.coords, *found.data_vars)}
