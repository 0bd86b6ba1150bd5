"""Combustion engine, hot: inertia, limits, closed throttle, fuel map.

With the commanded speed ``omega_c`` of the control and the engine's own estimate ``omega``::

    tau_map = clip(tau_asked + J d omega/dt, tau_closed(omega), tau_max(omega))      (1)
    tau_out = tau_map - J d omega/dt
    fuel    = f(omega, tau_map) while on, else 0                                     (2)

Torques below the map's lowest are read at the lowest: an engine on overrun burns what it burns at the lowest load.
Behind an open clutch (or before a genset is ready) the engine spins by itself toward the commanded speed, by
``J d omega/dt = tau - tau_accessory``; the speed below idling is remembered, so that a later start begins there.
Geared to the wheels it follows them, after a missed trace at the speed actually reached (paper eq. 10).

The engine has one face: a source with limits has no way back.  Left out: cold running, emissions, turbo lag.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from halfshaft.library.component import Component, State, Variable, face, plant
from halfshaft.library.expressions import Turning, clip, where
from halfshaft.library.parameters import Parameters, param, table
from halfshaft.library.ports import Expr, Port, Shaft
from halfshaft.library.tables import Axis, Table

#: Time in which a governor of the forward-facing model would remove an error of speed [s].
GOVERNOR_TIME = 0.05
#: Fall below idling speed at which the idling governor opens the throttle fully [rad/s].
GOVERNOR_BAND = 10.0

SPEED, TORQUE = Axis("omega", "rad/s"), Axis("tau", "N.m")


@dataclass(frozen=True, kw_only=True)
class EngineParameters(Parameters):
    """Maps, limits, fuel and scales of an engine."""

    fuel: Table = table("kg/s", "fuel flow", SPEED, TORQUE, clip=True, ge=0)
    tau_max: Table = table("N.m", "largest torque", SPEED, clip=True)
    tau_closed: Table = table("N.m", "torque with closed throttle, negative", SPEED, clip=True)
    J: float = param("kg.m^2", "inertia", ge=0, le=100)
    rho_fuel: float = param("kg/m^3", "density of the fuel", ge=0.01, le=1e4)
    H_fuel: float = param("J/kg", "lower heating value of the fuel", ge=1e5, le=1e9)
    speed_scale: float = param("1", "factor on all speeds", 1.0, ge=0.01, le=100)
    torque_scale: float = param("1", "factor on all torques", 1.0, ge=0.01, le=100)
    efficiency_scale: float = param("1", "factor on the efficiency", 1.0, ge=0.01, le=100)
    mass: float = param("kg", "mass", 0.0, ge=0, le=1e5)


@dataclass(frozen=True)
class Engine(Component):
    """Engine behind a clutch or a generator."""

    p: EngineParameters
    parameters = EngineParameters
    shaft = Port(Shaft, "wheel")
    states = (
        State("omega_before", "rad/s", "speed of the previous step"),
        State("omega_free", "rad/s", "speed of the free engine, idling control left out"),
        State("command_before", "rad/s", "commanded speed of the previous step"),
        State("ratio_before", "1", "ratio of the gear in the previous step"),
        State("fuel_used", "kg", "fuel burnt", shown=True),
    )
    variables = (
        Variable("omega_engine", "rad/s", "speed of the engine", signal=True),
        Variable("throttle_engine", "1", "that torque between closed and open throttle", signal=True),
        Variable("tau_map", "N.m", "torque in the fuel map (eq. 1)"),
        Variable("fuel_flow", "kg/s", "fuel flow (eq. 2)"),
        Variable("P_fuel", "W", "power in the fuel", "fuel"),
        Variable("P_loss", "W", "power lost", "loss"),
        Variable("P_kinetic", "W", "rate of change of the rotor's kinetic energy", "kinetic"),
        Variable("P_discretisation", "W", "inertia work by difference quotients less that rate", "discretisation"),
        Variable("P_mismatch", "W", "power at the engine's own speed less that at the shaft", "mismatch"),
    )
    plant_states = ((State("omega_engine", "rad/s", "speed of the engine", signal=True), "omega_before"), (states[4], "fuel_used"))
    laws = ("tau_envelope", "engine")

    def start(self, omega_idle: Expr) -> Mapping[str, Any]:  # type: ignore[override]
        """Return the start values: idling."""
        idling = dict.fromkeys(("omega_before", "omega_free", "command_before"), omega_idle)
        return {**idling, "ratio_before": 1.0, "fuel_used": 0.0}

    @face("tau_envelope", "engine")
    def law(self) -> Mapping[str, Any]:
        """Publish the envelope, the highest speed and the largest torque and power."""
        return {"tau_envelope": self.tau_max, "engine": self}

    @property
    def omega_max(self) -> Expr:
        """Highest speed of the map [rad/s]."""
        return self.p.speed_scale * self.p.tau_max.inside(0)[1]

    @property
    def tau_largest(self) -> Expr:
        """Largest torque of the envelope [N.m]."""
        return self.p.torque_scale * float(self.p.tau_max.values.max())

    @property
    def P_largest(self) -> Expr:
        """Largest power of the envelope's points [W]."""
        return self.p.speed_scale * self.p.torque_scale * float((self.p.tau_max.values * self.p.tau_max.points[0]).max())

    def tau_max(self, omega: Expr) -> Expr:
        """Return the largest torque [N.m]."""
        return self.p.torque_scale * self.p.tau_max(omega / self.p.speed_scale)

    def tau_closed(self, omega: Expr) -> Expr:
        """Return the torque with closed throttle [N.m]."""
        return self.p.torque_scale * self.p.tau_closed(omega / self.p.speed_scale)

    def fuel_flow(self, tau: Expr, omega: Expr) -> Expr:
        """Return the fuel flow of a running engine, equation (2) [kg/s]."""
        p = self.p
        scale = p.speed_scale * p.torque_scale / p.efficiency_scale
        return scale * p.fuel(omega / p.speed_scale, tau / p.torque_scale)

    @face("omega_engine", "next_omega_before", "next_omega_free", "next_command_before", "next_ratio_before", "_tau_inertia", "_tau_shaft")
    def speed(
        self, omega_command: Expr, engine_on: Expr, omega_idle: Expr, clutch_open: Expr, dt: Expr,
        omega_before: Expr, omega_free: Expr, command_before: Expr, trace_missed: Expr, speed_ratio: Expr,
        ratio_before: Expr, clutch_slipping: Expr = 0.0, geared: Expr = 0.0, tau_accessory_before: Expr = 0.0,
        ratio: Expr = 1.0, J_shaft: Expr = 0.0,
    ) -> Mapping[str, Any]:  # fmt: skip
        """Estimate the engine's speed in this step."""
        J = ca.fmax(self.p.J + J_shaft, 1e-6)
        missed = ca.logic_and(trace_missed, geared)
        spin_up = ca.fmin(self.tau_max(omega_before), J * (omega_command - omega_before) / dt + tau_accessory_before)
        tau_free = where(omega_command >= omega_before, spin_up, self.tau_closed(omega_before))
        free = ca.fmax(omega_free + dt * (tau_free - tau_accessory_before) / J, 0)
        follows = ca.logic_and(missed, ca.logic_not(clutch_slipping))
        geared_speed = where(follows, command_before * speed_ratio * ratio / ratio_before, omega_command)
        omega = ca.fmax(ca.fmin(where(clutch_open, free, geared_speed), self.omega_max), omega_idle * engine_on)
        change = where(missed, ca.fmax(omega - omega_before, 0), omega - omega_before)
        return {
            "omega_engine": omega,
            "next_omega_before": omega,
            "next_omega_free": where(clutch_open, free, omega),
            "next_command_before": omega_command,
            "next_ratio_before": ratio,
            "_tau_inertia": self.p.J * change / dt,
            "_tau_shaft": where(clutch_open, J_shaft * change / dt, 0),
        }

    @face(
        "shaft", "throttle_engine", "tau_map", "fuel_flow", "P_fuel", "P_loss", "P_kinetic", "P_discretisation", "P_mismatch",
        "next_fuel_used",
    )  # fmt: skip
    def available(
        self, shaft: Shaft, omega_engine: Expr, omega_command: Expr, engine_on: Expr, clutch_open: Expr, dt: Expr,
        omega_before: Expr, fuel_used: Expr, _tau_inertia: Expr, _tau_shaft: Expr,
    ) -> Mapping[str, Any]:  # fmt: skip
        """Return the torque that the engine gives, equation (1), and the fuel that it burns, equation (2)."""
        omega, closed = omega_engine, self.tau_closed(omega_engine)
        driven = ca.logic_or(omega <= omega_command + 1e-9, ca.logic_not(clutch_open))
        # A genset that only spins turns its generator's rotor too.
        asked, highest = shaft.tau + _tau_shaft, self.tau_max(omega)
        tau_map = clip(where(driven, asked + _tau_inertia, closed), closed, highest)
        tau = where(clutch_open, asked, tau_map - _tau_inertia)
        # Behind an open clutch the shaft is the engine's own, and carries the accessories only.
        omega_shaft = where(clutch_open, omega, shaft.omega)
        flow = where(engine_on, self.fuel_flow(tau_map, omega), 0)
        P_fuel = flow * self.p.H_fuel
        kinetic = self.p.J * (omega**2 - omega_before**2) / (2 * dt)
        return {
            "shaft": Shaft(tau, omega_shaft, shaft.alpha),
            "throttle_engine": (tau_map - closed) / (highest - closed),
            "tau_map": tau_map,
            "fuel_flow": flow,
            "P_fuel": P_fuel,
            "P_loss": P_fuel - tau_map * omega,
            "P_kinetic": kinetic,
            "P_discretisation": _tau_inertia * omega - kinetic,
            "P_mismatch": (tau_map - _tau_inertia) * omega - tau * omega_shaft,
            "next_fuel_used": fuel_used + dt * flow,
        }

    def audit(
        self, shaft: Shaft, omega_engine: Expr, tau_map: Expr, P_fuel: Expr, P_loss: Expr, P_kinetic: Expr, P_discretisation: Expr,
        fuel_used: Expr, next_fuel_used: Expr, dt: Expr, engine_on: Expr, clutch_open: Expr,
    ) -> Mapping[str, Any]:  # fmt: skip
        """Compare fuel and torque with the map, equation (2), and with what shaft and rotor took, equation (1)."""
        fuel = where(engine_on, self.p.H_fuel * self.fuel_flow(tau_map, omega_engine), 0)
        taken = shaft.tau * omega_engine + P_kinetic + P_discretisation
        return {
            "fuel map": P_fuel - fuel,
            "fuel burnt": P_fuel - self.p.H_fuel * (next_fuel_used - fuel_used) / dt,
            "loss": P_loss - fuel + tau_map * omega_engine,
            "torque at the shaft": where(clutch_open, 0, tau_map * omega_engine - taken),
        }

    @plant("der_omega_engine", "der_fuel_used", "tau_map", "P_fuel", "P_loss", "P_kinetic")
    def flow(
        self, shaft: Shaft, omega_engine: Expr, throttle_engine: Expr, omega_command: Expr, omega_idle: Expr, engine_on: Expr,
        clutch_open: Expr, turning: Turning, clutch_slipping: Expr = 0.0, geared: Expr = 0.0, J_shaft: Expr = 0.0,
    ) -> Mapping[str, Any]:  # fmt: skip
        """Return the engine's motion in continuous time.

        Geared to the wheels it follows the throttle, and a governor keeps it from falling below idling speed.  Else a
        governor holds the commanded speed: the load's torque, plus one in proportion to the error.
        """
        closed, highest = self.tau_closed(omega_engine) * turning(omega_engine), self.tau_max(omega_engine)
        J = ca.fmax(self.p.J + J_shaft, 1e-3)

        def governed(omega: Expr) -> Expr:
            return clip(shaft.tau + J / GOVERNOR_TIME * (omega - omega_engine), closed, highest)

        by_throttle = ca.logic_and(geared, ca.logic_not(ca.logic_or(clutch_open, clutch_slipping)))
        idling = clip((omega_idle - omega_engine) / GOVERNOR_BAND, 0, 1)
        pedal = closed + ca.fmax(throttle_engine, idling) * (highest - closed)
        tau = where(engine_on, where(by_throttle, pedal, governed(omega_command)), closed)
        flow = where(engine_on, self.fuel_flow(tau, omega_engine), 0)
        alpha = (tau - shaft.tau) / J
        return {
            "der_omega_engine": alpha,
            "der_fuel_used": flow,
            "tau_map": tau,
            "P_fuel": flow * self.p.H_fuel,
            "P_loss": flow * self.p.H_fuel - tau * omega_engine,
            "P_kinetic": J * alpha * omega_engine,
        }
