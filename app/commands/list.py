"""What the library has."""

from __future__ import annotations

from typing import Annotated, Literal

import typer

from halfshaft.app.program import app
from halfshaft.library.base.errors import HalfshaftError

#: What the library has.
Shelf = Literal["vehicles", "components", "cycles", "procedures"]


@app.command(
    "list",
    help="""List what the library has.

    \b
    Examples:
      halfshaft list vehicles
      halfshaft list components --kind motor
    """,
)
def _list(
    what: Annotated[Shelf, typer.Argument(show_default=False)],
    kind: Annotated[str | None, typer.Option(metavar="KIND", help="Only components of this kind.")] = None,
) -> None:
    from halfshaft.app.show import print_list

    if kind is not None and what != "components":
        raise HalfshaftError(f"--kind {kind}: goes with components, not with {what}")
    print_list(what, kind)
