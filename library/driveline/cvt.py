"""Transmission with a continuous ratio (CVT): a gearbox whose ratio the control sets.

The laws are those of a gearbox (`halfshaft.library.driveline.gearbox`, equation 1) with an efficiency ``e(omega_in, tau_out / G, G)``
at the ratio ``G`` of the moment::

    tau_loss = (1 - e) |tau_out| / (G e)  driving,   (1 - e) |tau_out| / G  braking      (1)

Left out: the torque that the change of the ratio itself takes of the rotors before it, but that of the engine.
"""

from __future__ import annotations

from dataclasses import dataclass

from halfshaft.library.base.component import From
from halfshaft.library.base.expressions import Direction, Turning, clip
from halfshaft.library.base.links import Link
from halfshaft.library.base.parameters import Parameters, param, params, table
from halfshaft.library.base.ports import Expr, Shaft
from halfshaft.library.base.tables import Axis, Table
from halfshaft.library.driveline.gearbox import _Gearbox


@dataclass(frozen=True, kw_only=True)
class CvtParameters(Parameters):
    """Range of ratios, inertia and efficiency."""

    ratios: tuple[float, ...] = params(
        "1", "ratios of input speed to output speed at the ends of the range, the highest first", ge=0.01, le=100
    )
    J: float = param("kg.m^2", "inertia at the input", 0.0, ge=0, le=100)
    speed_scale: float = param("1", "factor on the speeds of the efficiency", 1.0, ge=0.01, le=100)
    torque_scale: float = param("1", "factor on the torques of the efficiency", 1.0, ge=0.01, le=100)
    efficiency: Table = table(
        "1", "efficiency over input speed, lossless input torque and ratio", Axis("omega", "rad/s"), Axis("tau", "N.m"), Axis("ratio", "1"),
        clip=True, gt=0, le=1,
    )  # fmt: skip
    efficiency_scale: float = param("1", "factor on the efficiency, which stays below 1", 1.0, ge=0.01, le=100)


@dataclass(frozen=True)
class Cvt(_Gearbox):
    """Gearbox with a continuous ratio."""

    kind = "cvt"
    p: CvtParameters
    parameters = CvtParameters
    reads = (From("shift", ratio="1"),)

    def tau_loss(self, output: Shaft, G: Expr, gear: Expr, direction: Direction) -> Expr:
        """Return equation (1) [N.m]."""
        p = self.p

        def efficiency(tau: Expr) -> Expr:
            e = p.efficiency(output.omega * G / p.speed_scale, tau / G / p.torque_scale, G)
            return clip(p.efficiency_scale * e, 1e-3, 1)

        return direction.loss(output.tau, efficiency) / G

    def chain(self, ratio: Expr, turning: Turning, direction: Direction) -> tuple[Link, ...]:  # type: ignore[override]
        """Return the gearbox's links at the ratio; there are no gears."""
        return super().chain(ratio, 0.0, turning, direction)
