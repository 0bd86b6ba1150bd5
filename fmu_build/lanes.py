"""From a step to C for many vehicles in lockstep: each operation is done for blocks of lanes, a vehicle a lane.

It defines ``HS_BLOCKS``, ``HS_LANES`` and ``HS_NL``, and::

    static void hs_prepare_lane(const double *p, double *q);
    static void hs_prepare_cycle(const double *u, double *w);
    static void hs_step_lanes(const double *x, const double *u, const double *w, const double *q, double *xn, double *y);

Vectors lie by value, block and lane.  ``q`` has ``HS_NL`` values: what is prepared for a step, and the parameters that the
step itself reads; `hs_prepare_lane` writes them for one lane, ``HS_LANES`` numbers apart.  ``w`` has ``HS_NW`` values that follow from
the request alone: they are found once where all lanes drive the same cycle.  The text goes behind that of
`halfshaft.fmu_build.code` of the same step, and gives its bits, lane by lane.

Both sides of a choice are computed, and one is taken.  Tables are read by permutes of registers where an axis has at most 32
intervals; of two axes, as rows of four that hold what one cell needs.  Three blocks at a time keep the processor busy while
one waits, and what is urgent goes first.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from importlib.resources import files
from math import frexp
from pathlib import Path
from typing import Any

import numpy as np

from halfshaft.fmu_build.code import line
from halfshaft.fmu_build.graph import Op, StepGraph, step_graph
from halfshaft.library.base.tables import Table
from halfshaft.models.assembly import Step

BLOCKS = 3
#: Flags for the compiler by the width of vectors, the widest first, and what the processor must have for it.
WIDTHS = {
    "avx512": (("-mavx512f", "-mavx512dq", "-mavx512vl", "-mprefer-vector-width=512"), {"avx512f", "avx512dq", "avx512vl"}),
    "avx2": (("-mavx2",), {"avx2"}),
}
#: Entries of tables that permutes of registers read.
SIZES = (8, 16, 32)

#: C of each operation; those that are not here are functions ``v_...`` of numbers, or of flags.
_C = {
    "add": "{0} + {1}", "sub": "{0} - {1}", "mul": "{0} * {1}", "neg": "-{0}", "sq": "{0} * {0}",
    "twice": "v_set(2) * {0}", "inv": "v_set(1) / {0}", "same": "{0}", "true": "v_ne({0}, v_set(0))",
}  # fmt: skip
#: How many of the first operands of an operation are flags, where any are.
_FLAGS = {"not": 1, "and": 2, "or": 2, "only": 1, "choose": 1}

#: About how many cycles an operation takes until its value is there, where it is not four.
_CYCLES = {
    "div": 24, "inv": 24, "sqrt": 32, "find": 25, "table": 14, "row": 40, "place": 11, "clip": 8, "sign": 9, "choose": 2, "only": 2,
    "and": 1, "or": 1, "not": 1,
}  # fmt: skip
_TYPES = {"number": "vd", "flag": "vm", "interval": "vi"}

_HEAD = """
#include "lanes.h"
#define HS_BLOCKS {blocks}
#define HS_LANES (HS_BLOCKS * W)
#define HS_NL {kept}
#define HS_NW {of_cycle}
"""


@cache
def widths() -> tuple[str, ...]:
    """Return the widths of vectors that this machine's processor has, the widest first; Linux alone tells."""
    try:
        flags = re.search(r"^flags\s*:(.*)$", Path("/proc/cpuinfo").read_text(), re.MULTILINE)
    except OSError:
        return ()
    own = set(flags[1].split()) if flags else set()
    return tuple(name for name, (_, needed) in WIDTHS.items() if needed <= own)


def lanes_header() -> dict[str, str]:
    """Return what the C of a step in lanes includes."""
    return {"lanes.h": files("halfshaft.fmu_build").joinpath("c", "lanes.h").read_text(encoding="utf-8")}


def lanes_code(step: Step, rows: Mapping[str, int] | None = None, *, halved: bool = False, blocks: int = BLOCKS) -> str:
    """Return the C of a step in lanes.

    Parameters
    ----------
    step, rows
        As for `step_code`, behind whose text it goes.
    halved
        Whether all steps last a second, a half, a quarter and so on: then a product with the inverse is the quotient.
    blocks
        How many vectors are worked on together.

    """
    return "\n".join(_Writer(step, step_graph(step, rows), halved, blocks).text())


class _Writer:
    """Writes the operations of a step."""

    def __init__(self, step: Step, found: StepGraph, halved: bool, blocks: int) -> None:
        self.found, self.graph, self.halved, self.blocks = found, found.graph, halved, blocks
        followed = set[str]()
        for op in found.stepped:
            if all(name.startswith(("u[", "(")) or name in followed for name in op.of):
                followed.add(op.name)
        #: What follows from the request alone, and all else.
        self.cycle = [op for op in found.stepped if op.name in followed]
        self.ops = _urgent_first([op for op in found.stepped if op.name not in followed])
        names = dict.fromkeys((*(name for op in self.ops for name in op.of), *found.following, *found.outputs))
        divisors = Counter(op.of[1] for op in self.ops if op.what == "div")
        self.length = f"u[{[d.name for d in step.requests].index('dt')}]"
        # The inverse is found of divisors that are known before, and of those of several quotients.
        self.divisors = {name for name, n in divisors.items() if n > 2 and name.startswith("t") and name not in followed}
        #: What follows from the request and is read; and what a lane keeps: prepared values, parameters, and rows of them.
        self.of_cycle = [name for name in names if name in followed]
        self.of_cycle += [f"1/{name}" for name in divisors if name in followed or name.startswith("u[")]
        self.kept = [name for name in names if name.startswith(("c", "p["))]
        self.kept += [f"1/{name}" for name in self.kept if name in divisors]
        self.rows: dict[str, int] = {}
        for name, first in self.graph.rows.items():
            self.rows[name] = len(self.kept)
            self.kept += [f"p[{first + i}]" for i in range(len(self.graph.tables[name].values))]
        kept = {name: ("q", i) for i, name in reversed([*enumerate(self.kept)])}
        self.place = kept | {name: ("w", i) for i, name in enumerate(self.of_cycle)}
        self.quotients: dict[tuple[str, str], int] = {}
        self.lines: list[str] = []
        self.loaded: set[str] = set()
        self.stores: dict[str, list[tuple[str, int]]] = {}
        for vector, values in (("xn", found.following), ("y", found.outputs)):
            for i, name in enumerate(values):
                self.stores.setdefault(name, []).append((vector, i))

    def text(self) -> Iterator[str]:
        """Yield the parts."""
        for op in self.ops:
            self._write(op)
        for name in list(self.stores):
            self._store(name)
        yield _HEAD.format(blocks=self.blocks, kept=max(len(self.kept), 1), of_cycle=max(len(self.of_cycle), 1))
        axes, tables = (dict.fromkeys(op.about for op in self.ops if op.what in kinds) for kinds in (("find", "place"), ("table",)))
        yield from (axis_source(name, self.graph.axes[name]) for name in axes)
        yield from (self._table_source(name, self.graph.tables[name]) for name in tables)
        yield "static int hs_prepare_lane(const double *p, double *q) {"
        yield "  double prepared[HS_NQ];\n  const int lost = hs_prepare(p, prepared);"
        yield from (f"  q[{i} * HS_LANES] = {self._prepared(name)};" for i, name in enumerate(self.kept))
        yield "  return lost;\n}\n"
        yield "static void hs_prepare_cycle(const double *u, double *w) {"
        yield from (line(op, self.graph) for op in self.cycle)
        for i, name in enumerate(self.of_cycle):
            yield f"  w[{i}] = {f'hs_inverse({name[2:]})' if name.startswith('1/') else name};"
        yield "}\n"
        yield "V void hs_step_lanes(const double *restrict x, const double *restrict u, const double *restrict w, const double *restrict q,"
        yield "                                 double *restrict xn, double *restrict y) {"
        yield from self.lines
        yield "}\n"

    def _prepared(self, name: str) -> str:
        """Return C of what a lane keeps."""
        if name.startswith("1/"):
            return f"hs_inverse({self._prepared(name[2:])})"
        return name if name.startswith("p[") else f"prepared[{self.found.kept.index(name)}]"

    def _write(self, op: Op) -> None:
        for block in range(self.blocks):
            self.lines.append(f"  const {_TYPES[op.kind]} {op.name}_{block} = {self._c(op, block)};")
            if op.name in self.divisors:
                name = f"{op.name}_{block}"
                self.lines.append(f"  vm s{name};\n  const vd r{name} = v_inverse({name}, &s{name});")
        self._store(op.name)

    def _c(self, op: Op, block: int) -> str:
        n_flags = _FLAGS.get(op.what, 0)
        if op.what == "find":
            return find(op.about, self.graph.axes[op.about], self._number(op.of[0], block))
        if op.what == "place":
            axis, i = f"{op.about}_v", self._value(op.of[1], block)
            x, n = self._number(op.of[0], block), len(self.graph.axes[op.about]) - 1
            return f"({x} - {pick(f'{axis}x', n, i)}) * {pick(f'{axis}s', n, i)}"
        if op.what in ("table", "row"):
            places = [self._number(name, block) for name in op.of]
            if op.what == "row":
                return f"v_row(q + {self.rows[op.about]} * HS_LANES + {block} * W, HS_LANES, {', '.join(places)})"
            return f"{op.about}_v({', '.join(places)})"
        if op.what == "clip":
            return f"v_clip({self._number(op.of[0], block)}, {op.of[1]}, {op.of[2]})"
        if op.what == "div":
            return self._quotient(op.of[0], op.of[1], block)
        of = [self._flag(name, block) if k < n_flags else self._number(name, block) for k, name in enumerate(op.of)]
        return _C[op.what].format(*of) if op.what in _C else f"v_{op.what}({', '.join(of)})"

    def _quotient(self, a: str, b: str, block: int) -> str:
        """Return C of a quotient: a division takes many times as long as what does without."""
        of = f"{self._number(a, block)}, {self._number(b, block)}"
        if b in self.divisors:
            return f"v_quotient({of}, r{b}_{block}, s{b}_{block})"
        if f"1/{b}" in self.place:
            inverse = self._value(f"1/{b}", block)
            if b == self.length and self.halved:
                return f"{self._number(a, block)} * {inverse}"
            # Every third one is divided after all: so what divides is busy too.
            if self.quotients.setdefault((a, b), len(self.quotients)) % 3 < 2:
                return f"v_ratio({of}, {inverse})"
        if b.startswith("(0x") and 1e-30 < (c := float.fromhex(b[1:-1])) < 1e30:
            return f"v_set({(1 / c).hex()}) * {self._number(a, block)}" if frexp(c)[0] == 0.5 else f"v_ratio({of}, v_set({(1 / c).hex()}))"
        return of.replace(", ", " / ")

    def _number(self, name: str, block: int) -> str:
        if name.startswith("("):
            return f"v_set{name}"
        return f"v_number({self._value(name, block)})" if self.graph.kind(name) == "flag" else self._value(name, block)

    def _flag(self, name: str, block: int) -> str:
        return f"v_all({name} != 0)" if name.startswith("(") else self._value(name, block)

    def _value(self, name: str, block: int) -> str:
        """Return a value that is not constant; an input is loaded where it is first needed."""
        if name.startswith("t") and name not in self.place:
            return f"{name}_{block}"
        vector, at = self.place.get(name) or (name[0], int(name[2:-1]))
        own = f"{vector}{at}_{block}"
        if own not in self.loaded:
            self.loaded.add(own)
            load = f"v_load({vector} + {at * self.blocks + block} * W)"
            kind = self.graph.kind(name)
            load = {"flag": f"v_ne({load}, v_set(0))", "interval": f"v_trunc({load})"}.get(kind, load)
            self.lines.append(f"  const {_TYPES[kind]} {own} = {load};")
        return own

    def _store(self, name: str) -> None:
        for vector, i in self.stores.pop(name, []):
            for block in range(self.blocks):
                value = self._number(name, block)
                self.lines.append(f"  v_store({vector} + {i * self.blocks + block} * W, {value});")

    def _table_source(self, name: str, table: Table) -> str:
        """Return C of a table, ``name_v(i, t, ...)``, at intervals and places."""
        points = [table.points[i] for i in table.live]
        y = table.values.reshape([len(p) for p in points])
        n = [len(p) - 1 for p in points]
        if len(n) == 1:
            low, rise = _array(f"{name}_vy", _padded(y[:-1], n[0])), _array(f"{name}_vd", _padded(np.diff(y), n[0]))
            value = f"{pick(f'{name}_vy', n[0], 'i')} + t * {pick(f'{name}_vd', n[0], 'i')}"
            return f"{low}{rise}V vd {name}_v(vi i, vd t) {{ return {value}; }}"
        if len(n) == 2:
            y = y[:, :, None]
        # A cell has its two values at the low end of the first axis, each with its rise toward the high end.
        rises = np.diff(y, axis=0)
        cells = np.stack([y[:-1, :-1], rises[:, :-1], y[:-1, 1:], rises[:, 1:]], axis=-1)
        text = _array(f"{name}_vy", np.moveaxis(cells, 2, 0).ravel())
        cell = f"v_plus(v_times(i, {n[1]}), j)"
        if len(n) == 2:
            return f"{text}V vd {name}_v(vi i, vd t, vi j, vd s) {{ return v_cell({name}_vy, {cell}, t, s); }}"
        arguments = f"{name}_vy, {cell}, {n[0] * n[1]}, k, t, s, r"
        return f"{text}V vd {name}_v(vi i, vd t, vi j, vd s, vi k, vd r) {{ return v_cells({arguments}); }}"


def _urgent_first(ops: list[Op]) -> list[Op]:
    """Return operations in the order of how long what follows from them takes: so that few wait for each other."""
    rest = dict.fromkeys((op.name for op in ops), 0)
    for op in reversed(ops):
        rest[op.name] += _CYCLES.get(op.what, 4)
        for name in op.of:
            rest[name] = max(rest.get(name, 0), rest[op.name])
    return sorted(ops, key=lambda op: -rest[op.name])


def _size(n: int) -> int:
    """Return the entries of a table for `n` intervals: what permutes read, or all where gathers do."""
    return next((size for size in SIZES if n <= size), n)


def _padded(values: Any, n: int) -> Any:
    return np.append(values, np.full(_size(n) - len(values), np.nan))


def _array(name: str, values: Iterable[float]) -> str:
    numbers = ", ".join(float(x).hex() if np.isfinite(x) else "NAN" for x in values)
    return f"static const double {name}[] __attribute__((aligned(64))) = {{{numbers}}};\n"


def pick(name: str, n: int, i: str) -> str:
    """Return C of an entry of a table for `n` intervals."""
    if n == 1:
        return f"v_set({name}[0])"
    return f"v_pick{_size(n)}({name}, {i})" if n <= SIZES[-1] else f"v_gather({name}, {i})"


def find(name: str, points: Any, x: str) -> str:
    """Return C of the interval of an axis in which a number lies."""
    n = len(points) - 1
    if n == 1:
        return "v_at(0)"
    if n <= SIZES[-1]:
        return f"v_find{_size(n)}({name}_vt, {x})"
    return f"{name}_vfind({x})"


def axis_source(name: str, points: Any) -> str:
    """Return C of an axis: its points, the inverse of their distances, and what finds an interval."""
    n = len(points) - 1
    ends = _array(f"{name}_vt", _padded(points[1:-1], n)) if n > 1 else ""
    text = ends + _array(f"{name}_vx", _padded(points[:-1], n)) + _array(f"{name}_vs", _padded(1.0 / np.diff(points), n))
    if n <= SIZES[-1]:
        return text
    # A read from memory takes longer than a larger index.
    for bins in (len(points) * 2**k for k in range(2, 8)):
        start, rounds = _bins(points, bins)
        if rounds < 2:
            break
    scale = float(bins / (points[-1] - points[0])).hex()
    place = f"(x - v_set({float(points[0]).hex()})) * v_set({scale})"
    return f"""{text}static const int {name}_vb[] = {{{", ".join(map(str, start))}}};
V vi {name}_vfind(vd x) {{ return v_find({name}_vb, {name}_vt, {bins}, {rounds}, {place}, x); }}"""


def _bins(points: Any, bins: int) -> tuple[Any, int]:
    """Return the interval at which the search begins in each of equal bins, and how many it may have to go on."""
    edges = points[0] + (points[-1] - points[0]) * np.arange(bins + 1) / bins
    # Rounding may put a number just beside an edge into the other bin.
    hair = 1e-9 * (points[-1] - points[0])
    start = np.searchsorted(points[1:-1], edges[:-1] - hair, side="right")
    return start, int(np.max(np.searchsorted(points[1:-1], edges[1:] + hair, side="right") - start))
