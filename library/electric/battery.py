"""Battery pack: open-circuit voltage behind a resistance.

For N modules in series, besides limits and thermal node of every store (`halfshaft.library.electric.store`)::

    U_oc = N u_oc(T, soc),   R = N r(T, soc) / capacity_scale                (1), r of discharging or charging by the sign of P
    d D/dt = I discharging, eta_c I charging;   soc = 1 - D / Q(T)           (2), D the charge drawn
    P_loss = R I^2 + (1 - eta_c) U_oc |I| while charging                     (3)

Left out: ageing, self-discharge, concentration (relaxation of voltage).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from halfshaft.library.base.component import State, face, plant
from halfshaft.library.base.expressions import clip, where
from halfshaft.library.base.parameters import each, plain, table
from halfshaft.library.base.ports import Electric, Expr
from halfshaft.library.base.tables import Table
from halfshaft.library.electric.store import CHARGE, TEMPERATURE, Source, Store, StoreParameters


@dataclass(frozen=True, kw_only=True)
class BatteryParameters(StoreParameters):
    """A pack of equal modules in series; tables are for one module."""

    u_oc: Table = table("V", "open-circuit voltage of a module", TEMPERATURE, CHARGE, clip=True, gt=0)
    r_discharge: Table = table("ohm", "resistance of a module while discharging", TEMPERATURE, CHARGE, clip=True, gt=0)
    r_charge: Table = table("ohm", "resistance of a module while charging", TEMPERATURE, CHARGE, clip=True, gt=0)
    Q: Table = table("C", "capacity", TEMPERATURE, clip=True, gt=0)
    eta_coulomb: Table = table("1", "share of a charging current that is stored", TEMPERATURE, clip=True, gt=0, le=1)

    def ratings(self) -> Mapping[str, float]:
        """Return the energy of the full pack [J]."""
        return {"energy": pack_energy(self)}

    @property
    def module(self) -> tuple[Any, Any]:
        """Voltage [V] and resistance [ohm] of a module that is discharged at the start temperature, at the charges of the map."""
        at = [(self.T_start, float(soc)) for soc in self.u_oc.points[1]]
        return np.array([self.u_oc(*x) for x in at]), np.array([self.r_discharge(*x) for x in at])


def pack_energy(p: BatteryParameters) -> float:
    """Return what a full pack stores at its start temperature, by its open-circuit voltage down to empty [J]."""
    Q = np.interp(p.T_start, p.Q.points[0], p.Q.values)
    return plain(p.n_modules * p.capacity_scale * Q * each(_mean_voltage, p.u_oc, p.T_start))


# A sweep asks for the same part again and again.
@lru_cache(maxsize=64)
def _mean_voltage(u_oc: Table, T_start: float) -> float:
    T, soc = u_oc.points
    points = np.union1d(soc, (0.0, 1.0))
    points = points[(points >= 0) & (points <= 1)]
    return float(np.trapezoid(np.interp(points, soc, [np.interp(T_start, T, u) for u in u_oc.values.T]), points))


@dataclass(frozen=True)
class Battery(Store):
    """Battery pack at the bus."""

    kind = "battery"
    p: BatteryParameters
    parameters = BatteryParameters
    states = (State("charge_drawn", "C", "charge drawn from the full pack", shown=True), *Store.states)
    plant_states = ((states[0], "charge_drawn"), *Store.plant_states)

    def start(self) -> Mapping[str, Any]:
        """Return the start values."""
        p = self.p
        drawn = (1 - p.soc_start) * self.capacity(p.T_start)
        return {"charge_drawn": drawn, "T": p.T_start, "soc": p.soc_start, "U_supply": p.n_modules * p.u_oc(p.T_start, p.soc_start)}

    def capacity(self, T: Expr) -> Expr:
        """Return the charge of a full pack [C]."""
        return self.p.capacity_scale * self.p.Q(T)

    def soc(self, charge_drawn: Expr, T: Expr) -> Expr:
        """Return the state of charge, equation (2); of what has been drawn, a cold pack with its smaller capacity has less left."""
        # The reciprocal is a constant of a pack whose capacity does not depend on the temperature.
        return clip(1 - charge_drawn * (1 / self.capacity(T)), 0, 1)

    def source(self, charge_drawn: Expr, T: Expr) -> Source:
        """Return equation (1)."""
        p, soc = self.p, self.soc(charge_drawn, T)
        R_out, R_in = (p.n_modules * r(T, soc) / p.capacity_scale for r in (p.r_discharge, p.r_charge))
        return Source(soc, p.n_modules * p.u_oc(T, soc), R_out, R_in)

    def rates(self, U_oc: Expr, U: Expr, I: Expr, T: Expr) -> dict[str, Expr]:  # noqa: E741
        """Return the rates of the states and the powers, equations (2) and (3)."""
        eta = where(I >= 0, 1, self.p.eta_coulomb(T))
        stored = U_oc * eta * I
        loss = stored - U * I
        return {"charge_drawn": eta * I, "T": self.warming(loss, T), "P_stored": stored, "P_loss": loss}

    @face("soc_before", "_source")
    def before(self, charge_drawn: Expr, T: Expr) -> Mapping[str, Any]:
        """Publish the state of charge at the start of the step."""
        source = self.source(charge_drawn, T)
        return {"soc_before": source.soc, "_source": source}

    @face("next_charge_drawn", "next_T", "next_soc", "P_stored", "P_loss")
    def store(self, _source: Source, U: Expr, I: Expr, charge_drawn: Expr, T: Expr, dt: Expr) -> Mapping[str, Any]:  # noqa: E741
        """Take the charge from the store."""
        rates = self.rates(_source.U_oc, U, I, T)
        next_drawn, next_T = charge_drawn + dt * rates["charge_drawn"], T + dt * rates["T"]
        return {
            "next_charge_drawn": next_drawn,
            "next_T": next_T,
            "next_soc": self.soc(next_drawn, next_T),
            "P_stored": rates["P_stored"],
            "P_loss": rates["P_loss"],
        }

    def audit(
        self, dc: Electric, charge_drawn: Expr, next_charge_drawn: Expr, T: Expr, dt: Expr, P_stored: Expr, P_loss: Expr
    ) -> Mapping[str, Any]:
        """Compare store and loss with the circuit's at the terminal power, equation (3), and with the charge that left."""
        circuit = self.source(charge_drawn, T).circuit(dc.P)
        I = circuit.current(dc.P)  # noqa: E741
        charging = where(I < 0, (1 - self.p.eta_coulomb(T)) * circuit.U_oc * -I, 0)
        loss = circuit.R * I**2 + charging
        drawn = next_charge_drawn - charge_drawn
        return {"R I^2": P_loss - loss, "store": P_stored - dc.P - loss, "charge": P_stored - circuit.U_oc * drawn / dt}

    @plant("soc", "_source")
    def charge(self, charge_drawn: Expr, T: Expr) -> Mapping[str, Any]:
        """Return the state of charge in continuous time."""
        source = self.source(charge_drawn, T)
        return {"soc": source.soc, "_source": source}

    @plant("der_charge_drawn", "der_T", "P_stored", "P_loss")
    def drain(self, _source: Source, _U: Expr, I: Expr, T: Expr) -> Mapping[str, Any]:  # noqa: E741
        """Return the rates in continuous time."""
        rates = self.rates(_source.U_oc, _U, I, T)
        powers = {name: rates[name] for name in ("P_stored", "P_loss")}
        return {"der_charge_drawn": rates["charge_drawn"], "der_T": rates["T"], **powers}
