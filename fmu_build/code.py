"""From a step to C: one self-contained piece of C99 (and C++), everything static, that any shell can include.

It defines ``HS_NX``, ``HS_NU``, ``HS_NP``, ``HS_NQ``, ``HS_NY`` and::

    static void hs_start(const double *p, double *x);
    static int  hs_prepare(const double *p, double *q);
    static void hs_step_prepared(const double *x, const double *u, const double *p, const double *q, double *xn, double *y);
    static int  hs_lost(const double *x, int n);
    static int  hs_step(const double *x, const double *u, const double *p, double *xn, double *y);

``q`` holds what depends on parameters only, computed once for many steps.  ``hs_prepare`` returns nonzero when a
parameter is not a number, ``hs_step`` when anything is not (minima and maxima would swallow it); who calls
``hs_step_prepared`` must look with ``hs_lost``.

The C has a line for each operation of the step (`halfshaft.fmu_build.graph`), and gives the bits of CasADi's virtual machine as
long as the compiler does not contract (``-ffp-contract=off``).  A table that counts on one side of a choice only is looked up
where that side is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

import casadi as ca

from halfshaft.fmu_build.compiler import shared_library
from halfshaft.fmu_build.graph import Graph, Op, step_graph
from halfshaft.library.base.rounded import RoundedTable, rounded_source
from halfshaft.library.base.tables import Table, axis_source, external_source, values_source
from halfshaft.models.assembly import Step

_PRELUDE = """#include <math.h>
#ifdef __cplusplus
#define restrict __restrict
#endif
static inline double hs_min(double a, double b) { return a < b ? a : b; }
static inline double hs_max(double a, double b) { return a > b ? a : b; }
static inline double hs_sign(double a) { return a < 0 ? -1 : a > 0 ? 1 : a; }
static inline int hs_lost(const double *x, int n) {
  double even = 0, odd = 0;
  for (int i = 0; i + 1 < n; i += 2) { even += x[i]; odd += x[i + 1]; }
  if (n % 2) even += x[n - 1];
  return (even + odd) * 0 != 0;
}
"""

#: C of each operation.
_C = {
    "add": "{0} + {1}", "sub": "{0} - {1}", "mul": "{0} * {1}", "div": "{0} / {1}", "neg": "-{0}", "sq": "{0} * {0}", "twice": "2. * {0}",
    "inv": "1. / {0}", "min": "hs_min({0}, {1})", "max": "hs_max({0}, {1})", "sign": "hs_sign({0})", "pow": "pow({0}, {1})",
    "fmod": "fmod({0}, {1})", "only": "{0} ? {1} : 0.", "same": "{0}", "choose": "{0} ? {1} : {2}", "true": "{0} != 0",
    "lt": "{0} < {1}", "le": "{0} <= {1}", "eq": "{0} == {1}", "ne": "{0} != {1}", "not": "!{0}", "and": "{0} && {1}", "or": "{0} || {1}",
    "clip": "{0} < {1} ? {1} : {0} > {2} ? {2} : {0}", "find": "{about}_find({0})", "place": "({0} - {about}_x[{1}]) * {about}_s[{1}]",
    "row": "p[{first} + {0}] + {1} * (p[{first} + 1 + {0}] - p[{first} + {0}])",
    **{name: f"{name}({{0}})" for name in ("sqrt", "fabs", "exp", "log", "tanh", "sin", "cos", "atan", "floor", "ceil")},
}  # fmt: skip
#: What takes its first value as a condition on the others; the second one of two flags counts only where the first holds.
_CHOICES = ("only", "choose", "and")
_TYPES = {"number": "double", "flag": "int", "interval": "int"}


def compiled_tables(named: Mapping[str, Table]) -> dict[str, ca.Function]:
    """Return tables as compiled functions, from the user's cache of libraries."""
    if not named:
        return {}
    head = '#include <math.h>\n#define casadi_int long long int\n#define TABLE_EXPORT __attribute__((visibility("default")))\n'
    source = head + "\n".join(external_source(name, t) for name, t in named.items())
    library = str(shared_library(source, "tables"))
    return {name: ca.external(name, library) for name in named}


def step_code(step: Step, rows: Mapping[str, int] | None = None) -> str:
    """Return the C of a step; `rows` are tables whose values stand among the parameters, with the position of the first."""
    graph, prepared, stepped, following, outputs, kept = step_graph(step, rows)
    starter = Graph(step.tables, rows or {})
    p = ca.SX.sym("p", len(step.parameters))
    starter.inputs(p=p)
    first = starter.values(step.start.call([p])[0])
    lines = [*unpacked(graph, kept), *guarded(stepped, graph, [*following, *outputs])]
    n_rows = sum(len(graph.tables[name].values) for name in graph.rows)
    parts = [
        _PRELUDE,
        *(axis_source(name, points) for name, points in graph.axes.items()),
        *(_table_source(name, t) for name, t in graph.tables.items() if name not in graph.rows),
        f"#define HS_NX {len(step.states)}\n#define HS_NU {len(step.requests)}\n#define HS_NP {len(step.parameters) + n_rows}",
        f"#define HS_NQ {max(len(kept), 1)}\n#define HS_NY {len(step.outputs)}\n",
        "static void hs_start(const double *p, double *x) {", *_lines(starter, first), *stores("x", first), "}\n",
        "static int hs_prepare(const double *p, double *q) {", *(line(op, graph) for op in prepared), *stores("q", kept),
        "  return hs_lost(p, HS_NP);\n}\n",
        "static void hs_step_prepared(const double *restrict x, const double *restrict u, const double *restrict p,",
        "                             const double *restrict q, double *restrict xn, double *restrict y) {",
        *stores_at_once(lines, [*stores("xn", following), *stores("y", outputs)]),
        "}\n",
        "static int hs_step(const double *x, const double *u, const double *p, double *xn, double *y) {",
        "  double q[HS_NQ];",
        "  const int lost = hs_prepare(p, q) | hs_lost(x, HS_NX) | hs_lost(u, HS_NU);",
        "  hs_step_prepared(x, u, p, q, xn, y);",
        "  return lost | hs_lost(xn, HS_NX);\n}\n",
    ]  # fmt: skip
    return "\n".join(parts)


def _table_source(name: str, table: Table) -> str:
    return rounded_source(name, table) if isinstance(table, RoundedTable) else values_source(name, table)


def relations_code(step: Step) -> str:
    """Return C of ``hs_relate(p, broken)``, which tells of each relation between parameters whether it is broken."""
    p = ca.SX.sym("p", len(step.parameters))
    graph = Graph({})
    graph.inputs(p=p)
    names = graph.values(step.broken.call([p])[0])
    head = "static void hs_relate(const double *p, int *broken) {\n  (void)p, (void)broken;"
    return "\n".join([head, *_lines(graph, names), *stores("broken", names), "}\n"])


def _lines(graph: Graph, names: Sequence[str]) -> list[str]:
    """Return the lines that give prepared values."""
    return [line(op, graph) for op in graph.used(graph.prepared, names)]


def unpacked(graph: Graph, kept: Sequence[str]) -> list[str]:
    """Return the lines that read what is prepared."""
    return [f"  const {_TYPES[graph.kind(name)]} {name} = q[{i}];" for i, name in enumerate(kept)]


def guarded(ops: Sequence[Op], graph: Graph, names: Sequence[str], beside: Callable[[Op], Iterable[str]] = lambda _: ()) -> list[str]:
    """Return the lines with each table that counts on one side of a choice only, and what it alone needs, in an ``if``.

    Behind the line of an operation stand those that `beside` gives for it; each defines a constant.
    """
    guards: dict[str, tuple[str, ...]] = dict.fromkeys(names, ())
    for op in reversed(ops):
        here = guards[op.name]
        sides = [here] * len(op.of)
        if op.what in _CHOICES:
            # The condition; what counts where it holds; what counts where it does not.
            sides = [here, (*here, op.of[0]), (*here, f"!{op.of[0]}")]
        for name, guard in zip(op.of, sides, strict=False):
            guards[name] = _common(guards.get(name, guard), guard)
    waiting = {op.name: op for op in ops}
    looked_up = [guards[op.name] for op in ops if op.what in ("find", "table", "row")]
    worth = {guard[:i] for guard in looked_up for i in range(len(guard) + 1)}
    declared, written, now = list[str](), list[str](), tuple[str, ...]()
    stack = list(waiting)[::-1]
    while stack:
        name = stack.pop()
        if name not in waiting:
            continue
        op = waiting[name]
        guard = next((g for i in range(len(guards[name]), 0, -1) if (g := guards[name][:i]) in worth), ())
        # What decides is written before what it decides on.
        if before := [other for other in (*(g.lstrip("!") for g in guard), *op.of) if other in waiting]:
            stack += [name, *before]
            continue
        del waiting[name]
        shared = len(_common(now, guard))
        written += ["  }"] * (len(now) - shared) + [f"  if ({g}) {{" for g in guard[shared:]]
        now = guard
        for text in (line(op, graph), *beside(op)):
            if guard:
                kind, _, rest = text.removeprefix("  const ").partition(" ")
                declared.append(f"  {kind} {rest.partition(' = ')[0]};")
                text = f"    {rest}"
            written.append(text)
    return [*declared, *written, *["  }"] * len(now)]


def _common(one: tuple[str, ...], other: tuple[str, ...]) -> tuple[str, ...]:
    """Return what two begin with."""
    n = next((i for i, (a, b) in enumerate(zip(one, other, strict=False)) if a != b), min(len(one), len(other)))
    return one[:n]


def line(op: Op, graph: Graph) -> str:
    """Return the line of an operation."""
    if op.what == "table":
        c = f"{op.about}_at({''.join(f'{name}, ' for name in op.of)}0)"
    else:
        c = _C[op.what].format(*op.of, about=op.about, first=graph.rows.get(op.about, 0))
    return f"  const {_TYPES[op.kind]} {op.name} = {c};"


def stores(vector: str, names: Sequence[str]) -> list[str]:
    """Return the lines that store values."""
    return [f"  {vector}[{i}] = {name};" for i, name in enumerate(names)]


def stores_at_once(lines: Sequence[str], stores: Sequence[str]) -> list[str]:
    """Return the lines with each store right behind what it stores, so that few values wait in registers."""
    waiting: dict[str, list[str]] = {}
    for store in stores:
        waiting.setdefault(store.rpartition(" = ")[2].rstrip(";"), []).append(store)
    ordered = []
    for line in lines:
        ordered += [line, *waiting.pop(line.partition(" = ")[0].rpartition(" ")[2], [])]
    return [*ordered, *(store for rest in waiting.values() for store in rest)]
