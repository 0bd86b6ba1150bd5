"""Shift logic: which gear, and whether a shift is under way.

A sampled law: the step and the forward-facing model run the same one.  The load is the estimated input torque over the
torque that the machine can give at the estimated input speed::

    tau_e = tau_out / (clip(eta, 0.2, 1) G)                                  (1)
    load  = clip(tau_e / tau_max(omega_e), 0, 1), 1 while the grip limit acts

Shift up where the load is below the up line of the present gear, and the control of a hybrid allows it; down where it is
above the down line; one gear a step, not down so soon after a gear was raised.  That rule counts seconds: the original's two
steps are two seconds at steps of 1 s, but at 0.01 s would let the gears change 1900 times on UDDS.  After a change the gearbox
is open for the shift delay.  A gearbox with one ratio uses `FixedGear`.

An automatic gearbox (`AutomaticShift`) passes torque while it shifts.  Speed and torque in (1) are those of the engine, behind
the converter, the efficiency is at least 0.7, and the load of a braking engine is negative.  The control also closes the
lock-up clutch, in the gears that have one, where a locked converter would not make it shift down, now and in the step before;
after a change of gear it stays open for the shift delay.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca

from halfshaft.library.base.component import Command, Component, From, Signal, State, Variable, commanded, face
from halfshaft.library.base.expressions import clip, where
from halfshaft.library.base.interfaces import Machine
from halfshaft.library.base.parameters import Parameters, param, params, table
from halfshaft.library.base.ports import Expr
from halfshaft.library.base.tables import Axis, Table
from halfshaft.library.driveline.torque_converter import TorqueConverter

SPEED, GEAR = Axis("omega", "rad/s"), Axis("gear", "1")


@dataclass(frozen=True, kw_only=True)
class ShiftParameters(Parameters):
    """Shift lines over input speed, gear by gear."""

    up: Table = table("1", "load below which to shift up", SPEED, GEAR, clip=False)
    down: Table = table("1", "load above which to shift down", SPEED, GEAR, clip=False)
    t_shift: float = param("s", "time without torque after a change of gear", 0.0, ge=0, le=100, tag="shift time")
    t_hold: float = param("s", "shortest time between two changes of gear", 0.0, ge=0, le=1e12, tag="hold time")
    t_raised: float = param("s", "shortest time between a change upward and the next one downward", 2.0, ge=0, le=1e12)
    gear_start: float = param("1", "gear at the start", 1.0, ge=1, le=100, tag="start gear")


@dataclass(frozen=True, kw_only=True)
class AutomaticShiftParameters(ShiftParameters):
    """Shift lines over engine speed, and the gears that lock the converter."""

    lockup: tuple[float, ...] = params("1", "1 if the converter may be locked, gear by gear", ge=0, le=1)


@dataclass(frozen=True, kw_only=True)
class FixedGearParameters(Parameters):
    """A fixed gear has no parameters."""


@dataclass(frozen=True)
class FixedGear(Component):
    """Always the first gear."""

    kind = "fixed-gear"
    family = "gear-choice"
    p: FixedGearParameters
    parameters = FixedGearParameters
    signals = (Signal("ratio", "1", "the ratio"), Signal("gear", "1", "the gear"))
    reads = (From("gearbox", ratios="1"),)

    @face("ratio", "gear")
    def law(self, ratios: tuple[Expr, ...]) -> Mapping[str, Any]:
        """Return the only ratio."""
        return {"ratio": ratios[0], "gear": 1.0}


@dataclass(frozen=True)
class Shift(Component):
    """Chooses a gear by load and speed."""

    kind = "shift"
    family = "gear-choice"
    p: ShiftParameters
    parameters = ShiftParameters
    states: ClassVar[tuple[State, ...]] = (
        State("gear_before", "1", "gear of the previous step", decision=True),
        State("raised", "1", "whether the last change of gear was upward", decision=True),
        State("t_since_shift", "s", "time since the last change of gear", decision=True),
        State("omega_estimate", "rad/s", "input speed at the end of the previous step, as achieved"),
    )
    variables: ClassVar[tuple[Variable, ...]] = (
        Variable("gear", "1", "gear", signal=True, kind="count", tag="gear"),
        Variable("ratio", "1", "ratio of the gear", signal=True),
        Variable("shifting", "1", "whether a shift is under way", signal=True, kind="flag"),
        Variable("load", "1", "estimated load of the machine"),
    )
    commands: ClassVar[tuple[Command, ...]] = (
        Command("change", "change of the gear, as far as the times between changes allow", "step", lowest=-1.0, memory="gear_before"),
    )
    signals = (
        Signal("omega_input_estimate", "rad/s", "estimated input speed, were the gear kept"),
        Signal("ratio_before", "1", "ratio of the gear so far"),
        Signal("ratio_above", "1", "ratio of the next gear up"),
    )
    reads: ClassVar[tuple[From, ...]] = (
        From("gearbox", tau_gearbox="N.m", omega_gearbox="rad/s", torque_ratio="1", ratios="1", omega_gearbox_input="rad/s"),
        From("machine", Machine, along=("gearbox", "input")),
        From("wheel", slip_limited="1", v_driveline="m/s"),
        From("body", trace_missed="1", next_v="m/s"),
        From("accessories", optional=True, tau_accessory_before="N.m"),
        From("control", optional=True, upshift_allowed="1"),
    )

    def start(self) -> Mapping[str, Any]:
        """Return the start values: no recent shift."""
        return {"gear_before": self.p.gear_start, "raised": 0.0, "t_since_shift": 15.0, "omega_estimate": 0.0}

    def ratio_of(self, gear: Expr, ratios: tuple[Expr, ...]) -> Expr:
        """Return the ratio of a whole-numbered gear."""
        ratio = ratios[0]
        for i, r in enumerate(ratios[1:], 2):
            ratio = where(gear >= i - 0.5, r, ratio)
        return ratio

    @face("ratio_before", "ratio_above")
    def neighbours(self, gear_before: Expr, ratios: tuple[Expr, ...]) -> Mapping[str, Any]:
        """Publish the ratios among which a shift upward chooses."""
        return {"ratio_before": self.ratio_of(gear_before, ratios), "ratio_above": self.ratio_of(gear_before + 1, ratios)}

    def input_speed(
        self, omega_gearbox: Expr, ratio_before: Expr, trace_missed: Expr, slip_limited: Expr, omega_estimate: Expr, dt: Expr
    ) -> Expr:
        """Return the gearbox's estimated input speed, were the gear kept [rad/s]."""
        # Beyond the grip the required speed is that of spinning wheels.
        slow = ca.logic_and(ca.logic_or(trace_missed, slip_limited), dt <= 0.11)
        return where(slow, omega_estimate, omega_gearbox * ratio_before)

    @face("load", "omega_input_estimate")
    def demand(
        self, tau_gearbox: Expr, omega_gearbox: Expr, slip_limited: Expr, trace_missed: Expr, torque_ratio: Expr,
        ratios: tuple[Expr, ...], machine: Machine, dt: Expr, gear_before: Expr, omega_estimate: Expr, tau_accessory_before: Expr = 0.0,
    ) -> Mapping[str, Any]:  # fmt: skip
        """Return the load of the machine, equation (1), and its speed."""
        ratio_before = self.ratio_of(gear_before, ratios)
        omega = self.input_speed(omega_gearbox, ratio_before, trace_missed, slip_limited, omega_estimate, dt)
        tau = tau_gearbox / (clip(torque_ratio, 0.2, 1) * ratio_before) + tau_accessory_before
        load = where(slip_limited, 1, clip(tau / ca.fmax(machine.tau_envelope(omega), 1e-9), 0, 1))
        return {"load": load, "omega_input_estimate": omega}

    @face("_lines")
    def compare(self, load: Expr, omega_input_estimate: Expr, gear_before: Expr, upshift_allowed: Expr = 1.0) -> Mapping[str, Any]:
        """Say on which side of the lines the load is."""
        omega = omega_input_estimate
        above = ca.logic_and(load < self.p.up(omega, gear_before), upshift_allowed)
        return {"_lines": (above, load > self.p.down(omega, gear_before))}

    @commanded("_lines")
    def obey(self, change: Expr) -> Mapping[str, Any]:
        """Take from outside whether to shift."""
        return {"_lines": (change > 0.5, change < -0.5)}

    @face("gear", "ratio", "shifting", "next_gear_before", "next_raised", "next_t_since_shift")
    def control(
        self, _lines: tuple[Expr, Expr], ratios: tuple[Expr, ...], dt: Expr, gear_before: Expr, raised: Expr, t_since_shift: Expr,
        decided: Expr,
    ) -> Mapping[str, Any]:  # fmt: skip
        """Choose the gear for this step."""
        free = t_since_shift >= self.p.t_hold - 1e-6
        kept = ca.logic_and(raised, t_since_shift < self.p.t_raised - 1e-6)
        up, down = (ca.logic_and(free, wanted) for wanted in _lines)
        change = where(decided, 0, where(up, 1, where(ca.logic_and(down, ca.logic_not(kept)), -1, 0)))
        gear = clip(gear_before + change, 1, len(ratios))
        since = where(decided, t_since_shift, where(gear != gear_before, 0, t_since_shift + dt))
        return {
            "gear": gear,
            "ratio": self.ratio_of(gear, ratios),
            "shifting": since < self.p.t_shift - 1e-6,
            "next_gear_before": gear,
            "next_raised": where(gear == gear_before, raised, gear > gear_before),
            "next_t_since_shift": since,
        }

    @face("next_omega_estimate")
    def estimate(self, omega_gearbox_input: Expr, v_driveline: Expr, next_v: Expr) -> Mapping[str, Any]:
        """Remember the input speed at the end of the step (paper eq. 10)."""
        return {"next_omega_estimate": where(v_driveline > 0, omega_gearbox_input * next_v / ca.fmax(v_driveline, 1e-12), 0)}


@dataclass(frozen=True)
class AutomaticShift(Shift):
    """Chooses a gear of an automatic gearbox behind a torque converter, and locks the converter."""

    kind = "automatic-shift"
    family = ""
    p: AutomaticShiftParameters
    parameters = AutomaticShiftParameters
    states = (
        *Shift.states,
        State("locked_before", "1", "whether the converter was locked in the previous step", decision=True),
        State("lockable", "1", "whether the previous step would have kept its gear with a locked converter", decision=True),
    )
    variables = (
        *(v._replace(signal=v.signal and v.name != "shifting") for v in Shift.variables),
        Variable("geared", "1", "whether the converter is locked, so that the engine turns with the gearbox", signal=True, kind="flag"),
    )
    reads = (*Shift.reads, From("converter", TorqueConverter), From("control", omega_idle="rad/s"))

    def start(self) -> Mapping[str, Any]:
        """Return the start values: no recent shift, not locked."""
        return {**super().start(), "locked_before": 0.0, "lockable": 0.0}

    def load_at(self, tau: Expr, omega: Expr, slip_limited: Expr, machine: Machine) -> Expr:
        """Return a torque at the engine over the largest one at a speed."""
        return where(slip_limited, 1, clip(tau / ca.fmax(machine.tau_envelope(omega), 1e-9), -1, 1))

    @face("load", "omega_input_estimate")
    def demand(
        self, tau_gearbox: Expr, omega_gearbox: Expr, slip_limited: Expr, trace_missed: Expr, torque_ratio: Expr,
        ratios: tuple[Expr, ...], machine: Machine, converter: TorqueConverter, omega_idle: Expr, dt: Expr, gear_before: Expr,
        omega_estimate: Expr, locked_before: Expr, tau_accessory_before: Expr = 0.0,
    ) -> Mapping[str, Any]:  # fmt: skip
        """Return the load of the engine, equation (1) behind the converter, and its speed."""
        ratio_before = self.ratio_of(gear_before, ratios)
        omega = self.input_speed(omega_gearbox, ratio_before, trace_missed, slip_limited, omega_estimate, dt)
        tau = tau_gearbox / (clip(torque_ratio, 0.7, 1) * ratio_before)
        pump = converter.omega_pump(tau, omega)
        tau_pump = converter.tau_pump(tau, omega)
        # A request beyond all torque would ask for a speed that the engine cannot reach against the converter.
        most = machine.tau_largest
        pump = where(tau_pump > most, ca.fmin(pump, converter.omega_settled(most, omega)), pump)
        tau_pump = where(pump < omega_idle, converter.tau_taken(omega_idle, omega), tau_pump)
        omega_engine = where(locked_before, omega, ca.fmax(pump, omega_idle))
        tau_engine = where(locked_before, tau, tau_pump) + tau_accessory_before
        return {"load": self.load_at(tau_engine, omega_engine, slip_limited, machine), "omega_input_estimate": omega_engine}

    @face("geared", "next_locked_before", "next_lockable")
    def lock(
        self, gear: Expr, ratio: Expr, shifting: Expr, tau_gearbox: Expr, omega_gearbox: Expr, slip_limited: Expr, torque_ratio: Expr,
        machine: Machine, omega_idle: Expr, locked_before: Expr, lockable: Expr, decided: Expr, tau_accessory_before: Expr = 0.0,
    ) -> Mapping[str, Any]:  # fmt: skip
        """Decide on the lock-up clutch for this step."""
        omega = omega_gearbox * ratio
        tau = tau_gearbox / (clip(torque_ratio, 0.7, 1) * ratio) + tau_accessory_before
        keeps = self.load_at(tau, omega, slip_limited, machine) <= self.p.down(omega, gear)
        able = ca.logic_and(ca.logic_and(self.ratio_of(gear, self.p.lockup), omega > omega_idle), keeps)
        locked = where(decided, locked_before, ca.logic_and(ca.logic_and(able, lockable), ca.logic_not(shifting)))
        return {"geared": locked, "next_locked_before": locked, "next_lockable": where(decided, lockable, able)}
