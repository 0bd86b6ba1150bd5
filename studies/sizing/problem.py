"""The problem of a sizing: what varies, what is to be least, and what must hold.

What varies is a *size* (``source``, ``store`` or ``drive``, see `halfshaft.studies.sizes`), a number of the vehicle
(``gearbox.ratios_1``), a rating in place of a factor (``engine.P_max``), each between two bounds, or a role with the names of parts that
may fill it.  The goal is an expression over figures, and a limit a text such as ``0-60 mph <= 12 s``, ``grade at 55 mph >= 6 %``,
``top speed >= 90 mph`` or ``city.range_m >= 120 km``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any, Literal, NamedTuple, TypeAlias

from halfshaft.cosim.figures import unit_of
from halfshaft.library.base.errors import InputError, nearest, not_a
from halfshaft.library.base.parameters import Spec
from halfshaft.library.base.tags import part_of
from halfshaft.library.files.component_file import Reader, shown
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.acceleration import IN_MPS, NAMES, REQUEST, AccelerationTest, TopSpeedTest
from halfshaft.studies.gradeability import GradeabilityTest
from halfshaft.studies.sizes import KINDS, NAMED, TAGS, amount, misfits, pinned
from halfshaft.studies.sizing.expressions import Expression, read_expression
from halfshaft.studies.task import Task

#: What is given for something that varies: ``20..80 kW``, or names of parts.
Given: TypeAlias = str | Sequence[str]
Sense: TypeAlias = Literal["at most", "at least"]
SENSES: Mapping[str, Sense] = {"<=": "at most", ">=": "at least"}
#: The key of the vehicle's own numbers among the tasks.
OWN = ""
#: At most so many combinations of parts.
MOST_COMBINATIONS = 50
#: So deep names of a user may lie in each other.
DEEPEST = 10
#: How finely a grade is found [1]: its changes tell how it depends on sizes.
GRADE_FINE = 2e-7
_NUMBER, _SPEED = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?", r"(mph|km/h)"
_RANGE = re.compile(rf"\s*({_NUMBER})\s*(.*?)\s*\.\.\s*({_NUMBER})\s*(.*?)\s*")
_LIMIT = re.compile(r"\s*(.+?)\s*(<=|>=)\s*(.+?)\s*")
_TARGET = re.compile(rf"({_NUMBER})\s*(.*)")
_TIME = re.compile(rf"({_NUMBER}) *- *({_NUMBER}) *{_SPEED}")
_GRADE = re.compile(rf"grade *(?:@|at) *({_NUMBER}) *{_SPEED}")
TOP_SPEED = "top speed"
#: Words for figures: the first of these that a task finds.
WORDS: Mapping[str, tuple[str, ...]] = {
    "fuel": ("fuel_equivalent_L_per_100km", "fuel_economy_L_per_100km"),
    "energy": ("energy_Wh_per_km", "energy_kWh_per_100km"),
    "range": ("range_m",),
}


class Ref(NamedTuple):
    """A figure, and the name of the task that finds it."""

    task: str
    figure: str


@dataclass(frozen=True)
class Variable:
    """What varies: its name, the user's unit and that in SI, bounds in SI, and what each number of the vehicle is of it."""

    name: str
    unit: str
    factor: float
    low: float
    high: float
    whole: bool
    shares: Mapping[str, float]
    #: Numbers that must be whole in a vehicle that is built.
    counted: frozenset[str] = frozenset()

    def values(self, x: float, *, exact: bool) -> dict[str, float]:
        """Return the vehicle's numbers at a value [SI]."""
        found = {name: share * x for name, share in self.shares.items()}
        return {name: max(1.0, float(round(y))) if exact and name in self.counted else y for name, y in found.items()}

    def shown(self, x: float) -> str:
        """Return a value as it is shown."""
        text = f"{x / self.factor:.0f}" if self.whole else f"{x / self.factor:.5g}"
        return f"{text} {self.unit}".strip()


@dataclass(frozen=True)
class Term:
    """An expression with what its names stand for."""

    expression: Expression
    refs: tuple[Ref, ...]


@dataclass(frozen=True)
class Limit:
    """What must be at most, or at least, a target [SI, or the unit that its figure is in]; `factor` is what the shown unit is of that."""

    title: str
    term: Term
    sense: Sense
    target: float
    unit: str
    factor: float

    @property
    def sign(self) -> float:
        """1 where it must be at most the target, else -1."""
        return 1.0 if self.sense == "at most" else -1.0

    @property
    def scale(self) -> float:
        """What an excess is told over."""
        return abs(self.target) or 1.0

    @property
    def wanted(self) -> str:
        """Sense and target as they are shown."""
        return f"{'<=' if self.sense == 'at most' else '>='} {self.target / self.factor:.5g} {self.unit}".strip()

    def shown(self, value: float) -> str:
        """Return a value as it is shown."""
        return "never" if not math.isfinite(value) else f"{value / self.factor:.5g} {self.unit}".strip()


@dataclass(frozen=True, kw_only=True, eq=False)
class Problem:
    """What is asked for.

    Parameters
    ----------
    vehicle
        The vehicle to start from.
    vary
        What varies, by name: ``"20..80 kW"``, or a list of parts for a role.  Counted numbers, such as modules, stay whole.
    minimise
        An expression over figures: ``fuel``, ``energy``, ``mass``, or ``city.fuel + 0.2 * highway.fuel + 0.001 * engine.P_max``.
    limits
        What must hold.
    tasks
        What finds the figures, by a name of letters.
    define
        Further names for expressions, such as a ``cost``.
    sensitivities
        Other numbers of the vehicle of which to tell how they move the optimum.

    """

    vehicle: Vehicle
    vary: Mapping[str, Given]
    minimise: str = "fuel"
    limits: tuple[str, ...] = ()
    tasks: Mapping[str, Task] = field(default_factory=dict)
    define: Mapping[str, str] = field(default_factory=dict)
    sensitivities: tuple[str, ...] = ()
    name: str = "sizing"
    title: str = ""

    @property
    def choices(self) -> dict[str, tuple[str, ...]]:
        """The roles whose parts are chosen, with the names of the parts."""
        return {name: tuple(x) for name, x in self.vary.items() if not isinstance(x, str)}

    def combinations(self) -> list[dict[str, str]]:
        """Return the parts of all combinations by role."""
        return [dict(zip(self.choices, names, strict=True)) for names in product(*self.choices.values())]

    def bound(self, parts: Mapping[str, str] | None = None) -> Bound:
        """Return the problem of the vehicle with some parts.

        Raises
        ------
        InputError
            If something is not what it must be; all of it is named.

        """
        return _Binder(self, parts or {}).bound()

    def problems(self, *, figures: bool = True) -> list[str]:
        """Return all that is wrong; without the figures, which must be found by running tasks, all else."""
        binder = _Binder(self, {})
        try:
            read = binder.read()
            if figures:
                binder.tied(*read)
        except InputError as e:
            return list(e.problems)
        return binder.wrong


@dataclass(frozen=True, kw_only=True, eq=False)
class Bound:
    """A problem whose names are known to fit the vehicle and what its tasks find."""

    problem: Problem
    vehicle: Vehicle
    parts: Mapping[str, str]
    variables: tuple[Variable, ...]
    goal: Term
    goal_unit: str
    limits: tuple[Limit, ...]
    tasks: Mapping[str, Task]

    @property
    def names(self) -> tuple[str, ...]:
        """All numbers of the vehicle that vary."""
        return tuple(dict.fromkeys(name for v in self.variables for name in v.shares))

    def moved(self, limit: int, target: float) -> Bound:
        """Return the problem with another target of one of its limits."""
        limits = list(self.limits)
        limits[limit] = replace(limits[limit], target=target)
        return replace(self, limits=tuple(limits))

    def held(self, values: Mapping[str, float]) -> Bound:
        """Return the problem with some variables held at values [SI]."""
        kept = tuple(replace(v, low=values[v.name], high=values[v.name]) if v.name in values else v for v in self.variables)
        return replace(self, variables=kept)


#: Of a limit: what is left of its sign, the figure if that is a test's, the sense, and what is right of it.
Text: TypeAlias = tuple[str, Ref | None, Sense, str]


class _Binder:
    """Puts a problem and its vehicle together, and collects everything that is wrong."""

    def __init__(self, problem: Problem, parts: Mapping[str, str]) -> None:
        self.problem, self.parts, self.reader = problem, parts, Reader()
        self.wrong = self.reader.problems
        self.tasks: dict[str, Task] = {}
        self.pairs: dict[str, list[tuple[float, float]]] = {}
        #: Figures that tasks did not find.
        self.empty: set[str] = set()

    def bound(self) -> Bound:
        """Return the problem, or raise one error with all that is wrong."""
        vehicle, variables, texts = self.read()
        return self.tied(vehicle, variables, texts)

    def read(self) -> tuple[Vehicle, tuple[Variable, ...], list[Text]]:
        """Return vehicle, variables and texts of the limits; what is wrong is noted."""
        problem = self.problem
        if wrong := not_a(Vehicle, vehicle=problem.vehicle):
            raise InputError("sizing", wrong)
        vehicle = self.filled(pinned(problem.vehicle))
        if not problem.vary:
            self.wrong.append("vary is empty: name a size, a number of the vehicle, or a role with parts")
        found = [self.variable(vehicle, name, x) for name, x in problem.vary.items() if isinstance(x, str)]
        variables = tuple(v for v in found if v)
        taken: dict[str, str] = {}
        for v in variables:
            both = [name for name in v.shares if name in taken]
            self.wrong += [f"vary.{v.name} and vary.{taken[name]} both change {name}" for name in both]
            taken |= dict.fromkeys(v.shares, v.name)
        for key, task in problem.tasks.items():
            if not key.isidentifier() or key in vehicle.parts or key in (*WORDS, *KINDS, "mass"):
                self.wrong.append(f"tasks.{key}: must be a name of letters that is no role and no other word")
            self.wrong += [f"tasks.{key}: {p}" for p in getattr(task, "problems", tuple)()]
        self.reader.keys(problem.sensitivities, {**vehicle.specs, **vehicle.rated}, "sensitivities: ")
        own = [name for name in problem.sensitivities if name in taken]
        self.wrong += [f"sensitivities: {name} varies itself, by {taken[name]}" for name in own]
        self.tasks = dict(problem.tasks)
        texts = [text for x in problem.limits if (text := self.split(x))]
        for unit, pairs in self.pairs.items():
            test = AccelerationTest(pairs=tuple(dict.fromkeys(pairs)), unit="mph" if unit == "mph" else "km/h", within=(), over=())
            self.tasks[f"acceleration {unit}"] = test
        return vehicle, variables, texts

    def filled(self, vehicle: Vehicle) -> Vehicle:
        """Return the vehicle with the parts of this combination; all parts that could be chosen are tried."""
        choices = self.problem.choices
        for role, names in choices.items():
            if role not in vehicle.parts:
                self.wrong.append(f"vary.{role} is a list of parts, but no role of '{vehicle.name}'{nearest(role, vehicle.parts)}")
                continue
            for name in names if role not in self.parts else [self.parts[role]]:
                try:
                    changed = vehicle.with_parts({role: name})
                except InputError as e:
                    self.wrong += [f"vary.{role}: {p}" for p in e.problems]
                else:
                    vehicle = changed if role in self.parts else vehicle
        if math.prod(map(len, choices.values())) > MOST_COMBINATIONS:
            self.wrong.append(f"vary has more than {MOST_COMBINATIONS} combinations of parts")
        return vehicle

    def tied(self, vehicle: Vehicle, variables: tuple[Variable, ...], texts: list[Text]) -> Bound:
        """Return the problem with goal and limits tied to what finds their figures."""
        known = self.known(vehicle)
        goal = self.term(self.problem.minimise, "minimise", known, vehicle)
        limits = [limit for text in texts if (limit := self.limit(*text, known, vehicle))]
        titles = [limit.title + limit.sense for limit in limits]
        self.wrong += [f"limit {t} stands {titles.count(t)} times" for t in dict.fromkeys(titles) if titles.count(t) > 1]
        if self.wrong or goal is None:
            raise InputError(f"sizing {self.problem.name}", dict.fromkeys(self.wrong))
        unit = self.unit(goal.refs[0], vehicle) if goal.expression.plain else ""
        used = {ref.task for term in (goal, *(limit.term for limit in limits)) for ref in term.refs}
        return Bound(
            problem=self.problem, vehicle=vehicle, parts=dict(self.parts), variables=variables, goal=goal, goal_unit=unit,
            limits=tuple(limits), tasks={key: task for key, task in self.tasks.items() if key in used},
        )  # fmt: skip

    def variable(self, vehicle: Vehicle, name: str, text: str) -> Variable | None:
        """Return what varies."""
        where = f"vary.{name}"
        match = _RANGE.fullmatch(text)
        if match is None:
            self.wrong.append(f"{where} = {shown(text)}, must be two bounds such as 0.5..2 or 20..80 kW")
            return None
        if name in KINDS:
            kind = next(k for k in KINDS if k == name)
            if lacking := misfits(vehicle, (kind,)):
                self.wrong += lacking
                return None
            names = [*vehicle.tags.all_of(TAGS[kind]), *(vehicle.tags.all_of("follows source") if kind == "source" else ())]
            whole, spec = kind == "store", Spec("1" if kind == "store" else "W", "", gt=0)
            shares = {n: vehicle.values[n] / amount(vehicle, kind) for n in names}
            counted = frozenset(n for n in names if vehicle.specs[n].ge == 1)
        elif name in vehicle.rated:
            rated, part = vehicle.rated[name], part_of(name)
            spec, whole, counted = rated.spec, False, frozenset[str]()
            factor = f"{part}.{rated.scale}"
            shares = {factor: vehicle.values[factor] / rated.of(vehicle.parameters[part])}
        elif name in vehicle.specs:
            spec = vehicle.specs[name]
            # What is at least 1 is counted, all else is a factor.
            whole = spec.unit == "1" and spec.ge == 1
            shares, counted = {name: 1.0}, frozenset([name] if whole else [])
        else:
            self.wrong.append(f"{where} is no size and no number of '{vehicle.name}'{nearest(name, {**vehicle.specs, **vehicle.rated})}")
            return None
        unit = match[4] or match[2]
        before = len(self.wrong)
        low, high = (self.reader.number(f"{x} {u}".strip() if spec.unit != "1" or u else x, spec, where)
                     for x, u in ((match[1], match[2] or unit), (match[3], unit)))  # fmt: skip
        if len(self.wrong) > before:
            return None
        if not low < high:
            self.wrong.append(f"{where} = {shown(text)}, must rise")
            return None
        one, none = (Reader().number(f"{x} {unit}".strip(), spec._replace(gt=None, ge=None, lt=None, le=None), where) for x in (1, 0))
        if whole:
            low, high = math.ceil(low - 1e-9), math.floor(high + 1e-9)
        unit = unit or (NAMED[kind][1] if name in KINDS else "")
        return Variable(name, unit, one - none, float(low), float(high), whole, shares, counted)

    def split(self, text: Any) -> Text | None:
        """Return the parts of a limit, and the figure if it is that of a test; the tests are noted."""
        match = _LIMIT.fullmatch(text) if isinstance(text, str) else None
        if match is None:
            self.wrong.append(f"limit {shown(text)}, must be like 0-60 mph <= 12 s, grade at 55 mph >= 6 % or mass <= 1400 kg")
            return None
        left, sense = match[1], SENSES[match[2]]
        ref = None
        if found := _TIME.fullmatch(left):
            low, high, unit = float(found[1]), float(found[2]), found[3]
            if not 0 <= low < high < REQUEST / IN_MPS[unit]:
                self.wrong.append(f"limit {text}: the speeds must rise from >= 0 to < 322 km/h")
            self.pairs.setdefault(unit, []).append((low, high))
            ref = Ref(f"acceleration {unit}", f"time_{low:g}_to_{high:g}_{NAMES[unit]}_s")
        elif found := _GRADE.fullmatch(left):
            speed = float(found[1]) * IN_MPS[found[2]]
            if not 0 < speed < REQUEST:
                self.wrong.append(f"limit {text}: the speed must be > 0 and < 322 km/h")
            ref = Ref(left, "grade_percent")
            self.tasks[left] = GradeabilityTest(speed=speed, tolerance=GRADE_FINE)
        elif left == TOP_SPEED:
            ref = Ref(TOP_SPEED, "top_speed_mps")
            self.tasks[TOP_SPEED] = TopSpeedTest()
        return left, ref, sense, match[3]

    def known(self, vehicle: Vehicle) -> dict[str, set[str]]:
        """Return the figures that each task finds; a test of full effort need not reach its own."""
        from halfshaft.studies.probes import numbers

        known = {OWN: set(numbers(vehicle))}
        for key, task in self.problem.tasks.items():
            try:
                figures = task(vehicle).figures
                known[key] = {name for name, x in figures.items() if x is not None}
                self.empty |= figures.keys() - known[key]
            except InputError as e:
                self.wrong += [f"tasks.{key}: {p}" for p in e.problems]
        for key, task in self.tasks.items():
            if key not in known and key not in self.problem.tasks:
                try:
                    task(vehicle)
                except InputError as e:
                    self.wrong += [f"limit {key}: {p}" for p in e.problems]
        return known

    def limit(self, left: str, ref: Ref | None, sense: Sense, right: str, known: Mapping[str, set[str]], vehicle: Vehicle) -> Limit | None:
        """Return a limit."""
        where = f"limit {left}"
        if ref:
            term = Term(read_expression("x"), (ref,))
        elif (found := self.term(left, where, known, vehicle)) is None:
            return None
        else:
            term = found
        plain = ref is not None or term.expression.plain
        unit = self.unit(term.refs[0], vehicle) if plain else "1"
        match = _TARGET.fullmatch(right)
        if match is None:
            self.wrong.append(f"{where}: {shown(right)} must be a number" + (f" and a unit such as {unit}" if unit != "1" else ""))
            return None
        given, own = float(match[1]), match[2].strip()
        if own == unit or unit not in ("m", "s", "L", "J", "W", "kg", "m/s", "1", *{s.unit for s in vehicle.specs.values()}):
            if own != unit:
                self.wrong.append(f"{where}: {shown(right)} must be a number and the unit {unit}")
                return None
            return Limit(left, term, sense, given, "" if unit == "1" else unit, 1.0)
        before = len(self.wrong)
        target = self.reader.number(right, Spec(unit, ""), where)
        if len(self.wrong) > before:
            return None
        factor = Reader().number(f"1 {own}".strip(), Spec(unit, ""), where)
        return Limit(left, term, sense, target, own, factor)

    def term(self, text: Any, where: str, known: Mapping[str, set[str]], vehicle: Vehicle, depth: int = 0) -> Term | None:
        """Return an expression with what its names stand for."""
        try:
            expression = read_expression(self.defined(text))
        except ValueError as e:
            self.wrong.append(f"{where}: {shown(text)} {e}")
            return None
        if not expression.names:
            self.wrong.append(f"{where}: {shown(text)} has no figure")
        refs = [self.ref(name, where, known, vehicle) for name in expression.names]
        return Term(expression, tuple(r for r in refs if r)) if expression.names and all(refs) else None

    def defined(self, given: Any) -> str:
        """Return an expression with the user's own names written out."""
        if not isinstance(given, str):
            raise ValueError("must be a text")
        text, define = given, self.problem.define
        for _ in range(DEEPEST):
            names = set(read_expression(text).names) & define.keys()
            if not names:
                return text
            either = "|".join(map(re.escape, names))
            text = re.sub(rf"(?<![\w.])({either})(?![\w.])", lambda match: f"({define[match[1]]})", text)
        raise ValueError("has names that are defined by themselves")

    def ref(self, name: str, where: str, known: Mapping[str, set[str]], vehicle: Vehicle) -> Ref | None:
        """Return what a name stands for."""
        if name in known[OWN]:
            return Ref(OWN, name)
        owner, _, own = name.rpartition(".")
        tasks = [owner] if owner in self.problem.tasks else list(self.problem.tasks) if not owner else []
        for figure in WORDS.get(own, (own,)):
            having = [key for key in tasks if figure in known.get(key, ())]
            if len(having) > 1:
                self.wrong.append(f"{where}: {name} is found by {' and '.join(having)}: write {having[0]}.{own}")
                return None
            if having:
                return Ref(having[0], figure)
        if own in WORDS:
            self.wrong.append(f"{where}: vehicle '{vehicle.name}' has no {own}, or no task finds it")
        elif own in self.empty:
            self.wrong.append(f"{where}: vehicle '{vehicle.name}' has no {own}, or none with its own sizes")
        else:
            figures = [f for key in self.problem.tasks for f in known.get(key, ())]
            every = [*known[OWN], *WORDS, *figures, *(f"{key}.{f}" for key in self.problem.tasks for f in known.get(key, ()))]
            self.wrong.append(f"{where}: {name} is no figure and no number of '{vehicle.name}'{nearest(name, every)}")
        return None

    def unit(self, ref: Ref, vehicle: Vehicle) -> str:
        """Return the unit of a figure."""
        if ref.task != OWN:
            return str(unit_of(ref.figure))
        if ref.figure in KINDS:
            return "1" if ref.figure == "store" else "W"
        if ref.figure == "mass":
            return "kg"
        return str((vehicle.specs.get(ref.figure) or vehicle.rated[ref.figure].spec).unit)
