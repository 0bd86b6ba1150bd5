"""Clutch logic that cars with a manual gearbox share.

::

    open     while shifting, or no torque is asked for below idling speed (or at any speed, if so set), or the engine is off
    slipping while torque is asked for below the launch speed and the clutch was not engaged before
    engaged  else
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import casadi as ca

from halfshaft.library.base.component import Component, Signal, State, Variable
from halfshaft.library.base.expressions import where
from halfshaft.library.base.ports import Expr

OPEN, SLIPPING, ENGAGED = 1, 2, 3
#: A torque above this is asked for [N.m].
ASKED = 1e-3


class ClutchLogic(NamedTuple):
    """State of a clutch, and what it says."""

    state: Expr
    is_open: Expr
    slipping: Expr


def clutch_logic(
    *, tau: Expr, omega: Expr, omega_estimate: Expr, omega_idle: Expr, omega_launch: Expr, open_when_braking: Expr, opened: Expr,
    before: Expr, decided: Expr,
) -> ClutchLogic:  # fmt: skip
    """Return the state of the clutch.

    Parameters
    ----------
    tau, omega
        Torque [N.m] and speed [rad/s] that are asked for at the output.
    omega_estimate
        Input speed of the gearbox, were the gear kept [rad/s].
    omega_idle, omega_launch, open_when_braking
        Parameters of the control.
    opened
        Whether it is open for other reasons: a shift is under way, or the engine is off.
    before, decided
        The state before; whether it is kept.

    """
    asked = tau > ASKED
    idle_open = ca.logic_and(ca.logic_not(asked), ca.logic_or(open_when_braking, omega_estimate < omega_idle))
    is_open = where(decided, before == OPEN, ca.logic_or(opened, idle_open))
    # The estimate is that of the old gear: after a shift down the clutch may already turn faster.
    omega_input = ca.fmax(omega_estimate, omega)
    slipping = ca.logic_and(ca.logic_and(asked, omega_input < omega_launch), before < 2.5)
    slipping = where(decided, before == SLIPPING, ca.logic_and(slipping, ca.logic_not(is_open)))
    return ClutchLogic(where(is_open, OPEN, where(slipping, SLIPPING, ENGAGED)), is_open, slipping)


@dataclass(frozen=True)
class ClutchControl(Component):
    """What the controls of an engine behind a clutch share: what they remember, and what they command."""

    states: ClassVar[tuple[State, ...]] = (
        State("clutch_before", "1", "state of the clutch in the previous step", decision=True),
        State("on_before", "1", "whether the engine was on in the previous step", decision=True),
    )
    variables: ClassVar[tuple[Variable, ...]] = (
        Variable("clutch_state", "1", "1 open, 2 slipping, 3 engaged", kind="count"),
        Variable("clutch_open", "1", "whether the clutch is open", signal=True, kind="flag"),
        Variable("clutch_slipping", "1", "whether the clutch slips", signal=True, kind="flag"),
        Variable("engine_on", "1", "whether the engine runs", signal=True, kind="flag"),
        Variable("omega_command", "rad/s", "commanded engine speed", signal=True),
    )
    signals: ClassVar[tuple[Signal, ...]] = (
        Signal("omega_idle", "rad/s", "idling speed"),
        Signal("omega_launch", "rad/s", "speed of the engine while the clutch slips at launch"),
    )

    @staticmethod
    def decision(clutch: ClutchLogic, on: Expr, omega: Expr) -> Mapping[str, Any]:
        """Return what a face gives that decides on clutch and engine; `omega` is the speed of an engine that runs."""
        return {
            "clutch_state": clutch.state,
            "clutch_open": clutch.is_open,
            "clutch_slipping": clutch.slipping,
            "engine_on": on,
            "omega_command": where(on, omega, 0),
            "next_clutch_before": clutch.state,
            "next_on_before": on,
        }


#: Names of what `ClutchControl.decision` gives.
COMMANDS = ("clutch_state", "clutch_open", "clutch_slipping", "engine_on", "omega_command", "next_clutch_before", "next_on_before")
