"""Fuel cell system: fuel to electric power, without a shaft; hot.

Both forms deliver what the control commands, within what the system can:

*Net power*: everything that the system needs for itself is in its map::

    P = clip(P_command, 0, P_max),  fuel = f(P)                              (1)

*Polarisation*: n cells of area A, each with the voltage U(i) at the current density i; auxiliaries (compressor, pumps)
take their power from the stack::

    P_stack = P_command + P_aux(fuel of the previous step)                   (2)
    n A i U(i) = P_stack, solved for i within the table; fuel = n A f(i) / utilisation        (3)
    P       = n A i U(i) - P_aux(fuel)                                       (4)

so that a system whose power rises delivers a little less than commanded, and an idling one may take power from the bus.
While off a system burns and gives nothing.  Left out: warm-up, purging, the dynamics of the air supply.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import casadi as ca
import numpy as np

from halfshaft.library.base.component import Component, From, State, Variable, face, plant
from halfshaft.library.base.expressions import LIFTED, clip, lifted, where
from halfshaft.library.base.parameters import Parameters, Rated, Relation, each, param, plain, table
from halfshaft.library.base.ports import Electric, Expr, Port
from halfshaft.library.base.tables import Axis, Table

CURRENT = Axis("i", "A/m^2")


@dataclass(frozen=True, kw_only=True)
class FuelCellParameters(Parameters):
    """Fuel of a fuel cell system."""

    rho_fuel: float = param("kg/m^3", "density of the fuel", ge=0.01, le=1e4, tag="fuel density")
    H_fuel: float = param("J/kg", "lower heating value of the fuel", ge=1e5, le=1e9, tag="fuel heating value")
    mass: float = param("kg", "mass", 0.0, ge=0, le=1e5)


class Converted(NamedTuple):
    """Power that is delivered, and the fuel for it."""

    P: Expr
    fuel_flow: Expr


@dataclass(frozen=True)
class FuelCell(Component):
    """Fuel cell system on the bus; a subclass gives `P_stack` and what becomes of it."""

    family = "fuel-cell"
    p: FuelCellParameters
    dc = Port(Electric, "wheel", tags={"P": "generated"})
    states: ClassVar[tuple[State, ...]] = (State("fuel_used", "kg", "fuel used", shown=True, tag="fuel mass"),)
    variables: ClassVar[tuple[Variable, ...]] = (
        Variable("P_stack", "W", "power asked of the stack"),
        Variable("fuel_flow", "kg/s", "fuel flow"),
        Variable("P_fuel", "W", "power in the fuel", "fuel"),
        Variable("P_loss", "W", "power lost", "loss"),
    )
    plant_states = ((states[0], "fuel_used"),)
    reads = (From("control", P_converter="W", converter_on="1"),)

    @property
    def P_largest(self) -> Expr:
        """Largest power that it delivers [W]."""
        raise NotImplementedError

    def convert(self, P_stack: Expr) -> Converted:
        """Return what a running system delivers and burns."""
        raise NotImplementedError

    def burning(self, P_stack: Expr, on: Expr) -> tuple[Electric, dict[str, Expr]]:
        """Return the power delivered, and the variables."""
        running = self.convert(P_stack)
        P, flow = where(on, running.P, 0), where(on, running.fuel_flow, 0)
        P_fuel = flow * self.p.H_fuel
        return Electric(P), {"fuel_flow": flow, "P_fuel": P_fuel, "P_loss": P_fuel - P}

    @face("dc", "fuel_flow", "P_fuel", "P_loss", "next_fuel_used")
    def available(self, P_stack: Expr, converter_on: Expr, fuel_used: Expr, dt: Expr) -> Mapping[str, Any]:
        """Return the power that the system delivers and the fuel that it burns."""
        dc, found = self.burning(P_stack, converter_on)
        return {"dc": dc, **found, "next_fuel_used": fuel_used + dt * found["fuel_flow"]}

    @plant("dc", "fuel_flow", "P_fuel", "P_loss", "der_fuel_used")
    def flow(self, P_stack: Expr, converter_on: Expr) -> Mapping[str, Any]:
        """Return the same in continuous time; what the stack is asked for is held between samples."""
        dc, found = self.burning(P_stack, converter_on)
        return {"dc": dc, **found, "der_fuel_used": found["fuel_flow"]}


@dataclass(frozen=True, kw_only=True)
class NetPowerParameters(FuelCellParameters):
    """Map and scales of a fuel cell system."""

    fuel: Table = table("kg/s", "fuel flow", Axis("P", "W"), clip=True, ge=0)
    P_scale: float = param("1", "factor on all powers", 1.0, ge=0.01, le=100, tag="source size")
    efficiency_scale: float = param("1", "factor on the efficiency", 1.0, ge=0.01, le=100)

    rated: ClassVar[tuple[Rated, ...]] = (
        Rated("P_max", "W", "largest net power", "P_scale", lambda p: p.P_scale * p.fuel.inside(0)[1]),
        Rated("e_max", "1", "best efficiency", "efficiency_scale", lambda p: best_efficiency(p)),
    )
    relations = (Relation(lambda p: lifted(p.efficiency_scale, p.fuel, lambda P, fuel: [(P, fuel)], p.H_fuel), LIFTED),)

    @property
    def weight(self) -> float:
        """Mass of the system [kg]."""
        return self.mass * self.P_scale

    @property
    def P_own(self) -> float:
        """Largest net power [W]."""
        return self.P_scale * self.fuel.inside(0)[1]


def best_efficiency(p: NetPowerParameters) -> float:
    """Return the best efficiency of the map."""
    return plain(p.efficiency_scale * each(_best, p.fuel, p.H_fuel))


def _best(fuel: Table, H_fuel: float) -> float:
    P, P_fuel = fuel.points[0], H_fuel * fuel.values
    return float(np.max(np.divide(P, P_fuel, out=np.zeros_like(P), where=P_fuel > 0)))


@dataclass(frozen=True)
class NetPowerFuelCell(FuelCell):
    """Fuel cell system by its net power, equation (1)."""

    kind = "fuel-cell"
    p: NetPowerParameters
    parameters = NetPowerParameters

    @property
    def P_largest(self) -> Expr:
        """Largest power of the map [W]."""
        return self.p.P_scale * self.p.fuel.inside(0)[1]

    def convert(self, P_stack: Expr) -> Converted:
        """Return the power, and the fuel of the map."""
        p = self.p
        return Converted(P_stack, p.P_scale / p.efficiency_scale * p.fuel(P_stack / p.P_scale))

    @face("P_stack")
    def ask(self, P_converter: Expr, converter_on: Expr) -> Mapping[str, Any]:
        """Cut the command to what the system can deliver."""
        return {"P_stack": where(converter_on, clip(P_converter, 0, self.P_largest), 0)}

    def audit(
        self, dc: Electric, converter_on: Expr, P_fuel: Expr, P_loss: Expr, fuel_used: Expr, next_fuel_used: Expr, dt: Expr
    ) -> Mapping[str, Any]:
        """Compare the fuel with the map at the power delivered."""
        fuel = where(converter_on, self.p.H_fuel * self.convert(dc.P).fuel_flow, 0)
        burnt = self.p.H_fuel * (next_fuel_used - fuel_used) / dt
        return {"fuel map": P_fuel - fuel, "fuel burnt": P_fuel - burnt, "loss": P_loss - fuel + dc.P}


def _falls(p: Any) -> bool:
    """Return whether the power of a cell falls somewhere over its current, so that a power has two currents."""
    return len(p.U_cell.points) == 1 and bool(np.any(np.diff(p.U_cell.points[0] * p.U_cell.values) <= 0))


def _creates(p: Any) -> Any:
    """Return whether a cell gives more power than its fuel has."""
    if len(p.U_cell.points) != 1 or len(p.fuel.points) != 1:
        return False
    # At the points of both.
    i = np.union1d(p.U_cell.points[0], p.fuel.points[0])
    U, fuel = (np.interp(i, t.points[0], t.values) for t in (p.U_cell, p.fuel))
    least = float(np.min(fuel[i > 0] / (U * i)[i > 0], initial=np.inf))
    return p.H_fuel * least < p.utilisation


@dataclass(frozen=True, kw_only=True)
class PolarisationParameters(FuelCellParameters):
    """Cells and auxiliaries of a fuel cell system."""

    U_cell: Table = table("V", "voltage of a cell", CURRENT, clip=True, gt=0)
    fuel: Table = table("kg/(s.m^2)", "fuel that reacts in a cell, by its area", CURRENT, clip=True, ge=0)
    P_aux: Table = table("W", "power of compressor and pumps", Axis("fuel", "kg/s"), clip=True, ge=0)
    n_cells: float = param("1", "number of cells in all", ge=1, le=1e6, tag="source size")
    A_cell: float = param("m^2", "area of a cell", ge=1e-6, le=100)
    utilisation: float = param("1", "share of the fuel that reacts", 1.0, ge=0.01, le=1)

    @property
    def P_own(self) -> float:
        """Net power at the end of the polarisation curve [W]."""
        i = self.U_cell.inside(0)[1]
        area = self.n_cells * self.A_cell
        return float(area * i * self.U_cell(i) - self.P_aux(area / self.utilisation * self.fuel(i)))

    relations = (
        Relation(_falls, "U_cell falls so fast that the power of a cell falls with it; end the table at the largest power"),
        Relation(_creates, "a cell gives more power than its fuel has at H_fuel = {H_fuel:g} J/kg"),
    )


@dataclass(frozen=True)
class PolarisationFuelCell(FuelCell):
    """Fuel cell system by the polarisation curve of its cells, equations (2) to (4)."""

    kind = "fuel-cell-polarisation"
    p: PolarisationParameters
    parameters = PolarisationParameters
    states = (*FuelCell.states, State("flow_before", "kg/s", "fuel flow of the previous step"))
    variables = (*FuelCell.variables, Variable("i_cell", "A/m^2", "current density"))

    def gross(self, i: Expr) -> Expr:
        """Return the stack's power at a current density [W]."""
        return self.p.n_cells * self.p.A_cell * i * self.p.U_cell(i)

    def fuel_flow(self, i: Expr) -> Expr:
        """Return the fuel flow at a current density [kg/s]."""
        return self.p.n_cells * self.p.A_cell / self.p.utilisation * self.p.fuel(i)

    @property
    def P_largest(self) -> Expr:
        """Net power at the end of the polarisation curve [W]."""
        i = self.p.U_cell.inside(0)[1]
        return self.gross(i) - self.p.P_aux(self.fuel_flow(i))

    def current_density(self, P_stack: Expr) -> Expr:
        """Return the current density that gives a power, between the points of the curve on a line over the power [A/m^2]."""
        i = self.p.U_cell.points[0]
        power = i * self.p.U_cell.values
        P = clip(P_stack / (self.p.n_cells * self.p.A_cell), float(power[0]), float(power[-1]))
        slopes = np.diff(i) / np.diff(power)
        found: Expr = float(i[0])
        for start, bend in zip(power, np.diff(slopes, prepend=0.0), strict=False):
            found = found + float(bend) * ca.fmax(P - float(start), 0)
        return found

    def convert(self, P_stack: Expr) -> Converted:
        """Return net power and fuel, equations (3) and (4)."""
        i = self.current_density(P_stack)
        flow = self.fuel_flow(i)
        return Converted(self.gross(i) - self.p.P_aux(flow), flow)

    @face("P_stack", "i_cell")
    def ask(self, P_converter: Expr, converter_on: Expr, flow_before: Expr) -> Mapping[str, Any]:
        """Add what the auxiliaries took in the previous step to the command, equation (2)."""
        P = where(converter_on, P_converter + where(flow_before > 0, self.p.P_aux(flow_before), 0), 0)
        return {"P_stack": P, "i_cell": where(converter_on, self.current_density(P), 0)}

    @face("next_flow_before")
    def remember(self, fuel_flow: Expr) -> Mapping[str, Any]:
        """Keep the fuel flow for the next step."""
        return {"next_flow_before": fuel_flow}

    def audit(
        self, dc: Electric, converter_on: Expr, i_cell: Expr, P_fuel: Expr, P_loss: Expr, fuel_used: Expr, next_fuel_used: Expr, dt: Expr
    ) -> Mapping[str, Any]:
        """Compare power and fuel with those of the cells at their current density."""
        flow = where(converter_on, self.fuel_flow(i_cell), 0)
        P = where(converter_on, self.gross(i_cell) - self.p.P_aux(flow), 0)
        burnt = self.p.H_fuel * (next_fuel_used - fuel_used) / dt
        return {
            "power": dc.P - P,
            "fuel": P_fuel - self.p.H_fuel * flow,
            "fuel burnt": P_fuel - burnt,
            "loss": P_loss - self.p.H_fuel * flow + P,
        }
