"""Pictures of runs: speed, grade, powers, charge, gear, and where the energy went; several runs over each other.

Each picture is a column of panels.  Which powers there are, and what is stored or shifted, follows from the outputs of
the run: their bookings, kinds and units.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Text
from matplotlib.ticker import AutoMinorLocator, MaxNLocator

from halfshaft.cosim.compiled import Array
from halfshaft.cosim.result import Result
from halfshaft.cosim.units import Units, edge, shown
from halfshaft.library.base.errors import InputError, nearest
from halfshaft.library.base.tags import part_of
from halfshaft.library.files.writing import source_date, written_whole

#: Formats by the ending of the file.
FORMATS = ("png", "svg", "pdf")

# The palette of Okabe and Ito, which colour-blind readers tell apart.
_BLUE, _ORANGE, _GREEN, _RED = "#0072B2", "#E69F00", "#009E73", "#D55E00"
#: Colours of runs over each other; more runs than these are not told apart.
COLOURS = (_BLUE, _RED, _GREEN, _ORANGE, "#CC79A7", "#56B4E9", "#222222")
INK, SOFT, LINE, _FAINT = "#222222", "#6b6b6b", "#9a9a9a", "#e3e3e3"
STYLE: Any = {
    "font.family": "sans-serif", "font.sans-serif": ["Inter", "Helvetica Neue", "Arial", "Liberation Sans", "DejaVu Sans"],
    "font.size": 9.0, "text.color": INK, "lines.solid_joinstyle": "round", "lines.solid_capstyle": "round",
    "axes.unicode_minus": True, "svg.fonttype": "none", "pdf.fonttype": 42,
}  # fmt: skip
#: Units of the time axis by the length that they are good for [s].
TIMES = ((1800.0, "s", 1.0), (3 * 3600.0, "min", 60.0), (float("inf"), "h", 3600.0))
_KINDS = {"lost": _ORANGE, "stored": _BLUE, "error of the method": "#a6a6a6"}
#: Losses below this share of the turnover are summed up; other lines below that one are left out.
_SMALL, _TINY = 0.005, 5e-4
#: Width of a picture, and room left of the axes over time and right of all [in].
_WIDTH, _LEFT, _RIGHT = 8.2, 0.72, 0.3


class Picture(Figure):
    """A figure that a notebook shows by itself, without pyplot."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png", dpi=100, facecolor="white")
        return buffer.getvalue()


def plot_run(
    result: Result,
    *others: Result,
    panels: str | Sequence[str] | None = None,
    labels: Sequence[str] | None = None,
    axes: Axes | Sequence[Axes] | None = None,
    units: Units = "metric",
    path: str | Path | None = None,
) -> Figure:
    """Draw a run, or several over each other.

    Parameters
    ----------
    result, others
        What is drawn.
    panels
        From top to bottom: ``speed``, ``grade``, ``power``, ``charge``, ``gear``, ``energy``, or the name of any output, such
        as ``battery.T``; without it, all that the runs have.
    labels
        Names of the runs; without them, what tells the runs apart.
    axes
        Axes of your own to draw into, one for each panel; only what is drawn is added to them, no style.
    units
        Of the axes and of the numbers in the head.
    path
        A PNG, SVG or PDF file to write, whole or not at all.

    Returns
    -------
    matplotlib.figure.Figure
        The figure; no window system is touched.

    Raises
    ------
    InputError
        If a run has no time series, something is asked for that it does not have, or the file cannot be written.

    """
    results = (result, *others)
    problems = plot_problems(Path(path)) if path is not None else []
    if not all(len(r.history) for r in results):
        problems.append("the run has no time series to draw" if not others else "a run has no time series to draw")
    if len(results) > len(COLOURS):
        problems.append(f"{len(results)} runs, at most {len(COLOURS)} can be told apart")
    if labels is not None and len(labels) != len(results):
        problems.append(f"{len(labels)} labels for {len(results)} runs")
    where = str(path) if path is not None else "plot"
    if problems:
        raise InputError(where, problems)
    runs = _Runs(results, tuple(labels or labels_of(results)), units)
    outputs = dict.fromkeys(d.name for r in results for d in r.outputs)
    usual = _panels(runs)
    known = {**{name: _output_panel(runs, name) for name in outputs}, **usual}
    names = list(usual) if panels is None else [panels] if isinstance(panels, str) else list(panels)
    problems = [f"there is no panel '{name}'{nearest(name, known)}" for name in names if name not in known]
    own = None if axes is None else [axes] if isinstance(axes, Axes) else list(axes)
    if own is not None and len(own) != len(names):
        problems.append(f"{len(own)} axes for {len(names)} panels: {', '.join(names)}")
    if problems:
        raise InputError(where, problems)
    drawn = {name: known[name] for name in names}
    with mpl.rc_context(STYLE):
        figure = _figure(runs, drawn) if own is None else _into(drawn, own)
        if path is not None:
            with written_whole(path) as part:
                figure.savefig(part, dpi=200, facecolor="white")
    return figure


@contextmanager
def drawing(path: str | Path | None, size: tuple[float, float], left: float, title: str, said: Sequence[str]) -> Iterator[Picture]:
    """Yield a picture of a size with its head, `left` from the edge [in]; what is drawn is written at the end, whole or not at all.

    Raises
    ------
    InputError
        If the file cannot be written.

    """
    if path is not None and (problems := plot_problems(Path(path))):
        raise InputError(str(path), problems)
    width, height = size
    with mpl.rc_context(STYLE):
        figure = Picture(figsize=size)
        figure.text(left / width, 1 - 0.34 / height, title, fontsize=14, fontweight="bold", va="baseline")
        figure.text(left / width, 1 - 0.57 / height, "   \u00b7   ".join(filter(None, said)), va="baseline", color=SOFT)
        yield figure
        if path is not None:
            with written_whole(path) as part:
                figure.savefig(part, dpi=200, facecolor="white")


def plot_problems(path: Path) -> list[str]:
    """Return what is wrong with the name of a file to draw into."""
    if path.suffix.lower().removeprefix(".") in FORMATS:
        try:
            if path.suffix.lower() != ".png":  # which holds no date
                source_date()
        except InputError as error:
            return [str(error)]
        return []
    return [f"a plot is written as {', '.join(f'.{f}' for f in FORMATS)}, not as '{path.suffix}'"]


class _Panel(NamedTuple):
    """A panel: its height and the room above it [in], and what draws it; `timed` ones share the axis of time."""

    height: float
    above: float
    draw: Callable[[Axes], None]
    timed: bool = True


class _Runs:
    """Runs over each other, and the axis of time that they share."""

    def __init__(self, results: tuple[Result, ...], labels: tuple[str, ...], units: Units) -> None:
        self.results, self.labels, self.units = results, labels, units
        self.one = results[0] if len(results) == 1 else None
        begin, end = min(_start(r) for r in results), max(float(r.time[-1]) for r in results)
        self.unit, self.second = next((unit, 1 / length) for longest, unit, length in TIMES if end - begin <= longest)
        self.limits = begin * self.second, end * self.second

    def coloured(self) -> list[tuple[Result, Array, str, str]]:
        """Return each run with its times, its colour and its label."""
        return [(r, r.time * self.second, c, label) for r, c, label in zip(self.results, COLOURS, self.labels, strict=False)]


def _start(result: Result) -> float:
    return float(result.time[0]) - result.inputs.dt if result.inputs.via != "forward" else min(0.0, float(result.time[0]))


def _method(result: Result) -> str:
    inputs = result.inputs
    return "forward-facing model" if inputs.via == "forward" else f"{inputs.mode} step of {inputs.dt:g} s"


def labels_of(results: Sequence[Result]) -> list[str]:
    """Return what tells runs apart: vehicle, cycle, method; then, of those that are alike, the first two numbers that differ."""
    traits = [(r.inputs.vehicle, r.inputs.cycle, _method(r)) for r in results]
    differing = [i for i in range(3) if len({t[i] for t in traits}) > 1]
    labels = [", ".join(t[i] for i in differing) for t in traits]
    for label in {label for label in labels if labels.count(label) > 1}:
        alike = [i for i, other in enumerate(labels) if other == label]
        sets = {i: results[i].inputs.parameters for i in alike}
        names = [name for name in sets[alike[0]] if len({p.get(name) for p in sets.values()}) > 1][:2]
        for i, p in sets.items():
            labels[i] = ", ".join(filter(None, [label, *(f"{name} = {p[name]:g}" for name in names if name in p)]))
    alike = [labels[: i + 1].count(label) for i, label in enumerate(labels)]
    return [label if labels.count(label) == 1 else f"{label} ({n})".strip() for label, n in zip(labels, alike, strict=True)]


def _parts(results: Sequence[Result], booking: str) -> list[str]:
    """Return the parts whose power is booked so: ``fuel`` finds engines and fuel cells, ``stored`` batteries."""
    return list(dict.fromkeys(part_of(d.name) for r in results for d in r.outputs if d.booking == booking))


def _powers(results: Sequence[Result]) -> list[tuple[str, str, str]]:
    """Return name, label and colour of the powers that tell most: of sources, and into the machine that a store feeds."""
    sources, stores = _parts(results, "fuel"), _parts(results, "stored")
    inputs = dict.fromkeys(name for r in results for name in r.tags.all_of("traction input"))
    found = [(f"{part}.P_out", part, _RED) for part in sources]
    found += [(name, f"{part_of(name)} input", _BLUE) for name in inputs]
    found += [(f"{part}.P_out", part, _GREEN) for part in stores]
    return [(name, label.replace("_", " "), colour) for name, label, colour in found]


def _panels(runs: _Runs) -> dict[str, _Panel]:
    """Return all panels that the runs have."""
    results = runs.results
    panels = {"speed": _Panel(2.2, 0.42, lambda ax: _speed(ax, runs))}
    if any(np.ptp(r.the("elevation")) > 0 for r in results):
        panels["grade"] = _Panel(0.8, 0.3, lambda ax: _grade(ax, runs))
    powers = _powers(results)
    if runs.one:
        panels["power"] = _Panel(1.8, 0.42, lambda ax: _power(ax, runs, powers))
    else:
        panels |= {name: _output_panel(runs, name, label) for name, label, _ in powers}
    if any(r.tags.all_of("charge") for r in results):
        panels["charge"] = _Panel(1.15, 0.3, lambda ax: _charge(ax, runs))
    if any(r.tags.all_of("gear") for r in results):
        panels["gear"] = _Panel(1.15, 0.3, lambda ax: _gear(ax, runs))
    bars = [_bars(r) for r in results]
    lines = len(dict.fromkeys(bar.label for of_run in bars for bar in of_run))
    panels["energy"] = _Panel((0.215 + 0.09 * (len(results) - 1)) * lines + 0.1, 0.95, lambda ax: _energy(ax, runs, bars), timed=False)
    return panels


def _output_panel(runs: _Runs, name: str, label: str = "") -> _Panel:
    return _Panel(1.3, 0.3, lambda ax: _output(ax, runs, name, label or name))


def _into(panels: Mapping[str, _Panel], axes: Sequence[Axes]) -> Figure:
    for ax, panel in zip(axes, panels.values(), strict=True):
        panel.draw(ax)
    figure = axes[0].get_figure(root=True)
    assert figure is not None
    return figure


def _figure(runs: _Runs, panels: Mapping[str, _Panel]) -> Figure:
    head = 0.58 if runs.one else 0.44 + 0.24 * len(runs.results)
    timed = [name for name, panel in panels.items() if panel.timed]
    foot = 0.2 if list(panels)[-1] not in timed else 0.6
    height = head + sum(p.height + p.above for p in panels.values()) + foot
    figure = Picture(figsize=(_WIDTH, height))
    y = height - head
    for name, panel in panels.items():
        y -= panel.height + panel.above
        left = _LEFT if panel.timed else _LEFT + 1.0
        ax = figure.add_axes((left / _WIDTH, y / height, (_WIDTH - left - _RIGHT) / _WIDTH, panel.height / height))
        dress(ax)
        panel.draw(ax)
        if panel.timed:
            ax.set_xlabel(ax.get_xlabel() if name == timed[-1] else "")
            ax.tick_params(labelbottom=name == timed[-1])
            ax.yaxis.set_label_coords(-0.47 / (_WIDTH - _LEFT - _RIGHT), 0.5)
    _title(figure, runs)
    return figure


def dress(ax: Axes) -> None:
    """Give axes the style of all; said to them, not left to settings that may have changed when they are drawn."""
    ax.set_axisbelow(True)
    ax.grid(axis="y", color=_FAINT, linewidth=0.7)
    ax.spines[["top", "right"]].set_visible(False)
    ax.spines[["left", "bottom"]].set(color=LINE, linewidth=0.7)
    ax.tick_params(color=LINE, labelcolor=SOFT, labelsize=9)
    ax.tick_params(axis="x", length=3.5)
    ax.tick_params(axis="x", which="minor", length=2.0, color=LINE)
    ax.tick_params(axis="y", length=0.0)
    ax.xaxis.label.set_color(SOFT)
    ax.yaxis.label.set_color(SOFT)


def _facts(result: Result, units: Units) -> list[str]:
    s = result.summary
    facts = [f"{shown('distance', s['distance_m'], units, 2)} in {s['duration_s']:g} s"]
    if s["fuel_economy_L_per_100km"] is not None:
        balanced = s["fuel_equivalent_L_per_100km"]
        more = "" if balanced is None else f" ({shown('economy', balanced, units, 2).split()[0]} with the battery as fuel)"
        facts.append(f"fuel {shown('economy', s['fuel_economy_L_per_100km'], units, 2)}{more}")
    if s["motor_input_J"] is not None:
        facts.append(f"motor input {shown('energy', s['motor_input_J'], units, 2)}")
    if s["soc_end"] is not None:
        facts.append(f"charge {100 * s['soc_start']:.1f} to {100 * s['soc_end']:.1f} %")
    return facts


def _title(figure: Figure, runs: _Runs) -> None:
    """Write what all runs have in common, then a line for each."""
    height, width = figure.get_figheight(), figure.get_figwidth()
    x = _LEFT / width
    inputs = [r.inputs for r in runs.results]
    same = [
        text for text, *rest in ({i.vehicle for i in inputs}, {i.cycle for i in inputs}, {_method(r) for r in runs.results}) if not rest
    ]
    title = same[0] if inputs[0].vehicle in same or len(same) == 1 else f"{len(inputs)} runs"
    aside = [text for text in same if text != title]
    figure.text(x, 1 - 0.34 / height, title, fontsize=14, fontweight="bold", va="baseline")
    figure.text(1 - _RIGHT / width, 1 - 0.34 / height, ", ".join(aside), fontsize=9.5, ha="right", va="baseline", color=SOFT)
    for i, (result, _, colour, label) in enumerate(runs.coloured()):
        y = 1 - (0.57 + 0.24 * i) / height
        if runs.one:
            line = figure.text(x, y, "   \u00b7   ".join(_facts(result, runs.units)), va="baseline", color=SOFT)
            line.set_fontsize(9.0 * min(1.0, (width - _LEFT - _RIGHT) / _wide(line)))
        else:
            figure.add_artist(Line2D([x, x + 0.2 / width], [y + 0.045 / height] * 2, color=colour, lw=2.2))
            named = figure.text(x + 0.3 / width, y, label, va="baseline")
            told = figure.text(1 - _RIGHT / width, y, "", va="baseline", ha="right", color=SOFT)
            room, (_, *said) = width - _LEFT - _RIGHT - 0.5 - _wide(named), _facts(result, runs.units)
            # As many as have room beside the name, the first ones first.
            for n in range(len(said), -1, -1):
                told.set_text("  \u00b7  ".join(said[:n]))
                if _wide(told) <= room:
                    break


def _wide(text: Text) -> float:
    """Return the width of a text [in]."""
    return text.get_window_extent(dpi=72.0).width / 72.0


def _over_time(ax: Axes, runs: _Runs, label: str) -> None:
    ax.set_xlim(*runs.limits)
    ax.xaxis.set_minor_locator(AutoMinorLocator(2))
    ax.set_xlabel(f"time [{runs.unit}]")
    ax.set_ylabel(label)


def _speed(ax: Axes, runs: _Runs) -> None:
    unit, factor, _ = edge("m/s", runs.units)
    fastest = max(float(r.the("speed").max()) for r in runs.results) * factor
    asked = max(float(r.the("request").max()) for r in runs.results) * factor
    requests: list[tuple[Array, Array]] = []
    for i, (r, t, colour, _) in enumerate(runs.coloured()):
        wanted, achieved = factor * r.the("request"), factor * r.the("speed")
        if not any(len(t) == len(other) and np.array_equal(wanted, v) for other, v in requests):
            requests.append((t, wanted))
            ax.plot(t, wanted, color="#a6a6a6", lw=2.4, label="requested" if len(requests) == 1 else None)
        ax.plot(t, achieved, color=colour, lw=1.1, label="achieved" if runs.one else None)
        missed = wanted - achieved > factor * r.inputs.parameters[r.tags.the("miss threshold")]
        if missed.any():
            begin = np.concatenate([[_start(r) * runs.second], t[:-1]])
            steps = list(zip(begin[missed].tolist(), (t - begin)[missed].tolist(), strict=True))
            place, mark = (0.965 - 0.05 * i, 0.035), _RED if runs.one else colour
            # The edge lets a single step of a long cycle be seen.
            ax.broken_barh(steps, place, transform=ax.get_xaxis_transform(), color=mark, lw=0.7, label="trace missed" if runs.one else None)
    # A request that nobody can follow, as in full acceleration, must not flatten what was achieved.
    ax.set_ylim(0, 1.1 * max(min(asked, 1.25 * fastest), fastest, 1.0))
    _over_time(ax, runs, f"speed [{unit}]")
    legend(ax)


def _grade(ax: Axes, runs: _Runs) -> None:
    for r, t, colour, _ in runs.coloured():
        ahead, up = (np.diff(r.the(tag), prepend=0.0) for tag in ("distance", "elevation"))
        flat = np.sqrt(np.maximum(ahead**2 - up**2, 0.0))
        # A vehicle that stands tells no grade.
        grade = np.divide(100 * up, flat, out=np.full(len(t), np.nan), where=flat > 1e-3)
        ax.step(t, grade, where="pre", color=SOFT if runs.one else colour, lw=1.0)
    ax.axhline(0, color=LINE, lw=0.7)
    ax.yaxis.set_major_locator(MaxNLocator(3))
    _over_time(ax, runs, "grade [%]")


def _power(ax: Axes, runs: _Runs, powers: Sequence[tuple[str, str, str]]) -> None:
    ((result, t, _, _),) = runs.coloured()
    for name, label, colour in powers:
        if colour == _GREEN:
            ax.fill_between(t, 0, result[name] / 1e3, color=colour, alpha=0.35, lw=0, label=label)
        else:
            ax.plot(t, result[name] / 1e3, color=colour, lw=0.9, label=label)
    ax.axhline(0, color=LINE, lw=0.7)
    ax.margins(y=0.08)
    ax.yaxis.set_major_locator(MaxNLocator(5))
    _over_time(ax, runs, "power [kW]")
    legend(ax)


def _output(ax: Axes, runs: _Runs, name: str, label: str) -> None:
    unit, factor, offset = "", 1.0, 0.0
    for r, t, colour, _ in runs.coloured():
        for d in r.outputs:
            if d.name == name:
                unit, factor, offset = edge(d.unit, runs.units)
                ax.plot(t, r[name] * factor + offset, color=colour, lw=0.9)
    ax.margins(y=0.08)
    ax.yaxis.set_major_locator(MaxNLocator(4))
    _over_time(ax, runs, label if unit == "1" else f"{label} [{unit}]")


def _charge(ax: Axes, runs: _Runs) -> None:
    low, high = [], []
    for r, t, colour, _ in runs.coloured():
        for name in r.tags.all_of("charge"):
            soc = 100 * np.concatenate([[r.first[name]], r[name]])
            ax.plot(np.concatenate([[_start(r) * runs.second], t]), soc, color=_GREEN if runs.one else colour, lw=1.5)
            low.append(soc.min())
            high.append(soc.max())
    # A flat line stays flat: no axis of a few hundredths of a percent.
    middle, half = 0.5 * (max(high) + min(low)), max(0.58 * (max(high) - min(low)), 1.0)
    ax.set_ylim(middle - half, middle + half)
    ax.yaxis.set_major_locator(MaxNLocator(4))
    _over_time(ax, runs, "charge [%]")


def _gear(ax: Axes, runs: _Runs) -> None:
    for r, t, colour, _ in runs.coloured():
        for name in r.tags.all_of("gear"):
            ax.step(t, r[name], where="pre", color=_GREEN if runs.one else colour, lw=1.0)
    low, high = ax.dataLim.intervaly
    ax.set_ylim(low - 0.5, high + 0.5)
    ax.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=8))
    _over_time(ax, runs, "gear")


class _Bar(NamedTuple):
    label: str
    energy: float
    kind: str


def _bars(result: Result) -> list[_Bar]:
    """Return what became of the energy [J]: losses, the largest first, what is stored, and the method's own error."""
    a = result.account
    losses: dict[str, float] = {}
    for name, x in a.losses.items():
        label = "other" if abs(x) < _SMALL * a.turnover else result.tags.get(name, part_of(name).replace("_", " "))
        losses[label] = losses.get(label, 0.0) + x
    bars = [_Bar(label, x, "lost") for label, x in sorted(losses.items(), key=lambda item: (item[0] == "other", -item[1])) if x]
    rest = [
        _Bar("kinetic energy", a.kinetic, "stored"),
        _Bar("potential energy", a.potential, "stored"),
        _Bar("speed mismatch", a.speed_mismatch, "error of the method"),
        _Bar("inertia discretisation", a.inertia_discretisation, "error of the method"),
        _Bar("speed limit, standstill", a.speed_limit, "error of the method"),
    ]
    return bars + [bar for bar in rest if abs(bar.energy) >= _TINY * a.turnover]


def _energy(ax: Axes, runs: _Runs, bars: Sequence[Sequence[_Bar]]) -> None:
    """Draw the bars of each run, one below the other where there are several."""
    largest: dict[str, tuple[int, bool, float]] = {}
    for bar in (bar for of_run in bars for bar in of_run):
        place = (list(_KINDS).index(bar.kind), bar.label == "other", -bar.energy)
        largest[bar.label] = min(place, largest.get(bar.label, place))
    order = sorted(largest, key=largest.__getitem__)
    thick = 0.68 if runs.one else 0.84 / len(bars)
    span = max((abs(bar.energy) for of_run in bars for bar in of_run), default=3600.0) / 3600
    lowest = min([0.0, *(bar.energy / 3600 for of_run in bars for bar in of_run)])
    for i, of_run in enumerate(bars):
        total = sum(bar.energy for bar in of_run) or 1.0
        for bar in of_run:
            x, y = bar.energy / 3600, order.index(bar.label) + (i - (len(bars) - 1) / 2) * thick
            ax.barh(y, x, color=_KINDS[bar.kind] if runs.one else COLOURS[i], height=thick * (1 if runs.one else 0.9))
            text = (f"{x:,.0f}" if abs(x) >= 10 else f"{x:.1f}").replace("-", "\u2212").replace(",", "\u2009")
            share = f"{bar.energy / total:.1%}".replace("-", "\u2212")
            ax.text(max(x, 0) + 0.01 * span, y, f"{text}   {share}", va="center_baseline", fontsize=8 if runs.one else 7, color=SOFT)
    ax.axvline(0, color=LINE, lw=0.7)
    ax.set_yticks(range(len(order)), order)
    ax.set_ylim(len(order) - 0.4, -0.6)
    ax.set_xlim(lowest * 1.05, 1.14 * span)
    ax.grid(False)
    ax.spines[["left", "bottom"]].set_visible(False)
    ax.tick_params(bottom=False, labelbottom=False)
    kinds = [kind for kind in _KINDS if any(bar.kind == kind for bar in bars[0])] if runs.one else []
    if len(kinds) > 1:
        ax.legend(
            handles=[Patch(color=_KINDS[kind], label=kind) for kind in kinds], loc="lower right", bbox_to_anchor=(1, 1.0), ncols=3,
            borderaxespad=0.3, borderpad=0.1, handlelength=1.0, handletextpad=0.5, columnspacing=1.5, fontsize=8.5, labelcolor=SOFT,
            frameon=False,
        )  # fmt: skip
    ax.set_title("Where the energy went [Wh]", loc="left", fontsize=9.5, color=INK, pad=7)


def legend(ax: Axes) -> None:
    """Write the legend above the axes, on the left."""
    ax.legend(
        loc="lower left", bbox_to_anchor=(0, 1.0), borderaxespad=0.1, borderpad=0.1, ncols=4, handlelength=1.2, handletextpad=0.5,
        columnspacing=1.5, labelcolor=SOFT, fontsize=8.5, frameon=False,
    )  # fmt: skip
