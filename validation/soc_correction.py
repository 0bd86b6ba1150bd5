"""Zero-delta and linear correction of every hybrid of the library, and where their difference comes from.

``python -m halfshaft.validation.soc_correction`` prints the table.  The account of a run closes, so the difference of two fuels over a
distance is, to the last bit, what the one vehicle lost and stored more than the other, part by part.  For the linear correction that
is a mixture of its two runs, in which the charge that one gains the other loses: all that energy goes through the battery and back, and
the engine runs at other loads.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from halfshaft.cosim.cycle import Cycle
from halfshaft.cosim.result import Result
from halfshaft.cosim.simulate import run
from halfshaft.library.base.tags import part_of
from halfshaft.models.vehicle import Vehicle, vehicle_names
from halfshaft.studies.conditions import is_hybrid
from halfshaft.studies.procedure import kinds_of
from halfshaft.studies.soc_correction import Corrected, Linear, ZeroDelta, started

CYCLES = ("udds", "hwfet", "us06", "nedc")
#: Runs within which a hybrid that keeps its charge converges.
MOST_RUNS = 8
#: Relative difference of the two fuels that needs no reason, and least share of one that is told [1].
ALIKE, TOLD = 0.01, 0.003


@dataclass(frozen=True)
class Row:
    """One vehicle on one cycle; `reasons` are shares of the zero-delta fuel by what takes them, and add up to the difference."""

    vehicle: str
    cycle: str
    #: Whether the control keeps the charge, and does not use it up first.
    keeps: bool
    zero: Corrected
    linear: Corrected
    reasons: Mapping[str, float]

    @property
    def difference(self) -> float | None:
        """Linear fuel over zero-delta fuel, less one; None where there is no linear one."""
        a, b = (x.figures["fuel_economy_L_per_100km"] for x in (self.zero, self.linear))
        return None if a is None or b is None else b / a - 1

    def said(self) -> str:
        """Return where the difference comes from."""
        if self.difference is None:
            return "none: the charge moved the same way from both ends of the window"
        if abs(self.difference) <= ALIKE:
            return ""
        return ", ".join(f"{what} {100 * x:+.1f} %" for what, x in self.reasons.items() if abs(x) > TOLD)


def rows(names: Iterable[str] | None = None, cycles: Iterable[str] = CYCLES) -> Iterator[Row]:
    """Yield the rows of vehicles; without names, of every hybrid of the library."""
    for name in vehicle_names() if names is None else names:
        car = Vehicle.load(name)
        if not is_hybrid(car):
            continue
        for cycle in map(Cycle.load, cycles):
            zero, linear = ZeroDelta(cycle=cycle)(car), Linear(cycle=cycle)(car)
            runs = [run(started(car, t.soc), cycle) for t in linear.record]
            shares = [1.0]
            if len(runs) == 2:
                first, second = (t.change for t in linear.record)
                shares = [second / (second - first), first / (first - second)]
            reasons = _reasons(zero.result, list(zip(runs, shares, strict=True))) if linear.status == "converged" else {}
            yield Row(name, cycle.name, "plug-in" not in kinds_of(car), zero, linear, reasons)


def _reasons(zero: Result, mixture: list[tuple[Result, float]]) -> dict[str, float]:
    """Return what the mixture takes more than the zero-delta run, over the fuel of that, by what takes it; the largest first."""
    base = _taken(zero)
    more: dict[str, float] = {}
    for result, share in mixture:
        for what, x in _taken(result).items():
            more[what] = more.get(what, 0.0) + share * x
    fuel = zero.account.fuel / zero.figures["distance_m"]
    found = {what: (more.get(what, 0.0) - x) / fuel for what, x in base.items()}
    return dict(sorted(found.items(), key=lambda item: -abs(item[1])))


def _taken(result: Result) -> dict[str, float]:
    """Return what takes the fuel's energy, per distance [J/m]."""
    a, distance = result.account, result.figures["distance_m"]
    taken: dict[str, float] = {"charge left": -a.battery}
    for name, x in a.losses.items():
        part = part_of(name).replace("_", " ")
        taken[part] = taken.get(part, 0.0) + x
    taken["motion and method"] = a.kinetic + a.potential + a.speed_mismatch + a.inertia_discretisation + a.speed_limit
    return {what: x / distance for what, x in taken.items()}


def table(found: Iterable[Row]) -> Iterator[str]:
    """Yield the lines of the table in Markdown."""
    yield "| vehicle | cycle | status | runs | change of charge | battery over fuel | zero-delta [L/100 km] | linear | difference | from |"
    yield "|---|---|---|--:|--:|--:|--:|--:|--:|---|"
    for row in found:
        last, fuels = row.zero.record[-1], [x.figures["fuel_economy_L_per_100km"] for x in (row.zero, row.linear)]
        zero, linear = ("-" if x is None else f"{x:.3f}" for x in fuels)
        ratio = "-" if last.energy_ratio is None else f"{100 * last.energy_ratio:+.2f} %"
        difference = "-" if row.difference is None else f"{100 * row.difference:+.1f} %"
        numbers = f"{len(row.zero.record)} | {last.change:+.4f} | {ratio} | {zero} | {linear} | {difference}"
        yield f"| {row.vehicle} | {row.cycle} | {row.zero.status} | {numbers} | {row.said()} |"


if __name__ == "__main__":
    for line in table(rows(sys.argv[1:] or None)):
        sys.stdout.write(f"{line}\n")
