"""Sizing with derivatives: a scan of the limits, IPOPT from several starts, and the search on the exact step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from halfshaft.cosim.compiled import Array
from halfshaft.studies.sizing.evaluator import ROUNDING, Bench, Mask
from halfshaft.studies.sizing.ipopt import INTERRUPTED, Solved, solve
from halfshaft.studies.sizing.local import around, descend, mend, search

#: Vehicles of a scan for each variable; it drives no cycle.
SCAN = 16
#: So many of them are led toward the limits where none meets all.
NEAREST = 3
#: Vehicles of it whose goal is looked at too, for each variable and at most.
GOALS, MOST_GOALS = 8, 20
#: Widths of the further scans [of the bounds], from how many points each goes on, and to how many from each.
WIDTHS, PARENTS, CHILDREN = (0.15, 0.08, 0.04), 8, 6
#: What the worth of a start loses with its violation, and gains with its distance from others.
VIOLATED, FAR = 2.0, 0.1
#: Iterations of IPOPT from each start, and evaluations of the cycle.
ITERATIONS, CYCLES = 30, 40
#: Ends of two starts that are nearer than this to each other are one [of the bounds].
APART = 0.03
#: Ends that are worse than the best by more than this are not searched on the exact step.
WORSE = 0.01
#: An excess that IPOPT leaves and the search on the exact step can mend.
MENDED = 0.05


@dataclass(frozen=True)
class Scan:
    """Vehicles all over the bounds, on the smooth base, with the excess of each limit."""

    points: Array
    excess: Array

    @property
    def violation(self) -> Array:
        """The sum of what each misses, each limit by 10 at most."""
        found: Array = np.sum(np.clip(self.excess, 0.0, 10.0), axis=1)
        return found

    @property
    def known(self) -> Mask:
        """Whether all its limits are numbers: what was never reached tells IPOPT nothing."""
        found: Mask = np.all(self.excess < np.inf, axis=1)
        return found

    def and_(self, other: Scan) -> Scan:
        """Return both."""
        return Scan(np.vstack([self.points, other.points]), np.vstack([self.excess, other.excess]))


def looked_at(bench: Bench, points: Array) -> Scan:
    """Look at vehicles for the limits that drive no cycle."""
    found = bench.many(points, goal=False, exact=False)
    return Scan(points, np.array([t.excess for t in found]).reshape(len(points), -1))


def scan(bench: Bench, seed: int) -> Scan:
    """Look at the vehicle itself and at others all over the bounds."""
    n = len(bench.low)
    drawn = qmc.Sobol(n, rng=np.random.default_rng(seed)).random(2 ** int(np.ceil(np.log2(SCAN * n))))
    return looked_at(bench, np.vstack([bench.start, np.zeros(n), np.ones(n), drawn]))


def starts_of(bench: Bench, found: Scan, n: int, seed: int) -> list[Array]:
    """Return where to start: the points that promise most, apart from each other.

    The goal is looked at where limits are missed least, and a parabola is put through it.  With that in place of the goal, and the limits
    themselves, which cost no cycle, the scan goes on around its best points.
    """
    near = np.argsort(np.where(found.known, found.violation, np.inf), kind="stable")[: min(GOALS * len(bench.low), MOST_GOALS)]
    points = found.points[near]
    goals = np.array([t.goal for t in bench.many(points, exact=False)])
    sound = np.isfinite(goals)
    if not sound.any():
        return [points[0]]
    guess = _parabola(points[sound], goals[sound])
    draw = np.random.default_rng(seed)
    for width in WIDTHS:
        best = found.points[np.argsort(_worth(found, guess))[:PARENTS]]
        children = np.clip(
            np.repeat(best, CHILDREN, axis=0) + width * draw.standard_normal((len(best) * CHILDREN, len(bench.low))), 0.0, 1.0
        )
        found = found.and_(looked_at(bench, children))
    worth, chosen = _worth(found, guess), list[int]()
    while len(chosen) < n:
        gap = np.min([np.linalg.norm(found.points - found.points[i], axis=1) for i in chosen], axis=0, initial=np.inf)
        # A start is the better the further it is from the others.
        rank = np.where(gap > APART, worth - FAR * np.minimum(gap, 1.0), np.inf)
        if not np.isfinite(rank).any():
            break
        chosen.append(int(np.argmin(rank)))
    return [found.points[i] for i in chosen] or [points[0]]


def _parabola(points: Array, goals: Array) -> Callable[[Array], Array]:
    """Return the goal over the variables by least squares: a parabola in each, or a plane where there are few points."""

    def terms(u: Array) -> Array:
        one = np.ones((len(u), 1))
        return np.hstack([one, u, u * u]) if len(points) > 2 * points.shape[1] + 1 else np.hstack([one, u])

    weights = np.linalg.lstsq(terms(points), goals, rcond=None)[0]
    scale = np.median(np.abs(goals)) or 1.0
    return lambda u: terms(u) @ weights / scale


def _worth(found: Scan, guess: Callable[[Array], Array]) -> Array:
    return np.where(found.known, guess(found.points) + VIOLATED * found.violation, np.inf)


def starts_from_scan(bench: Bench, *, starts: int, seed: int) -> list[Array]:
    """Return where to start; nowhere if no vehicle within the bounds meets the limits."""
    bench.stage = "scan"
    looked = scan(bench, seed)
    if (looked.violation <= ROUNDING).any():
        return starts_of(bench, looked, starts, seed)
    bench.stage = "limits"
    for i in np.argsort(looked.violation, kind="stable")[:NEAREST]:
        nearest = descend(bench, bench.at(bench.rounded(looked.points[i])))
        if nearest.holds:
            return [bench.scaled(nearest.x)]
    return []


def minimise(bench: Bench, points: list[Array], note: Callable[[Solved], None], widths: tuple[float, ...] = ()) -> None:
    """Try vehicles until the best is found; what came of it is in the record of the bench, and each run of IPOPT is noted.

    With widths the cycle is first that of the smooth step with these, one after the other, its decisions those where each begins.

    Raises
    ------
    KeyboardInterrupt
        If it was interrupted; the record has then what holds near to where IPOPT came.

    """
    if not (bench.span > 0).any():
        for point in points:
            bench.at(point)
        return
    ends: list[Solved] = []
    try:
        for point in points:
            bench.stage = "ipopt"
            for width in (*widths, 0.0):
                bench.smooth(point, width)
                solved = solve(bench, point, iterations=ITERATIONS, cycles=CYCLES // (len(widths) + 1))
                note(solved)
                point = solved.u
                if not width or solved.status == INTERRUPTED:
                    ends.append(solved)
                if solved.status == INTERRUPTED:
                    raise KeyboardInterrupt
        done: list[Array] = []
        for solved in _promising(ends):
            if all(np.linalg.norm(solved.u - u) >= APART for u in done):
                bench.stage = "exact"
                bench.rebase(bench.rounded(solved.u))
                search(bench, solved.u)
                done.append(solved.u)
    except KeyboardInterrupt:
        bench.smoothed = {}
        if bench.stage == "ipopt":
            for solved in _promising(ends)[:1]:
                bench.stage = "exact"
                for built in around(bench, solved.u):
                    mend(bench, built)
        raise


def _promising(ends: list[Solved]) -> list[Solved]:
    """Return the ends that the exact step can perhaps mend and that are hardly worse than the best, the best first."""
    good = [s for s in ends if s.worst < MENDED and np.isfinite(s.goal)] or ends
    least = min((s.goal for s in good), default=0.0)
    return sorted((s for s in good if not s.goal > least + WORSE * abs(least)), key=lambda s: s.goal)
