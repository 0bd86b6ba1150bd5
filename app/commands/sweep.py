"""Tests and cycles over a grid or a sample of vehicles."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

import typer
from rich.markup import escape

from halfshaft.app.options import Checks, Correction, CycleNames, Json, Mass, Soc, TestNames, Values, VehicleNames
from halfshaft.app.output import busy, console, counted, new_table, print_json, print_line, print_written, resumable
from halfshaft.app.program import app
from halfshaft.cosim.ways import Mode

if TYPE_CHECKING:
    import xarray as xr


Kind: TypeAlias = Literal["lines", "contours", "slices", "tornado", "indices"]
#: At most so many points are printed one by one, and so many failures named.
ROWS, FAILURES = 40, 5


@app.command(
    "sweep",
    help="""Run vehicles over a grid or a sample of numbers, parts and vehicles.

    An axis is a number, a role whose part is replaced, or several vehicles. A range LOW..HIGH:N has N values; with --sample
    it is LOW..HIGH.

    \b
    Examples:
      halfshaft sweep small-car-electric --cycle udds --axis body.m=1000..1600:7 --plot mass.png
      halfshaft sweep small-car-electric --cycle udds --axis motor.P_max="50..100 kW:6" --axis motor=ac-75kw,ac-83kw
      halfshaft sweep small-car-series small-car-parallel --cycle udds --cycle hwfet --axis body.c_d=0.25,0.3,0.35 --json
      halfshaft sweep small-car-parallel --cycle udds --correction zero-delta --test acceleration --axis engine.P_max="40..80 kW:5"
      halfshaft sweep small-car-series --cycle us06 --axis body.m=1000..1600 --axis body.c_d=0.2..0.4 --sample sobol:64 --out study
    """,
)
def _sweep(
    vehicles: VehicleNames,
    axis: Annotated[list[str] | None, typer.Option(metavar="NAME=VALUES", help="What varies; repeatable.")] = None,
    cycle: CycleNames = None,
    test: TestNames = None,
    correction: Correction = None,
    sample: Annotated[
        str | None, typer.Option(metavar="KIND:N", help="Draw N points, lhs:N or sobol:N; saltelli:N for Sobol's indices.")
    ] = None,
    seed: Annotated[int, typer.Option(metavar="N", help="The same one draws the same points.")] = 0,
    response: Annotated[list[str] | None, typer.Option(metavar="NAME", help="A figure to keep, such as fuel_L; repeatable.")] = None,
    mode: Annotated[Mode, typer.Option(help="How each step is solved.")] = "hybrid",
    dt: Annotated[float, typer.Option(metavar="S", help="Length of the step [s].")] = 1.0,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Keep what is finished in this folder; the same command goes on where it was.")
    ] = None,
    workers: Annotated[int | None, typer.Option(metavar="N", help="Processes; as many as there are cores if not given.")] = None,
    scheduler: Annotated[str | None, typer.Option(metavar="ADDRESS", help="A dask cluster that works instead, tcp://HOST:PORT.")] = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE.png", help="Draw the responses (.png, .svg, .pdf).")] = None,
    kind: Annotated[Kind | None, typer.Option(help="What to draw; what fits the axes if not given.")] = None,
    constraint: Annotated[
        list[str] | None, typer.Option(metavar="NAME<=X", help="What a figure must keep to, shown in the plot; repeatable.")
    ] = None,
    mass: Mass = None,
    values: Values = None,
    soc: Soc = None,
    as_json: Json = False,
) -> None:
    from halfshaft.cosim.figures import main_of
    from halfshaft.studies.design import read_axes
    from halfshaft.studies.effects import Constraint, kind_problems
    from halfshaft.studies.job import FAILURE
    from halfshaft.studies.sweep import sweep, table

    checks = Checks()
    cars = [checks.vehicle(name, mass, values, soc) for name in vehicles]
    tasks = checks.tasks(cycle, test, correction, mode, dt)
    axes = read_axes(axis or (), checks.problem)
    checks.folder(out, "--out")
    checks.target(plot, "--plot")
    limits = [checks.take(partial(Constraint.read, text)) for text in constraint or ()]
    if plot is None:
        checks.problem(*(f"{option} goes with --plot" for option, given in (("--kind", kind), ("--constraint", constraint)) if given))
    else:
        from halfshaft.cosim.plot import plot_problems  # matplotlib takes a quarter of a second

        checks.problem(*(f"--plot {plot}: {p}" for p in plot_problems(plot)))
        if kind is not None:
            checks.problem(*(f"--kind {p}" for p in kind_problems(kind, sum("." in name for name in axes), sample is not None)))
    checks.raise_problems()
    found_cars = [car for car in cars if car is not None]
    # A constraint on what no point has is said before the sweep runs, not when it is drawn.
    needed = [*response, *(limit.name for limit in limits if limit is not None)] if response else []
    title = f"{', '.join(car.name for car in found_cars)} over {', '.join(task.name for task in tasks)}"
    with resumable(out), counted(title) as progress:
        found = sweep(
            found_cars, axes, tasks, sample=sample, seed=seed, responses=needed, folder=out, workers=workers, scheduler=scheduler,
            progress=progress,
        )  # fmt: skip
    drawn = response or main_of(map(str, found))
    if as_json:
        columns = table(found)
        failed = sum(text != "" for text in columns[FAILURE])
        print_json({"tasks": [task.name for task in tasks], "points": len(columns[FAILURE]), "failed": failed, "table": columns})
    else:
        _print(title, found, drawn)
    if plot is not None:
        from halfshaft.studies.pictures import plot_sweep

        with busy(f"drawing {plot}"):
            plot_sweep(found, response or drawn[:1], kind=kind, constraints=constraint or (), path=plot)
    if not as_json:
        print_written(out, plot)


def _print(title: str, found: xr.Dataset, responses: Sequence[str]) -> None:
    """Print the points one by one, or where each response is lowest and highest if they are many."""
    from halfshaft.studies.job import FAILURE
    from halfshaft.studies.sweep import table

    columns = table(found)
    axes = [str(name) for name in found.coords]
    failures = [i for i, text in enumerate(columns[FAILURE]) if text]
    total = len(columns[FAILURE])
    told = f"{total} points" + (f", {len(failures)} of them failed" if failures else "")
    console().print(f"[bold]{escape(title)}[/]  [dim]{told}[/]", highlight=False, soft_wrap=True)
    heads = {name: f"{name} [{unit}]" if (unit := found[name].attrs.get("units", "1")) not in ("", "1") else name for name in columns}
    shown = new_table()
    if total <= ROWS:
        for name in (*axes, *responses):
            head = heads[name] if name in axes else "\n".join(heads[name].rsplit(".", 1))
            shown.add_column(escape(head), justify="left" if isinstance(columns[name][0], str) else "right", overflow="fold")
        for i in range(total):
            shown.add_row(*(_cell(columns[name][i]) for name in (*axes, *responses)), style="dim" if i in failures else None)
    else:
        for heading in ("figure", "", "", *(heads[name] for name in axes)):
            shown.add_column(escape(heading))
        for name in responses:
            known = [(x, i) for i, x in enumerate(columns[name]) if x == x]
            for end, (x, i) in zip(("lowest", "highest"), (min(known), max(known)) if known else (), strict=False):
                point = (_cell(columns[axis][i]) for axis in axes)
                shown.add_row(escape(heads[name]) if end == "lowest" else "", end, _cell(x), *point)
    console().print(shown)
    for i in failures[:FAILURES]:
        place = ", ".join(f"{axis} {_cell(columns[axis][i])}" for axis in axes)
        print_line(f"  ! {place}: {columns[FAILURE][i]}", "yellow")
    if len(failures) > FAILURES:
        print_line(f"  ! and {len(failures) - FAILURES} more points that failed", "yellow")


def _cell(value: Any) -> str:
    if isinstance(value, str):
        return escape(value)
    return "-" if value != value else f"{value:.5g}"
