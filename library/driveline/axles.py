"""Two driven axles, each with a driveline of its own.

The divider gives each axle the share of the wheels' torque that its load is of both loads, so that both come to the grip of
their tyres at the same force; both turn equally fast.  What is beyond the envelope of one axle's machine, driving or braking, the
other is asked for, as far as its tyres hold it: ::

    tau_front = share tau - (what the rear one takes of it) + (what it takes of the rear one's share)        (1)

Envelopes alone decide: what power the battery has follows from what both axles ask for, and both bear its limits.  In the
forward-facing model the machines decide; what the front one brings is an algebraic unknown.  Where the battery cannot feed both
there, they divide its power so that both axles use the same share of their grip: by the loads, as in the step.

The original's rear branch subtracts the rear friction brakes twice; here the driveline's share of a braking force is split like
a driving one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import casadi as ca

from halfshaft.library.base.component import From, Signal, face, plant
from halfshaft.library.base.expressions import clip, where
from halfshaft.library.base.junction import Junction, shared_speed
from halfshaft.library.base.links import Link, TwoSided
from halfshaft.library.base.parameters import Parameters, param
from halfshaft.library.base.ports import Expr, Port, Shaft

#: What a point asked of an axle would ask of the rotor, and what is left of that within the envelope.
Drive: TypeAlias = Callable[[Shaft], Mapping[str, Expr]]


def beyond(drive: Drive | None, asked: Shaft) -> Expr:
    """Return how much of a torque asked of an axle is beyond the envelope of its machine, if there is one."""
    if drive is None:
        return 0

    def rotor(tau: Expr) -> Expr:
        return drive(asked._replace(tau=tau))["tau_rotor"]

    found = drive(asked)
    tau, tau_rotor, limit = asked.tau, found["tau_rotor"], found["tau_limited"]
    # Secants from the same share of both torques on: one finds the limit where losses are straight over torque, three where they
    # have a kink between; on an efficiency map three leave nothing that the refined mode, whose limit is sharp, would notice.
    # An axle is at most relieved of its share, not driven by the other one; where its losses turn the rotor's torque round, not even that.
    lowest, highest = ca.fmin(tau, 0), ca.fmax(tau, 0)
    before, at_before, reached = tau, tau_rotor, tau * limit / where(tau_rotor != 0, tau_rotor, 1)
    for _ in range(3):
        at = rotor(reached)
        slope = (reached - before) / where(at != at_before, at - at_before, 1)
        before, at_before, reached = reached, at, clip(reached + slope * (limit - at), lowest, highest)
    return where(ca.logic_or(tau_rotor == limit, tau * tau_rotor <= 0), 0, tau - reached)


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
    reads = (
        From("wheel", share_front="1", tau_front_out="N.m", tau_front_in="N.m", tau_rear_out="N.m", tau_rear_in="N.m"),
        From("drive_front", along=("front",), tried=True, optional=True, tau_rotor="N.m", tau_limited="N.m"),
        From("drive_rear", along=("rear",), tried=True, optional=True, tau_rotor="N.m", tau_limited="N.m"),
    )

    @face("_tau_front")
    def divide(
        self, output: Shaft, share_front: Expr, tau_front_out: Expr, tau_front_in: Expr, tau_rear_out: Expr, tau_rear_in: Expr,
        drive_front: Drive | None = None, drive_rear: Drive | None = None,
    ) -> Mapping[str, Any]:  # fmt: skip
        """Return equation (1)."""
        front = output._replace(tau=share_front * output.tau)
        rear = output._replace(tau=output.tau - front.tau)
        to_rear = clip(beyond(drive_front, front), -ca.fmax(tau_rear_in + rear.tau, 0), ca.fmax(tau_rear_out - rear.tau, 0))
        to_front = clip(beyond(drive_rear, rear), -ca.fmax(tau_front_in + front.tau, 0), ca.fmax(tau_front_out - front.tau, 0))
        return {"_tau_front": front.tau - to_rear + to_front}

    def ask_front(self, output: Shaft, _tau_front: Expr) -> Shaft:
        """Return what the front axle shall bring."""
        return output._replace(tau=_tau_front)

    def ask_rear(self, output: Shaft, _tau_front: Expr) -> Shaft:
        """Return the rest."""
        return output._replace(tau=output.tau - _tau_front)

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
        Signal("P_lack_out", "W", "what both axles would drive more, were the tyres of both as far from their grip"),
        Signal("P_lack_in", "W", "what both would brake more"),
    )
    reads = (From("wheel", tau_front_out="N.m", tau_front_in="N.m", tau_rear_out="N.m", tau_rear_in="N.m"),)

    def chain(self) -> tuple[Link, ...]:
        """Return no link."""
        return ()

    @plant("tau_grip_out", "tau_grip_in", "P_lack_out", "P_lack_in")
    def grip(self, output: Shaft, tau_front_out: Expr, tau_front_in: Expr, tau_rear_out: Expr, tau_rear_in: Expr) -> Mapping[str, Any]:
        """Return how far the axle is from its grip."""
        out, into = where(self.p.rear, tau_rear_out, tau_front_out), where(self.p.rear, tau_rear_in, tau_front_in)
        omega = ca.fmax(ca.fabs(output.omega), 1)
        return {
            "tau_grip_out": out - output.tau,
            "tau_grip_in": into + output.tau,
            "P_lack_out": (1 - output.tau / ca.fmax(out, 1)) * (tau_front_out + tau_rear_out) * omega,
            "P_lack_in": (1 + output.tau / ca.fmax(into, 1)) * (tau_front_in + tau_rear_in) * omega,
        }
