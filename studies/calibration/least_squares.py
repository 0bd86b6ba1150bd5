"""Nonlinear least squares with exact derivatives, and what the data say of its answer.

Of predictions ``f(x)`` of what was measured, ``y``, with standard uncertainties ``sigma``, the fit makes least::

    1/2 sum rho(r^2),    r = (f(x) - y) / sigma,    low <= x <= high                           (1)

where ``rho`` grows more slowly than its argument if outliers are to count less (`LOSSES`; each is set so that with normal noise
it is 95 % as efficient as plain squares).  With the Jacobian ``J`` of ``r`` the covariance is, for plain squares::

    (J^T J)^-1                                                                                  (2)

and for a robust loss that of Huber, with ``psi = r rho'(r^2)`` and ``K = 1 + (p / n) var(psi') / mean(psi')^2``::

    K^2 sum(psi^2) / (n - p) / mean(psi')^2 (J^T J)^-1                                          (3)

A group of measurements whose uncertainty is not stated gets that of its own residuals: fit and estimate are repeated until they
agree, and each group's degrees of freedom are its rows less its share of the parameters, the trace of its part of the hat
matrix.  Intervals are those of Student's distribution with these degrees of freedom, or of the normal one if all is stated.

What the data cannot tell is looked for in the singular values of ``J``, its columns scaled to the same length: a
direction in which a parameter may move through all of its range before the data object.  A QR decomposition with pivots says it as
sentences of few parameters: one that moves, and what makes up for it.

References
----------
P. J. Huber, *Robust Statistics*, Wiley, 1981, chapter 7.  D. A. Belsley, E. Kuh, R. E. Welsch, *Regression Diagnostics*,
Wiley, 1980, chapter 3.

"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, Literal, NamedTuple, TypeAlias, get_args

import numpy as np
import numpy.typing as npt
from scipy.linalg import qr
from scipy.optimize import least_squares
from scipy.special import chdtrc, ndtri, stdtrit

from halfshaft.library.base.errors import InputError

Array: TypeAlias = npt.NDArray[np.float64]
#: Returns what is predicted of each measurement, and its derivatives, shapes ``(n,)`` and ``(n, p)``.
Model: TypeAlias = Callable[[Array], tuple[Array, Array]]
Loss: TypeAlias = Literal["linear", "soft_l1", "huber", "cauchy"]
#: Residuals of so many standard uncertainties begin to count less; then the loss is 95 % as efficient as squares under normal noise.
LOSSES: dict[Loss, float] = {"linear": 1.0, "soft_l1": 1.287, "huber": 1.345, "cauchy": 2.385}
#: Share of the truth that an interval is to contain.
CONFIDENCE = 0.95
#: Fit and estimated uncertainties agree when these change by less than this share; most rounds of both.
SETTLED, ROUNDS = 1e-3, 30
#: Fewer rows than these do not tell their own uncertainty.
FEWEST = 3
#: Most evaluations of the model in one round.
MOST = 200
#: A median deviation of normal noise is its standard deviation over this.
NORMAL = 1.4826
#: Singular values below this share of the largest are rounding.
ROUNDING = 1e-7
#: A parameter is hardly told on its own if more than this share of what it changes is nobody else's; others that make up for less than
#: this share of the most are not named.
ALONE, SLIGHT = 0.3, 0.05
#: A parameter this near to a bound, over its scale, stands at it.
AT_BOUND = 1e-6
#: Where half the sum of squares should still fall by more than this but does not, there is a jump, which is passed at most so often; it is
#: told where it holds the fit off by more than a standard uncertainty.
AT_JUMP, HOPS, HELD_OFF = 0.02, 6, 0.5
#: A jump within the intervals is told from this size on; with smaller ones they have been seen to hold (in standard uncertainties).
CLIFF = 10.0
#: Of several places to start from, so many beside the first are gone on from.
TRIED = 3
#: Stated uncertainties are doubted if such residuals are rarer than this; independence from this correlation with the next row on.
DOUBT, CORRELATED = 1e-3, 0.3


class Unknown(NamedTuple):
    """A number that is fitted: where the fit starts, between what it stays, and how far it may be expected to move."""

    name: str
    unit: str
    start: float
    low: float = -math.inf
    high: float = math.inf
    scale: float = 1.0


class Measured(NamedTuple):
    """Measurements of one kind: name, values, and standard uncertainties; None if these are to be found from the residuals."""

    name: str
    values: Array
    sigma: Array | None = None


@dataclass(frozen=True, eq=False)
class Fit:
    """What least squares found.

    Parameters
    ----------
    unknowns, groups
        What was fitted to what.
    loss
        How residuals count.
    x
        The values found.
    sigma
        Standard uncertainty of each measurement, stated or found.
    before, after
        What is predicted with the values at the start and with those found.
    jacobian
        Derivatives of the predictions at the values found, shape ``(n, p)``.
    evaluations
        How often the model was evaluated.
    converged
        Whether the fit ended by itself.
    left
        By how much, by the derivatives, half the sum of squares could still fall: more than 0 where the fit ended at a jump of the model.
    jump
        How far the model is from its derivatives a standard uncertainty to each side of a number, in standard uncertainties of the
        measurements: the largest root of a sum of squares.

    """

    unknowns: tuple[Unknown, ...]
    groups: tuple[Measured, ...]
    loss: Loss
    x: Array
    sigma: Array
    before: Array
    after: Array
    jacobian: Array
    evaluations: int
    converged: bool
    left: float = 0.0
    jump: float = 0.0

    @cached_property
    def measured(self) -> Array:
        """All measurements, one group after the other."""
        return np.concatenate([g.values for g in self.groups])

    @cached_property
    def residuals(self) -> Array:
        """Predicted less measured, in standard uncertainties."""
        return (self.after - self.measured) / self.sigma

    def rows(self, i: int) -> slice:
        """Return the place of a group among all measurements."""
        first = sum(len(g.values) for g in self.groups[:i])
        return slice(first, first + len(self.groups[i].values))

    @cached_property
    def at_bound(self) -> tuple[str, ...]:
        """Of each parameter, the bound that it stands at: ``low``, ``high`` or nothing."""
        return tuple(
            "low" if x - u.low <= AT_BOUND * u.scale else "high" if u.high - x <= AT_BOUND * u.scale else ""
            for u, x in zip(self.unknowns, self.x, strict=True)
        )

    @cached_property
    def _directions(self) -> _Directions:
        free = np.array([not bound for bound in self.at_bound])
        return _directions(self.jacobian / self.sigma[:, None] * [u.scale for u in self.unknowns], free)

    @cached_property
    def dof(self) -> float:
        """Degrees of freedom of the uncertainties: infinite if all of them are stated."""
        if self.loss == "linear" and all(g.sigma is not None for g in self.groups):
            return math.inf
        own = self._directions.leverage
        places = [self.rows(i) for i, g in enumerate(self.groups) if g.sigma is None or self.loss != "linear"]
        return float(sum(rows.stop - rows.start - own[rows].sum() for rows in places))

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the parameters, shape ``(p, p)``; infinite where the data do not tell, 0 of what stands at a bound."""
        scale = np.array([u.scale for u in self.unknowns])
        factor = 1.0
        if self.loss != "linear":
            psi, slope = _influence(self.residuals, self.loss)
            n, p = len(psi), sum(not bound for bound in self.at_bound)
            K = 1 + p / n * slope.var() / slope.mean() ** 2
            factor = K**2 * float(psi @ psi) / (n - p) / slope.mean() ** 2
        return factor * self._directions.covariance() * np.outer(scale, scale)

    @property
    def std(self) -> Array:
        """Standard uncertainties of the parameters."""
        return np.sqrt(np.diag(self.covariance))

    @cached_property
    def correlation(self) -> Array:
        """Correlations of the parameters, shape ``(p, p)``; NaN where there is none."""
        std = self.std
        with np.errstate(all="ignore"):
            return np.where(np.isfinite(np.outer(std, std)), self.covariance / np.outer(std, std), np.nan)

    @cached_property
    def intervals(self) -> Array:
        """Lower and upper ends of the intervals, shape ``(p, 2)``."""
        half = quantile(self.dof) * self.std
        return np.column_stack([self.x - half, self.x + half])

    @cached_property
    def blind(self) -> tuple[str, ...]:
        """What the data cannot tell, in sentences."""
        return tuple(self._directions.sentences(self.unknowns, self.x))

    @cached_property
    def doubts(self) -> tuple[str, ...]:
        """What speaks against the model, the stated uncertainties, or the independence of the measurements."""
        told = []
        if not self.converged:
            told.append("the fit did not end by itself: its values are the best so far")
        if self.left > HELD_OFF:
            told.append(
                "the fit ended at a jump of the model, such as a gear or an engine that switches a step later: what is found may not be the"
                " best, and intervals do not count the jump"
            )
        elif self.jump > CLIFF:
            told.append(
                f"within the intervals the model jumps by up to {self.jump:.3g} standard uncertainties, as a gear or an engine does that"
                " switches a step later: intervals take it for straight, and are approximate"
            )
        told += [f"{u.name} stands at its {bound}est allowed value, {u.low if bound == 'low' else u.high:g}, and has no interval"
                 for u, bound in zip(self.unknowns, self.at_bound, strict=True) if bound]  # fmt: skip
        for i, g in enumerate(self.groups):
            r = self.residuals[self.rows(i)]
            if g.sigma is not None and self.loss == "linear":
                n = len(r) - self._directions.leverage[self.rows(i)].sum()
                if n > 0 and chdtrc(n, r @ r) < DOUBT:
                    told.append(f"{g.name}: residuals are {math.sqrt(r @ r / n):.3g} times as large as the stated uncertainty says")
            noise = np.std(r * self.sigma[self.rows(i)]) > ROUNDING * np.max(np.abs(g.values))
            if noise and len(r) > 10 and (rho := _serial(r)) > max(CORRELATED, 3 / math.sqrt(len(r))):
                wider = math.sqrt((1 + rho) / (1 - rho))
                told.append(
                    f"{g.name}: residuals follow one another (correlation with the next row {rho:.2f}), so that intervals, which take them"
                    f" for independent, should be up to {wider:.2g} times as wide"
                )
        return tuple(told)


def fit(unknowns: Sequence[Unknown], model: Model, groups: Sequence[Measured], loss: Loss = "linear", starts: int = 1) -> Fit:
    """Fit numbers to measurements.

    With several `starts` the model is tried once at so many places, that of the unknowns and others spread over their ranges, and the
    fit goes on from the first and the best of the others (`TRIED`), whichever leads lower.

    Raises
    ------
    InputError
        If there are too few measurements, or the uncertainty of some cannot be found.

    """
    sizes, p = [len(g.values) for g in groups], len(unknowns)
    problems = [] if loss in LOSSES else [f"loss = {loss!r}, must be one of {', '.join(get_args(Loss))}"]
    stated = sum(n for n, g in zip(sizes, groups, strict=True) if g.sigma is not None)
    if sum(sizes) < p or ((stated < sum(sizes) or loss != "linear") and sum(sizes) <= p):
        problems.append(f"{sum(sizes)} measurements for {p} parameters, there must be more")
    problems += [
        f"{g.name}: {n} rows do not tell their own uncertainty, state it"
        for n, g in zip(sizes, groups, strict=True) if g.sigma is None and n < FEWEST
    ]  # fmt: skip
    if problems:
        raise InputError("fit", problems)
    edges = np.cumsum([0, *sizes])
    places = [slice(a, b) for a, b in pairwise(edges)]
    measured = np.concatenate([g.values for g in groups])
    scale = np.array([u.scale for u in unknowns])
    low, high = np.array([u.low for u in unknowns]), np.array([u.high for u in unknowns])
    start = np.array([u.start for u in unknowns])
    kept: list[tuple[bytes, tuple[Array, Array]]] = []
    evaluations = 0

    def at(u: Array) -> tuple[Array, Array]:
        nonlocal evaluations
        x = np.clip(start + u * scale, low, high)
        key = x.tobytes()
        for known, found in kept:
            if known == key:
                return found
        evaluations += 1
        found = model(x)
        # The solver asks for the derivatives at one of the last two places that it asked for the values.
        kept[:] = [*kept[-2:], (key, found)]
        return found

    before = at(np.zeros(p))[0]
    sigma = np.empty(len(measured))
    for g, rows in zip(groups, places, strict=True):
        off = before[rows] - g.values
        sigma[rows] = g.sigma if g.sigma is not None else math.sqrt(off @ off / len(off)) or 1.0
    bounds, u, ended, left = ((low - start) / scale, (high - start) / scale), np.zeros(p), False, 0.0

    def descended(u: Array, s: Array) -> Any:
        """Return where the solver ends that starts at a place."""
        return least_squares(
            lambda u: (at(u)[0] - measured) / s,
            u,
            lambda u: at(u)[1] * scale / s[:, None],
            bounds=bounds,
            x_scale="jac",
            loss=loss,
            f_scale=LOSSES[loss],
            ftol=1e-12,
            xtol=1e-9,
            gtol=1e-12,
            max_nfev=MOST,
        )

    def beyond(done: Any, s: Array) -> tuple[Any, float]:
        """Return the best of where the solver ended and where it ends beyond jumps, and by how much the sum should fall from there."""
        step, left = _step(done, bounds)
        best, least = done, left
        for _ in range(HOPS):
            # At a jump the solver's short steps all lead upward; the whole step of Gauss and Newton may lead past it.
            if left <= AT_JUMP:
                break
            done = descended(np.clip(done.x + step, *bounds), s)
            step, left = _step(done, bounds)
            if done.cost < best.cost:
                best, least = done, left
        return best, least

    def change(old: Array, new: Array) -> float:
        return float(np.max(np.abs(new / old - 1)))

    if starts > 1:
        others = _spread(unknowns, starts - 1)
        others.sort(key=lambda u: float(np.sum(((at(u)[0] - measured) / sigma) ** 2)))
        u = min((descended(place, sigma) for place in (u, *others[:TRIED])), key=lambda done: float(done.cost)).x
    for _ in range(ROUNDS):
        done = descended(u, sigma)
        found = _found_sigma(groups, places, *at(done.x), measured, sigma, scale, loss)
        if change(sigma, found) < SETTLED:
            done, left = beyond(done, sigma)
            found = _found_sigma(groups, places, *at(done.x), measured, sigma, scale, loss)
        u, ended, sigma, before_that = done.x, done.status > 0, found, sigma
        if change(before_that, sigma) < SETTLED:
            break
    # The solver stays inside of bounds: what it brought to one is at it.
    x = np.clip(start + u * scale, low, high)
    u = np.where(x - low <= AT_BOUND * scale, (low - start) / scale, np.where(high - x <= AT_BOUND * scale, (high - start) / scale, u))
    x = np.clip(start + u * scale, low, high)
    after, jacobian = at(u)
    result = Fit(tuple(unknowns), tuple(groups), loss, x, sigma, before, after, jacobian, evaluations, bool(ended), left)
    jump = 0.0
    for i, std in enumerate(result.std):
        for side in (-std, std) if 0 < std < math.inf else ():
            moved = np.clip(x + side * np.eye(p)[i], low, high)
            off = model(moved)[0] - after - jacobian @ (moved - x)
            jump = max(jump, float(np.linalg.norm(off / sigma)))
    return replace(result, jump=jump)


def _spread(unknowns: Sequence[Unknown], n: int) -> list[Array]:
    """Return places spread evenly over the ranges, over the scales from the start: multiples of powers of a root of x^(p + 1) = x + 1."""
    bounded = [i for i, u in enumerate(unknowns) if math.isfinite(u.low) and math.isfinite(u.high)]
    root = 2.0
    for _ in range(50):
        root = (1 + root) ** (1 / (len(bounded) + 1))
    places = [np.zeros(len(unknowns)) for _ in range(n)]
    for k, place in enumerate(places, 1):
        for j, i in enumerate(bounded, 1):
            u = unknowns[i]
            place[i] = (u.low + (0.5 + k * root**-j) % 1 * (u.high - u.low) - u.start) / u.scale
    return places


def _step(done: Any, bounds: tuple[Array, Array]) -> tuple[Array, float]:
    """Return the step of Gauss and Newton from where a solver ended, and by how much it says that half the sum of squares would fall."""
    low, high = bounds
    held = ((done.x - low <= AT_BOUND) & (done.grad > 0)) | ((high - done.x <= AT_BOUND) & (done.grad < 0))
    lengths = np.linalg.norm(done.jac, axis=0)
    free = ~held & (lengths > 1e-12 * lengths.max(initial=0.0))
    step = np.zeros(len(held))
    _, singular, right = np.linalg.svd(done.jac[:, free] / lengths[free], full_matrices=False)
    told = singular > ROUNDING * singular.max(initial=1.0)
    along = right[told] @ (done.grad[free] / lengths[free]) / singular[told]
    step[free] = -(right[told].T @ (along / singular[told])) / lengths[free]
    return step, float(along @ along) / 2


def quantile(dof: float) -> float:
    """Return by how many standard uncertainties an interval reaches to each side."""
    return float(ndtri((1 + CONFIDENCE) / 2) if math.isinf(dof) else stdtrit(dof, (1 + CONFIDENCE) / 2))


def _found_sigma(
    groups: Sequence[Measured],
    places: Sequence[slice],
    after: Array,
    jacobian: Array,
    measured: Array,
    sigma: Array,
    scale: Array,
    loss: Loss,
) -> Array:
    """Return the uncertainties, those that are not stated from the residuals."""
    if all(g.sigma is not None for g in groups):
        return sigma
    J = jacobian * scale / sigma[:, None]
    own, found, problems = _directions(J, np.full(J.shape[1], True)).leverage, sigma.copy(), []
    for g, rows in zip(groups, places, strict=True):
        if g.sigma is not None:
            continue
        off, n = after[rows] - g.values, len(g.values)
        free = n - own[rows].sum()
        if free < 0.5:
            problems.append(f"{g.name}: {n} rows do not tell their own uncertainty, state it")
        spread = NORMAL * float(np.median(np.abs(off))) * math.sqrt(n) if loss != "linear" else math.sqrt(off @ off)
        # Series without noise are fitted to rounding.
        found[rows] = max(spread / math.sqrt(max(free, 0.5)), 1e-12 * float(np.max(np.abs(g.values))), 1e-300)
    if problems:
        raise InputError("fit", problems)
    return found


def _influence(r: Array, loss: Loss) -> tuple[Array, Array]:
    """Return the derivative of half the loss by the residual, and its derivative."""
    z = (r / LOSSES[loss]) ** 2
    if loss == "huber":
        inside = z <= 1
        return np.where(inside, r, np.sign(r) * LOSSES[loss]), inside.astype(float)
    if loss == "soft_l1":
        return r / np.sqrt(1 + z), (1 + z) ** -1.5
    if loss == "cauchy":
        return r / (1 + z), (1 - z) / (1 + z) ** 2
    return r, np.ones_like(r)


def _serial(r: Array) -> float:
    """Return the correlation of residuals with those of the next row."""
    off = r - r.mean()
    total = off @ off
    return float(off[1:] @ off[:-1] / total) if total else 0.0


class _Directions(NamedTuple):
    """The singular directions of a Jacobian whose free columns have been brought to the same length."""

    free: npt.NDArray[np.bool_]
    lengths: Array
    columns: Array
    left: Array
    singular: Array
    right: Array

    @property
    def told(self) -> npt.NDArray[np.bool_]:
        """Which directions the data tell anything of."""
        return np.asarray(self.singular > ROUNDING * self.singular.max(initial=1.0))

    @property
    def leverage(self) -> Array:
        """Share of each measurement in the parameters."""
        return np.asarray(np.sum(self.left[:, self.told] ** 2, axis=1))

    def covariance(self) -> Array:
        """Return the covariance of all parameters, over their scales."""
        told, p = self.told, len(self.free)
        found = np.zeros((p, p))
        half = self.right[told] / self.singular[told, None] / self.lengths
        inner = half.T @ half
        lost = np.any(np.abs(self.right[~told]) > 1e-3, axis=0) | (self.lengths == _NOTHING)
        inner[lost, lost] = np.inf
        found[np.ix_(self.free, self.free)] = inner
        return found

    def sentences(self, unknowns: Sequence[Unknown], x: Array) -> list[str]:
        """Return what cannot be told."""
        known = [(u, value) for u, value, free in zip(unknowns, x, self.free, strict=True) if free]
        told = [f"{u.name} changes nothing that was measured" for (u, _), n in zip(known, self.lengths, strict=True) if n == _NOTHING]
        alive = [i for i, n in enumerate(self.lengths) if n < _NOTHING]
        # Open is a direction that adds most to an interval as wide as the range of its parameter.
        half = quantile(math.inf) * np.abs(self.right[self.told]) / self.singular[self.told, None] / self.lengths
        wide = np.linalg.norm(half, axis=0) > 0.5
        rank = int(np.sum(self.told)) - len({int(np.argmax(half[:, i])) for i in np.flatnonzero(wide)})
        _, R, order = qr(self.columns[:, alive], mode="economic", pivoting=True) if alive else (None, np.empty((0, 0)), [])
        weights = np.linalg.solve(R[:rank, :rank], R[:rank, rank:]) if rank else np.zeros((0, len(alive)))
        for k in range(rank, len(alive)):
            j, w = alive[order[k]], weights[:, k - rank]
            (u, value), left = known[j], float(np.linalg.norm(R[rank:, k]))
            if left > ALONE:
                told.append(f"{u.name} is hardly told: its interval is as wide as its range")
                continue
            step, moves = 0.01 * abs(value) or 0.01 * u.scale, []
            for i, share in ((alive[order[i]], w[i]) for i in np.flatnonzero(np.abs(w) > SLIGHT * np.abs(w).max())):
                other, at = known[i]
                back = -share * step * (self.lengths[j] / u.scale) / (self.lengths[i] / other.scale)
                by = f"{100 * abs(back / at):.3g} %" if at else f"{abs(back):.3g} {other.unit}"
                moves.append((other.name, f"{'more' if back > 0 else 'less'} of {other.name} by {by}"))
            names, made_up = " and ".join(name for name, _ in moves), " and ".join(text for _, text in moves)
            more = "1 %" if value else f"{step:.3g} {u.unit}"
            hardly = "" if left < ROUNDING else "hardly "
            told.append(
                f"{u.name} and {names} can{'' if hardly else 'not'} {hardly}be told apart: {made_up} makes up for {more} more of {u.name}"
            )
        return told


#: Length of a column that is nothing.
_NOTHING = 1e300


def _directions(J: Array, free: npt.NDArray[np.bool_]) -> _Directions:
    """Return the directions of a Jacobian in standard uncertainties per scale."""
    lengths = np.linalg.norm(J[:, free], axis=0)
    largest = lengths.max(initial=0.0)
    lengths = np.where(lengths > 1e-12 * largest, lengths, _NOTHING) if largest else np.full_like(lengths, _NOTHING)
    columns = J[:, free] / lengths
    left, singular, right = np.linalg.svd(columns, full_matrices=False)
    return _Directions(free, lengths, columns, left, singular, right)
