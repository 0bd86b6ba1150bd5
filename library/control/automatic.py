"""Control of the engine in a car with an automatic gearbox behind a torque converter.

The engine idles at stops, and its commanded speed is what the converter's pump must turn at, never below idling speed.  With
the key off the driveline is open (neutral).  Gears and lock-up: `halfshaft.library.control.shift.AutomaticShift`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from halfshaft.library.base.component import Component, From, Signal, Variable, face
from halfshaft.library.base.expressions import clip, where
from halfshaft.library.base.interfaces import Machine
from halfshaft.library.base.parameters import Parameters, param
from halfshaft.library.base.ports import Expr


@dataclass(frozen=True, kw_only=True)
class AutomaticControlParameters(Parameters):
    """Speeds of the control."""

    omega_idle: float = param("rad/s", "idling speed", ge=1, le=1e4)


@dataclass(frozen=True)
class AutomaticControl(Component):
    """Engine on and off, and the engine's speed command."""

    kind = "automatic-control"
    p: AutomaticControlParameters
    parameters = AutomaticControlParameters
    variables = (
        Variable("clutch_open", "1", "whether the driveline is open", signal=True, kind="flag"),
        Variable("engine_on", "1", "whether the engine runs", signal=True, kind="flag"),
        Variable("omega_command", "rad/s", "commanded engine speed", signal=True),
    )
    signals = (
        Signal("omega_idle", "rad/s", "idling speed"),
        Signal("pedalled", "1", "whether the engine follows the throttle also where it is not geared to the wheels"),
    )
    reads = (From("converter", omega_pump="rad/s"), From("engine", Machine, along=("converter", "input")))

    @face("omega_idle", "pedalled")
    def law(self) -> Mapping[str, Any]:
        """Publish the idling speed, and that a pedal drives the engine, not a governor."""
        return {"omega_idle": self.p.omega_idle, "pedalled": 1.0}

    @face("clutch_open")
    def neutral(self, key_on: Expr) -> Mapping[str, Any]:
        """Open the driveline with the key off."""
        return {"clutch_open": ca.logic_not(key_on)}

    @face("engine_on", "omega_command")
    def control(self, omega_pump: Expr, key_on: Expr, engine: Machine) -> Mapping[str, Any]:
        """Command the pump's speed."""
        return {"engine_on": key_on, "omega_command": where(key_on, clip(omega_pump, self.p.omega_idle, engine.omega_max), 0)}
