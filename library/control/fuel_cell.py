"""Control of a fuel cell hybrid: the power follower, whose source is on the bus itself.

When the fuel cell runs and with what power is the power follower's part (`halfshaft.library.control.power_follower`); the
supply of the bus needs no more than the bus asks for, and the operating point is a power.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from halfshaft.library.base.component import From, Variable, face
from halfshaft.library.base.expressions import where
from halfshaft.library.base.ports import Expr
from halfshaft.library.control.power_follower import Demand, PowerFollower, PowerFollowerParameters, Supply
from halfshaft.library.electric.fuel_cell import FuelCell


@dataclass(frozen=True, kw_only=True)
class FuelCellControlParameters(PowerFollowerParameters):
    """Power follower for a fuel cell."""


@dataclass(frozen=True)
class FuelCellControl(PowerFollower):
    """Decides when the fuel cell runs, and at what power."""

    kind = "fuel-cell-control"
    p: FuelCellControlParameters
    parameters = FuelCellControlParameters
    variables = (
        Variable("converter_on", "1", "whether the fuel cell runs", signal=True, kind="flag"),
        Variable("P_converter", "W", "commanded power of the fuel cell", signal=True),
        Variable("P_converter_request", "W", "power that demand and charging ask for"),
    )
    reads = (*PowerFollower.reads, From("fuel_cell", FuelCell))

    @face("_supply")
    def supply(self, P_bus: Expr, fuel_cell: FuelCell) -> Mapping[str, Any]:
        """Return the power that supplies the bus."""
        P = fuel_cell.P_largest
        return {"_supply": Supply(ca.fmax(P_bus, 0), self.p.P_min_share * P, self.p.P_max_share * P, P)}

    @face("converter_on", "P_converter", "P_converter_request")
    def operating_point(self, _demand: Demand, _P: Expr, _on: Expr) -> Mapping[str, Any]:
        """Return the command."""
        return {"converter_on": _on, "P_converter": where(_on, _P, 0), "P_converter_request": _demand.P}
