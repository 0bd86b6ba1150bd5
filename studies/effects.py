"""What matters in a sweep: the main effect of each axis on a response, and Sobol's indices.

The main effect of an axis is how far the mean of the response goes from one end of the axis to the other: on a grid the mean
over all other axes at each value; of a sample the straight line, or the step of each name, that fits best.  Sobol's indices
say which share of the variance an axis makes, alone (first order) and with all that it acts together with (total).
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias, get_args

import numpy as np

from halfshaft.library.base.errors import InputError, nearest
from halfshaft.studies.job import FAILURE, NOTES

if TYPE_CHECKING:
    import xarray as xr

    from halfshaft.cosim.compiled import Array

#: Share of bootstrap samples inside the bounds of an index, how many there are, and where they begin.
CONFIDENCE, RESAMPLES, SEED = 0.95, 999, 0
#: At most about so many numbers are redrawn at once; they take some megabytes.
AT_ONCE = 1_000_000


#: What can be drawn of a sweep.
Kind: TypeAlias = Literal["lines", "contours", "slices", "tornado", "indices"]
#: Axes over numbers that a kind needs.
_NEEDED = {"lines": 0, "contours": 2, "slices": 3}


class Effect(NamedTuple):
    """The mean of a response at both ends of an axis; of names, at those where it is lowest and highest."""

    axis: str
    ends: tuple[float | str, float | str]
    means: tuple[float, float]

    @property
    def span(self) -> float:
        """How far apart the means are."""
        return abs(self.means[1] - self.means[0])


class Index(NamedTuple):
    """Sobol's indices of an axis, each with the bounds of its confidence."""

    axis: str
    first: float
    first_bounds: tuple[float, float]
    total: float
    total_bounds: tuple[float, float]


def responses_of(found: xr.Dataset) -> list[str]:
    """Return the figures of a sweep that are not the same everywhere."""
    names = [str(name) for name in found.data_vars if name not in (FAILURE, NOTES)]
    # What is nothing but rounding, such as a trace that is met, does not vary.
    return [name for name in names if np.ptp(x := _known(found[name].to_numpy())) > max(1e-9 * np.abs(x).max(), 1e-12)]


def _known(x: Array) -> Array:
    return x[np.isfinite(x)] if np.isfinite(x).any() else np.zeros(1)


def axes_of(found: xr.Dataset) -> list[str]:
    """Return the axes of a sweep."""
    return [str(name) for name in found.coords]


def response(found: xr.Dataset, name: str) -> xr.DataArray:
    """Return a figure of a sweep.

    Raises
    ------
    InputError
        If there is no such figure.

    """
    if name not in found.data_vars or name in (FAILURE, NOTES):
        known = [str(n) for n in found.data_vars if n not in (FAILURE, NOTES)]
        raise InputError("sweep", [f"response {name} is not known{nearest(name, known) or ', must be one of ' + ', '.join(known)}"])
    return found[name]


def main_effects(found: xr.Dataset, name: str) -> list[Effect]:
    """Return the effect of each axis on a response, the largest first; points without the response do not count."""
    y = response(found, name)
    effects = _of_sample(found, y) if y.dims == ("point",) else _of_grid(y)
    return sorted(effects, key=lambda effect: -effect.span)


def _of_grid(y: xr.DataArray) -> list[Effect]:
    effects = []
    for axis in map(str, y.dims):
        means = y.mean([dim for dim in y.dims if dim != axis], skipna=True)
        values, x = means[axis].to_numpy().tolist(), means.to_numpy()
        if np.isfinite(x).any():
            low, high = (int(np.nanargmin(x)), int(np.nanargmax(x))) if isinstance(values[0], str) else (0, -1)
            effects.append(Effect(axis, (values[low], values[high]), (float(x[low]), float(x[high]))))
    return effects


def _ends(found: xr.Dataset, axis: str) -> tuple[float, float]:
    """Return the ends of an axis over a number, which no point of a sample may lie at."""
    values = _made(found).get("axes", {}).get(axis, {}).get("values") or found[axis].to_numpy().tolist()
    return float(min(values)), float(max(values))


def _made(found: xr.Dataset) -> dict[str, Any]:
    return dict(json.loads(found.attrs.get("sweep", "{}")).get("sweep") or {})


def _of_sample(found: xr.Dataset, y: xr.DataArray) -> list[Effect]:
    known = np.isfinite(y.to_numpy())
    row = y.to_numpy()[known]
    columns: list[Array] = []
    places: dict[str, tuple[list[Any], slice]] = {}
    for axis in axes_of(found):
        x = found[axis].to_numpy()[known]
        if x.dtype.kind == "f":
            low, high = _ends(found, axis)
            ends, parts = [low, high], [(x - low) / (high - low)]
        else:
            ends = sorted(set(x.tolist()))
            parts = [(x == end).astype(float) for end in ends[1:]]
        places[axis] = ends, slice(len(columns), len(columns) + len(parts))
        columns += parts
    if len(row) <= len(columns):
        raise InputError("effects", [f"{y.name}: {len(row)} points are too few for {len(columns)} effects"])
    centred = np.column_stack(columns) - np.mean(columns, axis=1)
    slopes, *_ = np.linalg.lstsq(centred, row - row.mean(), rcond=None)
    effects = []
    for axis, (ends, place) in places.items():
        steps, shares = slopes[place], np.mean(columns[place], axis=1)
        # The mean over all points stays where it is.
        means = row.mean() - steps @ shares + np.concatenate([[0.0], steps])
        numeric = not isinstance(ends[0], str)
        i, j = (0, 1) if numeric else (int(means.argmin()), int(means.argmax()))
        effects.append(Effect(axis, (ends[i], ends[j]), (float(means[i]), float(means[j]))))
    return effects


def sobol_indices(found: xr.Dataset, name: str) -> list[Index]:
    """Return Sobol's indices of each axis for a response, the largest first.

    Raises
    ------
    InputError
        If the sweep was not drawn for it, by a sample ``saltelli:N``, or some of its points have no such response.

    """
    from scipy.stats import sobol_indices as indices  # takes over a second

    y = response(found, name).to_numpy()
    sample = _made(found).get("sample") or {}
    if sample.get("kind") != "saltelli":
        raise InputError("indices", ["Sobol's indices need points that are drawn for them; sweep with the sample saltelli:64"])
    if lost := int((~np.isfinite(y)).sum()):
        raise InputError("indices", [f"{name}: {lost} of {len(y)} points have no value, but the indices need all of them"])
    axes, n = axes_of(found), int(sample["n"])
    if len(axes) == 1:
        # All variance is that of the one number; SciPy's estimate needs two.
        all_of_it = float(np.ptp(y) > 0)
        return [Index(axes[0], all_of_it, (all_of_it, all_of_it), all_of_it, (all_of_it, all_of_it))]
    a, b, *mixed = y.reshape(-1, n)

    def of(chosen: Any) -> Array:
        """Return both indices of each axis, for each row of chosen points."""
        func = {"f_A": a[chosen], "f_B": b[chosen], "f_AB": np.array([x[chosen] for x in mixed])}
        result = indices(func=func, n=n)
        return np.stack([np.atleast_2d(result.first_order), np.atleast_2d(result.total_order)], axis=1)

    first, total = of(np.arange(n)[None])[0]
    chance = np.random.default_rng(SEED)
    drawn = np.array([chance.integers(0, n, n) for _ in range(RESAMPLES)])
    again = np.concatenate([of(part) for part in np.array_split(drawn, -(-drawn.size * len(axes) // AT_ONCE))])
    low, high = np.quantile(again, (0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2), axis=0)
    bounds = np.stack([low, high], axis=-1).tolist()
    found_indices = [Index(axis, float(first[i]), tuple(bounds[0][i]), float(total[i]), tuple(bounds[1][i])) for i, axis in enumerate(axes)]
    return sorted(found_indices, key=lambda index: -index.total)


def names_or(given: Sequence[str], found: xr.Dataset) -> list[str]:
    """Return the responses that are given, checked, or the first that varies."""
    problems: list[str] = []
    for name in given:
        try:
            response(found, name)
        except InputError as error:
            problems += error.problems
    if problems:
        raise InputError("sweep", problems)
    return list(given) or responses_of(found)[:1]


def kind_problems(kind: str, numbers: int, sampled: bool) -> list[str]:
    """Return why a sweep cannot be drawn so: one with so many axes over numbers, over a grid or a sample."""
    if kind not in get_args(Kind):
        return [f"kind {kind} is not known{nearest(kind, get_args(Kind))}, must be one of {', '.join(get_args(Kind))}"]
    if kind in _NEEDED and sampled:
        return [f"{kind} need a grid, this is a sample: draw its tornado"]
    if numbers < _NEEDED.get(kind, 0):
        return [f"{kind} need {_NEEDED[kind]} axes over numbers, this sweep has {numbers}: draw lines"]
    return []


class Constraint(NamedTuple):
    """What a response must keep to."""

    name: str
    sign: Literal["<=", ">="]
    limit: float

    @classmethod
    def read(cls, text: str) -> Constraint:
        """Return what ``time_s <= 12`` says.

        Raises
        ------
        InputError
            If it says no constraint.

        """
        match = re.fullmatch(r"\s*(\S+?)\s*(<=|>=|<|>)\s*(\S+)\s*", text)
        try:
            if match is None:
                raise ValueError
            return cls(match[1], "<=" if match[2].startswith("<") else ">=", float(match[3]))
        except ValueError:
            raise InputError(f"constraint {text}", ["must be NAME<=NUMBER or NAME>=NUMBER, such as soc_end>=0.3"]) from None

    def excess(self, found: xr.Dataset) -> xr.DataArray:
        """Return how far the response is beyond its limit; below 0 it keeps to it."""
        try:
            beyond = response(found, self.name) - self.limit
        except InputError as error:
            raise InputError(f"constraint {self.name}{self.sign}{self.limit:g}", error.problems) from None
        return beyond if self.sign == "<=" else -beyond
