"""What a sweep is, as JSON holds it: by this a folder of another sweep is known, and a result says what it was made of."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from halfshaft import __version__
from halfshaft.cosim.origin import machine, part_text, vehicle_text, versions
from halfshaft.library.base.errors import InputError
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.design import Design

#: What a folder of a sweep is written as.
FORMAT = 1
#: At most so many differences of two sweeps are named.
NAMED = 8


def manifest(vehicles: tuple[Vehicle, ...], design: Design, tasks: tuple[Any, ...]) -> dict[str, Any]:
    """Return what a sweep is and where it was begun.

    Parameters
    ----------
    vehicles, design, tasks
        What is done where.

    """
    sweep = {
        "version": __version__,
        "vehicles": {car.name: _vehicle(car) for car in vehicles},
        "axes": {
            axis.name: {
                "values": axis.values,
                "open": axis.open,
                "parts": [part_text(part).sha256 for part in axis.parts],
                "distribution": axis.spread and [axis.spread.text, axis.spread.low, axis.spread.high],
            }
            for axis in design.axes
        },
        "sample": plain(design.sample),
        "correlation": None if design.correlation is None else design.correlation.tolist(),
        "tasks": {task.name: plain(task) for task in tasks},
    }
    texts = {car.name: vehicle_text(car) for car in vehicles}
    origin = {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": machine(),
        "versions": versions(),
        "vehicles": {name: {"sha256": text.sha256, "text": text.text} for name, text in texts.items()},
    }
    # What comes back from a file has no tuples.
    return dict(json.loads(json.dumps({"format": FORMAT, "sweep": sweep, "origin": origin})))


def _vehicle(car: Vehicle) -> dict[str, Any]:
    """Return what makes a vehicle: also what was set and what follows from rules, as they act when other numbers change."""
    return {
        "powertrain": car.powertrain,
        "parts": {role: part_text(part).sha256 for role, part in car.parts.items()},
        "values": car.values,
        "set": sorted(car.given),
        "rules": plain(car.rules),
    }


def plain(value: Any) -> Any:
    """Return a value as JSON can hold it; two are equal if the values are.

    Raises
    ------
    InputError
        If it is something that equal ones cannot be told by.

    """
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.ndarray):
        digest = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
        return f"{value.dtype} {'x'.join(map(str, value.shape))} sha256 {digest}"
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Path):
        return str(value)
    if is_dataclass(value) and not isinstance(value, type):
        return {"is": type(value).__qualname__, **{f.name: plain(getattr(value, f.name)) for f in fields(value) if f.init}}
    if isinstance(value, Mapping):
        return {str(key): plain(x) for key, x in value.items()}
    if isinstance(value, list | tuple):
        return [plain(x) for x in value]
    if isinstance(value, set | frozenset):
        return sorted(json.dumps(plain(x)) for x in value)
    raise InputError(
        "sweep", [f"{type(value).__name__} {value!r:.60} is no option of a task: it must be made of numbers, texts and dataclasses"]
    )


def differences(there: Any, here: Any) -> list[str]:
    """Return in what two sweeps differ."""
    found = list(_differences(there, here, ""))
    return found[:NAMED] + ([f"and {len(found) - NAMED} more"] if len(found) > NAMED else [])


def _differences(there: Any, here: Any, where: str) -> Iterator[str]:
    if isinstance(there, dict) and isinstance(here, dict):
        place = f"{where}: " if where else ""
        for key in dict.fromkeys((*there, *here)):
            if key not in here:
                yield f"{place}{key} is in the folder only"
            elif key not in there:
                yield f"{place}{key} is new"
            else:
                yield from _differences(there[key], here[key], place + key)
    elif there != here:
        yield f"{where} is {_short(there)} in the folder and {_short(here)} now"


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else f"{text[:40]} ... {text[-12:]}"
