"""The program that every command belongs to."""

from __future__ import annotations

from typing import Annotated

import typer

from halfshaft.app.output import Commands

app = typer.Typer(
    cls=Commands,
    help="Vehicle powertrains: cycle runs, full acceleration, FMUs.",
    epilog="A vehicle or a cycle is a name of the library (halfshaft list) or the path of a TOML or CSV file.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(wanted: bool) -> None:
    if wanted:
        from halfshaft import __version__

        typer.echo(f"halfshaft {__version__}")
        raise typer.Exit


@app.callback()
def _main(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")] = False,
) -> None:
    pass
