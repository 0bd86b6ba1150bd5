"""What the controls of a source beside a battery share: when the source runs, and at what power.

In each step:

1. the power that would supply the bus (the subclass knows what the source needs for it);
2. plus a charging power in proportion to how far the state of charge is below the middle of its window;
3. cut to the range of normal power (no upper cut when the battery is short) and slewed;
4. on below the lower end of the window, off above the upper end, or by demand after the least off time; or always.

A thermostat has equal lowest and highest power and no slew, so it runs at one point.  The average of the demand over
five seconds is kept in one-second parts.  What the source does with the power is the subclass's *operating point*.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import casadi as ca

from halfshaft.library.base.component import Command, Component, From, State, commanded, face
from halfshaft.library.base.expressions import clip, where
from halfshaft.library.base.parameters import Parameters, Relation, param
from halfshaft.library.base.ports import Expr

#: One-second parts of the five-second average.
PARTS = 5


@dataclass(frozen=True, kw_only=True)
class PowerFollowerParameters(Parameters):
    """Window of the state of charge, powers and times."""

    soc_high: float = param("1", "state of charge above which the source is off", 0.8, ge=1e-3, le=1, tag="highest charge")
    soc_low: float = param("1", "state of charge below which the source is on", 0.4, ge=0, le=0.999, tag="lowest charge")
    on_start: float = param("1", "1 if the source is on at the start", 0.0, ge=0, le=1)
    P_min_share: float = param("1", "lowest power of the source over its largest", 0.5, ge=1e-3, le=1)
    P_max_share: float = param("1", "highest normal power of the source over its largest", 0.5, ge=1e-3, le=1)
    P_charge: float = param("W", "charging power at the lower end of the window", 0.0, ge=0, le=1e8)
    t_off_min: float = param("s", "shortest time off; very long for a thermostat", 1e9, ge=0, le=1e12)
    P_rise: float = param("W/s", "fastest rise of the source's power", 0.0, ge=0, le=1e9, tag="source rise")
    P_fall: float = param("W/s", "fastest fall of the source's power", 0.0, ge=0, le=1e9)
    charge_depleting: float = param("1", "1 to start the source only in the lower half of the window", 0.0, ge=0, le=1, tag="depletes")
    always_on: float = param("1", "1 to keep the source on while the key is", 0.0, ge=0, le=1)

    relations = (Relation(lambda p: p.soc_low >= p.soc_high, "soc_low = {soc_low:g} must be below soc_high = {soc_high:g}"),)


class Supply(NamedTuple):
    """Power of the source that would supply the bus, the ends of its normal range, and its largest."""

    P: Expr
    P_min: Expr
    P_max: Expr
    P_largest: Expr


class Demand(NamedTuple):
    """Power that bus and battery ask of the source; whether the battery is short, or has no room for the lowest power."""

    P: Expr
    short: Expr
    full: Expr


@dataclass(frozen=True)
class PowerFollower(Component):
    """Decides when a source runs and at what power; a subclass gives `_supply` and an operating point."""

    p: PowerFollowerParameters
    states: ClassVar[tuple[State, ...]] = (
        State("on_before", "1", "whether the source was on in the previous step"),
        State("t_off", "s", "time since the source was stopped, below 0 in the step that stops it"),
        State("P_before", "W", "slewed power of the previous step; below 0 before the first"),
        State("part_time", "s", "time in the present part of the average"),
        State("part_energy", "J", "demand in the present part of the average"),
        *(State(f"part_{i}", "J", f"demand in the part {i} s ago") for i in range(1, PARTS + 1)),
    )
    commands: ClassVar[tuple[Command, ...]] = (
        Command("run", "whether the source runs", "flag"),
        Command("share", "power of the source over its largest", "share", needs="run"),
    )
    reads: ClassVar[tuple[From, ...]] = (From("bus", P_bus="W"), From("battery", soc_before="1", P_battery_max="W", P_battery_min="W"))

    def start(self) -> Mapping[str, Any]:
        """Return the start values."""
        return {**super().start(), "on_before": self.p.on_start, "P_before": -1.0}

    @property
    def middle(self) -> Expr:
        """Middle of the window of the state of charge."""
        return (self.p.soc_high + self.p.soc_low) / 2

    @face("_demand")
    def demand(self, P_bus: Expr, soc_before: Expr, P_battery_max: Expr, P_battery_min: Expr, _supply: Supply) -> Mapping[str, Any]:
        """Add the charging power to what supplies the bus."""
        half, room = (self.p.soc_high - self.p.soc_low) / 2, P_bus - P_battery_min
        P_charge = self.p.P_charge * clip((self.middle - soc_before) / half, -1, 1)
        P_charge = where(P_bus <= 0, ca.fmin(room, P_charge), P_charge)
        full = ca.logic_and(_supply.P_min > room, P_bus < 0)
        return {"_demand": Demand(_supply.P + P_charge, P_bus >= P_battery_max, full)}

    @face("_average", "next_part_time", "next_part_energy", *(f"next_part_{i}" for i in range(1, PARTS + 1)))
    def average(
        self, dt: Expr, _demand: Demand, part_time: Expr, part_energy: Expr,
        part_1: Expr, part_2: Expr, part_3: Expr, part_4: Expr, part_5: Expr,
    ) -> Mapping[str, Any]:  # fmt: skip
        """Return the average of the demand over the five seconds before this step, and move its parts on."""
        parts = [part_1, part_2, part_3, part_4, part_5]
        energy, time = part_energy + _demand.P * dt, part_time + dt
        turn = time >= 1 - 1e-9
        moved = zip([energy, *parts[:-1]], parts, strict=True)
        return {
            "_average": sum(parts) / PARTS,
            "next_part_time": where(turn, 0, time),
            "next_part_energy": where(turn, 0, energy),
            **{f"next_part_{i}": where(turn, new, old) for i, (new, old) in enumerate(moved, 1)},
        }

    @face("_P", "next_P_before")
    def power(self, dt: Expr, soc_before: Expr, _demand: Demand, _supply: Supply, P_before: Expr) -> Mapping[str, Any]:
        """Cut the demand to the normal range and slew it."""
        p = self.p
        P = ca.fmax(_demand.P, _supply.P_min)
        normal = ca.logic_and(ca.logic_not(_demand.short), soc_before >= p.soc_low)
        P = where(normal, ca.fmin(P, _supply.P_max), P)
        P = where(P_before < 0, P, clip(P, P_before - p.P_fall * dt, P_before + p.P_rise * dt))
        return {"_P": P, "next_P_before": P}

    @face("_on", "next_on_before", "next_t_off")
    def decide(
        self, key_on: Expr, dt: Expr, soc_before: Expr, _demand: Demand, _supply: Supply, _average: Expr, on_before: Expr, t_off: Expr
    ) -> Mapping[str, Any]:
        """Decide whether the source runs."""
        p = self.p
        # The present step counts; the one after a stop begins to count at 0.
        off = where(t_off < 0, 0, t_off + dt)
        restart = ca.logic_and(off >= p.t_off_min - 1e-9, _average >= 1.2 * _supply.P_min)
        wanted = ca.logic_or(ca.logic_or(on_before, restart), soc_before <= p.soc_low)
        wanted = ca.logic_and(wanted, ca.logic_or(soc_before <= p.soc_high, _demand.P >= _supply.P_min))
        wanted = ca.logic_and(wanted, ca.logic_or(ca.logic_not(p.charge_depleting), soc_before <= self.middle))
        on = ca.logic_and(ca.logic_or(wanted, _demand.short), ca.logic_not(_demand.full))
        on = ca.logic_and(key_on, ca.logic_or(on, p.always_on))
        return {"_on": on, "next_on_before": on, "next_t_off": where(ca.logic_and(on_before, ca.logic_not(on)), -1, off)}

    @commanded("_on", "next_on_before", "_P")
    def obey(self, key_on: Expr, run: Expr, share: Expr, _supply: Supply) -> Mapping[str, Any]:
        """Take when the source runs and at what power from outside."""
        on = ca.logic_and(key_on, run)
        return {"_on": on, "next_on_before": on, "_P": share * _supply.P_largest}
