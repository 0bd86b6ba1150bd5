"""Draws the paper's figures from our runs, on the paper's axes, for a light or a dark page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from halfshaft.cosim.compiled import Array
from halfshaft.cosim.result import Result
from halfshaft.studies.acceleration import T_START

Place: TypeAlias = Literal["upper left", "upper right", "center right", "lower right"] | tuple[float, float]


class Theme(NamedTuple):
    """Colours of a page."""

    paper: str
    ink: str
    faint: str
    grid: str
    curves: tuple[str, str, str, str]


LIGHT = Theme("#ffffff", "#1c2430", "#5b6675", "#e3e7ec", ("#9aa4b1", "#d9772b", "#2a9d8f", "#1f5fa8"))
DARK = Theme("#161b22", "#e6eaf0", "#9aa5b3", "#2b323c", ("#7d8896", "#f0a05a", "#4cc4b4", "#6cb0f5"))


class Curve(NamedTuple):
    """A line of a plot; `colour` is its place in the theme."""

    label: str
    x: Array
    y: Array
    colour: int
    line: str = "-"
    width: float = 1.8


class Name(NamedTuple):
    """A name written into a plot; a negative colour is that of text."""

    text: str
    x: float
    y: float
    colour: int = -1
    align: Literal["left", "right"] = "left"


@dataclass(frozen=True)
class Plot:
    """Curves over common axes; `ticks` are the steps of the axes."""

    curves: Sequence[Curve]
    x_label: str
    y_label: str
    x_end: float
    y_end: float
    ticks: tuple[float, float]
    names: Sequence[Name] = ()
    legend: Place | None = "upper left"


#: One figure: its plots from top to bottom.
Drawing = Sequence[Plot]


def acceleration_drawings(r: Result) -> dict[str, Drawing]:
    """Return figures 2, 3, 5, 6 and 7 from the acceleration of a vehicle whose motor has a current limit."""
    t, kmh, kilo = r.time, 3.6, 1e-3

    def plot(y_label: str, y_end: float, step: float, legend: Place, *curves: Curve) -> Drawing:
        return [Plot(curves, "time (s)", y_label, 50, y_end, (10, step), legend=legend)]

    return {
        "2": plot(
            "tractive force (kN)", 25, 5, "upper right",
            Curve("a hundredth of what is asked for", t, r["body.F_required"] * kilo / 100, 1),
            Curve("what the tyres carry", t, r["wheel.F_limited"] * kilo, 3),
        ),
        "3": plot(
            "vehicle speed (km/h)", 350, 50, (0.24, 0.69),
            Curve("trace", t, r["body.v_request"] * kmh, 0),
            Curve("required mean speed", t, r["wheel.v_required"] * kmh, 1),
            Curve("within the tyres' grip", t, r["wheel.v_limited"] * kmh, 2, "--"),
            Curve("achieved", t, r["body.v"] * kmh, 3),
        ),
        "5": plot(
            "motor torque (N m)", 700, 100, "center right",
            Curve("asked for", t, r["motor.tau_required"], 1),
            Curve("within the motor's largest torque", t, r["motor.tau_limited"], 3),
        ),
        "6": plot(
            "motor speed (rad/s)", 1000, 200, "lower right",
            Curve("asked for", t, r["motor.omega_required"], 1),
            Curve("within the motor's top speed", t, r["motor.omega"], 3),
        ),
        "7": plot(
            "motor input power (kW)", 80, 10, "lower right",
            Curve("by the motor's map", t, r["motor.P_map"] * kilo, 1),
            Curve("within the controller's current limit", t, r["motor.P_in_required"] * kilo, 3),
        ),
    }  # fmt: skip


def speeds_drawing(hybrid: Mapping[str, Result], iteration: Mapping[str, Result]) -> Drawing:
    """Return figure 9: speeds over the time since the start, by vehicle."""
    curves, names = [], []
    for i, (name, r) in enumerate(hybrid.items()):
        for method, run, colour, line, width in (("hybrid", r, 3, "-", 2.2), ("iteration", iteration[name], 1, (0, (4, 3)), 1.5)):
            t, v = np.append(0.0, run.time - T_START), np.append(0.0, run["body.v"] * 3.6)
            shown = (t >= 0) & (v <= 104)
            curves.append(Curve(method if i == 0 else "", t[shown], v[shown], colour, line, width))  # type: ignore[arg-type]
        names.append(Name(name, float(np.interp(100 / 3.6, r["body.v"], r.time)) - T_START, 103, 3, "right"))
    return [Plot(curves, "time (s)", "speed (km/h)", 25, 100, (5, 20), names, "upper left")]


def deviations_drawing(runs: Mapping[str, Result]) -> Drawing:
    """Return figure 10: how far each vehicle falls behind the trace."""
    last = len(runs) - 1
    return [
        Plot(
            [Curve("", r.time, np.maximum(r["body.trace_miss"], 0) * 3.6, 3, width=1.3)],
            "time (s)" if i == last else "", "behind (km/h)", 600, 20, (100, 10), [Name(name, 8, 15.5)], None,
        )
        for i, (name, r) in enumerate(runs.items())
    ]  # fmt: skip


def _draw(ax: Axes, plot: Plot, theme: Theme) -> None:
    for c in plot.curves:
        ax.plot(c.x, c.y, color=theme.curves[c.colour], linestyle=c.line, linewidth=c.width, label=c.label, solid_joinstyle="round")
    ax.set_xlim(0, plot.x_end)
    ax.set_ylim(0, plot.y_end)
    ax.set_xticks(np.arange(0, plot.x_end * 1.001, plot.ticks[0]))
    ax.set_yticks(np.arange(0, plot.y_end * 1.001, plot.ticks[1]))
    ax.set_xlabel(plot.x_label, color=theme.ink)
    ax.set_ylabel(plot.y_label, color=theme.ink)
    ax.set_facecolor(theme.paper)
    ax.grid(color=theme.grid, linewidth=0.8)
    ax.set_axisbelow(True)
    ax.tick_params(colors=theme.faint, length=0, labelsize=9)
    for side, spine in ax.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(theme.grid)
    for name in plot.names:
        colour = theme.ink if name.colour < 0 else theme.curves[name.colour]
        ax.text(name.x, name.y, name.text, color=colour, fontsize=9, va="center", ha=name.align)
    if plot.legend:
        columns = 2 if len(plot.curves) == 4 else 1
        ax.legend(loc=plot.legend, frameon=False, labelcolor=theme.ink, fontsize=10, handlelength=1.8, ncols=columns)


def png(drawing: Drawing, theme: Theme = LIGHT) -> bytes:
    """Return a figure as a PNG."""
    # Several plots over each other fill the width of a page.
    figure = Figure(figsize=(6.0, 3.7) if len(drawing) == 1 else (12.0, 5.0), facecolor=theme.paper, layout="constrained")
    for ax, plot in zip(np.atleast_1d(np.asarray(figure.subplots(len(drawing), 1))), drawing, strict=True):
        _draw(ax, plot, theme)
        if len(drawing) > 1 and not plot.x_label:
            ax.set_xticklabels([])
    buffer = BytesIO()
    # Without the name of the drawing software the file depends on the data alone.
    figure.savefig(buffer, format="png", dpi=180, metadata={"Software": None})
    return buffer.getvalue()
