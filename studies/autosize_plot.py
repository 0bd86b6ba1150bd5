"""Picture of a sizing: how the sizes went, trial by trial, and how far each goal was from its target."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from halfshaft.cosim.plot import COLOURS, LINE, SOFT, Picture, drawing, dress
from halfshaft.studies.sizes import KINDS, NAMED, Kind

if TYPE_CHECKING:
    from halfshaft.studies.autosize import Sized

#: Width of the picture, and room left and right of the axes [in].
_WIDTH, _LEFT, _RIGHT = 8.2, 0.85, 1.85
#: Heights of the panel of a size and of that of the goals, and room between panels [in].
_SIZE, _GOALS, _ROOM = 1.0, 2.2, 0.22
#: Margins beyond this are drawn at the edge [%].
_MOST = 60.0
_TINTS: dict[Kind, str] = {"source": COLOURS[1], "store": COLOURS[0], "drive": COLOURS[2]}


def plot_sizes(sized: Sized, *, path: str | Path | None = None) -> Picture:
    """Draw a sizing.

    Parameters
    ----------
    sized
        What was found.
    path
        A PNG, SVG or PDF file to write, whole or not at all.

    Raises
    ------
    InputError
        If the file cannot be written.

    """
    kinds = [kind for kind in KINDS if kind in sized.after]
    heights = [*[_SIZE] * len(kinds), _GOALS]
    height = 0.95 + sum(heights) + _ROOM * len(kinds) + 0.6
    mass = f"{sized.base.mass:.0f} to {sized.vehicle.mass:.0f} kg"
    said = [f"preset {sized.preset}", f"{len(sized.trials)} trials", mass, sized.status]
    with drawing(path, (_WIDTH, height), _LEFT, sized.base.name, said) as figure:
        y, axes = height - 0.95 + _ROOM, []
        for high in heights:
            y -= high + _ROOM
            axes.append(figure.add_axes((_LEFT / _WIDTH, y / height, (_WIDTH - _LEFT - _RIGHT) / _WIDTH, high / height)))
        for ax in axes:
            dress(ax)
            _bands(ax, sized)
            ax.set_xlim(-0.8, len(sized.trials) - 0.2)
            ax.xaxis.set_major_locator(MaxNLocator(8, integer=True))
        for ax, kind in zip(axes, kinds, strict=False):
            _size(ax, sized, kind)
            ax.tick_params(labelbottom=False)
        _margins(axes[-1], sized)
    return figure


def _bands(ax: Axes, sized: Sized) -> None:
    """Tint what was being sized."""
    numbered = enumerate(trial.aim.partition(" ")[0] for trial in sized.trials)
    for kind, group in groupby(numbered, key=lambda x: x[1]):
        first, *_, last = [i for i, _ in group] * 2
        if kind in KINDS:
            ax.axvspan(first - 0.5, last + 0.5, color=_TINTS[kind], alpha=0.07, lw=0)


def _size(ax: Axes, sized: Sized, kind: Kind) -> None:
    name, unit, factor, digits = NAMED[kind]
    values = np.array([trial.sizes[kind] / factor for trial in sized.trials])
    ax.plot(values, color=_TINTS[kind], lw=1.1, drawstyle="steps-mid")
    after = sized.after[kind] / factor
    ax.axhline(after, color=_TINTS[kind], lw=0.7, ls=":")
    ax.set_ylabel(f"{name} [{unit}]" if unit != "modules" else f"{name}\n[{unit}]")
    ax.set_ylim(0, 1.12 * values.max())
    ax.yaxis.set_major_locator(MaxNLocator(3))
    said = f"{after:.{digits}f} {unit}"
    beside = ax.get_yaxis_transform()
    ax.text(1.02, after, said, transform=beside, va="bottom", color=_TINTS[kind], fontweight="bold")
    ax.text(1.02, after, _wrapped(sized.binds[kind]), transform=beside, va="top", color=SOFT, fontsize=7)


def _wrapped(text: str) -> str:
    """Return a list one entry a line, so that it fits beside the axes; what does not is counted."""
    lines = [entry.partition(" [")[0] for entry in text.split(", ")]
    return "\n".join(lines if len(lines) <= 3 else [*lines[:2], f"and {len(lines) - 2} more"])


def _margins(ax: Axes, sized: Sized) -> None:
    """Draw by how much each goal is met, where it was looked at."""
    for i, reached in enumerate(sized.goals):
        title, colour = reached.goal.title, COLOURS[i % len(COLOURS)]
        # The line breaks where the goal was not looked at.
        margins = np.clip([100 * trial.margins.get(title, np.nan) for trial in sized.trials], -_MOST, _MOST)
        name, _, unit = title.removesuffix("]").partition(" [")
        label = f"{name}: {reached.goal.shown(reached.after)} {unit}" + ("" if reached.met else ", not met")
        ax.plot(margins, color=colour, lw=0.9, marker=".", ms=3.5, label=label)
    ax.axhline(0, color=LINE, lw=1.2)
    ax.set_ylim(-1.08 * _MOST, 1.08 * _MOST)
    ax.set_xlabel("trial")
    ax.set_ylabel("better than the target [%]")
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.03), frameon=False, fontsize=7.5, handlelength=1.2)
