"""How uncertain figures are where numbers of the vehicle are."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape

from halfshaft.app.options import Checks, Correction, CycleNames, Json, Mass, Soc, TestNames, Values, VehicleName, number_or_text
from halfshaft.app.output import console, counted, new_table, print_json, print_line, print_written, resumable
from halfshaft.app.program import app
from halfshaft.cosim.ways import Mode

if TYPE_CHECKING:
    from halfshaft.studies.uncertainty import Uncertainty


@app.command(
    "uncertainty",
    help="""Work out how uncertain figures are where numbers of the vehicle are.

    Numbers get distributions: normal(mean, sd), lognormal(mean, sd), both also cut, normal(mean, sd, low, high), uniform(low, high),
    triangular(low, mode, high). Samples of them are run, and a first-order estimate stands beside.

    \b
    Examples:
      halfshaft uncertainty small-car-electric --cycle udds --vary "body.c_d=normal(0.30, 0.01)" --vary "body.m=uniform(1100, 1200 kg)"
      halfshaft uncertainty small-car-series --test acceleration --vary "engine.P_max=normal(40, 1 kW)" --plot spread.png
    """,
)
def _uncertainty(
    vehicle: VehicleName,
    vary: Annotated[list[str] | None, typer.Option(metavar="NAME=DISTRIBUTION", help="A number and its distribution; repeatable.")] = None,
    cycle: CycleNames = None,
    test: TestNames = None,
    correction: Correction = None,
    correlation: Annotated[
        list[str] | None, typer.Option(metavar="NAME,NAME=R", help="How two numbers hang together, -1 to 1; repeatable.")
    ] = None,
    sample: Annotated[
        str | None,
        typer.Option(metavar="KIND:N", help="sobol:N, lhs:N, or saltelli:N for Sobol's indices too; saltelli:256 unless given."),
    ] = None,
    seed: Annotated[int, typer.Option(metavar="N", help="The same one draws the same samples.")] = 0,
    truncate: Annotated[bool, typer.Option("--truncate", help="Cut distributions at the bounds of their numbers.")] = False,
    figure: Annotated[list[str] | None, typer.Option(metavar="NAME", help="A figure to look at, such as fuel_L; repeatable.")] = None,
    constraint: Annotated[
        list[str] | None, typer.Option(metavar="NAME<=X", help="Also say how probable it is that a figure keeps to this; repeatable.")
    ] = None,
    mode: Annotated[Mode, typer.Option(help="How each step is solved.")] = "hybrid",
    dt: Annotated[float, typer.Option(metavar="S", help="Length of the step [s].")] = 1.0,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Keep the runs in this folder; the same command goes on where it was.")
    ] = None,
    workers: Annotated[int | None, typer.Option(metavar="N", help="Processes; as many as there are cores if not given.")] = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE", help="Draw it: .png, .svg or .pdf.")] = None,
    mass: Mass = None,
    values: Values = None,
    soc: Soc = None,
    as_json: Json = False,
) -> None:
    from halfshaft.studies.effects import Constraint
    from halfshaft.studies.uncertainty import uncertainty

    checks = Checks()
    car = checks.vehicle(vehicle, mass, values, soc)
    tasks = checks.tasks(cycle, test, correction, mode, dt)
    distributions, together = _pairs(vary or (), "--vary", checks), _pairs(correlation or (), "--correlation", checks)
    limits = [checks.take(partial(Constraint.read, text)) for text in constraint or ()]
    checks.folder(out, "--out")
    checks.picture(plot, "--plot")
    checks.raise_problems()
    pairs = {tuple(name.strip() for name in names.split(",")): number_or_text(r) for names, r in together.items()}
    needed = [*figure, *(limit.name for limit in limits if limit is not None)] if figure else []
    with resumable(out), counted(f"uncertainty: {vehicle}") as progress:
        found = uncertainty(
            checks.done(car), distributions, tasks, correlation=pairs or None, sample=sample, seed=seed, truncate=truncate,  # type: ignore[arg-type]
            figures=list(dict.fromkeys(needed)), folder=out, workers=workers, progress=progress,
        )  # fmt: skip
    chances = {f"{c.name} {c.sign} {c.limit:g}": found.probability(f"{c.name}{c.sign}{c.limit!r}") for c in limits if c is not None}
    if plot is not None:
        found.plot(path=plot)
    if as_json:
        print_json(_json(found) | {"probabilities": chances})
        return
    _print(found)
    for told, chance in chances.items():
        print_line(f"  {told} with a probability of {100 * chance:.1f} %")
    print_written(out, plot)


def _pairs(texts: list[str] | tuple[()], option: str, checks: Checks) -> dict[str, str]:
    """Return what is told as NAME=..., by name."""
    found: dict[str, str] = {}
    for text in texts:
        name, sign, told = (part.strip() for part in text.partition("="))
        if not (name and sign and told):
            example = "body.m=normal(1300, 40)" if option == "--vary" else "body.m,body.A=0.5"
            checks.problem(f"{option} {text}: must be like {example}")
        elif name in found:
            checks.problem(f"{option} {name} is given twice")
        else:
            found[name] = told
    return found


def _json(found: Uncertainty) -> dict[str, Any]:
    return {
        "samples": found.drawn.sizes["point"],
        "runs": found.samples.sizes["point"],
        "failed": found.lost,
        "figures": {
            name: {
                "samples": of.sampled._asdict(),
                "first_order": None if of.first_order is None else of.first_order._asdict(),
                "missing": of.missing,
                "gradient": of.gradient,
                "shares": {
                    s.name: {
                        "first_order": s.first_order, "alone": s.sobol and s.sobol.first, "alone_bounds": s.sobol and s.sobol.first_bounds,
                        "with_others": s.sobol and s.sobol.total, "with_others_bounds": s.sobol and s.sobol.total_bounds,
                    }
                    for s in of.shares
                },
            }
            for name, of in found.figures.items()
        },
        "notes": found.notes,
    }  # fmt: skip


def _print(found: Uncertainty) -> None:
    """Print how uncertain each figure is, and whose share is how large."""
    from halfshaft.studies.uncertainty import HEADINGS, SHARE_HEADINGS

    out = console()
    runs, drawn = found.samples.sizes["point"], found.drawn.sizes["point"]
    told = f"{drawn} samples" + (f", {runs} runs" if runs > drawn else "")
    out.print(f"[bold]{escape(found.title)}[/]  [dim]{told}[/]", highlight=False, soft_wrap=True)
    for headings, rows, texts in ((HEADINGS, found.rows(), 2), (SHARE_HEADINGS, found.share_rows(), 2)):
        table, last = new_table(), ""
        for i, heading in enumerate(headings):
            table.add_column(escape(heading), justify="left" if i < texts else "right", overflow="fold")
        for row in rows:
            table.add_row(*map(escape, ("" if row[0] == last else row[0], *row[1:])))
            last = row[0]
        out.print(table)
    for note in found.notes:
        print_line(f"  ! {note}", "yellow")
