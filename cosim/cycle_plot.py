"""Pictures of cycles: speed, grade and key over time, the time at each speed, and acceleration over speed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from halfshaft.cosim.compiled import Array
from halfshaft.cosim.cycle import Cycle
from halfshaft.cosim.plot import COLOURS, LINE, SOFT, TIMES, Picture, drawing, dress, legend
from halfshaft.cosim.units import SYSTEMS, Units

#: Width of the picture, and room left and right of the axes [in].
_WIDTH, _LEFT, _RIGHT = 8.2, 0.72, 0.3
#: Width of a bar of the histogram, in the unit of speed.
_BIN = {"metric": 10.0, "us": 5.0}
#: A trace of more points than this has only so many of its accelerations drawn.
_POINTS = 6000


def plot_cycle(cycle: Cycle, *, before: Cycle | None = None, units: Units = "metric", path: str | Path | None = None) -> Picture:
    """Draw a cycle.

    Parameters
    ----------
    cycle
        What is drawn.
    before
        What it was before it was smoothed or restored, drawn grey behind it.
    units
        Of the axes.
    path
        A PNG, SVG or PDF file to write, whole or not at all.

    Raises
    ------
    InputError
        If the file cannot be written.

    """
    road = cycle.grade_by_distance
    heights = [2.2, *([0.8] if road is not None or cycle.grade is not None else []), 1.9]
    above = [0.8, *[0.25] * (len(heights) - 2), 0.85]
    height = sum(heights) + sum(above) + 0.6
    values = {name: (value, unit) for name, value, unit, _ in cycle.figures(units)}
    said = [
        f"{value} {unit if unit != '1' else name}" for name in ("duration", "distance", "v_max", "stops") for value, unit in [values[name]]
    ]
    said[2] = f"at most {said[2]}"
    with drawing(path, (_WIDTH, height), _LEFT, cycle.name, said) as figure:
        y, axes = height, []
        for high, room in zip(heights, above, strict=True):
            y -= high + room
            axes.append(figure.add_axes((_LEFT / _WIDTH, y / height, (_WIDTH - _LEFT - _RIGHT) / _WIDTH, high / height)))
        bottom = axes.pop()
        half = bottom.get_position()
        bottom.set_position((half.x0, half.y0, 0.43 * half.width, half.height))
        beside = figure.add_axes((half.x0 + 0.57 * half.width, half.y0, 0.43 * half.width, half.height))
        for ax in (*axes, bottom, beside):
            dress(ax)
        _trace(axes[0], cycle, before, units)
        if len(axes) > 1:
            _road(axes[1], cycle)
            axes[0].set_xlabel("")
            axes[0].tick_params(labelbottom=False)
        _histogram(bottom, cycle, units)
        _accelerations(beside, cycle, units)
    return figure


def _time(cycle: Cycle, of: Cycle | None = None) -> tuple[Array, str]:
    """Return the times of a cycle, or of another one beside it, and their unit."""
    unit, second = next((unit, 1 / length) for longest, unit, length in TIMES if cycle.duration <= longest)
    return (of or cycle).time * second, unit


def _trace(ax: Axes, cycle: Cycle, before: Cycle | None, units: Units) -> None:
    speed = SYSTEMS[units]["speed"]
    t, unit = _time(cycle)
    if before is not None:
        ax.plot(_time(cycle, before)[0], before.speed * speed.of(1.0), color="#b5b5b5", lw=0.8, label="before")
    ax.plot(t, cycle.speed * speed.of(1.0), color=COLOURS[0], lw=1.1, label="after" if before is not None else None)
    if cycle.key_on is not None:
        off = np.flatnonzero((cycle.key_on[1:] <= 0) & (cycle.key_on[:-1] <= 0))
        spans = list(zip(t[off].tolist(), (t[off + 1] - t[off]).tolist(), strict=True))
        ax.broken_barh(spans, (0, 1), transform=ax.get_xaxis_transform(), color="#e6e6e6", lw=0, zorder=0.5, label="key off")
    ax.set_xlim(t[0], t[-1])
    ax.set_ylim(0, None)
    ax.set_xlabel(f"time [{unit}]")
    ax.set_ylabel(f"speed [{speed.name}]")
    if before is not None or cycle.key_on is not None:
        legend(ax)


def _road(ax: Axes, cycle: Cycle) -> None:
    """Draw the grade over time; one over distance where the trace is when it is met."""
    t, unit = _time(cycle)
    if cycle.grade_by_distance is not None:
        dt, v = np.diff(cycle.time), cycle.speed
        travelled = np.append(0.0, np.cumsum((v[1:] + v[:-1]) / 2 * dt))
        grade = np.interp(travelled, *cycle.grade_by_distance)
    else:
        assert cycle.grade is not None
        grade = cycle.grade
    ax.plot(t, 100 * grade, color=SOFT, lw=1.0)
    ax.axhline(0, color=LINE, lw=0.7)
    ax.yaxis.set_major_locator(MaxNLocator(3))
    ax.set_xlim(t[0], t[-1])
    ax.set_xlabel(f"time [{unit}]")
    ax.set_ylabel("grade [%]")


def _histogram(ax: Axes, cycle: Cycle, units: Units) -> None:
    """Draw the share of time at each speed, with the time at rest a bar of its own."""
    speed, width = SYSTEMS[units]["speed"], _BIN[units]
    bins = int(speed.of(float(cycle.speed.max())) // width) + 1
    edges = width * np.arange(bins + 1)
    total = cycle.duration or 1.0
    idle = 100 * cycle.statistics().t_idle / total
    shares = 100 * cycle.time_at(edges / speed.of(1.0)) / total
    shares[0] -= idle
    ax.bar(edges[:-1] + width / 2, shares, width=0.88 * width, color=COLOURS[5], lw=0, label="moving")
    ax.bar(-0.5 * width, idle, width=0.88 * width, color=COLOURS[3], lw=0, label="at rest")
    ax.set_xlim(-1.2 * width, edges[-1])
    ax.set_xlabel(f"speed [{speed.name}]")
    ax.set_ylabel("time [%]")
    ax.yaxis.set_major_locator(MaxNLocator(5))
    legend(ax)


def _accelerations(ax: Axes, cycle: Cycle, units: Units) -> None:
    speed, acceleration = SYSTEMS[units]["speed"], SYSTEMS[units]["acceleration"]
    middle, a = (cycle.speed[1:] + cycle.speed[:-1]) / 2, np.diff(cycle.speed) / np.diff(cycle.time)
    drawn = np.flatnonzero(middle > 0)[:: max(1, len(a) // _POINTS)]
    ax.plot(middle[drawn] * speed.of(1.0), a[drawn] * acceleration.of(1.0), ".", color=COLOURS[0], ms=2.5, alpha=0.45, mew=0)
    ax.axhline(0, color=LINE, lw=0.7)
    ax.set_xlim(0, None)
    ax.set_xlabel(f"speed [{speed.name}]", color=SOFT)
    ax.set_ylabel(f"acceleration [{acceleration.name}]".replace("^2", "\u00b2"))
