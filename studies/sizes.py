"""What of a vehicle a sizing changes: the sizes of its sources, stores and drives, whatever its powertrain.

Each *size* is one or more numbers of the vehicle that change together in proportion: factors on the torque of engines, motors and what
must follow an engine, numbers of modules or of cells.  Sizes are whole numbers of steps, 0.001 of a factor or one module, so that
a search ends at the smallest that will do and not somewhere near it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

from halfshaft.library.base.errors import number
from halfshaft.library.base.tags import Tag, part_of
from halfshaft.models.vehicle import Vehicle

#: Engines and fuel cells; batteries and ultracapacitors; motors that drive.
Kind: TypeAlias = Literal["source", "store", "drive"]
KINDS: tuple[Kind, ...] = get_args(Kind)
TAGS: Mapping[Kind, Tag] = {"source": "source size", "store": "store size", "drive": "drive size"}
#: What limits of a size are told in.
UNITS: Mapping[Kind, str] = {"source": "W", "store": "modules", "drive": "W"}
#: What is shown of a size: its name, unit, what that is in SI, and digits.
NAMED: Mapping[Kind, tuple[str, str, float, int]] = {
    "source": ("source", "kW", 1e3, 1), "store": ("store", "modules", 1.0, 0), "drive": ("drive", "kW", 1e3, 1),
}  # fmt: skip
#: Highest voltage of a store where nothing else says what it may be [V].
U_USUAL = 480.0
#: Step of a factor.
FINE = 0.001


@dataclass(frozen=True)
class Bounds:
    """Between which sizes are sought.

    Parameters
    ----------
    power
        Least power of source and of drive [W].
    factor
        Largest factor on source and on drive.
    U_highest
        Highest voltage of a store [V]; without it five times the lowest supply voltage.

    """

    power: Mapping[Kind, float]
    factor: Mapping[Kind, float]
    U_highest: float | None


@dataclass(frozen=True)
class Size:
    """A size: by name the numbers that change together, and what each is of the first; `low` and `high` are in steps."""

    kind: Kind
    shares: Mapping[str, float]
    counted: frozenset[str]
    low: int
    high: int

    @property
    def first(self) -> str:
        """The number that tells the size."""
        return next(iter(self.shares))

    @property
    def step(self) -> float:
        """What a step is of the first number."""
        return 1.0 if self.first in self.counted else FINE

    def values(self, k: int) -> dict[str, float]:
        """Return the numbers at a size of k steps."""
        first = round(k * self.step, 3)
        values = {name: share * first for name, share in self.shares.items()}
        return {name: max(1.0, float(round(x))) if name in self.counted else round(x, 6) for name, x in values.items()}

    def within(self, k: int) -> int:
        """Return the nearest size within the limits."""
        return min(max(k, self.low), self.high)


def power(vehicle: Vehicle, kind: Kind) -> float:
    """Return the power of a vehicle's sources, stores or drives [W]: what they bring, or can turn into motion."""
    parts = vehicle.tags.by_part(TAGS[kind])
    sets = [vehicle.parameters[part] for part in parts]
    return sum(p.ratings().get("traction power", 0.0) if kind == "drive" else p.P_own for p in sets)


def amount(vehicle: Vehicle, kind: Kind) -> float:
    """Return a size as limits tell it: power [W], or the number of modules."""
    return sum(vehicle.values[name] for name in vehicle.tags.all_of(TAGS[kind])) if kind == "store" else power(vehicle, kind)


def sizes_of(vehicle: Vehicle, kinds: tuple[Kind, ...], bounds: Bounds, limits: Mapping[Kind, tuple[float, float]]) -> dict[Kind, Size]:
    """Return the sizes of a vehicle that can change.

    Parameters
    ----------
    vehicle
        The vehicle.
    kinds
        Which may change.
    bounds
        Between which they are sought where nothing else is said.
    limits
        Lowest and highest by kind, in W or modules, in place of those.

    """
    found = {}
    for kind in kinds:
        names = vehicle.tags.all_of(TAGS[kind])
        if not names:
            continue
        followers = vehicle.tags.all_of("follows source") if kind == "source" else []
        first = vehicle.values[names[0]]
        # What is at least 1 is counted, all else is a factor.
        counted = frozenset(name for name in (*names, *followers) if vehicle.specs[name].ge == 1)
        step = 1.0 if names[0] in counted else FINE
        # How much of the unit of the limits a step of the first number is.
        per_step = amount(vehicle, kind) / first * step
        if kind in limits:
            low, high = limits[kind]
        elif kind == "store":
            low, high = _modules(vehicle, bounds)
        else:
            low, high = bounds.power[kind], bounds.factor[kind] * (first if names[0] in counted else 1.0) / step * per_step
        spec = vehicle.specs[names[0]]
        n_low = max(math.ceil(low / per_step - 1e-9), math.ceil((spec.lowest or 0.0) / step), 1)
        n_high = max(n_low, math.floor(min(high / per_step + 1e-9, (spec.highest or math.inf) / step)))
        shares = {name: vehicle.values[name] / first for name in (*names, *followers)}
        found[kind] = Size(kind, shares, counted, n_low, n_high)
    return found


def _modules(vehicle: Vehicle, bounds: Bounds) -> tuple[float, float]:
    """Return the numbers of modules between which the voltage serves what hangs on the store."""
    tags, values = vehicle.tags, vehicle.values
    U_needed = max((values[name] for name in tags.all_of("lowest supply voltage")), default=0.0)
    u_min, u_max = values[tags.all_of("lowest module voltage")[0]], values[tags.all_of("highest module voltage")[0]]
    U_highest = bounds.U_highest or 5 * U_needed or U_USUAL
    n = len(tags.all_of(TAGS["store"]))
    low = n * max(1.0, math.ceil(U_needed / (u_min or u_max) - 1e-9))
    return low, max(low, n * math.floor(U_highest / u_max))


def problems(kinds: tuple[Kind, ...], limits: Mapping[Kind, tuple[float, float]]) -> list[str]:
    """Return what is wrong with what is to change, and with its limits, whatever the vehicle."""
    found = [f"size {kind!r}: must be {' or '.join(KINDS)}" for kind in dict.fromkeys((*kinds, *limits)) if kind not in KINDS]
    for kind, ends in limits.items():
        if not (isinstance(ends, tuple | list) and len(ends) == 2):
            found.append(f"limits of {kind} = {ends!r}, must be the lowest and the highest")
        elif not 0 < number(ends[0]) <= number(ends[1]) < math.inf:
            found.append(f"limits of {kind} = {ends[0]!r} to {ends[1]!r} {UNITS.get(kind, '')}, must rise from > 0")
        elif kind in KINDS and kinds and kind not in kinds:
            found.append(f"limits of {kind}, which is not to change")
    return found


def misfits(vehicle: Vehicle, kinds: tuple[Kind, ...]) -> list[str]:
    """Return which sizes a vehicle does not have."""
    there = [kind for kind in KINDS if vehicle.tags.all_of(TAGS[kind])]
    if not there:
        return [f"vehicle '{vehicle.name}' has no source, store or drive that could change its size"]
    missing = [kind for kind in dict.fromkeys(kinds) if kind in KINDS and kind not in there]
    return [f"size {kind}: vehicle '{vehicle.name}' has {' and '.join(there)}" for kind in missing]


def pinned(vehicle: Vehicle) -> Vehicle:
    """Return the vehicle with factors in place of the ratings that were given: a pack of more modules stores more."""
    rated = {name: r for name, r in vehicle.rated.items() if name in vehicle.given}
    factors = {name: f"{part_of(name)}.{r.scale}" for name, r in rated.items()}
    return vehicle.with_values({factor: vehicle.values[factor] for factor in factors.values()}) if factors else vehicle
