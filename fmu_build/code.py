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

The C is written from the expression graph, one line a node, in the order and with the operations of CasADi's virtual
machine, so both give the same bits as long as the compiler does not contract (``-ffp-contract=off``).  Equal nodes are
computed once; tables with an axis in common share its search.  A table that counts on one side of a choice only is looked up
where that side is taken.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from halfshaft.fmu_build.compiler import shared_library
from halfshaft.library.base.tables import Table, axis_source, clip_source, external_source, values_source
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

#: C of each operation; those in `_FLAGS` give 0 or 1.
_OPERATIONS = {
    ca.OP_ADD: "{0} + {1}", ca.OP_SUB: "{0} - {1}", ca.OP_MUL: "{0} * {1}", ca.OP_DIV: "{0} / {1}", ca.OP_NEG: "-{0}",
    ca.OP_SQ: "{0} * {0}", ca.OP_TWICE: "2. * {0}", ca.OP_INV: "1. / {0}", ca.OP_SQRT: "sqrt({0})", ca.OP_FABS: "fabs({0})",
    ca.OP_FMIN: "hs_min({0}, {1})", ca.OP_FMAX: "hs_max({0}, {1})", ca.OP_SIGN: "hs_sign({0})", ca.OP_EXP: "exp({0})",
    ca.OP_LOG: "log({0})", ca.OP_POW: "pow({0}, {1})", ca.OP_CONSTPOW: "pow({0}, {1})", ca.OP_TANH: "tanh({0})", ca.OP_SIN: "sin({0})",
    ca.OP_COS: "cos({0})", ca.OP_ATAN: "atan({0})", ca.OP_FLOOR: "floor({0})", ca.OP_CEIL: "ceil({0})", ca.OP_FMOD: "fmod({0}, {1})",
    ca.OP_IF_ELSE_ZERO: "{0} ? {1} : 0.", ca.OP_ASSIGN: "{0}",
}  # fmt: skip
_FLAGS = {
    ca.OP_LT: "{0} < {1}", ca.OP_LE: "{0} <= {1}", ca.OP_EQ: "{0} == {1}", ca.OP_NE: "{0} != {1}",
    ca.OP_NOT: "!{0}", ca.OP_AND: "{0} && {1}", ca.OP_OR: "{0} || {1}",
}  # fmt: skip
_LOGIC = (ca.OP_NOT, ca.OP_AND, ca.OP_OR)
#: A flag, 0 or 1, is its own square and no less than zero.
_KEEP_FLAG = (ca.OP_SQ, ca.OP_FMAX)
_ZERO = f"({(0.0).hex()})"
#: Names of values in the lines that are written.
_NAME = re.compile(r"\b[ct]\d+\b")
#: A choice, or a second condition that counts only where the first holds.
_CHOICE = re.compile(r"(\S+) (?:\?|&&) (\S+?)(?: : (\S+))?;")


class _Writer:
    """Writes the nodes of expressions as C; `parameters` are those from which prepared values are made."""

    def __init__(self, symbols: Mapping[str, ca.SX], tables: Mapping[str, Table], axes: dict[bytes, str]) -> None:
        self.tables, self.axes = tables, axes
        self.names = {vector[i].element_hash(): f"{name}[{i}]" for name, vector in symbols.items() for i in range(vector.numel())}
        self.known: dict[str, str] = {}
        self.prepared: list[str] = []
        self.lines: list[str] = []
        self.only_p: dict[str, bool] = {}
        self.flags: set[str] = set()
        self.negated: dict[str, str] = {}
        self.chosen: dict[str, tuple[str, str]] = {}

    def write(self, expressions: ca.SX) -> list[str]:
        """Write what the expressions need; return their names."""
        return [self._node(expressions[i]) for i in range(expressions.numel())]

    def _node(self, root: ca.SX) -> str:
        stack = [root]
        while stack:
            node = stack[-1]
            key = node.element_hash()
            if key in self.names:
                stack.pop()
                continue
            parts = [node.dep(i) for i in range(node.n_dep())]
            missing = [d for d in parts if d.element_hash() not in self.names]
            if missing:
                stack.extend(missing)
                continue
            self.names[key] = self._define(node, [self.names[d.element_hash()] for d in parts])
            stack.pop()
        return self.names[root.element_hash()]

    def _define(self, node: ca.SX, parts: list[str]) -> str:
        if node.is_constant():
            value = float(node)
            return f"({value.hex()})" if np.isfinite(value) else ("NAN" if np.isnan(value) else "HUGE_VAL" if value > 0 else "(-HUGE_VAL)")
        if node.is_output():
            return parts[0]
        if node.is_call():
            return self._call(node.which_function().name(), parts)
        op = node.op()
        if op == ca.OP_ADD:
            # A choice is the sum of two that are zero where the other counts.
            one, other = (self.chosen.get(p) for p in parts)
            if one and other and self.negated.get(other[0]) == one[0]:
                return self._line(f"{one[0]} ? {one[1]} : {other[1]}", parts)
        if op in _LOGIC:
            parts = [self._flag(p) for p in parts]
        elif op == ca.OP_IF_ELSE_ZERO:
            parts = [self._flag(parts[0]), parts[1]]
        flag = next((p for p in parts if p in self.flags), "")
        if flag and op in _KEEP_FLAG and all(p in (flag, _ZERO) for p in parts):
            return flag
        if flag and op == ca.OP_MUL:
            # A choice costs less than to make a number of the flag.
            op, parts = ca.OP_IF_ELSE_ZERO, [flag, parts[1] if parts[0] == flag else parts[0]]
        if op in _FLAGS:
            name = self._line(_FLAGS[op].format(*parts), parts, "int")
            self.flags.add(name)
            if op == ca.OP_NOT:
                self.negated[name] = parts[0]
            return name
        name = self._line(_OPERATIONS[op].format(*parts), parts)
        if op == ca.OP_IF_ELSE_ZERO:
            self.chosen[name] = (parts[0], parts[1])
        return name

    def _flag(self, name: str) -> str:
        """Return whether a value is not zero: found once, of parameters before the march."""
        if name in self.flags or name.startswith("("):
            return name
        flag = self._line(f"{name} != 0", [name], "int")
        self.flags.add(flag)
        return flag

    def _line(self, c: str, parts: Sequence[str], kind: str = "double") -> str:
        if c in self.known:
            return self.known[c]
        only_p = all(p.startswith(("p[", "(", "q")) or self.only_p.get(p, False) for p in parts)
        lines = self.prepared if only_p else self.lines
        name = f"{'c' if only_p else 't'}{len(self.known)}"
        lines.append(f"  const {kind} {name} = {c};")
        self.known[c] = name
        self.only_p[name] = only_p
        return name

    def _call(self, function: str, parts: list[str]) -> str:
        table, places = self.tables[function].reduced, []
        for i in table.live:
            points, x = table.points[i], parts[i]
            axis = self.axes[points.tobytes()]
            if table.clip:
                x = self._line(clip_source(x, points), [x])
            interval = self._line(f"{axis}_find({x})", [x], "int")
            fraction = self._line(f"({x} - {axis}_x[{interval}]) * {axis}_s[{interval}]", [x, interval])
            places += [interval, fraction]
        return self._line(f"{function}_at({''.join(f'{p}, ' for p in places)}0)", places)


def compiled_tables(named: Mapping[str, Table]) -> dict[str, ca.Function]:
    """Return tables as compiled functions, from the user's cache of libraries."""
    if not named:
        return {}
    head = '#include <math.h>\n#define casadi_int long long int\n#define TABLE_EXPORT __attribute__((visibility("default")))\n'
    source = head + "\n".join(external_source(name, t) for name, t in named.items())
    library = str(shared_library(source, "tables"))
    return {name: ca.external(name, library) for name in named}


def step_code(step: Step) -> str:
    """Return the C of a step."""
    tables = {name: t.reduced for name, t in step.tables.items()}
    points = {t.points[i].tobytes(): t.points[i] for t in tables.values() for i in t.live}
    axes = {key: f"axis_{n}" for n, key in enumerate(points)}
    x, u, p = (ca.SX.sym(name, step.function.size1_in(i)) for i, name in enumerate("xup"))
    following, outputs = step.function.call([x, u, p])
    writer = _Writer({"x": x, "u": u, "p": p}, step.tables, axes)
    next_names, output_names = writer.write(following), writer.write(outputs)
    starter = _Writer({"p": p}, step.tables, axes)
    first_names = starter.write(step.start.call([p])[0])

    lines = _guarded(_used(writer.lines, [*next_names, *output_names]), [*next_names, *output_names])
    found = set(_NAME.findall(" ".join([*lines, *next_names, *output_names])))
    kept = [name for name, only_p in writer.only_p.items() if only_p and name in found]
    unpack = [f"  const {'int' if n in writer.flags else 'double'} {n} = q[{i}];" for i, n in enumerate(kept)]
    parts = [
        _PRELUDE,
        *(axis_source(axes[key], x) for key, x in points.items()),
        *(values_source(name, t) for name, t in tables.items()),
        f"#define HS_NX {len(step.states)}\n#define HS_NU {len(step.requests)}\n#define HS_NP {len(step.parameters)}",
        f"#define HS_NQ {max(len(kept), 1)}\n#define HS_NY {len(step.outputs)}\n",
        "static void hs_start(const double *p, double *x) {", *_used(starter.prepared, first_names), *_stores("x", first_names), "}\n",
        "static int hs_prepare(const double *p, double *q) {", *_used(writer.prepared, kept), *_stores("q", kept),
        "  return hs_lost(p, HS_NP);\n}\n",
        "static void hs_step_prepared(const double *restrict x, const double *restrict u, const double *restrict p,",
        "                             const double *restrict q, double *restrict xn, double *restrict y) {",
        *_stored_at_once([*unpack, *lines], [*_stores("xn", next_names), *_stores("y", output_names)]),
        "}\n",
        "static int hs_step(const double *x, const double *u, const double *p, double *xn, double *y) {",
        "  double q[HS_NQ];",
        "  const int lost = hs_prepare(p, q) | hs_lost(x, HS_NX) | hs_lost(u, HS_NU);",
        "  hs_step_prepared(x, u, p, q, xn, y);",
        "  return lost | hs_lost(xn, HS_NX);\n}\n",
    ]  # fmt: skip
    return "\n".join(parts)


def _stores(vector: str, names: Sequence[str]) -> list[str]:
    return [f"  {vector}[{i}] = {name};" for i, name in enumerate(names)]


def _stored_at_once(lines: Sequence[str], stores: Sequence[str]) -> list[str]:
    """Return the lines with each store right behind what it stores, so that few values wait in registers."""
    waiting: dict[str, list[str]] = {}
    for store in stores:
        waiting.setdefault(store.rpartition(" = ")[2].rstrip(";"), []).append(store)
    ordered = []
    for line in lines:
        ordered += [line, *waiting.pop(line.partition(" = ")[0].rpartition(" ")[2], [])]
    return [*ordered, *(store for rest in waiting.values() for store in rest)]


def _guarded(lines: Sequence[str], names: Sequence[str]) -> list[str]:
    """Return the lines with each table that counts on one side of a choice only, and what it alone needs, in an ``if``."""
    guards: dict[str, tuple[str, ...]] = dict.fromkeys(names, ())
    for line in reversed(lines):
        left, _, value = line.partition(" = ")
        here = guards[left.rpartition(" ")[2]]
        if choice := _CHOICE.fullmatch(value):
            condition, then, otherwise = choice.groups()
            uses = [(condition, here), (then, (*here, condition)), (otherwise or "", (*here, f"!{condition}"))]
        else:
            uses = [(value, here)]
        for text, guard in uses:
            for name in _NAME.findall(text):
                guards[name] = _common(guards.get(name, guard), guard)
    waiting = {line.partition(" = ")[0].rpartition(" ")[2]: line for line in lines}
    worth = {guards[n][:i] for n, line in waiting.items() if "_find(" in line or "_at(" in line for i in range(len(guards[n]) + 1)}
    declared, written, now = list[str](), list[str](), tuple[str, ...]()
    stack = list(waiting)[::-1]
    while stack:
        name = stack.pop()
        if name not in waiting:
            continue
        left, _, value = waiting[name].partition(" = ")
        guard = next((g for i in range(len(guards[name]), 0, -1) if (g := guards[name][:i]) in worth), ())
        # What decides is written before what it decides on.
        if before := [other for other in _NAME.findall(" ".join((*guard, value))) if other in waiting]:
            stack += [name, *before]
            continue
        del waiting[name]
        shared = len(_common(now, guard))
        written += ["  }"] * (len(now) - shared) + [f"  if ({g}) {{" for g in guard[shared:]]
        now = guard
        if guard:
            declared.append(f"{left.replace('const ', '')};")
            left = f"  {name}"
        written.append(f"{left} = {value}")
    return [*declared, *written, *["  }"] * len(now)]


def _common(one: tuple[str, ...], other: tuple[str, ...]) -> tuple[str, ...]:
    """Return what two begin with."""
    n = next((i for i, (a, b) in enumerate(zip(one, other, strict=False)) if a != b), min(len(one), len(other)))
    return one[:n]


def _used(lines: Sequence[str], names: Sequence[str]) -> list[str]:
    """Return the lines that the names come from, in order."""
    wanted, kept = set(names), list[str]()
    for line in reversed(lines):
        name, _, value = line.partition(" = ")
        if name.rpartition(" ")[2] in wanted:
            wanted |= set(_NAME.findall(value))
            kept.append(line)
    return kept[::-1]


def relations_code(step: Step) -> str:
    """Return C of ``hs_relate(p, broken)``, which tells of each relation between parameters whether it is broken."""
    p = ca.SX.sym("p", len(step.parameters))
    writer = _Writer({"p": p}, {}, {})
    names = writer.write(step.broken.call([p])[0])
    head = "static void hs_relate(const double *p, int *broken) {\n  (void)p, (void)broken;"
    return "\n".join([head, *_used(writer.prepared, names), *_stores("broken", names), "}\n"])
