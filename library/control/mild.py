"""Control of a mild hybrid, whose machine sits on the crankshaft: sampled laws in the manner of the 2000 Honda Insight's.

*Decide*: the engine is off where no torque is asked for below `v_decel`, so long as the battery is not short; the clutch follows
`halfshaft.library.control.clutch_logic`, and is open behind an engine that is off.

*Operating point*: what is wanted of the machine, by the torque ``tau`` that the clutch is asked for and the largest torque ``tau_max``
that the machine gives for long at the crankshaft::

    crank   J (omega_command - omega_own) / dt        in the step that starts the engine, at most tau_max
    assist  share_low tau_max + slope (tau - tau_assist), at most share_high tau_max
            while tau >= tau_assist, a >= a_assist, v >= v_assist, and not in the first gear
    full    min(tau_max, P_full / omega)              while tau > tau_full
    regen   slope_regen (tau - tau_regen)             while tau <= tau_regen and the battery has room
    else    - P_alternator / omega                    while the battery has room

The engine is asked for the rest, and the machine for what the engine does not give.  Assist fades as the charge falls from
`soc_assist` to `soc_low`.  Left out: the original's steps of that fading, its warm-up, its fuel cut on overrun.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from halfshaft.library.base.component import Command, From, State, Variable, commanded, face
from halfshaft.library.base.expressions import clip, where
from halfshaft.library.base.parameters import Parameters, Relation, param
from halfshaft.library.base.ports import Expr
from halfshaft.library.control.clutch_logic import ASKED, COMMANDS, ENGAGED, OPEN, ClutchControl, clutch_logic
from halfshaft.library.electric.motor import Motor
from halfshaft.library.engine.engine import Engine


@dataclass(frozen=True, kw_only=True)
class MildControlParameters(Parameters):
    """Window of the state of charge, thresholds and slopes."""

    soc_high: float = param("1", "state of charge above which the machine does not charge", 0.8, ge=1e-3, le=1, tag="highest charge")
    soc_assist: float = param("1", "state of charge below which the machine helps less", 0.355, ge=0, le=1)
    soc_low: float = param(
        "1", "state of charge below which it does not help and the engine is not stopped", 0.2, ge=0, le=0.999, tag="lowest charge"
    )
    tau_assist: float = param("N.m", "torque above which the machine helps", 25.0, ge=0, le=1e4)
    a_assist: float = param("m/s^2", "acceleration above which it helps", 0.3, ge=-10, le=10)
    v_assist: float = param("m/s", "speed above which it helps", 4.4704, ge=0, le=1e3)
    share_low: float = param("1", "least help over the machine's largest torque", 0.129, ge=0, le=1)
    share_high: float = param("1", "most help over the machine's largest torque", 0.32, ge=0, le=1)
    slope: float = param("1", "rise of help with torque", 1 / 11, ge=0, le=10)
    tau_full: float = param("N.m", "torque above which the machine gives all", 125.0, ge=0, le=1e4)
    P_full: float = param("W", "power that it then gives at most", 6000.0, ge=0, le=1e8)
    tau_regen: float = param("N.m", "braking torque beyond which it regenerates, negative", -15.0, ge=-1e4, le=0)
    slope_regen: float = param("1", "rise of the regenerating torque with the braking torque", 0.7, ge=0, le=1)
    P_alternator: float = param("W", "power taken from the crankshaft for the accessories", 0.0, ge=0, le=1e6)
    v_decel: float = param("m/s", "speed below which the engine is off while no torque is asked for", 4.5, ge=0, le=1e3)
    omega_idle: float = param("rad/s", "idling speed", 94.0, ge=1, le=1e4)
    launch_share: float = param(
        "1", "launch speed over the engine's highest; at least 1.5 times idling speed", 0.2, ge=1e-3, le=0.999, tag="launch share"
    )
    open_when_braking: float = param("1", "1 if the clutch opens whenever no torque is asked for", 0.0, ge=0, le=1)

    relations = (
        Relation(lambda p: p.soc_low >= p.soc_assist, "soc_low = {soc_low:g} must be below soc_assist = {soc_assist:g}"),
        Relation(lambda p: p.soc_assist >= p.soc_high, "soc_assist = {soc_assist:g} must be below soc_high = {soc_high:g}"),
    )


@dataclass(frozen=True)
class MildControl(ClutchControl):
    """Clutch logic, engine on and off, and the torque that is wanted of the machine."""

    kind = "mild-control"
    p: MildControlParameters
    parameters = MildControlParameters
    states = (
        *ClutchControl.states,
        State("starting", "1", "whether the last step started the engine", decision=True),
    )
    variables = (
        *ClutchControl.variables,
        Variable("tau_machine", "N.m", "torque at the crankshaft that is wanted of the machine", signal=True),
    )
    commands = (
        Command("run", "whether the engine runs", "flag"),
        Command("share", "torque that is wanted of the machine over its largest", "share", lowest=-1.0, needs="run"),
    )
    reads = (
        From("body", v="m/s", a_request="m/s^2"),
        From("wheel", v_limited="m/s"),
        From("shift", omega_input_estimate="rad/s", shifting="1", gear="1"),
        From("clutch", tau_clutch="N.m", omega_clutch="rad/s"),
        From("engine", Engine),
        From("engine", omega_own="rad/s"),
        From("coupler", n_motor="1"),
        From("motor", Motor, along=("coupler", "motor")),
        From("battery", soc_before="1"),
    )

    def start(self, v: Expr) -> Mapping[str, Any]:  # type: ignore[override]
        """Return the start values: engaged and on if the vehicle moves."""
        return {"clutch_before": where(v > 0, ENGAGED, OPEN), "on_before": where(v > 0, 1.0, 0.0), "starting": 0.0}

    @face("omega_idle", "omega_launch")
    def law(self, engine: Engine) -> Mapping[str, Any]:
        """Publish idling and launch speed."""
        p = self.p
        return {"omega_idle": p.omega_idle, "omega_launch": ca.fmax(p.launch_share * engine.omega_max, 1.5 * p.omega_idle)}

    @face("_wanted")
    def want(self, tau_clutch: Expr, shifting: Expr, v_limited: Expr, soc_before: Expr, on_before: Expr) -> Mapping[str, Any]:
        """Say whether the engine should run."""
        p = self.p
        wanted = ca.logic_or(ca.logic_or(tau_clutch > ASKED, v_limited >= p.v_decel), soc_before < p.soc_low)
        return {"_wanted": ca.logic_or(wanted, ca.logic_and(shifting, on_before))}

    @commanded("_wanted")
    def obey(self, run: Expr) -> Mapping[str, Any]:
        """Take from outside whether the engine runs."""
        return {"_wanted": run}

    @face(
        *COMMANDS,
        "next_starting",
    )  # fmt: skip
    def decide(
        self, tau_clutch: Expr, omega_clutch: Expr, omega_input_estimate: Expr, shifting: Expr, key_on: Expr, omega_launch: Expr,
        engine: Engine, decided: Expr, clutch_before: Expr, on_before: Expr, starting: Expr, _wanted: Expr,
    ) -> Mapping[str, Any]:  # fmt: skip
        """Decide on clutch and engine for this step."""
        p = self.p
        on = where(decided, on_before, ca.logic_and(key_on, _wanted))
        clutch = clutch_logic(
            tau=tau_clutch, omega=omega_clutch, omega_estimate=omega_input_estimate, omega_idle=p.omega_idle, omega_launch=omega_launch,
            open_when_braking=p.open_when_braking, opened=ca.logic_or(shifting, ca.logic_not(on)), before=clutch_before, decided=decided,
        )  # fmt: skip
        omega = clip(where(clutch.slipping, omega_launch, omega_clutch), p.omega_idle, engine.omega_max)
        return {
            **self.decision(clutch, on, omega),
            "next_starting": where(decided, starting, ca.logic_and(on, ca.logic_not(on_before))),
        }

    def largest(self, omega_command: Expr, n_motor: Expr, motor: Motor) -> Expr:
        """Return the largest torque that the machine gives for long at the crankshaft [N.m]."""
        return n_motor * motor.tau_envelope(n_motor * omega_command)

    @face("_driving")
    def drive(
        self, tau_clutch: Expr, omega_command: Expr, clutch_open: Expr, gear: Expr, v_limited: Expr, a_request: Expr, soc_before: Expr,
        motor: Motor, n_motor: Expr,
    ) -> Mapping[str, Any]:  # fmt: skip
        """Choose the torque of a machine that need not crank; it follows the request also where the decisions stand."""
        p, tau = self.p, where(clutch_open, 0, tau_clutch)
        omega = ca.fmax(omega_command, 1.0)
        highest = self.largest(omega_command, n_motor, motor)
        fade = clip((soc_before - p.soc_low) / (p.soc_assist - p.soc_low), 0, 1)
        asked = ca.logic_and(ca.logic_and(tau >= p.tau_assist, gear > 1.5), ca.logic_and(a_request >= p.a_assist, v_limited >= p.v_assist))
        help = fade * ca.fmin(p.share_low * highest + p.slope * (tau - p.tau_assist), p.share_high * highest)
        full = fade * ca.fmin(highest, p.P_full / omega)
        regen = where(tau <= p.tau_regen, p.slope_regen * (tau - p.tau_regen), -p.P_alternator / omega)
        return {"_driving": where(tau > p.tau_full, full, where(asked, help, where(soc_before < p.soc_high, regen, 0)))}

    @commanded("_driving")
    def share_out(self, share: Expr, omega_command: Expr, clutch_open: Expr, motor: Motor, n_motor: Expr) -> Mapping[str, Any]:
        """Take from outside what the machine is asked for; behind an open clutch it rests."""
        return {"_driving": where(clutch_open, 0, share * self.largest(omega_command, n_motor, motor))}

    @face("tau_machine")
    def operate(
        self, _driving: Expr, omega_command: Expr, engine_on: Expr, omega_own: Expr, engine: Engine, motor: Motor, n_motor: Expr, dt: Expr,
        on_before: Expr, decided: Expr, starting: Expr,
    ) -> Mapping[str, Any]:  # fmt: skip
        """Return the machine's torque: first it cranks the engine."""
        crank = clip(engine.p.J * (omega_command - omega_own) / dt, 0, self.largest(omega_command, n_motor, motor))
        begins = where(decided, starting, ca.logic_and(engine_on, ca.logic_not(on_before)))
        return {"tau_machine": where(begins, crank, where(engine_on, _driving, 0))}
