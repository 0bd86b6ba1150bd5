"""What rounds a kink: one kernel for choices, limits and tables.

Between -1 and 1 the *weight* passes from 0 to 1, and outside of that nothing is changed::

    weight(t) = 1/2 + 15/16 t - 5/8 t^3 + 3/16 t^5
    ramp(t) = 5/32 + 1/2 t + 15/32 t^2 - 5/32 t^4 + 1/32 t^6      whose slope it is, in place of max(0, t)

Value, slope and curvature of both are continuous, as an interior-point solver asks.

A kink of a table is rounded over half of the shorter of its two intervals, times the width: from 0, the table itself, to 1, where each
rounded piece ends where the next begins.  Each axis is rounded by itself, so that a table of two variables is the weighted sum of at
most four by four values; a third axis, which counts gears, stays as it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from halfshaft.library.base.tables import Table, numbers_in_c

Array = npt.NDArray[np.float64]

#: Axes that are rounded; further ones stay.
ROUNDED = 2
#: No kink of a table is sharper than this width.
SHARPEST = 1e-9


def weight(x: Any, w: Any) -> Any:
    """Return a number from 0 where x <= -w to 1 where x >= w."""
    t = ca.fmin(ca.fmax(x / w, -1), 1)
    square = t**2
    return 0.5 + t * (15 / 16 - square * (5 / 8 - 3 / 16 * square))


def ramp(x: Any, w: Any) -> Any:
    """Return the larger one of x and 0, rounded from -w to w."""
    t = ca.fmin(ca.fmax(x / w, -1), 1)
    square = t**2
    return w * (5 / 32 + 0.5 * t + square * (15 / 32 - square * (5 / 32 - 1 / 32 * square))) + ca.fmax(x - w, 0)


@dataclass(frozen=True, eq=False)
class RoundedTable(Table):
    """A table that takes the width as a last argument."""

    @classmethod
    def from_table(cls, table: Table) -> RoundedTable:
        """Return a table with its kinks rounded; its arguments are cut before."""
        return cls(table.points, table.values, False, table.name)

    @cached_property
    def reduced(self) -> Table:
        """The same table with each axis along which nothing changes cut to one point."""
        return RoundedTable.from_table(super().reduced)

    @cached_property
    def interpolant(self) -> ca.Function:
        """The table as a function on the virtual machine."""
        x = ca.SX.sym("x", len(self.points) + 1)
        return ca.Function(self.name, [x], [rounded(self, ca.vertsplit(x)[:-1], x[-1])], {"never_inline": True})


def rounded(table: Table, x: Sequence[Any], width: Any) -> Any:
    """Return a table as an expression without look-up."""
    rest = ca.SX(ca.DM(table.values.reshape(len(table.points[0]), -1)))
    for i, points in enumerate(table.points):
        hats = _hats(points, x[i], width if i < ROUNDED else 0.0) if len(points) > 1 else [1.0]
        rest = ca.mtimes(ca.vertcat(*hats).T, rest)
        if i + 1 < len(table.points):
            rest = ca.reshape(rest, -1, len(table.points[i + 1])).T
    return ca.SX(rest)


def _hats(points: Array, x: Any, width: Any) -> list[Any]:
    """Return the weight of each point: hats with rounded kinks, whose sum is one."""
    gaps = np.diff(points)
    # A ramp begins at each inner point; the first and the last piece are extended.
    ramps: list[Any] = [x - points[0]]
    for i, point in enumerate(points[1:-1], 1):
        half = 0.5 * min(gaps[i - 1], gaps[i]) * ca.fmax(width, SHARPEST)
        ramps.append(ramp(x - point, half))
    slopes = [(ramps[i] - (ramps[i + 1] if i + 1 < len(ramps) else 0)) / gap for i, gap in enumerate(gaps)]
    return [1 - slopes[0], *(a - b for a, b in pairwise(slopes)), slopes[-1]]


_WEIGHTS = """
#ifndef HS_ROUNDED
#define HS_ROUNDED
/* Weights of the points before, at both ends of, and behind an interval at the place t in it, and their slopes.  `s` has the shares
   of the interval that are rounded for a width of 1, at its low and its high end, and what it is times as long as its neighbours. */
static inline void hs_weights(double t, double width, const double *s, double *w, double *d) {
  const double low = width * s[0], high = width * s[1];
  const int begins = low > 0 && t < low, ends = high > 0 && 1 - t < high;
  w[0] = w[3] = d[0] = d[3] = 0;
  w[1] = 1 - t; w[2] = t; d[1] = -1; d[2] = 1;
  if (begins || ends) {
    /* How far from the point, and by how much the ramp that begins there is above its straight lines. */
    const double part = begins ? low : high, r = begins ? t / low : (1 - t) / high, q = r * r;
    const double above = part * (5 / 32. - r / 2 + q * (15 / 32. - q * (5 / 32. - q / 32.)));
    const double slope = r * (15 / 16. - q * (5 / 8. - 3 / 16. * q)) - 0.5;
    const double *near = begins ? s + 2 : s + 3;
    /* The point itself, and those before and behind it: of them one is outside of the interval. */
    const int point = begins ? 1 : 2, inner = 3 - point, outer = begins ? 0 : 3;
    w[outer] = above * *near; w[point] -= above * (1 + *near); w[inner] += above;
    const double along = begins ? slope : -slope;
    d[outer] = along * *near; d[point] -= along * (1 + *near); d[inner] += along;
  }
}
#endif
"""


def rounded_source(name: str, table: Table) -> str:
    """Return C of ``name_at(i, t, ..., width, d)``, as `halfshaft.library.base.tables.values_source` does for a plain table."""
    live = table.live
    body = [_WEIGHTS, f"static const double {name}_y[] = {numbers_in_c(table.values)};"]
    body += [f"static const double {name}_{i}_k[] = {numbers_in_c(_shares(table.points[i], i < ROUNDED))};" for i in live]
    arguments = "".join(f"int i{i}, double t{i}, " for i in live)
    body.append(f"static double {name}_at({arguments}double width, double *d) {{")
    body.append("  double value = 0;")
    for i in live:
        last = len(table.points[i]) - 1
        body.append(f"  double w{i}[4], d{i}[4];\n  hs_weights(t{i}, width, {name}_{i}_k + 4 * i{i}, w{i}, d{i});")
        body.append(f"  const int n{i}[4] = {{i{i} > 0 ? i{i} - 1 : 0, i{i}, i{i} + 1, i{i} + 2 < {last} ? i{i} + 2 : {last}}};")
    body.append("".join(f"  if (d) d[{i}] = 0;\n" for i in live))
    for i in live:
        low, high = (0, 4) if i < ROUNDED else (1, 3)
        body.append(f"  for (int k{i} = {low}; k{i} < {high}; ++k{i})")
    strides = [int(np.prod(table.values.shape[i + 1 :])) for i in range(len(table.points))]
    at = " + ".join(f"n{i}[k{i}] * {strides[i]}" for i in live) or "0"
    body.append(f"  {{\n    const double y = {name}_y[{at}];")
    body.append(f"    value += y{''.join(f' * w{i}[k{i}]' for i in live)};")
    for i in live:
        slope = "".join(f" * {'d' if j == i else 'w'}{j}[k{j}]" for j in live)
        body.append(f"    if (d) d[{i}] += y{slope};")
    body.append("  }\n  return value;\n}")
    return "\n".join(body)


def _shares(points: Array, bent: bool) -> Array:
    """Return four numbers of each interval, as ``hs_weights`` takes them; 0 where there is no kink, or it stays."""
    gaps = np.diff(points)
    shares = np.zeros((len(gaps), 4))
    if bent and len(gaps) > 1:
        half = 0.5 * np.minimum(gaps[:-1], gaps[1:])
        shares[1:, 0], shares[:-1, 1] = half / gaps[1:], half / gaps[:-1]
        shares[1:, 2], shares[:-1, 3] = gaps[1:] / gaps[:-1], gaps[:-1] / gaps[1:]
    return shares
