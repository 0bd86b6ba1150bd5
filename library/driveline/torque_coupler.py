"""Torque coupler: joins an engine and a motor on one shaft, by gears, a belt or a chain.

With the motor's ratio ``n``::

    tau_out + tau_loss = tau_engine + n tau_motor                            (1)
    omega_motor        = n omega                                             (2)

The engine's side is asked first; the motor is asked for what it does not give, or takes what it gives too much.  On a shaft toward
the wheels all turn together: as fast as the slowest.  A machine on the crankshaft turns with the engine, also behind an open clutch;
there the engine is asked for what the control does not want of the machine.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca

from halfshaft.library.base.component import From, Signal, face
from halfshaft.library.base.expressions import Turning, where
from halfshaft.library.base.junction import Junction, shared_speed
from halfshaft.library.base.links import Link, drag
from halfshaft.library.base.parameters import Parameters, param
from halfshaft.library.base.ports import Expr, Port, Shaft
from halfshaft.library.electric.motor import Motor

#: Where the tyres slip, neither clutch nor motor knows which of both gives way; this share of what each lacks decides it.
FORGIVEN = 1e-3


@dataclass(frozen=True, kw_only=True)
class TorqueCouplerParameters(Parameters):
    """Ratio and loss of a torque coupler."""

    n: float = param("1", "ratio of the motor's speed to the engine's", ge=0.01, le=100)
    tau_loss: float = param("N.m", "drag torque at the output", 0.0, ge=0, le=1e4)


@dataclass(frozen=True)
class _Coupler(Junction):
    """What all couplers share."""

    p: TorqueCouplerParameters
    parameters = TorqueCouplerParameters
    output = Port(Shaft, "wheel")
    engine = Port(Shaft, "source")
    motor = Port(Shaft, "source")
    signals: ClassVar[tuple[Signal, ...]] = (Signal("n_motor", "1", "ratio of the motor's speed to that of the shaft"),)

    @face("n_motor")
    def law(self) -> Mapping[str, Any]:
        """Publish the motor's ratio, which the control of a hybrid looks at."""
        return {"n_motor": self.p.n}

    def chain(self, turning: Turning) -> tuple[Link, ...]:  # type: ignore[override]
        """Return the drag."""
        return (drag(lambda shaft: self.p.tau_loss * turning(shaft.omega)),)

    def rest(self, output: Shaft, engine: Shaft) -> Expr:
        """Return equation (1) for the motor."""
        return (output.tau - engine.tau) / self.p.n

    def join(self, output: Shaft, engine: Shaft, motor: Shaft) -> Shaft:
        """Return equation (1) for the output."""
        n = self.p.n
        return output._replace(tau=engine.tau + n * motor.tau, omega=shared_speed(output, engine, motor._replace(omega=motor.omega / n)))


@dataclass(frozen=True)
class TorqueCoupler(_Coupler):
    """Coupler on a shaft toward the wheels."""

    kind = "torque-coupler"
    signals = (*_Coupler.signals, Signal("grip_forgiven", "1", "share of a missing torque that the balance of each side forgives the grip"))

    @face("n_motor", "grip_forgiven")
    def law(self) -> Mapping[str, Any]:
        """Publish the motor's ratio, and how both sides share what the tyres hold."""
        return {"n_motor": self.p.n, "grip_forgiven": FORGIVEN}

    def ask_engine(self, output: Shaft) -> Shaft:
        """Return all that is required."""
        return output

    def ask_motor(self, output: Shaft, engine: Shaft) -> Shaft:
        """Return equations (1) and (2) for the motor."""
        n = self.p.n
        return Shaft(self.rest(output, engine), n * shared_speed(output, engine), n * output.alpha)


@dataclass(frozen=True)
class CrankshaftCoupler(_Coupler):
    """Machine on the crankshaft, between clutch and engine, which also starts the engine."""

    kind = "crankshaft-coupler"
    signals = (
        *_Coupler.signals,
        Signal("tau_machine_largest", "N.m", "largest torque that the machine can add at the crankshaft"),
        Signal("J_machine", "kg.m^2", "inertia of the machine at the crankshaft"),
    )
    reads = (
        From("control", tau_machine="N.m", clutch_open="1"),
        From("machine", Motor, along=("motor",)),
        From("engine", omega_engine="rad/s"),
    )

    @face("n_motor", "tau_machine_largest", "J_machine")
    def law(self, machine: Motor) -> Mapping[str, Any]:
        """Publish the motor's ratio, its largest torque and its inertia."""
        n, p = self.p.n, machine.p
        return {"n_motor": n, "tau_machine_largest": n * p.overtorque * machine.tau_largest, "J_machine": n**2 * p.J}

    def ask_engine(self, output: Shaft, tau_machine: Expr) -> Shaft:
        """Return what is not wanted of the machine."""
        return output._replace(tau=output.tau - tau_machine)

    def ask_motor(self, output: Shaft, engine: Shaft, clutch_open: Expr, omega_engine: Expr) -> Shaft:
        """Return equations (1) and (2) for the machine.

        Behind an open clutch nothing says how fast the shaft gains speed.  Where the engine is at its top speed, and not only asked to
        turn faster, the machine does not drive it beyond.
        """
        n, tau = self.p.n, self.rest(output, engine)
        at_top = ca.logic_and(output.omega - engine.omega > 1e-6, omega_engine > engine.omega * (1 - 1e-9))
        beyond = ca.logic_and(ca.logic_not(clutch_open), at_top)
        return Shaft(where(beyond, ca.fmin(tau, 0), tau), n * engine.omega, where(clutch_open, 0, n * output.alpha))
