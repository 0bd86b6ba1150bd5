"""Runs a test procedure: cycles with soaks in one go, bags, weights, and what follows from several tests.

Bags share the points at their ends, so that their distances add up to the whole.  (In the original the second bag of the FTP begins one
sample late, and that of hybrids does not.)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from halfshaft.cosim.compiled import Array
from halfshaft.cosim.cycle import Cycle
from halfshaft.cosim.remarks import SOC_EMPTY
from halfshaft.cosim.result import Result
from halfshaft.cosim.simulate import run
from halfshaft.cosim.ways import Mode
from halfshaft.library.base.errors import InputError, nearest
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.conditions import Conditions, charge_at, is_hybrid
from halfshaft.studies.economy import Consumption
from halfshaft.studies.procedure_file import Kind, Leg, Plan, Test
from halfshaft.studies.soc_correction import Search, Trial, first_charge, said_of, started, zero_delta
from halfshaft.studies.trace import ALLOWED, trace_figures

#: Key turns within this time [s]; speeds at the seam of two legs may differ by so much [m/s].
TURN, SEAM = 1e-6, 0.5
#: A cycle in which the battery gives no more than this share of what it takes to drive it keeps the charge (WLTP).
SUSTAINED = 0.04


class Span(NamedTuple):
    """When a leg is driven [s], in which round, and what it counts for."""

    start: float
    end: float
    round: int
    bag: str
    weight: float


@dataclass(frozen=True)
class Tested:
    """One test of a procedure: the run, the consumption by distance, what else was found, and how the charge was kept."""

    result: Result
    consumption: Consumption
    figures: Mapping[str, float | None]
    #: Distance at the end of each round [m], and consumption in each.
    rounds: tuple[tuple[float, Consumption], ...]
    search: Search[Result] | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Outcome:
    """What a procedure found.

    Parameters
    ----------
    figures
        By the names of tests and of what combines them, ``city_fuel_economy_mpg``; those to report come first.
    tests
        The tests that were driven.
    reported
        Names of the figures to report.
    notes
        What a user should know.

    """

    figures: Mapping[str, float | None]
    tests: Mapping[str, Tested]
    notes: tuple[str, ...] = ()
    reported: tuple[str, ...] = ()


@dataclass(frozen=True)
class Procedure:
    """The task to run a test procedure.

    Parameters
    ----------
    plan
        What is driven, as a file says it.
    mode, dt
        As in `run`.

    """

    plan: Plan
    mode: Mode = "hybrid"
    dt: float = 1.0

    @classmethod
    def load(cls, source: str | Path) -> Procedure:
        """Return a procedure of the library by name, or of a file ending in ``.toml``."""
        return cls(Plan.load(source))

    @property
    def name(self) -> str:
        """The procedure's name."""
        return self.plan.name

    def __call__(self, vehicle: Vehicle) -> Outcome:
        """Run the tests that are for such a vehicle.

        Raises
        ------
        InputError
            If none is, or a leg does not end with a step.

        """
        kinds = kinds_of(vehicle)
        tests = {test.name: self._tested(vehicle, test) for test in self.plan.tests if kinds & set(test.vehicles)}
        if not tests:
            wanted = dict.fromkeys(kind for test in self.plan.tests for kind in test.vehicles)
            what = f"vehicle '{vehicle.name}' is {' and '.join(sorted(kinds))}, and no test is for such: they are for {', '.join(wanted)}"
            raise InputError(f"procedure '{self.name}'", [what])
        consumptions = {name: tested.consumption for name, tested in tests.items()}
        for name, weighted in self.plan.weighted.items():
            if self.plan.utility and weighted.sustaining in tests:
                depleting, kept = tests.get(weighted.depleting), tests[weighted.sustaining].consumption
                rounds = depleting.rounds if depleting else ()
                parts = np.diff(self.plan.utility(np.array([0.0, *(distance for distance, _ in rounds)])))
                consumptions[name] = kept * (1 - float(parts.sum()))
                for part, (_, consumption) in zip(parts, rounds, strict=True):
                    consumptions[name] += consumption * float(part)
        for name, shares in self.plan.combined.items():
            found = {test: share for test, share in shares.items() if test in consumptions}
            if total := sum(found.values()):
                first, *others = (consumptions[test] * (share / total) for test, share in found.items())
                consumptions[name] = sum(others, first)
        figures = {f"{name}_{k}": x for name, consumption in consumptions.items() for k, x in consumption.figures().items()}
        figures |= {f"{name}_{k}": x for name, tested in tests.items() for k, x in tested.figures.items()}
        reported = [x for x in self.plan.report if x in figures]
        unknown = [x for x in self.plan.report if x not in reported and not _may_be(self.plan, x)]
        if unknown:
            raise InputError(f"procedure '{self.name}'", [f"report: no figure is called {x}{nearest(x, figures)}" for x in unknown])
        notes = (f"{name}: {note}" for name, tested in tests.items() for note in tested.notes)
        return Outcome({name: figures[name] for name in (*reported, *figures)}, tests, tuple(notes), tuple(reported))

    def _tested(self, vehicle: Vehicle, test: Test) -> Tested:
        """Return what a test finds."""
        warm = {} if test.temperature is None else dict.fromkeys(vehicle.tags.all_of("start temperature"), test.temperature)
        car = Conditions().applied(vehicle, test.soc, more=warm)
        search = None
        if test.repeat:
            result, spans, more, notes = self._repeated(car, test)
        else:
            cycle, spans = joined(test, 1)
            more, notes = {}, ()
            if test.correction == "zero-delta" and is_hybrid(vehicle):
                begins = next(i for i, span in enumerate(spans) if span.weight > 0)

                def drive(soc: float) -> tuple[Trial, Result]:
                    result = run(started(car, soc), cycle, mode=self.mode, dt=self.dt)
                    return Bags(spans, self.dt, result).trial(soc, begins), result

                soc = charge_at(car, test.soc)
                search = zero_delta(drive, first_charge(car) if soc is None else soc)
                result, notes = search.found, said_of(search)
                more = {"runs": float(len(search.record))}
            else:
                result = run(car, cycle, mode=self.mode, dt=self.dt)
        bags = Bags(spans, self.dt, result, self.plan.grid_efficiency)
        return Tested(result, bags.consumption(spans), {**bags.figures(), **more}, bags.rounds(), search, (*notes, *result.warnings))

    def _repeated(self, car: Vehicle, test: Test) -> tuple[Result, list[Span], dict[str, float | None], tuple[str, ...]]:
        """Return a run over as many rounds as it takes, and the spans that count."""
        assert test.repeat is not None
        repeat, n = test.repeat, test.repeat.at_least
        while True:
            cycle, spans = joined(test, n)
            result = run(car, cycle, mode=self.mode, dt=self.dt)
            bags = Bags(spans, self.dt, result)
            if repeat.until == "empty":
                if (i := bags.empty_at()) is not None:
                    # The range ends within a round: what is left of it does not count.
                    end = float(result.time[i])
                    cut = [span._replace(end=min(span.end, end)) for span in spans if span.start < end]
                    return result, cut, {"range_m": bags.distance_to(i), "rounds": float(cut[-1].round + 1)}, ()
            else:
                done = bags.sustained() if repeat.until == "sustaining" else bags.burnt()
                found = next((k for k in range(repeat.at_least - 1, n) if done[k]), None)
                if found is not None:
                    # The round that shows that the charge is kept depletes nothing.
                    last = found if repeat.until == "sustaining" and found > 0 else found + 1
                    kept = [span for span in spans if span.round < last]
                    return result, kept, {"rounds": float(last), "range_m": bags.distance_by(kept[-1].end)}, ()
            if n >= repeat.at_most:
                what = {"empty": "empty", "engine": "never helped by its engine", "sustaining": "still used up"}[repeat.until]
                note = f"after {n} rounds the battery is {'not ' if repeat.until == 'empty' else ''}{what}"
                more = {"range_m": None, "rounds": float(n)}
                return result, spans, more, (note,)
            n = min(2 * n, repeat.at_most)


def kinds_of(vehicle: Vehicle) -> set[Kind]:
    """Return what a vehicle is; a plug-in hybrid is one that uses its charge up first."""
    if not is_hybrid(vehicle):
        return {"electric"} if vehicle.tags.all_of("start charge") else {"fuel"}
    plugs = any(vehicle.values[name] > 0 for name in vehicle.tags.all_of("depletes"))
    return {"hybrid", "plug-in"} if plugs else {"hybrid"}


def _may_be(plan: Plan, figure: str) -> bool:
    """Return whether a figure belongs to a test or a combination that this vehicle does not have."""
    return any(figure.startswith(f"{name}_") for name in (*(t.name for t in plan.tests), *plan.combined, *plan.weighted))


def joined(test: Test, rounds: int) -> tuple[Cycle, list[Span]]:
    """Return one cycle of the legs of a test, driven so many times, and when each leg is driven."""
    pause = [Leg(soak=test.repeat.pause, weight=0.0)] if test.repeat and test.repeat.pause else []
    legs = [(leg, k) for k in range(rounds) for leg in (*(pause if k else ()), *test.legs)]
    only = legs[0][0]
    if len(legs) == 1 and only.cycle and only.start is None and only.end is None:
        c = only.cycle
        return c, [Span(float(c.time[0]), float(c.time[-1]), 0, only.bag, only.weight)]
    rows: list[tuple[Array, Array, Array, Array]] = []
    spans, now = [], 0.0
    for leg, k in legs:
        t, v, grade, key = _points(leg, test)
        if rows:
            before = [x[-1] for x in rows[-1]]
            if abs(v[0] - before[1]) > SEAM:
                raise InputError(
                    f"test '{test.name}'", [f"a leg begins at {v[0]:.3g} m/s where the one before ends at {before[1]:.3g} m/s"]
                )
            # The point at the seam is there already; the key turns right after it.
            turned = np.array([now + TURN]) if key[0] != before[3] else np.zeros(0)
            rows.append((turned, np.full(len(turned), v[0]), np.full(len(turned), grade[0]), np.full(len(turned), key[0])))
            t, v, grade, key = (x[1:] for x in (t, v, grade, key))
        rows.append((now + t, v, grade, key))
        end = now + (leg.soak if leg.cycle is None else float(t[-1]))
        spans.append(Span(now, end, k, leg.bag, leg.weight))
        now = end
    time, speed, grade, key_on = (np.concatenate(column) for column in zip(*rows, strict=True))
    sources = dict.fromkeys(leg.cycle.source for leg, _ in legs if leg.cycle)
    return Cycle(name=test.name, source="; ".join(sources), time=time, speed=speed, grade=grade, key_on=key_on), spans


def _points(leg: Leg, test: Test) -> tuple[Array, Array, Array, Array]:
    """Return time from the start of a leg, speed, grade and key."""
    if leg.cycle is None:
        return np.array([0.0, leg.soak]), np.zeros(2), np.zeros(2), np.zeros(2)
    c = leg.cycle
    if c.grade_by_distance is not None:
        raise InputError(f"test '{test.name}'", [f"cycle '{c.name}' has a grade over distance, which no part of a test can have"])
    start, end = (c.time[0] + (x if x is not None else d) for x, d in ((leg.start, 0.0), (leg.end, c.duration)))
    inside = c.time[(c.time > start) & (c.time < end)]
    t = np.concatenate([[start], inside, [end]])
    rows = (np.interp(t, c.time, x) if x is not None else np.full(len(t), d) for x, d in ((c.speed, 0.0), (c.grade, 0.0), (c.key_on, 1.0)))
    speed, grade, key = rows
    return t - start, speed, grade, key


@dataclass(frozen=True)
class Bags:
    """Sums of one run over the legs of a test."""

    spans: list[Span]
    dt: float
    result: Result
    grid_efficiency: float = 1.0

    @cached_property
    def ends(self) -> npt.NDArray[np.int64]:
        """Number of the steps until the end of each leg, and before the first."""
        r = self.result
        wanted = np.array([self.spans[0].start, *(span.end for span in self.spans)])
        times = np.concatenate([[r.t_start], r.time])
        found = np.searchsorted(times, wanted - 1e-3 * self.dt)
        found = np.minimum(found, len(times) - 1)
        off = np.abs(times[found] - wanted) > 1e-3 * self.dt
        if off.any():
            raise InputError(f"steps of {self.dt:g} s", [f"a leg ends at {wanted[off][0]:g} s, within a step"])
        return found

    def total(self, row: Array) -> Array:
        """Return the integral of a row over each leg."""
        sums = np.concatenate([[0.0], np.cumsum(row * self.result.dt)])
        return np.diff(sums[self.ends])

    @cached_property
    def distances(self) -> Array:
        """Distance driven in each leg [m]."""
        return np.diff(np.concatenate([[0.0], self.result.the("distance")])[self.ends])

    @cached_property
    def burnt_energy(self) -> Array:
        """Energy of the fuel burnt in each leg [J]."""
        return self._booked("fuel")

    @cached_property
    def stored(self) -> Array:
        """Energy that the batteries gave in each leg [J]."""
        return self._booked("stored")

    def _booked(self, booking: str) -> Array:
        rows = [self.total(self.result[d.name]) for d in self.result.outputs if d.booking == booking]
        return np.sum(rows, axis=0) if rows else np.zeros(len(self.spans))

    @cached_property
    def burnt_volume(self) -> Array:
        """Fuel burnt in each leg [L]."""
        r = self.result
        density = {part: r.inputs.parameters[name] for part, name in r.tags.by_part("fuel density").items()}
        masses = {part: np.concatenate([[0.0], r[name]])[self.ends] for part, name in r.tags.by_part("fuel mass").items()}
        burnt: Array = np.sum([1e3 * np.diff(m) / density[part] for part, m in masses.items()] or [np.zeros(len(self.spans))], axis=0)
        return burnt

    def consumption(self, spans: list[Span]) -> Consumption:
        """Return what is consumed per metre in some of the legs by their weights."""
        weights = np.array([span.weight if span in spans else 0.0 for span in self.spans])
        distance = float(weights @ self.distances)
        if distance <= 0:
            return Consumption(None, None, None)
        burns, stores = self.result.tags.all_of("fuel mass"), self.result.tags.all_of("charge")
        return Consumption(
            float(weights @ self.burnt_volume) / distance if burns else None,
            float(weights @ self.burnt_energy) / distance if burns else None,
            float(weights @ self.stored) / distance / self.grid_efficiency if stores else None,
        )

    def rounds(self) -> tuple[tuple[float, Consumption], ...]:
        """Return the distance at the end of each round, and its consumption."""
        numbers = dict.fromkeys(span.round for span in self.spans)
        return tuple(
            (float(self.distances[[s.round <= k for s in self.spans]].sum()), self.consumption([s for s in self.spans if s.round == k]))
            for k in numbers
        )

    def charge_at(self, i: int) -> float:
        """Return the mean state of charge after so many steps."""
        r = self.result
        charges = [r[name][i - 1] if i else r.first[name] for name in r.tags.all_of("charge")]
        return float(np.mean(charges))

    def trial(self, soc: float, begins: int) -> Trial:
        """Return the run as a trial of a correction; what counts begins with a leg."""
        first, last = int(self.ends[begins]), int(self.ends[-1])
        fuel, stored = float(self.burnt_energy[begins:].sum()), float(self.stored[begins:].sum())
        change = self.charge_at(last) - self.charge_at(first)
        economy = self.consumption(self.spans).figures()["fuel_economy_L_per_100km"]
        return Trial(soc, change, economy, stored / fuel if fuel > 0 else None)

    def figures(self) -> dict[str, float | None]:
        """Return what else there is to tell: charge, trace and bags."""
        r, first = self.result, int(self.ends[0])
        counted = [i for i, span in enumerate(self.spans) if span.weight > 0]
        begins, last = int(self.ends[counted[0]]), int(self.ends[-1])
        found: dict[str, float | None] = {"distance_m": float(sum(self.distances[i] for i in counted))}
        if r.tags.all_of("charge"):
            found |= {"soc_start": self.charge_at(begins), "soc_end": self.charge_at(last)}
            found["soc_change"] = self.charge_at(last) - self.charge_at(begins)
        found |= trace_figures(r, slice(first, last))
        bags = dict.fromkeys(self.spans[i].bag for i in counted)
        for bag in bags if len(bags) > 1 else ():
            own = [span for span in self.spans if span.bag == bag and span.weight > 0]
            mask = np.array([span in own for span in self.spans])
            found[f"bag_{bag}_distance_m"] = float(self.distances[mask].sum())
            economy = self.consumption(own).figures()
            found |= {f"bag_{bag}_{n}": economy[n] for n in ("fuel_economy_L_per_100km", "energy_kWh_per_100km")}
        return found

    def _by_round(self, row: Array) -> Array:
        rounds = np.array([span.round for span in self.spans])
        return np.array([row[rounds == k].sum() for k in range(rounds[-1] + 1)])

    def burnt(self) -> npt.NDArray[np.bool_]:
        """Return in which rounds fuel was burnt."""
        return self._by_round(self.burnt_energy) > 0

    def sustained(self) -> npt.NDArray[np.bool_]:
        """Return in which rounds the battery gave and took little beside what it takes to drive."""
        r = self.result
        v = r.the("speed")
        v_mean = (v + np.append(r.first[r.tags.the("speed")], v[:-1])) / 2
        driven = self._by_round(self.total(np.maximum(r.the("asked force"), 0) * v_mean))
        return np.abs(self._by_round(self.stored)) < SUSTAINED * driven

    def empty_at(self) -> int | None:
        """Return the step with which the range ends: the battery is empty, or the trace missed by more than 2 mph for two seconds."""
        r = self.result
        charges = np.max([r[name] for name in r.tags.all_of("charge")], axis=0)
        missed = r.the("miss") > ALLOWED
        late = np.flatnonzero(missed[1:] & missed[:-1]) if self.dt < 2 else np.flatnonzero(missed) - 1
        found = [int(late[0]) - 1] if len(late) else []
        found += [int(np.flatnonzero(charges < SOC_EMPTY)[0])] if (charges < SOC_EMPTY).any() else []
        return max(min(found), 0) if found else None

    def distance_to(self, step: int) -> float:
        """Return the distance at the end of a step [m]."""
        return float(self.result.the("distance")[step])

    def distance_by(self, time: float) -> float:
        """Return the distance at the end of the step that ends at a time [m]."""
        return self.distance_to(int(np.searchsorted(self.result.time, time - 1e-3 * self.dt)))
