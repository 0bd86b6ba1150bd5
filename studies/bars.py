"""A picture of numbers of several runs: a small bar chart for each number."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
from matplotlib.lines import Line2D

from halfshaft.cosim.plot import COLOURS, INK, LINE, SOFT, STYLE, Picture, plot_problems
from halfshaft.library.base.errors import InputError
from halfshaft.library.files.writing import written_whole

#: Width of the picture, room at its edges, height of a bar and of a title with the room around it, of the head and a line in it [in].
_WIDTH, _EDGE, _BAR, _TITLE, _HEAD, _LINE = 8.2, 0.35, 0.17, 0.5, 0.55, 0.22
_COLUMNS = 3


def plot_bars(rows: Sequence[tuple[str, Sequence[float | None]]], labels: Sequence[str], *, path: str | Path | None = None) -> Picture:
    """Draw bars.

    Parameters
    ----------
    rows
        For each number its title, and its value for each run; None where there is none.
    labels
        Names of the runs.
    path
        A PNG, SVG or PDF file to write, whole or not at all.

    Raises
    ------
    InputError
        If there are too many runs to tell apart, or the file cannot be written.

    """
    problems = plot_problems(Path(path)) if path is not None else []
    if len(labels) > len(COLOURS):
        problems.append(f"{len(labels)} runs, at most {len(COLOURS)} can be told apart")
    if problems:
        raise InputError(str(path) if path is not None else "plot", problems)
    each, head = _TITLE + _BAR * len(labels), _HEAD + _LINE * len(labels)
    high = head + each * -(-len(rows) // _COLUMNS)
    room = (_WIDTH - 2 * _EDGE) / _COLUMNS
    with mpl.rc_context(STYLE):
        figure = Picture(figsize=(_WIDTH, high))
        figure.text(_EDGE / _WIDTH, 1 - 0.34 / high, f"{len(labels)} runs", fontsize=14, fontweight="bold", va="baseline")
        for i, label in enumerate(labels):
            y = 1 - (0.6 + _LINE * i) / high
            figure.add_artist(Line2D([_EDGE / _WIDTH, (_EDGE + 0.2) / _WIDTH], [y + 0.045 / high] * 2, color=COLOURS[i], lw=5))
            figure.text((_EDGE + 0.32) / _WIDTH, y, label, va="baseline")
        for i, (title, values) in enumerate(rows):
            line, column = divmod(i, _COLUMNS)
            left, bottom = _EDGE + column * room, high - head - (line + 1) * each + 0.1
            ax = figure.add_axes((left / _WIDTH, bottom / high, (room - 0.8) / _WIDTH, (each - _TITLE) / high))
            known = [0.0 if x is None else float(x) for x in values]
            places = range(len(labels))
            ax.barh(places, known, color=COLOURS[: len(labels)], height=0.76)
            low, top = min(0.0, *known), max(0.0, *known)
            span = (top - low) or 1.0
            ax.set_xlim(low, low + span)
            ax.set_ylim(len(labels) - 0.45, -0.55)
            for place, x, given in zip(places, known, values, strict=True):
                told = "\u2013" if given is None else f"{x:.4g}".replace("-", "\u2212")
                ax.text(max(x, 0.0) + 0.03 * span, place, told, va="center_baseline", fontsize=8, color=SOFT, clip_on=False)
            ax.axvline(0, color=LINE, lw=0.7)
            ax.tick_params(left=False, bottom=False, labelleft=False, labelbottom=False)
            ax.spines[:].set_visible(False)
            ax.set_title(title, loc="left", fontsize=9, color=INK, pad=4)
        if path is not None:
            with written_whole(path) as part:
                figure.savefig(part, dpi=200, facecolor="white")
    return figure
