"""Picture of an uncertainty: for each figure its samples with the normal distribution to first order, and who made its variance."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from halfshaft.cosim.figures import title_of, unit_of
from halfshaft.cosim.plot import COLOURS, INK, LINE, SOFT, Picture, drawing, dress
from halfshaft.cosim.units import Edge, edge

if TYPE_CHECKING:
    from halfshaft.studies.uncertainty import Uncertain, Uncertainty

#: Width of the picture; left end and width of the histograms and of the bars; room above all, around a row, and below it [in].
_WIDTH, _HISTOGRAM, _BARS, _HEAD, _ABOVE, _BELOW = 8.6, (0.35, 3.7), (5.75, 2.5), 1.0, 0.18, 0.62
#: Heights of a row: of a bar, and at least [in].
_BAR, _LEAST = 0.42, 1.7
#: A histogram is drawn between these shares of the samples, wide enough for the normal distribution between the same shares.
_TAIL, _SCORE = 0.001, 3.0902
_SAMPLES, _FIRST, _ALONE, _TOTAL = "#b9d9ea", COLOURS[1], COLOURS[0], "#9fcbe6"


def plot_uncertainty(found: Uncertainty, *, path: str | Path | None = None) -> Picture:
    """Draw an uncertainty.

    Parameters
    ----------
    found
        What was found.
    path
        A PNG, SVG or PDF file to write, whole or not at all.

    Raises
    ------
    InputError
        If the file cannot be written.

    """
    figures = list(found.figures.values())
    rows = max(_LEAST, _BAR * max(len(of.shares) for of in figures) + 0.2)
    height = _HEAD + len(figures) * (rows + _ABOVE + _BELOW)
    samples = found.drawn
    cars, _, rest = found.title.partition(": ")
    said = [rest, f"{samples.sizes['point']} samples", *([f"{found.lost} runs failed"] if found.lost else [])]
    with drawing(path, (_WIDTH, height), _HISTOGRAM[0], cars, said) as figure:
        indexed = any(share.sobol for of in figures for share in of.shares)
        _keys(figure, indexed)
        for i, of in enumerate(figures):
            y = (height - _HEAD - (i + 1) * (rows + _ABOVE + _BELOW) + _BELOW) / height
            left, right = (figure.add_axes((x / _WIDTH, y, wide / _WIDTH, rows / height)) for x, wide in (_HISTOGRAM, _BARS))
            for ax in (left, right):
                dress(ax)
                ax.grid(False)
                ax.spines["left"].set_visible(False)
            x = samples[of.name].to_numpy()
            _histogram(left, of, x[np.isfinite(x)])
            _shares(right, of)
    return figure


def _keys(figure: Picture, indexed: bool) -> None:
    """Say what the colours mean."""
    height = figure.get_figheight()
    bars = [("to first order", _FIRST), *([("alone", _ALONE), ("with others", _TOTAL)] if indexed else [])]
    for x, keys in ((_HISTOGRAM[0], [("samples", _SAMPLES), ("normal, to first order", _FIRST)]), (_BARS[0], bars)):
        lines = [Line2D([], [], color=colour, lw=1.8 if "normal" in name else 6, solid_capstyle="butt") for name, colour in keys]
        figure.legend(
            lines, [name for name, _ in keys], loc="upper left", bbox_to_anchor=(x / _WIDTH, 1 - 0.72 / height), ncols=3, frameon=False,
            fontsize=8.5, labelcolor=SOFT, handlelength=1.0, borderaxespad=0, borderpad=0, columnspacing=1.2,
        )  # fmt: skip


def _histogram(ax: Axes, of: Uncertain, x: np.ndarray) -> None:
    scale = edge(unit_of(of.name))
    ends = np.quantile(x, (_TAIL, 1 - _TAIL)).tolist()
    if of.first_order is not None:
        ends += [of.first_order.mean - _SCORE * of.first_order.sd, of.first_order.mean + _SCORE * of.first_order.sd]
    low, high = min(ends), max(ends)
    inside = x[(x >= low) & (x <= high)]
    bins = np.linspace(*(inside.min(), inside.max() + 1e-12), int(np.clip(1.5 * len(x) ** 0.4, 8, 60)) + 1)
    heights, _ = np.histogram(x, bins)
    density = heights / len(x) / (np.diff(bins) * scale.factor)
    ax.stairs(density, _shown(scale, bins), fill=True, color=_SAMPLES)
    if of.first_order is not None and of.first_order.sd > 0:
        mean, sd = of.first_order.mean, of.first_order.sd
        u = np.linspace(low, high, 301)
        bell = np.exp(-0.5 * ((u - mean) / sd) ** 2) / (np.sqrt(2 * np.pi) * sd * scale.factor)
        ax.plot(_shown(scale, u), bell, color=_FIRST, lw=1.6)
    top = ax.get_ylim()[1]
    ax.set_ylim(0, 1.12 * top)
    for value, name, side in ((of.sampled.p5, "5 %", "right"), (of.sampled.p50, "50 %", "center"), (of.sampled.p95, "95 %", "left")):
        place = _shown(scale, value)
        ax.axvline(place, color=INK, lw=0.7, ls=(0, (4, 3)), ymax=0.9)
        ax.text(place, 1.03 * top, f"{name}  {place:#.4g}".replace("-", "\u2212"), ha=side, fontsize=7.5, color=SOFT)
    ax.set_yticks([])
    ax.xaxis.set_major_locator(MaxNLocator(6))
    unit = scale.name.replace("^2", "\u00b2")
    ax.set_xlabel(f"{title_of(of.name)} [{unit}]" if unit != "1" else title_of(of.name))


def _shown(scale: Edge, x: Any) -> Any:
    return x * scale.factor + scale.offset


def _shares(ax: Axes, of: Uncertain) -> None:
    for place, share in enumerate(of.shares):
        bars: list[tuple[float | None, tuple[float, float] | None, str]] = [(share.first_order, None, _FIRST)]
        if share.sobol:
            bars += [(share.sobol.first, share.sobol.first_bounds, _ALONE), (share.sobol.total, share.sobol.total_bounds, _TOTAL)]
        high = 0.8 / len(bars)
        for i, (value, bounds, colour) in enumerate(bars):
            y = place + (i - (len(bars) - 1) / 2) * high
            ax.barh(y, value or 0.0, height=0.88 * high, color=colour)
            if bounds:
                ax.plot(np.clip(bounds, 0, None), [y, y], color=INK, lw=0.8, solid_capstyle="butt")
    low = min([0.0, *(share.first_order or 0.0 for share in of.shares)])
    ax.set_yticks(range(len(of.shares)), [share.name for share in of.shares])
    ax.set_ylim(len(of.shares) - 0.45, -0.55)
    ax.set_xlim(1.02 * low, max(1.02, *(1.02 * (share.first_order or 0.0) for share in of.shares)))
    ax.axvline(0, color=LINE, lw=0.7)
    ax.grid(axis="x", color="#ececec", lw=0.7)
    ax.set_xlabel("share of the variance")
