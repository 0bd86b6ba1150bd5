"""One figure of a run: speed, powers, state of charge or gear, and where the energy went."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import AutoMinorLocator, MaxNLocator

from halfshaft.cosim.result import Result
from halfshaft.library.errors import InputError
from halfshaft.library.writing import written_whole

#: Formats by the ending of the file.
FORMATS = ("png", "svg", "pdf")

# The palette of Okabe and Ito, which colour-blind readers tell apart.
_BLUE, _ORANGE, _GREEN, _RED = "#0072B2", "#E69F00", "#009E73", "#D55E00"
_INK, _SOFT, _FAINT = "#222222", "#6b6b6b", "#e3e3e3"
_STYLE: Any = {
    "font.family": "sans-serif", "font.sans-serif": ["Inter", "Helvetica Neue", "Arial", "Liberation Sans", "DejaVu Sans"],
    "font.size": 9.0,
    "text.color": _INK, "axes.labelcolor": _SOFT, "axes.edgecolor": "#9a9a9a", "axes.linewidth": 0.7,
    "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True, "axes.grid.axis": "y", "axes.axisbelow": True,
    "grid.color": _FAINT, "grid.linewidth": 0.7, "grid.linestyle": "-", "xtick.color": "#9a9a9a", "ytick.color": "#9a9a9a",
    "xtick.labelcolor": _SOFT, "ytick.labelcolor": _SOFT, "xtick.major.size": 3.5, "ytick.major.size": 0.0,
    "xtick.minor.size": 2.0, "xtick.direction": "out", "lines.solid_joinstyle": "round", "lines.solid_capstyle": "round",
    "legend.frameon": False, "axes.unicode_minus": True, "svg.fonttype": "none", "pdf.fonttype": 42, "path.simplify": True,
}  # fmt: skip
_POWERS = (("engine.P_out", "engine", _RED), ("motor.P_in", "motor input", _BLUE), ("battery.P_out", "battery", _GREEN))
_LOSSES = {
    "body.P_aero": "air drag",
    "body.P_roll": "rolling resistance",
    "wheel.P_brake": "friction brakes",
    "wheel.P_slip": "tyre slip",
    "wheel.P_bearing": "wheel bearings",
}
_KINDS = {"lost": _ORANGE, "stored": _BLUE, "error of the method": "#a6a6a6"}
#: Losses below this share of the turnover are summed up; other lines below that one are left out.
_SMALL, _TINY = 0.005, 5e-4
#: Room left of the axes over time [in].
_LEFT = 0.72


def plot_run(result: Result, path: str | Path) -> Path:
    """Draw a run into a PNG, SVG or PDF file, whole or not at all.

    Raises
    ------
    InputError
        If the run has no time series, the ending of the file is of no known format, or it cannot be written.

    """
    target = Path(path)
    problems = plot_problems(target)
    if not len(result.history):
        problems.append("the run has no time series to draw")
    if problems:
        raise InputError(str(target), problems)
    with written_whole(target) as part, mpl.rc_context(_STYLE):
        figure(result).savefig(part, dpi=200, facecolor="white")
    return target


def plot_problems(path: Path) -> list[str]:
    """Return what is wrong with the name of a file to draw into."""
    if path.suffix.lower().removeprefix(".") in FORMATS:
        return []
    return [f"a plot is written as {', '.join(f'.{f}' for f in FORMATS)}, not as '{path.suffix}'"]


def figure(result: Result) -> Figure:
    """Return the figure of a run; no window system is touched."""
    names = {d.name for d in result.outputs}
    third = next((name for name in ("battery.soc", "shift.gear") if name in names), None)
    bars = _bars(result)
    # Heights of the axes and the room above each [in], from top to bottom.
    rows = [(2.2, 1.0), (1.8, 0.42), *([(1.15, 0.3)] if third else []), (0.215 * len(bars) + 0.1, 0.95)]
    width, height = 8.2, sum(h + above for h, above in rows) + 0.2
    fig = Figure(figsize=(width, height))
    FigureCanvasAgg(fig)
    axes: list[Axes] = []
    y = height
    for h, above in rows:
        y -= h + above
        left = _LEFT if len(axes) < len(rows) - 1 else _LEFT + 1.0
        axes.append(fig.add_axes((left / width, y / height, (width - left - 0.3) / width, h / height)))
    _title(fig, result)
    _speed(axes[0], result)
    _power(axes[1], result, [p for p in _POWERS if p[0] in names])
    if third == "battery.soc":
        _soc(axes[2], result)
    elif third:
        _gear(axes[2], result)
    timed = axes[:-1]
    for ax in timed:
        ax.set_xlim(_start(result), float(result.time[-1]))
        ax.xaxis.set_minor_locator(AutoMinorLocator(2))
        ax.tick_params(labelbottom=ax is timed[-1])
        ax.yaxis.set_label_coords(-0.47 / (width - _LEFT - 0.3), 0.5)
    timed[-1].set_xlabel("time [s]")
    _losses(axes[-1], bars)
    return fig


def _start(result: Result) -> float:
    return float(result.time[0]) - result.inputs.dt if result.inputs.via != "forward" else min(0.0, float(result.time[0]))


def _title(fig: Figure, result: Result) -> None:
    s, inputs = result.summary, result.inputs
    x, height = _LEFT / fig.get_figwidth(), fig.get_figheight()
    fig.text(x, 1 - 0.34 / height, inputs.vehicle, fontsize=14, fontweight="bold", va="baseline")
    method = "forward-facing model" if inputs.via == "forward" else f"{inputs.mode} step of {inputs.dt:g} s"
    right = 1 - 0.3 / fig.get_figwidth()
    fig.text(right, 1 - 0.34 / height, f"{inputs.cycle}, {method}", fontsize=9.5, ha="right", va="baseline", color=_SOFT)
    facts = [f"{s['distance_m'] / 1000:.2f} km in {s['duration_s']:g} s"]
    if s["fuel_economy_L_per_100km"] is not None:
        balanced = s["fuel_equivalent_L_per_100km"]
        more = "" if balanced is None else f" ({balanced:.2f} with the battery as fuel)"
        facts.append(f"fuel {s['fuel_economy_L_per_100km']:.2f} L/100 km{more}")
    if s["motor_input_J"] is not None:
        facts.append(f"motor input {s['motor_input_J'] / 3.6e6:.2f} kWh")
    if s["soc_end"] is not None:
        facts.append(f"charge {100 * s['soc_start']:.1f} to {100 * s['soc_end']:.1f} %")
    fig.text(x, 1 - 0.57 / height, "   \u00b7   ".join(facts), fontsize=9, va="baseline", color=_SOFT)


def _speed(ax: Axes, result: Result) -> None:
    t, wanted, achieved = result.time, 3.6 * result["body.v_request"], 3.6 * result["body.v"]
    # A request that nobody can follow, as in full acceleration, must not flatten what was achieved.
    top = 1.1 * max(min(float(wanted.max()), 1.25 * float(achieved.max())), float(achieved.max()), 1.0)
    missed = wanted - achieved > 3.6 * result.inputs.parameters["body.v_miss"]
    ax.plot(t, wanted, color="#a6a6a6", lw=2.4, label="requested")
    ax.plot(t, achieved, color=_BLUE, lw=1.1, label="achieved")
    if missed.any():
        begin = np.concatenate([[_start(result)], t[:-1]])
        steps = list(zip(begin[missed].tolist(), (t - begin)[missed].tolist(), strict=True))
        # The edge lets a single step of a long cycle be seen.
        ax.broken_barh(steps, (0.965, 0.035), transform=ax.get_xaxis_transform(), color=_RED, lw=0.7, label="trace missed")
    ax.set_ylim(0, top)
    ax.set_ylabel("speed [km/h]")
    _legend(ax)


def _power(ax: Axes, result: Result, powers: Sequence[tuple[str, str, str]]) -> None:
    for name, label, colour in powers:
        if name == "battery.P_out":
            ax.fill_between(result.time, 0, result[name] / 1e3, color=colour, alpha=0.35, lw=0, label=label)
        else:
            ax.plot(result.time, result[name] / 1e3, color=colour, lw=0.9, label=label)
    ax.axhline(0, color="#9a9a9a", lw=0.7)
    ax.margins(y=0.08)
    ax.yaxis.set_major_locator(MaxNLocator(5))
    ax.set_ylabel("power [kW]")
    _legend(ax)


def _soc(ax: Axes, result: Result) -> None:
    soc = 100 * np.concatenate([[result.first["battery.soc"]], result["battery.soc"]])
    ax.plot(np.concatenate([[_start(result)], result.time]), soc, color=_GREEN, lw=1.5)
    # A flat line stays flat: no axis of a few hundredths of a percent.
    middle, half = 0.5 * (soc.max() + soc.min()), max(0.58 * (soc.max() - soc.min()), 1.0)
    ax.set_ylim(middle - half, middle + half)
    ax.yaxis.set_major_locator(MaxNLocator(4))
    ax.set_ylabel("charge [%]")


def _gear(ax: Axes, result: Result) -> None:
    gear = result["shift.gear"]
    ax.step(result.time, gear, where="pre", color=_GREEN, lw=1.0)
    ax.set_ylim(float(gear.min()) - 0.5, float(gear.max()) + 0.5)
    ax.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=8))
    ax.set_ylabel("gear")


class _Bar(NamedTuple):
    label: str
    energy: float
    kind: str


def _bars(result: Result) -> list[_Bar]:
    """Return what became of the energy [J]: losses, the largest first, what is stored, and the method's own error."""
    a = result.account
    losses: dict[str, float] = {}
    for name, x in a.losses.items():
        label = "other" if abs(x) < _SMALL * a.turnover else _LOSSES.get(name, name.split(".")[0].replace("_", " "))
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


def _losses(ax: Axes, bars: Sequence[_Bar]) -> None:
    values = [bar.energy / 3600 for bar in bars]
    ax.barh(range(len(bars)), values, color=[_KINDS[bar.kind] for bar in bars], height=0.68)
    span = max((abs(x) for x in values), default=1.0)
    total = sum(values) or 1.0
    for i, x in enumerate(values):
        text = (f"{x:,.0f}" if abs(x) >= 10 else f"{x:.1f}").replace("-", "\u2212").replace(",", "\u2009")
        share = f"{x / total:.1%}".replace("-", "\u2212")
        ax.text(max(x, 0) + 0.01 * span, i, f"{text}   {share}", va="center_baseline", fontsize=8, color=_SOFT)
    ax.axvline(0, color="#9a9a9a", lw=0.7)
    ax.set_yticks(range(len(bars)), [bar.label for bar in bars])
    ax.set_ylim(len(bars) - 0.4, -0.6)
    ax.set_xlim(min([0.0, *values]) * 1.05, 1.14 * span)
    ax.grid(False)
    ax.spines[["left", "bottom"]].set_visible(False)
    ax.tick_params(bottom=False, labelbottom=False)
    kinds = [kind for kind in _KINDS if any(bar.kind == kind for bar in bars)]
    if len(kinds) > 1:
        ax.legend(
            handles=[Patch(color=_KINDS[kind], label=kind) for kind in kinds], loc="lower right", bbox_to_anchor=(1, 1.0), ncols=3,
            borderaxespad=0.3, borderpad=0.1, handlelength=1.0, handletextpad=0.5, columnspacing=1.5, fontsize=8.5, labelcolor=_SOFT,
        )  # fmt: skip
    ax.set_title("Where the energy went [Wh]", loc="left", fontsize=9.5, color=_INK, pad=7)


def _legend(ax: Axes) -> None:
    ax.legend(
        loc="lower left", bbox_to_anchor=(0, 1.0), borderaxespad=0.1, borderpad=0.1, ncols=4, handlelength=1.2, handletextpad=0.5,
        columnspacing=1.5, labelcolor=_SOFT, fontsize=8.5,
    )  # fmt: skip
