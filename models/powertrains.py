"""The powertrains, and the model that a vehicle makes with one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

from halfshaft.library.base.component import Component
from halfshaft.library.base.parameters import numbers, tables
from halfshaft.models.conventional import conventional
from halfshaft.models.electric import electric
from halfshaft.models.model import Model
from halfshaft.models.series import series
from halfshaft.models.vehicle import Vehicle

BUILDERS: dict[str, Callable[[Mapping[str, Component]], Model]] = {
    "electric": electric,
    "series": series,
    "conventional": conventional,
}


def model_of(vehicle: Vehicle) -> Model:
    """Return the model of a vehicle."""
    return BUILDERS[vehicle.powertrain](vehicle.components())


@lru_cache(maxsize=256)
def structure_of(vehicle: Vehicle) -> tuple[Any, ...]:
    """Return what is built into the code of a vehicle: its parts and tables, not its numbers."""
    return (
        vehicle.powertrain,
        *(
            (role, type(part), tuple(name for name, *_ in numbers(part.p)), tuple((f, t.key) for f, t in tables(part.p)))
            for role, part in vehicle.components().items()
        ),
    )
