"""The continuous problem by IPOPT through CasADi: whole numbers relaxed, the mass not rounded, gradients of whole runs."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from halfshaft.cosim.compiled import Array
from halfshaft.cosim.forward import Interrupts
from halfshaft.studies.sizing.evaluator import Bench, Slopes

#: Accuracy of the scaled conditions of an optimum, and with how much IPOPT is content after three such iterations.
TOLERANCE, ACCEPTABLE = 1e-5, 3e-4
#: So many iterations that gain less than this, relative, end it; a vehicle counts that misses no limit by more.
PATIENCE, GAIN, MET = 4, 1e-4, 1e-3
#: How a run ended that was interrupted.
INTERRUPTED = "interrupted"


@dataclass(frozen=True)
class Iterate:
    """One iteration: number, goal, largest excess, and the infeasibility of the dual as IPOPT tells it."""

    number: int
    goal: float
    worst: float
    u: Array = field(repr=False)


@dataclass(frozen=True)
class Solved:
    """Where IPOPT ended: the scaled point, its goal and largest excess, how it ended, and its iterations."""

    u: Array
    goal: float
    worst: float
    status: str
    iterates: tuple[Iterate, ...]


class _Model(ca.Callback):
    """Goal and excesses as a CasADi function whose Jacobian comes with the values."""

    def __init__(self, n: int, m: int, at: Callable[[Array], Slopes]) -> None:
        ca.Callback.__init__(self)
        self.n, self.m, self.at = n, m, at
        self._kept: list[Any] = []
        self.construct("sizing", {})

    def get_n_in(self) -> int:
        return 1

    def get_n_out(self) -> int:
        return 2

    def get_sparsity_in(self, _: int) -> Any:
        return ca.Sparsity.dense(self.n, 1)

    def get_sparsity_out(self, i: int) -> Any:
        return ca.Sparsity.dense((1, self.m)[i], 1)

    def eval(self, given: Any) -> Any:
        found = self.at(np.array(given[0]).ravel())
        return [found.goal, found.excess]

    def has_jacobian(self) -> bool:
        return True

    def get_jacobian(self, name: str, inames: Any, onames: Any, options: Any) -> Any:
        jacobian = _Jacobian(self, name, options)
        self._kept.append(jacobian)
        return jacobian


class _Jacobian(ca.Callback):
    """The Jacobian of the model; its inputs are those of the model and its outputs."""

    def __init__(self, model: _Model, name: str, options: Any) -> None:
        ca.Callback.__init__(self)
        self.model = model
        self.construct(name, options)

    def get_n_in(self) -> int:
        return 3

    def get_n_out(self) -> int:
        return 2

    def get_sparsity_in(self, i: int) -> Any:
        return ca.Sparsity.dense((self.model.n, 1, self.model.m)[i], 1)

    def get_sparsity_out(self, i: int) -> Any:
        return ca.Sparsity.dense((1, self.model.m)[i], self.model.n)

    def eval(self, given: Any) -> Any:
        found = self.model.at(np.array(given[0]).ravel())
        return [ca.DM(found.goal_gradient).T, ca.DM(found.excess_gradient)]


class Watch(ca.Callback):
    """Notes each iteration, and ends the solver when it is told to."""

    def __init__(self, n: int, m: int, note: Callable[[Array, float, Array], bool]) -> None:
        ca.Callback.__init__(self)
        self.n, self.m, self.note = n, m, note
        self.construct("watch", {})

    def get_n_in(self) -> int:
        """Return how many inputs there are."""
        return ca.nlpsol_n_out()

    def get_n_out(self) -> int:
        """Return how many outputs there are."""
        return 1

    def get_sparsity_in(self, i: int) -> Any:
        """Return the shape of an input."""
        rows = {"x": self.n, "lam_x": self.n, "f": 1, "g": self.m, "lam_g": self.m}.get(ca.nlpsol_out(i), 0)
        return ca.Sparsity.dense(rows, 1 if rows else 0)

    def eval(self, given: Any) -> Any:
        """Note an iteration, and return whether to end."""
        places = {ca.nlpsol_out(i): np.array(x).ravel() for i, x in enumerate(given)}
        return [int(self.note(places["x"], float(places["f"][0]), places["g"]))]


def _settled(iterates: list[Iterate]) -> bool:
    """Return whether the last iterations gained nothing that counts: at kinks IPOPT goes on for ever, and the exact step comes next."""
    good = [i.goal for i in iterates if i.worst < MET]
    if len(good) <= PATIENCE or len(iterates) <= 2 * PATIENCE:
        return False
    before = min(i.goal for i in iterates[:-PATIENCE] if i.worst < MET) if any(i.worst < MET for i in iterates[:-PATIENCE]) else np.inf
    return before - min(good) < GAIN * abs(before)


def solve(bench: Bench, start: Array, *, iterations: int, cycles: int) -> Solved:
    """Minimise from a start until IPOPT is content, it is interrupted, or so many iterations or evaluations of the cycle are done."""
    free = np.flatnonzero(bench.span > 0)
    n, m, most = len(free), len(bench.problem.limits), bench.effort.cycles + cycles
    known: dict[bytes, Slopes] = {}
    iterates: list[Iterate] = []
    failed: list[Exception] = []
    listening = Interrupts()
    ends: list[str] = []

    def whole(x: Array) -> Array:
        u = start.copy()
        u[free] = np.clip(x, 0.0, 1.0)
        return u

    def at(x: Array) -> Slopes:
        key = x.tobytes()
        if key not in known:
            if listening.came or failed or bench.effort.cycles >= most:
                return Slopes(np.nan, np.full(m, np.nan), np.full(n, np.nan), np.full((m, n), np.nan))
            try:
                s = bench.slopes(whole(x))
            # CasADi cannot be told of an error, and would go on.
            except Exception as error:
                failed.append(error)
                return at(x)
            known[key] = Slopes(
                s.goal, np.where(np.isfinite(s.excess), s.excess, np.nan), s.goal_gradient[free], s.excess_gradient[:, free]
            )
        return known[key]

    def note(x: Array, goal: float, excess: Array) -> bool:
        iterates.append(Iterate(len(iterates), goal * scale, _worst(excess), whole(x)))
        stopped = INTERRUPTED if listening.came else "evaluations used up" if bench.effort.cycles >= most else ""
        ends.append(stopped or ("settled" if _settled(iterates) else ""))
        return bool(ends[-1])

    first = at(start[free])
    if failed:
        raise failed[0]
    scale = abs(first.goal) if np.isfinite(first.goal) and first.goal else 1.0
    model, watch, x = _Model(n, m, at), Watch(n, m, note), ca.MX.sym("x", n)
    f, g = model(x)
    f = f / scale
    problem: Any = {"x": x, "f": f, "g": g}
    options: Any = {
        "ipopt": {
            "hessian_approximation": "limited-memory", "tol": TOLERANCE, "acceptable_tol": ACCEPTABLE, "acceptable_iter": 3,
            "max_iter": iterations, "print_level": 0, "sb": "yes", "mu_init": 1e-3, "bound_relax_factor": 0.0,
            "honor_original_bounds": "yes", "bound_push": 1e-3, "bound_frac": 1e-3,
        },
        "print_time": False, "iteration_callback": watch, "error_on_fail": False, "show_eval_warnings": False,
    }  # fmt: skip
    solver = ca.nlpsol("solver", "ipopt", problem, options)
    with suppress(KeyboardInterrupt), listening.listened_to():
        solver(x0=start[free], lbx=0.0, ubx=1.0, lbg=-np.inf, ubg=0.0)
    if failed:
        raise failed[0]
    said = str(solver.stats()["return_status"]).replace("_", " ").lower()
    status = INTERRUPTED if listening.came else (ends[-1] if ends else "") or said
    # Where it did not end by itself, its best iterate is worth more than its last.
    best = min(iterates or [Iterate(0, first.goal, _worst(first.excess), start)], key=lambda i: (max(i.worst, MET), i.goal))
    return Solved(best.u, best.goal, best.worst, status, tuple(iterates))


def _worst(excess: Array) -> float:
    return float(max(np.max(np.where(np.isnan(excess), np.inf, excess), initial=0.0), 0.0))
