"""Torque coupler: joins an engine and a motor on one shaft, by gears, a belt or a chain.

With the motor's ratio ``n``::

    tau_out + tau_loss = tau_engine + n tau_motor                            (1)
    omega_motor        = n omega                                             (2)

The engine's side is asked for all of the torque first; the motor is asked for what it does not give, or takes what it gives too
much.  All turn together: as fast as the slowest.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from halfshaft.library.base.component import Signal, face, plant
from halfshaft.library.base.expressions import Turning
from halfshaft.library.base.junction import Junction, shared_speed
from halfshaft.library.base.links import Link, continuous, drag
from halfshaft.library.base.parameters import Parameters, param
from halfshaft.library.base.ports import Expr, Port, Shaft


@dataclass(frozen=True, kw_only=True)
class TorqueCouplerParameters(Parameters):
    """Ratio and loss of a torque coupler."""

    n: float = param("1", "ratio of the motor's speed to the engine's", ge=0.01, le=100)
    tau_loss: float = param("N.m", "drag torque at the output", 0.0, ge=0, le=1e4)


@dataclass(frozen=True)
class TorqueCoupler(Junction):
    """Coupler between a shaft toward the wheels, an engine's side and a motor."""

    kind = "torque-coupler"
    p: TorqueCouplerParameters
    parameters = TorqueCouplerParameters
    output = Port(Shaft, "wheel")
    engine = Port(Shaft, "source")
    motor = Port(Shaft, "source")
    signals = (
        Signal("n_motor", "1", "ratio of the motor's speed to that of the shaft"),
        Signal("tau_beside", "N.m", "torque that comes to the shaft from the motor"),
    )

    @face("n_motor")
    def law(self) -> Mapping[str, Any]:
        """Publish the motor's ratio, which the control of a hybrid looks at."""
        return {"n_motor": self.p.n}

    def chain(self, turning: Turning) -> tuple[Link, ...]:  # type: ignore[override]
        """Return the drag."""
        return (drag(lambda shaft: self.p.tau_loss * turning(shaft.omega)),)

    @plant("tau_beside")
    def beside(self, output: Shaft, tau_engine: Expr, turning: Turning) -> Mapping[str, Any]:
        """Publish what the motor gives in continuous time, which gives way before the engine where the tyres slip."""
        return {"tau_beside": continuous(self.chain(turning), output)[0].tau - tau_engine}

    def motor_speed(self, output: Shaft, engine: Shaft) -> Expr:
        """Return equation (2)."""
        return self.p.n * shared_speed(output, engine)

    def ask_engine(self, output: Shaft) -> Shaft:
        """Return all that is required."""
        return output

    def ask_motor(self, output: Shaft, engine: Shaft) -> Shaft:
        """Return equation (1) for the motor."""
        n = self.p.n
        return Shaft((output.tau - engine.tau) / n, self.motor_speed(output, engine), n * output.alpha)

    def join(self, output: Shaft, engine: Shaft, motor: Shaft) -> Shaft:
        """Return equation (1) for the output."""
        n = self.p.n
        turning = motor._replace(omega=motor.omega / n)
        return output._replace(tau=engine.tau + n * motor.tau, omega=shared_speed(output, engine, turning))
