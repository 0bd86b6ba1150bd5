"""A step's operations on arrays: every value of many steps at once, without a compiler.

Tests look at values in the middle of a step with it, and the smooth form of a step (`halfshaft.fmu_build.smooth`) learns from a run
how large they are.  The numbers are those of the compiled step; only powers and transcendental functions may differ in the last bit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import product
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from halfshaft.fmu_build.graph import Op, StepGraph
from halfshaft.library.base.tables import Table

Array: TypeAlias = npt.NDArray[np.float64]

#: What each operation does with arrays; flags are 0 and 1.
_ON_ARRAYS: Mapping[str, Callable[..., Any]] = {
    "add": np.add, "sub": np.subtract, "mul": np.multiply, "div": np.divide, "neg": np.negative, "sq": lambda a: a * a,
    "twice": lambda a: 2 * a, "inv": lambda a: 1 / a, "min": np.minimum, "max": np.maximum, "sign": np.sign, "pow": np.power,
    "fmod": np.fmod, "only": lambda c, a: np.where(c, a, 0.0), "same": lambda a: a, "choose": np.where, "true": lambda a: a != 0,
    "lt": np.less, "le": np.less_equal, "eq": np.equal, "ne": np.not_equal, "not": np.logical_not, "and": np.logical_and,
    "or": np.logical_or, "clip": np.clip, "sqrt": np.sqrt, "fabs": np.abs, "exp": np.exp, "log": np.log, "tanh": np.tanh, "sin": np.sin,
    "cos": np.cos, "atan": np.arctan, "floor": np.floor, "ceil": np.ceil,
}  # fmt: skip


def number(name: str) -> float:
    """Return the number of a constant's name."""
    text = name[1:-1]
    return {"NAN": np.nan, "HUGE_VAL": np.inf, "-HUGE_VAL": -np.inf}[text] if text[-1] in "NL" else float.fromhex(text)


def evaluate(found: StepGraph, x: Array, u: Array, p: Array, given: Mapping[str, Array] | None = None) -> dict[str, Array]:
    """Return all values of a step, by name.

    Parameters
    ----------
    found
        The operations.
    x, u, p
        State, request and parameters, each an array of values, or a matrix with a row a value and a column a step.
    given
        Values that are put in the place of what an operation gives; where one is not a number, the operation's own stands.

    """
    values: dict[str, Any] = {f"{vector}[{i}]": row for vector, rows in (("x", x), ("u", u), ("p", p)) for i, row in enumerate(rows)}
    # Both sides of a choice are computed; the one that is not taken may be out of bounds.
    with np.errstate(all="ignore"):
        for op in (*found.graph.prepared, *found.stepped):
            values[op.name] = _value(op, found, [number(name) if name.startswith("(") else values[name] for name in op.of])
            if given and op.name in given:
                own = given[op.name]
                values[op.name] = np.where(np.isnan(own), values[op.name], own)
    return values


def of_names(values: Mapping[str, Array], names: list[str], n: int) -> Array:
    """Return some values as a matrix with a row a name and a column a step."""
    return np.array([np.broadcast_to(number(name) if name.startswith("(") else values[name], n) for name in names], dtype=float).reshape(
        -1, n
    )


def _value(op: Op, found: StepGraph, of: list[Any]) -> Any:
    if op.what == "find":
        points = found.graph.axes[op.about]
        return np.clip(np.searchsorted(points, of[0], side="right") - 1, 0, len(points) - 2)
    if op.what == "place":
        points = found.graph.axes[op.about]
        return (of[0] - points[of[1]]) * (1.0 / np.diff(points))[of[1]]
    if op.what == "table":
        return _interpolated(found.graph.tables[op.about], of[::2], of[1::2])
    return _ON_ARRAYS[op.what](*of)


def _interpolated(table: Table, intervals: list[Any], places: list[Any]) -> Any:
    """Return a table at an interval and a place of each axis that has several points."""
    y = table.values.reshape([len(table.points[i]) for i in table.live])
    corners = {bits: y[tuple(i + bit for i, bit in zip(intervals, bits, strict=True))] for bits in product((0, 1), repeat=len(places))}
    for t in places:
        corners = {bits[1:]: low + t * (corners[1, *bits[1:]] - low) for bits, low in corners.items() if not bits[0]}
    return corners[()]
