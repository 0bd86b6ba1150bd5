"""Vehicles: which parts fill the roles of a powertrain, the numbers set for them, and the rules that derive others.

A vehicle file names its parts by role, sets numbers as ``role.parameter`` and names rules.  A number that is set wins
over a rule; a rule follows when what it depends on changes.  With ``base`` a file starts from another vehicle and says
only what differs.  Numbers and rules of a part go when the part is replaced.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from functools import cached_property, lru_cache
from importlib.resources.abc import Traversable
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias, TypeVar

import numpy as np

from halfshaft.library.base.component import Component
from halfshaft.library.base.errors import InputError, nearest
from halfshaft.library.base.parameters import (
    DESCRIBED,
    Parameters,
    Rated,
    Spec,
    array_problems,
    described,
    outside,
    spec_of,
)
from halfshaft.library.base.tables import Table
from halfshaft.library.base.tags import Tags
from halfshaft.library.control.shift import ShiftParameters
from halfshaft.library.driveline.gearbox import MapGearboxParameters
from halfshaft.library.engine.engine import EngineParameters
from halfshaft.library.files.component_file import LARGEST, SCHEMA, ComponentFile, Reader, component_names, read_component, save_toml, shown
from halfshaft.library.files.notebook import Grid, card
from halfshaft.library.files.texts import cleaned, name_problem, read_text
from halfshaft.library.files.toml import inline, quantity, toml_text, written
from halfshaft.models.model import Model
from halfshaft.models.powertrain import Derived, Powertrain, powertrains, vehicle_files
from halfshaft.models.rules import Rule, Sets

Parts: TypeAlias = Mapping[str, ComponentFile]
P = TypeVar("P", bound=Parameters)
#: A map of a gearbox serves ratios that are so near to its own.
OTHER_RATIO = 0.01
#: Shift lines that fit an engine end between this share of its top speed and that speed.
LAST_SHIFT = 0.9
#: How the source of a changed vehicle begins: its changes are not of the base's source.
OWN = "own figures, on the base"
#: A vehicle is at most so many bases away from one that has none.
MOST_BASES = 20


@dataclass(frozen=True, kw_only=True, eq=False)
class Vehicle:
    """A vehicle with all its numbers.

    Raises
    ------
    InputError
        If names, numbers or parts do not fit; everything that is wrong is named at once.

    """

    name: str
    title: str
    source: str
    powertrain: str
    parts: Parts
    #: Numbers that were set, in SI, by ``role.parameter``.
    given: Mapping[str, float] = field(default_factory=dict)
    rules: Mapping[str, Rule] = field(default_factory=dict)
    parameters: Sets = field(init=False)

    def __post_init__(self) -> None:
        """Derive and check all parameters."""
        if problem := name_problem(self.name):
            raise InputError(f"vehicle '{self.name}'", [problem])
        object.__setattr__(self, "title", cleaned(self.title))
        object.__setattr__(self, "source", cleaned(self.source))
        object.__setattr__(self, "parameters", _parameter_sets(self))

    def __getstate__(self) -> dict[str, Any]:
        """Return what another process needs; what was worked out of it may hold functions, which cannot be sent."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    def __repr__(self) -> str:
        """Return name, powertrain and mass."""
        return f"<Vehicle {self.name}: {self.powertrain}, {self.mass:g} kg, {len(self.parts)} parts>"

    def _repr_html_(self) -> str:
        facts = {"powertrain": self.powertrain, "mass": f"{self.mass:g} kg", "source": self.source}
        parts = [(role, part.name, part.kind, part.title) for role, part in self.parts.items()]
        rows = [(f"{role}.{name}", *rest) for role, p in self.parameters.items() for name, *rest in described(type(p), vars(p))]
        return card(
            self.name,
            self.title,
            facts,
            Grid(("role", "component", "kind", "title"), parts),
            Grid(DESCRIBED, rows, f"{len(rows)} parameters"),
        )

    @property
    def explicit(self) -> frozenset[str]:
        """Names of the numbers that were set."""
        return frozenset(self.given)

    @cached_property
    def values(self) -> dict[str, Any]:
        """All numbers by ``role.parameter``, the entries of a row by ``role.parameter_1`` and so on."""
        return {f"{role}.{name}": value for role, p in self.parameters.items() for name, value in p.values.items()}

    @property
    def mass(self) -> float:
        """Test mass [kg]."""
        return float(self.values[self.tags.the("vehicle mass")])

    @cached_property
    def tags(self) -> Tags:
        """What the numbers are, by ``role.parameter``."""
        return _tags(tuple((role, type(p)) for role, p in self.parameters.items()))

    @cached_property
    def specs(self) -> dict[str, Spec]:
        """Unit, meaning and bounds of all numbers."""
        return dict(_known(tuple(self.parts.items())).specs)

    @cached_property
    def rated(self) -> dict[str, Rated]:
        """What can be set in place of factors, by ``role.rating``."""
        return dict(_known(tuple(self.parts.items())).rated)

    @cached_property
    def derived(self) -> frozenset[str]:
        """Names of the numbers that follow from others, by rules."""
        targets = {d.target for d in powertrains()[self.powertrain].derived if d.target in self.rules or self._open(d)}
        return frozenset(n for n in self.values if n not in self.given and targets & {n, n.rpartition("_")[0]})

    def _open(self, derived: Derived) -> bool:
        return derived.role in self.parts and derived.parameter not in self.parts[derived.role].values

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """What was made for other parts or numbers than this vehicle has; runs show it among their warnings."""
        return (*_maps_of_other_ratios(self), *_lines_of_another_engine(self))

    def model(self) -> Model:
        """Return the parts, connected."""
        return powertrains()[self.powertrain].model(self.components())

    @cached_property
    def structure(self) -> tuple[Any, ...]:
        """What is built into the code of the vehicle: its parts and tables, not its numbers."""
        return (
            self.powertrain,
            *((role, part.component, *self.parameters[role].structure) for role, part in self.parts.items()),
        )

    def components(self) -> dict[str, Component]:
        """Return the components by role, from the wheel to the source."""
        return {role: part.component(self.parameters[role]) for role, part in self.parts.items()}

    def with_values(self, values: Mapping[str, float | str]) -> Vehicle:
        """Return the vehicle with numbers set: SI numbers, or texts with a unit; the rules follow."""
        reader = Reader()
        plain = {name: x.item() if isinstance(x, np.generic) else x for name, x in values.items()}
        given = _numbers(reader, self.parts, plain, "", plain=True)
        reader.finish(f"vehicle '{self.name}'")
        return replace(self, given={**_without_rivals(self.parts, self.given, given), **given}, source=_source_on(self))

    def with_arrays(self, values: Mapping[str, Any]) -> Vehicle:
        """Return a vehicle that stands for many, as `with_values`, but that values may be arrays, with an entry for each [SI].

        Its numbers are arrays where the vehicles differ; only a batch can run it.
        """
        reader, specs = Reader(), self.specs | {name: rated.spec for name, rated in self.rated.items()}
        arrays: dict[str, Any] = {name: x for name, x in values.items() if isinstance(x, np.ndarray)}
        # Names are checked with numbers that are allowed in place of the arrays; these then, as a whole.
        given = _numbers(reader, self.parts, {**values, **{name: self.values.get(name, 1.0) for name in arrays}}, "", plain=True)
        known = not reader.problems
        reader.problems += [problem for name, x in arrays.items() if name in specs for problem in outside(name, specs[name], x)]
        if known:
            with np.errstate(all="ignore"):
                fleet = replace(self, given=_without_rivals(self.parts, self.given, given) | given | arrays, source=_source_on(self))
                reader.problems += [f"{role}.{problem}" for role, p in fleet.parameters.items() for problem in array_problems(p)]
        reader.problems = list(dict.fromkeys(reader.problems))
        reader.finish(f"vehicle '{self.name}'")
        return fleet

    def displaced(self, values: Mapping[str, Any]) -> Vehicle:
        """Return a vehicle that stands for many near to this one, to see how its numbers change with some of them.

        As `with_arrays`, but that bounds are not looked at, the mass is not rounded, and maps that a rule makes stay as they are.
        """
        targets = [d.target for d in powertrains()[self.powertrain].derived if isinstance(self._at(d.target), Table)]
        own = {role: {t.partition(".")[2]: self._at(t) for t in targets if t.startswith(f"{role}.")} for role in self.parts}
        parts = {role: replace(part, values={**part.values, **own[role]}) if own[role] else part for role, part in self.parts.items()}
        rules = {target: rule.unrounded for target, rule in self.rules.items() if target not in targets}
        given = {**_without_rivals(self.parts, self.given, values), **values}
        with np.errstate(all="ignore"):
            return replace(self, parts=parts, rules=rules, given=given)

    def _at(self, name: str) -> Any:
        role, _, parameter = name.partition(".")
        return getattr(self.parameters.get(role), parameter, None)

    def with_parts(self, parts: Mapping[str, str | Path | ComponentFile]) -> Vehicle:
        """Return the vehicle with parts replaced, by names in the library, paths of files, or components that were read before."""
        reader = Reader()
        powertrain = powertrains()[self.powertrain]
        new = _parts(reader, powertrain, parts, "", Path())
        reader.finish(f"vehicle '{self.name}'")
        return replace(
            self,
            source=_source_on(self),
            parts=_ordered(powertrain, {**self.parts, **new}),
            given=_without(self.given, new),
            rules=_without(self.rules, new),
        )

    def to_toml(self, folder: Path | None = None) -> str:
        """Return the vehicle as the text of a file, in SI units; read back it gives the same bits.

        Parts from files of their own are named by their place, seen from `folder` where that is given.
        """
        head = {"schema": SCHEMA, "kind": "vehicle", "name": self.name, "title": self.title, "source": self.source}
        derive = {}
        for target, rule in self.rules.items():
            values = {f.name: getattr(rule, f.name) for f in fields(rule)}
            derive[target] = inline({"rule": rule.name, **written(type(rule), values)})
        specs = self.specs | {name: rated.spec for name, rated in _known(tuple(self.parts.items())).rated.items()}
        sections: dict[str, Mapping[str, Any]] = {
            "parts": {role: part.place(folder) for role, part in self.parts.items()},
            "set": {name: quantity(value, specs[name]) for name, value in self.given.items()},
            "derive": derive,
        }
        return toml_text({**head, "powertrain": self.powertrain}, sections)

    def save(self, path: str | Path) -> Path:
        """Write the vehicle to a TOML file, whole or not at all; its name becomes that of the file.

        Raises
        ------
        InputError
            If the file cannot be written, or its name does not end in ``.toml``.

        """
        return save_toml(path, lambda name: replace(self, name=name).to_toml(Path(path).parent))

    @classmethod
    def load(cls, source: str | Path) -> Vehicle:
        """Return a vehicle of the library by name, or of a file ending in ``.toml``."""
        return _load(source, ())


def vehicle_names() -> list[str]:
    """Return the names of the library's vehicles."""
    return list(vehicle_files())


# Runs ask for it again and again.
@lru_cache(maxsize=256)
def _tags(kinds: tuple[tuple[str, type[Parameters]], ...]) -> Tags:
    found = ((f"{role}.{f.name}", spec_of(f).tag) for role, kind in kinds for f in fields(kind))
    return Tags({name: tag for name, tag in found if tag})


class _Known(NamedTuple):
    """What of some parts can be set by name: numbers, ratings in place of factors; and what are maps."""

    specs: Mapping[str, Spec]
    rated: Mapping[str, Rated]
    maps: frozenset[str]


# Studies set numbers of the same parts again and again.
@lru_cache(maxsize=64)
def _known(parts: tuple[tuple[str, ComponentFile], ...]) -> _Known:
    specs = {}
    for role, part in parts:
        for f in fields(part.component.parameters):
            spec = spec_of(f)
            row = part.values.get(f.name, () if f.default is MISSING else f.default) if spec.row else ()
            names = [f"{f.name}_{i}" for i in range(1, len(row) + 1)] if spec.row else [] if spec.axes else [f.name]
            specs.update({f"{role}.{name}": spec for name in names})
    rated = {f"{role}.{rated.name}": rated for role, part in parts for rated in part.component.parameters.rated}
    maps = frozenset(f"{role}.{f.name}" for role, part in parts for f in fields(part.component.parameters) if spec_of(f).axes)
    return _Known(specs, rated, maps)


@lru_cache(maxsize=256)
def _built(part: ComponentFile, values: tuple[tuple[str, Any], ...], typed: tuple[tuple[str, float], ...]) -> Parameters:
    """Return the parameter set of a part with numbers set; the same one again for the same numbers."""
    return part.build(**dict(values)).rescaled(dict(typed))


def _without_rivals(parts: Parts, given: Mapping[str, float], new: Collection[str]) -> dict[str, float]:
    """Return what was given but for ratings and factors that new ones stand for."""
    rated = _known(tuple(parts.items())).rated

    def factor(name: str) -> str:
        return f"{name.partition('.')[0]}.{rated[name].scale}" if name in rated else name

    replaced = {factor(name) for name in new}
    return {name: x for name, x in given.items() if factor(name) not in replaced}


def _numbers(reader: Reader, parts: Parts, values: Mapping[str, Any], where: str, *, plain: bool = False) -> dict[str, float]:
    """Return numbers by ``role.parameter`` in SI."""
    known, rated, maps = _known(tuple(parts.items()))
    specs = {**known, **{name: r.spec for name, r in rated.items()}}
    for name in (n for n in values if n in maps):
        role = name.partition(".")[0]
        factors = " or ".join(n for n in specs if n.startswith(f"{role}.") and n.endswith("_scale"))
        instead = f"stretch it by {factors}, or replace the {role}" if factors else f"replace the {role}"
        reader.problems.append(f"{where}{name} is a map, not a number: {instead}")
    reader.keys([n for n in values if n not in maps], specs, where)
    for name, r in rated.items():
        factor = f"{name.partition('.')[0]}.{r.scale}"
        if name in values and factor in values:
            reader.problems.append(f"{where}{name} and {where}{factor} both say how large it is; set one of them")
    return {name: reader.number(x, specs[name], where + name, plain=plain) for name, x in values.items() if name in specs}


def _parts(
    reader: Reader, powertrain: Powertrain, names: Mapping[str, Any], where: str, folder: Path | Traversable
) -> dict[str, ComponentFile]:
    """Return the parts by role; names that end in ``.toml`` are relative to `folder`."""
    reader.keys(names, powertrain.roles, where)
    parts = {}
    for role, name in names.items():
        if role not in powertrain.roles:
            continue
        kinds = powertrain.kinds(role)
        if not isinstance(name, str | Path | ComponentFile):
            reader.problems.append(f"{where}{role} = {shown(name)}, must be the name of a component")
            continue
        try:
            part = name if isinstance(name, ComponentFile) else read_component(_beside(folder, name), powertrain.derivable(role))
        except InputError as e:
            reader.problems.extend(f"{where}{role}: {e.where}: {p}" for p in e.problems)
            continue
        if part.kind in kinds:
            parts[role] = part
        else:
            called, fitting = str(getattr(name, "name", name)), [n for kind in kinds for n in component_names(kind)]
            reader.problems.append(
                f"{where}{role} = {shown(called)} is of kind {part.kind}, must be {' or '.join(kinds)}{nearest(called, fitting)}"
            )
    return parts


def _beside(folder: Path | Traversable, name: str | Path) -> str | Path:
    return folder / Path(name) if isinstance(folder, Path) and str(name).endswith(".toml") else name


def _ordered(powertrain: Powertrain, parts: Parts) -> dict[str, ComponentFile]:
    return {role: parts[role] for role in powertrain.roles if role in parts}


def _without(named: Mapping[str, Any], roles: Collection[str]) -> dict[str, Any]:
    return {name: x for name, x in named.items() if name.partition(".")[0] not in roles}


def _rules(reader: Reader, powertrain: Powertrain, parts: Parts, data: Mapping[str, Any], where: str) -> dict[str, Rule]:
    names = {f"{role}.{f.name}" for role, part in parts.items() for f in fields(part.component.parameters)}
    targets = {d.target: {rule.name: rule for rule in d.rules} for d in powertrain.derived if d.target in names}
    fixed = [n for n in data if n in names and n not in targets]
    reader.problems.extend(f"{where}{n}: no rule gives it in the powertrain {powertrain.name}" for n in fixed)
    reader.keys([n for n in data if n not in fixed], targets, where)
    rules = {}
    for target, fitting in targets.items():
        if target not in data:
            continue
        settings, place = data[target], f"{where}{target}"
        name = settings.get("rule") if isinstance(settings, dict) else None
        if not isinstance(name, str) or name not in fitting:
            reader.problems.append(f"{place} has rule {shown(name)}, must be {' or '.join(fitting)}")
            continue
        before = len(reader.problems)
        values = reader.parameters({k: v for k, v in settings.items() if k != "rule"}, fitting[name], f"{place}.")
        if len(reader.problems) == before:
            rules[target] = fitting[name](**values)
    return rules


def _flat(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return what belongs to each ``role.parameter``, whether or not the name was quoted."""
    nested = {role: x for role, x in data.items() if "." not in role and isinstance(x, dict)}
    return {k: x for k, x in data.items() if k not in nested} | {f"{r}.{k}": x for r, part in nested.items() for k, x in part.items()}


def _of_kind(vehicle: Vehicle, kind: type[P]) -> Iterator[tuple[ComponentFile, P]]:
    """Yield the parts whose parameters are of a kind, with those."""
    yield from ((vehicle.parts[role], p) for role, p in vehicle.parameters.items() if isinstance(p, kind))


def _maps_of_other_ratios(vehicle: Vehicle) -> Iterator[str]:
    for part, gearbox in _of_kind(vehicle, MapGearboxParameters):
        pairs = enumerate(zip(part.values["ratios"], gearbox.ratios, strict=True), 1)
        gears = [f"{own:.4g} in gear {i}, made for {made:.4g}" for i, (made, own) in pairs if abs(own / made - 1) > OTHER_RATIO]
        if gears:
            yield f"the efficiency map of gearbox {part.name} is used at ratios that it was not made for: {', '.join(gears)}"


def _lines_of_another_engine(vehicle: Vehicle) -> Iterator[str]:
    for (lines, shift), (own, engine) in product(_of_kind(vehicle, ShiftParameters), _of_kind(vehicle, EngineParameters)):
        last, top = shift.up.inside(0)[1], engine.tau_max.inside(0)[1] * engine.speed_scale
        if not LAST_SHIFT <= last / top <= 1:
            ends = f"the shift lines of {lines.name} end at {last:.0f} rad/s, engine {own.name} at {top:.0f} rad/s"
            yield f"{ends}: they were made for another engine"


def _source_on(base: Vehicle | None) -> str:
    """Return where the figures come from that differ from a base: from whoever changed it."""
    if base is None:
        return ""
    return base.source if base.source.startswith(OWN) else f"{OWN} {base.name} ({base.source})"


def _load(source: str | Path, above: tuple[str, ...]) -> Vehicle:
    path: Path | Traversable = Path(source)
    if isinstance(source, str) and not source.endswith(".toml"):
        library = vehicle_files()
        if source not in library:
            raise InputError(f"vehicle '{source}'", [f"not in the library{nearest(source, library)}"])
        path = library[source]
    if str(path) in above or len(above) > MOST_BASES:
        raise InputError(str(path), ["base leads back to the vehicle itself"])
    reader = Reader()
    extra = {"powertrain": str, "base": str, "parts": dict, "set": dict, "derive": dict}
    data = reader.toml(str(path), read_text(path, LARGEST), ["vehicle"], extra)
    folder = path.parent if isinstance(path, Path) else path
    base = None
    if "base" in data:
        beside = folder / data["base"] if isinstance(folder, Path) and data["base"].endswith(".toml") else data["base"]
        base = _load(beside, (*above, str(path)))
    else:
        reader.required(data, ("source", "powertrain", "parts"), "")
    name = data.get("powertrain", base.powertrain if base else "")
    if name not in powertrains():
        if "powertrain" in data:
            reader.problems.append(f"powertrain = {shown(name)} is not known{nearest(name, powertrains())}")
        reader.finish(str(path))
    elif base and name != base.powertrain:
        reader.problems.append(f'powertrain = {shown(name)}, must be that of its base, "{base.powertrain}"')
    powertrain = powertrains()[name]
    new = _parts(reader, powertrain, data.get("parts", {}), "parts.", folder)
    parts = _ordered(powertrain, {**(base.parts if base else {}), **new})
    reader.required({**parts, **data.get("parts", {})}, powertrain.roles, "parts.")
    lost = (powertrain.roles.keys() - parts) | (data.get("parts", {}).keys() - new)
    given = _numbers(reader, parts, _without(_flat(data.get("set", {})), lost), "set.")
    rules = _rules(reader, powertrain, parts, _without(_flat(data.get("derive", {})), lost), "derive.")
    reader.finish(str(path))
    try:
        return Vehicle(
            name=data["name"],
            title=data["title"],
            source=data["source"] if "source" in data else _source_on(base),
            powertrain=powertrain.name,
            parts=parts,
            given={**(_without_rivals(parts, _without(base.given, new), given) if base else {}), **given},
            rules={**(_without(base.rules, new) if base else {}), **rules},
        )
    except InputError as e:
        raise InputError(str(path), e.problems) from None


def _parameter_sets(vehicle: Vehicle) -> dict[str, Parameters]:
    """Return the parameter sets by role, with the numbers that were set and what the rules derive."""
    problems: list[str] = []
    values = {role: dict(part.values) for role, part in vehicle.parts.items()}
    typed: dict[str, dict[str, float]] = {role: {} for role in vehicle.parts}
    ratings = _known(tuple(vehicle.parts.items())).rated
    for name, x in vehicle.given.items():
        role, _, parameter = name.partition(".")
        if name in ratings:
            typed[role][parameter] = x
            continue
        stem, _, place = parameter.rpartition("_")
        if stem in values[role] and isinstance(values[role][stem], tuple):
            row = values[role][stem]
            values[role][stem] = (*row[: int(place) - 1], x, *row[int(place) :])
        else:
            values[role][parameter] = x
    rules = dict(vehicle.rules)
    derived = {d.target: d for d in powertrains()[vehicle.powertrain].derived}
    for d in derived.values():
        if d.parameter in values[d.role] or d.target in rules:
            continue
        if d.rules[0].lacks():
            names = " or ".join(rule.name for rule in d.rules)
            problems.append(f"{d.target} has no value; set it, or derive it by {names}")
        else:
            rules[d.target] = d.rules[0]()
    if problems:
        raise InputError(f"vehicle '{vehicle.name}'", problems)
    # An entry of a row ends in its place: body.m_test is none of body.m.
    rows_set = {stem for stem, _, place in (name.rpartition("_") for name in vehicle.given) if place.isdigit()}
    rules = {target: rule for target, rule in rules.items() if target not in rows_set | vehicle.given.keys()}
    # What looks at all parts comes last.
    rules = dict(sorted(rules.items(), key=lambda item: item[1].needs is None))
    sets: dict[str, Parameters] = {}

    def build(role: str) -> None:
        try:
            part = vehicle.parts[role]
            own = tuple((name, x) for name, x in values[role].items() if x is not part.values.get(name))
            key = part, own, tuple(typed[role].items())
            try:
                hash(key)
            except TypeError:
                # Arrays, which stand for many vehicles.
                sets[role] = _built.__wrapped__(*key)
            else:
                sets[role] = _built(*key)
        except InputError as e:
            problems.extend(f"{role}: {p}" for p in e.problems)

    waiting = {target.partition(".")[0] for target in rules}
    for role in values:
        if role not in waiting:
            build(role)
    if not problems:
        for target, rule in rules.items():
            role, _, parameter = target.partition(".")
            try:
                value = derived[target].value(rule, sets)
            except InputError as e:
                problems.extend(f"{target}: {p}" for p in e.problems)
                continue
            if isinstance(value, tuple) and len(value) != len(values[role][parameter]):
                problems.append(f"{target} has {len(values[role][parameter])} entries, its rule gives {len(value)}")
            values[role][parameter] = value
            build(role)
    if problems:
        raise InputError(f"vehicle '{vehicle.name}'", problems)
    return {role: sets[role] for role in vehicle.parts}
