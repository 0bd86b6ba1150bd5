"""Battery electric car: one motor on one axle."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from halfshaft.models.model import Model


def electric(parts: Mapping[str, Any], name: str = "electric") -> Model:
    """Return the model; parts are listed from the wheel to the source."""
    m, p = Model(name, parts), parts
    m.connect(p["body"].tyre, p["wheel"].tyre)
    m.connect(p["wheel"].axle, p["final_drive"].output)
    m.connect(p["final_drive"].input, p["gearbox"].output)
    m.connect(p["gearbox"].input, p["motor"].shaft)
    m.connect(p["motor"].dc, p["accessories"].load)
    m.connect(p["accessories"].supply, p["bus"].load)
    m.connect(p["bus"].battery, p["battery"].dc)
    return m
