"""The vehicle of least fuel, energy, mass or cost that does what it must."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

from halfshaft.app.options import Checks, Json
from halfshaft.app.output import busy, console, new_table, print_json, print_line, print_written
from halfshaft.app.program import app

if TYPE_CHECKING:
    from halfshaft.studies.size import Optimum


def _problems(incomplete: str) -> list[str]:
    from halfshaft.studies.sizing.problem_file import problem_names

    return [name for name in problem_names() if name.startswith(incomplete)]


@app.command(
    "size",
    help="""Find the vehicle of least fuel, energy, mass or cost that does what it must.

    A problem says which sizes, ratios and thresholds vary, what is to be least, and which limits must hold: a TOML file, or one of the
    library (series, parallel, electric, conventional). Ctrl-C ends the search with the best vehicle so far.

    \b
    Examples:
      halfshaft size series
      halfshaft size my-problem.toml --out sized.toml --report sized.html
      halfshaft size parallel --method evolution --evaluations 2000 --plot sized.png
      halfshaft size electric --pareto "0-85 mph=16..24 s:5" --plot front.png
    """,
)
def _size(
    problem: Annotated[
        str,
        typer.Argument(metavar="PROBLEM", help="Name in the library, or a TOML file.", show_default=False, autocompletion=_problems),
    ],
    method: Annotated[str, typer.Option(metavar="NAME", help="ipopt, with derivatives; evolution, without.")] = "ipopt",
    starts: Annotated[int, typer.Option(metavar="N", help="Points that IPOPT starts from.")] = 3,
    evaluations: Annotated[int, typer.Option(metavar="N", help="Vehicles that evolution may try.")] = 5000,
    seed: Annotated[int, typer.Option(metavar="N", help="The same one draws the same points.")] = 0,
    out: Annotated[Path | None, typer.Option("--out", "-o", metavar="FILE", help="Write the vehicle to this TOML file.")] = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE", help="Draw how it went: .png, .svg or .pdf.")] = None,
    report: Annotated[Path | None, typer.Option(metavar="FILE", help="Write a page of HTML.")] = None,
    as_json: Json = False,
) -> None:
    from halfshaft.studies.size import results, size
    from halfshaft.studies.sizing.problem_file import read_problem

    checks = Checks()
    found = checks.take(lambda: read_problem(problem))
    for path, option, end in ((out, "--out", ".toml"), (report, "--report", ".html")):
        checks.target(path, option)
        if path is not None and path.suffix != end:
            checks.problem(f"{option} {path}: must end in {end}")
    checks.picture(plot, "--plot")
    asked = checks.done(found)
    with busy(f"size: {asked.name}") as tell:
        optimum = size(asked, method=method, starts=starts, evaluations=evaluations, seed=seed, progress=tell)  # type: ignore[arg-type]
    if out is not None:
        optimum.vehicle.save(out)
    if plot is not None:
        optimum.plot(plot)
    if report is not None:
        optimum.report(report)
    if as_json:
        print_json(results(optimum))
        return
    _print(optimum)
    print_written(out, plot, report)


def _print(optimum: Optimum) -> None:
    """Print goal, variables, limits and what they cost."""
    out = console()
    e = optimum.effort
    how = f"{optimum.method}, {e.cycles} evaluations of the cycle, {e.slopes} gradients, {e.limits} of the limits alone"
    out.print(f"[bold]{escape(optimum.problem.name)}[/]  [dim]{escape(optimum.problem.title)}; {how}[/]", highlight=False, soft_wrap=True)
    name, unit, before, after = optimum.goal_row()
    said = "[green]every limit holds[/]" if optimum.holds else f"[yellow]{optimum.status}[/]"
    out.print(f"  {escape(name)}: {before} to [bold]{after}[/] {escape(unit)}, {said}", highlight=False)
    table = new_table()
    for i, heading in enumerate(("variable", "bounds", "before", "after", "")):
        table.add_column(heading, justify="right" if i in (2, 3) else "left")
    for row in optimum.variable_rows():
        table.add_row(*map(escape, row))
    out.print(table)
    if optimum.limits:
        table = new_table()
        for i, heading in enumerate(("limit", "target", "before", "after", f"costs [{unit or 'goal'}]", "")):
            table.add_column(escape(heading), justify="right" if i in (2, 3) else "left")
        for row, limit in zip(optimum.limit_rows(), optimum.limits, strict=True):
            table.add_row(*map(escape, row), style=None if limit.holds else "yellow")
        out.print(table)
    for note in optimum.notes:
        print_line(f"  ! {note}", "yellow")
