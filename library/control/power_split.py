"""Coordinated control of a power split: when the engine runs, and at which power and speed.

In each step, with the power ``P`` that the ring is asked for:

1. the engine is on, but where all of these are true: ``P`` is small, the vehicle slow and the battery charged; once off, it stays
   off for a while;
2. it is to give ``P`` and a charging power in proportion to how far the state of charge is below its target;
3. its speed is that of least fuel at this power and the one that speeds up its own rotor;
4. within its own top speed and what the generator's leaves to it; never below its lowest running speed;
5. from a certain ``P`` on it gives all that it can, at the highest speed allowed;
6. its torque is no more than the generator can hold.

The engine counts as hot: the original waits for the coolant before it stops the engine.  The rotor's power is reckoned over
`t_inertia` at least, which is the original's step; over shorter ones the command would swing from end to end.  An engine
speeds up and slows down no faster than its torque and closed throttle let both rotors, its own and the generator's, so that steps
may be as short as one likes.

While a search looks for the best end speed the engine keeps the power that the first request asked for, and its being on: so
the search moves the motor alone, and what is lost at a limit is not lost once more by an engine that follows it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca

from halfshaft.library.base.component import Command, Component, From, Signal, State, Variable, commanded, face
from halfshaft.library.base.expressions import clip, where
from halfshaft.library.base.parameters import Parameters, param, table
from halfshaft.library.base.ports import Expr
from halfshaft.library.base.tables import Axis, Table
from halfshaft.library.driveline.planetary_gear import PlanetaryGear
from halfshaft.library.electric.motor_generator import MotorGenerator
from halfshaft.library.engine.engine import Engine


@dataclass(frozen=True, kw_only=True)
class PowerSplitControlParameters(Parameters):
    """Thresholds, charging and the engine's best speeds."""

    P_on: float = param("W", "power at the ring from which on the engine runs", ge=0, le=1e8)
    v_on: float = param("m/s", "speed of the vehicle from which on the engine runs", ge=0, le=1e3)
    soc_on: float = param("1", "state of charge up to which the engine runs", ge=0, le=1)
    t_off_min: float = param("s", "shortest time off", 0.0, ge=0, le=1e9)
    soc_target: float = param("1", "state of charge at which nothing is charged", ge=0, le=1)
    I_charge: float = param("A", "charging current per state of charge below the target", 0.0, ge=0, le=1e6)
    eta_charge: float = param("1", "efficiency on the way to the battery that the charging power makes up for", 1.0, ge=0.01, le=1)
    P_full: float = param("W", "power at the ring above which the engine gives all", ge=0, le=1e9)
    omega_lowest: float = param("rad/s", "lowest speed of a running engine", ge=1, le=1e4)
    t_inertia: float = param("s", "shortest time over which the rotor's power is reckoned", 1.0, ge=0, le=100)
    omega_best: Table = table("rad/s", "engine speed of least fuel, for engine scales of 1", Axis("P", "W"), clip=True, ge=0)


class Decision(NamedTuple):
    """What the engine shall do, before any limit of speed."""

    on: Expr
    full: Expr
    P: Expr


@dataclass(frozen=True)
class PowerSplitControl(Component):
    """Decides when the engine runs, and at which point; generator and motor follow by the gear."""

    kind = "power-split-control"
    p: PowerSplitControlParameters
    parameters = PowerSplitControlParameters
    states = (
        State("on_before", "1", "whether the engine was on in the previous step", decision=True),
        State("full_before", "1", "whether it gave all", decision=True),
        State("P_before", "W", "power that it was asked for", decision=True),
        State("t_off", "s", "time since the engine was stopped, or the start"),
    )
    variables = (
        Variable("engine_on", "1", "whether the engine runs", signal=True, kind="flag"),
        Variable("engine_full", "1", "whether it gives all that it can", kind="flag"),
        Variable("omega_command", "rad/s", "commanded engine speed", signal=True),
        Variable("tau_command", "N.m", "commanded engine torque", signal=True),
        Variable("P_engine_request", "W", "engine power that demand and charging ask for"),
    )
    commands = (
        Command("run", "whether the engine runs", "flag"),
        Command("share", "engine power over the largest", "share", needs="run", lasts=True),
    )
    signals = (Signal("omega_idle", "rad/s", "idling speed"), Signal("clutch_open", "1", "whether the engine only spins"))
    reads = (
        From("body", v="m/s"),
        From("battery", soc_before="1", U_supply="V"),
        From("gear", tau_ring="N.m", omega_ring="rad/s", omega_ring_turning="rad/s"),
        From("gear", PlanetaryGear),
        From("engine", Engine),
        From("engine", omega_own="rad/s"),
        From("generator", MotorGenerator, along=("gear", "sun")),
    )

    @face("omega_idle", "clutch_open")
    def law(self) -> Mapping[str, Any]:
        """Say that the engine is never held at idling speed by itself, and never parted from the gear."""
        return {"omega_idle": 0.0, "clutch_open": 0.0}

    @face("_wanted")
    def want(
        self, tau_ring: Expr, omega_ring: Expr, v: Expr, soc_before: Expr, U_supply: Expr, on_before: Expr, t_off: Expr
    ) -> Mapping[str, Any]:
        """Say whether the engine should run, and for which power."""
        p = self.p
        P_ring = tau_ring * omega_ring
        needed = ca.logic_or(ca.logic_or(P_ring >= p.P_on, v >= p.v_on), soc_before <= p.soc_on)
        may = ca.logic_or(on_before, t_off >= p.t_off_min - 1e-9)
        P_charge = p.I_charge * (p.soc_target - soc_before) * U_supply / p.eta_charge
        return {"_wanted": Decision(ca.logic_and(needed, may), P_ring > p.P_full, P_ring + P_charge)}

    @commanded("_wanted")
    def obey(self, run: Expr, share: Expr, engine: Engine) -> Mapping[str, Any]:
        """Take from outside when the engine runs and for which power."""
        return {"_wanted": Decision(run, 0, share * engine.P_largest)}

    @face("engine_on", "engine_full", "P_engine_request", "next_on_before", "next_full_before", "next_P_before", "next_t_off", "_decision")
    def decide(
        self, _wanted: Decision, key_on: Expr, dt: Expr, decided: Expr, on_before: Expr, full_before: Expr, P_before: Expr, t_off: Expr
    ) -> Mapping[str, Any]:
        """Decide for this step."""
        on = where(decided, on_before, ca.logic_and(key_on, _wanted.on))
        full = where(decided, full_before, ca.logic_and(on, _wanted.full))
        P = where(decided, P_before, where(on, _wanted.P, 0))
        return {
            "engine_on": on,
            "engine_full": full,
            "P_engine_request": P,
            "next_on_before": on,
            "next_full_before": full,
            "next_P_before": P,
            "next_t_off": where(on, 0, t_off + dt),
            "_decision": Decision(on, full, P),
        }

    @face("omega_command", "tau_command")
    def operate(
        self, _decision: Decision, omega_ring_turning: Expr, omega_own: Expr, dt: Expr, gear: PlanetaryGear, engine: Engine,
        generator: MotorGenerator,
    ) -> Mapping[str, Any]:  # fmt: skip
        """Return the engine's operating point."""
        p, (on, full, P) = self.p, _decision
        scale = engine.p.speed_scale * engine.p.torque_scale

        def best(P: Expr) -> Expr:
            return engine.p.speed_scale * p.omega_best(P / scale)

        top = generator.omega_max
        highest = ca.fmin(gear.omega_carrier(top, omega_ring_turning), engine.omega_max)
        lowest = gear.omega_carrier(-top, omega_ring_turning)
        lowest = where(lowest > 0, ca.fmax(lowest, p.omega_lowest), 0)
        omega = best(P)
        omega = best(P + omega * engine.p.J * (omega - omega_own) / ca.fmax(dt, p.t_inertia))
        omega = where(full, highest, ca.fmax(clip(omega, lowest, highest), p.omega_lowest))
        J = engine.p.J + generator.p.J * gear.omega_sun(1, 0) ** 2
        slowest, fastest = (omega_own + dt * tau(omega_own) / ca.fmax(J, 1e-6) for tau in (engine.tau_closed, engine.tau_max))
        omega = clip(where(on, omega, 0), slowest, fastest)
        held = generator.tau_envelope(ca.fabs(gear.omega_sun(omega, omega_ring_turning))) / (1 - gear.share)
        highest = ca.fmin(engine.tau_max(omega), held)
        tau = where(full, highest, ca.fmin(P / ca.fmax(omega, p.omega_lowest), highest))
        return {"omega_command": omega, "tau_command": where(on, tau, 0)}
