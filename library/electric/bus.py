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

from halfshaft.library.base.component import Variable, face
from halfshaft.library.base.junction import Junction
from halfshaft.library.base.parameters import Parameters
from halfshaft.library.base.ports import Electric, Port

#: A port that nothing is connected to.
NOTHING = Electric(0.0)


@dataclass(frozen=True, kw_only=True)
class BusParameters(Parameters):
    """A bus has no parameters."""


@dataclass(frozen=True)
class Bus(Junction):
    """Node between the loads, the battery and what makes electricity on board."""

    kind = "bus"
    p: BusParameters
    parameters = BusParameters
    load = Port(Electric, "wheel")
    battery = Port(Electric, "source")
    generator = Port(Electric, "source", optional=True, offers=True)
    variables = (Variable("P_bus", "W", "power that the load asks of the bus", signal=True),)

    @face("P_bus")
    def demand(self, load: Electric) -> Mapping[str, Any]:
        """Publish the demand, which the control of a hybrid looks at."""
        return {"P_bus": load.P}

    def ask_battery(self, load: Electric, generator: Electric = NOTHING) -> Electric:
        """Return equation (1)."""
        return Electric(load.P - generator.P)

    def join(self, load: Electric, battery: Electric, generator: Electric = NOTHING) -> Electric:
        """Return what the load gets."""
        return Electric(ca.fmin(battery.P + generator.P, ca.fmax(load.P, 0)))
