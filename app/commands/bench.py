"""Timing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.markup import escape

from halfshaft.app.options import Json
from halfshaft.app.output import busy, console, new_table, print_json
from halfshaft.app.program import app


@app.command(
    "bench",
    help="""Time the step, and compare it with FASTSim where that is installed.

    \b
    Examples:
      halfshaft bench
      halfshaft bench --json
    """,
)
def _bench(as_json: Json = False) -> None:
    from halfshaft.validation.bench import bench

    with busy("timing") as progress:
        found = bench(progress)
    if as_json:
        print_json(found)
    else:
        _print_bench(found["rows"])


def _print_bench(rows: Sequence[Mapping[str, Any]]) -> None:
    """Print what was timed."""
    table = new_table()
    for heading in ("measured", "value", "unit", "target", "note"):
        table.add_column(heading, justify="right" if heading == "value" else "left", overflow="fold", no_wrap=heading in ("value", "unit"))
    for row in rows:
        table.add_row(*(escape(_cell(row[key])) for key in ("name", "value", "unit", "target", "note")))
    console().print(table)


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
