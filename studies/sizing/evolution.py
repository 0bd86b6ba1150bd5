"""Sizing without derivatives: differential evolution, all vehicles of a generation at once on the batch engine."""

from __future__ import annotations

import numpy as np
from scipy.optimize import NonlinearConstraint, differential_evolution

from halfshaft.cosim.compiled import Array
from halfshaft.studies.sizing.evaluator import Bench, Tried

#: Vehicles of a generation, for each variable, and at least.
POPULATION, LEAST = 12, 24
#: Vehicles that are tried at once.
PORTION = 12
#: An excess counts no more than this.
MOST_EXCESS = 10.0


def evolve(bench: Bench, *, evaluations: int, seed: int = 0) -> None:
    """Try vehicles until so many were evaluated; what came of it is in the record.

    A vehicle that misses a limit is worse than any that does not, and of two that miss some the one that misses them by less is better.
    """
    bench.stage = "evolution"
    n = len(bench.low)
    size = max(POPULATION * n, LEAST)
    seen: dict[bytes, Tried] = {}

    def tried(rows: Array) -> list[Tried]:
        points = [bench.scaled(row) for row in rows.T]
        new = {u.tobytes(): u for u in points if u.tobytes() not in seen}
        # In portions, so that an interrupt loses little.
        for keys in (list(new)[k : k + PORTION] for k in range(0, len(new), PORTION)):
            seen.update(zip(keys, bench.many(np.array([new[key] for key in keys])), strict=True))
        return [seen[u.tobytes()] for u in points]

    def goal(rows: Array) -> Array:
        found = np.array([t.goal for t in tried(rows.reshape(n, -1))])
        return np.where(np.isnan(found), np.inf, found)

    def excess(rows: Array) -> Array:
        found = np.array([t.excess for t in tried(rows.reshape(n, -1))]).T
        clipped: Array = np.clip(found, -1.0, MOST_EXCESS)
        return clipped

    limits = NonlinearConstraint(excess, -np.inf, 0.0) if bench.problem.limits else ()
    # A generation of the same vehicles as before takes no evaluations, so generations are counted too.
    generations = max(1, evaluations // size - 1)
    differential_evolution(
        goal, list(zip(bench.low, bench.low + bench.span, strict=True)), maxiter=generations, popsize=max(1, size // n), rng=seed,
        constraints=limits, integrality=bench.whole, vectorized=True, updating="deferred", polish=False, tol=0.0, atol=0.0, init="sobol",
        x0=bench.values(bench.rounded(bench.start)), callback=lambda *_, **__: bench.effort.cycles >= evaluations,
    )  # fmt: skip
