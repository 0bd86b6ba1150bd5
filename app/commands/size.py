"""The vehicle of least fuel, energy, mass or cost that does what it must."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape

from halfshaft.app.options import Checks, Json
from halfshaft.app.output import busy, console, new_table, print_json, print_line, print_written
from halfshaft.app.program import app

if TYPE_CHECKING:
    from halfshaft.studies.size import Price
    from halfshaft.studies.sizing.optimum import Optimum
    from halfshaft.studies.sizing.problem import Problem

#: Of a front.
MOST_TARGETS = 200
_FRONT = re.compile(r"(.+)=\s*([-+.\d]+)\s*\.\.\s*([-+.\d]+)\s*:\s*(\d{1,4})\s*")


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
      halfshaft size electric --pareto "0-85 mph=16..24:5" --plot front.png
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
    width: Annotated[
        list[float] | None,
        typer.Option(metavar="W", help="Width of the smooth step that IPOPT drives first, such as 0.1; repeatable, one after the other."),
    ] = None,
    pareto: Annotated[
        str | None, typer.Option(metavar="LIMIT=A..B:N", help='A front over a limit of the problem, "0-60 mph=9..12:4".')
    ] = None,
    check: Annotated[bool, typer.Option("--check", help="Size again with each limit that binds 1 % tighter and looser.")] = False,
    out: Annotated[Path | None, typer.Option("--out", "-o", metavar="FILE", help="Write the vehicle to this TOML file.")] = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE", help="Draw how it went: .png, .svg or .pdf.")] = None,
    report: Annotated[Path | None, typer.Option(metavar="FILE", help="Write a page of HTML.")] = None,
    as_json: Json = False,
) -> None:
    from halfshaft.studies.size import measured_prices, option_problems, size
    from halfshaft.studies.sizing.problem_file import read_problem

    checks = Checks()
    found = checks.take(lambda: read_problem(problem))
    for path, option, end in ((out, "--out", ".toml"), (report, "--report", ".html")):
        checks.target(path, option)
        if path is not None and path.suffix != end:
            checks.problem(f"{option} {path}: must end in {end}")
    checks.picture(plot, "--plot")
    checks.problem(*option_problems(method, starts, evaluations, tuple(width or ())))
    front = _front(pareto, checks) if pareto else None
    if front:
        alone = (("--method", method != "ipopt"), ("--out", out), ("--report", report), ("--check", check))
        checks.problem(*(f"{option} goes with one vehicle, not with a --pareto" for option, x in alone if x))
    asked = checks.done(found)
    if front:
        _print_front(asked, *front, plot, seed=seed, as_json=as_json)
        return
    given: dict[str, Any] = {"starts": starts, "evaluations": evaluations, "seed": seed, "widths": tuple(width or ())}
    with busy(f"size: {asked.name}") as tell:
        optimum = size(asked, method=method, progress=tell, **given)  # type: ignore[arg-type]
        prices = measured_prices(optimum) if check else []
    if out is not None:
        optimum.vehicle.save(out)
    if plot is not None:
        optimum.plot(plot)
    if report is not None:
        optimum.report(report)
    if as_json:
        print_json({**optimum.plain(), **({"prices": [price._asdict() for price in prices]} if check else {})})
        return
    _print(optimum)
    if prices:
        _print_prices(prices, optimum.bound.goal_unit)
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
    if optimum.sensitivities:
        table = new_table()
        for i, heading in enumerate(("number", "value", f"1 % more of it [{unit or 'goal'}]")):
            table.add_column(escape(heading), justify="right" if i else "left")
        for row in optimum.sensitivity_rows():
            table.add_row(*map(escape, row))
        out.print(table)
    for note in optimum.notes:
        print_line(f"  ! {note}", "yellow")


def _print_prices(prices: list[Price], unit: str) -> None:
    """Print what limits cost, by multiplier and as measured."""
    from halfshaft.studies.size import COSTS

    table = new_table()
    for i, heading in enumerate((f"price [{unit or 'goal'}]", "per", *COSTS)):
        table.add_column(escape(heading), justify="right" if i > 1 else "left")
    for price in prices:
        table.add_row(escape(price.title), escape(price.unit), *(f"{x:.3g}" for x in price.costs))
    console().print(table)


def _front(text: str, checks: Checks) -> tuple[str, list[float]] | None:
    """Return limit and targets."""
    found = _FRONT.fullmatch(text)
    if found is None or not 2 <= int(found[4]) <= MOST_TARGETS:
        checks.problem(f'--pareto {text}: must be like "0-60 mph=9..12:4", with 2 to {MOST_TARGETS} targets')
        return None
    low, high, n = float(found[2]), float(found[3]), int(found[4])
    return found[1].strip(), [low + (high - low) * i / (n - 1) for i in range(n)]


def _print_front(problem: Problem, limit: str, targets: list[float], plot: Path | None, *, seed: int, as_json: bool) -> None:
    """Size for all targets, and print the front."""
    from halfshaft.studies.sizing.pareto import pareto

    with busy(f"size: {problem.name}") as tell:
        front = pareto(problem, limit, targets, progress=tell, seed=seed)
    if plot is not None:
        front.plot(plot)
    if as_json:
        print_json({"limit": limit, "unit": front.limit.unit, "front": [o.plain() for o in front.found]})
        return
    first = front.found[0]
    table = new_table()
    unit = first.bound.goal_unit
    names = [v.name for v in first.bound.variables]
    for heading in (f"{limit} [{front.limit.unit}]", f"{problem.minimise} [{unit}]" if unit else "goal", "limit costs", *names, ""):
        table.add_column(escape(heading), justify="right")
    for row in front.rows():
        table.add_row(*map(escape, row))
    console().print(table)
    print_written(plot)
