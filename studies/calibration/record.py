"""What was measured on a drive: the trace, and series of outputs; and how a run of a vehicle predicts them.

A run gives a state (speed, charge, fuel used) at the ends of its steps, and a straight line between; a flow (power, torque, fuel flow) as
its mean over each step, so that its integral is a straight line between their ends.  From these follows what a row says:

- ``instant``: of a state, its value at that time; of a flow, that of the step the time lies in.
- ``mean``: of a flow, its mean since the row before.  Rows that are closer than steps are taken together, step by step.
- ``counted``: what was added since the first row, so that a counter may begin at any number.

States are instant and flows means, unless told.  A series in the output's unit times a time (J of a power, kg or L of a
fuel flow) is its integral, and counted; one in its unit over a time (kg/s of a fuel that is counted) is the rate between rows.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, TypeAlias, get_args

import numpy as np

from halfshaft.cosim.cycle import Cycle
from halfshaft.cosim.cycle_file import TRACE, read_csv
from halfshaft.library.base.errors import InputError, nearest, number
from halfshaft.library.base.tags import part_of
from halfshaft.library.files.component_file import parse_quantity
from halfshaft.models.assembly import Description
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.calibration.least_squares import Array

How: TypeAlias = Literal["instant", "mean", "counted"]
#: What a run predicts from: the value of a step, a state or an integral at a time, its rate between two, or what it gained since the first.
Form: TypeAlias = Literal["step", "value", "rate", "gain"]
_TITLE = re.compile(r"\s*(.*?)\s*(?:\[(.*)\]|\((.*)\))?\s*")
_OUTPUT = re.compile(r"\w+\.\w+")
#: Rows of a series are named up to this many.
NAMED = 5


def checked_rows(given: object, *columns: str) -> list[str]:
    """Keep columns of an object, the first of them its times, as arrays of floats; return what is wrong with them."""
    problems, arrays = [], list[Array]()
    for what in columns:
        try:
            row = np.array(getattr(given, what), dtype=float)
        except (TypeError, ValueError):
            row = np.empty((0, 0))
        object.__setattr__(given, what, row)
        arrays.append(row)
        if row.ndim != 1:
            problems.append(f"{what} must be a row of numbers")
        elif bad := np.flatnonzero(~np.isfinite(row)).tolist():
            rows = ", ".join(str(i + 1) for i in bad[:NAMED]) + (f" and {len(bad) - NAMED} more" if len(bad) > NAMED else "")
            problems.append(f"{what} is no finite number in row {rows}")
    lengths = zip(columns[1:], arrays[1:], strict=True)
    if not problems:
        problems += [f"{what} has {len(x)} rows, time has {len(arrays[0])}" for what, x in lengths if len(x) != len(arrays[0])]
    if not problems and np.any(np.diff(arrays[0]) <= 0):
        problems.append("time must rise")
    return problems


@dataclass(frozen=True)
class Reading:
    """How one output was measured.

    Parameters
    ----------
    column
        Title of its column in a file; the name of the output unless given.
    sigma
        Standard uncertainty of each row: ``"0.5 kW"``, ``"2 %"`` of what is read (of a charge, of full), or ``"0.5 kW + 2 %"``, their
        squares added; a number is SI.  Without it, the residuals tell.
    how
        ``instant``, ``mean`` or ``counted``.
    offset
        What is added to the times [s]: below 0 if the instrument was late.

    """

    column: str = ""
    sigma: float | str | None = None
    how: How | None = None
    offset: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Series:
    """What was measured of one output.

    Parameters
    ----------
    output
        Its name, ``battery.P_out``.
    time, values
        Rising times [s], and what was read at each.
    unit
        Of the values; SI unless given.
    reading
        How it was measured.

    Raises
    ------
    InputError
        If the rows are not what they must be; everything that is wrong is named at once.

    """

    output: str
    time: Array
    values: Array
    unit: str = ""
    reading: Reading = field(default_factory=Reading)

    def __post_init__(self) -> None:
        """Check what was given, and keep it as arrays of floats."""
        problems = checked_rows(self, "time", "values")
        if self.reading.how not in (None, *get_args(How)):
            problems.append(f"how = {self.reading.how!r}, must be one of {', '.join(get_args(How))}")
        if not math.isfinite(number(self.reading.offset)):
            problems.append(f"offset = {self.reading.offset!r} s, must be a finite number")
        if problems:
            raise InputError(f"series {self.output}", problems)

    def __repr__(self) -> str:
        return f"<Series {self.output}: {len(self.time)} rows{f' in {self.unit}' if self.unit else ''}>"


@dataclass(frozen=True, kw_only=True, eq=False)
class Record:
    """A drive: its trace, what was measured, and what of the vehicle was so on this drive only.

    Parameters
    ----------
    name
        What it is called.
    cycle
        The trace, whose times are those of the series.
    series
        What was measured.
    values
        Numbers of the vehicle on this drive, such as its mass or the charge at the start.
    notes
        What to know about it.

    """

    name: str
    cycle: Cycle
    series: tuple[Series, ...]
    values: Mapping[str, float | str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def read(self, readings: Mapping[str, Reading]) -> Record:
        """Return the drive with series read as said; those that are not named stay as they are.

        Raises
        ------
        InputError
            If it has no such series.

        """
        own = [s.output for s in self.series]
        if problems := [f"has no series {name}{nearest(name, own)}" for name in readings if name not in own]:
            raise InputError(f"record {self.name}", problems)
        return replace(self, series=tuple(replace(s, reading=readings.get(s.output, s.reading)) for s in self.series))

    def __repr__(self) -> str:
        return f"<Record {self.name}: {self.cycle.duration:g} s, {', '.join(s.output for s in self.series)}>"

    @classmethod
    def load(
        cls,
        path: str | Path,
        series: Mapping[str, Reading] | Sequence[str] | None = None,
        *,
        cycle: Cycle | None = None,
        values: Mapping[str, float | str] | None = None,
    ) -> Record:
        """Return the drive of a CSV file.

        Parameters
        ----------
        path
            The file, with the columns of a cycle (a time and a speed, perhaps a grade), and columns of what was measured, each with
            its unit in brackets: ``battery.P_out [kW]``; without one it is SI.
        series
            The outputs to take, and how each was measured; every column that is called like an output, if None.
        cycle
            The trace, if it is not that of the file.
        values
            Numbers of the vehicle on this drive.

        Raises
        ------
        InputError
            If the file is not such a table; everything that is wrong is named at once.

        """
        readings = None if series is None else dict(series) if isinstance(series, Mapping) else {name: Reading() for name in series}
        wanted = {} if readings is None else {(reading.column or name): name for name, reading in readings.items()}
        units: dict[str, str] = {}
        unused: list[str] = []

        def column(title: str) -> tuple[str, float, float] | None:
            name, unit = _split(title)
            output = wanted.get(title) or wanted.get(name) or (name if readings is None and _OUTPUT.fullmatch(name) else "")
            if not output:
                unused.append(title)
                return None
            units[output] = unit
            return output, 1.0, 0.0

        _, columns = read_csv(Path(path), {"time": TRACE["time"]}, "time", column)
        problems = [f"there is no column '{title}'{nearest(title, unused)}" for title, name in wanted.items() if name not in columns]
        if not units and not problems:
            problems.append("has no column that is called like an output, such as battery.P_out [kW]")
        try:
            cycle = Cycle.load(Path(path), others=True) if cycle is None else cycle
        except InputError as error:
            problems += error.problems
        if problems or cycle is None:
            raise InputError(str(path), problems)
        rows = [
            Series(output=name, time=columns["time"], values=columns[name], unit=unit, reading=(readings or {}).get(name, Reading()))
            for name, unit in units.items()
        ]
        return cls(name=Path(path).stem, cycle=cycle, series=tuple(rows), values=dict(values or {}))


def _split(title: str) -> tuple[str, str]:
    """Return name and unit of a title."""
    match = _TITLE.fullmatch(title)
    return (match[1], match[2] or match[3] or "") if match else (title, "")


class Predicted:
    """How a run with steps of a length predicts the rows of a series.

    Parameters
    ----------
    series
        What was measured.
    output
        What it is of.
    density
        Of the fuel of its part [kg/m^3], if it has one.
    ends
        Start and ends of the steps [s].
    problems
        Takes what is wrong.

    """

    def __init__(self, series: Series, output: Description, density: float | None, ends: Array, problems: list[str]) -> None:
        self.series, self.output, self.ends = series, output, ends
        self.notes: list[str] = []
        self.state = output.state is not None
        self.form: Form = "value"
        self.time = self.before = self.values = np.empty(0)
        self.sigma: Array | None = None
        before, reading = len(problems), series.reading
        if output.kind != "real":
            problems.append(f"{output.name} is a {output.kind}, whose derivatives are 0: nothing can be fitted to it")
        found = self._scaled(density, problems)
        how = self._how(found[0], problems) if found is not None else "instant"
        low, high = ends[0], ends[-1]
        if len(series.time) and (series.time[0] < low - 1e-6 or series.time[-1] > high + 1e-6):
            problems.append(
                f"{output.name} has times from {series.time[0]:g} to {series.time[-1]:g} s, the drive those from {low:g} to {high:g} s"
            )
        if found is None or len(problems) > before:
            return
        _, values, sigma = found
        time = series.time + reading.offset
        inside = (time >= low - 1e-9) & (time <= high + 1e-9)
        if np.sum(~inside):
            self.notes.append(f"{output.name}: {np.sum(~inside)} rows lie outside of the drive with their offset")
        if how == "instant" and not self.state:
            # There is no step before the start.
            inside &= time > low + 1e-9
        time, values, sigma = time[inside], values[inside], None if sigma is None else sigma[inside]
        if how == "instant":
            self.form, self.time, self.before = "value" if self.state else "step", time, time
        elif how == "counted":
            self.form, self.time, self.before = "gain", time[1:], np.full(len(time[1:]), time[0] if len(time) else 0.0)
            values, sigma = values[1:] - (values[0] if len(values) else 0.0), None if sigma is None else sigma[1:]
        else:
            self.form = "rate"
            self.time, self.before, values, sigma = self._together(time[1:], time[:-1], values[1:], None if sigma is None else sigma[1:])
        self.values, self.sigma = values, sigma
        if not len(values):
            problems.append(f"{output.name} has {len(series.time)} rows, of which none can be compared: there must be more")

    def _scaled(self, density: float | None, problems: list[str]) -> tuple[int, Array, Array | None] | None:
        """Return the power of time in the unit of the rows, and the rows and their uncertainty in SI."""
        series, si = self.series, self.output.unit
        kinds = [(0, si, 1.0), (1, "s" if si == "1" else f"{si}.s", 1.0), (-1, f"{si}/s", 1.0)]
        if density is not None and si in ("kg", "kg/s"):
            kinds += [(0, si.replace("kg", "m^3"), density), (1 if si == "kg/s" else -1, "m^3" if si == "kg/s" else "m^3/s", density)]
        for power, unit, factor in kinds:
            try:
                zero, one = (parse_quantity(f"{x} {series.unit}", unit, "") for x in (0, 1)) if series.unit else (0.0, 1.0)
            except InputError:
                continue
            values = factor * (zero + (one - zero) * series.values)
            sigma = self._sigma(values, unit, factor, problems)
            return power, values, sigma
        allowed = " or ".join(unit for _, unit, _ in kinds)
        problems.append(f"{self.output.name} has the unit '{series.unit}', must be one such as {allowed}")
        return None

    def _sigma(self, values: Array, unit: str, factor: float, problems: list[str]) -> Array | None:
        """Return the uncertainty of each row in SI."""
        given = self.series.reading.sigma
        if given is None:
            return None
        absolute = share = 0.0
        for term in re.split(r"\s+\+\s+", str(given).strip()):
            try:
                if re.fullmatch(r"[\d.eE+-]+\s*%", term) and unit != "1":
                    share = number(term.rstrip("% ")) / 100
                elif re.fullmatch(r"[\d.eE+-]+", term):
                    absolute = number(term)
                else:
                    # A difference: an uncertainty of 1 degC is one of 1 K.
                    zero, one = (parse_quantity(f"{x} {term.lstrip('0123456789.eE+- ')}", unit, "sigma") for x in (0, 1))
                    absolute = factor * (one - zero) * number(re.match(r"[\d.eE+-]+", term)[0])  # type: ignore[index]
            except (InputError, TypeError):
                absolute = math.nan
        sigma = np.hypot(absolute, share * values)
        if not (np.all(np.isfinite(sigma)) and np.all(sigma > 0)):
            least = "0.01" if unit == "1" else f"1 {unit}"
            hint = ", which is 0 where 0 was read: add a constant part" if share and not absolute else f", must be > 0, such as '{least}'"
            problems.append(f"{self.output.name} has the uncertainty {given!r}{hint}")
        return np.asarray(sigma)

    def _how(self, power: int, problems: list[str]) -> How:
        """Return how the rows were taken."""
        given, name = self.series.reading.how, self.output.name
        default: How = "counted" if power == 1 else "mean" if power == -1 or not self.state else "instant"
        if power == 1 and given in ("instant", "mean"):
            problems.append(f"{name} is measured as its integral, which is counted, not {given}")
        elif power == -1 and given in ("instant", "counted"):
            problems.append(f"{name} is measured as its rate, which is a mean, not {given}")
        elif power == 0 and self.state and given == "mean":
            problems.append(f"{name} is a state: it is read instant, or counted")
        elif power == 0 and not self.state and given == "counted":
            problems.append(f"{name} is a flow: what is counted of it has its unit times one of time")
        if (power == 1 and self.state) or (power == -1 and not self.state):
            what = "integral" if power == 1 else "rate"
            problems.append(f"{name} is measured in '{self.series.unit}', as its {what}, which a run does not tell")
        return given or default

    def _together(self, time: Array, before: Array, values: Array, sigma: Array | None) -> tuple[Array, Array, Array, Array | None]:
        """Return means over the steps, where rows are closer than steps."""
        if len(time) < 2 or np.median(time - before) > 0.75 * np.median(np.diff(self.ends)):
            return time, before, values, sigma
        step = np.searchsorted(self.ends, time - 1e-9)
        first = np.flatnonzero(np.diff(step, prepend=-1))
        last = np.append(first[1:], len(time)) - 1
        length = time - before
        total = np.add.reduceat(length, first)
        mean = np.add.reduceat(length * values, first) / total
        noise = None if sigma is None else np.sqrt(np.add.reduceat((length * sigma) ** 2, first)) / total
        self.notes.append(f"{self.output.name}: {len(time)} rows are taken together to {len(mean)}, step by step")
        return time[last], before[first], mean, noise

    def of(self, history: Array, first: Array) -> Array:
        """Return what is predicted of each row, by the output at the ends of all steps and a state's start; or of derivatives of these."""
        if self.form == "step":
            found: Array = history[np.minimum(np.searchsorted(self.ends[1:], self.time - 1e-9), len(history) - 1)]
            return found
        dt = np.diff(self.ends).reshape(-1, *[1] * (history.ndim - 1))
        line = np.concatenate([first[None], history if self.state else np.cumsum(history * dt, axis=0)])
        end = _between(self.ends, line, self.time)
        if self.form == "value":
            return end
        gained = end - _between(self.ends, line, self.before)
        return gained if self.form == "gain" else gained / (self.time - self.before).reshape(-1, *[1] * (history.ndim - 1))


def _between(ends: Array, line: Array, time: Array) -> Array:
    """Return a line that is given at the ends of the steps at other times."""
    i = np.clip(np.searchsorted(ends, time, side="right") - 1, 0, len(ends) - 2)
    share = ((time - ends[i]) / (ends[i + 1] - ends[i])).reshape(-1, *[1] * (line.ndim - 1))
    found: Array = line[i] * (1 - share) + line[i + 1] * share
    return found


def problems_of(record: Record, vehicle: Vehicle, outputs: Mapping[str, Description]) -> list[str]:
    """Return what is wrong with a record for a vehicle."""
    names = [s.output for s in record.series]
    problems = [] if names else [f"record {record.name} has no series"]
    problems += [
        f"record {record.name}: {name} is no output of vehicle '{vehicle.name}'{nearest(name, outputs)}"
        for name in names
        if name not in outputs
    ]
    problems += [
        f"record {record.name}: {name} is measured {names.count(name)} times" for name in dict.fromkeys(names) if names.count(name) > 1
    ]
    return problems


def density_of(vehicle: Vehicle, output: str) -> float | None:
    """Return the density of the fuel of an output's part [kg/m^3], if it burns any."""
    name = vehicle.tags.by_part("fuel density").get(part_of(output))
    return None if name is None else float(vehicle.values[name])
