"""The main figures of many runs: those of `Result.figures`, by the same formulas, for arrays.

What the vehicle does not have is left out; what a run does not have, such as an economy without distance, is NaN.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from halfshaft.cosim.result import GENSET_NOMINAL, GENSET_RAN
from halfshaft.cosim.units import mpg, mpge
from halfshaft.library.base.tags import Tag
from halfshaft.models.assembly import Step

#: What a figure needs of the runs: an output, and what of it.
Get = Callable[[str, str], Any]
#: Unit of a figure by the end of its name, the longest that fits.
UNITS = {
    "_m": "m", "_s": "s", "_L": "L", "_J": "J", "_W": "W", "_kg": "kg", "_mps": "m/s", "_mps2": "m/s^2", "_L_per_100km": "L/100 km",
    "_mpg": "mpg", "_Wh_per_km": "Wh/km", "_kWh_per_100km": "kWh/100 km", "_MPGe": "mpg", "_percent": "%",
}  # fmt: skip
#: What is shown of a study unless other figures are asked for.
MAIN = (
    "time_0_to_100_kmh_s", "grade_percent", "top_speed_mps", "fuel_equivalent_L_per_100km", "fuel_economy_L_per_100km",
    "energy_Wh_per_km", "soc_end", "trace_miss_max_mps",
)  # fmt: skip


def main_of(names: Iterable[str]) -> list[str]:
    """Return which of the figures of some tasks are shown unless others are asked for."""
    return [name for name in names if name.rpartition(".")[2] in MAIN]


def unit_of(figure: str) -> str:
    """Return the unit of a figure."""
    return UNITS.get(_end(figure), "1")


def title_of(figure: str) -> str:
    """Return the name of a figure in words, without its unit."""
    return figure.removesuffix(_end(figure)).replace("_", " ").replace(".", ": ")


def _end(figure: str) -> str:
    return next((end for end in sorted(UNITS, key=len, reverse=True) if figure.endswith(end)), "")


def needs(step: Step) -> Iterator[tuple[str, str]]:
    """Yield the outputs that the figures need, and what of each."""
    tags: tuple[tuple[Tag, str], ...] = (
        ("distance", "last"), ("fuel mass", "last"), ("traction input", "integral"), ("charge", "first"), ("charge", "last"),
        ("miss", "max"), ("overspeed", "max"),
    )  # fmt: skip
    for tag, how in tags:
        yield from ((name, how) for name in step.tags.all_of(tag) if name in step.output_index)
    booked = ("stored", "fuel") if _burns(step) else ("stored",)
    yield from ((d.name, "integral") for d in step.outputs if d.booking in booked)
    if _burns(step) and _stores(step):
        yield from ((name, "integral") for name in step.tags.all_of("generated"))


def _burns(step: Step) -> bool:
    return bool(step.tags.all_of("fuel mass"))


def _stores(step: Step) -> bool:
    return any(d.booking == "stored" for d in step.outputs)


def end_states(step: Step) -> Iterator[tuple[str, str]]:
    """Yield the states that are shown and that no figure has."""
    told = [name for tag in ("distance", "charge", "fuel mass") for name in step.tags.all_of(tag)]
    yield from ((d.name, "last") for d in step.outputs if d.state is not None and d.name not in told)


def figures(step: Step, get: Get, p: Mapping[str, Any], ratings: Mapping[str, Mapping[str, Any]], duration: Any) -> dict[str, Any]:
    """Return the figures.

    Parameters
    ----------
    step
        What ran.
    get
        Gives what `needs` asks for.
    p
        Numbers by ``role.parameter``.
    ratings
        What the parts are rated at, by role.
    duration
        Of each run [s].

    """
    tags = step.tags
    booked = {b: sum(get(d.name, "integral") for d in step.outputs if d.booking == b) for b in ("stored", "fuel")}
    distance, battery = get(tags.the("distance"), "last"), booked["stored"]
    energies, powers = ({role: r[what] for role, r in ratings.items() if what in r} for what in ("energy", "traction power"))
    out = {"distance_m": distance, "duration_s": duration}
    burnt = {part: get(name, "last") for part, name in tags.by_part("fuel mass").items()}
    moved = _over(distance > 0)
    if burnt:
        density, heating = ({part: p[n] for part, n in tags.by_part(tag).items()} for tag in ("fuel density", "fuel heating value"))
        fuel = out["fuel_L"] = sum(1e3 * mass / density[part] for part, mass in burnt.items())
        out["fuel_economy_L_per_100km"] = per_100km = moved(1e5 * fuel, distance)
        out["fuel_economy_mpg"] = _over(per_100km > 0)(mpg(1.0), per_100km)
        if _stores(step):
            generated = sum(get(name, "integral") for name in tags.all_of("generated"))
            own = (generated > 0) & (booked["fuel"] > GENSET_RAN * np.abs(battery))
            efficiency = np.where(own, np.divide(generated, booked["fuel"], where=own, out=np.full(own.shape, np.nan)), GENSET_NOMINAL)
            energy = [1e-3 * density[part] * heating[part] for part in burnt]
            per_litre = np.where(fuel > 0, _over(fuel > 0)(booked["fuel"], fuel), sum(energy) / len(energy))
            out["fuel_equivalent_L"] = fuel + battery / efficiency / per_litre
            out["fuel_equivalent_L_per_100km"] = moved(1e5 * out["fuel_equivalent_L"], distance)
            out["fuel_equivalent_efficiency"] = efficiency
    if _stores(step):
        out["energy_from_battery_J"] = battery
        if not burnt:
            drawn = (distance > 0) & (battery > 0)
            out["energy_Wh_per_km"] = _over(drawn)(battery / 3.6, distance)
            out["energy_MPGe"] = mpge(out["energy_Wh_per_km"])
            if energies:
                out["range_m"] = _over(drawn)(sum(energies.values()) * distance, battery)
    if energies:
        out["pack_energy_J"] = sum(energies.values())
    if powers:
        out["motor_power_max_W"] = sum(powers.values())
    if inputs := tags.all_of("traction input"):
        out["motor_input_J"] = sum(get(name, "integral") for name in inputs)
    charges = {part: name for part, name in tags.by_part("charge").items() if name in step.output_index}
    for name, how in (("soc_start", "first"), ("soc_end", "last")) if charges else ():
        found = np.array([get(charge, how) for charge in charges.values()])
        rated = energies if energies.keys() >= charges.keys() else dict.fromkeys(charges, 1.0)
        weights = np.array([np.broadcast_to(rated[part], found.shape[1:]) for part in charges])
        out[name] = found[0] if len(found) == 1 else np.average(found, axis=0, weights=weights)
    for name, tag in (("trace_miss_max_mps", "miss"), ("overspeed_max_mps", "overspeed")):
        out[name] = np.maximum(np.max([get(n, "max") for n in tags.all_of(tag) if n in step.output_index], axis=0), 0.0)  # type: ignore[arg-type]
    return out


def _over(where: Any) -> Callable[[Any, Any], Any]:
    """Return a division that gives NaN elsewhere."""
    return lambda a, b: np.divide(a, b, where=where, out=np.full(np.shape(where), np.nan))
