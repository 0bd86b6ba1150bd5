"""Control of a continuous ratio: the engine turns at the speed of a locus, where it burns least for the power asked of it.

::

    P      = tau_out omega_out / eta + P_accessories                         (1)
    G      = clip(omega_locus(P) / omega_out, G_lowest, G_highest)           (2)

with the transmission's efficiency and the accessories' power of the previous step.  The ratio changes no faster than ``rate``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from halfshaft.library.base.component import Component, From, Signal, State, Variable, face
from halfshaft.library.base.expressions import clip, where
from halfshaft.library.base.parameters import Parameters, param, table
from halfshaft.library.base.ports import Expr
from halfshaft.library.base.tables import Axis, Table

#: Efficiency where the previous step has none: at standstill, and where hardly any torque flowed.
ETA_START = 0.9


@dataclass(frozen=True, kw_only=True)
class CvtControlParameters(Parameters):
    """Locus of the engine's speed."""

    omega_locus: Table = table("rad/s", "engine speed over its power", Axis("P", "W"), clip=True, ge=0)
    rate: float = param("1/s", "largest change of the ratio per second over the ratio; the original has no limit", 1e6, ge=1e-3, le=1e6)


@dataclass(frozen=True)
class CvtControl(Component):
    """Chooses the ratio of a transmission without gears."""

    kind = "cvt-control"
    p: CvtControlParameters
    parameters = CvtControlParameters
    states = (
        State("ratio_before", "1", "ratio of the previous step", decision=True),
        State("change_before", "1", "change of the ratio in the previous step", decision=True),
    )
    variables = (Variable("ratio", "1", "ratio of input speed to output speed", signal=True),)
    signals = (
        Signal("omega_input_estimate", "rad/s", "input speed at this ratio"),
        Signal("ratio_change", "1", "change of the ratio in this step over the ratio"),
        Signal("shifting", "1", "whether a shift is under way: never"),
    )
    reads = (
        From("gearbox", tau_gearbox="N.m", omega_gearbox="rad/s", torque_ratio="1", ratios="1"),
        From("engine", omega_own="rad/s"),
        From("accessories", optional=True, tau_accessory_before="N.m"),
    )

    def start(self, ratios: tuple[Expr, ...]) -> Mapping[str, Any]:  # type: ignore[override]
        """Return the start value: the highest ratio."""
        return {"ratio_before": ratios[0], "change_before": 0.0}

    @face("shifting")
    def law(self) -> Mapping[str, Any]:
        """Say that there are no shifts."""
        return {"shifting": 0.0}

    @face("ratio", "ratio_change", "omega_input_estimate", "next_ratio_before", "next_change_before")
    def control(
        self, tau_gearbox: Expr, omega_gearbox: Expr, torque_ratio: Expr, ratios: tuple[Expr, ...], omega_own: Expr, ratio_before: Expr,
        change_before: Expr, dt: Expr, decided: Expr, tau_accessory_before: Expr = 0.0,
    ) -> Mapping[str, Any]:  # fmt: skip
        """Choose the ratio for this step."""
        eta = where(torque_ratio > 0, torque_ratio, ETA_START)
        P = tau_gearbox * omega_gearbox / eta + tau_accessory_before * omega_own
        wanted = clip(self.p.omega_locus(P) / ca.fmax(omega_gearbox, 1e-3), ratios[-1], ratios[0])
        most = 1 + self.p.rate * dt
        ratio = where(decided, ratio_before, clip(wanted, ratio_before / most, ratio_before * most))
        change = where(decided, change_before, 1 - ratio_before / ratio)
        return {
            "ratio": ratio,
            "ratio_change": change,
            "omega_input_estimate": omega_gearbox * ratio,
            "next_ratio_before": ratio,
            "next_change_before": change,
        }
