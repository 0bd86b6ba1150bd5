"""The variables of an FMU, one list for its C and its XML, and the cycle that can be part of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from halfshaft.library.errors import InputError, nearest
from halfshaft.models.assembly import Step

Array: TypeAlias = npt.NDArray[np.float64]
Version: TypeAlias = Literal[2, 3]

#: An internal step is never shorter than this [s].
SHORTEST_STEP = 1e-6
#: States that the shell knows by name.
SPEED, DISTANCE = "body.v", "body.distance"
#: Parameter that the start speed of a cycle replaces.
START_SPEED = "body.v_start"


class CycleTable(NamedTuple):
    """A cycle on the grid of internal steps: one element per step in each array."""

    name: str
    v_request: Array
    grade: Array
    key_on: Array
    grade_distance: tuple[Array, Array] | None = None
    v_start: float = 0.0


class Variable(NamedTuple):
    """A variable of an FMU; its value reference is its position in the list."""

    name: str
    unit: str
    doc: str
    causality: Literal["independent", "input", "parameter", "local", "output"]
    start: float
    lowest: float | None = None
    highest: float | None = None
    state: int | None = None


def variables(step: Step, step_size: float, cycle: CycleTable | None, values: Mapping[str, float]) -> list[Variable]:
    """Return all variables: time, requests, step size, parameters, outputs; `values` replaces start values of parameters."""
    requests = [(r, r.start) for r in step.requests[:3]]
    if cycle:
        firsts = (cycle.v_start, cycle.grade[0], cycle.key_on[0])
        requests = [(r, float(first)) for (r, _), first in zip(requests, firsts, strict=True)]
        values = {**values, START_SPEED: cycle.v_start}
    length = ("step_size", "s", "length of the internal steps")
    return [
        Variable("time", "s", "time", "independent", 0.0),
        *(Variable(r.name, r.unit, r.doc, "output" if cycle else "input", start) for r, start in requests),
        Variable(*length, "local", step_size) if cycle else Variable(*length, "parameter", step_size, SHORTEST_STEP),
        *(Variable(p.name, p.unit, p.doc, "parameter", values.get(p.name, p.start), p.lowest, p.highest) for p in step.parameters),
        *(Variable(y.name, y.unit, y.doc, "output", 0.0, state=y.state) for y in step.outputs),
    ]


def check(step: Step, step_size: float, cycle: CycleTable | None, values: Mapping[str, float]) -> None:
    """Refuse values, a cycle or a step size that no FMU can be made from.

    Raises
    ------
    InputError
        With everything that is wrong.

    """
    problems = [] if SHORTEST_STEP <= step_size < np.inf else [f"step_size = {step_size:g} s, must be at least {SHORTEST_STEP:g} s"]
    parameters = [p.name for p in step.parameters]
    problems += [f"no parameter '{name}'{nearest(name, parameters)}" for name in values if name not in parameters]
    problems += [f"{name} = {value:g} is not a finite number" for name, value in values.items() if not np.isfinite(value)]
    if cycle:
        rows = (cycle.v_request, cycle.grade, cycle.key_on)
        if len({np.shape(row) for row in rows}) > 1 or np.ndim(cycle.v_request) != 1 or not len(cycle.v_request):
            problems.append("v_request, grade and key_on must be rows of the same length, at least 1")
        if not all(np.all(np.isfinite(row)) for row in (*rows, cycle.v_start, *(cycle.grade_distance or ()))):
            problems.append("not all numbers of the cycle are finite")
        if cycle.v_start and START_SPEED not in parameters:
            problems.append(f"v_start = {cycle.v_start:g} m/s, but the model has no parameter {START_SPEED}")
        if cycle.grade_distance:
            distance, grade = cycle.grade_distance
            if np.shape(distance) != np.shape(grade) or not len(distance) or np.any(np.diff(distance) <= 0):
                problems.append("grade_distance needs rising distances and one grade for each")
            if DISTANCE not in [x.name for x in step.states]:
                problems.append(f"grade_distance is given, but the model has no state {DISTANCE}")
    if problems:
        raise InputError(f"FMU of {step.name}", problems)
