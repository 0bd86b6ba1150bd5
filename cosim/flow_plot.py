"""A picture of where the energy of a run flowed: bands from tank and battery through the parts to the road, as wide as the energy.

Sources are on the left, the road is on the right.  What came back runs in a lane of its own under what went forth, and turns round
where the vehicle's motion gave it back; losses leave each part.  So each part shows its own balance, and the foot that of the whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path as File

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.patches import Patch, PathPatch, Polygon, Rectangle
from matplotlib.path import Path
from matplotlib.patheffects import withStroke

from halfshaft.cosim.flows import Flow, Flows, flows
from halfshaft.cosim.plot import INK, SOFT, STYLE, Picture, labels_of, plot_problems
from halfshaft.cosim.result import Result
from halfshaft.library.base.errors import InputError
from halfshaft.library.files.writing import written_whole

# Shades of the palette of Okabe and Ito, on which dark text can be read; they differ in lightness too.
FUEL, ELECTRIC, MECHANIC, BACK, LOSS, REST = "#e39a78", "#86c5ee", "#c3ccd4", "#4fb597", "#f3cc6b", "#e3e3e3"
#: What the colours mean.
KEYS = {
    FUEL: "fuel", ELECTRIC: "electricity", MECHANIC: "shafts, tyres", BACK: "coming back", LOSS: "lost",
    REST: "in motion, method's own error",
}  # fmt: skip
#: Height of the thickest part, distance of two parts, and width of a part [in].
_THICK, _COLUMN, _BAR = 1.5, 1.12, 0.07
#: Room between the lanes forth and back, from a part down to where its losses end, and between two lanes of parts [in].
_GAP, _DROP, _APART = 0.05, 0.17, 0.42
#: How far losses and sources reach, in columns; size of an arrow and height of a line of text [in].
_REACH, _ARROW, _LINE = 0.6, 0.09, 0.145
#: What is below this share of the turnover gets no text.
_SMALL = 0.002


def plot_flows(*results: Result, labels: Sequence[str] | None = None, path: str | File | None = None) -> Picture:
    """Draw where the energy of a run flowed, or of several, one below the other to the same scale.

    Parameters
    ----------
    results
        The runs; without time series, what came back is taken off what went forth.
    labels
        Names of several runs; without them, what tells the runs apart.
    path
        A PNG, SVG or PDF file to write, whole or not at all.

    Raises
    ------
    InputError
        If the file cannot be written, a run moved no energy, or a loaded one does not say what its vehicle was made of.

    """
    problems = plot_problems(File(path)) if path is not None else []
    problems += [] if results else ["there is no run to draw"]
    if labels is not None and len(labels) != len(results):
        problems.append(f"{len(labels)} labels for {len(results)} runs")
    if problems:
        raise InputError(str(path) if path is not None else "plot", problems)
    found = [flows(result) for result in results]
    scale = _THICK / max(map(_thickest, found))
    with mpl.rc_context(STYLE):
        figure = _drawn(results, [_Layout(each, scale) for each in found], labels or labels_of(results))
        if path is not None:
            with written_whole(path) as part:
                figure.savefig(part, dpi=200, facecolor="white")
    return figure


def _thickest(found: Flows) -> float:
    """Return the most that goes through one side of a part [J]."""
    left = {name: s.burnt + s.drawn + s.charged for name, s in found.stations.items()}
    right = {name: s.lost + max(s.rest, 0.0) for name, s in found.stations.items()}
    for f in found.flows:
        left[f.load] += f.forth + f.back
        right[f.supply] += f.forth + f.back
    return max(*left.values(), *right.values())


class _Layout:
    """Where everything lies: x to the right and y downward [in]; columns are counted from the road, lanes from the top."""

    def __init__(self, found: Flows, scale: float) -> None:
        self.found, self.stations, self.scale = found, found.stations, scale
        self.into = {name: [f for f in found.flows if f.load == name] for name in self.stations}
        self.out = {name: [f for f in found.flows if f.supply == name] for name in self.stations}
        self.column = dict.fromkeys(self.stations, 0)
        for _ in self.stations:
            for f in found.flows:
                self.column[f.supply] = max(self.column[f.supply], self.column[f.load] + 1)
        self.lane: dict[str, int] = {}
        self.lanes = 0
        (self.road,) = [name for name in self.stations if not self.out[name]]
        self._choose_lane(self.road)
        self.up = self._upward()
        self.top = dict.fromkeys(self.stations, 0.0)
        self.height = {name: max(self._stack(name, "left"), self._stack(name, "right")) for name in self.stations}
        self._align()
        self.last = max(self.column.values())

    def burns(self, name: str) -> bool:
        """Return whether fuel comes in at a part or behind it."""
        return self.stations[name].burnt > 0 or any(self.burns(f.supply) for f in self.into[name])

    def _choose_lane(self, name: str) -> None:
        """Give a part the lane of the thickest branch behind it; what burns fuel is on top."""
        fresh = []
        for f in sorted(self.into[name], key=lambda f: not self.burns(f.supply)):
            if f.supply not in self.lane:
                self._choose_lane(f.supply)
                fresh.append(f)
        if fresh:
            self.lane[name] = self.lane[max(fresh, key=lambda f: f.forth + f.back).supply]
        else:
            self.lane[name] = self.lanes
            self.lanes += 1

    def _upward(self) -> set[str]:
        """Return the parts whose losses leave upward: those above what all energy goes through."""
        trunk, name = [self.road], self.road
        while len(self.into[name]) == 1:
            name = self.into[name][0].supply
            trunk.append(name)
        main = self.lane[self.road]
        above = self.lanes > 1 and main == 0
        return {name for name, lane in self.lane.items() if name not in trunk and (lane < main or (lane == main and above))}

    def lost(self, name: str) -> float:
        """Return the width of what leaves a part for good."""
        s = self.stations[name]
        return self.scale * (s.lost + max(s.rest, 0.0))

    def _stack(self, name: str, side: str) -> float:
        s = self.stations[name]
        both = self.into[name] if side == "left" else self.out[name]
        total = sum(self.width(f) for f in both)
        if side == "right":
            return total + (self.lost(name) if name != self.road else 0.0)
        return total + self.scale * s.burnt + self.pair(s.drawn, s.charged)

    def pair(self, forth: float, back: float) -> float:
        """Return the width of two lanes."""
        return self.scale * (forth + back) + (_GAP if forth and back else 0.0)

    def width(self, f: Flow) -> float:
        """Return the width of a flow with both of its lanes."""
        return self.pair(f.forth, f.back)

    def start(self, f: Flow) -> float:
        """Return where a flow begins, below the top of its supply."""
        before = [g for g in self.out[f.supply] if (self.lane[g.load], g.load) < (self.lane[f.load], f.load)]
        return (self.lost(f.supply) if f.supply in self.up else 0.0) + sum(map(self.width, before))

    def end(self, f: Flow) -> float:
        """Return where a flow ends, below the top of its load."""
        before = [g for g in self.into[f.load] if (self.lane[g.supply], g.supply) < (self.lane[f.supply], f.supply)]
        return sum(map(self.width, before))

    def extent(self, name: str) -> tuple[float, float]:
        """Return the highest and the lowest place that a part with its losses and texts takes, from its top."""
        texts = _LINE * (len(self.losses(name)) + 0.6)
        beyond = _DROP + self.lost(name) + texts if self.losses(name) and name != self.road else 0.0
        named = 1.5 * _LINE
        if name in self.up:
            return -(_DROP + texts) if beyond else 0.0, self.height[name] + named
        out = sum(map(self.width, self.out[name]))
        return -named, max(self.height[name], out + beyond)

    def span(self) -> tuple[float, float]:
        """Return the highest and the lowest place that is taken."""
        both = [(self.top[name] + high, self.top[name] + low) for name in self.stations for high, low in [self.extent(name)]]
        return min(high for high, _ in both), max(low for _, low in both)

    def losses(self, name: str) -> list[tuple[str, float]]:
        """Return what leaves a part for good and is worth a text, the largest first."""
        s, least = self.stations[name], _SMALL * self.found.turnover
        told = sorted(((label, x) for label, x in s.losses.items() if x > least), key=lambda item: -item[1])
        return [*told, *([("motion, method", s.rest)] if s.rest > least else [])]

    def _align(self) -> None:
        """Lay the parts of a lane along straight bands, and the lanes above and below that of the road."""
        order = sorted(self.stations, key=lambda name: self.column[name])
        for name in order:
            along = next((f for f in self.out[name] if self.lane[f.load] == self.lane[name]), None)
            if along is not None:
                self.top[name] = self.top[along.load] + self.end(along) - self.start(along)
        main = self.lane[self.road]
        placed = [name for name in order if self.lane[name] == main]
        for lane in [*range(main - 1, -1, -1), *range(main + 1, self.lanes)]:
            mine = [name for name in order if self.lane[name] == lane]
            shift = 0.0
            for name in mine:
                for other in placed:
                    # Losses reach from the next part on the left.
                    if self.column[other] - self.column[name] in (0, 1):
                        (high, low), (first, last) = self.extent(name), self.extent(other)
                        if lane > main:
                            shift = max(shift, self.top[other] + last + _APART - self.top[name] - high)
                        else:
                            shift = min(shift, self.top[other] + first - _APART - self.top[name] - low)
            for name in mine:
                self.top[name] += shift
            placed += mine


def _drawn(results: Sequence[Result], lays: Sequence[_Layout], labels: Sequence[str]) -> Picture:
    """Draw the runs one below the other, their roads aligned."""
    one = results[0].inputs if len(results) == 1 else None
    left, right, margin, head, name, foot = 1.75, 2.2, 0.3, 0.85, 0.1 if one else 0.45, 0.5
    columns = max(lay.last for lay in lays)
    spans = [lay.span() for lay in lays]
    wide, high = left + columns * _COLUMN + right, head + sum(name + low - top + foot for top, low in spans)
    figure = Picture(figsize=(wide, high))
    ax = figure.add_axes((0, 0, 1, 1))
    ax.set_xlim(0, wide)
    ax.set_ylim(high, 0)
    ax.set_axis_off()
    ax.text(margin, 0.36, one.vehicle if one else f"{len(results)} runs", fontsize=14, fontweight="bold")
    ax.text(wide - margin, 0.36, f"over {one.cycle}" if one else "to the same scale", fontsize=9.5, ha="right", color=SOFT)
    y = head
    for result, lay, (top, low), label in zip(results, lays, spans, labels, strict=True):
        if one is None:
            ax.text(margin, y + 0.15, label, fontsize=10.5, fontweight="bold")
        pen = _Pen(ax, lay, left + (columns - lay.last) * _COLUMN, y + name - top)
        for f in lay.found.flows:
            pen.flow(f)
        for part in lay.stations:
            pen.part(part)
        y += name + low - top + foot
        ax.text(margin, y - 0.2, _balance(result), fontsize=8.5, color=SOFT)
    drawn = {patch.get_facecolor() for patch in ax.patches}
    keys = [Patch(color=colour, label=label) for colour, label in KEYS.items() if to_rgba(colour) in drawn]
    ax.legend(
        handles=keys, loc="upper left", ncols=len(keys), frameon=False, bbox_to_anchor=(margin, 0.42), bbox_transform=ax.transData,
        borderpad=0.1, borderaxespad=0.1, handlelength=1.0, handletextpad=0.5, columnspacing=1.5, fontsize=8.5, labelcolor=SOFT,
    )  # fmt: skip
    return figure


def _balance(result: Result) -> str:
    """Return the account in one line."""
    a = result.account
    method = a.speed_mismatch + a.inertia_discretisation + a.speed_limit
    into = [(a.fuel, "fuel"), (a.battery, "stores")]
    out = [(sum(a.losses.values()), "lost"), (a.kinetic, "in motion"), (a.potential, "in height"), (method, "method's own error")]
    sides = [[f"{_number(x)} {label}" for x, label in side if abs(x) >= 0.5 * 3600] for side in (into, out)]
    return f"Wh:  {' + '.join(sides[0])}  =  {' + '.join(sides[1])};  open by {abs(a.residual) / 3600:.0e} Wh".replace(
        "+ \u2212", "\u2212 "
    )


def _number(energy: float) -> str:
    x = energy / 3600
    return (f"{x:,.0f}" if abs(x) >= 10 else f"{x:.1f}").replace(",", "\u2009").replace("-", "\u2212")


class _Pen:
    """Draws bands, parts and texts."""

    def __init__(self, ax: Axes, lay: _Layout, left: float, down: float) -> None:
        self.ax, self.lay, self.left = ax, lay, left
        self.least = _SMALL * lay.found.turnover
        self.top = {name: y + down for name, y in lay.top.items()}

    def x(self, name: str) -> float:
        """Return where a part begins."""
        return self.left + (self.lay.last - self.lay.column[name]) * _COLUMN

    def band(self, x: tuple[float, float], y: tuple[float, float], width: float, colour: str) -> None:
        """Draw a band between two places of its upper edge, level at both ends."""
        (a, b), (c, d), half = x, y, (x[0] + x[1]) / 2
        points = [(a, c), (half, c), (half, d), (b, d), (b, d + width), (half, d + width), (half, c + width), (a, c + width), (a, c)]
        codes = [Path.MOVETO, *[Path.CURVE4] * 3, Path.LINETO, *[Path.CURVE4] * 3, Path.CLOSEPOLY]
        self.ax.add_patch(PathPatch(Path(points, codes), facecolor=colour, edgecolor="none"))

    def arrow(self, x: float, y: float, width: float, colour: str, way: int = 1) -> None:
        """Draw the head of a band that ends at `x`."""
        size = min(_ARROW + 0.1 * width, 0.2)
        self.ax.add_patch(Polygon([(x, y), (x + way * size, y + width / 2), (x, y + width)], facecolor=colour, edgecolor="none"))

    def text(
        self, x: float, y: float, text: str, *, ha: str = "center", size: float = 8.0, colour: str = INK, weight: str = "normal"
    ) -> None:
        """Write something about a place."""
        # A number of what is lost may lie over a band.
        halo = [withStroke(linewidth=2.0, foreground="white")] if colour == SOFT else None
        self.ax.text(x, y, text, ha=ha, va="center_baseline", fontsize=size, color=colour, fontweight=weight, path_effects=halo)

    def flow(self, f: Flow) -> None:
        """Draw a connection: what went forth, and what came back under it."""
        lay = self.lay
        x = (self.x(f.supply) + _BAR, self.x(f.load))
        y = (self.top[f.supply] + lay.start(f), self.top[f.load] + lay.end(f))
        colour = ELECTRIC if f.carrier == "Electric" else MECHANIC
        self._lanes(x, y, f.forth, f.back, colour)

    def _lanes(self, x: tuple[float, float], y: tuple[float, float], forth: float, back: float, colour: str) -> None:
        lay, width, thin = self.lay, self.lay.scale * forth, self.lay.scale * back
        below = width + (_GAP if forth and back else 0.0)
        self.band(x, y, width, colour)
        self.band(x, (y[0] + below, y[1] + below), thin, BACK)
        # Where a band goes aslant there is room for a number at its end only.
        slant = abs(y[1] - y[0]) > 0.3
        at, middle, ha = (x[1] - 0.06, y[1], "right") if slant else ((x[0] + x[1]) / 2, (y[0] + y[1]) / 2, "center")
        for energy, place, said in ((forth, middle + width / 2, "{}"), (back, middle + below + thin / 2, "\u2190 {}")):
            if energy > self.least and lay.scale * energy > 0.1:
                self.text(at, place, said.format(_number(energy)), ha=ha, size=7.5 if slant else 8.0)

    def part(self, name: str) -> None:
        """Draw a part with what comes in from its tank or store, and what leaves it for good."""
        lay = self.lay
        x, top, height = self.x(name), self.top[name], lay.height[name]
        self.ax.add_patch(Rectangle((x, top), _BAR, height, facecolor="#4a5560", edgecolor="none"))
        label = name.replace("_", " ")
        # Bands that come or go aslant leave room on one side only.
        rises = any(lay.lane[f.load] < lay.lane[name] for f in lay.out[name])
        falls = any(lay.lane[f.supply] < lay.lane[name] for f in lay.into[name])
        below = name in lay.up or falls
        place = (x + _BAR, "right") if rises or falls else (x + _BAR / 2, "center")
        y = top + height + 0.8 * _LINE if below else top - 0.7 * _LINE
        self.text(place[0], y, label, ha=place[1], weight="bold", size=8.5)
        self._source(name, x, top + sum(map(lay.width, lay.into[name])))
        if name == lay.road:
            self._road(x + _BAR, top)
        else:
            self._losses(name, x + _BAR, top)

    def _source(self, name: str, x: float, top: float) -> None:
        """Draw what comes out of a part's tank or store, and what goes back into it."""
        lay, s = self.lay, self.lay.stations[name]
        begin = x - 0.62 * _COLUMN
        if s.burnt:
            self._lanes((begin, x), (top, top), s.burnt, 0.0, FUEL)
            self.text(begin - 0.07, top + lay.scale * s.burnt / 2, "fuel", ha="right", weight="bold", size=8.5)
        if s.drawn or s.charged:
            self._lanes((begin, x), (top, top), s.drawn, s.charged, ELECTRIC)
            both = lay.pair(s.drawn, s.charged)
            if s.charged:
                self.arrow(begin, top + both - lay.scale * s.charged, lay.scale * s.charged, BACK, -1)
            given = s.drawn - s.charged
            said = f"{'gave' if given >= 0 else 'took'} {_number(abs(given))}"
            for text, weight, line in (("store", "bold", -0.5), (said, "normal", 0.5)):
                self.text(begin - 0.22, top + both / 2 + 1.1 * line * _LINE, text, ha="right", weight=weight, size=8.5)

    def _losses(self, name: str, x: float, top: float) -> None:
        """Draw what leaves a part: upward above the road's lane, else downward."""
        lay, s = self.lay, self.lay.stations[name]
        told = lay.losses(name)
        if not told:
            return
        total, tip = lay.lost(name), x + _REACH * _COLUMN
        start = top + (0.0 if name in lay.up else sum(map(lay.width, lay.out[name])))
        end = start - _DROP if name in lay.up else start + _DROP
        lost = lay.scale * max(s.lost, 0.0)
        self.band((x, tip), (start, end), lost, LOSS)
        self.arrow(tip, end, lost, LOSS)
        if total > lost + lay.scale * self.least:
            self.band((x, tip), (start + lost, end + lost), total - lost, REST)
            self.arrow(tip, end + lost, total - lost, REST)
        for i, (label, energy) in enumerate(told):
            y = end - (len(told) - i - 0.25) * _LINE if name in lay.up else end + total + (i + 0.75) * _LINE
            self.text(tip - 0.1, y, f"{_number(energy)}{'' if label == 'loss' else f' {label}'}", colour=SOFT)

    def _road(self, x: float, top: float) -> None:
        """Draw what the road takes, and where the vehicle's motion turns round what comes back."""
        lay = self.lay
        back, forth = (lay.scale * sum(x) for x in zip(*((f.back, f.forth) for f in lay.into[lay.road]), strict=True))
        told = [(label, energy, LOSS if label != "motion, method" else REST) for label, energy in lay.losses(lay.road)]
        tip, at = x + 0.5, top
        # The texts beside need room.
        spread = max(0.0, 1.3 * _LINE - lay.scale * min((energy for _, energy, _ in told), default=1e9))
        for i, (label, energy, colour) in enumerate(told):
            width, end = lay.scale * energy, at + i * spread - 0.5 * spread * (len(told) - 1)
            self.band((x, tip), (at, end), width, colour)
            self.arrow(tip, end, width, colour)
            self.text(tip + 0.25, end + width / 2, f"{label} {_number(energy)}", ha="left", colour=INK)
            at += width
        if back > 0:
            inner, middle = _GAP / 2, top + forth + _GAP / 2
            outer, k = inner + back, 4 / 3
            far, near = x + k * outer, x + k * inner
            points = [
                (x, middle - outer), (far, middle - outer), (far, middle + outer), (x, middle + outer),
                (x, middle + inner), (near, middle + inner), (near, middle - inner), (x, middle - inner), (x, middle - outer),
            ]  # fmt: skip
            codes = [Path.MOVETO, *[Path.CURVE4] * 3, Path.LINETO, *[Path.CURVE4] * 3, Path.CLOSEPOLY]
            self.ax.add_patch(PathPatch(Path(points, codes), facecolor=BACK, edgecolor="none"))
