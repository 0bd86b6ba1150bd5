"""Autosize: the smallest source, store and drive with which a vehicle does what it must.

A vehicle has up to three sizes: that of its *source* (engine or fuel cell, with what follows it in proportion), of its *store* and of
its *drive* (the motors).  Its goals are either *sustained*, such as a grade, or a matter of seconds.  Rounds of these steps, each the
smallest size that will do with all others as they are, are repeated until nothing changes any more:

1. the source, for what is sustained; without a store, for everything;
2. the store, for the rest; without a source, for everything; the drive grows with the power that it can get;
3. the drive for the same, then the store again, and so on until neither gets smaller.

A drive that turns out to be too small for what is sustained, whatever the source, is kept as large as that needs.

Where the engine reaches the wheels beside the motor, there is a choice: engine for the grade alone and a large motor, or engine for
everything and a small motor.  With s_g and s_a the engine's sizes for each of the two, both with the smallest store and drive, and
the degree of hybridisation h from 0 (mild) to 1, the source gets, and never less than it needs for what is sustained::

    s = min(s_g, s_a) + (1 - h) |s_a - s_g|

If even the largest store is not enough, the source makes up for the rest.  The mass follows size wherever the vehicle has it from the
sum of its parts.  Every size is tested on the vehicle's own step; nothing is drawn at random.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeAlias, get_args

from halfshaft.cosim.ways import Mode
from halfshaft.library.base.errors import InputError, number
from halfshaft.library.files.notebook import Grid, card
from halfshaft.models.powertrain import powertrains
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.conditions import Routine
from halfshaft.studies.goals import Goal, read_goals
from halfshaft.studies.search import Least, by_halving, by_root
from halfshaft.studies.sizes import KINDS, NAMED, TAGS, Bounds, Kind, Size, amount, misfits, pinned, power, problems, sizes_of

if TYPE_CHECKING:
    from halfshaft.cosim.plot import Picture

#: The own way, and the original's of 1999.
Preset: TypeAlias = Literal["exact", "1999"]
PRESETS = get_args(Preset)
#: A size of each kind, in steps.
State: TypeAlias = dict[Kind, int]
Key: TypeAlias = tuple[tuple[Kind, int], ...]
#: At most so many rounds; from this one on a source gets no smaller again.
ROUNDS, SETTLED = 10, 4
#: So often goals that nothing meets give way.
PASSES = 2
#: Factors on the final drive's ratio that are tried, the unchanged one first.
RATIOS = tuple(sorted((round(1.04**i, 4) for i in range(-8, 9)), key=lambda x: abs(math.log(x))))
#: An engine that shares with a motor is sought for acceleration up to so many times its size for what is sustained.
MOST_ALONE = 3


@dataclass(frozen=True)
class Rules:
    """What the presets differ in.

    Parameters
    ----------
    routine, mode
        Of the tests.
    bounds
        Between which sizes are sought.
    tolerance
        How far each time may be missed [s].
    generous
        Whether a size will do that misses a goal within its tolerance.
    yielding
        Whether goals that no size meets give way, so that the others are met by no more than they need; else sizes stay at their limits.
    search
        How the smallest size is found.
    feed
        The power that a drive which follows is made for, out of that of the source, 0 where the engine drives beside it, and that of
        the store [W].

    """

    routine: Routine
    mode: Mode | None
    bounds: Bounds
    tolerance: tuple[float, ...]
    generous: bool
    yielding: bool
    search: Callable[..., Least]
    feed: Callable[[float, float], float]


RULES: Mapping[Preset, Rules] = {
    "exact": Rules(
        routine="2000", mode=None, bounds=Bounds({"source": 5e3, "drive": 5e3}, {"source": 10.0, "drive": 10.0}, 1000.0),
        tolerance=(0.04,), generous=False, yielding=True, search=by_root, feed=lambda source, store: source + store,
    ),
    "1999": Rules(
        routine="1999", mode="hybrid", bounds=Bounds({"source": 40e3, "drive": 15e3}, {"source": 4.0, "drive": 5.0}, None),
        tolerance=(0.02, 0.02, 0.05), generous=True, yielding=False, search=by_halving, feed=max,
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Trial:
    """A vehicle that was tried: what was being sized, its sizes in W or modules, its mass [kg], what it reached, by the goals' titles."""

    aim: str
    sizes: Mapping[Kind, float]
    mass: float
    values: Mapping[str, float | None]
    margins: Mapping[str, float]

    @property
    def margin(self) -> float:
        """The smallest of its margins."""
        return min(self.margins.values())


@dataclass(frozen=True)
class Reached:
    """What a goal's figure was before and after; and whether that will do."""

    goal: Goal
    before: float | None
    after: float | None
    met: bool

    @property
    def margin(self) -> float:
        """By how much it is better than the target, over the larger of the two."""
        return self.goal.margin(self.after)


@dataclass(frozen=True)
class Sized:
    """A vehicle with its smallest sizes, and how they were found.

    Parameters
    ----------
    vehicle
        The vehicle, to run, save and change as any other.
    status
        ``met``, or ``not met`` if goals are missed.
    preset
        By which rules.
    before, after
        Its sizes by kind: the power of source and drive [W], the number of the store's modules.
    goals
        What it reaches.
    binds
        Why each size is not smaller.
    trials
        Every vehicle that was tried, in order.
    notes
        What a user should know.

    """

    vehicle: Vehicle
    base: Vehicle = field(repr=False)
    status: Literal["met", "not met"]
    preset: Preset
    before: Mapping[Kind, float]
    after: Mapping[Kind, float]
    goals: tuple[Reached, ...] = field(repr=False)
    binds: Mapping[Kind, str] = field(repr=False)
    trials: tuple[Trial, ...] = field(repr=False)
    notes: tuple[str, ...] = ()

    @cached_property
    def figures(self) -> dict[str, float | None]:
        """The sizes, the mass and what each goal's task found, by name."""
        sizes = {f"{kind}_{'modules' if kind == 'store' else 'W'}": x for kind, x in self.after.items()}
        found: dict[str, float | None] = {}
        for r in self.goals:
            found[r.goal.figure if r.goal.figure not in found else r.goal.title] = r.after
        return {"met": float(self.status == "met"), **sizes, "mass_kg": self.vehicle.mass, "trials": float(len(self.trials)), **found}

    @property
    def changed(self) -> list[str]:
        """Names of the vehicle's numbers that are its sizes, and of the ratios that were changed."""
        tags = self.vehicle.tags
        followers = tags.all_of("follows source") if "source" in self.after else []
        ratios = [name for name in tags.all_of("final ratio") if self.vehicle.values[name] != self.base.values[name]]
        return [*(name for kind in self.after for name in tags.all_of(TAGS[kind])), *followers, *ratios]

    def plot(self, path: str | Path | None = None) -> Picture:
        """Draw how sizes and goals went; with a path into a PNG, SVG or PDF file."""
        from halfshaft.studies.autosize_plot import plot_sizes  # matplotlib takes a quarter of a second

        return plot_sizes(self, path=path)

    def size_rows(self) -> list[tuple[str, ...]]:
        """Return name, before, after, what binds, of each size and of the mass, as texts."""
        rows = [
            (name, unit, f"{self.before[kind] / factor:.{digits}f}", f"{self.after[kind] / factor:.{digits}f}", self.binds.get(kind, ""))
            for kind, (name, unit, factor, digits) in NAMED.items()
            if kind in self.after
        ]
        return [*rows, ("mass", "kg", f"{self.base.mass:.0f}", f"{self.vehicle.mass:.0f}", "")]

    def goal_rows(self) -> list[tuple[str, ...]]:
        """Return title, target, before, after, margin [%] and whether it is met, of each goal, as texts."""
        return [
            (
                r.goal.title, r.goal.wanted, r.goal.shown(r.before), r.goal.shown(r.after), f"{100 * r.margin:+.2f}",
                "met" if r.met else "not met",
            )
            for r in self.goals
        ]  # fmt: skip

    def _repr_html_(self) -> str:
        facts = {"status": self.status, "preset": self.preset, "trials": str(len(self.trials)), "notes": "; ".join(self.notes)}
        return card(
            self.vehicle.name, self.vehicle.title, facts,
            Grid(("size", "unit", "before", "after", "binds"), self.size_rows()),
            Grid(("goal", "target", "before", "after", "margin [%]", ""), self.goal_rows()),
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Autosize:
    """The task to find the smallest sizes with which a vehicle does what it must.

    Parameters
    ----------
    accelerations
        Times in seconds, as texts such as ``0-60mph=12`` or ``80-120km/h=9.5``.
    grades
        What must be climbed for any length of time, such as ``6%@55mph``.
    top_speed
        What must be reached, such as ``90mph``; None for nothing.
    goals
        Figures of any other task that must be at most, or at least, a target.
    preset
        ``exact`` meets every goal, in the refined mode; ``1999`` goes by the procedure, the limits and the tolerances of the original's
        routine, in the hybrid mode.
    hybridisation
        How much of what the engine needs more for full acceleration than for the grade motor and store give, from 0 (nothing) to 1
        (all); without it, what the powertrain says.  Only where the engine drives the wheels beside the motor.
    sizes
        Which sizes may change, of ``source``, ``store`` and ``drive``; all that the vehicle has if none is named.
    limits
        Lowest and highest size by kind: power of source and drive [W], number of the store's modules.
    ratio
        Whether to try ratios of the final drive too, from 0.73 to 1.37 times the vehicle's, for the one with which the parts weigh least.

    """

    accelerations: tuple[str, ...] = ("0-60mph=12", "40-60mph=5.3", "0-85mph=23.4")
    grades: tuple[str, ...] = ("6%@55mph",)
    top_speed: str | None = "90mph"
    goals: tuple[Goal, ...] = ()
    preset: Preset = "exact"
    hybridisation: float | None = None
    sizes: tuple[Kind, ...] = ()
    limits: Mapping[Kind, tuple[float, float]] = field(default_factory=dict)
    ratio: bool = False
    name: str = "autosize"

    def all_goals(self) -> tuple[tuple[Goal, ...], list[str]]:
        """Return all goals, and what is wrong with them."""
        rules = RULES.get(self.preset, RULES["exact"])
        goals, wrong = read_goals(self.accelerations, self.grades, self.top_speed, rules.routine, rules.mode, rules.tolerance)
        goals += self.goals
        titles = [goal.title for goal in goals]
        wrong += [f"goal {title} stands {titles.count(title)} times" for title in dict.fromkeys(titles) if titles.count(title) > 1]
        if not goals and not wrong:
            wrong.append("no goals: name a time, a grade, a speed, or a figure of a task")
        return tuple(goals), wrong + [problem for goal in self.goals for problem in goal.problems()]

    def problems(self) -> list[str]:
        """Return what is wrong with the options, whatever the vehicle."""
        found = problems(self.sizes, self.limits) + self.all_goals()[1]
        if self.preset not in PRESETS:
            found.append(f"preset = {self.preset!r}, must be {' or '.join(PRESETS)}")
        if self.hybridisation is not None and not 0 <= number(self.hybridisation) <= 1:
            found.append(f"hybridisation = {self.hybridisation!r}, must be >= 0 and <= 1")
        return found

    def misfits(self, vehicle: Vehicle) -> list[str]:
        """Return what of the options a vehicle does not have."""
        found = misfits(vehicle, (*self.sizes, *self.limits))
        if self.ratio and not vehicle.tags.all_of("final ratio"):
            found.append(f"ratio: vehicle '{vehicle.name}' has no final drive")
        if self.hybridisation is not None and powertrains()[vehicle.powertrain].hybridisation is None:
            found.append(f"hybridisation: the powertrain {vehicle.powertrain} has no engine that drives the wheels beside a motor")
        return found

    def __call__(self, vehicle: Vehicle) -> Sized:
        """Find them.

        Raises
        ------
        InputError
            If something is not what it must be; all of it is named.

        """
        if wrong := self.problems() + self.misfits(vehicle):
            raise InputError("autosize", wrong)
        return self._geared(vehicle) if self.ratio else self._sized(vehicle, vehicle)

    def _geared(self, vehicle: Vehicle) -> Sized:
        """Return the lightest of the vehicles with several ratios of the final drive."""
        names = vehicle.tags.all_of("final ratio")
        cars = [vehicle.with_values({name: x * vehicle.values[name] for name in names}) if x != 1 else vehicle for x in RATIOS]
        found = [self._sized(car, vehicle) for car in cars]

        def weight(sized: Sized) -> tuple[int, int]:
            # Less than 1 kg is no reason for another ratio: of equals the first wins, which is nearest to that of the vehicle.
            return sum(not r.met for r in sized.goals), round(sum(p.weight for p in sized.vehicle.parameters.values()))

        best = min(range(len(found)), key=lambda i: weight(found[i]))
        note = f"the ratio of the final drive is {RATIOS[best]:.3g} times what it was, the best of {len(RATIOS)} that were tried"
        goals = (replace(after, before=own.before) for after, own in zip(found[best].goals, found[0].goals, strict=True))
        return replace(found[best], before=found[0].before, goals=tuple(goals), notes=(*found[best].notes, note))

    def _sized(self, vehicle: Vehicle, base: Vehicle) -> Sized:
        """Return the vehicle with its smallest sizes; `base` is the one that was given."""
        rules, car = RULES[self.preset], pinned(vehicle)
        goals, _ = self.all_goals()
        sizes = sizes_of(car, self.sizes or KINDS, rules.bounds, self.limits)
        share = powertrains()[vehicle.powertrain].hybridisation
        beside = share is not None
        if beside and self.hybridisation is not None:
            share = self.hybridisation
        bench = _Bench(car, sizes, goals, rules, beside=beside)
        before = [bench.value(bench.given, goal, "before") for goal in goals]
        state, shared, notes = _found(bench, share)
        found = bench.car(state)
        after = [bench.value(state, goal, "after") for goal in goals]
        reached = tuple(Reached(goal, x, y, goal.met(y)) for goal, x, y in zip(goals, before, after, strict=True))
        missed = [r for r in reached if not r.met]
        notes += [f"no sizes within the limits reach {r.goal.title} {r.goal.wanted}" for r in missed]
        if car.tags.the("vehicle mass") in car.given:
            notes.append("the mass is set, so it does not follow the sizes")
        return Sized(
            vehicle=replace(found, name=f"{vehicle.name}-sized", title=f"{vehicle.title}, sized"),
            base=base,
            status="not met" if missed else "met",
            preset=self.preset,
            before={kind: amount(car, kind) for kind in sizes},
            after={kind: amount(found, kind) for kind in sizes},
            goals=reached,
            binds={kind: bench.bound(state, kind, shared) for kind in sizes},
            trials=tuple(bench.trials()),
            notes=tuple(dict.fromkeys(notes)),
        )


class _Bench:
    """Tries vehicles of one kind; nothing is tried twice."""

    def __init__(self, car: Vehicle, sizes: Mapping[Kind, Size], goals: tuple[Goal, ...], rules: Rules, *, beside: bool) -> None:
        self.base, self.sizes, self.goals, self.rules = car, sizes, goals, rules
        self.given: State = {}
        self.start: State = {kind: size.within(round(car.values[size.first] / size.step)) for kind, size in sizes.items()}
        self.beside = beside
        self._cars: dict[Key, Vehicle] = {}
        # Tasks need not have a hash; goals of one task share the object.
        self._found: dict[Key, dict[int, Mapping[str, float | None]]] = {}
        self._aims: dict[Key, str] = {}

    def best(self, goals: Sequence[Goal]) -> State:
        """Return the tried sizes that come nearest to all goals, the first of these."""
        tried: list[State] = [dict(key) for key in self._found if key]
        return max(tried, key=lambda state: sum(min(self.margin(state, goal), 0.0) for goal in goals))

    def car(self, state: State) -> Vehicle:
        """Return the vehicle with these sizes; without any, as it was given."""
        key = _key(state)
        if key not in self._cars:
            values = {name: x for kind, k in state.items() for name, x in self.sizes[kind].values(k).items()}
            self._cars[key] = self.base.with_values(values) if values else self.base
        return self._cars[key]

    def value(self, state: State, goal: Goal, aim: str) -> float | None:
        """Return what a goal's figure is with these sizes."""
        key = _key(state)
        self._aims.setdefault(key, aim)
        found, task = self._found.setdefault(key, {}), id(goal.task)
        if task not in found:
            found[task] = goal.task(self.car(state)).figures
        if goal.figure not in found[task]:
            known = ", ".join(found[task])
            raise InputError("autosize", [f"goal {goal.title}: task {goal.task.name} finds no {goal.figure}; it finds {known}"])
        return found[task][goal.figure]

    def margin(self, state: State, goal: Goal, aim: str = "check") -> float:
        """Return how well a goal is met; at least 0 where that will do."""
        return (goal.relaxed if self.rules.generous else goal).margin(self.value(state, goal, aim))

    def does(self, state: State, goals: Sequence[Goal]) -> bool:
        """Return whether sizes will do."""
        return all(self.margin(state, goal) >= 0 for goal in goals)

    def following(self, state: State, least: int) -> State:
        """Return the state with the drive that the others can feed, or the least if that is larger."""
        if "drive" not in self.sizes:
            return state
        car, size = self.car(state), self.sizes["drive"]
        P = self.rules.feed(0.0 if self.beside else power(car, "source"), power(car, "store"))
        return {**state, "drive": size.within(max(least, round(state["drive"] * P / power(car, "drive"))))}

    def smallest(
        self, state: State, kind: Kind, goals: tuple[Goal, ...], *, least: int = 0, most: int | None = None, follow: int | None = None
    ) -> tuple[State, bool]:
        """Return the state with the smallest size of a kind that will do, and whether there is one.

        With `follow` the drive goes with it, but gets no smaller than that.
        """
        size = self.sizes[kind]
        low, high = size.within(least), size.high if most is None else size.within(most)
        aim = f"{kind} for {'everything' if len(goals) == len(self.goals) else ', '.join(goal.title for goal in goals)}"

        def at(k: int) -> State:
            new = {**state, kind: k}
            return new if follow is None else self.following(new, follow)

        def margin(k: int) -> float:
            margins = [self.margin(at(k), goal, aim) for goal in goals]
            # Beyond a goal that nothing meets, it still counts how well the others are met.
            return sum(min(m, 0.0) for m in margins) or min(margins, default=0.0)

        slack = 2 * max((goal.slack for goal in goals), default=0.0)
        found = self.rules.search(margin, low, high, state[kind], slack)
        return at(found.k), found.does

    def bound(self, state: State, kind: Kind, shared: int | None) -> str:
        """Return why a size is not smaller: what would not do any more with one step less."""
        k = state[kind]
        if k == self.sizes[kind].low:
            return "its lower limit"
        if kind == "source" and k == shared:
            return "degree of hybridisation"
        less = {**state, kind: k - 1}
        failing = [goal.title for goal in self.goals if self.does(state, (goal,)) and not self.does(less, (goal,))]
        return ", ".join(failing) or "end of the search"

    def trials(self) -> list[Trial]:
        """Return all that was tried."""
        rows = []
        for key, found in self._found.items():
            car = self._cars[key]
            seen = [goal for goal in self.goals if id(goal.task) in found]
            values = {goal.title: found[id(goal.task)][goal.figure] for goal in seen}
            margins = {goal.title: goal.margin(values[goal.title]) for goal in seen}
            rows.append(Trial(self._aims[key], {kind: amount(car, kind) for kind in self.sizes}, car.mass, values, margins))
        return rows


def _key(state: State) -> tuple[tuple[Kind, int], ...]:
    return tuple((kind, state[kind]) for kind in KINDS if kind in state)


def _found(bench: _Bench, share: float | None) -> tuple[State, int | None, list[str]]:
    """Return the smallest sizes, the source's if it shares with a motor, and what is to be said of them.

    What no size meets gives way to what the best of all that were tried came to, or to nothing if that never reached it.
    """
    goals, found = bench.goals, _rounds(bench, bench.goals, share, bench.start)
    for _ in range(PASSES if bench.rules.yielding else 0):
        if bench.does(found[0], goals):
            break
        best = bench.best(goals)
        reached = [(goal, bench.value(best, goal, "check")) for goal in goals]
        goals = tuple(goal if goal.margin(x) >= 0 else goal.giving_way(x) for goal, x in reached if x is not None)
        if not goals:
            break
        found = _rounds(bench, goals, share, best)
    return found


def _rounds(bench: _Bench, goals: tuple[Goal, ...], share: float | None, start: State) -> tuple[State, int | None, list[str]]:
    """Return the sizes at which nothing changes any more, from a start, with the source's if it shares, and what is to be said."""
    sizes, state, shared, least, needed = bench.sizes, start, None, 0, 0
    hybrid = bool(power(bench.base, "source") and power(bench.base, "store"))
    split = hybrid and "store" in sizes
    sustained, rest = (tuple(goal for goal in goals if not split or goal.sustained is which) for which in (True, False))
    if split and share is not None and "source" in sizes:
        least = shared = _shared(bench, sustained, rest, share)
    for i in range(ROUNDS):
        begun = state
        if "source" in sizes:
            floor = max(least, state["source"] if i >= SETTLED else 0)
            state, does = bench.smallest(state, "source", sustained, least=floor)
            if not does and "drive" in sizes:
                # No source helps a drive that cannot give what is sustained.
                state, _ = bench.smallest(state, "drive", sustained)
                needed = state["drive"]
                state, _ = bench.smallest(state, "source", sustained, least=floor)
        if "store" in sizes:
            state, does = _stored(bench, state, rest, needed)
            if not does and "source" in sizes:
                # More of the store does not help: the source makes up for what it lacks.
                state, _ = bench.smallest(state, "source", goals, least=state["source"], follow=needed)
                least = state["source"]
                state, _ = _stored(bench, state, rest, needed)
        elif "drive" in sizes and not bench.does(state, goals):
            state, _ = bench.smallest(state, "drive", goals)
        state = _trimmed(bench, state, rest or goals, needed)
        if state == begun:
            return state, shared, []
    return state, shared, [f"the sizes still change after {ROUNDS} rounds"]


def _stored(bench: _Bench, state: State, goals: tuple[Goal, ...], needed: int) -> tuple[State, bool]:
    """Return the state with the smallest store that will do, and the drive that it can feed; both as small as can be if that does."""
    least: State = {**state, "store": bench.sizes["store"].low}
    if "drive" in bench.sizes:
        least["drive"] = bench.sizes["drive"].within(needed)
    if bench.does(least, goals):
        return least, True
    found, does = bench.smallest(state, "store", goals, follow=needed)
    if not does and "drive" in bench.sizes:
        # What the drive lacks may be torque, of which power that it is fed tells nothing.
        grown, does = bench.smallest(found, "drive", goals)
        if does:
            return bench.smallest(grown, "store", goals, most=grown["store"])
    return found, does


def _trimmed(bench: _Bench, state: State, goals: tuple[Goal, ...], needed: int) -> State:
    """Return the state with drive and store made smaller in turn until neither gets smaller."""
    begun: State = {}
    while state != begun:
        begun = state
        floors: dict[Kind, int] = {"drive": needed, "store": 0}
        for kind, least in floors.items():
            if kind in bench.sizes and bench.does(state, goals):
                state, _ = bench.smallest(state, kind, goals, least=least, most=state[kind])
    return state


def _shared(bench: _Bench, sustained: tuple[Goal, ...], rest: tuple[Goal, ...], share: float) -> int:
    """Return the size of an engine that shares what acceleration needs with motor and store."""
    state = {kind: k if kind == "source" else bench.sizes[kind].low for kind, k in bench.start.items()}
    s_g = bench.smallest(state, "source", sustained)[0]["source"]
    s_a = bench.smallest(state, "source", rest, most=MOST_ALONE * s_g)[0]["source"]
    return round(min(s_g, s_a) + (1 - share) * abs(s_a - s_g))
