"""Mechanical accessories: a constant load on the engine's shaft.

``tau_in = tau_out + tau + P / (eta omega)`` while the engine is on, at the engine's speed but never below its idling speed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from halfshaft.library.base.component import From, State
from halfshaft.library.base.expressions import where
from halfshaft.library.base.links import Link, TwoSided
from halfshaft.library.base.parameters import Parameters, param
from halfshaft.library.base.ports import Expr, Port, Shaft


@dataclass(frozen=True, kw_only=True)
class MechanicalAccessoriesParameters(Parameters):
    """Load on the engine's shaft."""

    tau_on: float = param("N.m", "constant torque while the engine is on", 0.0, ge=0, le=1e4)
    P_on: float = param("W", "constant power while the engine is on", 0.0, ge=0, le=1e6)
    eta: float = param("1", "efficiency of the belt drive", 1.0, ge=0.01, le=1)


@dataclass(frozen=True)
class MechanicalAccessories(TwoSided):
    """Load on the engine's shaft, between clutch (or generator) and engine."""

    kind = "mechanical-accessories"
    p: MechanicalAccessoriesParameters
    parameters = MechanicalAccessoriesParameters
    load = Port(Shaft, "wheel")
    supply = Port(Shaft, "source")
    reads = (From("engine", omega_engine="rad/s"), From("control", omega_idle="rad/s", engine_on="1"))
    states = (State("tau_accessory_before", "N.m", "torque of the accessories in the previous step", signal=True),)

    def torque(self, omega: Expr, omega_idle: Expr, engine_on: Expr) -> Expr:
        """Return the torque at the engine's shaft [N.m]."""
        p = self.p
        tau = p.tau_on + p.P_on / (p.eta * ca.fmax(ca.fmax(omega, omega_idle), 1e-3))
        return where(ca.logic_and(engine_on, omega > 1e-9), tau, 0)

    def chain(self, omega_engine: Expr, omega_idle: Expr, engine_on: Expr) -> tuple[Link, ...]:  # type: ignore[override]
        """Return the load."""
        tau = self.torque(omega_engine, omega_idle, engine_on)
        return (
            Link(
                lambda load: load._replace(tau=load.tau + tau),
                lambda asked, sent, offered: offered._replace(tau=offered.tau - tau),
                name="belt",
            ),
        )

    def found(self, way: Mapping[str, tuple[Shaft, Shaft]]) -> Mapping[str, Any]:
        """Return the torque for the shift logic and the engine's free spinning."""
        asked, sent = way["belt"]
        return {"next_tau_accessory_before": sent.tau - asked.tau}
