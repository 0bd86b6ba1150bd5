"""Electric node of two machines of which one gives way to the other.

Where the supply brings less than the two ask for together, what is missing is taken from the first (``load``) as long as it
consumes, the rest from the second (``other``); where it takes less than they send, from the first as long as it generates, the
rest from the second.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from halfshaft.library.base.component import From, Signal, face, plant
from halfshaft.library.base.expressions import where
from halfshaft.library.base.ports import Electric, Expr
from halfshaft.library.electric.node import ElectricNode


@dataclass(frozen=True)
class PriorityNode(ElectricNode):
    """Joins two machines on one supply; the first gives way."""

    kind = "priority-node"
    signals = (
        *ElectricNode.signals,
        Signal("P_spare_out", "W", "what the second machine may draw more, if the first one gives way"),
        Signal("P_spare_in", "W", "what it may send more, if the first one gives way"),
    )
    reads = (From("battery", P_room_out="W", P_room_in="W"),)

    @face("forgiven")
    def law(self) -> Mapping[str, Any]:
        """Say that no balance needs to forgive: only one of the two machines meets the store's limit at a time."""
        return {"forgiven": 0.0}

    @face("load", "other")
    def available(self, supply: Electric, _asked: tuple[Expr, Expr]) -> Mapping[str, Any]:
        """Return what each of the two gets."""
        first, second = _asked
        missing = first + second - supply.P
        given = first - where(missing >= 0, ca.fmin(missing, ca.fmax(first, 0)), ca.fmax(missing, ca.fmin(first, 0)))
        return {"load": Electric(given), "other": Electric(where(missing == 0, second, supply.P - given))}

    @plant("P_spare_out", "P_spare_in")
    def spare(self, load: Electric, P_room_out: Expr, P_room_in: Expr) -> Mapping[str, Any]:
        """Return what the second machine may still do once the first has given way."""
        return {"P_spare_out": P_room_out + ca.fmax(load.P, 0), "P_spare_in": P_room_in + ca.fmax(-load.P, 0)}
