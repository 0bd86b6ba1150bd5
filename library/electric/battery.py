"""Battery pack: open-circuit voltage behind a resistance, with a thermal node.

For N modules in series::

    U_oc = N u_oc(T, soc),   R = N r(T, soc) / capacity_scale                (1), r of discharging or charging by the sign of P
    P    = U I = (U_oc - R I) I                                              (2), solved for I
    d D/dt = I discharging, eta_c I charging;   soc = 1 - D / Q(T)           (3), D the charge drawn
    P_loss = R I^2 + (1 - eta_c) U_oc |I| while charging                     (4)

Limits: the voltage stays between U_min (no lower than half of U_oc, where the power is largest) and U_max; an empty
pack gives nothing; a full one takes nothing.  Each module warms by its loss and is cooled by air::

    m c_p dT/dt = P_loss / N - (T - T_ambient) / R_th                        (5)

where R_th falls when the fan runs, above T_fan; the fan's air leaves warmer than it came, which adds
``1 / (2 airflow c_air)`` to R_th.  All limits and tables take the state at the start of the step.  Left out: ageing,
self-discharge, concentration (relaxation of voltage).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache, reduce
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from halfshaft.library.base.component import Component, From, Signal, State, Variable, face, plant
from halfshaft.library.base.expressions import clip, where
from halfshaft.library.base.parameters import Parameters, Relation, param, table
from halfshaft.library.base.ports import Electric, Expr, Port
from halfshaft.library.base.tables import Axis, Table

TEMPERATURE, CHARGE = Axis("T", "K"), Axis("soc", "1")

#: A pack counts as empty up to here, and as full from here on, unless it is told otherwise.
SOC_EMPTY, SOC_FULL = 1e-3, 0.999
#: Charge over which the limits of an empty or full pack set in, in the forward-facing model.
SOC_FADE = 1e-4
#: Square of the least root of (2) over U_oc; its slope stays finite at the largest power, and beyond.
ROOT_FLOOR = 1e-12
#: Specific heat of the cooling air [J/(kg.K)].
C_AIR = 1009.0


@dataclass(frozen=True, kw_only=True)
class BatteryParameters(Parameters):
    """A pack of equal modules in series; tables are for one module."""

    n_modules: float = param("1", "number of modules in series", ge=1, le=1e4)
    u_oc: Table = table("V", "open-circuit voltage of a module", TEMPERATURE, CHARGE, clip=True, gt=0)
    r_discharge: Table = table("ohm", "resistance of a module while discharging", TEMPERATURE, CHARGE, clip=True, gt=0)
    r_charge: Table = table("ohm", "resistance of a module while charging", TEMPERATURE, CHARGE, clip=True, gt=0)
    Q: Table = table("C", "capacity", TEMPERATURE, clip=True, gt=0)
    eta_coulomb: Table = table("1", "share of a charging current that is stored", TEMPERATURE, clip=True, gt=0, le=1)
    u_min: float = param("V", "lowest voltage of a module", ge=0, le=1e4)
    u_max: float = param("V", "highest voltage of a module", ge=0.1, le=1e4)
    capacity_scale: float = param("1", "factor on the capacity", 1.0, ge=1e-3, le=1e3)
    soc_start: float = param("1", "state of charge at the start", 0.7, ge=0, le=1, tag="start charge")
    soc_empty: float = param("1", "state of charge up to which nothing is drawn", SOC_EMPTY, ge=0, le=0.999)
    soc_full: float = param("1", "state of charge from which on nothing is stored", SOC_FULL, ge=1e-3, le=1)
    T_start: float = param("K", "temperature at the start", 293.15, ge=200, le=400)
    T_ambient: float = param("K", "temperature of the air", 293.15, ge=200, le=400)
    T_fan: float = param("K", "temperature above which the fan runs", 308.15, ge=200, le=500)
    mass: float = param("kg", "mass of a module", ge=1e-3, le=1e4)
    c_p: float = param("J/(kg.K)", "specific heat", ge=10, le=1e5)
    R_th_fan: float = param("K/W", "thermal resistance of a module to the air with fan", ge=1e-3, le=1e3)
    R_th_still: float = param("K/W", "thermal resistance of a module to the air without fan", ge=1e-3, le=1e3)
    airflow: float = param("kg/s", "air flow of the fan at a module", ge=1e-6, le=10)

    relations = (Relation(lambda p: p.soc_empty >= p.soc_full, "soc_empty = {soc_empty:g} must be below soc_full = {soc_full:g}"),)

    def ratings(self) -> Mapping[str, float]:
        """Return the energy of the full pack [J]."""
        return {"energy": pack_energy(self)}


# A sweep asks for the same part again and again.
@lru_cache(maxsize=64)
def pack_energy(p: BatteryParameters) -> float:
    """Return what a full pack stores at its start temperature, by its open-circuit voltage down to empty [J]."""
    T, soc = p.u_oc.points
    points = np.union1d(soc, (0.0, 1.0))
    points = points[(points >= 0) & (points <= 1)]
    u_oc = np.interp(points, soc, [np.interp(p.T_start, T, u) for u in p.u_oc.values.T])
    Q = np.interp(p.T_start, p.Q.points[0], p.Q.values)
    return float(p.n_modules * p.capacity_scale * Q * np.trapezoid(u_oc, points))


class Circuit(NamedTuple):
    """Voltage source and resistance of the pack."""

    U_oc: Expr
    R: Expr

    def current(self, P: Expr) -> Expr:
        """Return the current that gives a terminal power, equation (2) [A]."""
        return 2 * P / (self.U_oc + ca.sqrt(ca.fmax(self.U_oc**2 - 4 * self.R * P, ROOT_FLOOR * self.U_oc**2)))


class Limits(NamedTuple):
    """What the pack can give and take."""

    P_max: Expr
    P_min: Expr
    I_min: Expr


@dataclass(frozen=True)
class Battery(Component):
    """Battery pack at the bus."""

    kind = "battery"
    p: BatteryParameters
    parameters = BatteryParameters
    dc = Port(Electric, "wheel")
    states = (
        State("charge_drawn", "C", "charge drawn from the full pack", shown=True),
        State("T", "K", "temperature of the modules", shown=True, tag="temperature"),
        State("soc", "1", "state of charge", shown=True, tag="charge"),
        State("U_supply", "V", "voltage at the end of the previous step", signal=True, neutral=0.0),
    )
    variables = (
        Variable("U", "V", "terminal voltage", signal=True),
        Variable("I", "A", "current"),
        Variable("P_stored", "W", "power drawn from the chemical store", "stored"),
        Variable("P_loss", "W", "power lost", "loss"),
        Variable("P_battery_max", "W", "largest discharging power", signal=True),
        Variable("P_battery_min", "W", "largest charging power, negative", signal=True),
        Variable(
            "battery_limited", "1", "whether a limit of the battery acts", kind="flag", tag="store limit", warning="battery limit reached"
        ),
    )

    def start(self) -> Mapping[str, Any]:
        """Return the start values."""
        p = self.p
        drawn = (1 - p.soc_start) * self.capacity(p.T_start)
        return {"charge_drawn": drawn, "T": p.T_start, "soc": p.soc_start, "U_supply": p.n_modules * p.u_oc(p.T_start, p.soc_start)}

    def capacity(self, T: Expr) -> Expr:
        """Return the charge of a full pack [C]."""
        return self.p.capacity_scale * self.p.Q(T)

    def soc(self, charge_drawn: Expr, T: Expr) -> Expr:
        """Return the state of charge, equation (3); of what has been drawn, a cold pack with its smaller capacity has less left."""
        # The reciprocal is a constant of a pack whose capacity does not depend on the temperature.
        return clip(1 - charge_drawn * (1 / self.capacity(T)), 0, 1)

    def circuit(self, soc: Expr, T: Expr, P: Expr) -> Circuit:
        """Return equation (1) for a power of this sign."""
        p = self.p
        r = where(P >= 0, p.r_discharge(T, soc), p.r_charge(T, soc))
        return Circuit(p.n_modules * p.u_oc(T, soc), p.n_modules * r / p.capacity_scale)

    def limits_at(self, soc: Expr, T: Expr, U_min: tuple[Expr, ...] = ()) -> Limits:
        """Return the limits of power and current; `U_min` are the lowest voltages of what hangs on the bus."""
        p = self.p
        N, u_oc = p.n_modules, p.u_oc(T, soc)
        U_oc, scale = N * u_oc, N / p.capacity_scale
        U_lowest = ca.fmax(reduce(ca.fmax, U_min, 0.5 * U_oc), N * p.u_min)
        P_max = ca.fmax(0, (U_oc - U_lowest) * U_lowest / (scale * p.r_discharge(T, soc)))
        I_min = ca.fmin(0, (U_oc - N * p.u_max) / (scale * p.r_charge(T, soc)))
        P_min = I_min * (U_oc - I_min * scale * p.r_charge(T, soc))
        return Limits(where(soc > p.soc_empty, P_max, 0), where(soc < p.soc_full, P_min, 0), I_min)

    def rates(self, circuit: Circuit, current: Expr, T: Expr) -> dict[str, Expr]:
        """Return the rates of the states and the powers, equations (3) to (5)."""
        p = self.p
        eta = where(current >= 0, 1, p.eta_coulomb(T))
        stored = circuit.U_oc * eta * current
        loss = stored - (circuit.U_oc - circuit.R * current) * current
        R_th = where(p.T_fan < T, p.R_th_fan + 1 / (2 * p.airflow * C_AIR), p.R_th_still)
        return {
            "charge_drawn": eta * current,
            "T": (loss / p.n_modules - (T - p.T_ambient) / R_th) / (p.mass * p.c_p),
            "P_stored": stored,
            "P_loss": loss,
        }

    plant_states = ((states[0], "charge_drawn"), (states[1], "T"))
    signals = (
        Signal("P_room_out", "W", "what the pack can give more"),
        Signal("P_room_in", "W", "what it can take more"),
        Signal("soc_before", "1", "state of charge at the start of the step"),
    )
    reads = (From("load", each=True, U_min="V"),)

    @face("P_battery_max", "P_battery_min", "soc_before", "_limits")
    def limits(self, charge_drawn: Expr, T: Expr, U_min: tuple[Expr, ...]) -> Mapping[str, Any]:
        """Publish the state of charge at the start of the step and the limits, which the control of a series hybrid looks at."""
        soc = self.soc(charge_drawn, T)
        limits = self.limits_at(soc, T, U_min)
        return {"P_battery_max": limits.P_max, "P_battery_min": limits.P_min, "soc_before": soc, "_limits": limits}

    @face("dc", "next_soc", "U", "I", "P_stored", "P_loss", "battery_limited", "next_charge_drawn", "next_T", "next_U_supply")
    def available(self, dc: Electric, _limits: Limits, soc_before: Expr, charge_drawn: Expr, T: Expr, dt: Expr) -> Mapping[str, Any]:
        """Return the power that the battery gives."""
        P = ca.fmin(dc.P, ca.fmax(0, _limits.P_max))
        P = where(ca.logic_and(soc_before >= self.p.soc_full, dc.P < 0), 0, P)
        circuit = self.circuit(soc_before, T, dc.P)
        current = ca.fmax(circuit.current(P), _limits.I_min)
        U = circuit.U_oc - circuit.R * current
        rates = self.rates(circuit, current, T)
        limited = ca.logic_or(P != dc.P, circuit.current(P) < _limits.I_min)
        next_drawn, next_T = charge_drawn + dt * rates["charge_drawn"], T + dt * rates["T"]
        return {
            # Inside the limits the power is what was asked for, not I U, so that nothing is lost to rounding.
            "dc": Electric(where(limited, U * current, dc.P)),
            "next_soc": self.soc(next_drawn, next_T),
            "U": U,
            "I": current,
            "P_stored": rates["P_stored"],
            "P_loss": rates["P_loss"],
            "battery_limited": limited,
            "next_charge_drawn": next_drawn,
            "next_T": next_T,
            "next_U_supply": U,
        }

    def audit(
        self, dc: Electric, charge_drawn: Expr, next_charge_drawn: Expr, T: Expr, dt: Expr, P_stored: Expr, P_loss: Expr
    ) -> Mapping[str, Any]:
        """Compare store and loss with the circuit's at the terminal power, equations (2) and (4), and with the charge that left."""
        circuit = self.circuit(self.soc(charge_drawn, T), T, dc.P)
        I = circuit.current(dc.P)  # noqa: E741
        charging = where(I < 0, (1 - self.p.eta_coulomb(T)) * circuit.U_oc * -I, 0)
        loss = circuit.R * I**2 + charging
        drawn = next_charge_drawn - charge_drawn
        return {"R I^2": P_loss - loss, "store": P_stored - dc.P - loss, "charge": P_stored - circuit.U_oc * drawn / dt}

    @plant("der_charge_drawn", "der_T", "soc", "U", "I", "P_stored", "P_loss", "P_room_out", "P_room_in")
    def flow(self, dc: Electric, charge_drawn: Expr, T: Expr, U_min: tuple[Expr, ...]) -> Mapping[str, Any]:
        """Return the rates in continuous time, and how far the power is from its limits."""
        soc = self.soc(charge_drawn, T)
        limits, circuit = self.limits_at(soc, T, U_min), self.circuit(soc, T, dc.P)
        current = circuit.current(dc.P)
        rates = self.rates(circuit, current, T)
        return {
            "der_charge_drawn": rates["charge_drawn"],
            "der_T": rates["T"],
            "soc": soc,
            # No power lies beyond half of the open-circuit voltage; the solver may look there, but must not settle there.
            "U": ca.fmax(circuit.U_oc - circuit.R * current, 0.5 * circuit.U_oc),
            "I": current,
            "P_stored": rates["P_stored"],
            "P_loss": rates["P_loss"],
            "P_room_out": clip((soc - self.p.soc_empty) / SOC_FADE, 0, 1) * limits.P_max - dc.P,
            "P_room_in": dc.P - clip((self.p.soc_full - soc) / SOC_FADE, 0, 1) * limits.P_min,
        }
