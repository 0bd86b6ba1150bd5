"""Optimal energy management: the least fuel that a cycle takes with a vehicle's own parts, as a yardstick of its control.

Of a hybrid everything stays as it is but the decisions of its controls: whether the source runs, what it gives, and the gear.  These come
from outside (`halfshaft.library.base.component.Command`), and two methods look for the best ones, both on the exact step, over the whole
cycle, and with the charge at the end that the control in use ends with:

*ECMS* gives the store's energy a price and minimises the fuel less what that energy is worth; the price (the equivalence factor, the
co-state of Pontryagin's principle) is that at which the charge is kept, found by search for a root.  What a start or a change of gear
costs shows a step later, so decisions that last are looked ahead for; a minimum taken step by step would never start an engine that must
spin up first.  Where a price decides all or nothing, as between running always and never, no price keeps the charge: so it falls as the
store fills (`BEND`), and where maps are straight two neighbouring prices are paid one after the other.

*Dynamic programming* tells vehicles apart by their charge too.  Forward in time each of them is stepped with each command, and where
several come to the same place the one that burnt least is kept, with its whole state.  So no value is interpolated, and each fuel that is
found is had by commands which the step obeys.  It begins with places in a corridor around the charge of ECMS, which is narrowed around the
best that was found; with more places and commands its fuel falls toward the least.

The control in use is held against both where all three start and end with the same charge: a difference of fuel then needs no correction.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias, get_args

import numpy as np

from halfshaft.cosim.compiled import Array
from halfshaft.cosim.cycle import Cycle
from halfshaft.cosim.result import Result
from halfshaft.cosim.simulate import recorded, run
from halfshaft.cosim.units import Units, shown
from halfshaft.library.base.errors import InputError, SolveError, nearest, not_a, number
from halfshaft.library.base.tags import Tag, part_of
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.crew import cores
from halfshaft.studies.optimal.search import HAIR, Bounds, Ends, Found, Problem
from halfshaft.studies.soc_correction import ZeroDelta, check_correctable

if TYPE_CHECKING:
    import xarray as xr

    from halfshaft.cosim.plot import Picture

#: What the charge at the end shall be: as at the start, as far as the control in use can keep it; or whatever that leaves of it.
Charge: TypeAlias = Literal["kept", "used"]
CHARGES: tuple[Charge, ...] = get_args(Charge)
#: Prices that are tried at once, the first ones, and how often their range is cut.
PRICES, LOWEST, HIGHEST, CUTS = 16, 0.5, 12.0, 3
#: So many searches may find no price that keeps the charge.
MOST_DEAD = 4
#: The corridor's first half width over the range of the charge, and by how much it is narrowed.
WIDE, NARROWED = 0.5, 0.3
#: Most passes, and how many that gain less than a share of the fuel are the last ones.
PASSES, ENOUGH, GAIN = 8, 2, 5e-4
#: A corridor is touched where the charge comes as near to its edge, as a share of its half width.
TOUCHED = 0.8
#: By how much of itself the price of ECMS falls from an empty to a full store.
BEND = 1.0
#: Charges that are the same.
SAME = 1e-12
#: Where the charge ends if the store does not say.
LIMITS: tuple[tuple[Tag, float], ...] = (("empty charge", 0.0), ("full charge", 1.0))
#: What is noted of a run.
OBEYED = "the controls obeyed commands: {}"


class Way(NamedTuple):
    """A way to drive the cycle: the run, and what was commanded at each step, by name; nothing where the controls decided."""

    name: str
    result: Result
    commands: Mapping[str, Array]

    @property
    def fuel(self) -> float:
        """Energy of the fuel [J]."""
        return self.result.account.fuel


class Pass(NamedTuple):
    """A pass of dynamic programming: half width of its corridor, and the energy of the fuel that it found [J]."""

    half_width: float
    fuel: float


@dataclass(frozen=True)
class Optimum:
    """What a control does, and the best that can be done.

    Parameters
    ----------
    vehicle, cycle
        What was driven, with the charge that it starts with.
    in_use, ecms, best
        The control in use; ECMS; and the least fuel that was found.
    price
        What ECMS paid for the store's energy: that of fuel over it, the equivalence factor.
    passes
        The passes of dynamic programming.
    notes
        What a user should know.

    """

    vehicle: Vehicle
    cycle: Cycle
    in_use: Way
    ecms: Way
    best: Way
    price: float
    passes: tuple[Pass, ...]
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"<Optimum {self.vehicle.name} over {self.cycle.name}: the control in use burns {100 * self.excess(self.in_use):.1f} % more>"

    @property
    def ways(self) -> tuple[Way, ...]:
        """All three, the control in use first."""
        return self.in_use, self.ecms, self.best

    def charge(self, way: Way) -> Array:
        """Return the state of charge over time."""
        return way.result.the("charge")

    def fuel(self, way: Way) -> float:
        """Return the energy of the fuel, less the price of the charge that a way ends with beyond that of the control in use [J]."""
        surplus = float(self.charge(way)[-1] - self.charge(self.in_use)[-1])
        return way.fuel - self.price * surplus * float(self.in_use.result.figures["pack_energy_J"])

    def excess(self, way: Way) -> float:
        """Return how much more fuel a way takes than the best one, over that."""
        return self.fuel(way) / self.fuel(self.best) - 1

    def figures(self) -> dict[str, dict[str, float]]:
        """Return the numbers of each way, SI or the unit in the names' endings."""
        found = {}
        for way in self.ways:
            f, tags = way.result.figures, way.result.tags
            source = [way.result[f"{part_of(name)}.P_out"] for name in tags.all_of("fuel mass")]
            running = np.any([np.abs(x) > 1.0 for x in source], axis=0)
            found[way.name] = {
                "fuel_L_per_100km": f["fuel_economy_L_per_100km"],
                "fuel_J": way.fuel,
                "fuel_at_equal_charge_J": float(self.fuel(way)),
                "excess": float(self.excess(way)),
                "soc_start": f["soc_start"],
                "soc_end": f["soc_end"],
                "source_share_of_time": float(np.average(running, weights=way.result.dt)),
                "source_starts": int(np.sum(np.diff(running.astype(int), prepend=0) > 0)),
                "trace_miss_max_mps": f["trace_miss_max_mps"],
            }
        return found

    @cached_property
    def dataset(self) -> xr.Dataset:
        """All outputs of the three ways and what was commanded, over ``way`` and ``time``."""
        import xarray as xr  # takes a fifth of a second

        data = xr.concat([way.result.dataset for way in self.ways], "way", combine_attrs="drop")
        for name in self.best.commands:
            rows = [way.commands.get(name, np.full(len(way.result.time), np.nan)) for way in self.ways]
            data[name] = (("way", "time"), np.array(rows), {"units": "1", "long_name": "command"})
        title = f"{self.vehicle.name} over {self.cycle.name}: control in use, ECMS and best"
        return data.assign_coords(way=[way.name for way in self.ways]).assign_attrs(title=title)

    def rows(self, units: Units = "metric") -> list[tuple[str, ...]]:
        """Return the lines of a table: name, fuel, that over the best, charge at both ends, time and starts of the source."""
        lines = []
        for name, f in self.figures().items():
            fuel = shown("economy", f["fuel_L_per_100km"], units).partition(" ")[0]
            charges = (f"{100 * f[end]:.2f}" for end in ("soc_start", "soc_end"))
            lines.append(
                (name, fuel, f"{100 * f['excess']:.2f}", *charges, f"{100 * f['source_share_of_time']:.0f}", f"{f['source_starts']:.0f}")
            )
        return lines

    def plot(self, *, units: Units = "metric", path: str | Path | None = None) -> Picture:
        """Draw speed, power split, gears, charge and fuel of the control in use and of the best way."""
        from halfshaft.studies.optimal.picture import plot_optimum  # matplotlib takes a quarter of a second

        return plot_optimum(self, units=units, path=path)


def optimal(
    vehicle: Vehicle,
    cycle: Cycle,
    *,
    charge: Charge | None = None,
    keep: Sequence[str] = (),
    window: tuple[float, float] | None = None,
    places: int = 100,
    points: int = 21,
    dt: float = 1.0,
    threads: int | None = None,
) -> Optimum:
    """Look for the least fuel with which a hybrid drives a cycle that is known.

    Parameters
    ----------
    vehicle, cycle
        What is driven.
    charge
        ``kept``: the control in use starts with the charge that it keeps over the cycle (`halfshaft.studies.soc_correction.ZeroDelta`);
        ``used``: it starts with the vehicle's own and uses what it does.  The best way starts with the same charge, and ends with no less.
        Without it ``used`` for what uses its charge up first, as plug-in hybrids do, else ``kept``.
    keep
        Parts that keep their own law: ``("shift",)`` leaves the gears to the control in use.
    window
        State of charge that is not left on the way; without it all that the store can give and take.
    places
        Charges that dynamic programming tells apart.
    points
        Values that are tried of a command with a range.
    dt
        Length of the step [s].
    threads
        How many; without it as many as this program may use cores.

    Raises
    ------
    InputError
        If the vehicle burns nothing or stores nothing, or an argument is not what it must be; everything that is wrong is named at once.
    SolveError
        If nothing drives the cycle within the window.

    """
    _check(vehicle, cycle, charge, keep, window, places, points, dt, threads)
    charge = charge or ("used" if _depletes(vehicle) else "kept")
    notes: tuple[str, ...] = ()
    if charge == "kept":
        corrected = ZeroDelta(cycle=cycle, dt=dt)(vehicle)
        in_use, vehicle = corrected.result, corrected.result.vehicle
        if corrected.status != "converged":
            notes = (f"the control in use does not keep its charge: {len(corrected.record)} runs were tried",)
    else:
        in_use = run(vehicle, cycle, dt=dt)
    if in_use.figures["trace_miss_max_mps"] > in_use.inputs.parameters[in_use.tags.the("miss threshold")]:
        notes = (*notes, "the control in use misses the trace: the other ways may be as slow there, but no slower")
    if not in_use.account.fuel > 0:
        told = f"the control in use burns no fuel over {cycle.name}, so none can be saved; drive further, or start with less charge"
        raise InputError(f"optimum of '{vehicle.name}'", [told])
    free = tuple(name for name in vehicle.model().commandable if name not in keep)
    problem = Problem(vehicle, free, cycle.sampled(dt))
    return _Task(problem, cycle, in_use, window, places, points, dt, threads or cores()).optimum(notes)


@dataclass(frozen=True, eq=False)
class _Task:
    """What is looked for."""

    problem: Problem
    cycle: Cycle
    in_use: Result
    window: tuple[float, float] | None
    places: int
    points: int
    dt: float
    threads: int

    @cached_property
    def target(self) -> float:
        """Charge at the end, at least."""
        return float(self.in_use.the("charge")[-1]) - SAME

    @cached_property
    def bounds(self) -> Bounds:
        """What may be after each step: as fast as asked for, or as the control in use could; a charge within the window."""
        asked, reached, charge = self.problem.samples.v, self.in_use.the("speed"), self.in_use.the("charge")
        ones, vehicle = np.ones_like(asked), self.problem.vehicle
        ends = (vehicle.values[vehicle.tags.all_of(tag)[0]] if vehicle.tags.all_of(tag) else end for tag, end in LIMITS)
        low, high = self.window or ends
        if self.window is None:
            low, high = min(low, charge.min() - HAIR), max(high, charge.max() + HAIR)
        n, figures = len(ones), self.in_use.figures
        plan = -self.in_use.account.battery * np.arange(1, n + 1) / n
        bend = BEND / figures["pack_energy_J"]
        return Bounds(bend, plan, low * ones, high * ones, np.minimum(asked, reached) - HAIR, np.maximum(asked, reached) + HAIR)

    @cached_property
    def candidates(self) -> Array:
        """What may be commanded."""
        return self.problem.candidates(self.points)

    def optimum(self, notes: tuple[str, ...]) -> Optimum:
        """Look for the best way."""
        ecms, price = self.ecms()
        passes = list[tuple[float, Found]]()
        try:
            for done in self.narrowing(ecms, price):
                passes.append(done)
        except KeyboardInterrupt:
            notes = (*notes, f"interrupted after {len(passes)} passes: the best so far")
        found = min((ecms, *(x for _, x in passes)), key=lambda x: x.fuel)
        vehicle = self.problem.vehicle
        ways = (Way("control in use", self.in_use, {}), self.way("ECMS", ecms), self.way("best", found))
        return Optimum(vehicle, self.cycle, *ways, price, tuple(Pass(half, x.fuel) for half, x in passes), notes)

    def narrowing(self, ecms: Found, price: float) -> Iterator[tuple[float, Found]]:
        """Yield what dynamic programming finds in narrower and narrower corridors, with their half widths."""
        least, reference, idle = ecms.fuel, self.charge_of(ecms), 0
        half = WIDE * max(float(np.ptp(reference)), 2 * float(np.abs(np.diff(reference)).max(initial=HAIR)))
        for _ in range(PASSES):
            low, high = self.bounds.low, self.bounds.high
            corridor = self.bounds._replace(low=np.maximum(low, reference - half), high=np.minimum(high, reference + half))
            ends = self.problem.search(self.candidates, np.array([price]), self.places, corridor, self.threads)
            if (found := self.least(ends)) is None:
                return
            yield half, found
            idle = idle + 1 if least - found.fuel < GAIN * least else 0
            if idle == ENOUGH:
                return
            least, before, reference = min(least, found.fuel), reference, self.charge_of(found)
            if idle or np.max(np.abs(reference - before)) < TOUCHED * half:
                half *= NARROWED

    def ecms(self) -> tuple[Found, float]:
        """Return the commands of least fuel less the worth of the charge, and the lowest price of it that keeps it.

        Where maps are straight a price decides all or nothing.  So the higher one of two that lie next to each other is paid up to some
        step, then the lower one, with which the charge would not be kept.
        """
        low, high, kept = self.prices()
        n = len(self.problem.samples.t)
        first, last = 0, n
        while last - first > 1:
            switch = np.unique(np.linspace(first, last, PRICES).round().astype(int))
            ends = self.search(np.where(np.arange(n)[:, None] < switch, high, low))
            fit = [(int(at), x) for family, at in enumerate(switch) if (x := self.least(ends, family)) is not None]
            if not fit:
                break
            kept += [x for _, x in fit]
            last = fit[0][0]
            first = max((int(at) for at in switch if at < last), default=last)
        return min(kept, key=lambda x: x.fuel), high

    def prices(self) -> tuple[float, float, list[Found]]:
        """Return two prices next to each other, of which the higher one keeps the charge, and ways that keep it.

        Raises
        ------
        SolveError
            If no price keeps it.

        """
        prices, cuts, kept = np.geomspace(LOWEST, HIGHEST, PRICES), 0, list[Found]()
        for _ in range(CUTS + MOST_DEAD):
            ends = self.search(prices)
            best = [self.least(ends, family) for family in range(len(prices))]
            enough = [i for i, x in enumerate(best) if x is not None]
            # What is left on the way has another price: too low a one, as a rule, leaves the store empty.
            short = [i for i in set(ends.end[:, 0].astype(int).tolist()) if i not in enough]
            if enough:
                kept += [x for x in best if x is not None]
                low, high, cuts = prices[enough[0] - 1] if enough[0] else 0.0, prices[enough[0]], cuts + 1
                if cuts == CUTS:
                    return low, high, kept
                prices = np.linspace(low, high, PRICES)
            elif short and max(short) + 1 < len(prices):
                prices = np.linspace(prices[max(short)], prices[max(short) + 1], PRICES)
            elif short:
                prices = prices[-1] * np.geomspace(1, HIGHEST, PRICES)
            else:
                prices = np.geomspace(LOWEST, HIGHEST, 3 * len(prices))
        at = "" if ends.dead is None else f"; at t = {ends.dead:g} s nothing follows the trace any more"
        raise SolveError(f"{self.cycle.name}: no price of the charge leads to {self.target:.4f} at the end{at}")

    def search(self, prices: Array) -> Ends:
        """Search with prices alone: all charges have one place."""
        return self.problem.search(self.candidates, prices, 1, self.bounds, self.threads)

    def least(self, ends: Ends, family: int = 0) -> Found | None:
        """Return what leaves enough charge for the least fuel, at one of the prices; None where nothing does."""
        family_of, fuel, charge = ends.end.T
        fit = np.flatnonzero((family_of == family) & (charge >= self.target))
        return ends.found(int(fit[np.argmin(fuel[fit])])) if len(fit) else None

    def charge_of(self, found: Found) -> Array:
        """Return the charge over time under commands."""
        rows, _ = self.problem.replay(found.commands)
        return rows[:, self.problem.step.output_index[self.problem.step.tags.the("charge")]]

    def way(self, name: str, found: Found) -> Way:
        """Return commands as a way: the exact step under them.

        Raises
        ------
        SolveError
            If the exact step does not come to what was found.

        """
        problem = self.problem
        rows, state = problem.replay(found.commands)
        at = problem.step.state_index[problem.step.tags.the("charge")]
        if state[at] != found.charge:
            raise SolveError(f"{name}: the step ends with a charge of {state[at]!r}, the search with {found.charge!r}")
        result = recorded(problem.vehicle, self.cycle, problem.compiled, problem.samples, rows, self.dt, (OBEYED.format(name),))
        return Way(name, result, dict(zip(problem.step.commands, found.commands.T, strict=True)))


def _depletes(vehicle: Vehicle) -> bool:
    """Return whether the control uses the charge up first."""
    return any(vehicle.values[name] for name in vehicle.tags.all_of("depletes"))


def _check(vehicle: Any, cycle: Any, charge: Any, keep: Any, window: Any, places: Any, points: Any, dt: Any, threads: Any) -> None:
    """Raise an error with all that is wrong with the arguments."""
    where, problems = "optimum", not_a(Vehicle, vehicle=vehicle) + not_a(Cycle, cycle=cycle)
    if charge is not None and charge not in CHARGES:
        problems.append(f"charge = {charge!r}, must be {' or '.join(CHARGES)}")
    ends = [number(x) for x in window] if isinstance(window, Sequence) and len(window) == 2 else [np.nan]
    if window is not None and not (len(ends) == 2 and 0 <= ends[0] < ends[1] <= 1):
        problems.append(f"window = {window!r}, must be two charges, the lower one first, >= 0 and <= 1")
    for name, x, least, most in (("places", places, 2, 100_000), ("points", points, 2, 1000), ("threads", threads, 1, 64)):
        if not (x is None and name == "threads") and not (isinstance(x, int | np.integer) and least <= x <= most):
            problems.append(f"{name} = {x!r}, must be a whole number >= {least} and <= {most}")
    if not 0 < number(dt) < np.inf:
        problems.append(f"dt = {dt} s, must be a number > 0 s")
    if isinstance(cycle, Cycle) and not cycle.duration:
        problems.append(f"cycle {cycle.name} has no step")
    if isinstance(vehicle, Vehicle):
        where = f"optimum of '{vehicle.name}'"
        commandable = vehicle.model().commandable
        problems += [f"keep: {name} obeys no commands{nearest(name, commandable)}" for name in keep if name not in commandable]
        stores = vehicle.tags.all_of("start charge")
        if len(stores) > 1:
            problems.append(f"it has several stores, {' and '.join(map(part_of, stores))}: the charge of one is looked for")
        elif len(commandable) and not [name for name in commandable if name not in keep]:
            problems.append(f"keep: nothing is left to decide beside {', '.join(keep)}")
        try:
            check_correctable(vehicle)
        except InputError as error:
            problems += error.problems
    if problems:
        raise InputError(where, problems)
