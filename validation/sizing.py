"""Sizing by derivatives against autosize and differential evolution, and prices of limits against sizing again.

python -m halfshaft.validation.sizing            # minutes; prints the tables of the manual
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import numpy as np

from halfshaft.cosim.compiled import Array
from halfshaft.cosim.cycle import Cycle
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.autosize import Autosize
from halfshaft.studies.size import COSTS, EVALUATIONS, Price, measured_prices, resized, size
from halfshaft.studies.sizing.evaluator import Bench, Tried
from halfshaft.studies.sizing.optimum import Optimum
from halfshaft.studies.sizing.problem import Problem
from halfshaft.studies.sizing.problem_file import read_problem
from halfshaft.studies.task import Drive

CARS = ("conventional", "electric", "parallel", "series")
#: The limits of the problems as autosize has them; it has a top speed too unless told.
GOALS = Autosize(top_speed=None)


@dataclass(frozen=True)
class Case:
    """A car that was sized in three ways."""

    name: str
    autosize: Tried
    evolution: Optimum
    ipopt: Optimum

    @property
    def worse(self) -> float:
        """By how much the solver's goal is above evolution's best, relative."""
        return self.ipopt.goal / self.evolution.goal - 1

    @property
    def fewer(self) -> float:
        """By which factor it took fewer evaluations of the cycle than evolution may."""
        return EVALUATIONS / self.ipopt.effort.cycles


@cache
def sized(name: str) -> Optimum:
    """Return a car of the library as the solver has it."""
    return size(name)


@cache
def case(name: str) -> Case:
    """Return a car of the library sized in three ways."""
    problem = read_problem(name)
    found = GOALS(problem.vehicle).vehicle
    bound = problem.bound()
    # Seen from its own problem, a vehicle stands where its sizes are.
    bench = Bench(replace(bound, vehicle=found))
    return Case(name, bench.at(bench.start), size(problem, method="evolution"), sized(name))


def table(cases: list[Case]) -> str:
    """Return the comparison as Markdown."""
    rows = [
        "| car | goal | as it is | autosize | evolution, 5000 | solver | against evolution | evaluations of the cycle |",
        "|---" * 8 + "|",
    ]
    for c in cases:
        goal = f"{c.ipopt.problem.minimise} [{c.ipopt.bound.goal_unit}]"
        rows.append(
            f"| `{c.name}` | {goal} | {c.ipopt.goal_before:.4f} | {c.autosize.goal:.4f} | {c.evolution.goal:.4f} | {c.ipopt.goal:.4f} "
            f"| {100 * c.worse:+.4f} % | {c.ipopt.effort.cycles}, {c.ipopt.effort.slopes} of them with gradient |"
        )
    rows += ["", "| car | | " + " | ".join(("sizes", "limits")) + " |", "|---" * 4 + "|"]
    for c in cases:
        for way, x, values in (
            ("autosize", c.autosize.x, c.autosize.values),
            ("evolution", [v.after for v in c.evolution.variables], [f.after for f in c.evolution.limits]),
            ("solver", [v.after for v in c.ipopt.variables], [f.after for f in c.ipopt.limits]),
        ):
            sizes = ", ".join(f"{v.name} {v.shown(float(y))}" for v, y in zip(c.ipopt.bound.variables, x, strict=True))
            limits = ", ".join(limit.shown(float(y)) for limit, y in zip(c.ipopt.bound.limits, values, strict=True))
            rows.append(f"| `{c.name}` | {way} | {sizes} | {limits} |")
    return "\n".join(rows)


@cache
def prices(name: str) -> list[Price]:
    """Return what limits cost, by multiplier and as measured over 1 %."""
    return measured_prices(sized(name))


#: Where goal and limit are smooth near the optimum: vehicle, what varies, what is least, and the limit.
SMOOTH = (
    ("small-car-cvt", (("source", "25..120 kW"),), "fuel", "0-60 mph <= 12 s"),
    ("small-car-cvt", (("source", "25..120 kW"),), "fuel", "40-60 mph <= 5.5 s"),
    ("small-car-electric", (("drive", "20..150 kW"),), "energy", "grade at 55 mph >= 12 %"),
    ("small-car-electric", (("store", "15..60"), ("drive", "20..150 kW")), "energy", "0-60 mph <= 9.5 s"),
)


@cache
def smooth_price(vehicle: str, vary: tuple[tuple[str, str], ...], goal: str, limit: str) -> Price:
    """Return what the only limit of a car costs whose mass is not rounded, over 1 %."""
    tasks = {"city": Drive(Cycle.load("udds"))}
    car = unrounded(Vehicle.load(vehicle))
    found = size(Problem(vehicle=car, vary=dict(vary), minimise=goal, limits=(limit,), tasks=tasks), starts=1)
    return measured_prices(found)[0]


def unrounded(car: Vehicle) -> Vehicle:
    """Return a car whose mass is not rounded."""
    return replace(car, rules={target: rule.unrounded for target, rule in car.rules.items()})


#: In so many steps a target is moved by 1 %.
STEPS = 8


class Way(NamedTuple):
    """Goals and multipliers of the vehicles that are best while the target of a limit moves by 1 %, whole numbers as they are.

    Both over the share of the target, so that the slope of the goal is the multiplier.
    """

    title: str
    shares: Array
    goals: Array
    multipliers: Array

    @property
    def rises(self) -> Array:
        """What the goal rises by in each step."""
        return np.diff(self.goals)

    @property
    def paid(self) -> Array:
        """The integral of the multipliers over each step."""
        found: Array = np.diff(self.shares) * (self.multipliers[1:] + self.multipliers[:-1]) / 2
        return found


@cache
def ways(name: str) -> list[Way]:
    """Return the ways of the limits that bind a car of the library whose mass is not rounded: tighter and looser."""
    problem = read_problem(name)
    first, found = size(replace(problem, vehicle=unrounded(problem.vehicle))), list[Way]()
    for i, f in enumerate(first.limits):
        for side in (1, -1) if f.price > 0 else ():
            shares, on = side * 0.01 * np.arange(STEPS + 1) / STEPS, [first]
            for share in shares[1:]:
                on.append(resized(on[-1], i, f.limit.target - share * f.limit.sign * f.limit.scale, whole=True))
            goals = np.array([o.goal if o.holds else np.nan for o in on])
            multipliers = np.array([o.limits[i].price * f.limit.scale for o in on])
            found.append(Way(f"{f.limit.title}, {'tighter' if side > 0 else 'looser'}", shares, goals, multipliers))
    return found


def price_table() -> str:
    """Return the prices as Markdown."""
    head = ("car", "limit", "unit", *COSTS)
    rows = ["| " + " | ".join(head) + " |", "|---" * len(head) + "|"]
    each = [(name, sized(name).bound.goal_unit, price) for name in CARS for price in prices(name)]
    each += [(x[0], {"fuel": "L/100 km", "energy": "Wh/km"}[x[2]], smooth_price(*x)) for x in SMOOTH]
    for name, unit, price in each:
        shown = " | ".join("-" if math.isnan(x) else f"{x:.3g}" for x in price.costs)
        rows.append(f"| `{name}` | {price.title} | {unit} per {price.unit} | {shown} |")
    return "\n".join(rows)


if __name__ == "__main__":
    print(table([case(name) for name in CARS]))  # noqa: T201
    print()  # noqa: T201
    print(price_table())  # noqa: T201
