"""Evaluates the vehicles of a problem, counts what that takes, and keeps all that was tried.

Points are scaled: 0 and 1 are the bounds of each variable.  A limit is told by its *excess*, how far its value is on the wrong side of the
target, over the target; at most 0 where it holds.  What was never reached has an infinite one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from halfshaft.cosim.compiled import Array
from halfshaft.library.base.errors import HalfshaftError, InputError
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.probes import Probe, probe_of
from halfshaft.studies.sizing.problem import OWN, Bound, Ref, Term

Mask: TypeAlias = npt.NDArray[np.bool_]
#: A limit holds up to rounding.
ROUNDING = 1e-9


class Tried(NamedTuple):
    """A vehicle that was tried: by what, its values [SI], its goal, the values of its limits, and their excesses."""

    stage: str
    x: Array
    goal: float
    values: Array
    excess: Array

    @property
    def worst(self) -> float:
        """The largest excess; 0 where all limits hold."""
        return float(max(np.max(self.excess, initial=0.0), 0.0))

    @property
    def holds(self) -> bool:
        """Whether all limits hold and the goal is known."""
        return self.worst <= ROUNDING and bool(np.isfinite(self.goal))


class Slopes(NamedTuple):
    """A goal and the excesses of the limits, with their gradients over the scaled variables."""

    goal: float
    excess: Array
    goal_gradient: Array
    excess_gradient: Array


@dataclass
class Effort:
    """What was evaluated: vehicles over their cycles, gradients of these, and vehicles for their limits alone."""

    cycles: int = 0
    slopes: int = 0
    limits: int = 0


@dataclass
class Bench:
    """Tries vehicles.

    Parameters
    ----------
    problem
        What is asked of them.
    stage
        What is under way, for the record.
    tried
        All vehicles as they would be built, in order.
    looked
        Those that drove no cycle, or were not as they would be built.
    smoothed
        How tasks are asked for slopes of a smooth form.

    """

    problem: Bound
    stage: str = ""
    tried: list[Tried] = field(default_factory=list)
    looked: list[Tried] = field(default_factory=list)
    effort: Effort = field(default_factory=Effort)
    smoothed: dict[str, Probe] = field(default_factory=dict)

    @cached_property
    def low(self) -> Array:
        """The lower bounds [SI]."""
        return np.array([v.low for v in self.problem.variables])

    @cached_property
    def span(self) -> Array:
        """What is between the bounds [SI]."""
        return np.array([v.high - v.low for v in self.problem.variables])

    @cached_property
    def whole(self) -> Mask:
        """Which variables are whole numbers."""
        return np.array([v.whole for v in self.problem.variables], dtype=bool)

    @cached_property
    def probes(self) -> dict[str, Probe]:
        """How each task is asked."""
        return {OWN: probe_of(None)} | {key: probe_of(task) for key, task in self.problem.tasks.items()}

    @cached_property
    def own(self) -> Array:
        """The values of the vehicle itself [SI]."""
        firsts = (next(iter(v.shares.items())) for v in self.problem.variables)
        return np.array([self.problem.vehicle.values[name] / share for name, share in firsts])

    @property
    def start(self) -> Array:
        """Where the vehicle itself is, or the nearest point between the bounds."""
        return self.scaled(self.own)

    def scaled(self, x: Array) -> Array:
        """Return a point of values, within the bounds."""
        with np.errstate(all="ignore"):
            u = np.where(self.span > 0, (x - self.low) / self.span, 0.0)
        return np.clip(u, 0.0, 1.0)

    def values(self, u: Array) -> Array:
        """Return the values of a point [SI]; a row each for many points."""
        return self.low + np.asarray(u) * self.span

    def rounded(self, u: Array) -> Array:
        """Return the nearest point whose whole numbers are whole."""
        x = self.values(u)
        return self.scaled(np.where(self.whole, np.round(x), x))

    def numbers(self, u: Array, *, exact: bool) -> dict[str, float]:
        """Return the vehicle's numbers at a point."""
        rows = zip(self.problem.variables, self.values(u), strict=True)
        return {name: y for v, x in rows for name, y in v.values(float(x), exact=exact).items()}

    @cached_property
    def base(self) -> Vehicle:
        """The vehicle on which goal and limits are smooth in sizes: its mass is not rounded, and maps that a rule makes stay."""
        return self.vehicle(self.start).displaced({})

    def rebase(self, u: Array) -> None:
        """Let the maps of the smooth base be those of a point."""
        self.base = self.vehicle(u).displaced({})

    def smooth(self, u: Array, width: float) -> None:
        """Let slopes be those of the smooth form of the step of a width, its decisions those at a point; of none, of the step itself."""
        car = self.base.with_values(self.numbers(u, exact=False))
        self.smoothed = {key: probe.rounded(car, width) for key, probe in self.probes.items()} if width else {}

    def vehicle(self, u: Array) -> Vehicle:
        """Return the vehicle at a point as it would be built."""
        return self.problem.vehicle.with_values(self.numbers(u, exact=True))

    def at(self, u: Array, *, goal: bool = True) -> Tried:
        """Try a vehicle as it would be built, by the tasks themselves; without its goal, only what drives no cycle."""
        figures: dict[str, Mapping[str, float]] = {}
        with suppress(HalfshaftError):
            car = self.vehicle(u)
            figures = {key: self.probes[key].at(car) for key in self._wanted(goal=goal)}
        return self._noted(u, figures, goal=goal)

    def at_own(self) -> Tried:
        """Try the vehicle itself; outside of the bounds it is none that could be chosen."""
        inside = self.own.clip(self.low, self.low + self.span)
        tried = self.at((self.own - self.low) / np.where(self.span > 0, self.span, 1.0)) if (self.span > 0).all() else self.at(self.start)
        if not np.array_equal(inside, self.own):
            self.looked.append(self.tried.pop())
        return tried

    def _noted(self, u: Array, figures: Mapping[str, Mapping[str, float]], *, goal: bool, exact: bool = True) -> Tried:
        def value(term: Term) -> float:
            if not all(ref.figure in figures.get(ref.task, ()) for ref in term.refs):
                return np.nan
            return float(term.expression(np.array([figures[ref.task][ref.figure] for ref in term.refs]))[0][0])

        reached = np.array([value(limit.term) for limit in self.problem.limits])
        known = np.array([goal or not self._drives(limit.term) for limit in self.problem.limits], dtype=bool)
        excess = np.where(known, self.excess(reached), -np.inf)
        tried = Tried(self.stage, self.values(u), value(self.problem.goal) if goal else np.nan, reached, excess)
        if goal:
            self.effort.cycles += 1
        else:
            self.effort.limits += 1
        (self.tried if goal and exact else self.looked).append(tried)
        return tried

    def many(self, points: Array, *, goal: bool = True, exact: bool = True) -> list[Tried]:
        """Try many vehicles at once, as they would be built or on the smooth base."""
        rows = [self.numbers(u, exact=exact) for u in points]
        columns = {name: np.array([row[name] for row in rows]) for name in self.problem.names}
        base = self.problem.vehicle if exact else self.base
        found = {key: self.probes[key].many(base, columns, wanted) for key, wanted in self._wanted(goal=goal).items()}
        each = [{key: {name: float(x[i]) for name, x in of.items()} for key, of in found.items()} for i in range(len(points))]
        return [self._noted(u, figures, goal=goal, exact=exact) for u, figures in zip(points, each, strict=True)]

    def slopes(self, u: Array) -> Slopes:
        """Return goal and excesses on the smooth base, with their gradients over the scaled variables; NaN where nothing can be built."""
        names = self.problem.names
        # What a scaled variable does to each number.
        chain = np.array([[v.shares.get(name, 0.0) for v in self.problem.variables] for name in names]) * self.span
        found = self.slopes_by(u, names)
        return found._replace(goal_gradient=found.goal_gradient @ chain, excess_gradient=found.excess_gradient @ chain)

    def slopes_by(self, u: Array, names: Sequence[str]) -> Slopes:
        """Return the same with gradients over numbers of the vehicle."""
        limits, terms = self.problem.limits, [self.problem.goal, *(x.term for x in self.problem.limits)]
        try:
            car = self.base.with_values(self.numbers(u, exact=False))
        except InputError:
            n, m = len(names), len(limits)
            return Slopes(np.nan, np.full(m, np.inf), np.full(n, np.nan), np.full((m, n), np.nan))
        found: dict[Ref, tuple[float, Array]] = {}
        cost = 0
        for key, wanted in self._wanted(goal=True).items():
            sloped = (self.smoothed or self.probes)[key].slopes(car, names, wanted)
            found |= {Ref(key, figure): (sloped.values[figure], sloped.gradients[figure]) for figure in wanted}
            cost = max(cost, sloped.cost * self.probes[key].drives)
        self.effort.slopes += 1
        self.effort.cycles += cost
        values, rows = [], []
        for term in terms:
            value, own = term.expression(np.array([found[ref][0] for ref in term.refs]))
            values.append(value[0])
            rows.append(own[0] @ np.array([found[ref][1] for ref in term.refs]))
        scales = np.array([limit.sign / limit.scale for limit in limits])
        gradients = np.array(rows[1:]).reshape(len(limits), len(names)) * scales[:, None]
        return Slopes(values[0], self.excess(np.array(values[1:])), rows[0], gradients)

    def excess(self, values: Array) -> Array:
        """Return how far values of the limits are on the wrong side, over the targets."""
        limits = self.problem.limits
        sign, target, scale = (np.array([getattr(limit, of) for limit in limits]) for of in ("sign", "target", "scale"))
        found = sign * (values - target) / scale if limits else np.zeros(0)
        return np.where(np.isnan(found), np.inf, found)

    def ranked(self) -> list[Tried]:
        """Return the record, the best vehicle first: of those that hold by their goal, then by how much they miss."""

        def missed(t: Tried) -> float:
            return float(np.sum(np.clip(t.excess, 0.0, 10.0))) + 10.0 * (not np.isfinite(t.goal))

        return sorted(self.tried, key=lambda t: (0.0, t.goal) if t.holds else (1.0 + missed(t), 0.0))

    def _drives(self, term: Term) -> bool:
        return any(self.probes[ref.task].drives for ref in term.refs)

    def _wanted(self, *, goal: bool) -> dict[str, list[str]]:
        """Return the figures that are needed by task; without the goal only of tasks that drive no cycle."""
        wanted: dict[str, list[str]] = {}
        terms = [self.problem.goal] * goal + [limit.term for limit in self.problem.limits]
        for ref in dict.fromkeys(ref for term in terms for ref in term.refs):
            if goal or not self.probes[ref.task].drives:
                wanted.setdefault(ref.task, []).append(ref.figure)
        return wanted
