"""What a number may be: a distribution, told in words or by `scipy.stats`, and how several hang together.

Correlations are those of a Gaussian copula: what is correlated are the normal scores, ``norm.ppf(cdf(x))``; of normal
distributions they are the numbers themselves.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np

from halfshaft.library.base.errors import nearest, number
from halfshaft.library.base.parameters import Spec
from halfshaft.library.files.component_file import Reader, shown

if TYPE_CHECKING:
    from halfshaft.cosim.compiled import Array

#: Correlations of pairs of names; or a matrix, in the order of the axes.
Correlation: TypeAlias = Mapping[tuple[str, str], float] | Sequence[Sequence[float]]
_CALL = re.compile(r"\s*(\w+)\s*\((.*)\)\s*")
#: A share is never nearer to 0 or 1: there many distributions are infinite.
_EDGE = 2.0**-53
#: Nodes of a Gauss-Hermite quadrature over a normal score.
_NODES = 48


@dataclass(frozen=True)
class Distribution:
    """What a number may be, in SI.

    Parameters
    ----------
    text
        How it was told.
    of
        A frozen distribution of `scipy.stats`.
    low, high
        Where it is cut.

    """

    text: str
    of: Any
    low: float = -math.inf
    high: float = math.inf

    def at(self, share: Any) -> Any:
        """Return the value below which a share lies."""
        below, up_to = self.of.cdf([self.low, self.high])
        u = np.clip(below + np.asarray(share) * (up_to - below), _EDGE, 1 - _EDGE)
        return np.clip(self.of.ppf(u), self.low, self.high)

    @property
    def cut(self) -> bool:
        """Whether some of it is cut off."""
        return math.isfinite(self.low) or math.isfinite(self.high)

    @cached_property
    def mean(self) -> float:
        """Expected value."""
        return float(self._expected(lambda x: x) if self.cut else self.of.mean())

    @cached_property
    def sd(self) -> float:
        """Standard deviation."""
        return math.sqrt(self._expected(lambda x: (x - self.mean) ** 2)) if self.cut else float(self.of.std())

    def _expected(self, function: Callable[[Any], Any]) -> float:
        # Not over the whole support: the quadrature would miss a narrow distribution.
        low, high = self.of.ppf([_EDGE, 1 - _EDGE])
        return float(self.of.expect(function, lb=max(low, self.low), ub=min(high, self.high), conditional=True))

    def within(self, spec: Spec) -> Distribution:
        """Return it cut at the bounds of a number."""
        low, high = (end if end is not None else other for end, other in ((spec.lowest, -math.inf), (spec.highest, math.inf)))
        return replace(self, low=max(low, self.low), high=min(high, self.high))

    def problems(self) -> list[str]:
        """Return why it cannot be used."""
        below, up_to = self.of.cdf([self.low, self.high])
        if not up_to > below:
            return ["nothing of it lies inside its bounds"]
        return (
            [] if math.isfinite(self.mean) and 0 < self.sd < math.inf else ["must have a finite mean and a finite standard deviation > 0"]
        )


class _Kind(NamedTuple):
    """A distribution that can be told in words: its arguments, those that are lengths, what must hold, and how it is made."""

    arguments: tuple[str, ...]
    lengths: tuple[str, ...]
    must: str
    holds: Callable[..., bool]
    make: Callable[..., Any]


def _normal(mean: float, sd: float) -> Any:
    from scipy.stats import norm  # takes over a second

    return norm(mean, sd)


def _uniform(low: float, high: float) -> Any:
    from scipy.stats import uniform

    return uniform(low, high - low)


def _triangular(low: float, mode: float, high: float) -> Any:
    from scipy.stats import triang

    return triang((mode - low) / (high - low), low, high - low)


def _lognormal(mean: float, sd: float) -> Any:
    from scipy.stats import lognorm

    variance = math.log1p((sd / mean) ** 2)
    return lognorm(math.sqrt(variance), scale=mean * math.exp(-variance / 2))


KINDS = {
    "normal": _Kind(("mean", "sd"), ("sd",), "sd > 0", lambda mean, sd: sd > 0, _normal),
    "uniform": _Kind(("low", "high"), (), "low < high", lambda low, high: low < high, _uniform),
    "triangular": _Kind(
        ("low", "mode", "high"), (), "low <= mode <= high and low < high",
        lambda low, mode, high: low <= mode <= high and low < high, _triangular,
    ),
    "lognormal": _Kind(("mean", "sd"), ("sd",), "mean > 0 and sd > 0", lambda mean, sd: mean > 0 and sd > 0, _lognormal),
}  # fmt: skip
_TOLD = ", ".join(f"{name}({', '.join(kind.arguments)})" for name, kind in KINDS.items())


def is_distribution(given: Any) -> bool:
    """Return whether this is a distribution rather than values: told in words, or one of `scipy.stats`."""
    return bool(_CALL.fullmatch(given)) if isinstance(given, str) else hasattr(given, "ppf")


def read_distribution(given: Any, spec: Spec, where: str, problems: list[str]) -> Distribution | None:
    """Return a distribution from ``normal(0.30, 0.01)`` or a frozen one of `scipy.stats`; or None, and what is wrong.

    A unit at the end counts for the numbers before it that have none.  Two more numbers cut a normal or a lognormal.
    """
    if isinstance(given, str):
        found = _read(given, spec, where, problems)
    elif hasattr(given, "dist") and all(hasattr(given, name) for name in ("ppf", "cdf", "mean", "std", "expect")):
        arguments = (*(f"{x:.12g}" for x in given.args), *(f"{name}={x:.12g}" for name, x in given.kwds.items()))
        found = Distribution(f"{given.dist.name}({', '.join(arguments)})", given)
    else:
        problems.append(f"{where} = {given!r:.60}, must be a distribution with its numbers, such as scipy.stats.norm(0.3, 0.01)")
        return None
    if found is None:
        return None
    wrong = found.problems()
    problems.extend(f"{where} = {found.text}, {problem}" for problem in wrong)
    return None if wrong else found


def _read(text: str, spec: Spec, where: str, problems: list[str]) -> Distribution | None:
    match = _CALL.fullmatch(text)
    if match is None or match[1] not in KINDS:
        near = nearest(match[1], KINDS) if match else ""
        problems.append(f"{where} = {shown(text)}, must be one of {_TOLD}{near}")
        return None
    kind = KINDS[match[1]]
    items = [item.strip() for item in match[2].split(",")]
    names = kind.arguments + (("low", "high") if kind.lengths and len(items) > len(kind.arguments) else ())
    if len(items) != len(names):
        cut = f" or {match[1]}({', '.join((*kind.arguments, 'low', 'high'))})" if kind.lengths else ""
        problems.append(f"{where} = {shown(text)}, must be {match[1]}({', '.join(kind.arguments)}){cut}")
        return None
    reader, free = Reader(), Spec(spec.unit, spec.doc)
    unit, values = "", dict[str, float]()
    for name, item in reversed(list(zip(names, items, strict=True))):
        plain = re.fullmatch(r"([-+.\deE]+)\s*(.*)", item)
        unit = plain[2] if plain and plain[2] else unit
        quantity = f"{plain[1]} {unit}" if plain and unit else number(item) if plain else item
        values[name] = reader.number(quantity, free, f"{where}: {name}", plain=True)
        if name in kind.lengths and unit:
            # A unit may have an offset, as degrees have; a length has none.
            values[name] -= reader.number(f"0 {unit}", free, f"{where}: {name}", plain=True)
    if reader.problems:
        problems.extend(dict.fromkeys(reader.problems))
        return None
    low, high = (values.pop(name) for name in ("low", "high")) if len(names) > len(kind.arguments) else (-math.inf, math.inf)
    if not kind.holds(**values) or not low < high:
        problems.append(f"{where} = {shown(text)}, must have {kind.must}{'' if low < high else ' and low < high'}")
        return None
    return Distribution(text.strip(), kind.make(**values), low, high)


def correlation_matrix(given: Correlation | None, names: Sequence[str], problems: list[str]) -> Array | None:
    """Return the correlations of all numbers as a matrix, or None where there are none; and add what is wrong."""
    if given is None or len(given) == 0:
        return None
    matrix, before = np.eye(len(names)), len(problems)
    if isinstance(given, Mapping):
        seen = set()
        for pair, value in given.items():
            told = f"correlation {', '.join(map(str, pair))} = {value}" if isinstance(pair, tuple) else f"correlation {pair!r} = {value}"
            if not (isinstance(pair, tuple) and len(pair) == 2 and pair[0] != pair[1]):
                problems.append(f"{told}, must be of two numbers")
                continue
            problems.extend(f"{told}: {name} has no distribution{nearest(name, names)}" for name in pair if name not in names)
            if frozenset(pair) in seen:
                problems.append(f"{told} is given twice")
            seen.add(frozenset(pair))
            if len(problems) == before:
                i, j = (names.index(name) for name in pair)
                matrix[i, j] = matrix[j, i] = number(value)
    else:
        try:
            matrix = np.atleast_2d(np.array(given, dtype=float))
        except (TypeError, ValueError):
            matrix = np.empty((0, 0))
        if matrix.shape != (len(names), len(names)):
            problems.append(f"correlation must have {len(names)} rows of {len(names)} numbers, in the order of {', '.join(names)}")
    if len(problems) > before:
        return None
    off = matrix[~np.eye(len(names), dtype=bool)]
    if not (np.all(np.diag(matrix) == 1) and np.all(np.abs(off) < 1) and np.array_equal(matrix, matrix.T)):
        problems.append("correlation must be between -1 and 1, the same for a pair in either order, and 1 of a number with itself")
    elif (least := float(np.linalg.eigvalsh(matrix)[0])) <= 0:
        problems.append(f"correlation is not possible: the matrix is not positive definite, its least eigenvalue is {least:.3g}")
    return matrix


def correlated(shares: Array, matrix: Array) -> Array:
    """Return shares between 0 and 1 of which the normal scores have these correlations, from independent ones."""
    from scipy.special import ndtr, ndtri

    return np.asarray(ndtr(ndtri(np.clip(shares, _EDGE, 1 - _EDGE)) @ np.linalg.cholesky(matrix).T))


def covariance(distributions: Sequence[Distribution], matrix: Array | None) -> Array:
    """Return the covariance of the numbers themselves.

    From the correlations of the normal scores, by quadrature.
    """
    sd = np.array([d.sd for d in distributions])
    found = np.diag(sd**2)
    if matrix is None:
        return found
    from scipy.special import ndtr

    z, w = np.polynomial.hermite_e.hermegauss(_NODES)
    w = w / w.sum()
    for i in range(len(sd)):
        for j in range(i):
            if rho := matrix[i, j]:
                one = distributions[i].at(ndtr(z)) - distributions[i].mean
                other = distributions[j].at(ndtr(rho * z[:, None] + math.sqrt(1 - rho**2) * z)) - distributions[j].mean
                found[i, j] = found[j, i] = (w * one) @ (other @ w)
    return found
