"""Test procedures as TOML files: which cycles are driven from which state, and how their consumptions are weighted.

A file holds ``schema``, ``kind = "procedure"``, ``name``, ``title``, ``source``, and ``tests`` by name::

    [tests.city]
    vehicles = ["fuel", "electric"]   # of fuel, hybrid, plug-in and electric; all unless said
    soc = "middle"                    # a number, or low, middle, high, full or own
    temperature = "20 degC"           # of what has one, at the start
    correction = "zero-delta"         # of hybrids; or "none"
    drive = [
        {cycle = "udds", to = "505 s", bag = "1", weight = 0.43},
        {cycle = "udds", from = "505 s", bag = "2"},
        {soak = "600 s"},
        {cycle = "udds", to = "505 s", bag = "3", weight = 0.57},
    ]

A bag's ``weight`` is 1, or 0 for a warm-up: the change of the charge counts from the first bag that counts.  With
``repeat = {until, at_least, at_most, pause}`` a test is driven again and again, ``until`` the ``engine`` has run (SAE J1711), the charge
is ``sustaining`` (WLTP), or the battery ``empty``.  ``combined.<name>`` gives the share of each test by its name, of those that were
driven; ``weighted.<name>`` weights a ``depleting`` test with a ``sustaining`` one by ``utility``, the ``share`` of driving that lies
within a ``distance``.  ``grid.efficiency`` is what the battery gives over what was drawn to charge it, and ``report`` the figures to show
first.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args

import numpy as np

from halfshaft.cosim.cycle import Array, Cycle
from halfshaft.library.base.errors import InputError, nearest
from halfshaft.library.base.parameters import Spec
from halfshaft.library.files.component_file import LARGEST, Reader, shown
from halfshaft.library.files.texts import read_text
from halfshaft.studies.conditions import PLACES, Place

Kind: TypeAlias = Literal["fuel", "hybrid", "plug-in", "electric"]
KINDS: tuple[Kind, ...] = get_args(Kind)
Until: TypeAlias = Literal["engine", "sustaining", "empty"]
UNTIL: tuple[Until, ...] = get_args(Until)
CORRECTIONS = ("zero-delta", "none")
#: Most times that a test is repeated, and most legs of one.
MOST = 1000


@dataclass(frozen=True)
class Leg:
    """A part of a cycle, or a soak [s] with the key off; what it counts for."""

    cycle: Cycle | None = None
    start: float | None = None
    end: float | None = None
    soak: float = 0.0
    bag: str = ""
    weight: float = 1.0


@dataclass(frozen=True)
class Repeat:
    """How often a test is driven, with a pause between [s]."""

    until: Until
    at_least: int = 1
    at_most: int = 100
    pause: float = 0.0


@dataclass(frozen=True)
class Test:
    """What is driven in one go, from one state."""

    name: str
    legs: tuple[Leg, ...]
    vehicles: tuple[Kind, ...] = KINDS
    soc: float | Place = "middle"
    temperature: float | None = None
    correction: str = "zero-delta"
    repeat: Repeat | None = None


@dataclass(frozen=True)
class Utility:
    """Share of driving that lies within a distance [m]."""

    distance: tuple[float, ...]
    share: tuple[float, ...]

    def __call__(self, distance: Array) -> Array:
        """Return the share of driving within distances."""
        return np.interp(distance, self.distance, self.share)


@dataclass(frozen=True)
class Weighted:
    """A test that depletes the battery and one that keeps its charge, weighted by the utility factor."""

    depleting: str
    sustaining: str


@dataclass(frozen=True)
class Plan:
    """A procedure as its file says it."""

    name: str
    title: str
    source: str
    tests: tuple[Test, ...]
    combined: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    weighted: Mapping[str, Weighted] = field(default_factory=dict)
    utility: Utility | None = None
    report: tuple[str, ...] = ()
    grid_efficiency: float = 1.0

    @classmethod
    def load(cls, source: str | Path) -> Plan:
        """Return a procedure of the library by name, or of a file ending in ``.toml``.

        Raises
        ------
        InputError
            If there is none, or the file is not right; everything that is wrong is named at once.

        """
        path: Path | Traversable = Path(source)
        if isinstance(source, str) and not source.endswith(".toml"):
            if source not in _library():
                raise InputError(f"procedure '{source}'", [f"not in the library{nearest(source, _library())}"])
            path = _library()[source]
        return _Reader(path).plan()


def procedure_names() -> list[str]:
    """Return the names of the library's procedures."""
    return sorted(_library())


def procedure_texts() -> dict[str, str]:
    """Return the texts of the library's procedures by name."""
    return {name: path.read_text(encoding="utf-8") for name, path in _library().items()}


@cache
def _library() -> dict[str, Traversable]:
    folder = files("halfshaft.studies") / "data" / "procedures"
    return {p.name.removesuffix(".toml"): p for p in folder.iterdir() if p.name.endswith(".toml")}


SECONDS, KELVIN, METRES, SHARE = Spec("s", "", ge=0, le=1e7), Spec("K", "", ge=200, le=400), Spec("m", "", ge=0), Spec("1", "", ge=0, le=1)
WEIGHT, EFFICIENCY, COUNT = Spec("1", "", ge=0, le=1000), Spec("1", "", gt=0, le=1), Spec("1", "", ge=1, le=MOST)


class _Reader(Reader):
    """Reads one file, and collects everything that is wrong with it."""

    def __init__(self, path: Path | Traversable) -> None:
        super().__init__()
        self.path = path

    def plan(self) -> Plan:
        """Return what the file says."""
        extra = {"tests": dict, "combined": dict, "weighted": dict, "utility": dict, "report": list, "grid": dict}
        data = self.toml(str(self.path), read_text(self.path, LARGEST), ["procedure"], extra)
        self.required(data, ("source", "tests"), "")
        given, weights = data.get("tests", {}), data.get("weighted", {})
        tests = [self.test(name, x, f"tests.{name}.") for name, x in given.items()]
        if "tests" in data and not tests:
            self.problems.append("tests is empty")
        utility = self.utility(data["utility"], "utility.") if "utility" in data else None
        if weights and "utility" not in data:
            self.problems.append("weighted needs a utility, the share of driving within a distance")
        weighted = {name: self.weighted(x, given, f"weighted.{name}.") for name, x in weights.items()}
        combined = {name: self.shares(x, [*given, *weighted], f"combined.{name}.") for name, x in data.get("combined", {}).items()}
        names = [*given, *weighted, *combined]
        self.problems.extend(f"{name} is the name of {names.count(name)} things" for name in dict.fromkeys(names) if names.count(name) > 1)
        grid = self.section(data.get("grid", {}), ("efficiency",), "grid.")
        efficiency = self.number(grid.get("efficiency", 1.0), EFFICIENCY, "grid.efficiency")
        report = tuple(x for x in data.get("report", ()) if self.text(x, "report"))
        self.finish(str(self.path))
        head = (data["name"], data["title"], data["source"])
        sound = {name: x for name, x in weighted.items() if x}
        return Plan(*head, tuple(t for t in tests if t), combined, sound, utility, report, efficiency)

    def section(self, data: Any, known: tuple[str, ...], where: str) -> dict[str, Any]:
        """Return a table of known keys."""
        if not isinstance(data, dict):
            self.problems.append(f"{where.removesuffix('.')} = {shown(data)}, must be a table with {', '.join(known)}")
            return {}
        self.keys(data, known, where)
        return data

    def one_of(self, value: Any, known: tuple[str, ...], where: str) -> bool:
        """Return whether a value is a known word."""
        if isinstance(value, str) and value in known:
            return True
        self.problems.append(f"{where} = {shown(value)}, must be {' or '.join(known)}{nearest(str(value), known)}")
        return False

    def text(self, value: Any, where: str) -> bool:
        """Return whether a value is a text."""
        if isinstance(value, str):
            return True
        self.problems.append(f"{where} = {shown(value)}, must be a text")
        return False

    def test(self, name: str, given: Any, where: str) -> Test | None:
        """Return a test."""
        known = ("vehicles", "soc", "temperature", "correction", "drive", "repeat")
        data = self.section(given, known, where)
        if not isinstance(given, dict):
            return None
        self.required(data, ("drive",), where)
        vehicles = data.get("vehicles", list(KINDS))
        if not isinstance(vehicles, list) or not vehicles:
            self.problems.append(f"{where}vehicles = {shown(vehicles)}, must be a list of {', '.join(KINDS)}")
            vehicles = []
        vehicles = [x for x in vehicles if self.one_of(x, KINDS, f"{where}vehicles")]
        soc = data.get("soc", "middle")
        if isinstance(soc, str):
            self.one_of(soc, PLACES, f"{where}soc")
        else:
            soc = self.number(soc, SHARE, f"{where}soc")
        correction = data.get("correction", "none" if "repeat" in data else "zero-delta")
        self.one_of(correction, CORRECTIONS, f"{where}correction")
        repeat = self.repeat(data["repeat"], f"{where}repeat.") if "repeat" in data else None
        if repeat and correction != "none":
            self.problems.append(f"{where}correction = {shown(correction)}: a test that is repeated has none")
        temperature = self.number(data["temperature"], KELVIN, f"{where}temperature") if "temperature" in data else None
        legs = data.get("drive", [])
        if "drive" in data and (not isinstance(legs, list) or not 0 < len(legs) <= MOST):
            self.problems.append(f"{where}drive = {shown(legs)}, must be a list of 1 to {MOST} cycles and soaks")
            legs = []
        driven = [self.leg(x, i, f"{where}drive[{i}].") for i, x in enumerate(legs, 1)]
        if legs and not any(leg and leg.cycle and leg.weight > 0 for leg in driven) and all(driven):
            self.problems.append(f"{where}drive has no cycle that counts")
        return Test(name, tuple(leg for leg in driven if leg), tuple(vehicles), soc, temperature, correction, repeat)

    def leg(self, given: Any, i: int, where: str) -> Leg | None:
        """Return a leg of a test."""
        data = self.section(given, ("cycle", "from", "to", "soak", "bag", "weight"), where)
        if not isinstance(given, dict):
            return None
        if ("cycle" in data) == ("soak" in data):
            self.problems.append(f"{where.removesuffix('.')} must have either a cycle or a soak")
            return None
        if "soak" in data:
            self.keys(data, ("soak",), where)
            return Leg(soak=self.number(data["soak"], SECONDS, f"{where}soak"), weight=0.0)
        ends = {n: self.number(data[n], SECONDS, where + n) for n in ("from", "to") if n in data}
        bag = data.get("bag", str(i))
        self.text(bag, f"{where}bag")
        weight = self.number(data.get("weight", 1.0), WEIGHT, f"{where}weight")
        cycle = self.cycle(data["cycle"], f"{where}cycle")
        if cycle is None:
            return None
        start, end = ends.get("from", 0.0), ends.get("to", cycle.duration)
        if not 0 <= start < end <= cycle.duration and math.isfinite(start + end):
            self.problems.append(
                f"{where}from {start:g} s to {end:g} s: must rise, within the {cycle.duration:g} s of cycle '{cycle.name}'"
            )
        return Leg(cycle, ends.get("from"), ends.get("to"), 0.0, str(bag), weight)

    def cycle(self, name: Any, where: str) -> Cycle | None:
        """Return a cycle of the library, or of a file beside this one."""
        if not self.text(name, where):
            return None
        beside = isinstance(self.path, Path) and name.lower().endswith(".csv")
        try:
            return Cycle.load(self.path.parent / name if beside and isinstance(self.path, Path) else name)
        except InputError as e:
            self.problems.extend(f"{where}: {e.where}: {p}" for p in e.problems)
            return None

    def repeat(self, given: Any, where: str) -> Repeat | None:
        """Return how often a test is driven."""
        data = self.section(given, ("until", "at_least", "at_most", "pause"), where)
        self.required(data, ("until",), where)
        if "until" in data:
            self.one_of(data["until"], UNTIL, f"{where}until")
        least, most = (self.number(data.get(n, x), COUNT, where + n) for n, x in (("at_least", 1), ("at_most", 100)))
        if most < least:
            self.problems.append(f"{where}at_most = {most:g} is below at_least = {least:g}")
        if not all(math.isfinite(x) and x == int(x) for x in (least, most)):
            self.problems.append(f"{where}at_least and at_most must be whole numbers")
            least = most = 1
        pause = self.number(data.get("pause", "0 s"), SECONDS, f"{where}pause")
        return Repeat(data.get("until", "empty"), int(least), int(most), pause)

    def shares(self, given: Any, known: list[str], where: str) -> dict[str, float]:
        """Return shares of tests by their names."""
        data = self.section(given, tuple(known), where)
        shares = {name: self.number(x, WEIGHT, where + name) for name, x in data.items() if name in known}
        if isinstance(given, dict) and not sum(shares.values()) > 0:
            self.problems.append(f"{where.removesuffix('.')} has no share above 0")
        return shares

    def weighted(self, given: Any, tests: Mapping[str, Any], where: str) -> Weighted | None:
        """Return which two tests are weighted by the utility factor."""
        names = ("depleting", "sustaining")
        data = self.section(given, names, where)
        self.required(data, names, where)
        if not all(n in data and self.one_of(data[n], tuple(tests), where + n) for n in names):
            return None
        repeated = tests[data["depleting"]]
        if isinstance(repeated, dict) and "repeat" not in repeated:
            self.problems.append(f"{where}depleting = {shown(data['depleting'])}: that test is not repeated")
        return Weighted(data["depleting"], data["sustaining"])

    def utility(self, given: Any, where: str) -> Utility | None:
        """Return a utility factor."""
        names = ("distance", "share")
        data = self.section(given, names, where)
        self.required(data, names, where)
        if any(n not in data for n in names):
            return None
        before = len(self.problems)
        distance = self.array(data["distance"], METRES, f"{where}distance", [("distance", None)])
        share = self.array(data["share"], SHARE, f"{where}share", [("distance", None if distance is None else len(distance))])
        if len(self.problems) > before:
            return None
        for name, row in (("distance", distance), ("share", share)):
            if np.any(np.diff(row) < 0) or (name == "distance" and np.any(np.diff(row) == 0)):
                self.problems.append(f"{where}{name} must rise")
        return Utility(tuple(distance.tolist()), tuple(share.tolist()))
