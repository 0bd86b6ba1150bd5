"""Maps: piecewise linear tables over one to three axes, as CasADi functions and as C.

A table is called with numbers or symbols.  On symbols it gives a call node, so the same expression graph runs on the
CasADi virtual machine and in generated C.  Two functions serve the call: an interpolant (no compiler needed), or
the C below through `casadi.external`, about five times as fast.  Axes need not be uniform: a small index over equal
bins tells where to start, and one or two comparisons finish the search.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import numpy.typing as npt

#: The search in C counts points in 16 bits.
MOST_POINTS = 65_000


class Axis(NamedTuple):
    """Name and SI unit of a table's axis."""

    name: str
    unit: str


def _grid(points: Any) -> tuple[npt.NDArray[np.float64], ...]:
    return tuple(np.atleast_1d(np.asarray(x, dtype=float)) for x in points)


def _clipped(x: ca.MX, lowest: float, highest: float) -> ca.MX:
    # By comparisons: fmin and fmax would turn what is not a number into an edge.
    return ca.if_else(x < lowest, lowest, ca.if_else(x > highest, highest, x))


@dataclass(frozen=True, eq=False)
class Table:
    """Piecewise linear function of one to three variables.

    Parameters
    ----------
    points
        Strictly rising points of each axis.
    values
        Array of shape ``(len(points[0]), len(points[1]), ...)``.
    clip
        Whether arguments outside the axes are moved to the edge; else the outermost piece is extended.

    """

    points: tuple[npt.NDArray[np.float64], ...]
    values: npt.NDArray[np.float64]
    clip: bool = True
    name: str = field(default="table")

    @classmethod
    def of(cls, *points: Any, values: Any, clip: bool = True) -> Table:
        """Return a table from any sequences.

        Raises
        ------
        ValueError
            If the shape does not fit, an axis does not rise or a value is missing.

        """
        axes, array = _grid(points), np.asarray(values, dtype=float)
        shape = tuple(len(x) for x in axes)
        if array.shape != shape:
            raise ValueError(f"values have shape {array.shape}, the axes ask for {shape}")
        for i, x in enumerate(axes, 1):
            if not len(x):
                raise ValueError(f"axis {i} has no points")
            if not np.all(np.isfinite(x)):
                raise ValueError(f"axis {i} has a missing value")
            if np.any(np.diff(x) <= 0):
                j = int(np.argmax(np.diff(x) <= 0))
                raise ValueError(f"axis {i} must rise strictly, but {x[j + 1]:g} follows {x[j]:g}")
            if len(x) > MOST_POINTS:
                raise ValueError(f"axis {i} has {len(x)} points, must have at most {MOST_POINTS}")
            # The search divides by the distance of points, and by that of the ends.
            if np.any(np.diff(x) < 1e-290) or x[-1] / 2 - x[0] / 2 > 1e300:
                raise ValueError(f"axis {i} has points too close to each other, or too far apart")
        if not np.all(np.isfinite(array)):
            where = tuple(int(k) + 1 for k in np.argwhere(~np.isfinite(array))[0])
            raise ValueError(f"the value at position {where} is missing or not a number")
        return cls(axes, array, clip)

    def __call__(self, *x: Any) -> Any:
        """Return the interpolated value; a number for numbers, an expression for symbols."""
        if all(isinstance(v, int | float | np.floating) for v in x):
            return float(self.interpolant(ca.vertcat(*x)))
        return self.interpolant(ca.vertcat(*x))

    def __repr__(self) -> str:
        """Return how many values there are, and between which they lie."""
        return f"<{self.extent}>"

    @property
    def extent(self) -> str:
        """How many values there are, and between which they lie."""
        return f"{' x '.join(str(len(p)) for p in self.points)} values, {self.values.min():.4g} to {self.values.max():.4g}"

    def inside(self, axis: int) -> tuple[float, float]:
        """Return the ends of one axis."""
        return float(self.points[axis][0]), float(self.points[axis][-1])

    @cached_property
    def key(self) -> tuple[Any, ...]:
        """What makes two tables the same."""
        return (*(p.tobytes() for p in self.points), self.values.tobytes(), self.clip)

    @cached_property
    def reduced(self) -> Table:
        """The same table with each axis along which nothing changes cut to one point; gives the same bits."""
        points, values = list(self.points), self.values
        for i in range(len(points)):
            first = values.take([0], axis=i)
            if np.all(values == first):
                points[i], values = points[i][:1], first
        return Table(tuple(points), values, self.clip, self.name)

    @cached_property
    def interpolant(self) -> ca.Function:
        """The table as a function on the virtual machine; needs no compiler."""
        x = ca.MX.sym("x", len(self.points))
        keep = self.live
        if not keep:
            return ca.Function(self.name, [x], [ca.MX(float(self.values.flat[0]))], {"never_inline": True})
        arguments = [_clipped(x[i], *self.inside(i)) if self.clip else x[i] for i in keep]
        grid = [self.points[i].tolist() for i in keep]
        values = self.values.reshape([len(g) for g in grid]).ravel(order="F").tolist()
        lookup = ca.interpolant(f"{self.name}_lookup", "linear", grid, values)
        return ca.Function(self.name, [x], [lookup(ca.vertcat(*arguments))], {"never_inline": True})

    @property
    def live(self) -> list[int]:
        """Axes of more than one point; only they need a search."""
        return [i for i, p in enumerate(self.points) if len(p) > 1]


@dataclass(frozen=True)
class BoundTable:
    """A table of an assembled model: calls a function with a name of its own, and still tells its ends and values."""

    function: ca.Function
    table: Table

    def __call__(self, *x: Any) -> Any:
        """Return the call node."""
        return self.function(ca.vertcat(*x))

    def inside(self, axis: int) -> tuple[float, float]:
        """Return the ends of one axis."""
        return self.table.inside(axis)

    @property
    def points(self) -> tuple[npt.NDArray[np.float64], ...]:
        """Points of each axis."""
        return self.table.points

    @property
    def values(self) -> npt.NDArray[np.float64]:
        """Values at the points."""
        return self.table.values


def interpolants(named: Mapping[str, Table]) -> dict[str, ca.Function]:
    """Return the tables as functions of the virtual machine."""
    return {name: Table(t.points, t.values, t.clip, name).interpolant for name, t in named.items()}


def numbers_in_c(values: npt.ArrayLike) -> str:
    """Return numbers as C writes an array."""
    return "{" + ", ".join(float(v).hex() if np.isfinite(v) else "NAN" for v in np.asarray(values, dtype=float).flat) + "}"


def axis_source(name: str, points: npt.NDArray[np.float64]) -> str:
    """Return C of an axis of at least two points: ``name_find(x)`` gives the interval of a number.

    A small index over equal bins tells where to start.  One comparison finishes the search, without a branch that may be foreseen
    wrongly, where no bin holds more than one point; else a loop does.
    """
    last, span = len(points) - 2, points[-1] - points[0]

    def index(bins: int) -> tuple[npt.NDArray[np.intp], bool]:
        """Return the interval to start from in each bin, and whether one comparison is enough."""
        edges = points[0] + span * np.arange(bins + 1) / bins
        # Rounding may put a number just beyond an edge into the next bin: begin and end a hair outside.
        low, high = (np.clip(np.searchsorted(points, edges + hair, side="right") - 1, 0, last) for hair in (-1e-9 * span, 1e-9 * span))
        return low[:-1], bool(np.all(high[1:] - low[:-1] <= 1))

    bins = next((n for n in (4 * len(points), 8 * len(points), 16 * len(points)) if index(n)[1]), 4 * len(points))
    start, single = index(bins)
    loop = f"""  int i = !(b > 0) ? 0 : b < {bins} ? {name}_b[(int)b] : {last};
  while (i < {last} && x >= {name}_x[i + 1]) ++i;
  return i;"""
    straight = f"""  static const double next[] = {numbers_in_c([*points[1:-1], np.nan])};
  b = b > 0 ? b : 0;
  int i = {name}_b[(int)(b < {bins - 1} ? b : {bins - 1})];
  return i + (x >= next[i]);"""
    return f"""
static const double {name}_x[] = {numbers_in_c(points)};
static const double {name}_s[] = {numbers_in_c(1.0 / np.diff(points))};
static const unsigned short {name}_b[] = {{{", ".join(str(int(i)) for i in start)}}};
static inline int {name}_find(double x) {{
  double b = (x - {float(points[0]).hex()}) * {float(bins / span).hex()};
{straight if single else loop}
}}"""


def clip_source(x: str, points: npt.NDArray[np.float64]) -> str:
    """Return C that moves `x` to the ends of an axis; what is not a number stays so."""
    low, high = float(points[0]).hex(), float(points[-1]).hex()
    return f"{x} < {low} ? {low} : {x} > {high} ? {high} : {x}"


def values_source(name: str, table: Table) -> str:
    """Return C of ``name_at(i, t, ..., d)``: the value at interval and fraction of each axis, and the slopes in `d`.

    Axes of one point take no arguments.  `d`, unless null, gets the derivatives by the fractions.
    """
    live = table.live
    strides = [int(np.prod(table.values.shape[i + 1 :])) for i in range(len(table.points))]
    arguments = ", ".join(f"int i{i}, double t{i}" for i in live)
    offset = " + ".join(f"i{i} * {strides[i]}" for i in live) or "0"
    body = [f"static const double {name}_y[] = {numbers_in_c(table.values)};"]
    body.append(f"static inline double {name}_at({arguments + ', ' if live else ''}double *d) {{")
    body.append(f"  const double *y = {name}_y + {offset};")
    if len(live) == 3:
        # The third axis counts gears: at a whole gear one plane is enough.
        i, j, k = live
        body.append(f"""  if (!d && (t{k} == 0 || t{k} == 1)) {{
    const double *z = t{k} == 0 ? y : y + {strides[k]};
    double a = z[0] + t{i} * (z[{strides[i]}] - z[0]);
    double b = z[{strides[j]}] + t{i} * (z[{strides[i] + strides[j]}] - z[{strides[j]}]);
    return a + t{j} * (b - a);
  }}""")
    level: dict[tuple[int, ...], str] = {}
    for corner in product((0, 1), repeat=len(live)):
        level[corner] = f"v{''.join(map(str, corner))}"
        at = " + ".join(str(strides[i]) for i, bit in zip(live, corner, strict=True) if bit) or "0"
        body.append(f"  double {level[corner]} = y[{at}];")
    # Interpolate along the first axis, then the next; each round halves the corners.
    slopes: dict[int, dict[tuple[int, ...], str]] = {}
    for k, i in enumerate(live):
        values, own = {}, {}
        moved: dict[int, dict[tuple[int, ...], str]] = {j: {} for j in slopes}
        for rest in product((0, 1), repeat=len(live) - k - 1):
            low, high, tag = (0, *rest), (1, *rest), f"{k}_{''.join(map(str, rest))}"
            body.append(f"  double m{tag} = {level[high]} - {level[low]};")
            body.append(f"  double l{tag} = {level[low]} + t{i} * m{tag};")
            values[rest], own[rest] = f"l{tag}", f"m{tag}"
            for j, known in slopes.items():
                moved[j][rest] = f"({known[low]} + t{i} * ({known[high]} - {known[low]}))"
        level, slopes = values, {**moved, i: own}
    gradient = " ".join(f"d[{i}] = {slopes[i][()]};" for i in live)
    body.append(f"  if (d) {{ {gradient} }}")
    body.append(f"  return {level[()]};\n}}")
    return "\n".join(body)


def external_source(name: str, table: Table) -> str:
    """Return C that exports ``name`` and its derivatives ``jac_name`` and ``jac_jac_name`` in CasADi's convention.

    A multilinear piece bends only between its axes: the mixed second derivative is the difference of a slope between
    the two ends of another axis.
    """
    live, n = table.live, len(table.points)
    lines = [axis_source(f"{name}_{i}", table.points[i]) for i in live]
    lines.append(values_source(name, table))
    places = []
    for i in live:
        places.append(f"  double x{i} = {clip_source(f'x[{i}]', table.points[i]) if table.clip else f'x[{i}]'};")
        places.append(f"  int i{i} = {name}_{i}_find(x{i});")
        places.append(f"  double t{i} = (x{i} - {name}_{i}_x[i{i}]) * {name}_{i}_s[i{i}];")
        # The fraction's derivative by the argument; none where the argument was clipped.
        places.append(f"  double g{i} = {f'x{i} != x[{i}] ? 0 : ' if table.clip else ''}{name}_{i}_s[i{i}];")
    arguments = "".join(f"i{i}, t{i}, " for i in live)
    lines.append(f"static double {name}_value(const double *x, double *d) {{\n  for (int i = 0; d && i < {n}; ++i) d[i] = 0;")
    lines += [*places, f"  double y = {name}_at({arguments}d);"]
    lines += [f"  if (d) d[{i}] *= g{i};" for i in live]
    lines.append("  return y;\n}")
    lines.append(f"static void {name}_curvature(const double *x, double *h) {{\n  double a[{n}], b[{n}];")
    lines += [*places, f"  for (int i = 0; i < {n * n}; ++i) h[i] = 0;"]
    for j in live:
        for end, t in (("a", "0."), ("b", "1.")):
            ends = "".join(f"i{i}, {t if i == j else 't' + str(i)}, " for i in live)
            lines.append(f"  {name}_at({ends}{end});")
        lines += [f"  h[{i + j * n}] = (b[{i}] - a[{i}]) * g{i} * g{j};" for i in live if i != j]
    lines.append("}")
    return "\n".join([*lines, _EXTERNAL.format(name=name, n=n)])


_EXTERNAL = """
TABLE_EXPORT int {name}(const double **arg, double **res, casadi_int *iw, double *w, int mem) {{
  if (res[0]) res[0][0] = {name}_value(arg[0], 0);
  return 0;
}}
TABLE_EXPORT int jac_{name}(const double **arg, double **res, casadi_int *iw, double *w, int mem) {{
  if (res[0]) {name}_value(arg[0], res[0]);
  return 0;
}}
TABLE_EXPORT int jac_jac_{name}(const double **arg, double **res, casadi_int *iw, double *w, int mem) {{
  if (res[0]) {name}_curvature(arg[0], res[0]);
  return 0;
}}
static const casadi_int {name}_in[] = {{{n}, 1, 1}}, {name}_out[] = {{1, 1, 1}}, {name}_jac[] = {{1, {n}, 1}};
static const casadi_int {name}_hess[] = {{{n}, {n}, 1}}, {name}_none[] = {{{n}, 1, 0, 0}};
TABLE_EXPORT casadi_int {name}_n_in(void) {{ return 1; }}
TABLE_EXPORT casadi_int {name}_n_out(void) {{ return 1; }}
TABLE_EXPORT const casadi_int *{name}_sparsity_in(casadi_int i) {{ return {name}_in; }}
TABLE_EXPORT const casadi_int *{name}_sparsity_out(casadi_int i) {{ return {name}_out; }}
TABLE_EXPORT casadi_int jac_{name}_n_in(void) {{ return 2; }}
TABLE_EXPORT casadi_int jac_{name}_n_out(void) {{ return 1; }}
TABLE_EXPORT const casadi_int *jac_{name}_sparsity_in(casadi_int i) {{ return i ? {name}_out : {name}_in; }}
TABLE_EXPORT const casadi_int *jac_{name}_sparsity_out(casadi_int i) {{ return {name}_jac; }}
TABLE_EXPORT casadi_int jac_jac_{name}_n_in(void) {{ return 3; }}
TABLE_EXPORT casadi_int jac_jac_{name}_n_out(void) {{ return 2; }}
TABLE_EXPORT const casadi_int *jac_jac_{name}_sparsity_in(casadi_int i) {{ return i ? i > 1 ? {name}_jac : {name}_out : {name}_in; }}
TABLE_EXPORT const casadi_int *jac_jac_{name}_sparsity_out(casadi_int i) {{ return i ? {name}_none : {name}_hess; }}
"""
