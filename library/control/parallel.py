"""Control of a parallel hybrid: sampled laws, in two faces.

*Decide*: with the torque ``tau`` and the speed ``omega`` that the clutch is asked for, and the limited mean speed ``v``::

    engine on = (turning and fast and worth it) or (on before, and shifting) or the battery alone cannot do it
    turning   = (tau > 0 or v > v_decel) and omega > omega_idle, or the engine idles at stops
    fast      = v >= v_launch(soc), or soc < soc_low where the control does not deplete the battery
    v_launch  from v_launch_low at soc_low to v_launch_high at soc_high and above; the line goes on below soc_low

The battery alone cannot do it where the mean of ``tau omega`` over the three steps before reaches its largest power; while
shifting that power stands still.  With an engine that is off the clutch is open; for the rest it follows
`halfshaft.library.control.clutch_logic`.  A gear is raised only if the motor alone could pull the next one, or the engine was on, or
the motor nears its top speed (it is asked at its own speed; the original asks at that of the gearbox).

*Operating point*: what the engine is asked for, by one of two strategies.  The motor gives what is missing of the request, and takes
what is too much.

* *Electric assist*: ``max(tau + tau_charge (soc_middle - soc) / half, tau_min)``, with ``tau_min`` a share of the largest torque
  below soc_low and 0 above.  Worth it: at ``tau > off_share tau_max`` or always where that is 0, below soc_low, or where it depletes.
* *Balanced*: the torque is moved toward good loads of the engine, the more the further the charge is from the middle.

The original asks an engine behind an open clutch for the charging torque too, which nobody takes; here it is asked for none.  Left out:
the rule that keeps a cold engine running.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca

from halfshaft.library.base.component import Command, From, Signal, State, Variable, commanded, face
from halfshaft.library.base.expressions import clip, where
from halfshaft.library.base.parameters import Parameters, Relation, param
from halfshaft.library.base.ports import Expr
from halfshaft.library.control.clutch_logic import ASKED, COMMANDS, ENGAGED, OPEN, ClutchControl, clutch_logic
from halfshaft.library.electric.motor import Motor
from halfshaft.library.engine.engine import Engine

#: Share of the motor's top speed above which a gear may be raised.
NEAR_TOP = 0.95


@dataclass(frozen=True, kw_only=True)
class ParallelControlParameters(Parameters):
    """Window of the state of charge, speeds and switches."""

    soc_high: float = param("1", "upper end of the window of the state of charge", 0.7, ge=1e-3, le=1, tag="highest charge")
    soc_low: float = param("1", "lower end of the window", 0.6, ge=0, le=0.999, tag="lowest charge")
    v_launch_low: float = param(
        "m/s", "speed below which the car drives electrically, at soc_low", 0.0, ge=0, le=1e3, tag="electric launch speed"
    )
    v_launch_high: float = param(
        "m/s", "speed below which the car drives electrically, from soc_high on", 0.0, ge=0, le=1e3, tag="electric launch speed"
    )
    v_decel: float = param("m/s", "speed below which the engine is off while no torque is asked for", 0.0, ge=0, le=1e3)
    min_share: float = param("1", "least engine torque below soc_low over the largest at the speed", 0.4, ge=0, le=1)
    charge_depleting: float = param("1", "1 to use the battery up before the engine charges it", 0.0, ge=0, le=1, tag="depletes")
    omega_idle: float = param("rad/s", "idling speed; the engine is off below it", 0.0, ge=0, le=1e4)
    launch_share: float = param(
        "1", "launch speed over the engine's highest; at least 1.5 times idling speed", 1 / 6, ge=1e-3, le=0.999, tag="launch share"
    )
    idle_at_stop: float = param("1", "1 if the engine idles at stops, 0 if it is switched off", 0.0, ge=0, le=1)
    open_when_braking: float = param("1", "1 if the clutch opens whenever no torque is asked for", 1.0, ge=0, le=1)

    relations: ClassVar[tuple[Relation, ...]] = (
        Relation(lambda p: p.soc_low >= p.soc_high, "soc_low = {soc_low:g} must be below soc_high = {soc_high:g}"),
    )


@dataclass(frozen=True, kw_only=True)
class ElectricAssistParameters(ParallelControlParameters):
    """What electric assist has besides."""

    off_share: float = param("1", "engine off below this torque over its largest at the speed, 0 for never", 0.0, ge=0, le=1)
    charge_share: float = param("1", "charging torque at soc_low over the least torque of the engine's envelope", 0.25, ge=0, le=10)


@dataclass(frozen=True, kw_only=True)
class BalancedParameters(ParallelControlParameters):
    """What the balanced strategy has besides."""

    load_low: float = param("1", "lower end of good engine loads: torque over the largest at the speed", 0.6, ge=0, le=0.999)
    load_high: float = param("1", "upper end of good engine loads", 0.9, ge=1e-3, le=1)
    load_weight: float = param("1", "weight of the load's distance from the middle, beside that of the charge", 0.13, ge=0, le=100)

    relations = (
        *ParallelControlParameters.relations,
        Relation(lambda p: p.load_low >= p.load_high, "load_low = {load_low:g} must be below load_high = {load_high:g}"),
    )


@dataclass(frozen=True)
class _ParallelControl(ClutchControl):
    """What both strategies share: clutch logic, engine on and off, leave to shift up."""

    family = "parallel-control"
    states = (
        *ClutchControl.states,
        State("P_before", "W", "power that the clutch was asked for one step ago", decision=True),
        State("P_before_2", "W", "two steps ago", decision=True),
        State("P_before_3", "W", "three steps ago", decision=True),
        State("steps_before", "1", "steps that the mean of these looks back on, at most three", decision=True),
    )
    variables = (
        *ClutchControl.variables,
        Variable("tau_command", "N.m", "torque that the engine is asked for", signal=True),
    )
    signals = (
        *ClutchControl.signals,
        Signal("upshift_allowed", "1", "whether a gear may be raised"),
    )
    commands = (
        Command("run", "whether the engine runs", "flag"),
        Command("share", "engine torque: 0 none, 1 what is asked for, 2 the largest", "share", highest=2.0, needs="run"),
    )
    reads = (
        From("body", v="m/s"),
        From("wheel", v_limited="m/s"),
        From("gearbox", tau_gearbox="N.m", omega_gearbox="rad/s", torque_ratio="1"),
        From("shift", omega_input_estimate="rad/s", shifting="1", ratio_before="1", ratio_above="1"),
        From("clutch", tau_clutch="N.m", omega_clutch="rad/s"),
        From("engine", Engine),
        From("coupler", n_motor="1"),
        From("motor", Motor, along=("coupler", "motor")),
        From("battery", soc_before="1", P_battery_max="W"),
    )

    def start(self, v: Expr) -> Mapping[str, Any]:  # type: ignore[override]
        """Return the start values: engaged and on if the vehicle moves."""
        powers = dict.fromkeys(("P_before", "P_before_2", "P_before_3", "steps_before"), 0.0)
        return {"clutch_before": where(v > 0, ENGAGED, OPEN), "on_before": where(v > 0, 1.0, 0.0), **powers}

    @face("omega_idle", "omega_launch")
    def law(self, engine: Engine) -> Mapping[str, Any]:
        """Publish idling and launch speed."""
        p = self.p
        return {"omega_idle": p.omega_idle * p.idle_at_stop, "omega_launch": ca.fmax(p.launch_share * engine.omega_max, 1.5 * p.omega_idle)}

    def worth_it(self, tau: Expr, omega: Expr, soc: Expr, engine: Engine) -> Expr:
        """Return whether a torque is worth running the engine for."""
        raise NotImplementedError

    def engine_torque(self, tau: Expr, omega: Expr, soc: Expr, engine: Engine) -> Expr:
        """Return what a running engine is asked for [N.m]."""
        raise NotImplementedError

    @face("upshift_allowed")
    def allow(
        self, tau_gearbox: Expr, omega_gearbox: Expr, torque_ratio: Expr, ratio_before: Expr, ratio_above: Expr, on_before: Expr,
        n_motor: Expr, motor: Motor,
    ) -> Mapping[str, Any]:  # fmt: skip
        """Say whether a gear may be raised."""
        omega = n_motor * ratio_above * omega_gearbox
        pulls = motor.limits(omega)[1] * omega > omega_gearbox * tau_gearbox / clip(torque_ratio, 0.2, 1)
        fast = n_motor * ratio_before * omega_gearbox > NEAR_TOP * motor.omega_max
        return {"upshift_allowed": ca.logic_or(ca.logic_or(pulls, fast), on_before)}

    @face("_wanted")
    def want(
        self, tau_clutch: Expr, omega_clutch: Expr, shifting: Expr, v_limited: Expr, soc_before: Expr, P_battery_max: Expr, engine: Engine,
        on_before: Expr, P_before: Expr, P_before_2: Expr, P_before_3: Expr, steps_before: Expr,
    ) -> Mapping[str, Any]:  # fmt: skip
        """Say whether the engine should run."""
        p = self.p
        turning = ca.logic_and(ca.logic_or(tau_clutch > ASKED, v_limited > p.v_decel), omega_clutch > p.omega_idle)
        share = ca.fmin((soc_before - p.soc_low) / (p.soc_high - p.soc_low), 1)
        fast = v_limited >= p.v_launch_low + share * (p.v_launch_high - p.v_launch_low)
        fast = ca.logic_or(fast, ca.logic_and(soc_before < p.soc_low, ca.logic_not(p.charge_depleting)))
        runs = ca.logic_and(ca.logic_or(turning, p.idle_at_stop), fast)
        wanted = ca.logic_and(runs, self.worth_it(tau_clutch, omega_clutch, soc_before, engine))
        mean = (P_before + P_before_2 + P_before_3) / ca.fmax(steps_before, 1)
        return {"_wanted": ca.logic_or(ca.logic_or(wanted, ca.logic_and(shifting, on_before)), mean >= P_battery_max)}

    @commanded("_wanted")
    def obey(self, run: Expr) -> Mapping[str, Any]:
        """Take from outside whether the engine runs."""
        return {"_wanted": run}

    @commanded("tau_command")
    def share_out(
        self, share: Expr, tau_clutch: Expr, omega_command: Expr, clutch_open: Expr, engine_on: Expr, engine: Engine
    ) -> Mapping[str, Any]:
        """Take from outside what the engine is asked for."""
        highest = engine.tau_envelope(omega_command)
        asked = clip(where(clutch_open, 0, tau_clutch), 0, highest)
        # An engine that is asked for more than it has leaves less of it to its rotor.
        tau = clip(share, 0, 1) * asked + clip(share - 1, 0, 1) * (ca.fmax(highest, tau_clutch) - asked)
        return {"tau_command": where(engine_on, tau, 0)}

    @face(
        *COMMANDS,
        "next_P_before", "next_P_before_2", "next_P_before_3", "next_steps_before",
    )  # fmt: skip
    def decide(
        self, tau_clutch: Expr, omega_clutch: Expr, omega_input_estimate: Expr, shifting: Expr, key_on: Expr, omega_launch: Expr,
        engine: Engine, decided: Expr, clutch_before: Expr, on_before: Expr, P_before: Expr, P_before_2: Expr, P_before_3: Expr,
        steps_before: Expr, _wanted: Expr,
    ) -> Mapping[str, Any]:  # fmt: skip
        """Decide on clutch and engine for this step."""
        p = self.p
        on = where(decided, on_before, ca.logic_and(key_on, _wanted))
        clutch = clutch_logic(
            tau=tau_clutch, omega=omega_clutch, omega_estimate=omega_input_estimate, omega_idle=p.omega_idle, omega_launch=omega_launch,
            open_when_braking=p.open_when_braking, opened=ca.logic_or(shifting, ca.logic_not(on)), before=clutch_before, decided=decided,
        )  # fmt: skip
        omega = clip(where(clutch.slipping, omega_launch, omega_clutch), p.omega_idle * p.idle_at_stop, engine.omega_max)
        P = where(shifting, P_before, tau_clutch * omega_clutch)
        return {
            **self.decision(clutch, on, omega),
            "next_P_before": where(decided, P_before, P),
            "next_P_before_2": where(decided, P_before_2, P_before),
            "next_P_before_3": where(decided, P_before_3, P_before_2),
            "next_steps_before": where(decided, steps_before, ca.fmin(steps_before + 1, 3)),
        }

    @face("tau_command")
    def operate(self, tau_clutch: Expr, omega_command: Expr, soc_before: Expr, engine_on: Expr, engine: Engine) -> Mapping[str, Any]:
        """Choose the engine's torque; it follows the request also where the decisions stand."""
        tau = ca.fmax(
            self.engine_torque(tau_clutch, omega_command, soc_before, engine),
            where(soc_before < self.p.soc_low, self.p.min_share * engine.tau_envelope(omega_command), 0),
        )
        return {"tau_command": where(engine_on, tau, 0)}

    def short(self, soc: Expr) -> Expr:
        """Return how far the charge is below the middle of the window, over half of the window."""
        p = self.p
        return ((p.soc_high + p.soc_low) / 2 - soc) / ((p.soc_high - p.soc_low) / 2)


@dataclass(frozen=True)
class ElectricAssist(_ParallelControl):
    """The motor helps the engine, which charges by a torque in proportion to the lack of charge."""

    kind = "electric-assist-control"
    p: ElectricAssistParameters
    parameters = ElectricAssistParameters

    def worth_it(self, tau: Expr, omega: Expr, soc: Expr, engine: Engine) -> Expr:
        """Return whether a torque is worth running the engine for."""
        p = self.p
        enough = ca.logic_or(tau > p.off_share * engine.tau_envelope(omega), p.off_share < 1e-12)
        return ca.logic_or(enough, ca.logic_or(p.charge_depleting, soc < p.soc_low))

    def engine_torque(self, tau: Expr, omega: Expr, soc: Expr, engine: Engine) -> Expr:
        """Return the request and the charging torque; outside the window that goes on growing [N.m]."""
        return tau + self.p.charge_share * engine.p.torque_scale * float(engine.p.tau_max.values.min()) * self.short(soc)


@dataclass(frozen=True)
class Balanced(_ParallelControl):
    """The engine's load is moved toward where it is good, the more the further the charge is from the middle."""

    kind = "balanced-control"
    p: BalancedParameters
    parameters = BalancedParameters

    def worth_it(self, tau: Expr, omega: Expr, soc: Expr, engine: Engine) -> Expr:
        """Return whether a torque is worth running the engine for."""
        p = self.p
        enough = ca.logic_or(soc < (p.soc_high + p.soc_low) / 2, tau > p.load_low * engine.tau_envelope(omega))
        return ca.logic_and(enough, soc < p.soc_high)

    def engine_torque(self, tau: Expr, omega: Expr, soc: Expr, engine: Engine) -> Expr:
        """Return the request, moved toward a good load [N.m]."""
        p = self.p
        middle, half = (p.load_high + p.load_low) / 2, (p.load_high - p.load_low) / 2
        highest = engine.tau_envelope(omega)
        load = clip(tau / highest, 0, 1)

        def signed_square(x: Expr) -> Expr:
            return x * ca.fabs(x)

        lack = signed_square(self.short(soc))
        weight = lack + p.load_weight * signed_square((middle - load) / half)
        empty, heavy = lack > 0, load > middle
        target = where(ca.logic_and(ca.logic_and(empty, heavy), load < p.load_high), p.load_high, middle)
        kept = where(empty, load >= p.load_high, ca.logic_not(heavy))
        sign = where(ca.logic_and(heavy, ca.logic_not(empty)), -1, 1)
        return ca.fmax(0, tau + where(kept, 0, highest * (target - load) * sign * weight))
