"""Control of clutch and engine in a conventional car: sampled laws.

The clutch follows `halfshaft.library.control.clutch_logic`.  The engine idles at stops unless told not to; the commanded
speed is that of the clutch, never below idling.  The original raises the engine to launch speed one sample before the trace
starts to move; a control that cannot see the next sample does not, and neither does this one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from halfshaft.library.base.component import From, face
from halfshaft.library.base.expressions import clip, where
from halfshaft.library.base.interfaces import Machine
from halfshaft.library.base.parameters import Parameters, param
from halfshaft.library.base.ports import Expr
from halfshaft.library.control.clutch_logic import COMMANDS, ENGAGED, OPEN, ClutchControl, clutch_logic


@dataclass(frozen=True, kw_only=True)
class ConventionalControlParameters(Parameters):
    """Speeds and switches of the control."""

    omega_idle: float = param("rad/s", "idling speed", ge=1, le=1e4)
    launch_share: float = param(
        "1", "launch speed over the engine's highest; at least 1.5 times idling speed", 0.2, ge=1e-3, le=0.999, tag="launch share"
    )
    idle_at_stop: float = param("1", "1 if the engine idles at stops, 0 if it is switched off", 1.0, ge=0, le=1)
    open_when_braking: float = param("1", "1 if the clutch opens whenever no torque is asked for", 0.0, ge=0, le=1)


@dataclass(frozen=True)
class ConventionalControl(ClutchControl):
    """Clutch logic, engine on and off, and the engine's speed command."""

    kind = "conventional-control"
    p: ConventionalControlParameters
    parameters = ConventionalControlParameters
    reads = (
        From("body", v="m/s"),
        From("clutch", tau_clutch="N.m", omega_clutch="rad/s"),
        From("engine", Machine, along=("clutch", "input")),
        From("shift", omega_input_estimate="rad/s", shifting="1"),
    )

    def start(self, v: Expr) -> Mapping[str, Any]:  # type: ignore[override]
        """Return the start values: engaged if the vehicle moves."""
        return {"clutch_before": where(v > 0, ENGAGED, OPEN), "on_before": 1.0}

    @face("omega_idle", "omega_launch")
    def law(self, engine: Machine) -> Mapping[str, Any]:
        """Publish idling and launch speed."""
        p = self.p
        return {"omega_idle": p.omega_idle * p.idle_at_stop, "omega_launch": ca.fmax(p.launch_share * engine.omega_max, 1.5 * p.omega_idle)}

    @face(*COMMANDS)
    def control(
        self, tau_clutch: Expr, omega_clutch: Expr, omega_input_estimate: Expr, shifting: Expr, key_on: Expr, omega_launch: Expr,
        engine: Machine, clutch_before: Expr, on_before: Expr, decided: Expr,
    ) -> Mapping[str, Any]:  # fmt: skip
        """Decide on clutch and engine for this step."""
        p = self.p
        clutch = clutch_logic(
            tau=tau_clutch, omega=omega_clutch, omega_estimate=omega_input_estimate, omega_idle=p.omega_idle, omega_launch=omega_launch,
            open_when_braking=p.open_when_braking, opened=shifting, before=clutch_before, decided=decided,
        )  # fmt: skip
        on = ca.logic_and(key_on, ca.logic_or(p.idle_at_stop, ca.logic_not(clutch.is_open)))
        on = where(decided, on_before, ca.logic_or(on, ca.logic_and(shifting, on_before)))
        omega = clip(where(clutch.slipping, omega_launch, omega_clutch), p.omega_idle * p.idle_at_stop, engine.omega_max)
        return self.decision(clutch, on, omega)
