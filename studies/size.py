"""Size: the vehicle of least fuel, energy, mass or cost that does what it must, which limits bind, and what each of them costs.

The problem is told in words (`halfshaft.studies.sizing.problem`).  With derivatives it is solved in four steps:

1. vehicles all over the bounds are looked at for the limits that drive no cycle: which are feasible, and what is not at all;
2. IPOPT solves the relaxed problem, whole numbers as any others, from the vehicle itself and from the best points of the scan;
3. on the exact step, sequential linear programs end at a vehicle as it would be built, for the whole numbers on either side of the relaxed
   ones and for neighbours as long as these are better;
4. the first-order conditions there give what each limit costs.

``evolution`` is the same without derivatives: `scipy.optimize.differential_evolution`, a generation at once on the batch engine.  Whatever
found it, the answer is run again by the tasks themselves, and said to hold or not.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, TypeAlias, get_args

import numpy as np

from halfshaft.cosim.gradient import value_of
from halfshaft.library.base.errors import InputError, number
from halfshaft.studies.sizing.evaluator import ROUNDING, Bench, Effort, Tried
from halfshaft.studies.sizing.evolution import evolve
from halfshaft.studies.sizing.ipopt import Solved
from halfshaft.studies.sizing.multipliers import Multipliers, multipliers_of
from halfshaft.studies.sizing.optimum import LimitFound, Method, Optimum, Status, VariableFound
from halfshaft.studies.sizing.problem import Bound, Problem
from halfshaft.studies.sizing.problem_file import read_problem
from halfshaft.studies.sizing.solver import minimise, starts_from_scan

Note: TypeAlias = Callable[[Solved], None]
METHODS: tuple[Method, ...] = get_args(Method)
#: Starts of IPOPT, and evaluations of differential evolution.
STARTS, EVALUATIONS = 3, 5000
MOST_STARTS, MOST_EVALUATIONS = 100, 1_000_000
#: Widest rounding of a step [1].
WIDEST = 1.0
#: A goal that falls by this share, by its slopes, within this part of the bounds is said to be no smooth optimum.
GAIN, STRAY = 5e-4, 0.01
#: A limit that costs less than this share of the goal for 1 % of its target does not bind.
NOTHING = 1e-6


def size(
    problem: Problem | str | Path,
    *,
    method: Method = "ipopt",
    starts: int = STARTS,
    evaluations: int = EVALUATIONS,
    seed: int = 0,
    widths: tuple[float, ...] = (),
    progress: Callable[[str], None] = lambda text: None,
) -> Optimum:
    """Find the vehicle with the least of what a problem names, within its limits.

    An interrupt (Ctrl-C) ends the search: the best vehicle so far is returned.

    Parameters
    ----------
    problem
        A problem, the name of one in the library, or a TOML file.
    method
        ``ipopt`` with derivatives, ``evolution`` without.
    starts
        From how many points IPOPT starts.
    evaluations
        How many vehicles differential evolution may try.
    seed
        The same one draws the same points.
    widths
        Of the smooth form of the step that IPOPT drives first, one after the other, such as 0.01 and 0.001; without them the step itself.
    progress
        Is told what is being done.

    Raises
    ------
    InputError
        If the problem or an option is not what it must be; everything that is wrong is named at once.
    KeyboardInterrupt
        If it was interrupted before any vehicle was tried.

    """
    if wrong := option_problems(method, starts, evaluations, widths):
        raise InputError("size", wrong)
    if isinstance(problem, str | Path):
        problem = read_problem(problem)
    found: list[Optimum] = []
    each = problem.combinations()
    for parts, bound in zip(each, [problem.bound(parts) for parts in each], strict=True):
        progress(", ".join([problem.name, *parts.values()]))
        if method == "evolution":
            found.append(_sized(bound, method, lambda bench, _: evolve(bench, evaluations=evaluations, seed=seed)))
        else:
            found.append(sized(bound, starts=starts, seed=seed, widths=widths))
        if found[-1].status == "interrupted":
            break
    best = min(found, key=lambda o: (not o.holds, o.goal if o.holds else o.tried[-1].worst))
    if len(found) == 1:
        return best
    others = [f"{', '.join(o.bound.parts.values())}: {f'{o.goal:.5g}' if o.holds else ' '.join((o.status, *o.notes[:1]))}" for o in found]
    total = Effort(*(sum(x) for x in zip(*((o.effort.cycles, o.effort.slopes, o.effort.limits) for o in found), strict=True)))
    status = found[-1].status if found[-1].status == "interrupted" else best.status
    return replace(best, status=status, effort=total, notes=(*best.notes, f"the goal by parts: {'; '.join(others)}"))


def option_problems(method: str, starts: int, evaluations: int, widths: tuple[float, ...]) -> list[str]:
    """Return what is wrong with options of a sizing."""
    wrong = [] if method in METHODS else [f"method = {method!r}, must be {' or '.join(METHODS)}"]
    for name, x, most in (("starts", starts, MOST_STARTS), ("evaluations", evaluations, MOST_EVALUATIONS)):
        if not (isinstance(x, int) and 1 <= x <= most):
            wrong.append(f"{name} = {x!r}, must be a whole number from 1 to {most}")
    return wrong + [f"width = {x!r}, must be > 0 and <= {WIDEST:g}" for x in widths if not 0 < number(x) <= WIDEST]


def sized(bound: Bound, *, starts: int = STARTS, seed: int = 0, widths: tuple[float, ...] = ()) -> Optimum:
    """Return the best vehicle with some parts, found by IPOPT from several starts."""
    return _sized(bound, "ipopt", lambda bench, note: minimise(bench, starts_from_scan(bench, starts=starts, seed=seed), note, widths))


def resized(optimum: Optimum, limit: int, target: float, *, whole: bool = False) -> Optimum:
    """Return the best vehicle with another target of a limit [SI, or the figure's unit], from the one that was found.

    With `whole` the whole numbers stay as they are.
    """
    bound = optimum.bound.moved(limit, target)
    if whole:
        bound = bound.held({v.variable.name: v.after for v in optimum.variables if v.variable.whole})
    values = np.array([v.after for v in optimum.variables])
    return _sized(bound, "ipopt", lambda bench, note: minimise(bench, [bench.scaled(values)], note))


#: What the columns of prices are.
COSTS = ("1 % tighter", "1 % looser", "multiplier", "where tighter", "where looser")


class Price(NamedTuple):
    """What a limit costs: by its multiplier, and by the vehicles that are best with its target a little tighter and a little looser.

    Those two have multipliers of their own: where the three differ the price changes on the way.
    """

    title: str
    unit: str
    multiplier: float
    tighter: float
    looser: float
    multiplier_tighter: float
    multiplier_looser: float

    @property
    def costs(self) -> tuple[float, ...]:
        """What it costs, by `COSTS`."""
        return self.tighter, self.looser, self.multiplier, self.multiplier_tighter, self.multiplier_looser


def measured_prices(optimum: Optimum, share: float = 0.01) -> list[Price]:
    """Return what each limit that binds costs, in the goal's unit per unit of the user, by sizing again with another target.

    A multiplier is the slope where the optimum is.  Where another limit soon binds too, or a gear changes, a change that can be seen has
    another price, and not the same in both directions: the integral of the multipliers on the way, and the jumps that no slope sees.

    Parameters
    ----------
    optimum
        What was found; its whole numbers stay.
    share
        By how much of itself the target is moved.

    """
    found = []
    for i, f in enumerate(optimum.limits):
        if f.price > 0:
            step = share * f.limit.scale
            both = [resized(optimum, i, f.limit.target + x, whole=True) for x in (-f.limit.sign * step, f.limit.sign * step)]
            if any(o.status == "interrupted" for o in both):
                break
            rises = [sign * (o.goal - optimum.goal) / step if o.holds else math.nan for o, sign in zip(both, (1, -1), strict=True)]
            there = [o.limits[i].price if o.holds else math.nan for o in both]
            found.append(Price(f.limit.title, f.limit.unit, *(f.limit.factor * x for x in (f.price, *rises, *there))))
    return found


def _sized(bound: Bound, method: Method, look: Callable[[Bench, Note], None]) -> Optimum:
    """Return the best vehicle that is found by looking."""
    bench, runs, interrupted = Bench(bound, stage="start"), list[Solved](), False
    before = bench.at_own()
    try:
        look(bench, runs.append)
    except KeyboardInterrupt:
        if not bench.tried:
            raise
        interrupted = True
    return _answer(bench, method, runs, before, interrupted=interrupted)


def _answer(bench: Bench, method: Method, runs: list[Solved], before: Tried, *, interrupted: bool) -> Optimum:
    """Return what was found, run again as it would be built."""
    bound, notes = bench.problem, list[str]()
    bench.stage = "again"
    # Lanes and single runs differ in the last digit, so the best of one may not hold in the other.
    for best in bench.ranked():
        again = bench.at(bench.scaled(best.x))
        if again.holds or not best.holds:
            break
    u = bench.scaled(again.x)
    car = bench.vehicle(u)
    status: Status = "interrupted" if interrupted else "holds" if again.holds else "infeasible"
    multipliers: Multipliers | None = None
    sensitivities: dict[str, float] = {}
    slope = np.full(len(u), np.nan)
    if again.holds and not interrupted:
        slopes = bench.slopes(u)
        slope = slopes.goal_gradient / np.where(bench.span > 0, bench.span, 1.0)
        free = (bench.span > 0) & ~bench.whole
        multipliers = multipliers_of(u, slopes, again.excess, free)
        if STRAY * multipliers.rest > GAIN * abs(again.goal):
            gain = 100 * STRAY * multipliers.rest / abs(again.goal)
            notes.append(
                f"by its slopes the goal would fall by {gain:.2g} % within 1 % of the bounds, and does not: it jumps, and prices are rough"
            )
        if others := bound.problem.sensitivities:
            by = bench.slopes_by(u, others)
            # Of the limits that bind, what a number does is paid at their price.
            each = by.goal_gradient + multipliers.limits @ np.nan_to_num(by.excess_gradient)
            sensitivities = {name: float(0.01 * value_of(car, name) * x) for name, x in zip(others, each, strict=True)}
    prices = np.zeros(len(bound.limits)) if multipliers is None else multipliers.limits
    limits = tuple(
        LimitFound(
            limit,
            float(old),
            float(new),
            bool(excess <= ROUNDING),
            float(price / limit.scale) if price > NOTHING * abs(again.goal) else 0.0,
        )
        for limit, old, new, excess, price in zip(bound.limits, before.values, again.values, again.excess, prices, strict=True)
    )
    variables = tuple(
        VariableFound(
            v, float(old), float(new), "lower bound" if new <= v.low else "upper bound" if new >= v.high else "", float(s * v.factor)
        )
        for v, old, new, s in zip(bound.variables, before.x, again.x, slope, strict=True)
    )
    if status == "infeasible":
        notes += _unmet(bench)
    if interrupted:
        notes.append("interrupted: the best so far " + ("holds" if again.holds else "does not hold"))
    if car.tags.the("vehicle mass") in car.given:
        notes.append("the mass is set, so it does not follow the sizes")
    return Optimum(
        problem=bound.problem, bound=bound, method=method,
        vehicle=replace(car, name=f"{bound.problem.name}-sized", title=f"{bound.problem.vehicle.title}, sized"),
        status=status, holds=again.holds, goal=again.goal, goal_before=before.goal, variables=variables, limits=limits,
        tried=tuple(bench.tried), runs=tuple(runs), effort=bench.effort,
        sensitivities=sensitivities, notes=tuple(notes),
    )  # fmt: skip


def _unmet(bench: Bench) -> list[str]:
    """Return which limits cannot be met: alone, or not with the others."""
    found = np.array([t.values for t in (*bench.tried, *bench.looked)]).reshape(-1, len(bench.problem.limits))
    nearest = bench.ranked()[0]
    said = []
    for i, limit in enumerate(bench.problem.limits):
        reached = found[:, i][np.isfinite(found[:, i])]
        best = limit.sign * np.min(limit.sign * reached) if len(reached) else np.nan
        if not len(reached) or limit.sign * (best - limit.target) > ROUNDING * limit.scale:
            said.append(f"{limit.title} {limit.wanted} cannot be met within the bounds: at best {limit.shown(float(best))}")
    if not said:
        missed = [f"{limit.title} {limit.wanted} ({limit.shown(float(x))})" for limit, x, e in
                  zip(bench.problem.limits, nearest.values, nearest.excess, strict=True) if e > ROUNDING]  # fmt: skip
        said.append(f"the limits cannot be met together: the nearest vehicle misses {' and '.join(missed) or 'a goal that is a number'}")
    return said
