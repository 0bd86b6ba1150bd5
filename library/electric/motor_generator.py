"""Motor-generator: a motor that turns both ways, and does either as often as it drives or brakes.

The law is that of the motor (`halfshaft.library.electric.motor`); turning backward the machine is its own mirror image.  Its
speed is set by what it is geared to, not by the vehicle alone, so the speed that equation (10) would estimate after a missed
trace has no meaning here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from halfshaft.library.base.component import From, Variable, plant
from halfshaft.library.base.expressions import Turning, where
from halfshaft.library.base.links import Link, continuous
from halfshaft.library.base.parameters import param
from halfshaft.library.base.ports import Electric, Expr, Port, Shaft
from halfshaft.library.electric.motor import Motor, MotorParameters


def mirror(shaft: Shaft) -> Shaft:
    """Return the point as it looks from the side from which the machine turns forward."""
    facing = where(shaft.omega < 0, -1, 1)
    return Shaft(*(facing * x for x in shaft))


def back(asked: Shaft, sent: Shaft, offered: Shaft) -> Shaft:
    """Return an offered point turned round again."""
    facing = where(asked.omega < 0, -1, 1)
    return Shaft(*(facing * x for x in offered))


@dataclass(frozen=True, kw_only=True)
class MotorGeneratorParameters(MotorParameters):
    """Maps, limits and scales of a machine that turns forward; backward they are mirrored."""

    torque_scale: float = param("1", "factor on all torques", 1.0, ge=0.01, le=100, tag="follows source")

    def ratings(self) -> Mapping[str, float]:
        """Return nothing: it is not there to drive the vehicle."""
        return {}


@dataclass(frozen=True)
class MotorGenerator(Motor):
    """Motor and controller that run from the highest speed backward to the highest forward."""

    kind = "motor-generator"
    p: MotorGeneratorParameters
    parameters = MotorGeneratorParameters
    dc = Port(Electric, "source")
    states = ()
    variables = (
        Variable("tau_limited", "N.m", "required torque with inertia, after the envelope, seen from where it turns forward"),
        Variable("throttle_motor", "1", "that torque over the envelope, positive if it drives forward or brakes backward", signal=True),
        Variable("P_map", "W", "electric power of the map, before the current limit"),
        Variable("tau_able", "N.m", "torque at the shaft within the envelope", signal=True),
    )
    reads = (
        From("battery", U_supply="V"),
        From("battery", U="V"),
        From("node", P_spare_out="W", P_spare_in="W"),
    )
    estimates = False

    def chain(self, U_supply: Expr, turning: Turning) -> tuple[Link, ...]:  # type: ignore[override]
        """Return the motor's links behind a mirror."""
        return (Link(mirror, back, "", name="mirror"), *super().chain(0, 0, 0, U_supply, turning))

    def found(self, way: Mapping[str, tuple[Shaft, Shaft]]) -> Mapping[str, Any]:
        """Return the throttle, and what the machine can give if it gets the power, both in the sense of the shaft."""
        asked, facing = way["mirror"][0], where(way["mirror"][0].omega < 0, -1, 1)
        return {
            "throttle_motor": facing * super().found(way)["throttle_motor"],
            "tau_able": facing * way["map"][0].tau - self.p.J * asked.alpha,
        }

    @plant("dc", "P_loss", "P_kinetic", "_tau", "_omega", "_P")
    def flow(self, shaft: Shaft, turning: Turning) -> Mapping[str, Any]:
        """Return the electric power that the motion needs, in continuous time."""
        power, booked = continuous(self.chain(0, turning), shaft)
        tau = shaft.tau + self.p.J * shaft.alpha
        return {"dc": power, "P_loss": booked.loss, "P_kinetic": booked.kinetic, "_tau": tau, "_omega": shaft.omega, "_P": power.P}

    @plant("balance")
    def drive(
        self, _tau: Expr, _omega: Expr, _P: Expr, throttle_motor: Expr, P_spare_out: Expr, P_spare_in: Expr, U: Expr
    ) -> Mapping[str, Any]:
        """Say when the machine gives what the motion needs: the throttle's torque, or less where power or current end."""
        facing = where(_omega < 0, -1, 1)
        return {"balance": self.short(facing * _tau, ca.fabs(_omega), _P, facing * throttle_motor, P_spare_out, P_spare_in, U)}
