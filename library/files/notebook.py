"""What a notebook shows of an object: a heading, facts, and tables, as HTML."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import NamedTuple


class Grid(NamedTuple):
    """A table of texts; with `title` it is folded away under it."""

    columns: Sequence[str]
    rows: Iterable[Sequence[str]]
    title: str = ""


def card(name: str, title: str, facts: Mapping[str, str], *grids: Grid) -> str:
    """Return an object as HTML; all texts are escaped."""
    shown = "".join(f"<div>{escape(key)}: {escape(text)}</div>" for key, text in facts.items() if text)
    return f"<div><strong>{escape(name)}</strong> {escape(title)}{shown}{''.join(map(_grid, grids))}</div>"


def _grid(grid: Grid) -> str:
    head = _row("th", grid.columns)
    table = f"<table><thead>{head}</thead><tbody>{''.join(_row('td', row) for row in grid.rows)}</tbody></table>"
    return f"<details><summary>{escape(grid.title)}</summary>{table}</details>" if grid.title else table


def _row(tag: str, cells: Sequence[str]) -> str:
    return "<tr>" + "".join(f'<{tag} style="text-align: left">{escape(cell)}</{tag}>' for cell in cells) + "</tr>"
