"""Pictures of calibrations: what was measured beside what was fitted, residuals, and road loads over speed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes

from halfshaft.cosim.plot import COLOURS, INK, LINE, SOFT, Picture, drawing, dress

if TYPE_CHECKING:
    from halfshaft.studies.calibration.calibrate import Calibration
    from halfshaft.studies.calibration.coast_down import CoastedDown
    from halfshaft.studies.calibration.road_load import RoadLoad, Shaped

#: Width of a picture, room at its left and right, its head, room between panels and at the bottom [in].
_WIDTH, _LEFT, _RIGHT, _HEAD, _ROOM, _FOOT = 8.2, 0.85, 0.3, 0.95, 0.22, 0.55
_KMH = 3.6


def plot_load(load: RoadLoad, *shaped: Shaped, path: str | Path | None = None) -> Picture:
    """Draw a road load over speed, and what vehicles were fitted to it.

    Parameters
    ----------
    load
        The road load.
    shaped
        Vehicles that were fitted to it by shape.
    path
        A PNG, SVG or PDF file to write, whole or not at all.

    Raises
    ------
    InputError
        If the file cannot be written.

    """
    with _panels(path, "road load", [f"at {load.m:.5g} kg", load.source[:70]], [2.6, *[1.1] * bool(shaped)]) as (figure, axes):
        _force(axes[0], load)
        for i, found in enumerate(shaped):
            label = f"{found.vehicle.name}: {', '.join(f'{name} {x:.4g}' for name, x in found.values.items())}"
            axes[0].plot(found.v * _KMH, found.fit.after, color=COLOURS[1 + i], lw=1.1, ls="--", label=label)
            axes[1].plot(found.v * _KMH, found.misfit, color=COLOURS[1 + i], lw=1.1)
        if shaped:
            axes[1].axhline(0, color=LINE, lw=0.8)
            axes[1].set_ylabel("misfit [N]")
            axes[0].tick_params(labelbottom=False)
        axes[0].legend(frameon=False, loc="upper left")
        axes[-1].set_xlabel("speed [km/h]")
    return figure


def plot_coast_down(found: CoastedDown, *, path: str | Path | None = None) -> Picture:
    """Draw the speeds of coast-downs and their residuals over time, and the load over speed.

    Parameters
    ----------
    found
        What they tell.
    path
        A PNG, SVG or PDF file to write, whole or not at all.

    Raises
    ------
    InputError
        If the file cannot be written.

    """
    A, B, C = found.load.coefficients
    said = [f"{A:.4g} N", f"{B:.4g} N s/m", f"{C:.4g} N s\u00b2/m\u00b2", f"{found.load.m:g} kg"]
    if found.wind is not None and found.grade is not None:
        said += [f"wind {found.wind:.2g} m/s", f"grade {100 * found.grade:.2g} %"]
    with _panels(path, "coast-down", said, [2.3, 1.1, 2.3], apart=(2,)) as (figure, axes):
        place = 0
        for i, run in enumerate(found.runs):
            colour, rows = COLOURS[i % len(COLOURS)], slice(place, place + len(run.time))
            place += len(run.time)
            t = run.time - run.time[0]
            axes[0].plot(t, run.speed * _KMH, ".", color=colour, ms=2.5, alpha=0.45, mew=0)
            axes[0].plot(t, found.fit.after[rows] * _KMH, color=colour, lw=1.1, label=run.name)
            axes[1].plot(t, (run.speed - found.fit.after[rows]) * _KMH, ".", color=colour, ms=2.5, mew=0)
        axes[0].legend(frameon=False, loc="upper right")
        axes[0].set_ylabel("speed [km/h]")
        axes[0].tick_params(labelbottom=False)
        axes[1].axhline(0, color=LINE, lw=0.8)
        axes[1].set_ylabel("residual [km/h]")
        axes[1].set_xlabel("time [s]")
        _force(axes[2], found.load)
        axes[2].legend(frameon=False, loc="upper left")
        axes[2].set_xlabel("speed [km/h]")
    return figure


def plot_calibration(found: Calibration, *, path: str | Path | None = None) -> Picture:
    """Draw each series: what was measured, what was predicted before and after, and residuals, drive by drive.

    Parameters
    ----------
    found
        What a calibration found.
    path
        A PNG, SVG or PDF file to write, whole or not at all.

    Raises
    ------
    InputError
        If the file cannot be written.

    """
    series = [(record.name, p) for record, of in zip(found.records, found.predicted, strict=True) for p in of]
    said = [f"{row[0]} {row[2]} ({row[3]})" for row in found.rows()[:2]]
    heights = [1.5, 0.8] * len(series)
    with _panels(path, found.base.name, said, heights, apart=range(2, len(heights), 2), head=1.25) as (figure, axes):
        for i, (name, p) in enumerate(series):
            top, low, rows = axes[2 * i], axes[2 * i + 1], found.fit.rows(i)
            factor, unit = _seen(found.matched[i].unit)
            measured, before, after = (factor * x[rows] for x in (found.fit.measured, found.fit.before, found.fit.after))
            top.plot(p.time, measured, ".", color=COLOURS[0], ms=3.2, mew=0, alpha=0.6, zorder=3, label="measured")
            top.plot(p.time, before, color=COLOURS[3], lw=0.8, label="before")
            top.plot(p.time, after, color=COLOURS[1], lw=0.9, label="fitted")
            top.set_ylabel(f"[{unit}]")
            top.tick_params(labelbottom=False)
            title = f"{name}: {p.output.name}" if len(found.records) > 1 else p.output.name
            top.text(0.0, 1.03, title, transform=top.transAxes, va="bottom", color=INK)
            low.axhline(0, color=LINE, lw=0.8)
            low.plot(p.time, measured - before, ".", color=COLOURS[3], ms=1.6, mew=0, alpha=0.6)
            low.plot(p.time, measured - after, ".", color=COLOURS[1], ms=2.2, mew=0)
            low.set_ylabel("residual")
        axes[0].legend(frameon=False, loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=3, fontsize=8, markerscale=3)
        axes[-1].set_xlabel("time [s]")
    return figure


def _seen(unit: str) -> tuple[float, str]:
    """Return factor and unit in which a series is drawn."""
    known = {"W": (1e-3, "kW"), "W.s": (1 / 3.6e6, "kWh"), "m/s": (3.6, "km/h"), "kg/s": (1e3, "g/s"), "1": (100.0, "%")}
    return known.get(unit, (1.0, unit))


def _force(ax: Axes, load: RoadLoad) -> None:
    v = np.linspace(*load.v, 101)
    F, half = load.force(v), load.half_width(v)
    ax.plot(v * _KMH, F, color=COLOURS[0], lw=1.4, label="road load")
    if load.covariance is not None:
        ax.fill_between(v * _KMH, F - half, F + half, color=COLOURS[0], alpha=0.2, lw=0)
    ax.plot(v * _KMH, F - load.C * v**2, color=SOFT, lw=0.9, ls=":", label="without C v\u00b2")
    ax.set_ylim(0, 1.08 * float(np.max(F + half)))
    ax.set_ylabel("force [N]")


@contextmanager
def _panels(
    path: str | Path | None, title: str, said: Sequence[str], heights: Sequence[float], apart: Sequence[int] = (), head: float = _HEAD
) -> Iterator[tuple[Picture, list[Axes]]]:
    """Yield a figure with panels below each other under a head, those of `apart` with an axis before them; it is written at the end."""
    gaps = [0.0 if i == 0 else _FOOT if i in apart else _ROOM for i in range(len(heights))]
    height = head + sum(heights) + sum(gaps) + _FOOT
    with drawing(path, (_WIDTH, height), _LEFT, title, said) as figure:
        y, axes = height - head + 0.2, []
        for gap, high in zip(gaps, heights, strict=True):
            y -= high + gap
            axes.append(figure.add_axes((_LEFT / _WIDTH, y / height, (_WIDTH - _LEFT - _RIGHT) / _WIDTH, high / height)))
            dress(axes[-1])
        yield figure, axes
