"""What the commands print: errors, warnings, progress, JSON, and the tables of runs, accelerations and validations."""

from __future__ import annotations

import errno
import io
import json
import math
import os
import re
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.padding import Padding
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Column, Table
from typer.core import TyperGroup

from halfshaft.cosim.units import Units, shown
from halfshaft.library.base.errors import HalfshaftError
from halfshaft.library.files.writing import source_date

if TYPE_CHECKING:
    from halfshaft.cosim.result import Result
    from halfshaft.models.vehicle import Vehicle
    from halfshaft.studies.acceleration import Acceleration

#: Exit codes as shells have them for a program that a signal ended: of an interrupt, and of a pipe that nobody reads.
INTERRUPTED, NOBODY_READS = 130, 141
#: The ways of running, as a reader knows them.
VIA = {"step": "compiled step", "fmu2": "FMI 2.0", "fmu3": "FMI 3.0", "forward": "forward-facing model"}


class Commands(TyperGroup):
    """The commands, with errors and warnings shown as one message each."""

    def main(self, *args: Any, **extra: Any) -> Any:
        """Run the command line and leave the program; also when its output cannot be written, or it is interrupted."""
        if sys.stderr is None:
            sys.stderr = Path(os.devnull).open("w")  # noqa: SIM115
        stdout = sys.stdout
        for stream in (stdout, sys.stderr):
            # Names of files need not be text.
            if isinstance(stream, io.TextIOWrapper) and stream.errors == "strict":
                stream.reconfigure(errors="replace")
        code: Any = 2
        said = ""
        try:
            if stdout is not None:
                super().main(*args, **extra)
        except SystemExit as end:
            code = end.code
        except OSError as error:
            said = f"error: {error if error.filename else f'standard output or a temporary file: {error.strerror or error}'}"
        failed = _unwritten(stdout)
        if failed:
            code, said = 2, f"error: standard output: {failed.strerror}"
        if code == 1 or (failed and failed.errno == errno.EPIPE):
            # Typer and rich end with 1 where a pipe was closed while they wrote to it; nothing else ends so.
            code, said = NOBODY_READS, ""
        if failed or code == NOBODY_READS:
            _give_up(stdout)
        if code == INTERRUPTED:
            said = "interrupted"
        with suppress(OSError):
            if said:
                typer.secho(said, fg="red", err=True)
        sys.exit(code)

    def invoke(self, ctx: Any) -> Any:
        """Run a command."""
        seen: set[str] = set()
        stderr = sys.stderr

        def show(message: Warning | str, *_: Any, **__: Any) -> None:
            text = " ".join(str(message).split())
            if text not in seen:
                # A running progress line is overwritten.
                clear = "\r\033[K" if stderr.isatty() else ""
                typer.secho(f"{clear}warning: {text}", fg="yellow", file=stderr)
            seen.add(text)

        with warnings.catch_warnings():
            warnings.simplefilter("always", UserWarning)
            warnings.showwarning = show
            try:
                # NumPy stumbles over one that is no number, and be it empty, as soon as SciPy is loaded.
                if source_date() is None:
                    os.environ.pop("SOURCE_DATE_EPOCH", None)
                return super().invoke(ctx)
            except typer.BadParameter as error:
                error.message = _in_own_words(error.message)
                raise
            except (HalfshaftError, MemoryError) as error:
                typer.secho(f"error: {error}", fg="red", err=True)
                raise typer.Exit(2) from None


def _unwritten(stdout: Any) -> OSError | None:
    """Write what is left in the buffer, here where it may still fail; return why it does."""
    if stdout is None:
        return OSError(errno.EBADF, "it is closed")
    try:
        stdout.flush()
    except OSError as error:
        return error
    return None


def _give_up(stdout: Any) -> None:
    """Let what is still to be written go nowhere, or the interpreter complains at its end."""
    if stdout is not None:
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), stdout.fileno())


def _in_own_words(message: str) -> str:
    """Return what a library says of a value of the wrong kind without its own way of speaking."""
    return re.sub(r"^Input should be a valid (\w+).*", r"must be a \1", message.removeprefix("Value error, "))


def console() -> Console:
    """Return where results go."""
    # In a pipe or a file, lines may be longer than on the narrowest terminal.
    narrow = sys.stdout.isatty() or "COLUMNS" in os.environ
    return Console(file=sys.stdout, width=None if narrow else 120)


def print_line(text: str, style: str | None = None) -> None:
    """Print a text as it is, however long."""
    console().print(text, style=style, markup=False, highlight=False, soft_wrap=True)


def print_written(*paths: Path | None) -> None:
    """Print which files or folders were written."""
    for path in paths:
        if path is not None:
            print_line(f"  wrote {path}", "dim")


def new_table() -> Table:
    """Return an empty table in the style of all tables."""
    return Table(box=box.SIMPLE_HEAD, padding=(0, 1))


@contextmanager
def busy(what: str) -> Iterator[Callable[[str], None]]:
    """Show on a terminal what is being done; yields what takes the name of each further task."""
    terminal = Console(file=sys.stderr)
    if not terminal.is_terminal:
        yield lambda _: None
        return
    columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn())
    with Progress(*columns, console=terminal, transient=True, redirect_stdout=False, redirect_stderr=False) as progress:
        task = progress.add_task(what, total=None)
        yield lambda text: progress.update(task, description=text)


@contextmanager
def counted(what: str) -> Iterator[Callable[[int, int], None]]:
    """Show on a terminal how far a long task is and what time is left; yields what takes how much is done, and of how much."""
    terminal = Console(file=sys.stderr)
    if not terminal.is_terminal:
        yield lambda done, total: None
        return
    columns = (
        # On a narrow terminal the numbers count, and the name is cut.
        TextColumn("{task.description}", markup=False, table_column=Column(ratio=1, no_wrap=True, overflow="ellipsis")),
        BarColumn(16), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn(),
    )  # fmt: skip
    progress = Progress(*columns, console=terminal, transient=True, expand=True, redirect_stdout=False, redirect_stderr=False)
    with progress:
        tasks: list[TaskID] = []

        def tell(done: int, total: int) -> None:
            # What was done before tells nothing of the time that the rest takes, so it is not counted as an advance.
            if not tasks:
                tasks.append(progress.add_task(what, total=total, completed=done))
            progress.update(tasks[0], completed=done)

        yield tell


@contextmanager
def resumable(folder: Path | None) -> Iterator[None]:
    """Say after an interrupt that a folder holds what is finished."""
    try:
        yield
    except KeyboardInterrupt:
        if folder is not None:
            typer.secho(f"what is finished is in {folder}; the same command goes on there", fg="yellow", err=True)
        raise


def print_json(found: Mapping[str, Any]) -> None:
    """Print one JSON object."""
    typer.echo(json.dumps(_plain(found), indent=2, allow_nan=False))


def _plain(value: Any) -> Any:
    """Return what JSON can hold; what is not a finite number becomes null."""
    import numpy as np

    if isinstance(value, Mapping):
        return {str(k): _plain(x) for k, x in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(x) for x in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def print_run_json(result: Result) -> None:
    """Print the summary and the energy account of a run as JSON."""
    a = result.account
    account = {
        "fuel_J": a.fuel,
        "battery_J": a.battery,
        "parts": {part.name: {"in_J": part.received, "out_J": part.delivered, "loss_J": part.lost} for part in a.parts},
        "losses_J": dict(a.losses),
        "kinetic_J": a.kinetic,
        "potential_J": a.potential,
        "speed_mismatch_J": a.speed_mismatch,
        "inertia_discretisation_J": a.inertia_discretisation,
        "speed_limit_J": a.speed_limit,
        "residual_J": a.residual,
    }
    gradient = {"gradient": result.gradient} if result.gradient else {}
    print_json({**result.summary, "account": account, "audit": _failures(result), **gradient})


def print_run(result: Result, units: Units = "metric") -> None:
    """Print the main numbers of a run, its energy account and its warnings."""
    from halfshaft.cosim.facts import facts
    from halfshaft.cosim.remarks import remarks

    out, run = console(), result.inputs
    way = VIA[run.via] if run.compiled else "interpreted step"
    how = "forward-facing" if run.via == "forward" else f"{way}, {run.mode}, {run.dt:g} s"
    title = f"[bold]{escape(run.vehicle)}[/] over [bold]{escape(run.cycle)}[/]"
    out.print(f"{title}  [dim]{escape(how)}[/]", highlight=False, soft_wrap=True)
    found = facts(result, units)
    found += [("", "")] * (len(found) % 2)
    grid = Table.grid(padding=(0, 2))
    for (name, value), (other, also) in zip(found[::2], found[1::2], strict=True):
        grid.add_row(f"[dim]{name}[/]", value, f"[dim]{other}[/]", also)
    out.print(Padding(grid, (1, 0, 0, 2), expand=False), highlight=False)
    out.print(_account_table(result))
    if result.gradient:
        out.print(gradient_table(result.figures, result.gradient, result.inputs.parameters))
    for text in (*remarks(result, units), *_failures(result)):
        print_line(f"  ! {text}", "yellow")


def gradient_table(figures: Mapping[str, Any], gradient: Mapping[str, Mapping[str, float]], numbers: Mapping[str, float]) -> Table:
    """Return by how much figures change with 1 % more of a number; of a rating, with 1 more of its unit in SI."""
    table = new_table()
    table.add_column("figure")
    table.add_column("value", justify="right")
    for name in next(iter(gradient.values())):
        table.add_column(f"1 % more of {name}" if name in numbers else f"1 more of {name}", justify="right", overflow="fold")
    for figure, slopes in gradient.items():
        changes = [0.01 * numbers[name] * x if name in numbers else x for name, x in slopes.items()]
        value = figures.get(figure)
        if value is not None and any(changes):
            table.add_row(figure, f"{value:.5g}", *(f"{x:+.3g}" for x in changes))
    return table


def _failures(result: Result) -> list[str]:
    """Return what the audit of a run found, where it can be audited."""
    return list(result.audit.failures) if result.auditable else []


def _account_table(result: Result) -> Table:
    """Return the energies in Wh, from the source to the wheel, and what became of them."""
    from halfshaft.cosim.facts import HEADINGS, energy_rows

    table = new_table()
    for i, heading in enumerate(HEADINGS):
        table.add_column(escape(heading), justify="right" if i else "left", no_wrap=True, min_width=8 if 0 < i < 4 else None)
    parts = len(result.account.parts)
    for i, row in enumerate(energy_rows(result.account)):
        if i == parts:
            table.add_section()
        table.add_row(*(escape(cell) for cell in row.cells()), style="dim" if row.soft else None)
    return table


def print_acceleration(car: Vehicle, to: float, runs: Mapping[str, Acceleration], units: Units = "metric") -> None:
    """Print the times to a speed [m/s] by method; with the iteration among them, the others are compared with it."""
    out, first = console(), next(iter(runs.values()))
    out.print(f"[bold]{escape(car.name)}[/] from 0 to {shown('speed', to, units, 1).replace('.0 ', ' ')}", highlight=False, soft_wrap=True)
    table = new_table()
    table.add_column("method")
    table.add_column("time \\[s]", justify="right")
    if "iteration" in runs:
        table.add_column("against iteration", justify="right")
    for title, found in runs.items():
        t = found.time
        row = [title, "not reached" if t is None else f"{t:.3f}"]
        if "iteration" in runs:
            reference = runs["iteration"].time
            row.append("" if t is None or reference is None or title == "iteration" else f"{100 * (t / reference - 1):+.2f} %")
        table.add_row(*row)
    out.print(table)
    if first.time is None:
        top, duration = first.result.highest[first.result.tags.the("speed")], first.result.figures["duration_s"]
        out.print(f"  [yellow]highest speed {shown('speed', top, units, 1)} within {duration:g} s[/]")
