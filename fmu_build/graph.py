"""A step as a list of operations: what every writer of code prints.

The list follows the expression graph, one operation a node, in the order and with the operations of CasADi's virtual
machine.  Equal operations are done once; tables with an axis in common share its search.  An operation has one of two
stages: what needs parameters only is *prepared*, once for many steps.

Names of values are ``x[i]``, ``u[i]``, ``p[i]`` for inputs, ``(...)`` for constants as C writes them, ``c1`` for what is
prepared, and ``t1`` for the rest.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, TypeAlias

import casadi as ca
import numpy as np
import numpy.typing as npt

from halfshaft.library.base.rounded import RoundedTable
from halfshaft.library.base.tables import Table
from halfshaft.models.assembly import Step

#: Operations of CasADi, those on numbers and those that give a flag: 0 or 1.
_NUMBERS = {
    ca.OP_ADD: "add", ca.OP_SUB: "sub", ca.OP_MUL: "mul", ca.OP_DIV: "div", ca.OP_NEG: "neg", ca.OP_SQ: "sq", ca.OP_TWICE: "twice",
    ca.OP_INV: "inv", ca.OP_SQRT: "sqrt", ca.OP_FABS: "fabs", ca.OP_FMIN: "min", ca.OP_FMAX: "max", ca.OP_SIGN: "sign", ca.OP_EXP: "exp",
    ca.OP_LOG: "log", ca.OP_POW: "pow", ca.OP_CONSTPOW: "pow", ca.OP_TANH: "tanh", ca.OP_SIN: "sin", ca.OP_COS: "cos",
    ca.OP_ATAN: "atan", ca.OP_FLOOR: "floor", ca.OP_CEIL: "ceil", ca.OP_FMOD: "fmod", ca.OP_IF_ELSE_ZERO: "only", ca.OP_ASSIGN: "same",
}  # fmt: skip
_FLAGS = {
    ca.OP_LT: "lt", ca.OP_LE: "le", ca.OP_EQ: "eq", ca.OP_NE: "ne", ca.OP_NOT: "not", ca.OP_AND: "and", ca.OP_OR: "or",
}  # fmt: skip
_LOGIC = ("not", "and", "or")
#: A flag is its own square and no less than zero.
_KEEP_FLAG = ("sq", "max")
ZERO = f"({(0.0).hex()})"


#: What a value is: a flag is 0 or 1, an interval a position on an axis.
Kind: TypeAlias = Literal["number", "flag", "interval"]


class Op(NamedTuple):
    """One operation: the name of its value, what it does, the names of what it takes, and the axis or table that it reads.

    Besides those above, ``true`` tells whether a number is not zero, ``choose`` takes one of two by a flag, ``clip`` moves a number
    between two ends, ``find`` gives the interval of an axis in which a number lies, ``place`` where in it, and ``table`` reads a
    table at intervals and places, and a rounded one with a width behind them; ``row`` reads one over an axis whose values are
    parameters, from the named one on.
    """

    name: str
    what: str
    of: tuple[str, ...]
    about: str = ""

    @property
    def kind(self) -> Kind:
        """What its value is."""
        return "flag" if self.what in _FLAGS.values() or self.what == "true" else "interval" if self.what == "find" else "number"


@dataclass
class Graph:
    """Operations that give the values of expressions.

    Parameters
    ----------
    tables
        Those that the expressions call, by the names of their functions.
    rows
        Those of them whose values are parameters, and the position of the first of these.

    """

    tables: Mapping[str, Table]
    rows: Mapping[str, int] = field(default_factory=dict)
    prepared: list[Op] = field(default_factory=list)
    stepped: list[Op] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Name the axes."""
        self.tables = {name: t if name in self.rows else t.reduced for name, t in self.tables.items()}
        points = {t.points[i].tobytes(): t.points[i] for t in self.tables.values() for i in t.live}
        self._axes = {key: f"axis_{n}" for n, key in enumerate(points)}
        #: Points of each axis.
        self.axes: dict[str, npt.NDArray[np.float64]] = {self._axes[key]: x for key, x in points.items()}
        self._names: dict[int, str] = {}
        self._known: dict[tuple[object, ...], Op] = {}
        self._by_name: dict[str, Op] = {}

    def inputs(self, **vectors: ca.SX) -> None:
        """Say which symbols are inputs."""
        self._names |= {vector[i].element_hash(): f"{name}[{i}]" for name, vector in vectors.items() for i in range(vector.numel())}

    def values(self, expressions: ca.SX) -> list[str]:
        """Add what the expressions need; return their names."""
        return [self._node(expressions[i]) for i in range(expressions.numel())]

    def kind(self, name: str) -> Kind:
        """Return what a value is."""
        return self._by_name[name].kind if name in self._by_name else "number"

    def used(self, ops: Sequence[Op], names: Iterable[str]) -> list[Op]:
        """Return the operations that values come from, in order."""
        wanted, kept = set(names), list[Op]()
        for op in reversed(ops):
            if op.name in wanted:
                wanted.update(op.of)
                kept.append(op)
        return kept[::-1]

    def _node(self, root: ca.SX) -> str:
        stack = [root]
        while stack:
            node = stack[-1]
            key = node.element_hash()
            if key in self._names:
                stack.pop()
                continue
            parts = [node.dep(i) for i in range(node.n_dep())]
            missing = [d for d in parts if d.element_hash() not in self._names]
            if missing:
                stack.extend(missing)
                continue
            self._names[key] = self._define(node, [self._names[d.element_hash()] for d in parts])
            stack.pop()
        return self._names[root.element_hash()]

    def _define(self, node: ca.SX, parts: list[str]) -> str:
        if node.is_constant():
            return constant(float(node))
        if node.is_output():
            return parts[0]
        if node.is_call():
            return self._call(node.which_function().name(), parts)
        what = _NUMBERS.get(node.op()) or _FLAGS[node.op()]
        if what == "add":
            # A choice is the sum of two that are zero where the other counts.
            one, other = (self._by_name.get(p) for p in parts)
            if one and other and one.what == other.what == "only":
                condition = self._by_name.get(other.of[0])
                if condition and condition.what == "not" and condition.of[0] == one.of[0]:
                    return self._add("choose", one.of[0], one.of[1], other.of[1])
        if what in _LOGIC:
            parts = [self._flag(p) for p in parts]
        elif what == "only":
            parts = [self._flag(parts[0]), parts[1]]
        flag = next((p for p in parts if self.kind(p) == "flag"), "")
        if flag and what in _KEEP_FLAG and all(p in (flag, ZERO) for p in parts):
            return flag
        if flag and what == "mul":
            # A choice costs less than to make a number of the flag.
            what, parts = "only", [flag, parts[1] if parts[0] == flag else parts[0]]
        return self._add(what, *parts)

    def _flag(self, name: str) -> str:
        """Return whether a value is not zero: found once, of parameters before the march."""
        return name if self.kind(name) == "flag" or name.startswith("(") else self._add("true", name)

    def _add(self, what: str, *of: str, about: str = "") -> str:
        key = (what, of, about)
        if key not in self._known:
            only_p = all(name.startswith(("p[", "(", "c")) for name in of)
            op = Op(f"{'c' if only_p else 't'}{len(self._known)}", what, of, about)
            (self.prepared if only_p else self.stepped).append(op)
            self._known[key] = self._by_name[op.name] = op
        return self._known[key].name

    def _call(self, function: str, parts: list[str]) -> str:
        table, places = self.tables[function], list[str]()
        for i in table.live:
            points, x = table.points[i], parts[i]
            axis = self._axes[points.tobytes()]
            if table.clip:
                x = self._add("clip", x, constant(points[0]), constant(points[-1]))
            interval = self._add("find", x, about=axis)
            places += [interval, self._add("place", x, interval, about=axis)]
        if isinstance(table, RoundedTable):
            places.append(parts[-1])
        return self._add("row", *places, about=function) if function in self.rows else self._add("table", *places, about=function)


def constant(value: float) -> str:
    """Return a number as C writes it, in brackets."""
    return f"({float(value).hex()})" if np.isfinite(value) else "(NAN)" if np.isnan(value) else "(HUGE_VAL)" if value > 0 else "(-HUGE_VAL)"


class StepGraph(NamedTuple):
    """The operations of a step: those that prepare it, those of a step, and what they give.

    ``kept`` are the values that are prepared for the step.
    """

    graph: Graph
    prepared: list[Op]
    stepped: list[Op]
    following: list[str]
    outputs: list[str]
    kept: list[str]


def step_graph(step: Step, rows: Mapping[str, int] | None = None) -> StepGraph:
    """Return the operations of a step; `rows` as for `Graph`."""
    graph = Graph(step.tables, rows or {})
    x, u, p = (ca.SX.sym(name, step.function.size1_in(i)) for i, name in enumerate("xup"))
    graph.inputs(x=x, u=u, p=p)
    following, outputs = (graph.values(values) for values in step.function.call([x, u, p]))
    stepped = graph.used(graph.stepped, [*following, *outputs])
    found = {name for op in stepped for name in op.of} | {*following, *outputs}
    kept = [op.name for op in graph.prepared if op.name in found]
    return StepGraph(graph, graph.used(graph.prepared, kept), stepped, following, outputs, kept)
