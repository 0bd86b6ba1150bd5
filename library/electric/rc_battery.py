"""Battery pack with relaxation: a large and a small capacitor behind resistances.

Per module, with the share i = I / capacity_scale of the pack's current, the bulk capacitor C_b behind R_e, the surface
capacitor C_c behind R_c, and R_t at the terminals::

    i_b = (v_b - v_c + R_c i) / (R_e + R_c),   i_c = i - i_b                 (1)
    C_b dv_b/dt = -i_b,   C_c dv_c/dt = -i_c                                 (2)
    u   = (R_c v_b + R_e v_c) / (R_e + R_c) - (R_t + R_c R_e / (R_e + R_c)) i        (3)
    soc = (20 s(v_b) + s(v_c)) / 21,   s the inverse of u_oc(T, soc)         (4)
    P_loss = R_t i^2 + R_e i_b^2 + R_c i_c^2                                 (5)

(3) is a voltage source behind a resistance, so that limits and thermal node are those of every store
(`halfshaft.library.electric.store`).  What the capacitors lose of their energy in a step is not quite the work at the voltages
of its start; the difference is discretisation.  Unlike the original, (4) is that of the same step, and no voltage is allowed
below half of the source's.  Left out: a coulombic efficiency, ageing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from halfshaft.library.base.component import State, Variable, face, plant
from halfshaft.library.base.expressions import clip
from halfshaft.library.base.parameters import Relation, each, plain, table
from halfshaft.library.base.ports import Electric, Expr
from halfshaft.library.base.tables import Table
from halfshaft.library.electric.store import CHARGE, TEMPERATURE, Source, Store, StoreParameters

#: Weight of the bulk capacitor in the state of charge, over that of the surface capacitor.
BULK = 20


@dataclass(frozen=True, kw_only=True)
class RCBatteryParameters(StoreParameters):
    """A pack of equal modules in series; tables are for one module."""

    u_oc: Table = table("V", "open-circuit voltage of a module", TEMPERATURE, CHARGE, clip=True, gt=0)
    C_bulk: Table = table("F", "bulk capacitance", TEMPERATURE, clip=True, gt=0)
    C_surface: Table = table("F", "surface capacitance", TEMPERATURE, clip=True, gt=0)
    r_bulk: Table = table("ohm", "resistance behind the bulk capacitor (R_e)", TEMPERATURE, CHARGE, clip=True, gt=0)
    r_surface: Table = table("ohm", "resistance behind the surface capacitor (R_c)", TEMPERATURE, CHARGE, clip=True, gt=0)
    r_terminal: Table = table("ohm", "resistance at the terminals (R_t)", TEMPERATURE, CHARGE, clip=True, gt=0)

    relations = (
        *StoreParameters.relations,
        Relation(
            lambda p: len(p.u_oc.points) == 2 and bool(np.any(np.diff(p.u_oc.values, axis=1) <= 0)),
            "u_oc must rise with the state of charge, at each temperature",
        ),
    )

    def ratings(self) -> Mapping[str, float]:
        """Return the energy of the full pack, down to empty, at its start temperature [J]."""
        empty, full = (each(self.u_oc, self.T_start, soc) for soc in (0.0, 1.0))
        C = each(self.C_bulk, self.T_start) + each(self.C_surface, self.T_start)
        return {"energy": plain(self.n_modules * self.capacity_scale * C * (full**2 - empty**2) / 2)}

    @property
    def module(self) -> tuple[Any, Any]:
        """Voltage [V] and resistance [ohm] of a module at rest at the start temperature, at the charges of the map."""
        at = [(self.T_start, float(soc)) for soc in self.u_oc.points[1]]
        u, r_e, r_c, r_t = (np.array([f(*x) for x in at]) for f in (self.u_oc, self.r_bulk, self.r_surface, self.r_terminal))
        return u, r_t + r_c * r_e / (r_e + r_c)


class Flows(NamedTuple):
    """Currents of the capacitors and loss of a module, as if its capacity were not scaled."""

    i_b: Expr
    i_c: Expr
    loss: Expr


@dataclass(frozen=True)
class RCBattery(Store):
    """Battery pack at the bus, its modules as two capacitors."""

    kind = "battery-rc"
    p: RCBatteryParameters
    parameters = RCBatteryParameters
    states = (
        State("v_bulk", "V", "voltage of a module's bulk capacitor", shown=True),
        State("v_surface", "V", "voltage of a module's surface capacitor", shown=True),
        *Store.states,
    )
    variables = (
        *Store.variables,
        Variable("P_discretisation", "W", "energy that left the capacitors less the work at the voltages before", "discretisation"),
    )
    plant_states = ((states[0], "v_bulk"), (states[1], "v_surface"), *Store.plant_states)

    def start(self) -> Mapping[str, Any]:
        """Return the start values: at rest."""
        p = self.p
        v = p.u_oc(p.T_start, p.soc_start)
        return {"v_bulk": v, "v_surface": v, "T": p.T_start, "soc": p.soc_start, "U_supply": p.n_modules * v}

    def charge_at(self, v: Expr, knots: list[Expr]) -> Expr:
        """Return the state of charge at an open-circuit voltage, given the voltages at the table's points."""
        soc = self.p.u_oc.points[1]
        found: Expr = float(soc[0])
        for step, low, high in zip(np.diff(soc), knots, knots[1:], strict=False):
            found = found + float(step) * clip((v - low) / (high - low), 0, 1)
        return found

    def source(self, v_bulk: Expr, v_surface: Expr, T: Expr) -> Source:
        """Return equations (3) and (4)."""
        p = self.p
        knots = [p.u_oc(T, float(x)) for x in p.u_oc.points[1]]
        soc = (BULK * self.charge_at(v_bulk, knots) + self.charge_at(v_surface, knots)) / (BULK + 1)
        R_e, R_c = p.r_bulk(T, soc), p.r_surface(T, soc)
        E = (R_c * v_bulk + R_e * v_surface) / (R_e + R_c)
        R = p.n_modules * (p.r_terminal(T, soc) + R_c * R_e / (R_e + R_c)) / p.capacity_scale
        return Source(soc, p.n_modules * E, R, R)

    def flows(self, soc: Expr, I: Expr, v_bulk: Expr, v_surface: Expr, T: Expr) -> Flows:  # noqa: E741
        """Return equations (1) and (5)."""
        p, i = self.p, I / self.p.capacity_scale
        R_e, R_c = p.r_bulk(T, soc), p.r_surface(T, soc)
        i_b = (v_bulk - v_surface + R_c * i) / (R_e + R_c)
        return Flows(i_b, i - i_b, p.r_terminal(T, soc) * i**2 + R_e * i_b**2 + R_c * (i - i_b) ** 2)

    @face("soc_before", "_source")
    def before(self, v_bulk: Expr, v_surface: Expr, T: Expr) -> Mapping[str, Any]:
        """Publish the state of charge at the start of the step."""
        source = self.source(v_bulk, v_surface, T)
        return {"soc_before": source.soc, "_source": source}

    @face("next_v_bulk", "next_v_surface", "next_T", "next_soc", "P_stored", "P_loss", "P_discretisation")
    def store(
        self, _source: Source, U: Expr, I: Expr, v_bulk: Expr, v_surface: Expr, T: Expr, dt: Expr  # noqa: E741
    ) -> Mapping[str, Any]:  # fmt: skip
        """Take the charge from the capacitors, equation (2)."""
        p = self.p
        flows = self.flows(_source.soc, I, v_bulk, v_surface, T)
        C_b, C_c, size = p.C_bulk(T), p.C_surface(T), p.n_modules * p.capacity_scale
        next_bulk, next_surface = v_bulk - dt * flows.i_b / C_b, v_surface - dt * flows.i_c / C_c
        loss = size * flows.loss
        next_T = T + dt * self.warming(loss, T)
        stored = size * (C_b * (v_bulk**2 - next_bulk**2) + C_c * (v_surface**2 - next_surface**2)) / (2 * dt)
        return {
            "next_v_bulk": next_bulk,
            "next_v_surface": next_surface,
            "next_T": next_T,
            "next_soc": self.source(next_bulk, next_surface, next_T).soc,
            "P_stored": stored,
            "P_loss": loss,
            "P_discretisation": stored - U * I - loss,
        }

    def audit(
        self, dc: Electric, v_bulk: Expr, next_v_bulk: Expr, v_surface: Expr, next_v_surface: Expr, T: Expr, dt: Expr,
        P_stored: Expr, P_loss: Expr, P_discretisation: Expr,
    ) -> Mapping[str, Any]:  # fmt: skip
        """Compare the powers with the charges that left the capacitors, and with the resistances at the terminal power."""
        p, source = self.p, self.source(v_bulk, v_surface, T)
        size = p.n_modules * p.capacity_scale
        i_b, i_c = p.C_bulk(T) * (v_bulk - next_v_bulk) / dt, p.C_surface(T) * (v_surface - next_v_surface) / dt
        loss = size * self.flows(source.soc, source.circuit(dc.P).current(dc.P), v_bulk, v_surface, T).loss
        return {
            "resistances": P_loss - loss,
            "charge": size * (v_bulk * i_b + v_surface * i_c) - dc.P - loss,
            "store": P_stored - P_discretisation - dc.P - loss,
        }

    @plant("soc", "_source")
    def charge(self, v_bulk: Expr, v_surface: Expr, T: Expr) -> Mapping[str, Any]:
        """Return the state of charge in continuous time."""
        source = self.source(v_bulk, v_surface, T)
        return {"soc": source.soc, "_source": source}

    @plant("der_v_bulk", "der_v_surface", "der_T", "P_stored", "P_loss")
    def drain(self, _source: Source, I: Expr, v_bulk: Expr, v_surface: Expr, T: Expr) -> Mapping[str, Any]:  # noqa: E741
        """Return the rates in continuous time."""
        p = self.p
        flows, size = self.flows(_source.soc, I, v_bulk, v_surface, T), p.n_modules * p.capacity_scale
        return {
            "der_v_bulk": -flows.i_b / p.C_bulk(T),
            "der_v_surface": -flows.i_c / p.C_surface(T),
            "der_T": self.warming(size * flows.loss, T),
            "P_stored": size * (v_bulk * flows.i_b + v_surface * flows.i_c),
            "P_loss": size * flows.loss,
        }
