"""Pictures of sweeps: lines, contours, slices, the main effects as a tornado, and Sobol's indices.

Each response has a row of panels.  What is not wanted is shown too: where a constraint is broken, lines are dotted, and areas pale
behind a line in the constraint's colour.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from halfshaft.cosim.plot import COLOURS, INK, LINE, SOFT, STYLE, Picture, dress, plot_problems
from halfshaft.cosim.units import edge
from halfshaft.library.base.errors import InputError
from halfshaft.library.files.writing import written_whole
from halfshaft.studies.effects import Constraint, Kind, axes_of, kind_problems, main_effects, names_or, sobol_indices

if TYPE_CHECKING:
    import xarray as xr

    from halfshaft.cosim.compiled import Array

#: From light to dark, so that it can be read without colours too.
SHADES = LinearSegmentedColormap.from_list("halfshaft", ["#f3f7f6", "#c4dfe0", "#7fb8c9", "#3a86ae", "#1d5583", "#12304f"])
#: A longer meaning of an axis is not part of its label.
LONGEST = 20
#: At most so many lines in a panel, and panels side by side; of more values of a third axis some are shown.
MOST_LINES, MOST_PANELS = 12, 6
#: Width and height of a panel, and room around it: left, right, above, below [in].
_PANEL, _LEFT, _RIGHT, _ABOVE, _BELOW = (2.9, 2.5), 0.75, 0.35, 0.22, 0.6
_GAP, _HEAD = 0.36, 0.74


def plot_sweep(
    found: xr.Dataset,
    responses: Sequence[str] = (),
    *,
    kind: Kind | None = None,
    constraints: Sequence[str] = (),
    path: str | Path | None = None,
) -> Figure:
    """Draw a sweep.

    Parameters
    ----------
    found
        What `sweep` returned.
    responses
        What is drawn, a row of panels each; the first figure that varies, if none is named.
    kind
        ``lines`` over the first axis, one for each value of the others; ``contours`` over two axes; ``slices``, contours at values
        of a third one; ``tornado``, the main effects; ``indices``, those of Sobol.  Without it, what fits the axes.
    constraints
        What responses must keep to, such as ``"soc_end >= 0.3"``.
    path
        A PNG, SVG or PDF file to write, whole or not at all.

    Returns
    -------
    matplotlib.figure.Figure
        The figure; no window system is touched.

    Raises
    ------
    InputError
        If a response is not there, the kind does not fit the sweep, or the file cannot be written.

    """
    responses, constraints = ((given,) if isinstance(given, str) else given for given in (responses, constraints))
    problems = [f"{path}: {problem}" for problem in plot_problems(Path(path))] if path is not None else []
    chosen = kind or _fitting(found)
    problems += kind_problems(chosen, len(_numbers(found)), "point" in found.dims)
    names, limits = list(responses), list[Constraint]()
    try:
        names = names_or(responses, found)
    except InputError as error:
        problems += error.problems
    for text in constraints:
        try:
            limits.append(Constraint.read(text))
            limits[-1].excess(found)
        except InputError as error:
            problems += [f"{error.where}: {problem}" for problem in error.problems]
    if not names and not problems:
        problems.append("nothing varies in this sweep")
    if problems:
        raise InputError("plot", problems)
    with mpl.rc_context(STYLE):
        figure = _DRAWN[chosen](found, names, limits)
        if path is not None:
            with written_whole(path) as part:
                figure.savefig(part, dpi=200, facecolor="white")
    return figure


def _fitting(found: xr.Dataset) -> Kind:
    """Return what fits the axes of a sweep."""
    if "point" in found.dims:
        sample = json.loads(found.attrs.get("sweep", "{}")).get("sweep", {}).get("sample") or {}
        return "indices" if sample.get("kind") == "saltelli" else "tornado"
    numeric = len(_numbers(found))
    return "lines" if numeric < 2 else "contours" if numeric == 2 else "slices" if numeric == 3 else "tornado"


def _numbers(found: xr.Dataset) -> list[str]:
    """Return the axes over numbers, of a part of a sweep those that are left."""
    return [str(name) for name in found.coords if found[name].dtype.kind == "f" and found[name].size > 1]


class _Scale(NamedTuple):
    """How a quantity is shown: its name and unit, and what its values are multiplied by and raised by."""

    name: str
    unit: str
    factor: float = 1.0
    offset: float = 0.0

    def __call__(self, x: Any) -> Any:
        return x * self.factor + self.offset

    @property
    def label(self) -> str:
        """Name and unit."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    def value(self, x: float | str) -> str:
        """Return a value with its unit."""
        return x if isinstance(x, str) else f"{self(x):.4g} {self.unit}".rstrip().replace("-", "\u2212")


def _scale(x: xr.DataArray) -> _Scale:
    """Return the scale of an axis or a response."""
    unit, factor, offset = edge(x.attrs.get("units", ""), "metric")
    told = re.split(r"[,;(]", x.attrs.get("long_name", ""))[0].strip()
    axis = str(x.name) in x.coords
    name = str(x.name) if axis and (not told or len(told) > LONGEST) else f"{told}, {x.name}" if axis else told
    return _Scale(name, "" if unit == "1" else unit.replace("^2", "\u00b2").replace("^3", "\u00b3"), factor, offset)


def _title(figure: Figure, found: xr.Dataset, aside: str, left: float = _LEFT) -> None:
    """Write which vehicles and tasks it is about, and what is drawn."""
    width, height = figure.get_figwidth(), figure.get_figheight()
    title, _, _ = found.attrs.get("title", "sweep").partition(" over ")
    cars, _, tasks = title.partition(": ")
    figure.text(left / width, 1 - 0.34 / height, cars, fontsize=14 if len(cars) < 40 else 10, fontweight="bold", va="baseline")
    told = "   \u00b7   ".join(filter(None, (tasks, aside)))
    figure.text(left / width, 1 - 0.57 / height, told, fontsize=9, va="baseline", color=SOFT)


def _grid(
    rows: int, columns: int = 1, *, panel: tuple[float, float] = _PANEL, left: float = _LEFT, right: float = _RIGHT, head: float = _HEAD
) -> tuple[Figure, list[list[Axes]]]:
    """Return a figure with panels, styled."""
    cell = panel[0] + _GAP
    width = left + columns * cell - _GAP + right
    height = head + rows * (panel[1] + _ABOVE + _BELOW)
    figure = Picture(figsize=(max(width, 5.0), height))
    width = figure.get_figwidth()
    axes = []
    for i in range(rows):
        y = height - head - (i + 1) * (panel[1] + _ABOVE + _BELOW) + _BELOW
        row = [figure.add_axes(((left + j * cell) / width, y / height, panel[0] / width, panel[1] / height)) for j in range(columns)]
        for ax in row:
            dress(ax)
        axes.append(row)
    return figure, axes


def _at(found: xr.Dataset, others: Sequence[str], values: Sequence[Any]) -> xr.Dataset:
    return found.sel(dict(zip(others, values, strict=True))) if others else found


def _lines(found: xr.Dataset, names: Sequence[str], limits: Sequence[Constraint]) -> Figure:
    dims = [str(dim) for dim in found.dims]
    x = next(iter(_numbers(found)), dims[0])
    others = [dim for dim in dims if dim != x]
    groups = list(product(*(found[dim].to_numpy().tolist() for dim in others)))
    if len(groups) > MOST_LINES:
        raise InputError("plot", [f"{len(groups)} lines are too many, at most {MOST_LINES} can be told apart: draw contours or a tornado"])
    figure, axes = _grid(len(names), panel=(6.4, 2.5), right=_RIGHT if len(groups) == 1 else 1.7)
    shades = len(others) == 1 and found[others[0]].dtype.kind == "f"
    scale = _scale(found[x])
    for (ax,), name in zip(axes, names, strict=True):
        told = _scale(found[name])
        for i, values in enumerate(groups):
            colour = mpl.colors.to_hex(SHADES(0.3 + 0.7 * i / max(len(groups) - 1, 1))) if shades else COLOURS[i % len(COLOURS)]
            of = _at(found, others, values)
            label = ", ".join(_scale(found[dim]).value(value) for dim, value in zip(others, values, strict=True))
            _line(ax, of, x, scale, told, name, limits, colour, label)
        ax.margins(x=0.03, y=0.12)
        ax.set_ylabel(told.label)
        ax.set_xlabel(scale.label if name == names[-1] else "")
        ax.tick_params(labelbottom=name == names[-1])
        for limit in limits:
            if limit.name == name:
                ax.axhline(told(limit.limit), color=SOFT, lw=0.8, ls=(0, (4, 3)))
        if len(groups) > 1 and name == names[0]:
            ax.legend(
                title=", ".join(others), loc="upper left", bbox_to_anchor=(1.0, 1.02), frameon=False, fontsize=8.5, title_fontsize=8.5,
                alignment="left", handlelength=1.3, labelcolor=SOFT,
            )  # fmt: skip
    broken = " or ".join(_said(found, limit, {"<=": ">", ">=": "<"}) for limit in limits)
    _title(figure, found, f"dotted where {broken}" if limits else "")
    return figure


def _said(found: xr.Dataset, limit: Constraint, signs: Mapping[str, str]) -> str:
    """Return a constraint in words."""
    told = _scale(found[limit.name])
    return f"{told.name} {signs[limit.sign]} {told.value(limit.limit)}"


def _line(
    ax: Axes, of: xr.Dataset, x: str, scale: _Scale, told: _Scale, name: str, limits: Sequence[Constraint], colour: str, label: str
) -> None:
    """Draw a line, solid where it keeps to the constraints and dotted elsewhere."""
    values, y = of[x].to_numpy(), told(of[name].to_numpy())
    if values.dtype.kind != "f":
        ax.plot(values, y, "o", color=colour, ms=5, label=label)
        return
    u = scale(values)
    if not limits:
        ax.plot(u, y, "o-", color=colour, lw=1.5, ms=3.2, label=label)
        return
    fine = np.unique(np.concatenate([np.linspace(u[0], u[-1], 601), u]))
    worst = np.max([np.interp(fine, u, limit.excess(of).to_numpy()) for limit in limits], axis=0)
    along, kept = np.interp(fine, u, y), worst <= 0
    ax.plot(fine, np.where(kept, along, np.nan), color=colour, lw=1.5, label=label)
    ax.plot(fine, np.where(kept, np.nan, along), color=colour, lw=1.3, ls=(0, (1, 1.6)))
    at = np.interp(u, fine, worst) <= 0
    ax.plot(u[at], y[at], "o", color=colour, ms=3.2)
    ax.plot(u[~at], y[~at], "o", mec=colour, mfc="white", ms=3.2, mew=0.9)


def _contours(found: xr.Dataset, names: Sequence[str], limits: Sequence[Constraint]) -> Figure:
    """Draw contours over the first two axes of numbers, in a panel for each value of the others."""
    dims = [str(dim) for dim in found.dims]
    x, y, *_ = _numbers(found)
    others = [dim for dim in dims if dim not in (x, y)]
    panels = list(product(*(_some(found[dim].to_numpy().tolist()) for dim in others)))
    if len(panels) > MOST_PANELS:
        raise InputError("plot", [f"{len(panels)} panels are too many, at most {MOST_PANELS} fit: choose values by sel, or draw a tornado"])
    head = _HEAD + 0.24 * ((len(limits) + 1) // 2)
    figure, axes = _grid(len(names), len(panels), right=1.0, panel=_PANEL if len(panels) > 1 else (4.6, 3.4), head=head)
    across, up = _scale(found[x]), _scale(found[y])
    for row, name in zip(axes, names, strict=True):
        told = _scale(found[name])
        shown = [_at(found, others, values) for values in panels]
        all_values = told(np.concatenate([of[name].to_numpy().ravel() for of in shown]))
        levels = MaxNLocator(9).tick_values(np.nanmin(all_values), np.nanmax(all_values))
        norm = Normalize(levels[0], levels[-1])
        for i, (ax, of, values) in enumerate(zip(row, shown, panels, strict=True)):
            u, v = across(of[x].to_numpy()), up(of[y].to_numpy())
            z = told(of[name].transpose(y, x).to_numpy())
            ax.grid(False)
            filled = ax.contourf(u, v, z, levels=levels, cmap=SHADES, norm=norm)
            ax.contour(u, v, z, levels=levels, colors="white", linewidths=0.5)
            _forbid(ax, of, x, y, u, v, limits)
            ax.set_xlabel(across.label)
            ax.set_ylabel(up.label if i == 0 else "")
            ax.tick_params(labelleft=i == 0)
            ax.xaxis.set_major_locator(MaxNLocator(4 if others else 6))
            if others:
                label = ", ".join(f"{dim} {_scale(found[dim]).value(value)}" for dim, value in zip(others, values, strict=True))
                ax.set_title(label, loc="left", fontsize=9.5, color=INK, pad=6)
        place = row[-1].get_position()
        width = figure.get_figwidth()
        bar = figure.add_axes((place.x1 + 0.14 / width, place.y0, 0.13 / width, place.height))
        colours = figure.colorbar(filled, cax=bar)
        colours.outline.set_visible(False)
        bar.tick_params(length=0, labelsize=8.5, labelcolor=SOFT)
        bar.set_title(told.unit, fontsize=8.5, color=SOFT, pad=7, loc="left")
    _legend_of(figure, found, limits)
    _title(figure, found, ", ".join(_scale(found[name]).label for name in names))
    return figure


def _some(values: Sequence[Any]) -> list[Any]:
    """Return all of a few values, or some of many, the ends among them."""
    if len(values) <= MOST_PANELS:
        return list(values)
    return [values[round(i * (len(values) - 1) / (MOST_PANELS - 1))] for i in range(MOST_PANELS)]


def _forbid(ax: Axes, of: xr.Dataset, x: str, y: str, u: Array, v: Array, limits: Sequence[Constraint]) -> None:
    """Draw the line of each constraint, and make pale what is beyond."""
    for i, limit in enumerate(limits):
        beyond = limit.excess(of).transpose(y, x).to_numpy()
        if np.nanmax(beyond) <= 0:
            continue
        ax.contourf(u, v, beyond, levels=[0.0, np.inf], colors=["white"], alpha=0.62)
        if np.nanmin(beyond) < 0:
            ax.contour(u, v, beyond, levels=[0.0], colors=[_LIMITS[i % len(_LIMITS)]], linewidths=1.8)


_LIMITS = ("#D55E00", "#CC79A7", "#E69F00", "#222222")
_SIGNS = {"<=": "\u2264", ">=": "\u2265"}


def _legend_of(figure: Figure, found: xr.Dataset, limits: Sequence[Constraint]) -> None:
    if not limits:
        return
    lines = [Line2D([], [], color=_LIMITS[i % len(_LIMITS)], lw=1.8) for i in range(len(limits))]
    met = ["" if float(limit.excess(found).max()) > 0 else ", met everywhere" for limit in limits]
    labels = [_said(found, limit, _SIGNS) + more for limit, more in zip(limits, met, strict=True)]
    place = _LEFT / figure.get_figwidth(), 1 - 0.7 / figure.get_figheight()
    figure.legend(
        lines, labels, loc="upper left", bbox_to_anchor=place, frameon=False, fontsize=8.5, labelcolor=SOFT, handlelength=1.4, ncols=2,
        borderaxespad=0, borderpad=0,
    )  # fmt: skip


def _tornado(found: xr.Dataset, names: Sequence[str], limits: Sequence[Constraint]) -> Figure:
    rows = len(axes_of(found))
    figure, axes = _grid(len(names), panel=(5.6, 0.38 * rows + 0.2), left=1.9, right=0.6)
    for (ax,), name in zip(axes, names, strict=True):
        told, effects = _scale(found[name]), main_effects(found, name)
        mean = told(float(found[name].mean()))
        span = max((max(abs(told(m) - mean) for m in effect.means) for effect in effects), default=1.0) or 1.0
        for place, effect in enumerate(effects):
            for value, end, colour in zip(effect.means, effect.ends, ("#56B4E9", "#0072B2"), strict=True):
                x = told(value)
                ax.barh(place, x - mean, left=mean, height=0.56, color=colour)
                inside = x < mean or (x == mean and end == effect.ends[0])
                ax.text(
                    x + (-0.02 if inside else 0.02) * span, place, _scale(found[effect.axis]).value(end), ha="right" if inside else "left",
                    va="center_baseline", fontsize=8, color=SOFT,
                )  # fmt: skip
        ax.axvline(mean, color=LINE, lw=0.8)
        ax.set_yticks(range(len(effects)), [effect.axis for effect in effects])
        ax.set_ylim(len(effects) - 0.45, -0.55)
        ax.set_xlim(mean - 1.3 * span, mean + 1.3 * span)
        ax.grid(False)
        ax.grid(axis="x", color="#ececec", lw=0.7)
        ax.spines["left"].set_visible(False)
        ax.set_xlabel(told.label)
    _title(figure, found, "main effects: the mean at the low and at the high end of each axis", left=0.35)
    return figure


def _indices(found: xr.Dataset, names: Sequence[str], limits: Sequence[Constraint]) -> Figure:
    rows = len(axes_of(found))
    figure, axes = _grid(len(names), panel=(5.6, 0.46 * rows + 0.2), left=1.9, right=0.6)
    for (ax,), name in zip(axes, names, strict=True):
        found_indices = sobol_indices(found, name)
        for place, index in enumerate(found_indices):
            bars = ((index.first, index.first_bounds, "#0072B2", -0.17), (index.total, index.total_bounds, "#9fcbe6", 0.17))
            for value, (low, high), colour, off in bars:
                ax.barh(place + off, max(value, 0.0), height=0.3, color=colour)
                ax.plot([max(low, 0.0), max(high, 0.0)], [place + off] * 2, color=INK, lw=0.9, solid_capstyle="butt")
        ax.set_yticks(range(len(found_indices)), [index.axis for index in found_indices])
        ax.set_ylim(len(found_indices) - 0.45, -0.55)
        ax.set_xlim(0, 1.02)
        ax.grid(False)
        ax.grid(axis="x", color="#ececec", lw=0.7)
        ax.spines["left"].set_visible(False)
        ax.set_xlabel(f"share of the variance of {_scale(found[name]).name}")
        handles = [Line2D([], [], color=colour, lw=6, solid_capstyle="butt") for colour in ("#0072B2", "#9fcbe6")]
        if name != names[0]:
            continue
        ax.legend(
            handles, ["alone", "with all it acts together with"], loc="lower left", bbox_to_anchor=(0, 1.0), ncols=2, frameon=False,
            fontsize=8.5, labelcolor=SOFT, handlelength=1.0, borderaxespad=0.1, columnspacing=1.5,
        )  # fmt: skip
    _title(figure, found, "Sobol's indices, with their 95 % confidence", left=0.35)
    return figure


_DRAWN: Mapping[str, Callable[[Any, Sequence[str], Sequence[Constraint]], Figure]] = {
    "lines": _lines, "contours": _contours, "slices": _contours, "tornado": _tornado, "indices": _indices,
}  # fmt: skip
