"""Series hybrid: the electric car with an engine and a generator on its bus."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from halfshaft.models.model import Model


def series(parts: Mapping[str, Any]) -> Model:
    """Return the model; parts are listed from the wheel to the source."""
    m = Model("series", parts)
    p = parts
    m.connect(p["body"].tyre, p["wheel"].tyre)
    m.connect(p["wheel"].axle, p["final_drive"].output)
    m.connect(p["final_drive"].input, p["gearbox"].output)
    m.connect(p["gearbox"].input, p["motor"].shaft)
    m.connect(p["motor"].dc, p["accessories"].load)
    m.connect(p["accessories"].supply, p["bus"].load)
    m.connect(p["bus"].battery, p["battery"].dc)
    m.connect(p["bus"].generator, p["generator"].dc)
    m.connect(p["generator"].shaft, p["engine"].shaft)
    return m
