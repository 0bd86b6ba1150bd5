"""Ultracapacitor pack: a capacitor behind a resistance.

For N modules in series, besides limits and thermal node of every store (`halfshaft.library.electric.store`)::

    U_oc = N v,   R = N r(T) / capacity_scale,   soc = v / u_max             (1), r of discharging or charging by the sign of P
    C(T) capacity_scale dv/dt = -I discharging, -eta_c I charging            (2)
    P_loss = R I^2 + (1 - eta_c) U_oc |I| while charging                     (3)

What the capacitor loses of its energy in a step is not quite the work at the voltage of its start; the difference is
discretisation.  Left out: dependence on the current, self-discharge.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from halfshaft.library.base.component import State, Variable, face, plant
from halfshaft.library.base.expressions import where
from halfshaft.library.base.parameters import each, plain, table
from halfshaft.library.base.ports import Electric, Expr
from halfshaft.library.base.tables import Table
from halfshaft.library.electric.store import SOC_EMPTY, TEMPERATURE, Source, Store, StoreParameters


@dataclass(frozen=True, kw_only=True)
class UltracapacitorParameters(StoreParameters):
    """A pack of equal modules in series; tables are for one module, which is full at `u_max`."""

    C: Table = table("F", "capacitance of a module", TEMPERATURE, clip=True, gt=0)
    r_discharge: Table = table("ohm", "resistance of a module while discharging", TEMPERATURE, clip=True, gt=0)
    r_charge: Table = table("ohm", "resistance of a module while charging", TEMPERATURE, clip=True, gt=0)
    eta_coulomb: Table = table("1", "share of a charging current that is stored", TEMPERATURE, clip=True, gt=0, le=1)

    def ratings(self) -> Mapping[str, float]:
        """Return the energy of the full pack at its start temperature [J]."""
        return {"energy": plain(self.n_modules * self.capacity_scale * each(self.C, self.T_start) * self.u_max**2 / 2)}

    @property
    def module(self) -> tuple[Any, Any]:
        """Voltage [V] and resistance [ohm] of a full module at the start temperature."""
        return self.u_max, self.r_discharge(self.T_start)


@dataclass(frozen=True)
class Ultracapacitor(Store):
    """Ultracapacitors at the bus."""

    kind = "ultracapacitor"
    p: UltracapacitorParameters
    parameters = UltracapacitorParameters
    states = (State("v", "V", "voltage of a module's capacitor", shown=True), *Store.states)
    variables = (
        *Store.variables,
        Variable("P_discretisation", "W", "energy that left the capacitor less the work at the voltage before", "discretisation"),
    )
    plant_states = ((states[0], "v"), *Store.plant_states)

    def start(self) -> Mapping[str, Any]:
        """Return the start values; a capacitor without any voltage could take no power."""
        p = self.p
        v = ca.fmax(p.soc_start, SOC_EMPTY) * p.u_max
        return {"v": v, "T": p.T_start, "soc": v / p.u_max, "U_supply": p.n_modules * v}

    def source(self, v: Expr, T: Expr) -> Source:
        """Return equation (1)."""
        p = self.p
        R_out, R_in = (p.n_modules * r(T) / p.capacity_scale for r in (p.r_discharge, p.r_charge))
        return Source(v / p.u_max, p.n_modules * v, R_out, R_in)

    def rates(self, v: Expr, U: Expr, I: Expr, T: Expr) -> dict[str, Expr]:  # noqa: E741
        """Return the rates of the states and the powers, equations (2) and (3)."""
        p = self.p
        i = where(I >= 0, 1, p.eta_coulomb(T)) * I
        stored = p.n_modules * v * i
        loss = stored - U * I
        return {"v": -i / (p.capacity_scale * p.C(T)), "T": self.warming(loss, T), "P_stored": stored, "P_loss": loss}

    @face("soc_before", "_source")
    def before(self, v: Expr, T: Expr) -> Mapping[str, Any]:
        """Publish the state of charge at the start of the step."""
        source = self.source(v, T)
        return {"soc_before": source.soc, "_source": source}

    @face("next_v", "next_T", "next_soc", "P_stored", "P_loss", "P_discretisation")
    def store(self, U: Expr, I: Expr, v: Expr, T: Expr, dt: Expr) -> Mapping[str, Any]:  # noqa: E741
        """Take the charge from the capacitor."""
        p, rates = self.p, self.rates(v, U, I, T)
        # In a step of many seconds more could be taken than there is.
        next_v = ca.fmax(v + dt * rates["v"], SOC_EMPTY * p.u_max / 2)
        stored = p.n_modules * p.capacity_scale * p.C(T) * (v**2 - next_v**2) / (2 * dt)
        return {
            "next_v": next_v,
            "next_T": T + dt * rates["T"],
            "next_soc": next_v / p.u_max,
            "P_stored": stored,
            "P_loss": rates["P_loss"],
            "P_discretisation": stored - rates["P_stored"],
        }

    def audit(
        self, dc: Electric, v: Expr, next_v: Expr, T: Expr, dt: Expr, P_stored: Expr, P_loss: Expr, P_discretisation: Expr
    ) -> Mapping[str, Any]:
        """Compare the powers with the charge that left, and with the circuit's at the terminal power, equation (3)."""
        p, circuit = self.p, self.source(v, T).circuit(dc.P)
        I = circuit.current(dc.P)  # noqa: E741
        loss = circuit.R * I**2 + where(I < 0, (1 - p.eta_coulomb(T)) * circuit.U_oc * -I, 0)
        left = p.n_modules * v * p.capacity_scale * p.C(T) * (v - next_v) / dt
        return {"R I^2": P_loss - loss, "charge": left - dc.P - loss, "store": P_stored - P_discretisation - dc.P - loss}

    @plant("soc", "_source")
    def charge(self, v: Expr, T: Expr) -> Mapping[str, Any]:
        """Return the state of charge in continuous time."""
        source = self.source(v, T)
        return {"soc": source.soc, "_source": source}

    @plant("der_v", "der_T", "P_stored", "P_loss")
    def drain(self, _U: Expr, I: Expr, v: Expr, T: Expr) -> Mapping[str, Any]:  # noqa: E741
        """Return the rates in continuous time."""
        rates = self.rates(v, _U, I, T)
        return {"der_v": rates["v"], "der_T": rates["T"], "P_stored": rates["P_stored"], "P_loss": rates["P_loss"]}
