"""Friction clutch between gearbox and engine: open, slipping or engaged.

Torque passes unchanged, open none.  The engine is asked for all of it, and cuts it by its own law; what it gives passes
up to its largest torque, and that of a machine on its shaft.  A control of a hybrid may ask the engine for another torque
than the wheels do.  While slipping, the engine is asked for the launch speed and the power ``tau (omega_in - omega_out)``
is lost.  The control says which state holds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from halfshaft.library.base.component import From, Signal, Variable, face, plant
from halfshaft.library.base.expressions import clip, where
from halfshaft.library.base.interfaces import Machine
from halfshaft.library.base.links import Link, TwoSided, limit
from halfshaft.library.base.parameters import Parameters
from halfshaft.library.base.ports import Expr, Port, Shaft

#: Capacity of the engaged clutch over the engine's largest torque, and slip speed of the smooth friction law [rad/s].
CAPACITY, OMEGA_SLIP = 2.0, 1.0
#: A slipping clutch begins to carry at this share of the idling speed and carries all that is asked for at launch speed.
BITE = 0.8


@dataclass(frozen=True, kw_only=True)
class ClutchParameters(Parameters):
    """A clutch has no parameters: it carries what the engine can give."""


@dataclass(frozen=True)
class Clutch(TwoSided):
    """Clutch between gearbox and engine."""

    kind = "clutch"
    p: ClutchParameters
    parameters = ClutchParameters
    output = Port(Shaft, "wheel")
    input = Port(Shaft, "source")
    variables = (Variable("tau_clutch", "N.m", "required output torque", signal=True),)
    signals = (
        Signal("geared", "1", "whether the engine turns with the wheels"),
        Signal("omega_clutch", "rad/s", "required output speed"),
    )
    reads = (
        From("control", clutch_open="1", clutch_slipping="1", omega_launch="rad/s", omega_idle="rad/s"),
        From("control", optional=True, tau_command="N.m"),
        From("engine", Machine, along=("input",)),
        From("engine", omega_engine="rad/s"),
        From("wheel", tau_grip_out="N.m", tau_grip_in="N.m"),
        From("coupler", optional=True, grip_forgiven="1"),
        From("coupler", optional=True, tau_machine_largest="N.m"),
    )

    @face("geared")
    def law(self) -> Mapping[str, Any]:
        """Say that the engine turns with the wheels."""
        return {"geared": 1.0}

    @face("tau_clutch", "omega_clutch")
    def request(self, output: Shaft) -> Mapping[str, Any]:
        """Publish the required output point, which the control looks at."""
        return {"tau_clutch": output.tau, "omega_clutch": output.omega}

    def chain(  # type: ignore[override]
        self,
        clutch_open: Expr,
        clutch_slipping: Expr,
        omega_launch: Expr,
        engine: Machine,
        tau_command: Expr | None = None,
        tau_machine_largest: Expr = 0.0,
    ) -> tuple[Link, ...]:
        """Return the torque that passes and the speed behind the clutch."""
        largest = engine.tau_largest + tau_machine_largest

        def cut(load: Shaft) -> Shaft:
            return load._replace(tau=where(clutch_open, 0, load.tau if tau_command is None else tau_command))

        def law(load: Shaft) -> Shaft:
            return load._replace(omega=where(clutch_slipping, omega_launch, load.omega))

        def back(asked: Shaft, sent: Shaft, offered: Shaft) -> Shaft:
            parted = ca.logic_or(clutch_open, clutch_slipping)
            # A clutch that slips at launch turns faster at the engine: it can only drive.
            tau = where(clutch_open, 0, clip(offered.tau, where(clutch_slipping, 0, -largest), largest))
            return Shaft(tau, where(parted, asked.omega, offered.omega), asked.alpha)

        return (limit(cut), Link(law, back))

    @plant("input", "P_loss", "balance")
    def flow(
        self,
        output: Shaft,
        tau_clutch: Expr,
        clutch_open: Expr,
        clutch_slipping: Expr,
        omega_engine: Expr,
        omega_idle: Expr,
        omega_launch: Expr,
        engine: Machine,
        tau_grip_out: Expr,
        tau_grip_in: Expr,
        tau_command: Expr | None = None,
        grip_forgiven: Expr = 0.0,
        tau_machine_largest: Expr = 0.0,
    ) -> Mapping[str, Any]:
        """Return the torque of the friction pair in continuous time: capacity times a smooth function of the slip speed.

        Engaged, the capacity is above the engine's largest torque; slipping, it is the torque that the control asks for.
        It is less while the engine is below its launch speed, or engaged below its idling speed, so that it is not stalled.
        The tyres' grip cuts what passes; beside a motor on the same shaft it forgives a share of what the clutch lacks.
        """
        largest = engine.tau_largest + tau_machine_largest
        asked = tau_clutch if tau_command is None else tau_command
        low = BITE * omega_idle
        full = where(clutch_slipping, omega_launch, omega_idle)
        bite = clip((omega_engine - low) / ca.fmax(full - low, 1), 0, 1)
        capacity = bite * where(clutch_slipping, clip(asked, 0, largest), CAPACITY * largest)
        tau = where(clutch_open, 0, capacity) * ca.tanh((omega_engine - output.omega) / OMEGA_SLIP)
        more = ca.fmax(tau_grip_out + grip_forgiven * (tau - output.tau), -output.tau)
        less = ca.fmin(-tau_grip_in - grip_forgiven * (output.tau - tau), -output.tau)
        return {
            "input": Shaft(output.tau, omega_engine, 0.0),
            "P_loss": output.tau * (omega_engine - output.omega),
            "balance": ca.fmax(ca.fmin(tau - output.tau, more), less),
        }
