"""Power bus: what the load asks for and the generator does not bring comes from the battery.

::

    P_battery = P_load - P_generator                                         (1)

On the way back the load gets what generator and battery bring together.  It never gets more driving power than it
asked for; a surplus that neither load nor battery takes is booked as lost.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from halfshaft.library.base.component import Component, Variable, face, plant
from halfshaft.library.base.parameters import Parameters
from halfshaft.library.base.ports import Electric, Expr, Port


@dataclass(frozen=True, kw_only=True)
class BusParameters(Parameters):
    """A bus has no parameters."""


@dataclass(frozen=True)
class Bus(Component):
    """Node between motor, battery and, in a series hybrid, generator."""

    kind = "bus"
    p: BusParameters
    parameters = BusParameters
    load = Port(Electric, "wheel")
    battery = Port(Electric, "source")
    generator = Port(Electric, "source", optional=True)
    variables = (
        Variable("P_bus", "W", "power that the load asks of the bus", signal=True),
        Variable("P_loss", "W", "surplus that nothing takes", "loss"),
    )

    @face("P_bus")
    def demand(self, load: Electric) -> Mapping[str, Any]:
        """Publish the demand, which the control of a series hybrid looks at."""
        return {"P_bus": load.P}

    @face("battery")
    def required(self, load: Electric, generator: Electric = Electric(0.0)) -> Mapping[str, Any]:  # noqa: B008
        """Return equation (1)."""
        return {"battery": Electric(load.P - generator.P)}

    @face("load", "P_loss")
    def available(self, P_bus: Expr, battery: Electric, generator: Electric = Electric(0.0)) -> Mapping[str, Any]:  # noqa: B008
        """Return what the load gets."""
        P = battery.P + generator.P
        given = ca.fmin(P, ca.fmax(P_bus, 0))
        return {"load": Electric(given), "P_loss": P - given}

    def audit(self, load: Electric, battery: Electric, P_loss: Expr, generator: Electric = Electric(0.0)) -> Mapping[str, Any]:  # noqa: B008
        """Compare what came with what went and what nothing took."""
        return {"sum": battery.P + generator.P - load.P - P_loss}

    @plant("battery", "P_loss")
    def flow(self, load: Electric, generator: Electric = Electric(0.0)) -> Mapping[str, Any]:  # noqa: B008
        """Return equation (1) in continuous time."""
        return {"battery": Electric(load.P - generator.P), "P_loss": 0}
