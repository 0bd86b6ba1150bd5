"""What all stores on the bus share: a voltage behind a resistance, limits, and a thermal node.

For N modules in series::

    P = U I = (U_oc - R I) I                                                 (1), solved for I

Limits: the voltage stays between U_min (no lower than half of U_oc, where the power is largest) and U_max; an empty
pack gives nothing; a full one takes nothing.  Each module warms by its loss and is cooled by air::

    m c_p dT/dt = P_loss / N - (T - T_ambient) / R_th                        (2)

where R_th falls when the fan runs, above T_fan; the fan's air leaves warmer than it came, which adds
``1 / (2 airflow c_air)`` to R_th.  All limits and tables take the state at the start of the step.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import reduce
from typing import Any, ClassVar, NamedTuple

import casadi as ca
import numpy as np

from halfshaft.library.base.component import Component, From, Signal, State, Variable, face, plant
from halfshaft.library.base.expressions import clip, where
from halfshaft.library.base.parameters import Parameters, Rated, Relation, param
from halfshaft.library.base.ports import Electric, Expr, Port
from halfshaft.library.base.tables import Axis

TEMPERATURE, CHARGE = Axis("T", "K"), Axis("soc", "1")

#: A pack counts as empty up to here, and as full from here on, unless it is told otherwise.
SOC_EMPTY, SOC_FULL = 1e-3, 0.999
#: Charge over which the limits of an empty or full pack set in, in the forward-facing model.
SOC_FADE = 1e-4
#: Square of the least root of (1) over U_oc; its slope stays finite at the largest power, and beyond.
ROOT_FLOOR = 1e-12
#: Specific heat of the cooling air [J/(kg.K)].
C_AIR = 1009.0


@dataclass(frozen=True, kw_only=True)
class StoreParameters(Parameters):
    """A pack of equal modules in series."""

    n_modules: float = param("1", "number of modules in series", ge=1, le=1e4, tag="store size")
    u_min: float = param("V", "lowest voltage of a module", ge=0, le=1e4, tag="lowest module voltage")
    u_max: float = param("V", "highest voltage of a module", ge=0.1, le=1e4, tag="highest module voltage")
    capacity_scale: float = param("1", "factor on the capacity", 1.0, ge=1e-3, le=1e3)
    soc_start: float = param("1", "state of charge at the start", 0.7, ge=0, le=1, tag="start charge")
    soc_empty: float = param("1", "state of charge up to which nothing is drawn", SOC_EMPTY, ge=0, le=0.999, tag="empty charge")
    soc_full: float = param("1", "state of charge from which on nothing is stored", SOC_FULL, ge=1e-3, le=1, tag="full charge")
    T_start: float = param("K", "temperature at the start", 293.15, ge=200, le=400, tag="start temperature")
    T_ambient: float = param("K", "temperature of the air", 293.15, ge=200, le=400)
    T_fan: float = param("K", "temperature above which the fan runs", 308.15, ge=200, le=500)
    mass: float = param("kg", "mass of a module", ge=1e-3, le=1e4)
    c_p: float = param("J/(kg.K)", "specific heat", ge=10, le=1e5)
    R_th_fan: float = param("K/W", "thermal resistance of a module to the air with fan", ge=1e-3, le=1e3)
    R_th_still: float = param("K/W", "thermal resistance of a module to the air without fan", ge=1e-3, le=1e3)
    airflow: float = param("kg/s", "air flow of the fan at a module", ge=1e-6, le=10)

    relations: ClassVar[tuple[Relation, ...]] = (
        Relation(lambda p: p.soc_empty >= p.soc_full, "soc_empty = {soc_empty:g} must be below soc_full = {soc_full:g}"),
    )

    rated: ClassVar[tuple[Rated, ...]] = (Rated("E", "J", "energy of the full pack", "capacity_scale", lambda p: p.ratings()["energy"]),)

    @property
    def weight(self) -> float:
        """Mass of the pack [kg]."""
        return self.n_modules * self.mass * self.capacity_scale

    @property
    def P_own(self) -> float:
        """Largest power that the pack gives at its start temperature, at whatever charge it gives most [W]."""
        u, r = self.module
        u_low = np.maximum(u / 2, self.u_min)
        return float(self.n_modules * self.capacity_scale * np.max(u_low * (u - u_low) / r))

    @property
    def module(self) -> tuple[Any, Any]:
        """Voltage [V] and resistance [ohm] of a module that is discharged at the start temperature, at some charges."""
        raise NotImplementedError


class Circuit(NamedTuple):
    """Voltage source and resistance of the pack."""

    U_oc: Expr
    R: Expr

    def current(self, P: Expr) -> Expr:
        """Return the current that gives a terminal power, equation (1) [A]."""
        return 2 * P / (self.U_oc + ca.sqrt(ca.fmax(self.U_oc**2 - 4 * self.R * P, ROOT_FLOOR * self.U_oc**2)))


class Source(NamedTuple):
    """State of charge, voltage source, and the resistances of discharging and charging."""

    soc: Expr
    U_oc: Expr
    R_out: Expr
    R_in: Expr

    def circuit(self, P: Expr) -> Circuit:
        """Return the circuit for a power of this sign."""
        return Circuit(self.U_oc, where(P >= 0, self.R_out, self.R_in))


class Limits(NamedTuple):
    """What the pack can give and take."""

    P_max: Expr
    P_min: Expr
    I_min: Expr


@dataclass(frozen=True)
class Store(Component):
    """A pack at the bus; a subclass gives its `_source`, and what leaves its store at a voltage and a current."""

    family = "battery"
    p: StoreParameters
    dc = Port(Electric, "wheel")
    states: ClassVar[tuple[State, ...]] = (
        State("T", "K", "temperature of the modules", shown=True, tag="temperature"),
        State("soc", "1", "state of charge", shown=True, tag="charge"),
        State("U_supply", "V", "voltage at the end of the previous step", signal=True, neutral=0.0),
    )
    variables: ClassVar[tuple[Variable, ...]] = (
        Variable("U", "V", "terminal voltage", signal=True),
        Variable("I", "A", "current"),
        Variable("P_stored", "W", "power drawn from the store", "stored"),
        Variable("P_loss", "W", "power lost", "loss"),
        Variable("P_battery_max", "W", "largest discharging power", signal=True),
        Variable("P_battery_min", "W", "largest charging power, negative", signal=True),
        Variable(
            "battery_limited", "1", "whether a limit of the battery acts", kind="flag", tag="store limit", warning="battery limit reached"
        ),
    )
    plant_states: ClassVar[tuple[tuple[State, str], ...]] = ((states[0], "T"),)
    signals = (
        Signal("P_room_out", "W", "what the pack can give more"),
        Signal("P_room_in", "W", "what it can take more"),
        Signal("soc_before", "1", "state of charge at the start of the step"),
    )
    reads = (From("load", each=True, U_min="V"),)

    def limits_at(self, source: Source, U_min: tuple[Expr, ...] = ()) -> Limits:
        """Return the limits of power and current; `U_min` are the lowest voltages of what hangs on the bus."""
        p, (soc, U_oc, R_out, R_in) = self.p, source
        U_lowest = ca.fmax(reduce(ca.fmax, U_min, 0.5 * U_oc), p.n_modules * p.u_min)
        P_max = ca.fmax(0, (U_oc - U_lowest) * U_lowest / R_out)
        I_min = ca.fmin(0, (U_oc - p.n_modules * p.u_max) / R_in)
        P_min = I_min * (U_oc - I_min * R_in)
        return Limits(where(soc > p.soc_empty, P_max, 0), where(soc < p.soc_full, P_min, 0), I_min)

    def warming(self, P_loss: Expr, T: Expr) -> Expr:
        """Return the rate of the temperature, equation (2) [K/s]."""
        p = self.p
        R_th = where(p.T_fan < T, p.R_th_fan + 1 / (2 * p.airflow * C_AIR), p.R_th_still)
        return (P_loss / p.n_modules - (T - p.T_ambient) / R_th) / (p.mass * p.c_p)

    @face("P_battery_max", "P_battery_min", "_limits")
    def limits(self, _source: Source, U_min: tuple[Expr, ...]) -> Mapping[str, Any]:
        """Publish the limits, which the control of a hybrid looks at."""
        limits = self.limits_at(_source, U_min)
        return {"P_battery_max": limits.P_max, "P_battery_min": limits.P_min, "_limits": limits}

    @face("dc", "U", "I", "battery_limited", "next_U_supply")
    def available(self, dc: Electric, _limits: Limits, _source: Source) -> Mapping[str, Any]:
        """Return the power that the pack gives."""
        P = ca.fmin(dc.P, ca.fmax(0, _limits.P_max))
        P = where(ca.logic_and(_source.soc >= self.p.soc_full, dc.P < 0), 0, P)
        circuit = _source.circuit(dc.P)
        current = ca.fmax(circuit.current(P), _limits.I_min)
        U = circuit.U_oc - circuit.R * current
        limited = ca.logic_or(P != dc.P, circuit.current(P) < _limits.I_min)
        # Inside the limits the power is what was asked for, not I U, so that nothing is lost to rounding.
        given = Electric(where(limited, U * current, dc.P))
        return {"dc": given, "U": U, "I": current, "battery_limited": limited, "next_U_supply": U}

    @plant("U", "I", "_U", "P_room_out", "P_room_in")
    def flow(self, dc: Electric, _source: Source, U_min: tuple[Expr, ...]) -> Mapping[str, Any]:
        """Return voltage and current in continuous time, and how far the power is from its limits."""
        limits, circuit, soc = self.limits_at(_source, U_min), _source.circuit(dc.P), _source.soc
        current = circuit.current(dc.P)
        U = circuit.U_oc - circuit.R * current
        return {
            # No power lies beyond half of the open-circuit voltage; the solver may look there, but must not settle there.
            "U": ca.fmax(U, 0.5 * circuit.U_oc),
            "_U": U,
            "I": current,
            "P_room_out": clip((soc - self.p.soc_empty) / SOC_FADE, 0, 1) * limits.P_max - dc.P,
            "P_room_in": dc.P - clip((self.p.soc_full - soc) / SOC_FADE, 0, 1) * limits.P_min,
        }
