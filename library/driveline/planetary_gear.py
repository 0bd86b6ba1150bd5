"""Planetary gear of a power split: ring toward the wheel, carrier at the engine, sun at the generator; a motor on the ring.

With the numbers of teeth ``r`` and ``s`` of ring and sun, and neither mass nor loss::

    omega_sun = (1 + r/s) omega_carrier - r/s omega_ring                     (1)
    tau_sun   = -s/(r + s) tau_carrier                                       (2)
    tau_motor = tau_load + r/s tau_sun,       omega_motor = omega_ring       (3)

all torques as they drive the gear.  The engine is asked first, at the point that the control commands; then the generator, by
what the engine offers; then the motor, by what the generator is able to hold.  On the way back (3) gives the torque of the load,
at the speed of the motor; what the engine offers beyond (2) is booked as mismatch.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from halfshaft.library.base.component import From, Signal, State, face, plant
from halfshaft.library.base.expressions import where
from halfshaft.library.base.junction import Junction
from halfshaft.library.base.parameters import Parameters, param
from halfshaft.library.base.ports import Expr, Port, Shaft


@dataclass(frozen=True, kw_only=True)
class PlanetaryGearParameters(Parameters):
    """Teeth of the gear."""

    r: float = param("1", "teeth of the ring", ge=1, le=1e4)
    s: float = param("1", "teeth of the sun", ge=1, le=1e4)


@dataclass(frozen=True)
class PlanetaryGear(Junction):
    """Planetary gear with the motor's shaft on its ring."""

    kind = "planetary-gear"
    p: PlanetaryGearParameters
    parameters = PlanetaryGearParameters
    ring = Port(Shaft, "wheel")
    carrier = Port(Shaft, "source")
    sun = Port(Shaft, "source")
    motor = Port(Shaft, "source")
    states = (
        State("omega_reached", "rad/s", "speed that the ring's shaft had reached at the end of the previous step"),
        State("alpha_reached", "rad/s^2", "its acceleration in the previous step"),
    )
    signals = (
        Signal("braked", "1", "whether the vehicle may brake with the engine"),
        Signal("tau_ring", "N.m", "required torque at the ring's shaft"),
        Signal("omega_ring", "rad/s", "required speed of the ring's shaft"),
        Signal("omega_ring_turning", "rad/s", "the same, after a missed trace what was reached"),
    )
    #: The sun's torque follows from the carrier's.
    free = ("carrier",)
    reads = (
        From("body", trace_missed="1", next_speed_ratio="1"),
        From("control", tau_command="N.m", omega_command="rad/s"),
        From("engine", omega_engine="rad/s", along=("carrier",)),
        From("generator", tau_able="N.m", along=("sun",)),
    )

    @face("braked")
    def law(self) -> Mapping[str, Any]:
        """Say that the vehicle may brake with the engine."""
        return {"braked": 1.0}

    @property
    def share(self) -> Expr:
        """Share of the carrier's torque that the ring gets."""
        return self.p.r / (self.p.r + self.p.s)

    def omega_sun(self, carrier: Expr, ring: Expr) -> Expr:
        """Return equation (1), of speeds or of accelerations."""
        i = self.p.r / self.p.s
        return (1 + i) * carrier - i * ring

    def omega_carrier(self, sun: Expr, ring: Expr) -> Expr:
        """Return the speed of the carrier at which sun and ring turn as given [rad/s]."""
        return self.share * ring + (1 - self.share) * sun

    def turning(self, ring: Shaft, trace_missed: Expr, omega_reached: Expr, alpha_reached: Expr) -> Shaft:
        """Return the ring's point as it turns: as required, after a missed trace as it was reached (paper eq. 10)."""
        return Shaft(ring.tau, where(trace_missed, omega_reached, ring.omega), where(trace_missed, alpha_reached, ring.alpha))

    @face("tau_ring", "omega_ring", "omega_ring_turning")
    def demand(self, ring: Shaft, trace_missed: Expr, omega_reached: Expr, alpha_reached: Expr) -> Mapping[str, Any]:
        """Publish the demand, which the control looks at."""
        turning = self.turning(ring, trace_missed, omega_reached, alpha_reached)
        return {"tau_ring": ring.tau, "omega_ring": ring.omega, "omega_ring_turning": turning.omega}

    @face("next_omega_reached", "next_alpha_reached")
    def remember(self, motor: Shaft, next_speed_ratio: Expr, omega_reached: Expr, dt: Expr) -> Mapping[str, Any]:
        """Keep what the ring has come to."""
        reached = motor.omega * next_speed_ratio
        return {"next_omega_reached": reached, "next_alpha_reached": (reached - omega_reached) / dt}

    def ask_carrier(self, tau_command: Expr, omega_command: Expr) -> Shaft:
        """Return the commanded point of the engine."""
        return Shaft(tau_command, omega_command, 0.0)

    def sun_of(self, ring: Shaft, carrier: Shaft) -> Shaft:
        """Return equations (1) and (2)."""
        omega, alpha = (self.omega_sun(getattr(carrier, f), getattr(ring, f)) for f in ("omega", "alpha"))
        return Shaft(-(1 - self.share) * carrier.tau, omega, alpha)

    def ask_sun(self, ring: Shaft, carrier: Shaft, trace_missed: Expr, omega_reached: Expr, alpha_reached: Expr) -> Shaft:
        """Return equations (1) and (2)."""
        return self.sun_of(self.turning(ring, trace_missed, omega_reached, alpha_reached), carrier)

    def ask_motor(self, ring: Shaft, tau_able: Expr) -> Shaft:
        """Return equation (3)."""
        return ring._replace(tau=ring.tau + self.p.r / self.p.s * tau_able)

    def join(self, ring: Shaft, sun: Shaft, motor: Shaft) -> Shaft:
        """Return equation (3), turned round."""
        return Shaft(motor.tau - self.p.r / self.p.s * sun.tau, motor.omega, ring.alpha)

    @plant("carrier")
    def divide(self, tau_carrier: Expr, omega_engine: Expr) -> Mapping[str, Any]:
        """Return the torque that the carrier takes at the speed of the engine."""
        return {"carrier": Shaft(tau_carrier, omega_engine, 0.0)}

    @plant("sun", "motor", "P_loss")
    def flow(self, ring: Shaft, carrier: Shaft) -> Mapping[str, Any]:
        """Return equations (1) to (3) in continuous time, at the speed and acceleration of the engine."""
        sun = self.sun_of(ring, carrier)
        motor = self.ask_motor(ring, sun.tau)
        return {"sun": sun, "motor": motor, "P_loss": carrier.P + sun.P + motor.P - ring.P}
