"""Pictures of a sizing: how goal, limits and variables went, vehicle by vehicle; and of a front."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from halfshaft.cosim.plot import COLOURS, INK, LINE, SOFT, Picture, drawing, dress
from halfshaft.studies.sizing.evaluator import ROUNDING

if TYPE_CHECKING:
    from halfshaft.studies.sizing.optimum import Optimum
    from halfshaft.studies.sizing.pareto import Front

#: Width of a picture, and room left and right of the axes [in].
_WIDTH, _LEFT, _RIGHT = 8.2, 0.95, 2.15
#: Heights of the panels, and the room between [in].
_HEIGHTS, _ROOM = (1.9, 1.4, 1.7), 0.22
#: Excesses between which the axis is drawn [%].
_LEAST, _MOST = 1e-3, 1e3
_STAGES = {"ipopt": "IPOPT", "exact": "exact step", "evolution": "evolution", "limits": "limits"}


def plot_optimum(optimum: Optimum, *, path: str | Path | None = None) -> Picture:
    """Draw how a sizing went.

    Parameters
    ----------
    optimum
        What was found.
    path
        A PNG, SVG or PDF file to write, whole or not at all.

    Raises
    ------
    InputError
        If the file cannot be written.

    """
    head, foot = 0.95, 0.6
    height = head + sum(_HEIGHTS) + _ROOM * (len(_HEIGHTS) - 1) + foot
    said = [optimum.method, f"{optimum.effort.cycles} evaluations of the cycle", "every limit holds" if optimum.holds else optimum.status]
    with drawing(path, (_WIDTH, height), _LEFT, optimum.problem.title or optimum.problem.name, said) as figure:
        y, axes = height - head + _ROOM, []
        for high in _HEIGHTS:
            y -= high + _ROOM
            axes.append(figure.add_axes((_LEFT / _WIDTH, y / height, (_WIDTH - _LEFT - _RIGHT) / _WIDTH, high / height)))
        stages, goals, excesses, points = _history(optimum)
        for ax in axes:
            dress(ax)
            _bands(ax, stages, named=ax is axes[0])
            ax.set_xlim(-0.8, len(stages) - 0.2)
            ax.xaxis.set_major_locator(MaxNLocator(8, integer=True))
        for ax in axes[:-1]:
            ax.tick_params(labelbottom=False)
        holds = excesses <= ROUNDING
        _goals(axes[0], optimum, goals, holds, np.array([stage != "ipopt" for stage in stages]))
        _excesses(axes[1], optimum, excesses)
        _variables(axes[2], optimum, points)
    return figure


def _history(optimum: Optimum) -> tuple[list[str], np.ndarray, np.ndarray, np.ndarray]:
    """Return stage, goal, largest excess and scaled point, of the iterations of IPOPT and of all vehicles as they would be built."""
    low, span = (np.array(x) for x in zip(*((v.low, (v.high - v.low) or 1.0) for v in optimum.bound.variables), strict=True))
    rows = [("ipopt", i.goal, i.worst, i.u) for run in optimum.runs for i in run.iterates]
    rows += [(t.stage, t.goal, t.worst, (t.x - low) / span) for t in optimum.tried if t.stage != "ipopt"]
    rows.sort(key=lambda row: ("start", "limits", "ipopt", "exact", "evolution", "again").index(row[0]))
    return [r[0] for r in rows], *(np.array([r[i] for r in rows]) for i in (1, 2, 3))  # type: ignore[return-value]


def _bands(ax: Axes, stages: list[str], *, named: bool) -> None:
    """Tint who was at work, and say it above."""
    above = ax.get_xaxis_transform()
    for stage, group in groupby(enumerate(stages), key=lambda x: x[1]):
        places = [i for i, _ in group]
        if stage in _STAGES:
            ax.axvspan(places[0] - 0.5, places[-1] + 0.5, color=COLOURS[list(_STAGES).index(stage)], alpha=0.07, lw=0)
            if named and len(places) > len(stages) / 8:
                ax.text(places[0] - 0.3, 1.02, _STAGES[stage], transform=above, va="bottom", fontsize=8, color=SOFT)


def _goals(ax: Axes, optimum: Optimum, goals: np.ndarray, holds: np.ndarray, built: np.ndarray) -> None:
    x = np.arange(len(goals))
    many = len(goals) > 400
    for which, colour, label in ((~holds, LINE, "a limit is missed"), (holds, COLOURS[2], "every limit holds")):
        ax.plot(x[which], goals[which], ls="", marker=".", ms=2 if many else 5, color=colour, label=label)
    # What is relaxed may be better than what can be built.
    best = np.fmin.accumulate(np.where(holds & built, goals, np.nan))
    ax.plot(x, best, color=COLOURS[2], lw=0.9, drawstyle="steps-post")
    ax.axhline(optimum.goal, color=COLOURS[2], lw=0.7, ls=":")
    known = goals[np.isfinite(goals)]
    if len(known):
        low, high = min(np.min(known), optimum.goal), np.quantile(known, 0.98)
        ax.set_ylim(low - 0.08 * (high - low), high + 0.08 * (high - low) or 1.0)
    unit = f" [{optimum.bound.goal_unit}]" if optimum.bound.goal_unit else ""
    ax.set_ylabel((optimum.problem.minimise if len(optimum.problem.minimise) < 20 else "goal") + unit)
    beside = ax.get_yaxis_transform()
    ax.text(
        1.02,
        optimum.goal,
        f"{optimum.goal:.5g}{unit[2:-1] and ' ' + unit[2:-1]}",
        transform=beside,
        va="center",
        color=COLOURS[2],
        fontweight="bold",
    )
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.05), frameon=False, fontsize=7.5, handlelength=1.0)


def _excesses(ax: Axes, optimum: Optimum, excesses: np.ndarray) -> None:
    shown = np.clip(100 * np.where(np.isfinite(excesses), excesses, 1e9), _LEAST, _MOST)
    ax.plot(shown, color=COLOURS[1], lw=0.7, marker=".", ms=2.5)
    ax.set_yscale("log")
    ax.set_ylim(0.6 * _LEAST, 1.6 * _MOST)
    ax.set_yticks([1e-3, 1e-1, 1e1, 1e3], ["none", "0.1", "10", "never"])
    ax.minorticks_off()
    ax.set_ylabel("largest miss\nof a limit [%]")
    lines = []
    for f in optimum.limits:
        lines.append((f"{f.limit.title} {f.limit.wanted}", INK if f.holds else COLOURS[1]))
        lines.append((f"   {f.limit.shown(f.after)}" + (f", {f.said}" if f.said else ""), SOFT if f.holds else COLOURS[1]))
    for i, (text, colour) in enumerate(lines[:12]):
        ax.text(1.02, 1.0 - 0.125 * i, text, transform=ax.transAxes, va="top", fontsize=7.2, color=colour)


def _variables(ax: Axes, optimum: Optimum, points: np.ndarray) -> None:
    for i, found in enumerate(optimum.variables):
        v = found.variable
        label = f"{v.name}: {v.shown(found.after)}\n{v.shown(v.low)} to {v.shown(v.high)}"
        ax.plot(points[:, i], color=COLOURS[i % len(COLOURS)], lw=0.9, marker=".", ms=2.5, label=label)
    ax.set_ylim(-0.05, 1.05)
    ax.set_yticks([0, 0.5, 1], ["lower", "", "upper"])
    ax.set_ylabel("between\nthe bounds")
    ax.set_xlabel("vehicle")
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.05), frameon=False, fontsize=7.5, handlelength=1.2)


def plot_front(front: Front, *, path: str | Path | None = None) -> Picture:
    """Draw a front: goal and variables over the target of the limit.

    Parameters
    ----------
    front
        What was found.
    path
        A PNG, SVG or PDF file to write, whole or not at all.

    Raises
    ------
    InputError
        If the file cannot be written.

    """
    height, limit, problem = 4.6, front.limit, front.found[0].problem
    x = np.array(front.targets) / limit.factor
    holds = np.array([o.holds for o in front.found])
    said = [f"over {limit.title}", f"{len(x)} vehicles"]
    with drawing(path, (_WIDTH, height), _LEFT, problem.title or problem.name, said) as figure:
        axes = [figure.add_axes((_LEFT / _WIDTH, y / height, (_WIDTH - _LEFT - _RIGHT) / _WIDTH, 1.45 / height)) for y in (2.25, 0.6)]
        for ax in axes:
            dress(ax)
        goals = np.array([o.goal for o in front.found])
        axes[0].plot(x[holds], goals[holds], color=COLOURS[2], lw=1.1, marker="o", ms=4)
        axes[0].plot(x[~holds], goals[~holds], ls="", marker="x", color=COLOURS[1], label="not met")
        unit = front.found[0].bound.goal_unit
        axes[0].set_ylabel((problem.minimise if len(problem.minimise) < 20 else "goal") + (f" [{unit}]" if unit else ""))
        axes[0].tick_params(labelbottom=False)
        for i, v in enumerate(front.found[0].bound.variables):
            values = np.array([o.variables[i].after for o in front.found])
            ends = f"{v.shown(float(values[0]))} to {v.shown(float(values[-1]))}"
            axes[1].plot(
                x[holds],
                ((values - v.low) / ((v.high - v.low) or 1.0))[holds],
                color=COLOURS[i % len(COLOURS)],
                lw=1.1,
                marker="o",
                ms=3.5,
                label=f"{v.name}\n{ends}",
            )
        axes[1].set_ylim(-0.05, 1.05)
        axes[1].set_yticks([0, 0.5, 1], ["lower", "", "upper"])
        axes[1].set_ylabel("between\nthe bounds")
        axes[1].set_xlabel(f"{limit.title} [{limit.unit}]" if limit.unit else limit.title)
        axes[1].legend(loc="upper left", bbox_to_anchor=(1.0, 1.05), frameon=False, fontsize=7.5, handlelength=1.2)
    return figure
