"""Electric node: two machines on one supply.

::

    P = P_first + P_second                                                   (1)

The supply may bring less than the two ask for together, or take less than they send.  What is missing is taken from the first
as long as it consumes, the rest from the second; what nothing takes is taken from the first as long as it generates, the rest
from the second.  Nothing is lost here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from halfshaft.library.base.component import Component, From, Signal, face, plant
from halfshaft.library.base.expressions import where
from halfshaft.library.base.parameters import Parameters
from halfshaft.library.base.ports import Electric, Expr, Port


@dataclass(frozen=True, kw_only=True)
class NodeParameters(Parameters):
    """A node has no parameters."""


@dataclass(frozen=True)
class Node(Component):
    """Node between two machines and what supplies both."""

    kind = "electric-node"
    p: NodeParameters
    parameters = NodeParameters
    first = Port(Electric, "wheel")
    second = Port(Electric, "wheel")
    supply = Port(Electric, "source")
    signals = (
        Signal("P_spare_out", "W", "what the second machine may draw more, if the first one gives way"),
        Signal("P_spare_in", "W", "what it may send more, if the first one gives way"),
    )
    reads = (From("battery", P_room_out="W", P_room_in="W"),)

    @face("supply")
    def required(self, first: Electric, second: Electric) -> Mapping[str, Any]:
        """Return equation (1)."""
        return {"supply": Electric(first.P + second.P)}

    @face("first", "second")
    def available(self, first: Electric, second: Electric, supply: Electric) -> Mapping[str, Any]:
        """Return what each of the two gets."""
        missing = first.P + second.P - supply.P
        taken = where(missing >= 0, ca.fmin(missing, ca.fmax(first.P, 0)), ca.fmax(missing, ca.fmin(first.P, 0)))
        given = first.P - taken
        return {"first": Electric(given), "second": Electric(where(missing == 0, second.P, supply.P - given))}

    def audit(self, first: Electric, second: Electric, supply: Electric) -> Mapping[str, Any]:
        """Compare what came with what went."""
        return {"sum": supply.P - first.P - second.P}

    @plant("supply")
    def flow(self, first: Electric, second: Electric) -> Mapping[str, Any]:
        """Return equation (1) in continuous time."""
        return {"supply": Electric(first.P + second.P)}

    @plant("P_spare_out", "P_spare_in")
    def spare(self, first: Electric, P_room_out: Expr, P_room_in: Expr) -> Mapping[str, Any]:
        """Return what the second machine may still do once the first has given way."""
        return {"P_spare_out": P_room_out + ca.fmax(first.P, 0), "P_spare_in": P_room_in + ca.fmax(-first.P, 0)}
