"""What the commands print: errors, warnings, progress, JSON, and the tables of runs, accelerations and validations."""

from __future__ import annotations

import io
import json
import math
import os
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.padding import Padding
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table
from typer.core import TyperGroup

from halfshaft.library.errors import HalfshaftError

if TYPE_CHECKING:
    from halfshaft.cosim.acceleration import Acceleration
    from halfshaft.cosim.cycle import Cycle
    from halfshaft.cosim.result import Result
    from halfshaft.models.vehicle import Vehicle

#: The ways of running, as a reader knows them.
VIA = {"step": "compiled step", "fmu2": "FMI 2.0", "fmu3": "FMI 3.0", "forward": "forward-facing model"}


class Commands(TyperGroup):
    """The commands, with errors and warnings shown as one message each."""

    def invoke(self, ctx: Any) -> Any:
        """Run a command."""
        for stream in (sys.stdout, sys.stderr):
            if isinstance(stream, io.TextIOWrapper) and not stream.encoding.lower().startswith("utf"):
                stream.reconfigure(errors="replace")
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
                return super().invoke(ctx)
            except HalfshaftError as error:
                typer.secho(f"error: {error}", fg="red", err=True)
                raise typer.Exit(2) from None


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
def solver_noise() -> Iterator[None]:
    """Keep what the integrator says to itself from the terminal; what matters is in the error."""
    with redirect_stderr(io.StringIO()):
        yield


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
    print_json({**result.summary, "account": account})


def print_run(car: Vehicle, trace: Cycle, result: Result) -> None:
    """Print the main numbers of a run, its energy account and its warnings."""
    out = console()
    s = result.summary
    how = "forward-facing" if result.inputs.via == "forward" else f"{VIA[result.inputs.via]}, {result.inputs.mode}, {result.inputs.dt:g} s"
    out.print(f"[bold]{escape(car.name)}[/] over [bold]{escape(trace.name)}[/]  [dim]{escape(how)}[/]", highlight=False, soft_wrap=True)
    facts = [("distance", f"{s['distance_m'] / 1000:.3f} km"), ("duration", f"{s['duration_s']:g} s")]
    if s["fuel_L"] is not None:
        economy = s["fuel_economy_L_per_100km"]
        facts += [("fuel", f"{s['fuel_L']:.4f} L"), ("economy", "-" if economy is None else f"{economy:.3f} L/100 km")]
    if s["motor_input_J"] is not None:
        facts.append(("motor input", f"{s['motor_input_J'] / 3.6e6:.4f} kWh"))
    if s["soc_end"] is not None:
        facts.append(("state of charge", f"{s['soc_start']:.4f} -> {s['soc_end']:.4f}"))
    facts.append(("largest trace miss", f"{s['trace_miss_max_mps'] * 3.6:.2f} km/h"))
    facts += [("", "")] * (len(facts) % 2)
    grid = Table.grid(padding=(0, 3))
    for (name, value), (other, also) in zip(facts[::2], facts[1::2], strict=True):
        grid.add_row(f"[dim]{name}[/]", value, f"[dim]{other}[/]", also)
    out.print(Padding(grid, (1, 0, 0, 2), expand=False), highlight=False)
    out.print(_account_table(car, result))
    for text in result.warnings:
        print_line(f"  ! {text}", "yellow")


def _account_table(car: Vehicle, result: Result) -> Table:
    """Return the energies in Wh, from the source to the wheel, and what became of them."""
    a = result.account
    rows = {part.name: part for part in a.parts}
    order = sorted((role for role in reversed(list(car.parts)) if role in rows), key=lambda role: role != "engine")
    table = new_table()
    table.add_column("energy \\[Wh]", no_wrap=True)
    for heading in ("in", "out", "loss"):
        table.add_column(heading, justify="right", no_wrap=True, min_width=9)
    for name in order:
        part = rows[name]
        table.add_row(name.replace("_", " "), *(_wh(x) for x in (part.received, part.delivered, part.lost)))
    table.add_section()
    if a.fuel:
        table.add_row("fuel", _wh(a.fuel), "", "")
    if a.battery:
        table.add_row("battery store", _wh(a.battery), "", "")
    table.add_row("losses", "", "", _wh(sum(a.losses.values())))
    for name, x in (("kinetic", a.kinetic), ("potential", a.potential)):
        table.add_row(f"{name} energy", "", _wh(x), "")
    lines = (
        ("speed mismatch", a.speed_mismatch),
        ("inertia discretisation", a.inertia_discretisation),
        ("limit and standstill", a.speed_limit),
    )
    for name, x in lines:
        table.add_row(f"[dim]method's error: {name}[/]", "", f"[dim]{_wh(x)}[/]", "")
    table.add_row(f"balance [dim]({a.balance_relative:.0e} of the turnover)[/]", "", "", _wh(a.residual))
    return table


def _wh(energy: float) -> str:
    """Return an energy [J] in Wh; what is rounding is zero."""
    return f"{energy / 3600:.2f}".replace("-0.00", "0.00")


def print_acceleration(car: Vehicle, to: float, runs: Mapping[str, Acceleration]) -> None:
    """Print the times to a speed [km/h] by method; with the iteration among them, the others are compared with it."""
    out = console()
    out.print(f"[bold]{escape(car.name)}[/] from 0 to {to:g} km/h", highlight=False, soft_wrap=True)
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
    if runs["hybrid"].time is None:
        result = runs["hybrid"].result
        out.print(f"  [yellow]highest speed {result['body.v'].max() * 3.6:.1f} km/h after {result.summary['duration_s']:g} s[/]")


def print_bench(rows: Sequence[Mapping[str, Any]]) -> None:
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
