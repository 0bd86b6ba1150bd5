"""Pictures of a component's maps: lines over one axis, contours over two, one contour plot a gear over three."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from halfshaft.cosim.compiled import Array
from halfshaft.cosim.plot import COLOURS, INK, LINE, SOFT, STYLE, Picture, dress, plot_problems
from halfshaft.cosim.units import Units, edge
from halfshaft.library.base.errors import InputError
from halfshaft.library.base.parameters import Parameters, Spec, spec_of
from halfshaft.library.base.tables import Axis, Table
from halfshaft.library.files.component_file import ComponentFile
from halfshaft.library.files.writing import written_whole

#: An axis of at most so many points gives a line for each of them.
_FEW = 6
#: Width of a panel and height with its title [in].
_WIDTH, _HEIGHT = 4.1, 3.1


@dataclass(frozen=True, eq=False)
class _Map:
    """A map of one or two axes, in the units of a reader."""

    title: str
    unit: str
    axes: tuple[Axis, ...]
    points: tuple[Array, ...]
    values: Array


def plot_maps(file: ComponentFile, path: str | Path | None = None, units: Units = "metric") -> Figure:
    """Draw all maps of a component.

    Parameters
    ----------
    file
        The component.
    path
        A PNG, SVG or PDF file to write, whole or not at all.
    units
        Of axes and values.

    Raises
    ------
    InputError
        If the component has no maps, or the file cannot be written.

    """
    maps = list(_maps(file, units))
    within = {one.title: [other for other in maps if _is_envelope(other, one)] for one in maps}
    maps = [one for one in maps if not any(one in envelopes for envelopes in within.values())]
    problems = plot_problems(Path(path)) if path is not None else []
    if not maps:
        problems.append(f"{file.name} has no maps to draw")
    if problems:
        raise InputError(str(path) if path is not None else "plot", problems)
    columns = min(2, len(maps))
    rows = -(-len(maps) // columns)
    with mpl.rc_context(STYLE):
        figure = Picture(figsize=(_WIDTH * columns if columns > 1 else 1.4 * _WIDTH, _HEIGHT * rows + 0.55), layout="constrained")
        figure.suptitle(f"{file.name}   {file.title}", x=0.02, ha="left", fontsize=10, color=INK)
        grid = np.atleast_1d(np.asarray(figure.subplots(rows, columns))).ravel()
        for ax, one in zip(grid, maps, strict=False):
            dress(ax)
            _draw(ax, one, within[one.title])
        for ax in grid[len(maps) :]:
            ax.set_axis_off()
        if path is not None:
            with written_whole(path) as part:
                figure.savefig(part, dpi=200, facecolor="white")
    return figure


def _is_envelope(line: _Map, m: _Map) -> bool:
    """Return whether a line belongs into a map, such as the largest torque over the speed."""
    return len(m.axes) == 2 and line.axes == m.axes[:1] and line.unit == m.axes[1].unit and min(map(len, m.points)) > _FEW


def _maps(file: ComponentFile, units: Units) -> Iterator[_Map]:
    """Yield the maps, those of three axes as one of two for each point of the third."""
    kind: type[Parameters] = file.component.parameters
    for f in fields(kind):
        spec, table = spec_of(f), file.values.get(f.name, f.default)
        if not isinstance(table, Table):
            continue
        # Axes along which nothing changes are left out.
        live = table.reduced.live or [0]
        axes, points = tuple(spec.axes[i] for i in live), tuple(table.points[i] for i in live)
        values = table.values[tuple(slice(None) if i in live else 0 for i in range(len(spec.axes)))]
        if len(axes) < 3:
            yield _shown(f.name, spec, axes, points, values, units)
            continue
        for i, x in enumerate(points[2]):
            yield _shown(f"{f.name}, {axes[2].name} {x:g}", spec, axes[:2], points[:2], values[:, :, i], units)


def _shown(name: str, spec: Spec, axes: tuple[Axis, ...], points: tuple[Array, ...], values: Array, units: Units) -> _Map:
    unit, factor, offset = edge(spec.unit, units)
    named = tuple(Axis(a.name, edge(a.unit, units).name) for a in axes)
    moved = tuple(x * scale + zero for x, (_, scale, zero) in zip(points, (edge(a.unit, units) for a in axes), strict=True))
    return _Map(f"{name}: {spec.doc}", unit, named, moved, values * factor + offset)


def _label(name: str, unit: str) -> str:
    return name if unit == "1" else f"{name} [{unit}]"


def _draw(ax: Axes, m: _Map, envelopes: list[_Map]) -> None:
    ax.set_title(m.title, loc="left", fontsize=8.5, color=SOFT, wrap=True)
    name = m.title.partition(":")[0]
    # An axis of few points is told by lines, over the axis of many.
    few = int(np.argmin([len(x) for x in m.points])) if min(len(x) for x in m.points) <= _FEW else None
    if len(m.points) == 1:
        ax.plot(m.points[0], m.values, color=COLOURS[0], lw=1.4, marker="o", ms=2.5)
        ax.set_ylabel(_label(name, m.unit))
        ax.set_xlabel(_label(*m.axes[0]))
    elif few is not None:
        over = 1 - few
        for i, x in enumerate(m.points[few]):
            ax.plot(m.points[over], m.values.take(i, axis=few), color=COLOURS[i], lw=1.4, label=f"{x:.4g}")
        ax.set_ylabel(_label(name, m.unit))
        ax.set_xlabel(_label(*m.axes[over]))
        ax.legend(title=_label(*m.axes[few]), frameon=False, fontsize=7.5, title_fontsize=7.5, labelcolor=SOFT)
    else:
        ax.grid(False)
        x, y = m.points
        drawn = ax.contourf(x, y, m.values.T, levels=14, cmap="viridis")
        bar = ax.figure.colorbar(drawn, ax=ax)
        bar.set_label(_label(name, m.unit), color=SOFT)
        bar.ax.tick_params(labelsize=7.5, color=LINE, labelcolor=SOFT)
        for other in envelopes:
            ax.plot(other.points[0], other.values, color="white", lw=2.4)
            ax.plot(other.points[0], other.values, color=INK, lw=1.1)
        ax.set_xlim(x[0], x[-1])
        ax.set_ylim(y[0], y[-1])
        ax.set_xlabel(_label(*m.axes[0]))
        ax.set_ylabel(_label(*m.axes[1]))
