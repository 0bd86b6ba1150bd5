"""Generator with its controller, in a series hybrid; it works in one direction only.

::

    tau = min(tau_offered - J d omega/dt, tau_max(omega))                    (1)
    P   = max(0, min(f(tau, omega), I_max U_before))                         (2)

The control states the operating point of engine and generator; the generator passes it on to the engine as the
required point, and turns what the engine gives into electric power.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca

from halfshaft.library.base.component import ROTOR, Component, From, Signal, State, Variable, face, plant
from halfshaft.library.base.expressions import Turning, clip, where
from halfshaft.library.base.links import kinetic_rate
from halfshaft.library.base.parameters import Parameters, Rated, each, param, plain, table
from halfshaft.library.base.ports import Electric, Expr, Port, Shaft
from halfshaft.library.base.tables import Axis, Table

SPEED, TORQUE = Axis("omega", "rad/s"), Axis("tau", "N.m")


@dataclass(frozen=True, kw_only=True)
class GeneratorParameters(Parameters):
    """Map, limits and scales of a generator with its controller."""

    P_electric: Table = table("W", "electric output power", SPEED, TORQUE, clip=False)
    tau_max: Table = table("N.m", "largest torque", SPEED, clip=False)
    omega_max: float = param("rad/s", "highest speed", ge=1, le=1e5)
    J: float = param("kg.m^2", "rotor inertia", ge=0, le=100)
    overtorque: float = param("1", "short-time torque over continuous torque", 1.0, ge=0.01, le=100)
    I_max: float = param("A", "current limit of the controller", ge=0.1, le=1e9)
    speed_scale: float = param("1", "factor on all speeds", 1.0, ge=0.01, le=100)
    torque_scale: float = param("1", "factor on all torques", 1.0, ge=0.01, le=100, tag="follows source")
    mass: float = param("kg", "mass", 0.0, ge=0, le=1e5)

    rated: ClassVar[tuple[Rated, ...]] = (
        Rated("P_max", "W", "largest power at the shaft, overtorque included", "torque_scale", lambda p: peak_power(p)),
    )


def peak_power(p: GeneratorParameters) -> float:
    """Return the largest power of the envelope's points at the shaft, overtorque included [W]."""
    return plain(each(_peak, p.tau_max, p.omega_max) * p.overtorque * p.torque_scale * p.speed_scale)


def _peak(tau_max: Table, omega_max: float) -> float:
    omega = tau_max.points[0]
    return float((omega * tau_max.values)[omega <= omega_max].max())


@dataclass(frozen=True)
class Generator(Component):
    """Generator and controller between engine and bus."""

    kind = "generator"
    p: GeneratorParameters
    parameters = GeneratorParameters
    dc = Port(Electric, "wheel", tags={"P": "generated"})
    shaft = Port(Shaft, "source")
    states = (State("omega_before", "rad/s", "speed of the previous step", neutral=0.0),)
    variables = (
        Variable("P_loss", "W", "power lost", "loss"),
        *ROTOR,
    )
    signals = (Signal("J_shaft", "kg.m^2", "inertia that the engine turns beside its own"),)
    reads = (
        From("control", tau_genset="N.m", omega_genset="rad/s", clutch_open="1"),
        From("battery", U_supply="V"),
        From("engine", omega_engine="rad/s"),
    )

    @face("J_shaft")
    def law(self) -> Mapping[str, Any]:
        """Publish the rotor's inertia."""
        return {"J_shaft": self.p.J}

    def power(self, tau: Expr, omega: Expr) -> Expr:
        """Return the electric output power of the map [W]."""
        p = self.p
        scale = p.speed_scale * p.torque_scale
        return scale * p.P_electric(omega / p.speed_scale, tau / p.torque_scale)

    def tau_max(self, omega: Expr) -> Expr:
        """Return the largest torque [N.m]."""
        p = self.p
        return p.overtorque * p.torque_scale * p.tau_max(omega / p.speed_scale)

    @face("shaft")
    def required(self, tau_genset: Expr, omega_genset: Expr) -> Mapping[str, Any]:
        """Pass the commanded operating point on to the engine."""
        return {"shaft": Shaft(tau_genset, omega_genset, 0.0)}

    @face("dc", "P_loss", "P_kinetic", "P_discretisation", "next_omega_before")
    def available(self, shaft: Shaft, U_supply: Expr, omega_before: Expr, dt: Expr) -> Mapping[str, Any]:
        """Return the electric power that the offered shaft power gives, equations (1) and (2)."""
        p = self.p
        omega = clip(shaft.omega, 0, p.omega_max * p.speed_scale)
        tau_inertia = p.J * (shaft.omega - omega_before) / dt
        tau = ca.fmin(shaft.tau - tau_inertia, self.tau_max(omega))
        P = ca.fmax(0, ca.fmin(self.power(tau, omega), p.I_max * U_supply))
        kinetic = kinetic_rate(p.J, omega_before, shaft.omega, dt)
        return {
            "dc": Electric(P),
            "P_loss": (shaft.tau - tau_inertia) * shaft.omega - P,
            "P_kinetic": kinetic,
            "P_discretisation": tau_inertia * shaft.omega - kinetic,
            "next_omega_before": shaft.omega,
        }

    def audit(self, shaft: Shaft, dc: Electric, P_loss: Expr, P_kinetic: Expr, P_discretisation: Expr) -> Mapping[str, Any]:
        """Compare the electric power with the map at the torque that is left of the shaft's, equations (1) and (2)."""
        P_rotor = P_kinetic + P_discretisation
        turning = shaft.omega > 1e-6
        tau = where(turning, shaft.tau - P_rotor / where(turning, shaft.omega, 1), 0)
        return {
            "map": ca.fmax(dc.P - ca.fmax(0, self.power(tau, shaft.omega)), 0),
            "loss": P_loss - (shaft.P - P_rotor - dc.P),
        }

    @plant("shaft", "dc", "P_loss")
    def flow(self, tau_genset: Expr, clutch_open: Expr, omega_engine: Expr, turning: Turning) -> Mapping[str, Any]:
        """Return torque and power in continuous time: the commanded torque, at the engine's speed."""
        tau = where(clutch_open, 0, ca.fmin(tau_genset, self.tau_max(omega_engine))) * turning(omega_engine)
        P = where(clutch_open, 0, ca.fmax(0, self.power(tau, omega_engine)))
        return {"shaft": Shaft(tau, omega_engine, 0.0), "dc": Electric(P), "P_loss": tau * omega_engine - P}
