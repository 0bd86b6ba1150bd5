"""Component files: TOML texts with units and provenance, read into parameter sets.

A file holds ``schema``, ``kind``, ``name``, ``title``, ``source`` and a table ``parameters``.  There, a number is written
with its unit (``"0.047 kg m^2"``; a plain number where there is none), a row as a list or as ``{unit, values}``, and a map
as a table with one entry per axis and ``values``, the first axis counting the lines.  Nothing in a file is executed.  A
file that is not right gives one `InputError` with every problem; places in lists count from 1.
"""

from __future__ import annotations

import math
import os
import re
import tomllib
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields, replace
from functools import cache, cached_property, lru_cache
from importlib.resources.abc import Traversable
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from halfshaft.library.base.component import Component
from halfshaft.library.base.errors import InputError, nearest
from halfshaft.library.base.parameters import DESCRIBED, Parameters, Spec, described, spec_of
from halfshaft.library.base.tables import Table
from halfshaft.library.files.catalog import component_kinds, data_files, sources
from halfshaft.library.files.notebook import Grid, card
from halfshaft.library.files.texts import cleaned, name_problem, read_text
from halfshaft.library.files.toml import toml_text, written
from halfshaft.library.files.writing import written_whole

if TYPE_CHECKING:
    import pint

SCHEMA = 1
#: What a unit measures, for messages.
QUANTITIES = {
    "A": "a current", "C": "a charge", "J/(kg.K)": "a specific heat", "J/kg": "a heating value", "K": "a temperature",
    "K/W": "a thermal resistance", "N": "a force", "N.m": "a torque", "V": "a voltage", "W": "a power", "W/s": "a rate of power",
    "kg": "a mass", "kg.m^2": "an inertia", "kg/m^3": "a density", "kg/s": "a mass flow", "m": "a length", "m/s": "a speed",
    "m/s^2": "an acceleration", "m^2": "an area", "ohm": "a resistance", "rad/s": "an angular speed", "s": "a time",
}  # fmt: skip
#: Factor and offset to SI of what the library's files use, in pint's digits: pint itself takes a fifth of a second to start.
COMMON = {
    ("rpm", "rad/s"): (0.10471975511965977, 0.0), ("degC", "K"): (1.0, 273.15), ("Ah", "C"): (3600.0, 0.0),
    ("mph", "m/s"): (0.44704, 0.0), ("km/h", "m/s"): (0.2777777777777778, 0.0), ("kW", "W"): (1000.0, 0.0),
    ("g/s", "kg/s"): (0.001, 0.0), ("J/g", "J/kg"): (1000.0, 0.0), ("g/l", "kg/m^3"): (0.9999999999999999, 0.0),
}  # fmt: skip
_TYPES = {int: "a whole number", str: "a text", dict: "a table", list: "a list"}
#: At most so many bad entries of one list, and unknown keys of one table, are named.
NAMED, NAMED_KEYS = 5, 50

#: Largest file that is read [MB], and longest text of a number.
LARGEST, LONGEST = 10, 100

_NUMBER = re.compile(r"([-+]?(?:(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?|inf\b|nan\b))((?:\s|[^\d.\s]).*)?", re.IGNORECASE)
_EXPONENT = re.compile(r"(\^|\*\*)\s*-?\d(?!\d|\.\d|\s*(\^|\*\*))")


@cache
def _units() -> pint.UnitRegistry[Any]:
    import pint

    return pint.UnitRegistry()


@cache
def _unit(text: str) -> Any:
    """Return a unit; of powers only single ones are let through, a tower of them would keep pint busy for ever."""
    rest = _EXPONENT.sub("", text)
    if "^" in rest or "**" in rest or not re.fullmatch(r"(?:[^\W\d]|[ %°²³1/*.()-])*", rest):
        raise ValueError(f"{shown(text)} is not a unit")
    try:
        return _units().parse_units(text)
    # What pint raises on a malformed unit has no common base.
    except Exception as e:
        raise ValueError(f"{shown(text)} is not a known unit") from e


def _to_si(values: Any, unit: str, si: str) -> Any:
    if unit.replace(" ", ".") == si:
        return values
    if (unit, si) in COMMON:
        factor, offset = COMMON[unit, si]
        with np.errstate(all="ignore"):
            return values * factor + offset
    given, wanted = (_unit(u) for u in (unit, si))
    expected = "be a number without unit" if si == "1" else f"be {QUANTITIES.get(si, 'a quantity')} such as {si}"
    try:
        # Nobody can tell whether 1/min and Hz count turns or radians.
        if _turns(si) <= _turns(unit) and _units().Quantity(1.0, given).is_compatible_with(wanted):
            with np.errstate(all="ignore"):
                return _units().Quantity(values, given).to(wanted).magnitude
    # What pint raises has no common base; a unit in decibels overflows.
    except Exception as e:
        raise ValueError(f"cannot be converted to {si}") from e
    raise ValueError(f"must {expected}")


@cache
def _turns(unit: str) -> bool:
    return "radian" in str(_units().Quantity(1.0, _unit(unit)).to_base_units().units)


def _number(value: Any, si: str) -> float:
    if isinstance(value, str):
        match = _NUMBER.fullmatch(value.strip()) if len(value) <= LONGEST else None
        if match is None:
            raise ValueError("must be a number" if si == "1" else f'must be a number and a unit such as "1 {si}"')
        unit = (match[2] or "").strip()
        if not math.isfinite(float(match[1])):
            raise ValueError("must be a finite number")
        if unit or si == "1":
            return float(_to_si(float(match[1]), unit or "1", si))
    elif isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError("must be a number" if si == "1" else f'must be a number and a unit in quotes such as "1 {si}"')
    elif si == "1":
        return _float(value)
    raise ValueError(f"must have a unit such as {si}")


def _float(value: float) -> float:
    """Return a number as a float: infinite where it is too large for one."""
    try:
        return float(value)
    except OverflowError:
        return math.inf


def shown(value: Any, deep: bool = True) -> str:
    """Return what a file holds as a short text for a message."""
    if isinstance(value, dict):
        text = "{...}" if value else "{}"
    elif isinstance(value, list):
        text = f"[{', '.join(shown(x, False) for x in value[:9])}]" if deep else "[...]"
    elif isinstance(value, int) and value.bit_length() > 99:
        text = "a number of more than 29 digits"
    else:
        text = f'"{value}"' if isinstance(value, str) else f"{value:g}" if isinstance(value, float) else str(value)
    return text if len(text) < 60 else f"{text[:56]} ..."


def _with_unit(value: float, unit: str) -> str:
    return f"{value:g}" if unit == "1" else f"{value:g} {unit}"


class Reader:
    """Reads what a user wrote and collects everything that is wrong with it."""

    def __init__(self) -> None:
        self.problems: list[str] = []

    def finish(self, where: str) -> None:
        """Raise one InputError if anything was wrong."""
        if self.problems:
            raise InputError(where, self.problems)

    def toml(self, path: str, text: str, kinds: Collection[str], extra: Mapping[str, type]) -> dict[str, Any]:
        """Return what the top level of a file's text holds; apart from what each file has, it may have `extra` keys."""
        try:
            data = tomllib.loads(text)
        # A number of thousands of digits is a ValueError of Python's own.
        except (ValueError, RecursionError) as e:
            raise InputError(path, [f"not a TOML file: {e}"]) from e
        if data.get("schema", SCHEMA) != SCHEMA:
            raise InputError(path, [f"schema = {shown(data['schema'])}, this version reads schema {SCHEMA}"])
        keys = {"schema": int, "kind": str, "name": str, "title": str, "source": str, **extra}
        self.keys(data, keys, "")
        self.required(data, ("schema", "kind", "name", "title"), "")
        wrong = [k for k, v in data.items() if k in keys and type(v) is not keys[k]]
        self.problems.extend(f"{k} = {shown(data[k])}, must be {_TYPES[keys[k]]}" for k in wrong)
        data = {k: cleaned(v) if k in ("title", "source") else v for k, v in data.items() if k in keys and k not in wrong}
        stem = Path(path).name.removesuffix(".toml")
        if data.get("name", stem) != stem:
            self.problems.append(f'name = {shown(data["name"])}, must be the name of the file, "{stem}"')
        elif problem := name_problem(stem):
            self.problems.append(problem)
        if "kind" in data and data["kind"] not in kinds:
            what = nearest(data["kind"], kinds) or f", must be {' or '.join(kinds) if len(kinds) < 3 else 'a kind of component'}"
            self.problems.append(f"kind = {shown(data['kind'])} is not known{what}")
        return data

    def required(self, data: Mapping[str, Any], names: Collection[str], where: str) -> None:
        """Report what is missing."""
        self.problems.extend(f"{where}{name} is missing" for name in names if name not in data)

    def keys(self, data: Iterable[str], known: Collection[str], where: str) -> None:
        """Report what is unknown."""
        self._report([f"{where}{key} is not known{nearest(key, known)}" for key in data if key not in known], NAMED_KEYS)

    def number(self, value: Any, spec: Spec, where: str, *, plain: bool = False) -> float:
        """Return one number in SI; with `plain`, a number without unit is SI already."""
        plain = plain and isinstance(value, int | float) and not isinstance(value, bool)
        try:
            number = _float(value) if plain else _number(value, spec.unit)
        except ValueError as e:
            self.problems.append(f"{where} = {shown(value)}, {e}")
            return math.nan
        if not spec.holds(number):
            allowed = [spec.allowed(), "a finite number" if not spec.allowed() else "" if math.isfinite(number) else "finite"]
            self.problems.append(f"{where} = {shown(value)}, must be {' and '.join(filter(None, allowed))}")
        return number

    def array(self, data: Any, spec: Spec, where: str, shape: Sequence[tuple[str, int | None]]) -> Any:
        """Return a list, or a list of lists, in SI; `shape` names each level and gives its length where it is known."""
        unit = "1"
        if isinstance(data, dict):
            self.keys(data, ("unit", "values"), f"{where}.")
            self.required(data, ("unit", "values"), f"{where}.")
            unit, data = data.get("unit", spec.unit), data.get("values", [])
        before, bad = len(self.problems), list[str]()
        self._level(data, where, shape, bad)
        try:
            if not isinstance(unit, str):
                raise ValueError("must be a text")
            _to_si(1.0, unit, spec.unit)
        except ValueError as e:
            self.problems.append(f"{where} has unit {shown(unit)}, {e}")
        if bad or len(self.problems) > before:
            self._report(bad)
            return None
        try:
            given = np.asarray(data, dtype=float)
        except ValueError:
            self.problems.append(f"{where} has lines of unequal length")
            return None
        values = np.asarray(_to_si(given, unit, spec.unit), dtype=float)
        # Several vehicles hold it.
        values.flags.writeable = False
        for index in np.argwhere(~np.vectorize(spec.holds, otypes=[bool])(values)):
            place = "".join(f"[{i + 1}]" for i in index)
            allowed = spec.allowed() or "a finite number"
            bad.append(f"{where}{place} = {_with_unit(float(given[tuple(index)]), unit)}, must be {allowed}")
        self._report(bad)
        return values

    def _level(self, data: Any, where: str, shape: Sequence[tuple[str, int | None]], bad: list[str]) -> None:
        if not shape:
            if isinstance(data, bool) or not isinstance(data, int | float) or not math.isfinite(_float(data)):
                bad.append(f"{where} = {shown(data)}, must be a finite number")
            return
        (name, length), *rest = shape
        if not isinstance(data, list) or not data:
            bad.append(f"{where} = {shown(data)}, must be a list")
        elif length is not None and len(data) != length:
            bad.append(f"{where} has {len(data)} entries, must have {length}, one for each {name}")
        else:
            for i, x in enumerate(data, 1):
                self._level(x, f"{where}[{i}]", rest, bad)

    def _report(self, bad: Sequence[str], named: int = NAMED) -> None:
        self.problems.extend(bad[:named])
        if len(bad) > named:
            self.problems.append(f"and {len(bad) - named} more like these")

    def table(self, data: Any, spec: Spec, where: str) -> Table | None:
        """Return a map."""
        names = [a.name for a in spec.axes]
        if not isinstance(data, dict):
            self.problems.append(f"{where} = {shown(data)}, must be a table with {', '.join(names)} and values")
            return None
        before = len(self.problems)
        self.keys(data, (*names, "values"), f"{where}.")
        self.required(data, (*names, "values"), f"{where}.")
        points = {name: self._axis(data[name], Spec(unit, ""), f"{where}.{name}", name) for name, unit in spec.axes if name in data}
        shape = [(n, len(points[n]) if points.get(n) is not None else None) for n in names]
        values = self.array(data["values"], spec, f"{where}.values", shape) if "values" in data else None
        if len(self.problems) > before:
            return None
        try:
            return Table.of(*(points[n] for n in names), values=values, clip=spec.clip)
        except ValueError as e:
            self.problems.append(f"{where}: {e}")
            return None

    def _axis(self, data: Any, spec: Spec, where: str, name: str) -> Any:
        points = self.array(data, spec, where, [(name, None)])
        if points is not None:
            given = data["values"] if isinstance(data, dict) else data
            # Points that differ by their last digits may be equal once converted.
            falls = [(i, *given[i - 2 : i]) for i, (a, b) in enumerate(pairwise(points), 2) if b <= a]
            self._report([f"{where}[{i}] = {b:g} follows {a:g}, an axis must rise strictly" for i, a, b in falls])
        return points

    def parameters(self, data: Mapping[str, Any], kind: type[Parameters], where: str, derived: Collection[str] = ()) -> dict[str, Any]:
        """Return the values of a parameter set by name; only what has a default or is `derived` may be missing."""
        known: dict[str, Field[Any]] = {f.name: f for f in fields(kind)}
        self.keys(data, known, where)
        for name, f in known.items():
            if name not in data and f.default is MISSING and name not in derived:
                self.problems.append(f"{where}{name} is missing: {spec_of(f).doc}")
        return {name: self._value(data[name], spec_of(f), f"{where}{name}") for name, f in known.items() if name in data}

    def _value(self, data: Any, spec: Spec, where: str) -> Any:
        if spec.axes:
            return self.table(data, spec, where)
        if spec.row:
            row = self.array(data, spec, where, [("row", None)])
            return None if row is None else tuple(row.tolist())
        return self.number(data, spec, where)


@dataclass(frozen=True, eq=False)
class ComponentFile:
    """A component as a file describes it; what other parts decide may still be open."""

    kind: str
    name: str
    title: str
    source: str
    path: str
    values: Mapping[str, Any] = field(repr=False)

    def __repr__(self) -> str:
        """Return name and kind."""
        return f"<ComponentFile {self.name}: {self.kind}>"

    def _repr_html_(self) -> str:
        facts = {"kind": self.kind, "source": self.source}
        return card(self.name, self.title, facts, Grid(DESCRIBED, described(self.component.parameters, self.values)))

    @property
    def component(self) -> type[Component]:
        """The class of the component."""
        return component_kinds()[self.kind]

    @cached_property
    def parameters(self) -> Parameters:
        """The parameter set; nothing may be open."""
        return self.build()

    def build(self, **values: Any) -> Parameters:
        """Return the parameter set with some values added or replaced."""
        return self.component.parameters(**{**self.values, **values})

    def to_toml(self) -> str:
        """Return the component as the text of a file, in SI units; read back it gives the same bits."""
        head = {"schema": SCHEMA, "kind": self.kind, "name": self.name, "title": self.title, "source": self.source}
        return toml_text(head, {"parameters": written(self.component.parameters, self.values)})

    def place(self, folder: Path | None = None) -> str:
        """Return what a vehicle's file calls it: its name in the library, or its path, seen from `folder` where that is given."""
        if str(_library().get(self.name, ("", ""))[1]) == self.path:
            return self.name
        return os.path.relpath(self.path, folder) if folder else os.path.abspath(self.path)

    def save(self, path: str | Path) -> Path:
        """Write the component to a TOML file, whole or not at all; its name becomes that of the file.

        Raises
        ------
        InputError
            If the file cannot be written, or its name does not end in ``.toml``.

        """
        return save_toml(path, lambda name: replace(self, name=name).to_toml())


def save_toml(path: str | Path, text: Callable[[str], str]) -> Path:
    """Write `text` of the file's name, without its ending, to a file."""
    target = Path(path)
    if target.suffix != ".toml":
        raise InputError(str(path), ["must end in .toml"])
    try:
        content = text(target.stem).encode()
    except UnicodeEncodeError as e:
        raise InputError(str(path), [f"{shown(e.object[e.start : e.end])} cannot be written in UTF-8"]) from e
    with written_whole(target) as part:
        part.write_bytes(content)
    return target


def parse_quantity(value: str | float, unit: str, where: str) -> float:
    """Return a number with unit, such as ``"0.05 kg m^2"``, in the SI unit `unit`."""
    reader = Reader()
    number = reader.number(value, Spec(unit, ""), where)
    reader.finish("input")
    return number


@cache
def _library() -> dict[str, tuple[str, Traversable]]:
    """Return kind and place of all components of the library by name."""
    found: dict[str, tuple[str, Traversable]] = {}
    for kind, path in ((k, path) for package in sources() for k in component_kinds() for path in data_files(package, k)):
        name = path.name.removesuffix(".toml")
        if name in found:
            raise InputError(f"component '{name}'", [f"stands twice in the library: {found[name][1]} and {path}; rename one"])
        found[name] = (kind, path)
    return dict(sorted(found.items()))


def component_names(kind: str | None = None) -> list[str]:
    """Return the names of the library's components, of one kind or all."""
    if kind is not None and kind not in component_kinds():
        raise InputError("component_names", [f"'{kind}' is not a kind of component{nearest(kind, component_kinds())}"])
    return [name for name, (k, _) in _library().items() if kind in (None, k)]


def read_component(source: str | Path, derived: Collection[str] = ()) -> ComponentFile:
    """Return a component of the library by name, or of a file ending in ``.toml``.

    Parameters
    ----------
    source
        Name or path.
    derived
        Names of parameters that the file may leave open, because the caller derives them from other parts.

    """
    path: Path | Traversable = Path(source)
    if isinstance(source, str) and not source.endswith(".toml"):
        library = _library()
        if source not in library:
            raise InputError(f"component '{source}'", [f"not in the library{nearest(source, library)}"])
        path = library[source][1]
    return _component(str(path), read_text(path, LARGEST), frozenset(derived))


# Vehicles share most of their parts; a file that has changed since is another text.
@lru_cache(maxsize=256)
def _component(path: str, text: str, derived: frozenset[str]) -> ComponentFile:
    reader = Reader()
    data = reader.toml(path, text, component_kinds(), {"parameters": dict})
    reader.required(data, ("source",), "")
    values: dict[str, Any] = {}
    if data.get("kind") in component_kinds():
        values = reader.parameters(data.get("parameters", {}), component_kinds()[data["kind"]].parameters, "parameters.", derived)
    reader.finish(path)
    file = ComponentFile(data["kind"], data["name"], data["title"], data["source"], path, values)
    if values.keys() >= derived:
        try:
            file.build()
        except InputError as e:
            raise InputError(path, [f"parameters: {p}" for p in e.problems]) from None
    return file
