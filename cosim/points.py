"""Pictures of operating points: where a run had its machines, on the efficiency that their maps give."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from halfshaft.cosim.compiled import Array
from halfshaft.cosim.plot import COLOURS, INK, LINE, SOFT, STYLE, Picture, dress, labels_of, plot_problems
from halfshaft.cosim.result import Result
from halfshaft.cosim.units import Units, edge
from halfshaft.library.base.errors import InputError, nearest
from halfshaft.library.base.parameters import Parameters, spec_of
from halfshaft.library.base.ports import SHOWN
from halfshaft.library.base.tables import Table
from halfshaft.library.files.writing import written_whole

#: Points of the grid that an efficiency is drawn on, along each axis.
_FINE = 160
#: Lines of equal efficiency.
_LEVELS = (
    0.05,
    0.1,
    0.15,
    0.2,
    0.25,
    0.28,
    0.3,
    0.32,
    0.34,
    0.36,
    0.38,
    0.4,
    0.45,
    0.5,
    0.6,
    0.7,
    0.75,
    0.8,
    0.84,
    0.88,
    0.9,
    0.92,
    0.94,
    0.96,
)
#: Width and height of a panel, height of the head and of a line of it [in].
_WIDTH, _HEIGHT, _HEAD, _LINE = 4.3, 3.3, 0.62, 0.22
_RPM = 60 / (2 * np.pi)
#: Of the runs, beside their colours.
_MARKERS = "os^Dv<>"


class _Machine(NamedTuple):
    """The map of a part: speed [rad/s], torque [N m], efficiency on their grid, and the envelopes over the speed."""

    part: str
    title: str
    omega: Array
    tau: Array
    efficiency: Array
    envelopes: tuple[tuple[Array, Array], ...]
    key: Any


def plot_points(
    *results: Result,
    parts: Sequence[str] | None = None,
    labels: Sequence[str] | None = None,
    units: Units = "metric",
    path: str | Path | None = None,
) -> Picture:
    """Draw the operating points of machines on their maps.

    Runs whose part has the same map share a panel.

    Parameters
    ----------
    results
        The runs.
    parts
        Which parts; without it, all that have a map of power or fuel over speed and torque.
    labels
        Names of the runs; without them, what tells the runs apart.
    units
        Of the torque.
    path
        A PNG, SVG or PDF file to write, whole or not at all.

    Raises
    ------
    InputError
        If a run kept no time series or has no such part, or the file cannot be written.

    """
    problems = plot_problems(Path(path)) if path is not None else []
    problems += ["there is no run to draw"] if not results else []
    problems += ["a run has no time series to draw"] if not all(r.has_history and len(r.time) for r in results) else []
    if len(results) > len(COLOURS):
        problems.append(f"{len(results)} runs, at most {len(COLOURS)} can be told apart")
    where = str(path) if path is not None else "plot"
    if problems:
        raise InputError(where, problems)
    panels: dict[Any, list[tuple[int, _Machine]]] = {}
    known: dict[str, None] = {}
    for i, result in enumerate(results):
        for machine in _machines(result):
            known[machine.part] = None
            if parts is None or machine.part in parts:
                panels.setdefault(machine.key, []).append((i, machine))
    problems = [f"no part {part} has a map over speed and torque{nearest(part, known)}" for part in parts or () if part not in known]
    problems += ["no part has a map over speed and torque"] if not known else []
    if problems:
        raise InputError(where, problems)
    named = labels or labels_of(results)
    columns = min(2, len(panels))
    rows = -(-len(panels) // columns)
    head = _HEAD + (_LINE * len(results) if len(results) > 1 else 0.0)
    wide, high = _WIDTH * max(columns, 1.4), _HEIGHT * rows + head
    with mpl.rc_context(STYLE):
        figure = Picture(figsize=(wide, high), layout="constrained")
        figure.get_layout_engine().set(rect=(0, 0, 1, 1 - head / high))  # type: ignore[union-attr,call-arg]
        one = results[0].inputs if len(results) == 1 else None
        title = one.vehicle if one else f"{len(results)} runs"
        figure.text(0.3 / wide, 1 - 0.34 / high, title, fontsize=14, fontweight="bold", va="baseline")
        aside = f"over {one.cycle}, torque and speed of each step" if one else "torque and speed of each step"
        figure.text(1 - 0.3 / wide, 1 - 0.34 / high, aside, fontsize=9.5, ha="right", va="baseline", color=SOFT)
        for i, label in enumerate(named if len(results) > 1 else ()):
            y = 1 - (0.6 + _LINE * i) / high
            figure.add_artist(Line2D([0.36 / wide], [y + 0.04 / high], marker=_MARKERS[i], ms=5, color=COLOURS[i], lw=0))
            figure.text(0.5 / wide, y, label, va="baseline")
        grid = np.atleast_1d(np.asarray(figure.subplots(rows, columns))).ravel()
        for ax, shared in zip(grid, panels.values(), strict=False):
            dress(ax)
            _draw(ax, shared, results, units)
        for ax in grid[len(panels) :]:
            ax.set_axis_off()
        if path is not None:
            with written_whole(path) as part:
                figure.savefig(part, dpi=200, facecolor="white")
    return figure


def points(result: Result, part: str) -> tuple[Array, Array]:
    """Return speed [rad/s] and torque [N m] of a machine in each step: its own, or those of its source."""
    outputs = {d.name for d in result.outputs}
    found = []
    for tag, field in (("engine speed", "omega"), ("engine torque", "tau")):
        own = result.tags.by_part(tag).get(part)  # type: ignore[arg-type]
        names = [own or f"{part}.{field}"]
        model = result.vehicle.model()
        names += [
            f"{c.supply}.{field}{model.suffixes(c)[1]}" for c in model.connections if c.load == part and field in SHOWN[c.supply_port.kind]
        ]
        there = [name for name in names if name in outputs]
        if not there:
            raise InputError("result", [f"{part} has no {field} among its outputs"])
        found.append(result[there[0]])
    return found[0], found[1]


def _machines(result: Result) -> list[_Machine]:
    """Return the parts with a map of electric power or fuel over speed and torque, with their factors on it."""
    found = []
    for part, p in result.vehicle.parameters.items():
        tables = {f.name: (spec_of(f), getattr(p, f.name)) for f in fields(p) if isinstance(getattr(p, f.name), Table)}
        axes = {name: tuple(a.unit for a in spec.axes) for name, (spec, _) in tables.items()}
        maps = [name for name, (spec, _) in tables.items() if axes[name] == ("rad/s", "N.m") and spec.unit in ("W", "kg/s")]
        lines = [name for name, (spec, _) in tables.items() if axes[name] == ("rad/s",) and spec.unit == "N.m"]
        if not maps:
            continue
        table, (speed, torque, share) = tables[maps[0]][1], (getattr(p, f"{x}_scale", 1.0) for x in ("speed", "torque", "efficiency"))
        envelopes = tuple((tables[name][1].points[0] * speed, tables[name][1].values * torque) for name in lines)
        key = (part, table.key, speed, torque, share, *(tables[name][1].key for name in lines))
        omega, tau = (np.linspace(x[0], x[-1], _FINE) for x in table.points)
        efficiency = _efficiency(p, table, omega, tau, share)
        over = getattr(p, "overtorque", 1.0)
        bounds = [over * np.interp(omega, tables[name][1].points[0], tables[name][1].values) for name in lines]
        outside = np.zeros_like(efficiency, dtype=bool)
        for bound in bounds:
            # An upper envelope is positive, a lower one negative.
            outside |= np.where(bound[:, None] > 0, tau > bound[:, None], (bound[:, None] < 0) & (tau < bound[:, None]))
        efficiency = np.where(outside, np.nan, efficiency)
        found.append(_Machine(part, result.vehicle.parts[part].name, omega * speed, tau * torque, efficiency, envelopes, key))
    return found


def _efficiency(p: Parameters, table: Table, omega: Array, tau: Array, share: float) -> Array:
    """Return the efficiency on a grid: of fuel, or of the one of two powers over the other."""
    from scipy.interpolate import RegularGridInterpolator  # scipy takes a quarter of a second

    value = RegularGridInterpolator(table.points, table.values)(np.stack(np.meshgrid(omega, tau, indexing="ij"), axis=-1))
    work = np.outer(omega, tau)
    heating = next((getattr(p, f.name) for f in fields(p) if spec_of(f).tag == "fuel heating value"), None)
    power = value if heating is None else np.where(work > 0, value * heating, np.nan)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(work * power > 0, work / power, np.nan)
        found: Array = share * np.where(ratio > 1, 1 / ratio, ratio)
    return found


def _draw(ax: Axes, shared: Sequence[tuple[int, _Machine]], results: Sequence[Result], units: Units) -> None:
    machine, (unit, factor, _) = shared[0][1], edge("N.m", units)
    ax.grid(False)
    x, y = machine.omega * _RPM, machine.tau * factor
    best = float(np.nanmax(machine.efficiency)) if np.isfinite(machine.efficiency).any() else 1.0
    levels = [level for level in _LEVELS if level < best]
    ax.contourf(x, y, machine.efficiency.T, levels=[0, *levels[-9:], max(best, levels[-1] + 1e-6)], cmap="Blues", vmin=0, vmax=2.8 * best)
    lines = ax.contour(x, y, machine.efficiency.T, levels=levels[-9:], colors="#5b7f9c", linewidths=0.6)
    # Those of low efficiency lie close together.
    ax.clabel(lines, levels[-5:], fmt=lambda level: f"{100 * level:.0f}", fontsize=7, colors="#3f5f78")
    for speeds, torques in machine.envelopes:
        ax.plot(speeds * _RPM, torques * factor, color=INK, lw=1.2)
    for i, _ in shared:
        omega, tau = points(results[i], machine.part)
        moves = (np.abs(tau) > 1e-9) & (omega > 1e-6)
        colour = COLOURS[i] if len(results) > 1 else COLOURS[1]
        ax.plot(omega[moves] * _RPM, tau[moves] * factor, _MARKERS[i], color=colour, ms=3.0, alpha=0.5, mew=0)
    ax.axhline(0, color=LINE, lw=0.7)
    ax.set_xlim(max(0.0, x[0]), x[-1])
    ax.set_title(f"{machine.part.replace('_', ' ')}: {machine.title}, efficiency in %", loc="left", fontsize=9, color=INK)
    ax.set_xlabel("speed [1/min]")
    ax.set_ylabel(f"torque [{unit}]".replace("N.m", "N m"))
