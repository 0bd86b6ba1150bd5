"""Electric accessories: a constant load on the bus.

``P_in = P_out + P_on / eta``.  On the way back the accessories are served first, but only with what the bus and a braking
motor offer together; an empty battery cannot feed them.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from halfshaft.library.base.expressions import clip, where
from halfshaft.library.base.links import Link, TwoSided
from halfshaft.library.base.parameters import Parameters, param
from halfshaft.library.base.ports import Electric, Expr, Port


@dataclass(frozen=True, kw_only=True)
class ElectricAccessoriesParameters(Parameters):
    """Electric load."""

    P_on: float = param("W", "power of the accessories while the key is on", 0.0, ge=0, le=1e6)
    eta: float = param("1", "efficiency of their supply", 1.0, ge=0.01, le=1)


@dataclass(frozen=True)
class ElectricAccessories(TwoSided):
    """Electric load between the motor and the bus."""

    kind = "electric-accessories"
    p: ElectricAccessoriesParameters
    parameters = ElectricAccessoriesParameters
    load = Port(Electric, "wheel")
    supply = Port(Electric, "source")

    def chain(self, key_on: Expr) -> tuple[Link, ...]:  # type: ignore[override]
        """Return the load."""
        P = where(key_on, self.p.P_on / self.p.eta, 0)

        def back(asked: Electric, sent: Electric, offered: Electric) -> Electric:
            return Electric(offered.P - clip(offered.P - ca.fmin(asked.P, 0), 0, P))

        return (Link(lambda load: Electric(load.P + P), back),)
