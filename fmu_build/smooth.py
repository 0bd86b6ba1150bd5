"""The smooth form of a step: what a gradient-based solver drives in its place.

`smooth_step` makes a step of a step, so that everything that takes a step (writers of code, the march, tangents) takes the smooth one
too.  Every kink is rounded, by a *width* that is one more parameter, without unit; as it goes to zero, so does the difference from the
exact step:

* maxima, minima, sizes and cuts are rounded over ``w`` on both sides of their kink: the width times the *scale* of that operation, a
  parameter as well, which tells how large its two sides usually are;
* tables are rounded at their points; the kernel of both is in `halfshaft.library.base.rounded`;
* a comparison is a number from 0 to 1, the *weight* of one side of a choice.  It is *given* for each step, a further request, or
  follows from its two sides, passing from 0 to 1 over ``w``; a parameter says which.  So decisions can be those of an exact run while
  what is continuous stays free.

Away from the kinks the smooth step is the exact one.  Only minima, maxima, sums, products and quotients come in: the code is as quick as
the exact one's, and has the same bits everywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import casadi as ca

from halfshaft.fmu_build.evaluate import number
from halfshaft.fmu_build.graph import Op, StepGraph, step_graph
from halfshaft.library.base.rounded import RoundedTable, ramp, weight
from halfshaft.models.assembly import Description, Step

COMPARISONS = ("lt", "le", "eq", "ne", "true")
#: What is rounded on a scale of its own.
ROUNDINGS = ("min", "max", "fabs", "sign", *COMPARISONS)


@dataclass(frozen=True)
class SmoothStep:
    """A smooth step, and what its further parameters and requests belong to."""

    step: Step
    exact: StepGraph
    #: Operations of the exact step with a scale; comparisons among them that can be given.
    rounded: tuple[Op, ...]
    compared: tuple[Op, ...]


def smooth_step(step: Step) -> SmoothStep:
    """Return the smooth form of a step.

    Its parameters are those of the step, the width, the scales, and for each comparison whether it is given and by how much of ``w``
    its threshold is moved; its requests are those of the step, and the weights that are given.
    """
    exact = step_graph(step)
    prepared = {op.name for op in exact.prepared}
    # What follows from parameters alone selects a variant: no number of a run moves it.
    rounded = tuple(
        op for op in (*exact.prepared, *exact.stepped) if op.what in ROUNDINGS and not (op.name in prepared and op.what in COMPARISONS)
    )
    compared = tuple(op for op in rounded if op.what in COMPARISONS)
    described = [Description("width", "1", "width of the rounding", start=1e-3, lowest=0.0)]
    described += [Description(f"scale.{op.name}", "", f"scale of the rounding of {op.what}", start=1.0, lowest=0.0) for op in rounded]
    described += [Description(f"given.{op.name}", "1", "whether the comparison is given", "flag", 1.0) for op in compared]
    described += [
        Description(f"offset.{op.name}", "1", "shift of its threshold; of two sides that are equal, whether it is rounded", start=0.0)
        for op in compared
    ]
    asked = [Description(f"weight.{op.name}", "1", "weight of the comparison", "real", 0.0, 0.0, 1.0) for op in compared]

    state, request, parameters = (ca.SX.sym(name, step.function.size1_in(i)) for i, name in enumerate(("x", "u", "p")))
    more = {d.name: ca.SX.sym(d.name) for d in described}
    given = {d.name: ca.SX.sym(d.name) for d in asked}
    tables = {f"{name}_rounded": RoundedTable.from_table(t) for name, t in step.tables.items()}
    tables = {name: replace(t, name=name) for name, t in tables.items()}
    width = more["width"]
    calls = {name: tables[f"{name}_rounded"].interpolant for name in step.tables}
    known = {f"{name}[{i}]": x[i] for name, x in (("x", state), ("u", request), ("p", parameters)) for i in range(x.numel())}
    rounding = Rounding(
        width, {op.name: more[f"scale.{op.name}"] for op in rounded},
        {op.name: (more[f"given.{op.name}"], given[f"weight.{op.name}"], more[f"offset.{op.name}"]) for op in compared},
        lambda name, x: calls[name](ca.vertcat(*x, width)),
    )  # fmt: skip
    found = smooth_values(exact, known, [*exact.following, *exact.outputs], rounding)
    results = [ca.vertcat(*values) for values in (found[: len(exact.following)], found[len(exact.following) :])]
    function = ca.Function(
        f"{step.function.name()}_smooth",
        [state, ca.vertcat(request, *given.values()), ca.vertcat(parameters, *more.values())],
        results,
    )
    p = ca.SX.sym("p", step.function.size1_in(2) + len(more))
    own = p[: step.function.size1_in(2)]
    smooth = replace(
        step,
        name=f"{step.name}_smooth",
        function=function,
        start=ca.Function(step.start.name(), [p], step.start.call([own]), ["parameters"], ["state"]),
        broken=ca.Function(step.broken.name(), [p], step.broken.call([own]), ["parameters"], ["broken"]),
        requests=(*step.requests, *asked),
        parameters=(*step.parameters, *described),
        tables={**step.tables, **tables},
        decisions=(),
    )
    return SmoothStep(smooth, exact, rounded, compared)


class Rounding(NamedTuple):
    """How operations of an exact step are rounded, each by its name: as numbers or symbols.

    `weights` tell of a comparison whether it is given, its weight then, and its offset; `table` reads a table at its variables.
    """

    width: Any
    scales: Mapping[str, Any]
    weights: Mapping[str, tuple[Any, Any, Any]]
    table: Callable[[str, list[Any]], Any]


def smooth_values(found: StepGraph, known: Mapping[str, Any], wanted: Sequence[str], rounding: Rounding) -> list[Any]:
    """Return values of a step in the smooth form, from others that are known by their names in the exact step."""
    smooth, needed, ops = _Smooth(found, rounding, dict(known)), set(wanted), list[Op]()
    for op in reversed([*found.graph.prepared, *found.stepped]):
        if op.name in needed and op.name not in known:
            needed.update(op.of)
            ops.append(op)
    for op in reversed(ops):
        if op.what not in ("find", "place"):
            smooth.values[op.name] = smooth.value(op)
    return [smooth.of(name) for name in wanted]


class _Smooth:
    """Values of operations in the smooth form."""

    def __init__(self, found: StepGraph, rounding: Rounding, values: dict[str, Any]) -> None:
        self.graph, self.values = found.graph, values
        self.width, self.scales, self.weights, self.table = rounding
        self.ops = {op.name: op for op in (*found.graph.prepared, *found.stepped)}
        self.flags = _flags(found)
        #: What is never finite, such as the room of a brake without a limit.
        self.endless = dict[str, bool]()

    def of(self, name: str) -> Any:
        return ca.SX(number(name)) if name.startswith("(") else self.values[name]

    def value(self, op: Op) -> Any:
        if op.what == "table":
            return self._table(op)
        of = [self.of(name) for name in op.of]
        if op.what in COMPARISONS:
            return self._compared(op, *of)
        if op.what == "clip":
            return self._cut(op, *of)
        endless = [self._endless(name) for name in op.of]
        if any(endless):
            if op.what in ("min", "max"):
                # The other side is the one that counts; of two, either.
                return of[endless.index(True) - 1]
            self.endless[op.name] = True
        if op.what in ("min", "max", "fabs", "sign"):
            if op.of[0].startswith("("):
                # A constant stays exact, however small beside what it cuts.
                of.reverse()
            w = self.width * self.scales[op.name]
            return _ROUND[op.what](*of, w)
        return _SMOOTH[op.what](*of)

    def _endless(self, name: str) -> bool:
        return abs(number(name)) == float("inf") if name.startswith("(") else self.endless.get(name, False)

    def _compared(self, op: Op, *of: Any) -> Any:
        if op.name not in self.weights:
            return _EXACT[op.what](*of)
        given, taken, offset = self.weights[op.name]
        if op.what == "true" and op.of[0] in self.flags:
            own = of[0]
        elif op.what == "true":
            own = _EXACT[op.what](*of)
        else:
            w, d = self.width * self.scales[op.name], of[1] - of[0]
            if op.what in ("lt", "le"):
                own = weight(d + offset * w, w)
            else:
                peak = weight(2 * w - ca.fabs(d), w)
                own = offset * (peak if op.what == "eq" else 1 - peak) + (1 - offset) * _EXACT[op.what](*of)
        return given * taken + (1 - given) * own

    def _cut(self, op: Op, x: Any, low: Any, high: Any) -> Any:
        """Return a variable cut to the ends of an axis; an end is as round as the axis' other kinks."""
        axis = next(a for a in self.graph.axes.values() if a[0] == float(low) and a[-1] == float(high))
        first, last = (float(axis[k] - axis[k - 1]) / 2 for k in (1, -1))
        return _low(_high(x, low, self.width * first), high, self.width * last)

    def _table(self, op: Op) -> Any:
        """Return a table at its variables, those of constant axes aside."""
        table = self.graph.tables[op.about]
        x = [ca.SX(float(points[0])) for points in table.points]
        for i, interval in zip(table.live, op.of[::2], strict=True):
            x[i] = self.of(self.ops[interval].of[0])
        return self.table(op.about, x)


def _flags(found: StepGraph) -> set[str]:
    """Return the names of numbers that are flags, or products of them: in the smooth form these are weights."""
    flags = {"u[2]", "u[4]"} | {f"x[{i}]" for i in range(len(found.following))}
    ops = (*found.graph.prepared, *found.stepped)
    while True:
        known = set(flags)
        for op in ops:
            numbers = [name for name in op.of if not name.startswith("(") or number(name) not in (0, 1)]
            if op.kind == "flag" or (op.what in ("mul", "only", "choose", "min", "max", "sq", "same") and all(n in known for n in numbers)):
                known.add(op.name)
        own = {f"x[{i}]" for i, name in enumerate(found.following) if name not in known}
        if not own & flags:
            return known
        flags -= own


def _sign(x: Any, w: Any) -> Any:
    return 2 * weight(x, w) - 1


def _size(x: Any, w: Any) -> Any:
    return x * _sign(x, w)


def _high(a: Any, b: Any, w: Any) -> Any:
    return b + ramp(a - b, w)


def _low(a: Any, b: Any, w: Any) -> Any:
    return b - ramp(b - a, w)


_ROUND: dict[str, Callable[..., Any]] = {"min": _low, "max": _high, "fabs": _size, "sign": _sign}
_SMOOTH: dict[str, Callable[..., Any]] = {
    "add": lambda a, b: a + b, "sub": lambda a, b: a - b, "mul": lambda a, b: a * b, "div": lambda a, b: a / b, "neg": lambda a: -a,
    "sq": lambda a: a**2, "twice": lambda a: 2 * a, "inv": lambda a: 1 / a, "pow": lambda a, b: a**b, "same": lambda a: a,
    "only": lambda c, a: c * a, "choose": lambda c, a, b: c * a + (1 - c) * b, "not": lambda a: 1 - a, "and": lambda a, b: a * b,
    "or": lambda a, b: a + b - a * b, "sqrt": ca.sqrt, "exp": ca.exp, "log": ca.log, "tanh": ca.tanh, "sin": ca.sin, "cos": ca.cos,
    "atan": ca.atan, "floor": ca.floor, "ceil": ca.ceil, "fmod": ca.fmod,
}  # fmt: skip
_EXACT: dict[str, Callable[..., Any]] = {
    "lt": lambda a, b: a < b, "le": lambda a, b: a <= b, "eq": lambda a, b: a == b, "ne": lambda a, b: a != b, "true": lambda a: a != 0,
}  # fmt: skip
