"""What a sizing found."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeAlias

from halfshaft.cosim.gradient import value_of
from halfshaft.library.files.notebook import Grid, card
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.sizing.evaluator import Effort, Tried
from halfshaft.studies.sizing.ipopt import Solved
from halfshaft.studies.sizing.problem import Bound, Limit, Problem, Variable

if TYPE_CHECKING:
    from halfshaft.cosim.plot import Picture

Method: TypeAlias = Literal["ipopt", "evolution"]
#: Every limit holds; no vehicle within the bounds meets all; the best so far, which holds or not.
Status: TypeAlias = Literal["holds", "infeasible", "interrupted"]


@dataclass(frozen=True)
class LimitFound:
    """A limit: its values before and after [SI, or the figure's unit], and by how much the goal rises per unit that it gets tighter."""

    limit: Limit
    before: float
    after: float
    holds: bool
    price: float

    @property
    def said(self) -> str:
        """What the limit costs, in the user's units; empty where it does not bind."""
        if not self.price > 0:
            return ""
        return f"{self.price * self.limit.factor:.3g} per {self.limit.unit or 'unit'}"


@dataclass(frozen=True)
class VariableFound:
    """A variable: its values before and after [SI], the bound that it is at, and the goal's slope there per unit of the user."""

    variable: Variable
    before: float
    after: float
    at: Literal["", "lower bound", "upper bound"]
    slope: float


@dataclass(frozen=True)
class Optimum:
    """The best vehicle that was found.

    Parameters
    ----------
    problem, bound
        What was asked for, and with which parts.
    vehicle
        The vehicle, to run, save and change as any other.
    status
        ``holds``, ``infeasible`` or ``interrupted``.
    holds
        Whether every limit holds on the exact step, by the tasks themselves.
    goal, goal_before
        What was to be least, after and before.
    variables, limits
        What was found for each.
    tried
        Every vehicle that was tried as it would be built, in order.
    runs
        The runs of IPOPT, each with its iterations.
    effort
        How much was evaluated.
    sensitivities
        By how much the optimum's goal rises where another number of the vehicle is 1 % larger, sizes following.
    notes
        What a user should know.

    """

    problem: Problem
    bound: Bound = field(repr=False)
    method: Method
    vehicle: Vehicle
    status: Status
    holds: bool
    goal: float
    goal_before: float
    variables: tuple[VariableFound, ...] = field(repr=False)
    limits: tuple[LimitFound, ...] = field(repr=False)
    tried: tuple[Tried, ...] = field(repr=False)
    runs: tuple[Solved, ...] = field(repr=False)
    effort: Effort
    sensitivities: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def values(self) -> dict[str, float]:
        """The values of the variables [SI]."""
        return {v.variable.name: v.after for v in self.variables}

    @property
    def binding(self) -> dict[str, float]:
        """What each limit that binds costs: by how much the goal rises per unit of the limit, as the user has it, that it gets tighter."""
        return {f.limit.title: f.price * f.limit.factor for f in self.limits if f.price > 0}

    @cached_property
    def figures(self) -> dict[str, float | None]:
        """Goal, variables and limits by name."""
        found = {"holds": float(self.holds), "goal": self.goal, **self.values}
        return found | {f.limit.title: f.after if math.isfinite(f.after) else None for f in self.limits}

    def plot(self, path: str | Path | None = None) -> Picture:
        """Draw how it went; with a path into a PNG, SVG or PDF file."""
        from halfshaft.studies.sizing.picture import plot_optimum  # matplotlib takes a quarter of a second

        return plot_optimum(self, path=path)

    def report(self, path: str | Path) -> Path:
        """Write a page of HTML with tables and picture."""
        from halfshaft.studies.sizing.report import write_report

        return write_report(self, path)

    def variable_rows(self) -> list[tuple[str, ...]]:
        """Return name, bounds, before, after and what holds it, of each variable and of the mass, as texts."""
        rows = [
            (v.variable.name, f"{v.variable.shown(v.variable.low)} to {v.variable.shown(v.variable.high)}", v.variable.shown(v.before),
             v.variable.shown(v.after), v.at)
            for v in self.variables
        ]  # fmt: skip
        rows += [(role, f"{len(self.problem.choices[role])} parts", self.problem.vehicle.parts[role].name, name, "")
                 for role, name in self.bound.parts.items()]  # fmt: skip
        return [*rows, ("mass", "", f"{self.problem.vehicle.mass:.0f} kg", f"{self.vehicle.mass:.0f} kg", "")]

    def limit_rows(self) -> list[tuple[str, ...]]:
        """Return title, target, before, after, what it costs, and whether it holds, of each limit, as texts."""
        return [
            (f.limit.title, f.limit.wanted, f.limit.shown(f.before), f.limit.shown(f.after), f.said, "holds" if f.holds else "missed")
            for f in self.limits
        ]

    def sensitivity_rows(self) -> list[tuple[str, str, str]]:
        """Return number, its value, and what 1 % more of it does to the goal, as texts."""
        specs = {**self.vehicle.specs, **{name: rated.spec for name, rated in self.vehicle.rated.items()}}
        return [(name, specs[name].shown(value_of(self.vehicle, name)), f"{x:+.3g}") for name, x in self.sensitivities.items()]

    def goal_row(self) -> tuple[str, ...]:
        """Return the goal with its value before and after, as texts."""
        return (self.problem.minimise, self.bound.goal_unit, f"{self.goal_before:.5g}", f"{self.goal:.5g}")

    def plain(self) -> dict[str, object]:
        """Return it as plain data, for JSON."""
        return {
            "problem": self.problem.name,
            "vehicle": self.problem.vehicle.name,
            "method": self.method,
            "status": self.status,
            "holds": self.holds,
            "parts": self.bound.parts,
            "goal": {
                "expression": self.problem.minimise, "unit": self.bound.goal_unit, "before": self.goal_before, "after": self.goal,
            },
            "variables": {
                v.variable.name: {
                    "before": v.before, "after": v.after, "low": v.variable.low, "high": v.variable.high, "at": v.at, "slope": v.slope,
                }
                for v in self.variables
            },
            "mass_kg": {"before": self.problem.vehicle.mass, "after": self.vehicle.mass},
            "limits": [
                {
                    "limit": f.limit.title, "sense": f.limit.sense, "target": f.limit.target / f.limit.factor, "unit": f.limit.unit,
                    "before": f.before / f.limit.factor, "after": f.after / f.limit.factor, "holds": f.holds,
                    "price": f.price * f.limit.factor,
                }
                for f in self.limits
            ],
            "sensitivities": self.sensitivities,
            "evaluations": {"cycles": self.effort.cycles, "of_these_with_gradient": self.effort.slopes, "limits": self.effort.limits},
            "notes": self.notes,
        }  # fmt: skip

    def _repr_html_(self) -> str:
        facts = {"status": self.status, "method": self.method, "notes": "; ".join(self.notes)}
        return card(
            self.problem.name, self.problem.title, facts,
            Grid(("goal", "unit", "before", "after"), [self.goal_row()]),
            Grid(("variable", "bounds", "before", "after", ""), self.variable_rows()),
            Grid(("limit", "target", "before", "after", "costs", ""), self.limit_rows()),
            *([Grid(("number", "value", "1 % more of it"), self.sensitivity_rows())] if self.sensitivities else []),
        )  # fmt: skip
