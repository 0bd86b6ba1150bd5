"""Small expressions that several components share, for numbers and symbols alike."""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from typing import Any, Protocol, TypeAlias

import casadi as ca
import numpy as np

#: Signal `turning`: tells of a speed whether something moves, as 0 or 1 in the step and smoothly in the forward-facing model.
Turning: TypeAlias = Callable[[Any], Any]

#: What a relation says of `lifted`.
LIFTED = "efficiency_scale = {efficiency_scale:g} lifts an efficiency of the map above 1"


class Direction(Protocol):
    """Signal `direction`: how a loss depends on whether a torque drives or brakes; smooth in the forward-facing model."""

    def size(self, tau: Any) -> Any:
        """Return the size of a torque."""

    def loss(self, tau: Any, efficiency: Callable[[Any], Any]) -> Any:
        """Return the torque lost behind an output torque: ``(1 - e) / e`` of it driving, ``1 - e`` braking."""


def where(condition: Any, then: Any, otherwise: Any) -> Any:
    """Return one of two values; both are evaluated, so both must be finite."""
    return ca.if_else(condition, then, otherwise)


def clip(x: Any, lowest: Any, highest: Any) -> Any:
    """Return `x` cut to an interval."""
    return ca.fmin(ca.fmax(x, lowest), highest)


def lifted(efficiency_scale: Any, table: Any, pairs: Callable[[Any, Any], list[tuple[Any, Any]]], one: Any = 1.0) -> Any:
    """Return whether a scale lifts an efficiency above one.

    The table is over power, or over speed and torque; `pairs` gives from the power there and its values what comes out and what
    goes in, and `one` is the ratio of both at an efficiency of one.
    """
    if len(table.points) > 2 or (isinstance(efficiency_scale, int | float) and efficiency_scale <= 1):
        return False
    both = pairs(reduce(np.multiply.outer, table.points), table.values)
    above = efficiency_scale * max(float(np.max(out[into > 0] / into[into > 0], initial=0.0)) for out, into in both) > one
    return above & (efficiency_scale > 1) if isinstance(efficiency_scale, np.ndarray) else above
