"""Components and vehicles as TOML texts in SI units; read back, they give the same bits."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import TYPE_CHECKING, Any

from halfshaft.library.base.parameters import Parameters, Spec, spec_of
from halfshaft.library.base.tables import Table

if TYPE_CHECKING:
    from tomlkit.items import InlineTable


def toml_text(head: Mapping[str, Any], sections: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the text of a file: the keys of its top level, then its tables, empty ones left out."""
    import tomlkit  # most runs write no file

    document = tomlkit.document()
    document.update(head)
    for name, content in sections.items():
        if content:
            document.add(tomlkit.nl())
            document.add(name, tomlkit.item(content))
    return tomlkit.dumps(document)


def quantity(value: float, spec: Spec) -> str | float:
    """Return a number as a file has it: with its unit in quotes, or plain where there is none."""
    plain = int(value) if value.is_integer() and abs(value) < 1e15 else value
    return plain if spec.unit == "1" else f"{plain!r} {_unit(spec.unit)}"


def written(kind: type[Parameters], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of a parameter set as a file has them."""
    specs = {f.name: spec_of(f) for f in fields(kind)}
    return {name: _written(values[name], spec) for name, spec in specs.items() if name in values}


def inline(content: Mapping[str, Any]) -> InlineTable:
    """Return a table to be written on one line."""
    import tomlkit

    table = tomlkit.inline_table()
    table.update(content)
    return table


def _written(value: Any, spec: Spec) -> Any:
    if isinstance(value, Table):
        axes = {axis.name: _row(points.tolist(), axis.unit) for axis, points in zip(spec.axes, value.points, strict=True)}
        return {**axes, "values": _row(value.values.tolist(), spec.unit)}
    return _row(value, spec.unit) if spec.row else quantity(float(value), spec)


def _row(values: Iterable[Any], unit: str) -> Any:
    import tomlkit

    row = tomlkit.array()
    row.extend(values)
    lines = any(isinstance(x, list) for x in row)
    row.multiline(lines)
    if unit == "1":
        return row
    content = {"unit": _unit(unit), "values": row}
    return content if lines else inline(content)


def _unit(unit: str) -> str:
    return unit.replace(".", " ")
