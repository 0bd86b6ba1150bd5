"""The variables of an FMU, one list for its C and its XML, and the cycle that can be part of it."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from halfshaft.library.base.errors import InputError, nearest
from halfshaft.library.base.tags import Tags
from halfshaft.models.assembly import Description, Step

Array: TypeAlias = npt.NDArray[np.float64]
Version: TypeAlias = Literal[2, 3]

#: An internal step is never shorter than this [s].
SHORTEST_STEP = 1e-6


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
    allowed: str = ""


def identifier(name: str) -> str:
    """Return an identifier of C made from a name; a name that loses more than points and dashes gets a digest instead."""
    if re.fullmatch("[A-Za-z][A-Za-z0-9_.-]{0,63}", name):
        return re.sub("[.-]", "_", name)
    digest = hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()[:8]
    return f"{re.sub('[^A-Za-z]', '', name)[:32] or 'model'}_{digest}"


def variables(step: Step, step_size: float, cycle: CycleTable | None, values: Mapping[str, float]) -> list[Variable]:
    """Return all variables: time, requests, step size, parameters, outputs; `values` replaces start values of parameters."""
    least = f">= {SHORTEST_STEP:g} s"
    length = Variable("step_size", "s", "length of the internal steps", "parameter", step_size, SHORTEST_STEP, allowed=least)
    requests = [_settable(r, "input", r.start) for r in step.requests[:3]]
    if cycle:
        firsts = (cycle.v_start, cycle.grade[0], cycle.key_on[0])
        length = length._replace(causality="local", lowest=None)
        requests = [v._replace(causality="output", start=float(first)) for v, first in zip(requests, firsts, strict=True)]
        values = {**values, **dict.fromkeys(Tags.of(step.parameters).all_of("start speed"), cycle.v_start)}
    return [
        Variable("time", "s", "time", "independent", 0.0),
        *requests,
        length,
        *(_settable(p, "parameter", values.get(p.name, p.start)) for p in step.parameters),
        *(Variable(y.name, y.unit, y.doc, "output", 0.0, state=y.state) for y in step.outputs),
    ]


def _settable(d: Description, causality: Literal["input", "parameter"], start: float) -> Variable:
    return Variable(d.name, d.unit, d.doc, causality, start, d.lowest, d.highest, allowed=d.allowed)


def _inside(d: Description, value: float | Array) -> Any:
    lowest, highest = -np.inf if d.lowest is None else d.lowest, np.inf if d.highest is None else d.highest
    return np.isfinite(value) & (value >= lowest) & (value <= highest)


def check(step: Step, step_size: float, cycle: CycleTable | None, values: Mapping[str, float]) -> None:
    """Refuse values, a cycle or a step size that no FMU can be made from.

    Raises
    ------
    InputError
        With everything that is wrong.

    """
    problems = [] if SHORTEST_STEP <= step_size < np.inf else [f"step_size = {step_size:g} s, must be at least {SHORTEST_STEP:g} s"]
    parameters = {p.name: p for p in step.parameters}
    problems += [f"no parameter '{name}'{nearest(name, parameters)}" for name in values if name not in parameters]
    problems += [
        f"{name} = {value:g}, must be {parameters[name].allowed or 'a finite number'}"
        for name, value in values.items()
        if name in parameters and not _inside(parameters[name], value)
    ]
    if cycle:
        rows = (cycle.v_request, cycle.grade, cycle.key_on)
        if len({np.shape(row) for row in rows}) > 1 or np.ndim(cycle.v_request) != 1 or not len(cycle.v_request):
            problems.append("v_request, grade and key_on must be rows of the same length, at least 1")
        if not all(np.all(np.isfinite(row)) for row in (*rows, cycle.v_start, *(cycle.grade_distance or ()))):
            problems.append("not all numbers of the cycle are finite")
        for d, row in zip(step.requests, rows, strict=False):
            if np.all(np.isfinite(row)) and not np.all(_inside(d, row)):
                problems.append(f"{d.name} of the cycle must be {d.allowed}")
        if cycle.v_start and not Tags.of(step.parameters).all_of("start speed"):
            problems.append(f"v_start = {cycle.v_start:g} m/s, but the model has no parameter for the start speed")
        if cycle.grade_distance:
            distance, grade = cycle.grade_distance
            if np.shape(distance) != np.shape(grade) or not len(distance) or np.any(np.diff(distance) <= 0):
                problems.append("grade_distance needs rising distances and one grade for each")
            if not Tags.of(step.states).all_of("distance"):
                problems.append("grade_distance is given, but the model has no state for the distance")
    if problems:
        raise InputError(f"FMU of {step.name}", problems)
