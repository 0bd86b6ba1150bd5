"""Picture of an optimum: who gives the power in the best way and under the control in use, and charge and fuel of all ways."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from halfshaft.cosim.compiled import Array
from halfshaft.cosim.plot import COLOURS, LINE, SOFT, TIMES, Picture, drawing, dress, legend
from halfshaft.cosim.units import SYSTEMS, Units, edge, shown
from halfshaft.library.base.tags import part_of

if TYPE_CHECKING:
    from halfshaft.studies.optimal.optimum import Optimum, Way

#: Width of the picture, and room left and right of the axes [in].
_WIDTH, _LEFT, _RIGHT = 8.2, 0.72, 0.3
#: Heights of the panels, and room above each [in].
_SPEED, _POWER, _CHARGE, _ROOM = 0.85, 1.35, 1.3, 0.36
#: Height of the title, and of what stands below the last panel [in].
_HEAD, _FOOT = 0.45, 0.55
_BLUE, _RED, _GREEN = COLOURS[0], COLOURS[1], COLOURS[2]
#: Colours of the ways.
_TINTS = (SOFT, COLOURS[3], _BLUE)


def plot_optimum(optimum: Optimum, *, units: Units = "metric", path: str | Path | None = None) -> Picture:
    """Draw an optimum.

    Parameters
    ----------
    optimum
        What was found.
    units
        Those of the speed and of the fuel.
    path
        A PNG, SVG or PDF file to write, whole or not at all.

    Raises
    ------
    InputError
        If the file cannot be written.

    """
    gears = any(np.ptp(way.result[name]) > 0 for way in optimum.ways for name in way.result.tags.all_of("gear"))
    heights = (_SPEED, _POWER, _POWER, *([_SPEED] if gears else []), _CHARGE, _CHARGE)
    height = _HEAD + sum(heights) + _ROOM * len(heights) + _FOOT
    _, unit, second = next(t for t in TIMES if optimum.cycle.duration <= t[0])
    result = optimum.in_use.result
    time = np.concatenate([[result.t_start], result.time]) / second
    with drawing(path, (_WIDTH, height), _LEFT, optimum.vehicle.name, _said(optimum, units)) as figure:
        y, axes = height - _HEAD, []
        for high in heights:
            y -= high + _ROOM
            axes.append(figure.add_axes((_LEFT / _WIDTH, y / height, (_WIDTH - _LEFT - _RIGHT) / _WIDTH, high / height)))
            dress(axes[-1])
        _speed(axes[0], time, optimum, units)
        for ax, way in zip(axes[1:3], (optimum.best, optimum.in_use), strict=True):
            _split(ax, time, way)
        ends = [ax.get_ylim() for ax in axes[1:3]]
        for ax in axes[1:3]:
            ax.set_ylim(min(low for low, _ in ends), max(high for _, high in ends))
        if gears:
            _gear(axes[3], time, optimum)
        _charge(axes[-2], time, optimum)
        _fuel(axes[-1], time, optimum, units)
        for ax in axes:
            ax.set_xlim(time[0], time[-1])
            ax.yaxis.set_label_coords(-0.47 / (_WIDTH - _LEFT - _RIGHT), 0.5)
            ax.tick_params(labelbottom=ax is axes[-1])
        axes[-1].set_xlabel(f"time [{unit}]")
    return figure


def _said(optimum: Optimum, units: Units) -> list[str]:
    said = [optimum.cycle.name]
    for way in optimum.ways:
        more = "" if way is optimum.best else f" ({100 * optimum.excess(way):+.1f} %)"
        said.append(f"{way.name} {shown('economy', way.result.figures['fuel_economy_L_per_100km'], units, 2)}{more}")
    return said


def _speed(ax: Axes, time: Array, optimum: Optimum, units: Units) -> None:
    unit, factor, _ = edge("m/s", units)
    ax.plot(time[1:], factor * optimum.best.result.the("request"), color=LINE, lw=1.2)
    ax.set_ylim(0, None)
    ax.set_ylabel(f"speed [{unit}]")
    ax.yaxis.set_major_locator(MaxNLocator(3))


def _split(ax: Axes, time: Array, way: Way) -> None:
    """Draw what source and store give."""
    result = way.result
    sources, stores = (list(map(part_of, result.tags.all_of(tag))) for tag in ("fuel mass", "charge"))
    for part in stores:
        ax.fill_between(time[1:], 0, result[f"{part}.P_out"] / 1e3, color=_GREEN, alpha=0.4, lw=0, step="pre", label=_named(part))
    for part in sources:
        ax.step(time[1:], result[f"{part}.P_out"] / 1e3, color=_RED, lw=0.9, where="pre", label=_named(part))
    ax.axhline(0, color=LINE, lw=0.7)
    ax.margins(y=0.06)
    ax.yaxis.set_major_locator(MaxNLocator(4))
    ax.set_ylabel("power [kW]")
    legend(ax)
    ax.text(1.0, 1.03, way.name, transform=ax.transAxes, ha="right", va="bottom", fontweight="bold")


def _named(part: str) -> str:
    return part.replace("_", " ")


def _gear(ax: Axes, time: Array, optimum: Optimum) -> None:
    for way, colour in ((optimum.in_use, _TINTS[0]), (optimum.best, _TINTS[2])):
        for name in way.result.tags.all_of("gear"):
            ax.step(time[1:], way.result[name], color=colour, lw=0.9, where="pre")
    ax.yaxis.set_major_locator(MaxNLocator(4, integer=True))
    ax.set_ylabel("gear")


def _charge(ax: Axes, time: Array, optimum: Optimum) -> None:
    for way, colour in zip(optimum.ways, _TINTS, strict=True):
        start = way.result.first[way.result.tags.the("charge")]
        ax.plot(time, 100 * np.concatenate([[start], optimum.charge(way)]), color=colour, lw=1.3, label=way.name)
    ax.yaxis.set_major_locator(MaxNLocator(4))
    ax.set_ylabel("charge [%]")
    legend(ax)


def _fuel(ax: Axes, time: Array, optimum: Optimum, units: Units) -> None:
    """Draw the fuel that was burnt so far."""
    unit = SYSTEMS[units]["volume"]
    for way, colour in zip(optimum.ways, _TINTS, strict=True):
        r, p = way.result, way.result.inputs.parameters
        density = {part: p[name] for part, name in r.tags.by_part("fuel density").items()}
        litres = np.sum([1e3 * r[name] / density[part] for part, name in r.tags.by_part("fuel mass").items()], axis=0)
        ax.plot(time, np.concatenate([[0.0], unit.of(1.0) * litres]), color=colour, lw=1.3)
    ax.set_ylim(0, None)
    ax.yaxis.set_major_locator(MaxNLocator(4))
    ax.set_ylabel(f"fuel [{unit.name}]")
