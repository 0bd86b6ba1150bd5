"""Parameters of components: value, unit, meaning and bound in one declaration.

A parameter set is a frozen dataclass whose fields are made by `param` (a number), `params` (a row of numbers, one
per gear for instance) and `table` (a map).  Numbers are SI.  The same class serves a component with numbers, and the
symbolic component from which the step is made: the assembler replaces each number by a symbol (`replace`).  It serves many
components at once too: a number may be an array, with an entry for each of them.  Bounds are checked for numbers only;
`array_problems` looks at arrays.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import MISSING, Field, dataclass, field, fields, replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np

from halfshaft.library.base.errors import InputError
from halfshaft.library.base.tables import Axis, Table
from halfshaft.library.base.tags import Tag
from halfshaft.library.files.notebook import Grid, card


class Spec(NamedTuple):
    """What is known of a parameter besides its value."""

    unit: str
    doc: str
    gt: float | None = None
    ge: float | None = None
    lt: float | None = None
    le: float | None = None
    axes: tuple[Axis, ...] = ()
    clip: bool = True
    row: bool = False
    tag: Tag = ""

    def shown(self, value: float) -> str:
        """Return a number with its unit, if it has one."""
        return f"{value:g}" if self.unit == "1" else f"{value:g} {self.unit}"

    def allowed(self) -> str:
        """Return the bounds in words, such as ``> 0 kg``; empty without bounds."""
        pairs = ((">", self.gt), (">=", self.ge), ("<", self.lt), ("<=", self.le))
        return " and ".join(f"{sign} {self.shown(bound)}" for sign, bound in pairs if bound is not None)

    @property
    def lowest(self) -> float | None:
        """The least number inside the bounds; above 0 the least normal one, as not every tool reads smaller ones."""
        if self.gt is None:
            return self.ge
        return math.nextafter(self.gt, math.inf) if self.gt else sys.float_info.min

    @property
    def highest(self) -> float | None:
        """The greatest number inside the bounds."""
        return self.le if self.lt is None else math.nextafter(self.lt, -math.inf)

    def holds(self, value: float) -> bool:
        """Return whether a number lies inside the bounds; NaN and infinity never do."""
        return (
            math.isfinite(value)
            and (self.gt is None or value > self.gt)
            and (self.ge is None or value >= self.ge)
            and (self.lt is None or value < self.lt)
            and (self.le is None or value <= self.le)
        )

    def outside(self, values: Any) -> Any:
        """Return which entries of an array lie outside the bounds."""
        inside = np.isfinite(values)
        for compared, bound in ((np.greater, self.gt), (np.greater_equal, self.ge), (np.less, self.lt), (np.less_equal, self.le)):
            if bound is not None:
                inside &= compared(values, bound)
        return ~inside


def param(unit: str, doc: str, default: Any = MISSING, **bounds: Any) -> Any:
    """Declare a number in SI unit `unit` with its meaning and bounds (``gt``, ``ge``, ``lt``, ``le``); ``tag`` says what it is."""
    return field(default=default, metadata={"spec": Spec(unit, doc, **bounds)})


def params(unit: str, doc: str, default: Any = MISSING, **bounds: Any) -> Any:
    """Declare a row of numbers."""
    return field(default=default, metadata={"spec": Spec(unit, doc, row=True, **bounds)})


def table(unit: str, doc: str, *axes: Axis, clip: bool, default: Any = MISSING, **bounds: Any) -> Any:
    """Declare a map over `axes`; outside of them it is clipped to the edge or extrapolated linearly."""
    return field(default=default, metadata={"spec": Spec(unit, doc, axes=axes, clip=clip, **bounds)})


class Relation(NamedTuple):
    """What must not be between several parameters of a set.

    ``broken`` takes the set, with numbers or with symbols, so that the C of an FMU asks the same; ``message`` says what is
    wrong and has the values, each as ``{name:g}``.
    """

    broken: Callable[[Any], Any]
    message: str


class Rated(NamedTuple):
    """What a part can be asked to be rated at, in place of a factor: the factor ``scale`` is then what gives that rating.

    ``of`` returns the rating of a set, which grows in proportion to the factor.
    """

    name: str
    unit: str
    doc: str
    scale: str
    of: Callable[[Any], float]

    @property
    def spec(self) -> Spec:
        """Unit, meaning and bounds."""
        return Spec(self.unit, f"{self.doc}; sets {self.scale}", gt=0)


@dataclass(frozen=True, kw_only=True)
class Parameters:
    """Base of all parameter sets.

    Raises
    ------
    InputError
        If numbers lie outside their bounds; all of them are named at once.

    """

    relations: ClassVar[tuple[Relation, ...]] = ()
    rated: ClassVar[tuple[Rated, ...]] = ()

    def __post_init__(self) -> None:
        """Check the bounds of all numbers."""
        problems = []
        for f in fields(self):
            spec, value = spec_of(f), getattr(self, f.name)
            if isinstance(value, Table) and (len(value.points), value.clip) != (len(spec.axes), spec.clip):
                outside = "clipped" if spec.clip else "extrapolated"
                problems.append(f"{f.name} has {len(value.points)} axes, must have {len(spec.axes)} and be {outside} outside of them")
            if isinstance(value, Table):
                # The ends tell for all, and are not numbers where one is none.
                ends: tuple[float, float] = value.values.min(), value.values.max()
                numbers: Iterable[Any] = () if spec.holds(ends[0]) and spec.holds(ends[1]) else value.values.flat
            else:
                numbers = value if spec.row else (value,)
            bad = [x for x in numbers if isinstance(x, int | float) and not spec.holds(x)]
            if bad:
                problems.append(f"{f.name} = {spec.shown(bad[0])}, must be {spec.allowed() or 'a finite number'}")
        problems.extend(self.check())
        if problems:
            raise InputError(type(self).__name__, problems)

    def check(self) -> list[str]:
        """Return which relations are broken; symbols break none."""
        return [r.message.format_map(vars(self)) for r in self.relations if isinstance(wrong := r.broken(self), bool | np.bool) and wrong]

    @property
    def weight(self) -> float:
        """Mass of the part [kg]: that of its figures times its factors on size; 0 for what is weighed with the vehicle."""
        size = math.prod(getattr(self, name, 1.0) for name in ("torque_scale", "speed_scale", "power_scale"))
        return plain(getattr(self, "mass", 0.0) * size)

    @property
    def P_own(self) -> float:
        """Largest power that the part brings into the vehicle [W]: of an engine, a fuel cell, a store; 0 for all else."""
        return 0.0

    def rescaled(self, typed: Mapping[str, float]) -> Parameters:
        """Return the set with the ratings that were typed."""
        factors = {r.scale: getattr(self, r.scale) * typed[r.name] / r.of(self) for r in self.rated if r.name in typed}
        return replace(self, **factors) if factors else self

    @cached_property
    def structure(self) -> tuple[tuple[str, ...], tuple[tuple[str, Any], ...]]:
        """Names of the numbers, and the content of the tables by name: what is built into code."""
        return tuple(name for name, *_ in all_numbers(self)), tuple((name, t.key) for name, t in tables(self))

    @cached_property
    def values(self) -> dict[str, Any]:
        """The numbers by name, the entries of a row as ``name_1``, ``name_2`` and so on."""
        return {name: plain(value) for name, _, value in all_numbers(self)}

    def ratings(self) -> Mapping[str, float]:
        """Return what the part is rated at: ``energy`` of a store [J], ``traction power`` of what drives [W]."""
        return {}

    def _repr_html_(self) -> str:
        return card(type(self).__name__, "", {}, Grid(DESCRIBED, described(type(self), vars(self))))


#: What `described` tells of a parameter.
DESCRIBED = ("parameter", "value", "unit", "meaning")


def described(kind: type[Parameters], values: Mapping[str, Any]) -> Iterator[tuple[str, str, str, str]]:
    """Yield each parameter with its value as texts; without a value and a default it is open."""
    for f in fields(kind):
        spec, value = spec_of(f), values.get(f.name, f.default)
        if value is MISSING:
            yield f.name, "open", spec.unit, f"{spec.doc}; follows from other parts of a vehicle"
        elif spec.axes:
            yield f.name, "map", spec.unit, f"{spec.doc}; {value.extent}"
        elif spec.row:
            yield from ((f"{f.name}_{i}", f"{x:g}", spec.unit, spec.doc) for i, x in enumerate(value, 1))
        else:
            yield f.name, f"{value:g}", spec.unit, spec.doc


def spec_of(f: Field[Any]) -> Spec:
    """Return the declaration of a field."""
    spec = f.metadata["spec"]
    assert isinstance(spec, Spec)
    return spec


def numbers(p: Parameters) -> Iterator[tuple[str, Spec, float]]:
    """Yield name, declaration and value of every number; rows give ``name_1``, ``name_2`` and so on."""
    yield from ((name, spec, float(x)) for name, spec, x in all_numbers(p))


def all_numbers(p: Parameters) -> Iterator[tuple[str, Spec, Any]]:
    """Yield the same, the arrays among them too."""
    for f in fields(p):
        spec, value = spec_of(f), getattr(p, f.name)
        if spec.row:
            yield from ((f"{f.name}_{i}", spec, x) for i, x in enumerate(value, 1))
        elif not spec.axes:
            yield f.name, spec, value


def tables(p: Parameters) -> Iterator[tuple[str, Table]]:
    """Yield name and value of every table, also of those that follow from others: the cached properties of a set."""
    for f in fields(p):
        if spec_of(f).axes:
            yield f.name, getattr(p, f.name)
    for name, followed in vars(type(p)).items():
        if isinstance(followed, cached_property):
            yield name, getattr(p, name)


def plain(x: Any) -> float:
    """Return a number as Python's own, and an array, which stands for many, as it is."""
    return x if isinstance(x, np.ndarray) else float(x)  # type: ignore[return-value]


def each(function: Callable[..., Any], *arguments: Any) -> Any:
    """Return a function of numbers and maps; where numbers are arrays, of each of their distinct entries."""
    arrays = [x for x in arguments if isinstance(x, np.ndarray)]
    if not arrays:
        return function(*arguments)
    rows, place = np.unique(np.column_stack(np.broadcast_arrays(*arrays)), axis=0, return_inverse=True)
    found = []
    for row in rows.tolist():
        entries = iter(row)
        found.append(function(*(next(entries) if isinstance(x, np.ndarray) else x for x in arguments)))
    return np.array(found)[place.ravel()]


def array_problems(p: Parameters) -> Iterator[str]:
    """Yield what is wrong with the numbers of a set that are arrays: what `Parameters` itself says of plain numbers."""
    arrays = {name: (spec, x) for name, spec, x in all_numbers(p) if isinstance(x, np.ndarray)}
    for name, (spec, x) in arrays.items():
        yield from outside(name, spec, x)
    for relation in p.relations if arrays else ():
        broken = relation.broken(p)
        if isinstance(broken, np.ndarray) and broken.any():
            one = {name: x[broken.argmax()] if isinstance(x, np.ndarray) else x for name, x in vars(p).items()}
            yield f"{relation.message.format_map(one)}{_where(broken)}"


def outside(name: str, spec: Spec, values: Any) -> Iterator[str]:
    """Yield which entries of an array lie outside the bounds."""
    if (bad := spec.outside(values)).any():
        yield f"{name} = {spec.shown(values[bad.argmax()])}{_where(bad)}, must be {spec.allowed() or 'a finite number'}"


def _where(bad: Any) -> str:
    n = int(bad.sum())
    return f" at index {bad.argmax()}{f' and {n - 1} more' if n > 1 else ''}"


def bind(p: Parameters, symbols: dict[str, Any], functions: dict[str, Any]) -> Parameters:
    """Return the same parameter set with its numbers replaced by symbols and its tables by functions."""
    values: dict[str, Any] = {}
    for f in fields(p):
        spec = spec_of(f)
        if spec.axes:
            values[f.name] = functions[f.name]
        elif spec.row:
            values[f.name] = tuple(symbols[f"{f.name}_{i}"] for i in range(1, len(getattr(p, f.name)) + 1))
        else:
            values[f.name] = symbols[f.name]
    values |= {name: functions[name] for name, _ in tables(p) if name not in values}
    bound = object.__new__(type(p))
    for name, value in values.items():
        object.__setattr__(bound, name, value)
    return bound
