"""Two driven axles, each with a driveline of its own.

The divider gives each axle the share of the wheels' torque that its load is of both loads, so that both come to the grip of
their tyres at the same force; both turn equally fast.  What one axle's machine cannot give the other is not asked for: both
are asked at once.  In the forward-facing model the machines decide; what the front one brings is an algebraic unknown.

The original's rear branch subtracts the rear friction brakes twice; here the driveline's share of a braking force is split like
a driving one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from halfshaft.library.base.component import From, Signal, plant
from halfshaft.library.base.expressions import where
from halfshaft.library.base.junction import Junction, shared_speed
from halfshaft.library.base.links import Link, TwoSided
from halfshaft.library.base.parameters import Parameters, param
from halfshaft.library.base.ports import Expr, Port, Shaft


@dataclass(frozen=True, kw_only=True)
class AxleDividerParameters(Parameters):
    """A divider has no parameters: the loads decide."""


@dataclass(frozen=True)
class AxleDivider(Junction):
    """Divides the wheels' torque between the drivelines of two axles."""

    kind = "axle-divider"
    p: AxleDividerParameters
    parameters = AxleDividerParameters
    output = Port(Shaft, "wheel")
    front = Port(Shaft, "source")
    rear = Port(Shaft, "source")
    reads = (From("wheel", share_front="1"),)

    def ask_front(self, output: Shaft, share_front: Expr) -> Shaft:
        """Return the front axle's share."""
        return output._replace(tau=share_front * output.tau)

    def ask_rear(self, output: Shaft, share_front: Expr) -> Shaft:
        """Return the rest."""
        return output._replace(tau=output.tau - share_front * output.tau)

    def join(self, output: Shaft, front: Shaft, rear: Shaft) -> Shaft:
        """Return both torques at the speed of the slower axle."""
        return Shaft(front.tau + rear.tau, shared_speed(output, front, rear), output.alpha)

    @plant("front", "rear", "P_loss")
    def flow(self, output: Shaft, tau_front: Expr) -> Mapping[str, Any]:
        """Return the unknown torque, and the rest."""
        return {"front": output._replace(tau=tau_front), "rear": output._replace(tau=output.tau - tau_front), "P_loss": 0}


@dataclass(frozen=True, kw_only=True)
class AxleParameters(Parameters):
    """Which axle it is."""

    rear: float = param("1", "1 for the rear axle, 0 for the front axle", ge=0, le=1)


@dataclass(frozen=True)
class Axle(TwoSided):
    """One of two driven axles: passes all on, and knows the grip of its own tyres."""

    kind = "axle"
    p: AxleParameters
    parameters = AxleParameters
    output = Port(Shaft, "wheel")
    input = Port(Shaft, "source")
    signals = (
        Signal("tau_grip_out", "N.m", "what the axle may drive more before its tyres slip"),
        Signal("tau_grip_in", "N.m", "what it may brake more"),
    )
    reads = (From("wheel", tau_front_out="N.m", tau_front_in="N.m", tau_rear_out="N.m", tau_rear_in="N.m"),)

    def chain(self) -> tuple[Link, ...]:
        """Return no link."""
        return ()

    @plant("tau_grip_out", "tau_grip_in")
    def grip(self, output: Shaft, tau_front_out: Expr, tau_front_in: Expr, tau_rear_out: Expr, tau_rear_in: Expr) -> Mapping[str, Any]:
        """Return how far the axle is from its grip."""
        return {
            "tau_grip_out": where(self.p.rear, tau_rear_out, tau_front_out) - output.tau,
            "tau_grip_in": where(self.p.rear, tau_rear_in, tau_front_in) + output.tau,
        }
