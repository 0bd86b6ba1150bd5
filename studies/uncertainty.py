"""How uncertain the figures of a vehicle are, where its numbers are: by samples, and to first order beside it.

Numbers that have distributions are drawn, and each draw is a run: mean, standard deviation and percentiles are those of the
draws.  To first order a figure is a plane through the expected values of the numbers, with the gradient g there, so that

    mean = f(E x),    variance = g' S g,    S the covariance of the numbers,

and its distribution is normal.  The gradient of a plain run is exact; that of any other task is taken over a standard deviation.
Which share of the variance a number makes follows from both: to first order ``g_i (S g)_i / variance``, which adds up to 1; of
samples that are drawn for it as Sobol's indices.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from halfshaft.cosim.figures import main_of, unit_of
from halfshaft.cosim.simulate import run
from halfshaft.library.base.errors import HalfshaftError, InputError, not_a
from halfshaft.library.files.notebook import Grid, card
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.design import Design, Given, Sample, design_of
from halfshaft.studies.distributions import Correlation, Distribution, covariance
from halfshaft.studies.effects import Constraint, Index, responses_of, sobol_indices
from halfshaft.studies.job import FAILURE
from halfshaft.studies.sweep import sweep
from halfshaft.studies.task import Drive

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

    from halfshaft.cosim.compiled import Array
    from halfshaft.studies.task import Task

#: Drawn where nothing is said: with Sobol's indices where the numbers are independent.
INDEPENDENT, DEPENDENT = "saltelli:256", "sobol:1024"
#: Normal score of the 95th percentile.
SCORE_95 = 1.6448536269514722
#: Slopes of what is no plain run are taken over this many standard deviations to either side.
STEP = 0.5


class Spread(NamedTuple):
    """Mean, standard deviation and percentiles of a figure."""

    mean: float
    sd: float
    p5: float
    p50: float
    p95: float


class Share(NamedTuple):
    """Which share of a figure's variance a number makes: to first order, and by Sobol's indices; None where not worked out."""

    name: str
    first_order: float | None
    sobol: Index | None


@dataclass(frozen=True)
class Uncertain:
    """How uncertain a figure is.

    Parameters
    ----------
    name
        Of the figure.
    sampled
        From the samples that have it.
    first_order
        From the gradient; None if the vehicle of the expected values does not have it.
    gradient
        By the name of the number, in the figure's unit over that of the number in SI.
    shares
        Of each number, the largest first.
    missing
        How many samples do not have the figure.

    """

    name: str
    sampled: Spread
    first_order: Spread | None
    gradient: Mapping[str, float]
    shares: tuple[Share, ...]
    missing: int = 0


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """What is known of the figures of a vehicle.

    Parameters
    ----------
    samples
        The runs, as `sweep` returns them: numbers and figures over ``point``.
    figures
        How uncertain each is, by name.
    lost
        How many runs failed; `samples` says why in ``failure``.
    notes
        What a user should know.

    """

    samples: xr.Dataset
    figures: Mapping[str, Uncertain]
    lost: int
    notes: tuple[str, ...]

    @property
    def title(self) -> str:
        """Vehicle, tasks and what is uncertain."""
        return str(self.samples.attrs["title"])

    @property
    def drawn(self) -> xr.Dataset:
        """The runs that are draws of the distributions; those that only Sobol's indices need are left out."""
        return self.samples.isel(point=slice(self.samples.attrs["draws"]))

    def probability(self, constraint: str) -> float:
        """Return how probable it is that a figure keeps to a limit, such as ``"time_0_to_100_kmh_s <= 12"``.

        Runs without the figure, such as of a car that never reaches the speed, do not keep to it.

        Raises
        ------
        InputError
            If that is no constraint on a figure.

        """
        return float((Constraint.read(constraint).excess(self.drawn) <= 0).mean())

    def rows(self) -> list[tuple[str, ...]]:
        """Return a table as texts: `HEADINGS`, then for each figure a line from the samples and one to first order."""
        found = []
        for name, of in self.figures.items():
            unit = unit_of(name)
            for way, spread in (("samples", of.sampled), ("first order", of.first_order)):
                cells = ["-"] * len(Spread._fields) if spread is None else [f"{x:.5g}" for x in spread]
                found.append((f"{name} [{unit}]" if unit != "1" else name, way, *cells))
        return found

    def share_rows(self) -> list[tuple[str, ...]]:
        """Return the shares as texts: `SHARE_HEADINGS`, then a line for each figure and number."""

        def told(x: float | None) -> str:
            # No sign before what is rounded to nothing.
            return "-" if x is None else f"{round(100 * x, 1) + 0.0:.1f}"

        return [
            (name, s.name, f"{of.gradient[s.name]:.5g}" if s.name in of.gradient else "-", told(s.first_order),
             told(s.sobol and s.sobol.first), told(s.sobol and s.sobol.total))
            for name, of in self.figures.items() for s in of.shares
        ]  # fmt: skip

    def plot(self, *, path: str | Path | None = None) -> Figure:
        """Draw the samples with the normal distribution to first order, and the shares of the numbers; write it to a file."""
        from halfshaft.studies.uncertainty_plot import plot_uncertainty  # matplotlib takes a quarter of a second

        return plot_uncertainty(self, path=path)

    def _repr_html_(self) -> str:
        facts = {"draws": str(self.drawn.sizes["point"]), "failed": str(self.lost), "notes": "; ".join(self.notes)}
        return card("uncertainty", self.title, facts, Grid(HEADINGS, self.rows()), Grid(SHARE_HEADINGS, self.share_rows(), "shares"))


#: Columns of the tables.
HEADINGS = ("figure", "by", "mean", "sd", "5 %", "50 %", "95 %")
SHARE_HEADINGS = ("figure", "number", "slope", "first order [%]", "alone [%]", "with others [%]")


def uncertainty(
    vehicle: Vehicle,
    vary: Mapping[str, Given],
    tasks: Task | Sequence[Task],
    *,
    correlation: Correlation | None = None,
    sample: str | None = None,
    seed: int = 0,
    truncate: bool = False,
    figures: Sequence[str] = (),
    folder: str | Path | None = None,
    workers: int | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Uncertainty:
    """Work out how uncertain figures are.

    Parameters
    ----------
    vehicle
        Whose numbers are uncertain.
    vary
        Distributions by ``role.parameter``: ``"normal(0.30, 0.01)"``, ``"uniform(1300, 1500 kg)"``, ``"triangular(low, mode, high)"``,
        ``"lognormal(mean, sd)"``, normal and lognormal also cut, ``"normal(mean, sd, low, high)"``; or frozen distributions of
        `scipy.stats`.  Numbers are SI or have a unit.
    tasks
        What is done with each vehicle, such as ``Drive(cycle)`` or ``AccelerationTest()``.
    correlation
        Of the numbers, by pairs of names or as a matrix in the order of `vary`; exactly, of their normal scores.
    sample
        ``sobol:N``, ``lhs:N``, or ``saltelli:N`` for Sobol's indices too, of N (d + 2) runs for d numbers.  Without it ``saltelli:256``,
        or ``sobol:1024`` where numbers are correlated.
    seed
        The same one draws the same samples.
    truncate
        Cut the distributions at the bounds of their numbers; without it, a sample outside is an error.
    figures
        Which ones to keep and look at; without it all are kept, and the main ones that vary looked at.
    folder, workers, progress
        As of `sweep`.

    Returns
    -------
    Uncertainty
        Figures by samples and to first order, with shares and the samples themselves.

    Raises
    ------
    InputError
        If something given is not what it must be; everything that is wrong is named at once.

    """
    figures = (figures,) if isinstance(figures, str) else figures
    work = tuple(tasks) if isinstance(tasks, list | tuple) else (tasks,)
    chosen = sample or (INDEPENDENT if correlation is None else DEPENDENT)
    design = _planned(vehicle, vary, chosen, seed, correlation, truncate)
    found = sweep(
        vehicle, vary, work, sample=chosen, seed=seed, correlation=correlation, truncate=truncate, responses=figures,
        folder=folder, workers=workers, progress=progress,
    )  # fmt: skip
    assert design.sample is not None
    found.attrs["draws"] = design.size - design.sample.n * len(design.axes) if design.sample.kind == "saltelli" else design.size
    prefixes = [f"{task.name}." if len(work) > 1 else "" for task in work]
    own = [[name for name in responses_of(found) if name.startswith(prefix)] for prefix in prefixes]
    names = list(figures) or [name for group in own for name in main_of(group) or group]
    notes: list[str] = []
    lost = int((found[FAILURE] != "").sum())
    if lost:
        first = next(text for text in found[FAILURE].to_numpy().tolist() if text)
        notes.append(f"{lost} of {design.size} runs failed and are left out, the first one: {first}")
    at_mean, slopes = _slopes(vehicle, work, design, notes)
    spread = covariance([axis.spread for axis in design.axes if axis.spread], design.correlation)
    told = {name: _uncertain(found, name, [axis.name for axis in design.axes], at_mean, slopes, spread, notes) for name in names}
    return Uncertainty(found, told, lost, tuple(dict.fromkeys(notes)))


def _planned(
    vehicle: Vehicle, vary: Mapping[str, Given], sample: str, seed: int, correlation: Correlation | None, truncate: bool
) -> Design:  # fmt: skip
    """Return what is drawn, or raise an error if it is not all of distributions; `sweep` says what else is wrong."""
    if problems := not_a(Vehicle, vehicle=vehicle):
        raise InputError("uncertainty", problems)
    if not vary:
        raise InputError("uncertainty", ["no number has a distribution, at least one must, such as body.m=normal(1300, 40)"])
    try:
        drawn = Sample.read(str(sample), seed)
    except InputError as error:
        problems += [f"{error.where} {problem}" for problem in error.problems]
        drawn = Sample("lhs", 2)
    design = design_of((vehicle,), vary, drawn, problems, correlation, truncate)
    fixed = [axis.name for axis in design.axes if axis.spread is None and not any(f"axis {axis.name}" in p for p in problems)]
    problems += [f"axis {name} = {vary[name]!r}, must be a distribution, such as normal(1300, 40)" for name in fixed]
    if problems:
        raise InputError("uncertainty", problems)
    return design


def _slopes(
    vehicle: Vehicle, tasks: Sequence[Task], design: Design, notes: list[str]
) -> tuple[dict[str, float], dict[str, Array]]:  # fmt: skip
    """Return the figures of the vehicle of the expected values, and the gradient of each over the numbers that are uncertain."""
    spreads = {axis.name: axis.spread for axis in design.axes if axis.spread}
    at_mean: dict[str, float] = {}
    slopes: dict[str, Array] = {}
    for task in tasks:
        prefix = f"{task.name}." if len(tasks) > 1 else ""
        try:
            value, gradient = _exact(task, vehicle, spreads) if isinstance(task, Drive) else _secants(task, vehicle, spreads)
        # A task of the user's own may raise anything; what the samples tell stays.
        except Exception as error:
            kind = "" if isinstance(error, HalfshaftError) else f"{type(error).__name__}: "
            notes.append(f"{task.name}: not known to first order: {kind}{error}")
            continue
        at_mean |= {prefix + name: value[name] for name in gradient}
        slopes |= {prefix + name: g for name, g in gradient.items()}
    return at_mean, slopes


def _exact(task: Drive, vehicle: Vehicle, spreads: Mapping[str, Distribution]) -> tuple[dict[str, float], dict[str, Array]]:
    """Return the figures of a run at the expected values, and their exact gradients."""
    mean = {name: spread.mean for name, spread in spreads.items()}
    found = run(vehicle.with_values(mean), task.cycle, mode=task.mode, dt=task.dt, history=False, gradient=list(mean))
    value = _known(found.figures)
    gradient = {name: np.array([of[n] for n in mean]) for name, of in found.gradient.items() if name in value}
    return value, {name: g for name, g in gradient.items() if np.isfinite(g).all()}


def _secants(task: Task, vehicle: Vehicle, spreads: Mapping[str, Distribution]) -> tuple[dict[str, float], dict[str, Array]]:
    """Return the figures of any task at the expected values, and how they rise over a standard deviation around them."""
    mean = {name: spread.mean for name, spread in spreads.items()}

    def at(values: Mapping[str, float]) -> dict[str, float]:
        return _known(task(vehicle.with_values(values)).figures)

    value = at(mean)
    below, above = ([at(mean | {name: mean[name] + way * STEP * s.sd}) for name, s in spreads.items()] for way in (-1, 1))
    widths = np.array([2 * STEP * s.sd for s in spreads.values()])
    everywhere = [name for name in value if all(name in end for end in (*below, *above))]
    return value, {name: np.array([b[name] - a[name] for a, b in zip(below, above, strict=True)]) / widths for name in everywhere}


def _known(figures: Mapping[str, Any]) -> dict[str, float]:
    """Return the figures that a vehicle has."""
    return {name: float(x) for name, x in figures.items() if isinstance(x, int | float | np.number) and math.isfinite(x)}


def _uncertain(
    found: xr.Dataset, name: str, numbers: Sequence[str], at_mean: Mapping[str, float], slopes: Mapping[str, Array], spread: Array,
    notes: list[str],
) -> Uncertain:  # fmt: skip
    """Return what is known of a figure."""
    x = found[name].to_numpy()[: found.attrs["draws"]]
    known = x[np.isfinite(x)]
    missing = len(x) - len(known)
    if len(known) < 2:
        raise InputError("uncertainty", [f"{name}: {len(known)} of {len(x)} samples have it, at least two must"])
    if missing:
        notes.append(f"{name}: {missing} of {len(x)} samples do not have it and are left out")
    sampled = Spread(float(known.mean()), float(known.std(ddof=1)), *np.quantile(known, (0.05, 0.5, 0.95)).tolist())
    first: dict[str, float] = {}
    normal = None
    g = slopes.get(name)
    if g is None:
        notes.append(f"{name}: not known to first order, the vehicle of the expected values does not have it")
    else:
        variance, mean = float(g @ spread @ g), at_mean[name]
        sd = math.sqrt(variance)
        normal = Spread(mean, sd, mean - SCORE_95 * sd, mean, mean + SCORE_95 * sd)
        first = dict(zip(numbers, (g * (spread @ g) / variance).tolist(), strict=True)) if variance > 0 else {}
    indices = _indices(found, name, notes)
    shares = [Share(number, first.get(number), indices.get(number)) for number in numbers]
    shares.sort(key=lambda s: -max(s.first_order or 0.0, s.sobol.total if s.sobol else 0.0))
    return Uncertain(name, sampled, normal, {} if g is None else dict(zip(numbers, g.tolist(), strict=True)), tuple(shares), missing)


def _indices(found: xr.Dataset, name: str, notes: list[str]) -> dict[str, Index]:
    """Return Sobol's indices where the samples give them."""
    if found.attrs["draws"] == found.sizes["point"] or np.ptp(found[name].to_numpy()) == 0:
        return {}
    try:
        return {index.axis: index for index in sobol_indices(found, name)}
    except InputError as error:
        notes += error.problems
        return {}
