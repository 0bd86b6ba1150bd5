"""The units in which people read results; everywhere else numbers are SI, or have their unit in their name.

A gallon is that of the US, 231 cubic inches, and a mile that of 1959; both are exact.  A gallon of gasoline counts as
33.705 kWh where electricity is told in miles per gallon equivalent (EPA).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal, NamedTuple, TypeAlias

Units: TypeAlias = Literal["metric", "us"]

L_PER_GALLON = 3.785411784
M_PER_MILE = 1609.344
M_PER_FOOT = 0.3048
WH_PER_GALLON = 33705.0
KG_PER_POUND = 0.45359237
N_PER_POUND = KG_PER_POUND * 9.80665


class Unit(NamedTuple):
    """How one quantity is shown: its unit, the number in it, and digits behind the point."""

    name: str
    of: Callable[[float], float]
    digits: int


class Edge(NamedTuple):
    """How a reader sees numbers of an SI unit: the unit, and factor and offset to it."""

    name: str
    factor: float
    offset: float = 0.0


_ALWAYS = {"W": Edge("kW", 1e-3), "J": Edge("Wh", 1 / 3600)}
#: What is not named here is shown as it is.
EDGES: Mapping[Units, Mapping[str, Edge]] = {
    "metric": {**_ALWAYS, "m/s": Edge("km/h", 3.6), "K": Edge("\u00b0C", 1.0, -273.15)},
    "us": {
        **_ALWAYS,
        "m/s": Edge("mph", 3600 / M_PER_MILE),
        "K": Edge("\u00b0F", 1.8, -459.67),
        "m": Edge("ft", 1 / M_PER_FOOT),
        "m/s^2": Edge("ft/s^2", 1 / M_PER_FOOT),
        "kg": Edge("lb", 1 / KG_PER_POUND),
        "N": Edge("lbf", 1 / N_PER_POUND),
        "N.m": Edge("lbf ft", 1 / N_PER_POUND / M_PER_FOOT),
    },
}


def edge(unit: str, units: Units = "metric") -> Edge:
    """Return how a reader sees an SI unit."""
    return EDGES[units].get(unit, Edge(unit, 1.0))


def mpg(L_per_100km: float) -> float:
    """Return miles per gallon."""
    return 1e5 * L_PER_GALLON / M_PER_MILE / L_per_100km


def mpge(Wh_per_km: float) -> float:
    """Return miles per gallon equivalent of gasoline."""
    return WH_PER_GALLON / (Wh_per_km * M_PER_MILE / 1e3)


_BOTH = {
    "energy": Unit("kWh", lambda J: J / 3.6e6, 3),
    "small energy": Unit("Wh", lambda J: J / 3600, 1),
    "power": Unit("kW", lambda W: W / 1e3, 1),
    "time": Unit("s", lambda s: s, 1),
    "share": Unit("%", lambda x: 100 * x, 2),
    "equivalent": Unit("MPGe", lambda x: x, 1),
}
SYSTEMS: Mapping[Units, Mapping[str, Unit]] = {
    "metric": {
        **_BOTH,
        "distance": Unit("km", lambda m: m / 1e3, 3),
        "range": Unit("km", lambda m: m / 1e3, 0),
        "way": Unit("m", lambda m: m, 1),
        "speed": Unit("km/h", lambda v: v * 3.6, 2),
        "acceleration": Unit("m/s^2", lambda a: a, 3),
        "volume": Unit("L", lambda L: L, 4),
        "economy": Unit("L/100 km", lambda x: x, 3),
        "consumption": Unit("Wh/km", lambda x: x, 1),
    },
    "us": {
        **_BOTH,
        "distance": Unit("mi", lambda m: m / M_PER_MILE, 3),
        "range": Unit("mi", lambda m: m / M_PER_MILE, 0),
        "way": Unit("ft", lambda m: m / M_PER_FOOT, 1),
        "speed": Unit("mph", lambda v: v * 3600 / M_PER_MILE, 2),
        "acceleration": Unit("ft/s^2", lambda a: a / M_PER_FOOT, 3),
        "volume": Unit("gal", lambda L: L / L_PER_GALLON, 4),
        "economy": Unit("mpg", mpg, 2),
        "consumption": Unit("Wh/mi", lambda x: x * M_PER_MILE / 1e3, 1),
    },
}  # fmt: skip


def shown(quantity: str, value: float | None, units: Units = "metric", digits: int | None = None, form: str = "") -> str:
    """Return a value with its unit, or a dash where there is none.

    Parameters
    ----------
    quantity
        What the value is, a key of `SYSTEMS`.
    value
        In SI, or in L, L/100 km and Wh/km.
    units
        The system to show it in.
    digits
        Digits behind the point, if not those of the quantity.
    form
        A format in place of them, such as ``.5g``.

    """
    unit = SYSTEMS[units][quantity]
    if value is None or (value == 0 and unit.of is mpg):
        return "-"
    return f"{unit.of(value):{form or f'.{unit.digits if digits is None else digits}f'}} {unit.name}"
