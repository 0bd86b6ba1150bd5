"""Combustion engine, hot: inertia, limits, closed throttle, fuel map.

With the speed ``omega`` in this step, the speed ``omega_own`` that the rotor has reached, and the acceleration ``alpha``
that the vehicle (of a genset: the command) asks of it::

    tau_out = tau_asked                                     if tau_asked + J alpha <= tau_max
            = tau_asked tau_max / (tau_asked + J alpha)     else: load and rotor get the same share        (1)
    tau_map = clip(tau_asked + J (omega - omega_own) / dt, tau_closed, tau_max)                            (2)
    d omega_own / dt = (tau_map - tau_out) / J                                                             (3)
    fuel    = f(omega, tau_map) while on, else 0                                                           (4)

Equation (1) solves the step for the acceleration that the torque allows, so that steps may be as short as one likes: the
inertia torque of an acceleration that is out of reach would stall the car.  Where gear or clutch make the speed jump, the
rotor follows with the torque that driving leaves, over several steps if these are short.

Torques below the map's lowest are read at the lowest: an engine on overrun burns what it burns at the lowest load.
Behind an open clutch (or before a genset is ready) the engine spins by itself toward the commanded speed, by
``J d omega/dt = tau - tau_accessory``; the speed below idling is remembered, so that a later start begins there.
Geared to the wheels it follows them, after a missed trace at the speed actually reached (paper eq. 10), and holds them
to its top speed.

A source with limits has no way back: *speed* says how fast it turns, *torque* what it gives, *burn* what that costs.  Left
out: cold running, emissions, turbo lag.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from halfshaft.library.base.component import ROTOR, Component, From, State, Variable, face, plant
from halfshaft.library.base.expressions import LIFTED, Turning, clip, lifted, where
from halfshaft.library.base.interfaces import Machine
from halfshaft.library.base.links import kinetic_rate
from halfshaft.library.base.parameters import Parameters, Rated, Relation, each, param, plain, table
from halfshaft.library.base.ports import Expr, Port, Shaft
from halfshaft.library.base.tables import Axis, Table

#: Time in which a governor of the forward-facing model would remove an error of speed [s].
GOVERNOR_TIME = 0.05
#: Fall below idling speed at which the idling governor opens the throttle fully [rad/s].
GOVERNOR_BAND = 10.0
#: Share of the top speed over which the torque of the forward-facing model fades below it.
FADE = 0.005

SPEED, TORQUE = Axis("omega", "rad/s"), Axis("tau", "N.m")


@dataclass(frozen=True, kw_only=True)
class EngineParameters(Parameters):
    """Maps, limits, fuel and scales of an engine."""

    fuel: Table = table("kg/s", "fuel flow", SPEED, TORQUE, clip=True, ge=0)
    tau_max: Table = table("N.m", "largest torque", SPEED, clip=True)
    tau_closed: Table = table("N.m", "torque with closed throttle, negative", SPEED, clip=True)
    J: float = param("kg.m^2", "inertia", ge=0, le=100)
    rho_fuel: float = param("kg/m^3", "density of the fuel", ge=0.01, le=1e4, tag="fuel density")
    H_fuel: float = param("J/kg", "lower heating value of the fuel", ge=1e5, le=1e9, tag="fuel heating value")
    speed_scale: float = param("1", "factor on all speeds", 1.0, ge=0.01, le=100)
    torque_scale: float = param("1", "factor on all torques", 1.0, ge=0.01, le=100, tag="source size")
    efficiency_scale: float = param("1", "factor on the efficiency", 1.0, ge=0.01, le=100)
    mass: float = param("kg", "mass", 0.0, ge=0, le=1e5)

    rated: ClassVar[tuple[Rated, ...]] = (
        Rated("P_max", "W", "largest power of the envelope's points", "torque_scale", lambda p: peak_power(p)),
        Rated("e_max", "1", "best efficiency", "efficiency_scale", lambda p: best_efficiency(p)),
    )
    relations = (Relation(lambda p: lifted(p.efficiency_scale, p.fuel, lambda work, fuel: [(work, fuel)], p.H_fuel), LIFTED),)

    @property
    def P_own(self) -> float:
        """Largest power of the envelope's points [W]."""
        return peak_power(self)


def peak_power(p: EngineParameters) -> float:
    """Return the largest power of the envelope's points [W]."""
    return plain((p.tau_max.points[0] * p.tau_max.values).max() * p.torque_scale * p.speed_scale)


def best_efficiency(p: EngineParameters) -> float:
    """Return the best efficiency of the fuel map."""
    return plain(p.efficiency_scale * each(_best, p.fuel, p.H_fuel))


def _best(fuel: Table, H_fuel: float) -> float:
    work, P_fuel = np.outer(*fuel.points), H_fuel * fuel.values
    return float(np.max(np.divide(work, P_fuel, out=np.zeros_like(work), where=P_fuel > 0)))


@dataclass(frozen=True)
class Engine(Component, Machine):
    """Engine behind a clutch or a generator."""

    kind = "engine"
    p: EngineParameters
    parameters = EngineParameters
    shaft = Port(Shaft, "wheel")
    states = (
        State("omega_own", "rad/s", "speed that the rotor has reached", signal=True),
        State("omega_free", "rad/s", "speed of the free engine, idling control left out"),
        State("command_before", "rad/s", "commanded speed of the previous step"),
        State("ratio_before", "1", "ratio of the gear in the previous step"),
        State("fuel_used", "kg", "fuel burnt", shown=True, tag="fuel mass"),
    )
    variables = (
        Variable("omega_engine", "rad/s", "speed of the engine", signal=True, tag="engine speed"),
        Variable("throttle_engine", "1", "that torque between closed and open throttle", signal=True),
        Variable("tau_map", "N.m", "torque in the fuel map (eq. 2)", tag="engine torque"),
        Variable("speed_limited", "1", "whether its top speed holds the vehicle", kind="flag", warning="{part} at its top speed"),
        Variable("fuel_flow", "kg/s", "fuel flow (eq. 4)"),
        Variable("P_fuel", "W", "power in the fuel", "fuel"),
        Variable("P_loss", "W", "power lost", "loss"),
        *ROTOR,
        Variable("P_mismatch", "W", "power at the engine's own speed less that at the shaft", "mismatch"),
    )
    plant_states = (
        (State("omega_engine", "rad/s", "speed of the engine", signal=True, tag="engine speed"), "omega_own"),
        (states[4], "fuel_used"),
    )
    reads = (
        From("control", omega_command="rad/s", engine_on="1", omega_idle="rad/s", clutch_open="1"),
        From("control", optional=True, clutch_slipping="1"),
        From("control", optional=True, pedalled="1"),
        From("body", v="m/s", trace_missed="1", speed_ratio="1"),
        From("wheel", v_limited="m/s"),
        From("clutch", optional=True, geared="1"),
        From("accessories", optional=True, tau_accessory_before="N.m"),
        From("shift", optional=True, ratio="1"),
        From("shift", optional=True, ratio_change="1"),
        From("generator", optional=True, J_shaft="kg.m^2"),
        From("coupler", optional=True, J_machine="kg.m^2"),
        From("gear", optional=True, along=("shaft",), braked="1"),
    )

    def start(self, omega_idle: Expr) -> Mapping[str, Any]:  # type: ignore[override]
        """Return the start values: idling."""
        idling = dict.fromkeys(("omega_own", "omega_free", "command_before"), omega_idle)
        return {**idling, "ratio_before": 1.0, "fuel_used": 0.0}

    def tau_envelope(self, omega: Expr) -> Expr:
        """Return the largest torque at a speed [N.m]."""
        return self.tau_max(omega)

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
        """Return the fuel flow of a running engine, equation (4) [kg/s]."""
        p = self.p
        scale = p.speed_scale * p.torque_scale / p.efficiency_scale
        return scale * p.fuel(omega / p.speed_scale, tau / p.torque_scale)

    def burnt(self, tau: Expr, omega: Expr, engine_on: Expr) -> tuple[Expr, Expr, Expr]:
        """Return the fuel flow [kg/s], the power in it and the power lost [W]."""
        flow = where(engine_on, self.fuel_flow(tau, omega), 0)
        P_fuel = flow * self.p.H_fuel
        return flow, P_fuel, P_fuel - tau * omega

    @face("_free", "_reach")
    def spin(
        self, omega_command: Expr, omega_own: Expr, omega_free: Expr, dt: Expr, tau_accessory_before: Expr = 0.0, J_shaft: Expr = 0.0
    ) -> Mapping[str, Any]:
        """Return the speed that the engine comes to by itself, and the most that it could."""
        J, highest = ca.fmax(self.p.J + J_shaft, 1e-6), self.tau_max(omega_own)
        # A governor holds the commanded speed from both sides.
        tau_free = clip(J * (omega_command - omega_own) / dt + tau_accessory_before, self.tau_closed(omega_own), highest)
        per_tau = dt * (1 / J)
        return {
            "_free": ca.fmax(omega_free + per_tau * (tau_free - tau_accessory_before), 0),
            "_reach": omega_own + per_tau * highest,
        }

    @face("omega_engine", "next_omega_free", "next_command_before", "next_ratio_before")
    def speed(
        self, _free: Expr, _reach: Expr, omega_command: Expr, engine_on: Expr, omega_idle: Expr, clutch_open: Expr,
        command_before: Expr, trace_missed: Expr, speed_ratio: Expr, ratio_before: Expr,
        clutch_slipping: Expr = 0.0, geared: Expr = 0.0, ratio: Expr = 1.0,
    ) -> Mapping[str, Any]:  # fmt: skip
        """Estimate the engine's speed in this step."""
        follows = ca.logic_and(ca.logic_and(trace_missed, geared), ca.logic_not(clutch_slipping))
        geared_speed = where(follows, command_before * speed_ratio * ratio / ratio_before, omega_command)
        # A genset speeds up no faster than with all of its torque.
        estimate = where(clutch_open, _free, where(geared, geared_speed, ca.fmin(omega_command, _reach)))
        omega = ca.fmax(ca.fmin(estimate, self.omega_max), omega_idle * engine_on)
        return {
            "omega_engine": omega,
            "next_omega_free": where(clutch_open, estimate, omega),
            "next_command_before": omega_command,
            "next_ratio_before": ratio,
        }

    @face(
        "shaft", "throttle_engine", "tau_map", "speed_limited", "P_kinetic", "P_discretisation", "P_mismatch", "next_omega_own"
    )  # fmt: skip
    def torque(
        self, shaft: Shaft, omega_engine: Expr, omega_command: Expr, engine_on: Expr, clutch_open: Expr, dt: Expr, omega_own: Expr,
        v: Expr, v_limited: Expr, clutch_slipping: Expr = 0.0, geared: Expr = 0.0, J_shaft: Expr | None = None, braked: Expr = 0.0,
        ratio_change: Expr = 0.0,
    ) -> Mapping[str, Any]:  # fmt: skip
        """Return the torque that the engine gives, equations (1) to (3)."""
        omega, closed, open_throttle = omega_engine, self.tau_closed(omega_engine), self.tau_max(omega_engine)
        # An engine that is off drives nothing.
        highest = where(engine_on, open_throttle, 0)
        J_dt, change = self.p.J * (1 / dt), omega - omega_own
        # A genset turns its generator's rotor too: with that alone while it only spins, with no less than that while it gives.
        rotor = 0 if J_shaft is None else J_shaft * (1 / dt) * change
        driven = shaft.tau if J_shaft is None else ca.fmax(shaft.tau, rotor)
        asked = where(ca.logic_or(geared, braked), shaft.tau, where(clutch_open, shaft.tau + rotor, driven))
        # What the vehicle gains in speed in this step, at the engine, and a continuous ratio; nothing behind a slipping clutch.
        gain = 2 * shaft.omega * (v_limited - v) / ca.fmax(v_limited, 1e-9) + ratio_change * shaft.omega
        gain = where(clutch_slipping, 0, gain)
        J_alpha = J_dt * where(geared, gain, change)
        needed = asked + J_alpha
        share = where(geared, asked * highest / ca.fmax(needed, 1e-9), ca.fmax(highest - J_alpha, rotor))
        tau = where(clutch_open, asked, where(needed > highest, share, ca.fmax(asked, closed - J_alpha)))
        spinning_down = ca.logic_and(clutch_open, omega > omega_command + 1e-9)
        tau_map = clip(where(spinning_down, closed, asked + J_dt * change), closed, highest)
        reached = omega_own + dt * (tau_map - tau) * (1 / ca.fmax(self.p.J, 1e-6))
        own = where(clutch_open, omega, clip(reached, ca.fmin(omega, omega_own), ca.fmax(omega, omega_own)))
        # Behind an open clutch the shaft is the engine's own, and carries the accessories only; so is a genset's.
        turned = ca.logic_and(geared, ca.logic_not(clutch_open))
        omega_shaft = where(turned, ca.fmin(shaft.omega, self.omega_max), omega)
        kinetic = kinetic_rate(self.p.J, omega_own, own, dt)
        return {
            "shaft": Shaft(tau, omega_shaft, where(geared, shaft.alpha, change / dt)),
            "throttle_engine": (tau_map - closed) / (open_throttle - closed),
            "tau_map": tau_map,
            "speed_limited": ca.logic_and(turned, shaft.omega > self.omega_max * (1 - 1e-9)),
            "P_kinetic": kinetic,
            "P_discretisation": (tau_map - tau) * omega - kinetic,
            "P_mismatch": tau * (omega - omega_shaft),
            "next_omega_own": own,
        }

    @face("fuel_flow", "P_fuel", "P_loss", "next_fuel_used")
    def burn(self, tau_map: Expr, omega_engine: Expr, engine_on: Expr, fuel_used: Expr, dt: Expr) -> Mapping[str, Any]:
        """Return the fuel that the engine burns, equation (4)."""
        flow, P_fuel, P_loss = self.burnt(tau_map, omega_engine, engine_on)
        return {"fuel_flow": flow, "P_fuel": P_fuel, "P_loss": P_loss, "next_fuel_used": fuel_used + dt * flow}

    def audit(
        self, shaft: Shaft, omega_engine: Expr, tau_map: Expr, P_fuel: Expr, P_loss: Expr, P_kinetic: Expr, P_discretisation: Expr,
        fuel_used: Expr, next_fuel_used: Expr, dt: Expr, engine_on: Expr, clutch_open: Expr,
    ) -> Mapping[str, Any]:  # fmt: skip
        """Compare fuel and torque with the map, equation (4), and with what shaft and rotor took, equation (3)."""
        _, fuel, _ = self.burnt(tau_map, omega_engine, engine_on)
        taken = shaft.tau * omega_engine + P_kinetic + P_discretisation
        return {
            "fuel map": P_fuel - fuel,
            "fuel burnt": P_fuel - self.p.H_fuel * (next_fuel_used - fuel_used) / dt,
            "loss": P_loss - fuel + tau_map * omega_engine,
            "torque at the shaft": where(clutch_open, 0, tau_map * omega_engine - taken),
        }

    @plant("shaft", "der_omega_engine", "tau_map", "speed_limited", "P_kinetic")
    def turn(
        self, shaft: Shaft, omega_engine: Expr, throttle_engine: Expr, omega_command: Expr, omega_idle: Expr, engine_on: Expr,
        clutch_open: Expr, turning: Turning, clutch_slipping: Expr = 0.0, geared: Expr = 0.0, pedalled: Expr = 0.0, J_shaft: Expr = 0.0,
        J_machine: Expr = 0.0,
    ) -> Mapping[str, Any]:  # fmt: skip
        """Return the engine's motion in continuous time.

        Geared to the wheels, or against a converter, it follows the throttle, and a governor keeps it from falling below
        idling speed.  Else a governor holds the commanded speed: the load's torque, plus one in proportion to the error.  The
        torque fades over the last half per cent below the top speed.
        """
        fade = clip((1 - omega_engine / self.omega_max) / FADE, 0, 1)
        closed, highest = self.tau_closed(omega_engine) * turning(omega_engine), fade * self.tau_max(omega_engine)
        J = ca.fmax(self.p.J + J_shaft + J_machine, 1e-3)

        def governed(omega: Expr) -> Expr:
            return clip(shaft.tau + J / GOVERNOR_TIME * (omega - omega_engine), closed, highest)

        by_throttle = ca.logic_and(ca.logic_or(geared, pedalled), ca.logic_not(ca.logic_or(clutch_open, clutch_slipping)))
        idling = clip((omega_idle - omega_engine) / GOVERNOR_BAND, 0, 1)
        pedal = closed + ca.fmax(throttle_engine, idling) * (highest - closed)
        tau = where(engine_on, where(by_throttle, pedal, governed(omega_command)), closed)
        alpha = (tau - shaft.tau) / J
        return {
            "shaft": Shaft(shaft.tau, omega_engine, alpha),
            "der_omega_engine": alpha,
            "tau_map": tau,
            "speed_limited": fade < 1,
            "P_kinetic": J * alpha * omega_engine,
        }

    @plant("der_fuel_used", "P_fuel", "P_loss")
    def fire(self, tau_map: Expr, omega_engine: Expr, engine_on: Expr) -> Mapping[str, Any]:
        """Return the fuel that the engine burns, equation (4), in continuous time."""
        flow, P_fuel, P_loss = self.burnt(tau_map, omega_engine, engine_on)
        return {"der_fuel_used": flow, "P_fuel": P_fuel, "P_loss": P_loss}
