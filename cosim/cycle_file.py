"""Reads cycles from CSV files: those of this project, and those of other tools and of loggers, as far as their columns tell their units.

Columns stand between commas, semicolons or tabs; where not between commas, numbers may have decimal commas.  A good file is
read by NumPy's parser, in C; only one that it refuses, or that holds what no cycle has, is gone through line by line, to say
what is wrong.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from importlib.resources.abc import Traversable
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from halfshaft.library.base.errors import InputError, nearest
from halfshaft.library.files.texts import cleaned, read_text

Array: TypeAlias = npt.NDArray[np.float64]

#: Largest file [MB].
LARGEST = 500
#: At most so many bad lines are named.
NAMED = 20

_TIMES = {"s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0}
_SPEEDS = {
    "mps": 1.0, "m_per_s": 1.0, "meters_per_second": 1.0, "kmh": 1 / 3.6, "kph": 1 / 3.6, "kmph": 1 / 3.6, "mph": 0.44704,
    "kn": 1852 / 3600, "knots": 1852 / 3600,
}  # fmt: skip
_LENGTHS = {"m": 1.0, "meters": 1.0, "km": 1000.0, "ft": 0.3048, "mi": 1609.344}
_SHARES = {"1": 1.0, "percent": 0.01, "pct": 0.01, "%": 0.01}


class Quantity(NamedTuple):
    """What a column may hold: how it is called, its units with their factors to SI, that of a title without unit, and bounds."""

    titles: tuple[str, ...]
    units: Mapping[str, float]
    unit: str | None
    needed: str | None = None
    low: float = -math.inf
    high: float = math.inf
    allowed: str = ""


#: Any finite number.
ANY = Quantity((), {}, None)
#: A logger at rest may show a speed so far below zero [m/s].
NEGATIVE = 0.5
#: What a trace and a grade over distance may hold.
TRACE = {
    "time": Quantity(("time", "t", "elapsed_time", "total_elapsed_time", "timestamp"), _TIMES, "s", "time_s"),
    "speed": Quantity(
        ("speed", "v", "velocity", "vehicle_speed", "gps_speed", "speed_gps", "speed_obd"), _SPEEDS, None, "speed_mps",
        -NEGATIVE, 1000.0, f">= 0 and <= 1000 m/s (what is above -{NEGATIVE:g} m/s, of a logger at rest, is set to 0)",
    ),
    "grade": Quantity(
        ("grade", "slope", "gradient", "road_gradient", "road_grade"), _SHARES, "1", None,
        -1.0, 1.0, ">= -1 and <= 1 (rise over run: 5 % is 0.05, or 5 in a column grade_percent)",
    ),
    "elevation": Quantity(("elevation", "altitude", "ele", "alt"), _LENGTHS, "m"),
    "key_on": Quantity(("key_on",), {"1": 1.0}, "1", None, 0.0, 1.0, ">= 0 and <= 1"),
}  # fmt: skip
GRADE = {
    "distance": Quantity(("distance", "dist"), _LENGTHS, "m", "distance_m"),
    "grade": TRACE["grade"],
    "elevation": TRACE["elevation"],
}
#: Titles of other tools that name no unit, or a quantity by its unit alone.
ALIASES = {
    "cycsecs": "time_s", "cycmps": "speed_mps", "cycgrade": "grade", "<t>": "time_s", "<v>": "speed_kmh", "<grad>": "grade_percent",
    "<s>": "distance_m", **{unit: f"speed_{unit}" for unit in ("mps", "kmh", "kph", "mph")}, "seconds": "time_s", "secs": "time_s",
}  # fmt: skip
#: Columns of loggers and other tools that say nothing of a cycle.
UNUSED = {
    "lat", "latitude", "lon", "lng", "longitude", "heading", "bearing", "course", "accuracy", "hdop", "vdop", "pdop", "satellites",
    "road_type", "cycroadtype",
}  # fmt: skip


#: What a column is, by its title: its name, factor and offset to SI; a text says what is wrong with it; None: known, or to be left out.
Others: TypeAlias = Callable[[str], tuple[str, float, float] | str | None]


class Column(NamedTuple):
    """One column that is read."""

    place: int
    title: str
    name: str
    factor: float
    offset: float = 0.0


def read_csv(
    path: Path | Traversable, known: Mapping[str, Quantity], axis: str, others: Others | None = None
) -> tuple[dict[str, str], dict[str, Array]]:
    """Return what stands before the columns of a CSV file (several notes one below the other), and the columns in SI.

    Parameters
    ----------
    path
        The file.
    known
        What its columns may hold, by name.
    axis
        Which of them must rise.
    others
        Says of a title what its column is; None for one of those known, or one that is left out.  Without it every column must be known.

    Raises
    ------
    InputError
        If anything is wrong with the file; every bad line is named, up to a limit.

    """
    # Not by `splitlines`, which also breaks at control characters.
    lines = read_text(path, LARGEST).replace("\r\n", "\n").replace("\r", "\n").split("\n")
    notes: dict[str, str] = {}
    for line in lines:
        if line.startswith("#") and (m := re.match(r"#\s*(name|title|source|note):(.*)", line)):
            text = m[2].strip() if m[1] == "name" else cleaned(m[2])
            # There may be several notes.
            notes[m[1]] = f"{notes[m[1]]}\n{text}" if m[1] == "note" and "note" in notes else text
    start = next((i for i, line in enumerate(lines) if line.strip() and not line.startswith(("#", "sep="))), None)
    if start is None:
        raise InputError(str(path), ["is empty"])
    head = lines[start]
    separator = next((sign for sign in ";\t" if sign in head), ",")
    columns, width = _columns(path, head.split(separator), start + 1, known, others)
    known = {**dict.fromkeys((c.name for c in columns), ANY), **known}
    body = lines[start + 1 :]
    values = _quickly(body, separator, columns, width)
    with np.errstate(over="ignore"):
        found = {} if values is None else {c.name: values[:, k] * c.factor + c.offset for k, c in enumerate(columns)}
    if not found or not all(_holds(known[name], x) for name, x in found.items()) or np.any(np.diff(found[axis]) <= 0):
        raise InputError(str(path), _wrong(body, start + 2, separator, columns, width, known, axis))
    return notes, found


def rows_of(columns: Mapping[str, Array]) -> list[str]:
    """Return the lines of a CSV file with these columns; what is read of them is the same to the last bit."""
    return [",".join(columns), *(",".join(map(repr, row)) for row in np.column_stack(list(columns.values())).tolist())]


def _quickly(body: Sequence[str], separator: str, columns: Sequence[Column], width: int) -> Array | None:
    """Return the numbers of the wanted columns, or None where a line is not as it should be."""
    if not any(line.strip() and not line.startswith("#") for line in body):
        return None
    # With columns left out, NumPy does not count those that are there.
    if width > len(columns) and any(line.count(separator) != width - 1 for line in body if line.strip() and not line.startswith("#")):
        return None
    lines: Sequence[str] = body if separator == "," else [line.replace(",", ".") for line in body]
    try:
        values = np.loadtxt(
            lines,
            delimiter=separator,
            comments="#",
            quotechar='"',
            ndmin=2,
            usecols=[c.place for c in columns] if width > len(columns) else None,
        )
    except (ValueError, OverflowError):
        return None
    return values if values.shape[1] == len(columns) else None


def _holds(quantity: Quantity, values: Array) -> bool:
    return bool(np.all(np.isfinite(values)) and values.min() >= quantity.low and values.max() <= quantity.high)


def _columns(
    path: Path | Traversable, titles: Sequence[str], line: int, known: Mapping[str, Quantity], others: Others | None
) -> tuple[list[Column], int]:
    problems, columns = [], []
    if not any(re.search("[^\\W\\d]", title) for title in titles):
        wanted = ", ".join(q.needed for q in known.values() if q.needed)
        raise InputError(str(path), [f"line {line} holds numbers; a line with the names of the columns must come first: {wanted}"])
    for place, title in enumerate(titles):
        plain = _plain(title)
        if plain in UNUSED:
            continue
        other = others and others(title.strip(" \"'"))
        if isinstance(other, tuple):
            columns.append(Column(place, title.strip(), *other))
            continue
        found = other or _quantity(plain, known)
        if others and not other and isinstance(found, str) and plain not in {t for q in known.values() for t in q.titles}:
            continue
        if isinstance(found, str):
            problems.append(f"line {line}: column '{title.strip()}' {found}")
        else:
            columns.append(Column(place, plain, *found))
    names = [c.name for c in columns]
    needed = {name: q.needed for name, q in known.items() if q.needed}
    problems += [f"line {line}: column {title} is missing" for name, title in needed.items() if name not in names]
    if "grade" not in names and "elevation" not in names and "distance" in known:
        problems.append(f"line {line}: column grade is missing")
    problems += [f"line {line}: there are several columns with the {name}" for name in sorted(set(names)) if names.count(name) > 1]
    if "grade" in names and "elevation" in names:
        problems.append(f"line {line}: grade and elevation say the same, delete one of them")
    if problems:
        raise InputError(str(path), problems)
    return columns, len(titles)


def _plain(title: str) -> str:
    """Return the plain name of a column: ``Speed [km/h]`` is ``speed_kmh``."""
    plain = title.strip(" \"'").lower().replace("km/h", "kmh").replace("m/s", "mps").replace("%", "percent")
    plain = plain.replace("meters/second", "mps")
    plain = re.sub(r"[\s_\[\]().]+", "_", plain).strip("_")
    return ALIASES.get(plain, plain)


def _quantity(plain: str, known: Mapping[str, Quantity]) -> tuple[str, float] | str:
    """Return name and factor of a column, or what is wrong with its title."""
    titled = [(title, name, q) for name, q in known.items() for title in q.titles if plain == title or plain.startswith(f"{title}_")]
    if not titled:
        near = nearest(plain, [f"{title}_{unit}" for q in known.values() for title in q.titles for unit in q.units] + ["grade", "key_on"])
        return f"is not known{near or '; if it is none of ' + ', '.join(known) + ', delete it'}"
    title, name, q = max(titled, key=lambda x: len(x[0]))
    unit = plain.removeprefix(title).strip("_") or q.unit
    if unit is None:
        return f"does not tell its unit: call it {' or '.join(f'{name}_{u}' for u in ('mps', 'kmh', 'mph'))}"
    if unit not in q.units:
        return f"has a unit that is not known, must be one of {', '.join(u for u in q.units if u != '%')}"
    return name, q.units[unit]


def _wrong(
    body: Sequence[str], first: int, separator: str, columns: Sequence[Column], width: int, known: Mapping[str, Quantity], axis: str
) -> list[str]:
    """Return what is wrong with the lines of a file."""
    numbered = [(i, line.partition("#")[0]) for i, line in enumerate(body, first) if line.partition("#")[0].strip()]
    if not numbered:
        return ["has no line with numbers"]
    problems: list[str] = []
    points = []
    for i, line in numbered:
        row = [entry.strip(' "') for entry in line.split(separator)]
        points.append(math.nan)
        if len(row) != width:
            commas = "; decimal commas need semicolons between the columns" if separator == "," and width < len(row) <= 2 * width else ""
            problems.append(f"line {i} has {len(row)} entries, must have {width}{commas}")
            continue
        for c in columns:
            text = row[c.place]
            try:
                # Python would take underscores and the digits of any script.
                value = float((text if separator == "," else text.replace(",", ".")) if text.isascii() and "_" not in text else "")
            except ValueError:
                clock = "; write seconds since the start" if c.name == "time" and re.search(r"\d[-:]\d", text) else ""
                problems.append(f"line {i}: {c.title} = '{text[:40]}', must be a number{clock}")
                continue
            if not math.isfinite(value):
                problems.append(f"line {i}: {c.title} = {text[:40]}, must be a finite number")
            elif not known[c.name].low <= value * c.factor + c.offset <= known[c.name].high:
                problems.append(f"line {i}: {c.title} = {text[:40]}, must be {known[c.name].allowed}")
            if c.name == axis:
                points[-1] = value
    title = next(c.title for c in columns if c.name == axis)
    falls = zip(numbered[1:], pairwise(points), strict=True)
    problems += [f"line {i}: {title} = {b:g} follows {a:g}, it must rise" for (i, _), (a, b) in falls if b <= a]
    problems = problems or ["has a column that is not made of plain numbers"]
    return problems[:NAMED] + ([f"and {len(problems) - NAMED} more like these"] if len(problems) > NAMED else [])
