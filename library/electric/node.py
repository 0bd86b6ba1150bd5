"""Electric node: two loads on one supply; with a node as a load of a node, any number.

::

    P_supply = P_load + P_other                                              (1)

Where the supply gives less than that, loads that drive bear it in proportion to what they ask for; where it takes less, those
that brake do.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca

from halfshaft.library.base.component import Component, Signal, face, plant
from halfshaft.library.base.expressions import where
from halfshaft.library.base.parameters import Parameters
from halfshaft.library.base.ports import Electric, Expr, Port

#: Share of a missing power that a machine's balance forgives the store's limit: small beside any loss.
FORGIVEN = 1e-4


@dataclass(frozen=True, kw_only=True)
class ElectricNodeParameters(Parameters):
    """A node has no parameters."""


@dataclass(frozen=True)
class ElectricNode(Component):
    """Joins two loads on one supply."""

    kind = "electric-node"
    p: ElectricNodeParameters
    parameters = ElectricNodeParameters
    load = Port(Electric, "wheel")
    other = Port(Electric, "wheel")
    supply = Port(Electric, "source")
    signals: ClassVar[tuple[Signal, ...]] = (
        Signal("forgiven", "1", "share of a missing power that a machine's balance forgives the store's limit"),
    )

    @face("forgiven")
    def law(self) -> Mapping[str, Any]:
        """Publish the share."""
        return {"forgiven": FORGIVEN}

    @face("supply", "_asked")
    def required(self, load: Electric, other: Electric) -> Mapping[str, Any]:
        """Return equation (1)."""
        return {"supply": Electric(load.P + other.P), "_asked": (load.P, other.P)}

    @face("load", "other")
    def available(self, supply: Electric, _asked: tuple[Expr, Expr]) -> Mapping[str, Any]:
        """Return what each load gets."""
        one, two = _asked
        change = supply.P - (one + two)
        # Who bears the change: what drives, or what brakes.
        bears = [where(change < 0, ca.fmax(P, 0), ca.fmin(P, 0)) for P in _asked]
        both = bears[0] + bears[1]
        share = where(both != 0, bears[0] / where(both != 0, both, 1), 0.5)
        given = where(change == 0, one, one + share * change)
        return {"load": Electric(given), "other": Electric(where(change == 0, two, supply.P - given))}

    def audit(self, load: Electric, other: Electric, supply: Electric) -> Mapping[str, Any]:
        """Compare what came with what went."""
        return {"sum": supply.P - load.P - other.P}

    @plant("supply")
    def flow(self, load: Electric, other: Electric) -> Mapping[str, Any]:
        """Return equation (1) in continuous time."""
        return {"supply": Electric(load.P + other.P)}
