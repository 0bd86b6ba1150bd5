"""All numbers of one thing."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from halfshaft.app.options import Checks
from halfshaft.app.output import print_written
from halfshaft.app.program import app
from halfshaft.cosim.units import Units


@app.command(
    "show",
    help="""Show a vehicle, a component or a cycle with all its numbers.

    \b
    Examples:
      halfshaft show small-car-series
      halfshaft show si-41kw
      halfshaft show us06
      halfshaft show si-41kw --plot map.png
      halfshaft show small-car-series --toml > my-car.toml
    """,
)
def _show(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Name in the library, or a file.", show_default=False)],
    toml: Annotated[bool, typer.Option("--toml", help="Print it as a file to edit.")] = False,
    plot: Annotated[Path | None, typer.Option(metavar="FILE.png", help="Draw the maps of a component (.png, .svg, .pdf).")] = None,
    units: Annotated[Units, typer.Option("--units", help="Of a cycle's figures and of what is drawn; parameters stay in SI.")] = "metric",
) -> None:
    from halfshaft.app.show import draw, print_named, print_toml

    checks = Checks()
    checks.target(plot, "--plot")
    checks.raise_problems()
    if plot is not None:
        draw(name, plot, units)
    if toml:
        print_toml(name)
        return
    print_named(name, units)
    print_written(plot)
