"""Figures by their names, whose endings are their units, in the units of a reader."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from halfshaft.cosim.units import M_PER_MILE, Units, shown

#: Endings of names, the longer first, and the quantity that they are shown as.
QUANTITIES = {
    "_L_per_100km": "economy", "_Wh_per_km": "consumption", "_range_m": "range", "_distance_m": "distance",
    "_mps2": "", "_mps": "speed", "_J": "energy", "_W": "power", "_L": "volume", "_m": "way",
}  # fmt: skip
#: Without a value the vehicle does not use what these tell of; all else was not reached.
USED = ("_L_per_100km", "_Wh_per_km", "_kWh_per_100km", "_MPGe")
#: Endings that both systems show alike.
PLAIN = {"_percent": "%", "_MPGe": "MPGe", "_mps2": "m/s2", "_s": "s", "_kWh_per_100km": "kWh/100 km", "_mpg": "mpg"}


def figure_rows(figures: Mapping[str, float | None], units: Units) -> list[tuple[str, str]]:
    """Return what the figures are and their values, as texts; of two that tell the same, the one that the reader knows."""
    return list(_rows(figures, units))


def _rows(figures: Mapping[str, float | None], units: Units) -> Iterable[tuple[str, str]]:
    for name, x in figures.items():
        if name.endswith("_mpg") and name.removesuffix("_mpg") + "_L_per_100km" in figures:
            continue
        ending = next((e for e in (*PLAIN, *QUANTITIES) if f"_{name}".endswith(e)), "")
        what = name.removesuffix(ending).removesuffix(ending[1:]).replace("_", " ")
        what = what.replace(" kmh", " km/h") + {"_range_m": " range", "_distance_m": " distance"}.get(ending, "")
        if x is None and ending not in USED:
            yield what.strip(), "-"
        elif x is None:
            continue
        elif quantity := QUANTITIES.get(ending):
            yield what.strip(), shown(quantity, x, units)
        elif ending == "_kWh_per_100km" and units == "us":
            yield what.strip(), f"{x * M_PER_MILE / 1e3:.3f} kWh/100 mi"
        else:
            yield what.strip(), f"{x:.5g} {PLAIN.get(ending, '')}".strip()
