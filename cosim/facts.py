"""The numbers of a run as people read them: in tables of the terminal, at the prompt and in notebooks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from halfshaft.cosim.units import Units, shown

if TYPE_CHECKING:
    from halfshaft.cosim.account import Account, Part
    from halfshaft.cosim.compiled import Array
    from halfshaft.cosim.result import Result

#: The method's own lines of the account, and what each is, in three words.
METHOD = {
    "speed_mismatch": "speed mismatch: slower than asked",
    "inertia_discretisation": "inertia discretisation: by steps",
    "speed_limit": "limit and standstill: unused drive",
}
#: Columns of the energy table.
HEADINGS = ("energy [Wh]", "in", "out", "loss", "eff. %")
#: Points of the curve in a notebook.
CURVE = 300


class Row(NamedTuple):
    """A line of the energy table: energies in, out and lost [J], and out over in; `soft` for the method's own error."""

    name: str
    received: float | None = None
    delivered: float | None = None
    lost: float | None = None
    efficiency: float | None = None
    soft: bool = False

    def cells(self) -> tuple[str, ...]:
        """Return name, energies in Wh and efficiency in per cent."""
        energies = ("" if x is None else watt_hours(x) for x in (self.received, self.delivered, self.lost))
        return (self.name, *energies, "" if self.efficiency is None else f"{100 * self.efficiency:.1f}")


def watt_hours(energy: float) -> str:
    """Return an energy [J] in Wh; what is rounding is zero."""
    return f"{energy / 3600:.2f}".replace("-0.00", "0.00")


def facts(result: Result, units: Units = "metric") -> list[tuple[str, str]]:
    """Return the main numbers of a run, each with its name; what the vehicle does not have is left out."""
    f = result.figures
    found = [("distance", shown("distance", f["distance_m"], units)), ("duration", f"{f['duration_s']:g} s")]
    battery = f["energy_from_battery_J"]
    if f["fuel_L"] is not None:
        found.append(("fuel", shown("volume", f["fuel_L"], units)))
    if battery is not None:
        found.append(("battery took" if battery < 0 else "battery gave", shown("energy", abs(battery), units)))
    if f["fuel_L"] is not None:
        found.append(("economy, fuel alone" if battery else "economy", shown("economy", f["fuel_economy_L_per_100km"], units)))
    if f["fuel_equivalent_L"] is not None:
        found.append(("with battery as fuel", shown("economy", f["fuel_equivalent_L_per_100km"], units)))
        found.append((f"genset, {'own mean' if result.genset_ran else 'nominal'}", f"{100 * f['fuel_equivalent_efficiency']:.1f} %"))
    if f["energy_Wh_per_km"] is not None:
        found.append(("consumption", shown("consumption", f["energy_Wh_per_km"], units)))
        found += [("economy", f"{f['energy_MPGe']:.1f} MPGe")] if units == "us" else []
    more = [
        ("full battery", "energy", "pack_energy_J"), ("range on it", "range", "range_m"),
        ("motor input", "energy", "motor_input_J"), ("motor peak", "power", "motor_power_max_W"),
    ]  # fmt: skip
    found += [(name, shown(quantity, f[key], units)) for name, quantity, key in more if f[key] is not None]
    if f["soc_end"] is not None:
        found.append(("state of charge", f"{f['soc_start']:.4f} -> {f['soc_end']:.4f}"))
    return [*found, ("largest trace miss", shown("speed", f["trace_miss_max_mps"], units))]


def energy_rows(account: Account) -> list[Row]:
    """Return the lines of the energy table, from the source to the wheel, and what became of the energy."""
    parts: list[Part] = sorted(reversed(account.parts), key=lambda part: not part.burns)
    rows = []
    for part in parts:
        both = part.received > 0 and part.delivered > 0
        efficiency = part.delivered / part.received if both else None
        rows.append(Row(part.name.replace("_", " "), part.received, part.delivered, part.lost, efficiency))
    if account.fuel:
        rows.append(Row("fuel", account.fuel))
    if account.battery:
        rows.append(Row("battery store", account.battery))
    rows.append(Row("losses", lost=sum(account.losses.values())))
    rows.append(Row("kinetic energy", delivered=account.kinetic))
    rows.append(Row("potential energy", delivered=account.potential))
    rows.append(Row("the method's own error:", soft=True))
    rows += [Row(title, delivered=getattr(account, name), soft=True) for name, title in METHOD.items()]
    return [*rows, Row(f"balance ({account.balance_relative:.0e} of the turnover)", lost=account.residual)]


def energy_table(account: Account) -> str:
    """Return the energy table in HTML."""
    return table((row.cells() for row in energy_rows(account)), HEADINGS)


def in_line(result: Result) -> str:
    """Return a run in one line."""
    kept = {name: "" for name in ("distance", "economy", "economy, fuel alone", "consumption")}
    kept |= {"with battery as fuel": "with battery as fuel ", "state of charge": "charge "}
    said = [kept[name] + value for name, value in facts(result) if name in kept and value != "-"]
    n = len(result.warnings)
    said += [f"{n} warning{'s' * (n > 1)}"] if n else []
    return f"{result.inputs.vehicle} over {result.inputs.cycle}: {', '.join(said)}"


def table(rows: Iterable[Sequence[str]], headings: Sequence[str] = ()) -> str:
    """Return an HTML table; all but the first column to the right."""

    def line(cells: Sequence[str], tag: str) -> str:
        sides = ("left", *("right",) * (len(cells) - 1))
        return "<tr>" + "".join(f'<{tag} style="text-align:{s}">{escape(c)}</{tag}>' for c, s in zip(cells, sides, strict=True)) + "</tr>"

    head = line(headings, "th") if headings else ""
    return f"<table>{head}{''.join(line(cells, 'td') for cells in rows)}</table>"


def curve(time: Array, speeds: Sequence[tuple[str, Array]], width: int = 600, height: int = 90) -> str:
    """Return curves of speed [m/s] over time as a small SVG picture."""
    if len(time) < 2:
        return ""
    picked = np.unique(np.linspace(0, len(time) - 1, CURVE).astype(int))
    top = max(float(v[picked].max()) for _, v in speeds) or 1.0
    x = width * (time[picked] - time[0]) / (time[-1] - time[0])
    lines = []
    for colour, v in speeds:
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, (height - 2) * (1 - v[picked] / top) + 1, strict=True))
        lines.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.2"/>')
    return f'<svg width="{width}" height="{height}" viewBox="0 0 {width} {height}" role="img">{"".join(lines)}</svg>'


def in_html(result: Result) -> str:
    """Return a run for a notebook: main numbers, warnings and speed."""
    head = f"<b>{escape(result.inputs.vehicle)}</b> over <b>{escape(result.inputs.cycle)}</b>"
    notes = "".join(f"<li>{escape(text)}</li>" for text in result.warnings)
    drawn = ""
    if result.has_history and len(result.time):
        # A request that nobody can follow must not flatten what was achieved.
        v = result.the("speed")
        asked = np.minimum(result.the("request"), 1.15 * max(float(v.max()), 1.0))
        drawn = curve(result.time, (("#b0b0b0", asked), ("#0072B2", v)))
    return f"{head}{table(facts(result))}{f'<ul>{notes}</ul>' if notes else ''}{drawn}"
