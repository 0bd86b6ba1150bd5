"""What limits and bounds cost at an optimum: the multipliers of its first-order conditions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from halfshaft.cosim.compiled import Array
from halfshaft.studies.sizing.evaluator import Mask, Slopes

#: A limit this near to its target may bind: the mass of a vehicle that is built, and whole numbers, leave a little.
NEAR = 5e-3
#: A variable so near to a bound is at it.
AT = 1e-6


@dataclass(frozen=True)
class Multipliers:
    """By how much the goal falls per unit of excess that a limit is given, and per scaled unit of a bound; the slope that is left."""

    limits: Array
    low: Array
    high: Array
    rest: float


def multipliers_of(u: Array, slopes: Slopes, excess: Array, free: Mask) -> Multipliers:
    """Return the multipliers with which the conditions of an optimum are met best by least squares, none of them below 0.

    Parameters
    ----------
    u, slopes
        The point and what the goal and limits do there.
    excess
        Of the limits, of the vehicle as it is built.
    free
        Which variables are continuous; whole ones have no slope to balance.

    """
    n = len(u)
    near = np.flatnonzero(excess > -NEAR)
    low, high = np.flatnonzero(free & (u < AT)), np.flatnonzero(free & (u > 1 - AT))
    eye = np.eye(n)
    columns = np.column_stack([slopes.excess_gradient[near].T, -eye[:, low], eye[:, high]])[free]
    wanted = -slopes.goal_gradient[free]
    found = np.zeros(columns.shape[1])
    if columns.size:
        # Columns of one length, so that least squares weighs all alike.
        size = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        found = nnls(columns / size, wanted)[0] / size
    out = Multipliers(np.zeros(len(excess)), np.zeros(n), np.zeros(n), float(np.linalg.norm(columns @ found - wanted)))
    out.limits[near], out.low[low], out.high[high] = np.split(found, [len(near), len(near) + len(low)])
    return out
