"""Sizing with derivatives: a scan of the limits, IPOPT from several starts, and the search on the exact step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from halfshaft.cosim.compiled import Array
from halfshaft.studies.sizing.evaluator import ROUNDING, Bench, Tried, smooth
from halfshaft.studies.sizing.ipopt import Solved, solve
from halfshaft.studies.sizing.local import descend, search

#: Vehicles of a scan for each variable; it drives no cycle.
SCAN = 16
#: Iterations of IPOPT from each start, and evaluations of the cycle.
ITERATIONS, CYCLES = 40, 60
#: Ends of two starts that are nearer than this to each other are one [of the bounds].
APART = 0.03
#: Ends that are worse than the best by more than this are not searched on the exact step.
WORSE = 0.01
#: An excess that IPOPT leaves and the search on the exact step can mend.
MENDED = 0.05


@dataclass(frozen=True)
class Scan:
    """Vehicles all over the bounds, on a smooth base, with the excess of each limit; the vehicle itself is the first."""

    points: Array
    excess: Array

    @property
    def violation(self) -> Array:
        """The sum of what each misses, each limit by 10 at most."""
        return np.sum(np.clip(self.excess, 0.0, 10.0), axis=1)


def scan(bench: Bench, seed: int) -> Scan:
    """Look at vehicles all over the bounds for the limits that drive no cycle."""
    n = len(bench.low)
    drawn = qmc.Sobol(n, rng=np.random.default_rng(seed)).random(2 ** int(np.ceil(np.log2(SCAN * n))))
    corners = np.array([np.zeros(n), np.ones(n)])
    points = np.vstack([bench.start, corners, drawn])
    found = bench.many(points, goal=False, base=smooth(bench.vehicle(bench.start)))
    return Scan(points, np.array([t.excess for t in found]).reshape(len(points), -1))


def starts_of(bench: Bench, found: Scan, n: int) -> list[Array]:
    """Return where to start: from the vehicle itself if its limits are known there, and from points as good and as far apart as can be."""
    violation = found.violation
    # What was never reached tells IPOPT nothing.
    known = np.isfinite(np.where(np.isneginf(found.excess), 0.0, found.excess)).all(axis=1)
    usable = np.flatnonzero(known)
    if not len(usable):
        return [found.points[int(np.argmin(violation))]]
    first = int(usable[np.argmin(violation[usable])])
    chosen = [0 if known[0] and violation[0] <= max(0.3, violation[first]) else first]
    slopes = bench.slopes(found.points[chosen[0]])
    guess = (found.points - found.points[chosen[0]]) @ np.nan_to_num(slopes.goal_gradient) / (abs(slopes.goal) or 1.0)
    rank = np.where(known, 10 * violation + guess, np.inf)
    while len(chosen) < min(n, len(usable)):
        gap = np.min([np.linalg.norm(found.points - found.points[i], axis=1) for i in chosen], axis=0)
        # A start is the better the further it is from the others.
        chosen.append(int(np.argmin(np.where(gap > APART, rank - 0.5 * gap, np.inf))))
    return [found.points[i] for i in dict.fromkeys(chosen)]


def least_violation(bench: Bench, found: Scan) -> Tried:
    """Return the vehicle that comes nearest to all limits."""
    u = bench.rounded(found.points[int(np.argmin(found.violation))])
    return descend(bench, bench.at(u))


def starts_from_scan(bench: Bench, *, starts: int, seed: int) -> list[Array]:
    """Return where to start; nowhere if no vehicle within the bounds meets the limits."""
    bench.stage = "scan"
    looked = scan(bench, seed)
    if (looked.violation <= ROUNDING).any():
        return starts_of(bench, looked, starts)
    bench.stage = "limits"
    nearest = least_violation(bench, looked)
    return [bench.scaled(nearest.x)] if nearest.worst <= ROUNDING else []


def minimise(bench: Bench, points: list[Array], note: Callable[[Solved], None]) -> None:
    """Try vehicles until the best is found; what came of it is in the record of the bench, and each run of IPOPT is noted."""
    ends: list[Solved] = []
    for point in points:
        bench.stage = "ipopt"
        solved = solve(bench, point, iterations=ITERATIONS, cycles=CYCLES)
        note(solved)
        ends.append(solved)
        # Where it ended, as it would be built: an interrupt finds something.
        bench.at(bench.rounded(solved.u))
    good = [s for s in ends if s.worst < MENDED and np.isfinite(s.goal)] or ends
    least = min((s.goal for s in good), default=0.0)
    done: list[Array] = []
    for solved in sorted(good, key=lambda s: s.goal):
        if solved.goal > least + WORSE * abs(least) or any(np.linalg.norm(solved.u - u) < APART for u in done):
            continue
        bench.stage = "exact"
        search(bench, solved.u)
        done.append(solved.u)
