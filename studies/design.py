"""Which points a sweep runs: its axes, and the grid or the sample over them.

An axis is a number of the vehicle by its name, a role of the powertrain whose part is replaced, or the vehicle itself.  Its
values are a list, or of a number also a range: ``1000..1600:4`` four values at equal distances, ``1000..1600`` what a
sample takes values between; or a distribution that a sample is drawn from, ``normal(1300, 40)``.  Numbers are SI, or have a
unit; a unit at the end counts for those before it that have none.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

import numpy as np

from halfshaft.library.base.errors import InputError, nearest
from halfshaft.library.files.component_file import ComponentFile, Reader, shown
from halfshaft.studies.distributions import (
    Correlation,
    Distribution,
    correlated,
    correlation_matrix,
    is_distribution,
    read_distribution,
)

if TYPE_CHECKING:
    from halfshaft.cosim.compiled import Array
    from halfshaft.library.base.parameters import Spec
    from halfshaft.models.vehicle import Vehicle

#: What an axis may be given as: a text, a list of numbers, of texts with units, or of names, or a distribution of `scipy.stats`.
Given: TypeAlias = str | Sequence[float | str | Path] | Any
Value: TypeAlias = float | str
Kind: TypeAlias = Literal["lhs", "sobol", "saltelli"]

#: No axis has more values, and no sweep more points.
MOST_VALUES, MOST_POINTS = 100_000, 10_000_000
#: The axis over several vehicles.
VEHICLE = "vehicle"
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_RANGE = re.compile(rf"\s*({_NUMBER}[^:]*?)\s*\.\.\s*({_NUMBER}[^:]*?)\s*(?::\s*([^:]*?)\s*)?")
_PLAIN = re.compile(rf"\s*({_NUMBER})\s*(.*?)\s*")


@dataclass(frozen=True)
class Axis:
    """What is varied.

    Parameters
    ----------
    name
        ``role.parameter``, a role, or ``vehicle``.
    unit, doc
        Of a number, SI; empty for what is chosen by name.
    values
        Those of a grid or a list; of an open range its two ends; of a distribution, between which nine tenths of it lie.
    open
        Whether a sample takes any number between the two values.
    parts
        The components that the values are the names of.
    spread
        The distribution that a sample takes numbers from.

    """

    name: str
    unit: str
    doc: str
    values: tuple[Value, ...]
    open: bool = False
    parts: tuple[ComponentFile, ...] = ()
    spread: Distribution | None = None

    @property
    def numeric(self) -> bool:
        """Whether its values are numbers."""
        return "." in self.name

    def at(self, share: float) -> Value:
        """Return the value at a share of the axis, from 0 to below 1: of a list each value has an equal part."""
        if self.spread:
            return float(self.spread.at(share))
        if self.open:
            low, high = (float(x) for x in self.values)
            return low + share * (high - low)
        return self.values[min(int(share * len(self.values)), len(self.values) - 1)]


@dataclass(frozen=True)
class Sample:
    """How points are drawn.

    Parameters
    ----------
    kind
        ``lhs`` a Latin hypercube, ``sobol`` a scrambled Sobol sequence, ``saltelli`` the matrices that Sobol's indices are
        worked out from.
    n
        Number of points; of ``saltelli`` the number of rows of each matrix, of which there are two more than axes.
    seed
        The same one draws the same points.

    """

    kind: Kind
    n: int
    seed: int = 0

    @classmethod
    def read(cls, text: str, seed: int = 0) -> Sample:
        """Return what ``sobol:64`` says.

        Raises
        ------
        InputError
            If it says no sample.

        """
        kind, _, n = text.partition(":")
        problems = []
        if kind not in get_args(Kind):
            problems.append(f"'{kind}' is not known, must be one of {', '.join(get_args(Kind))}{nearest(kind, get_args(Kind))}")
        count = int(n) if re.fullmatch(r"\d{1,9}", n) else 0
        if count < 2:
            problems.append(f"has {shown(n) if n else 'no'} points, must have at least 2, such as sobol:64")
        elif kind in ("sobol", "saltelli") and count & (count - 1):
            below = 1 << (count.bit_length() - 1)
            problems.append(f"has {count} points, must have a power of 2, such as {below} or {2 * below}")
        if not (isinstance(seed, int) and seed >= 0):
            problems.append(f"has seed {seed!r}, must be a whole number >= 0")
        if problems:
            raise InputError(f"sample {text}", problems)
        return cls(kind, count, seed)  # type: ignore[arg-type]

    def size(self, axes: int) -> int:
        """Return how many points there are."""
        return self.n * (axes + 2) if self.kind == "saltelli" else self.n

    def shares(self, axes: int) -> Array:
        """Return the points in the unit cube, shape ``(points, axes)``."""
        from scipy.stats import qmc  # takes over a second

        if self.kind == "lhs":
            return np.asarray(qmc.LatinHypercube(axes, rng=self.seed).random(self.n))
        if self.kind == "sobol":
            return np.asarray(qmc.Sobol(axes, rng=self.seed).random(self.n))
        a, b = np.hsplit(qmc.Sobol(2 * axes, rng=self.seed, bits=64).random(self.n), 2)
        mixed = [np.where(np.arange(axes) == i, b, a) for i in range(axes)]
        return np.concatenate([a, b, *mixed])


@dataclass(frozen=True)
class Design:
    """Axes, and the points over them."""

    axes: tuple[Axis, ...]
    sample: Sample | None = None
    #: Of the normal scores of what is drawn, as `distributions` has it; None where all is independent.
    correlation: Array | None = None

    @property
    def dims(self) -> tuple[str, ...]:
        """Dimensions of what is found: the axes of a grid, or ``point``."""
        return ("point",) if self.sample else tuple(axis.name for axis in self.axes)

    @property
    def shape(self) -> tuple[int, ...]:
        """Length of each dimension."""
        return (self.sample.size(len(self.axes)),) if self.sample else tuple(len(axis.values) for axis in self.axes)

    @property
    def size(self) -> int:
        """How many points there are."""
        return math.prod(self.shape)

    @cached_property
    def points(self) -> Sequence[tuple[Value, ...]]:
        """The values of all axes at each point; on a grid the last axis varies fastest."""
        if self.sample is None:
            return list(product(*(axis.values for axis in self.axes)))
        shares = self.sample.shares(len(self.axes))
        if self.correlation is not None:
            shares = correlated(shares, self.correlation)
        columns = [
            axis.spread.at(column).tolist() if axis.spread else [axis.at(u) for u in column.tolist()]
            for axis, column in zip(self.axes, shares.T, strict=True)
        ]
        return list(zip(*columns, strict=True))


def design_of(
    vehicles: Sequence[Vehicle], axes: Mapping[str, Given], sample: Sample | None, problems: list[str],
    correlation: Correlation | None = None, truncate: bool = False,
) -> Design:  # fmt: skip
    """Return the design, and add to `problems` all that is wrong with it.

    Distributions are cut at the bounds of their numbers with `truncate`; without, what is drawn outside of them is wrong.
    """
    names = [car.name for car in vehicles]
    problems.extend(f"vehicle '{name}' is given {names.count(name)} times" for name in dict.fromkeys(names) if names.count(name) > 1)
    found = [Axis(VEHICLE, "", "vehicle", tuple(names))] if len(vehicles) > 1 else []
    if not axes and not found:
        problems.append("has no axis, must have at least one, such as body.m=1000..1600:4")
    roles = {name: given for name, given in axes.items() if "." not in name}
    parts: dict[str, list[Vehicle]] = {}
    for name, given in roles.items():
        axis, parts[name] = _parts(vehicles, name, given, problems)
        found.append(axis)
    settable = [_settable(car) for car in vehicles]
    for name, given in axes.items():
        if name not in roles:
            role = name.partition(".")[0]
            known = [_settable(car) for car in parts[role]] if parts.get(role) else settable
            axis = _numbers(name, given, known, sample, problems, truncate)
            found.append(axis)
    _rivals(vehicles, [axis.name for axis in found if axis.numeric], problems)
    order = {VEHICLE: -1, **{name: i for i, name in enumerate(axes)}}
    found.sort(key=lambda axis: order[axis.name])
    matrix = correlation_matrix(correlation, [axis.name for axis in found], problems)
    if matrix is not None:
        problems.extend(f"axis {axis.name} has a correlation, must be a distribution" for axis in found if not axis.spread)
        if sample is not None and sample.kind == "saltelli":
            problems.append("a sample saltelli is for numbers that are independent: leave out the correlation, or draw sobol:N")
    design = Design(tuple(found), sample, matrix)
    if design.size > MOST_POINTS:
        problems.append(f"has {design.size} points, must have at most {MOST_POINTS}; draw a sample")
    elif not problems:
        problems.extend(_drawn_outside(design, settable[0]))
    return design


def _drawn_outside(design: Design, specs: Mapping[str, Spec]) -> Iterator[str]:
    """Yield which distributions reach beyond the bounds of their numbers."""
    for i, axis in enumerate(design.axes):
        if axis.spread and axis.name in specs and (bad := specs[axis.name].outside(x := np.array([p[i] for p in design.points]))).any():
            spec, worst = specs[axis.name], x[bad][np.argmax(np.abs(x[bad] - axis.spread.mean))]
            told = f"{int(bad.sum())} of {len(x)} points are outside, such as {spec.shown(worst)}, must be {spec.allowed()}"
            yield f"axis {axis.name} = {axis.spread.text}: {told}; narrow it, or truncate it there"


def _settable(car: Vehicle) -> dict[str, Spec]:
    """Return what can be set by name: the numbers, and the ratings that stand for factors."""
    return car.specs | {name: rated.spec for name, rated in car.rated.items()}


def _parts(vehicles: Sequence[Vehicle], role: str, given: Given, problems: list[str]) -> tuple[Axis, list[Vehicle]]:
    """Return an axis over parts, and the vehicles with each of them."""
    items: Any = given.split(",") if isinstance(given, str) else given if hasattr(given, "__len__") else [given]
    values = tuple(str(x).strip() for x in items)
    before = len(problems)
    _count(role, values, problems)
    known = {name for car in vehicles for name in (*car.parts, *_settable(car))}
    lacking = [car for car in vehicles if role not in car.parts]
    if lacking:
        problems.append(f"axis {role}: vehicle '{lacking[0].name}' has no such role{nearest(role, known)}")
    found = []
    for car, value in product(vehicles, values) if len(problems) == before else ():
        try:
            found.append(car.with_parts({role: value}))
        except InputError as error:
            problems.extend(f"axis {problem}" for problem in error.problems if f"axis {problem}" not in problems)
    # Every vehicle has read the same ones.
    parts = tuple(car.parts[role] for car in found[: len(values)])
    return Axis(role, "", f"part in the role {role}", values, parts=parts), found


def _numbers(
    name: str, given: Given, settable: Sequence[Mapping[str, Spec]], sample: Sample | None, problems: list[str], truncate: bool
) -> Axis:
    """Return an axis over a number."""
    known = {n: spec for of in settable for n, spec in of.items()}
    specs = [of[name] for of in settable if name in of]
    empty = Axis(name, "1", "", ())
    if not isinstance(given, str) and not hasattr(given, "__len__") and not is_distribution(given):
        problems.append(f"axis {name} = {shown(given)}, must be a list or a range such as 1000..1600:4")
        return empty
    if not specs:
        problems.append(f"axis {name} is not known{nearest(name, known)}")
        return empty
    if len(specs) < len(settable):
        problems.append(f"axis {name}: not every one of the vehicles and parts has it")
    if len({spec.unit for spec in specs}) > 1:
        problems.append(f"axis {name} has not the same unit in all vehicles: {' and '.join(sorted({spec.unit for spec in specs}))}")
    reader, spec = Reader(), specs[0]
    if is_distribution(given):
        return _spread(name, given, spec, sample, problems, truncate) or empty
    match = _RANGE.fullmatch(given) if isinstance(given, str) else None
    if match is None:
        items = given.split(",") if isinstance(given, str) else [x.item() if isinstance(x, np.generic) else x for x in given]
        values = tuple(reader.number(x, spec, f"axis {name}", plain=True) for x in _with_units(items))
        if not reader.problems:
            _count(name, values, reader.problems)
        problems.extend(reader.problems)
        return Axis(name, spec.unit, spec.doc, values)
    low, high = (reader.number(x, spec, f"axis {name}", plain=True) for x in _with_units(match.groups()[:2]))
    if not reader.problems and not low < high:
        reader.problems.append(f"axis {name} = {shown(given)}, the first end must be below the second")
    n = match[3]
    count = int(n) if n and re.fullmatch(r"\d{1,9}", n) else 0
    if n is not None and sample is not None:
        reader.problems.append(f"axis {name} = {shown(given)}, a sample takes any value between the ends: leave out :{n}")
    elif count > MOST_VALUES:
        reader.problems.append(f"axis {name} = {shown(given)} has {count} values, must have at most {MOST_VALUES}")
    elif sample is None and count < 2:
        told = "no number of values" if n is None else f"the number of values {n}" if n else "no number of values"
        reader.problems.append(f"axis {name} = {shown(given)} has {told}, must have at least two, such as {name}={match[1]}..{match[2]}:4")
    problems.extend(reader.problems)
    if reader.problems:
        return empty
    # With the digits that a reader would type: 0.3 and not 0.30000000000000004.
    values = (low, high) if sample else tuple(float(f"{x:.12g}") for x in np.linspace(low, high, count))
    return Axis(name, spec.unit, spec.doc, values, open=sample is not None)


def _spread(name: str, given: Given, spec: Spec, sample: Sample | None, problems: list[str], truncate: bool) -> Axis | None:
    """Return an axis over a number that has a distribution."""
    spread = read_distribution(given, spec, f"axis {name}", problems)
    if sample is None:
        problems.append(f"axis {name} = {shown(given)} is a distribution, which needs a sample, such as sobol:256")
    if spread is None:
        return None
    if truncate:
        spread = spread.within(spec)
        problems.extend(f"axis {name} = {spread.text}, {problem}" for problem in spread.problems())
    return Axis(name, spec.unit, spec.doc, tuple(spread.at([0.05, 0.95]).tolist()), spread=spread)


def _with_units(items: Sequence[Any]) -> Iterator[Any]:
    """Yield numbers and texts; a number without a unit has that of the next one that has one."""
    unit, found = "", []
    for item in reversed(items):
        if isinstance(item, str) and (match := _PLAIN.fullmatch(item)):
            unit = match[2] or unit
            found.append(f"{match[1]} {unit}" if unit else float(match[1]))
        else:
            found.append(item)
    yield from reversed(found)


def _count(name: str, values: Sequence[Value], problems: list[str]) -> None:
    given = [x for x in values if x != ""]
    if len(given) < 2:
        problems.append(f"axis {name} has {'one value' if given else 'no value'}, must have at least two")
    doubled = [x for x in dict.fromkeys(given) if given.count(x) > 1]
    problems.extend(f"axis {name} has {shown(x)} {given.count(x)} times" for x in doubled)


def _rivals(vehicles: Sequence[Vehicle], names: Sequence[str], problems: list[str]) -> None:
    """Report ratings and factors that say the same thing."""
    stands = {name: f"{name.partition('.')[0]}.{rated.scale}" for car in vehicles for name, rated in car.rated.items()}
    for i, name in enumerate(names):
        problems.extend(
            f"axes {other} and {name} both say how large it is; vary one of them"
            for other in names[:i]
            if stands.get(other, other) == stands.get(name, name)
        )


#: What reads an axis of the command line.
def read_axes(texts: Sequence[str], problem: Callable[[str], None]) -> dict[str, Given]:
    """Return axes from texts such as ``body.m=1000..1600:4``, and call `problem` with what is wrong."""
    axes: dict[str, Given] = {}
    for text in texts:
        name, sign, values = (part.strip() for part in text.partition("="))
        if not (name and sign and values):
            problem(f"--axis {text}: must be NAME=VALUES, such as body.m=1000..1600:4 or motor=ac-75kw,ac-59kw")
        elif name in axes:
            problem(f"--axis {name} is given twice")
        else:
            axes[name] = values
    return axes
