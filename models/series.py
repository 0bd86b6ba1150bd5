"""Series hybrid: the electric car with an engine and a generator on its bus."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from halfshaft.models.electric import electric
from halfshaft.models.model import Model


def series(parts: Mapping[str, Any]) -> Model:
    """Return the model."""
    m = electric(parts, "series")
    m.connect(parts["bus"].generator, parts["generator"].dc)
    m.connect(parts["generator"].shaft, parts["engine"].shaft)
    return m
