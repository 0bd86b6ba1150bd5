"""From a step to C that carries tangents: beside each number stand its derivatives by eight others.

It goes behind the text of `halfshaft.fmu_build.code` of the same step, gives its bits, and defines ``HS_TANGENTS``, the vector
``vt`` of so many numbers, and::

    static void hs_start_tangents(const double *p, const vt *dp, double *x, vt *dx);
    static void hs_prepare_tangents(const double *p, const vt *dp, vt *dq);
    static void hs_step_tangents(const double *x, const vt *dx, const double *u, const vt *du, const double *p, const vt *dp,
                                 const double *q, const vt *dq, double *xn, vt *dxn, double *y, vt *dy);

The derivatives are those of the operations that the step does (dual numbers), by the rules of calculus: exact to rounding.  Where an
operation has a kink, its derivative is that of the side that the step itself takes there; what jumps, such as a comparison, has none.
What no parameter moves carries no tangent: that is found out before anything is written.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import casadi as ca

from halfshaft.fmu_build.code import guarded, line, stores, stores_at_once, unpacked
from halfshaft.fmu_build.graph import Graph, Op, StepGraph, step_graph
from halfshaft.library.base.rounded import RoundedTable
from halfshaft.models.assembly import Step

#: Derivatives that are carried at once: as many as the widest registers hold.
TANGENTS = 8

_HEAD = f"""
#define HS_TANGENTS {TANGENTS}
typedef double vt __attribute__((vector_size(8 * HS_TANGENTS), aligned(8)));
#define HS_NONE ((vt){{0}})
"""

#: C of each operation's tangent: ``{0}`` and so on are what it takes, ``{d0}`` their tangents, ``{r}`` is its own value.
_C = {
    "add": "{d0} + {d1}", "sub": "{d0} - {d1}", "mul": "{d0} * {1} + {d1} * {0}", "div": "({d0} - {r} * {d1}) * (1. / {1})",
    "neg": "-{d0}", "sq": "{d0} * (2. * {0})", "twice": "2. * {d0}", "inv": "{d0} * (-{r} * {r})", "same": "{d0}",
    "sqrt": "{d0} * ({r} > 0 ? 0.5 / {r} : 0.)", "fabs": "{d0} * ({0} < 0 ? -1. : 1.)", "min": "{0} < {1} ? {d0} : {d1}",
    "max": "{0} > {1} ? {d0} : {d1}", "exp": "{d0} * {r}", "log": "{d0} * (1. / {0})", "tanh": "{d0} * (1. - {r} * {r})",
    "sin": "{d0} * cos({0})", "cos": "{d0} * -sin({0})", "atan": "{d0} * (1. / (1. + {0} * {0}))",
    "pow": "{d0} * ({1} * pow({0}, {1} - 1.)) + {d1} * ({0} > 0 ? {r} * log({0}) : 0.)", "fmod": "{d0} - {d1} * trunc({0} / {1})",
    "only": "{0} ? {d1} : HS_NONE", "choose": "{0} ? {d1} : {d2}",
    "clip": "{0} < {1} ? HS_NONE : {0} > {2} ? HS_NONE : {d0}", "place": "{d0} * {about}_s[{1}]",
}  # fmt: skip
#: Where one of two operands has no tangent.
_ALONE = {
    "add": ("{d0}", "{d1}"), "sub": ("{d0}", "-{d1}"), "mul": ("{d0} * {1}", "{d1} * {0}"),
    "div": ("{d0} * (1. / {1})", "{d1} * (-{r} / {1})"), "pow": ("{d0} * ({1} * pow({0}, {1} - 1.))", "{d1} * ({r} * log({0}))"),
    "fmod": ("{d0}", "{d1} * -trunc({0} / {1})"),
}  # fmt: skip


def tangents_code(step: Step, moved: Sequence[int] = (), still: int = 0) -> str:
    """Return the C of a step with tangents.

    Parameters
    ----------
    step
        The step.
    moved
        Positions of the requests that have tangents too.
    still
        How many of the last parameters have none.

    """
    return "\n".join(_Writer(step, step_graph(step), moved, still).text())


class _Writer:
    """Writes the operations of a step with their tangents."""

    def __init__(self, step: Step, found: StepGraph, moved: Sequence[int], still: int) -> None:
        self.found, self.graph = found, found.graph
        self.starter = Graph(step.tables)
        p = ca.SX.sym("p", len(step.parameters))
        self.starter.inputs(p=p)
        self.first = self.starter.values(step.start.call([p])[0])
        self.starting = self.starter.used(self.starter.prepared, self.first)
        fixed = step.parameter_index[step.tags.the("start speed")]
        always = {f"p[{i}]" for i in range(len(step.parameters) - still) if i != fixed} | {f"u[{i}]" for i in moved}
        start = self._moving(self.starting, always)
        # A state has a tangent if it begins with one, or if it ever gets one from those that have.
        self.moving, more = set[str](), {f"x[{i}]" for i, name in enumerate(self.first) if name in start}
        self.start_moves = start
        while more - self.moving:
            self.moving = self._moving([*found.prepared, *found.stepped], always | self.moving | more)
            more = {f"x[{i}]" for i, name in enumerate(found.following) if name in self.moving}

    def _moving(self, ops: Sequence[Op], inputs: set[str]) -> set[str]:
        """Return what has a tangent."""
        moving = set(inputs)
        for op in ops:
            numbers = op.of[1:] if op.what in ("only", "choose") else op.of[:1] if op.what in ("clip", "place") else op.of
            if op.kind == "number" and (op.what in _C or op.what in ("table", "row")) and any(name in moving for name in numbers):
                moving.add(op.name)
        return moving

    def _tangent(self, moving: set[str], graph: Graph) -> Callable[[Op], list[str]]:
        def line_of(op: Op) -> list[str]:
            return [f"  const vt d{op.name} = {self._c(op, moving, graph)};"] if op.name in moving else []

        return line_of

    def _c(self, op: Op, moving: set[str], graph: Graph) -> str:
        """Return C of the tangent of an operation."""
        tangents = [f"d{name}" if name in moving else "HS_NONE" for name in op.of]
        if op.what in ("table", "row"):
            places = 2 * (len(op.of) // 2)
            each = [f"{i}, {t}, {d}" for i, t, d in zip(op.of[:places:2], op.of[1::2], tangents[1::2], strict=True)]
            return f"{op.about}_tangent({', '.join([*each, *op.of[places:]])})"
        there = [d != "HS_NONE" for d in tangents]
        text = _ALONE[op.what][there.index(True)] if op.what in _ALONE and sum(there) == 1 else _C[op.what]
        named = {f"d{k}": d for k, d in enumerate(tangents)}
        return text.format(*op.of, r=op.name, about=op.about, **named)

    def text(self) -> list[str]:
        """Return the parts."""
        found, graph, moving = self.found, self.graph, self.moving
        read = dict.fromkeys(op.about for op in (*self.starting, *found.prepared, *found.stepped) if op.what == "table" and op.of)
        tangent = self._tangent(moving, graph)
        own = [f"  const vt d{name} = dq[{i}];" for i, name in enumerate(found.kept) if name in moving]
        lines = [*unpacked(graph, found.kept), *own, *guarded(found.stepped, graph, [*found.following, *found.outputs], tangent)]
        start = self._tangent(self.start_moves, self.starter)
        into = [*stores("xn", found.following), *stores("y", found.outputs)]
        into += [*self._tangents("dxn", found.following, moving), *self._tangents("dy", found.outputs, moving)]
        return [
            _HEAD,
            *(_table_source(name, graph) for name in read),
            "static void hs_start_tangents(const double *p, const vt *dp, double *x, vt *dx) {",
            *(text for op in self.starting for text in (line(op, self.starter), *start(op))),
            *stores("x", self.first), *self._tangents("dx", self.first, self.start_moves), "}\n",
            "static void hs_prepare_tangents(const double *p, const vt *dp, vt *dq) {",
            *(text for op in found.prepared for text in (line(op, graph), *tangent(op))), *self._tangents("dq", found.kept, moving), "}\n",
            "static void hs_step_tangents(const double *restrict x, const vt *restrict dx, const double *restrict u,",
            "                             const vt *restrict du, const double *restrict p, const vt *restrict dp,",
            "                             const double *restrict q, const vt *restrict dq, double *restrict xn,",
            "                             vt *restrict dxn, double *restrict y, vt *restrict dy) {",
            *stores_at_once(lines, into),
            "}\n",
        ]  # fmt: skip

    @staticmethod
    def _tangents(vector: str, names: Sequence[str], moving: set[str]) -> list[str]:
        """Return the lines that store tangents."""
        return [f"  {vector}[{i}] = {f'd{name}' if name in moving else 'HS_NONE'};" for i, name in enumerate(names)]


def _table_source(name: str, graph: Graph) -> str:
    """Return C of ``name_tangent(i, t, dt, ...)``: the tangent of a table at intervals and places with their tangents."""
    table = graph.tables[name]
    live, width = table.live, ["width"] if isinstance(table, RoundedTable) else []
    arguments = ", ".join([*(f"int i{i}, double t{i}, vt d{i}" for i in live), *(f"double {w}" for w in width)])
    each = " + ".join(f"g[{i}] * d{i}" for i in live)
    places = ", ".join([*(f"i{i}, t{i}" for i in live), *width])
    return f"""static inline vt {name}_tangent({arguments}) {{
  double g[{len(graph.tables[name].points)}];
  (void){name}_at({places}, g);
  return {each};
}}
"""
