"""Propeller shaft: a constant drag torque and an inertia.

``tau_in = tau_out + tau_loss + J alpha`` while it turns.
"""

from dataclasses import dataclass

from halfshaft.library.base.links import TwoSided, drag, inertia
from halfshaft.library.base.parameters import Parameters, param
from halfshaft.library.base.ports import Port, Shaft


@dataclass(frozen=True, kw_only=True)
class PropshaftParameters(Parameters):
    """Drag and inertia of a propeller shaft."""

    tau_loss: float = param("N.m", "drag torque", ge=0, le=100)
    J: float = param("kg.m^2", "inertia", 0.0, ge=0, le=100)


@dataclass(frozen=True)
class Propshaft(TwoSided):
    """Shaft between gearbox and final drive."""

    kind = "propshaft"
    p: PropshaftParameters
    parameters = PropshaftParameters
    output = Port(Shaft, "wheel")
    input = Port(Shaft, "source")

    def chain(self, turning):
        """Return drag and inertia."""
        return drag(lambda shaft: self.p.tau_loss * turning(shaft.omega)), inertia(self.p.J)
