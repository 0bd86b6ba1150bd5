"""The paper's tables and figures."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from halfshaft.app.options import Checks, Json
from halfshaft.app.output import busy, console, new_table, print_json, print_line, print_written
from halfshaft.app.program import app


@app.command(
    "reproduce",
    help="""Reproduce the tables and figures of the paper.

    \b
    Examples:
      halfshaft reproduce
      halfshaft reproduce --out build/reproduce
    """,
)
def _reproduce(
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Write figures, tables and a report to this folder.")] = None,
    as_json: Json = False,
) -> None:
    from halfshaft.validation.reproduce import reproduce

    checks = Checks()
    checks.folder(out, "--out")
    checks.raise_problems()
    with busy("reproducing the paper") as progress:
        found = reproduce(out, progress)
    if as_json:
        print_json(found)
        return
    print_report(found)
    print_written(out)


def print_report(result: Mapping[str, Any]) -> None:
    """Print the tables, what the figures show and the notes."""
    from halfshaft.validation.powertrains import HEAD
    from halfshaft.validation.report import TITLES, powertrain_sheet, sentences, sheets

    for sheet in sheets(result["tables"]):
        print_line(f"Table {sheet.number}. {sheet.title}", "bold")
        # Upright, so that it fits a narrow terminal: a line for each column of the page.
        table = new_table()
        table.add_column("")
        table.add_column("")
        for name, _ in sheet.rows:
            table.add_column(name, justify="right", no_wrap=True)
        place = 0
        for group, columns in sheet.groups:
            for i, column in enumerate(columns):
                cells = [row[place] for _, row in sheet.rows]
                table.add_row("" if i else group, column, *(f"[bold]{text}[/]" if own else text for text, own in cells))
                place += 1
            table.add_section()
        console().print(table)
    sheet = powertrain_sheet(result["powertrains"])
    print_line(f"Table {sheet.number}. {sheet.title}", "bold")
    flat = new_table()
    for head in ("", *HEAD):
        flat.add_column(head, justify="right" if head else "left", no_wrap=True)
    for name, row in sheet.rows:
        flat.add_row(name, *(text for text, _ in row))
    console().print(flat)
    print_line("Figures", "bold")
    for number, sentence in sentences(result["figures"]).items():
        print_line(f"  {number:>2}  {TITLES[number]}. {sentence}")
    for note in result["notes"]:
        print_line(f"  ! {note}", "yellow")
