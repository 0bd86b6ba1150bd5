"""Final drive: a fixed ratio with a constant drag torque and an inertia, both at its input.

::

    omega_in = i omega_out
    tau_in   = tau_out / i + tau_loss + J alpha_in                           (1)

The same loss torque and the required inertia torque act on the way back.
"""

from __future__ import annotations

from dataclasses import dataclass

from halfshaft.library.base.expressions import Turning
from halfshaft.library.base.links import Link, TwoSided, drag, inertia, ratio
from halfshaft.library.base.parameters import Parameters, param
from halfshaft.library.base.ports import Port, Shaft


@dataclass(frozen=True, kw_only=True)
class FinalDriveParameters(Parameters):
    """Ratio and losses of a final drive."""

    i: float = param("1", "ratio of input speed to output speed", ge=0.01, le=100, tag="final ratio")
    tau_loss: float = param("N.m", "drag torque at the input", 0.0, ge=0, le=1e4)
    J: float = param("kg.m^2", "inertia at the input", 0.0, ge=0, le=100)


@dataclass(frozen=True)
class FinalDrive(TwoSided):
    """Fixed gear between axle and gearbox."""

    kind = "final-drive"
    p: FinalDriveParameters
    parameters = FinalDriveParameters
    output = Port(Shaft, "wheel")
    input = Port(Shaft, "source")

    def chain(self, turning: Turning) -> tuple[Link, ...]:  # type: ignore[override]
        """Return equation (1)."""
        return (ratio(self.p.i), drag(lambda shaft: self.p.tau_loss * turning(shaft.omega)), inertia(self.p.J))
