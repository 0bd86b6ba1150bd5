"""The end of a sizing on the exact step: sequential linear programs, and for whole numbers a search among neighbours.

Each linear program takes goal and limits as they run at the best vehicle so far, within a box around it.  What it proposes is tried as it
would be built, rounded mass and all; a limit that it then misses is corrected by what it misses it by, which takes no cycle.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np
from scipy.optimize import linprog

from halfshaft.cosim.compiled import Array
from halfshaft.studies.sizing.evaluator import ROUNDING, Bench, Mask, Slopes, Tried

#: Half the first box and the smallest, in parts of the bounds; its growth and its shrinking.
FIRST, LAST, GROWTH, SHRINKING = 0.04, 2e-4, 2.0, 0.35
#: A gain that is not worth a cycle, and how far a limit is kept from its target, relative.
GAIN, INSIDE = 2e-5, 1e-7
#: Corrections of a proposal.
CORRECTIONS = 6
#: What an excess costs, in goals, where a program cannot do without.
ELASTIC = 100.0
#: A neighbour that a program takes for worse by so much is not tried.
HOPELESS = 5e-3


def program(slopes: Slopes, excess: Array, box: tuple[Array, Array], free: Mask) -> Array:
    """Return the step, within the box, that is best by linear goal and limits; if none meets all limits, the one that misses them least."""
    n, m = int(free.sum()), len(excess)
    scale = abs(slopes.goal) if slopes.goal and np.isfinite(slopes.goal) else 1.0
    rows = np.nan_to_num(slopes.excess_gradient[:, free])
    cost = np.append(np.nan_to_num(slopes.goal_gradient[free]) / scale, np.full(m, ELASTIC))
    bounds = [*zip(box[0][free], box[1][free], strict=True), *[(0.0, None)] * m]
    found = linprog(cost, A_ub=np.hstack([rows, -np.eye(m)]) if m else None, b_ub=-excess - INSIDE if m else None, bounds=bounds)
    step = np.zeros(len(free))
    step[free] = found.x[:n] if found.x is not None else 0.0
    return step


def descend(bench: Bench, start: Tried, slopes: Slopes | None = None, *, first: float = FIRST, last: float = LAST) -> Tried:
    """Return the best vehicle near a start, its whole numbers as they are."""
    best, half = start, first
    free = (bench.span > 0) & ~bench.whole
    if not free.any():
        return best
    while half >= last:
        u = bench.scaled(best.x)
        slopes = slopes or bench.slopes(u)
        excess = np.where(np.isfinite(best.excess), best.excess, 1.0)
        box = (np.maximum(-half, -u), np.minimum(half, 1 - u))
        step = program(slopes, excess, box, free)
        gain = -float(np.nan_to_num(slopes.goal_gradient) @ step) / (abs(best.goal) or 1.0)
        if best.holds and gain < GAIN:
            break
        proposal = _corrected(bench, u, step, slopes, box, free)
        tried = bench.at(proposal) if proposal is not None else None
        if tried is not None and _better(tried, best):
            best, slopes, half = tried, None, min(GROWTH * half, 0.25)
        else:
            half *= SHRINKING
    return best


def mend(bench: Bench, u: Array) -> Tried:
    """Return a vehicle near a point that meets the limits that drive no cycle, if one step of a program leads there."""
    slopes, free = bench.slopes(u), (bench.span > 0) & ~bench.whole
    box = (np.maximum(-FIRST, -u), np.minimum(FIRST, 1 - u))
    proposal = _corrected(bench, u, program(slopes, bench.at(u, goal=False).excess, box, free), slopes, box, free) if free.any() else u
    return bench.at(u if proposal is None else proposal)


def _better(a: Tried, b: Tried) -> bool:
    if a.holds and b.holds:
        return a.goal < b.goal
    return a.holds if a.holds != b.holds else a.worst < b.worst


def _corrected(bench: Bench, u: Array, step: Array, slopes: Slopes, box: tuple[Array, Array], free: Mask) -> Array | None:
    """Return a proposal that meets the limits that drive no cycle, or comes nearest to it; None where it cannot be built."""
    best: tuple[float, Array] | None = None
    for _ in range(CORRECTIONS):
        found = bench.at(np.clip(u + step, 0.0, 1.0), goal=False)
        if not np.all(np.isfinite(found.values) | np.isneginf(found.excess)):
            step = 0.5 * step
            continue
        if best is None or found.worst < best[0]:
            best = found.worst, np.clip(u + step, 0.0, 1.0)
        if found.worst <= ROUNDING:
            break
        # What the limits would be at the start, were they linear with these slopes.
        linear = np.nan_to_num(slopes.excess_gradient) @ step
        excess = np.where(np.isneginf(found.excess), slopes.excess, found.excess - linear)
        step = program(slopes, excess, box, free)
    return None if best is None else best[1]


def neighbours(bench: Bench, best: Tried) -> Iterator[Array]:
    """Yield the points whose whole numbers are one off, one at a time."""
    places = np.flatnonzero(bench.whole & (bench.span > 0))
    for i, off in product(places, (-1.0, 1.0)):
        x = best.x.copy()
        x[i] += off
        if bench.low[i] <= x[i] <= bench.low[i] + bench.span[i]:
            yield bench.scaled(x)


def around(bench: Bench, u: Array) -> Iterator[Array]:
    """Yield the points with whole numbers on either side of a relaxed one, the nearest first."""
    x = bench.values(u)
    near, far = np.round(x), np.where(np.round(x) > x, np.floor(x), np.ceil(x))
    ends = [dict.fromkeys((a, b)) if w else [y] for a, b, y, w in zip(near, far, x, bench.whole, strict=True)]
    yield from (bench.scaled(np.array(row)) for row in product(*ends))


def search(bench: Bench, u: Array) -> Tried:
    """Return the best vehicle near a relaxed point, and near neighbours by whole numbers as long as these are better."""
    best: Tried | None = None
    seen: set[bytes] = set()

    def take(points: Iterator[Array], slopes: Slopes | None) -> bool:
        nonlocal best
        found = False
        for point in points:
            x = bench.values(point)
            key = x[bench.whole].tobytes()
            if key in seen:
                continue
            seen.add(key)
            if best is not None and slopes is not None and best.holds and _hopeless(bench, best, slopes, point):
                continue
            tried = descend(bench, bench.at(point))
            if best is None or _better(tried, best):
                best, found = tried, True
        return found

    take(around(bench, u), bench.slopes(u))
    assert best is not None
    while bench.whole.any() and take(neighbours(bench, best), bench.slopes(bench.scaled(best.x))):
        pass
    return best


def _hopeless(bench: Bench, best: Tried, slopes: Slopes, point: Array) -> bool:
    """Return whether other whole numbers look worse than the best vehicle, all else put right by a linear program."""
    u = bench.scaled(best.x)
    off = point - u
    moved = slopes.excess + np.nan_to_num(slopes.excess_gradient) @ np.where(bench.whole, off, 0.0)
    free = (bench.span > 0) & ~bench.whole
    step = program(slopes, moved, (-u, 1 - u), free) + np.where(bench.whole, off, 0.0)
    return float(slopes.goal_gradient @ step) > HOPELESS * abs(best.goal)
