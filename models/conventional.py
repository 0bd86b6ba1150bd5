"""Conventional car: engine, clutch and gearbox."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from halfshaft.models.model import Model


def conventional(parts: Mapping[str, Any]) -> Model:
    """Return the model; parts are listed from the wheel to the source."""
    m, p = Model("conventional", parts), parts
    m.connect(p["body"].tyre, p["wheel"].tyre)
    m.connect(p["wheel"].axle, p["final_drive"].output)
    m.connect(p["final_drive"].input, p["gearbox"].output)
    m.connect(p["gearbox"].input, p["clutch"].output)
    m.connect(p["clutch"].input, p["accessories"].load)
    m.connect(p["accessories"].supply, p["engine"].shaft)
    return m
