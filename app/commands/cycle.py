"""A cycle: its figures, and trips made of cycles."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from halfshaft.app.options import Checks, Json, Shown
from halfshaft.app.output import print_json, print_line, print_written
from halfshaft.app.program import app
from halfshaft.library.base.errors import HalfshaftError, number

if TYPE_CHECKING:
    from halfshaft.cosim.cycle import Cycle

#: A cycle with its grade and how often it is driven.
_ITEM = re.compile(r"(?P<name>.+?)(?:@(?P<grade>[-+.\d]+%?))?(?:\*(?P<times>\d+))?")
#: No trip has more parts.
_MOST = 10_000


@app.command(
    "cycle",
    help="""Show the figures of a cycle, and make trips.

    A trip is made of cycles one after the other: NAME, NAME*3 three times, NAME@2% on a grade, pause=60 at rest with the
    key on, soak=600 with the key off [s].

    \b
    Examples:
      halfshaft cycle us06
      halfshaft cycle 'udds*2' soak=600 hwfet@1% --plot trip.png -o trip.csv
      halfshaft cycle udds hwfet us06 --pause 30 --units us
      halfshaft cycle recorded.csv --restore -o drive.csv
      halfshaft cycle udds --grade 3% --filter 3 --json
    """,
)
def _cycle(
    items: Annotated[list[str], typer.Argument(metavar="CYCLE...", help="Names in the library, or CSV files.", show_default=False)],
    pause: Annotated[float | None, typer.Option(metavar="S", help="Rest so long between all parts, the key on.")] = None,
    soak: Annotated[float | None, typer.Option(metavar="S", help="Rest so long between all parts, the key off.")] = None,
    window: Annotated[str | None, typer.Option(metavar="FROM:TO", help="Keep only this time of it [s].")] = None,
    grade: Annotated[str | None, typer.Option(metavar="G", help="A constant grade, 3% or 0.03, or a CSV file over distance.")] = None,
    restore: Annotated[bool, typer.Option("--restore", help="Take CSV files for a recorder's: fill gaps, smooth noise.")] = False,
    longest_gap: Annotated[float, typer.Option(metavar="S", help="Longest gap in motion that --restore fills.")] = 10.0,
    smooth: Annotated[
        float | None, typer.Option("--smooth", "--filter", metavar="S", help="Moving mean over so many seconds; 3 is usual.")
    ] = None,
    scale: Annotated[float | None, typer.Option(metavar="X", help="Multiply all speeds.")] = None,
    name: Annotated[str | None, typer.Option(metavar="NAME", help="What to call it.")] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", metavar="FILE.csv", help="Write it to a CSV file.")] = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE.png", help="Draw it (.png, .svg, .pdf).")] = None,
    units: Shown = "metric",
    as_json: Json = False,
) -> None:
    from halfshaft.app.show import print_cycle
    from halfshaft.cosim.trip import rest

    checks = Checks()
    if pause is not None and soak is not None:
        checks.problem("--pause and --soak: give one of them, or pause=S and soak=S where they belong")
    seconds = pause if soak is None else soak
    between = None if seconds is None else checks.take(lambda: rest(seconds, key_on=soak is None))
    kept = None if window is None else checks.take(lambda: _window(window))
    parts = [part for item in items if (part := checks.take(partial(_part, item))) is not None]
    if restore and not any(part.recorded for part in parts):
        checks.problem("--restore goes with CSV files, and there is none")
    if sum(part.times for part in parts) > _MOST:
        checks.problem(f"the trip has {sum(part.times for part in parts)} parts, must have at most {_MOST}")
    checks.target(out, "--out")
    checks.picture(plot, "--plot")
    if out is not None and out.suffix.lower() != ".csv":
        checks.problem(f"--out {out}: a cycle is written as .csv")
    checks.raise_problems()

    def trip(cycles: Iterable[Cycle]) -> Cycle:
        from halfshaft.cosim.trip import join

        driven = [c for c, part in zip(cycles, parts, strict=True) for _ in range(part.times)]
        whole = join(*driven, between=between) if len(driven) > 1 else driven[0]
        whole = whole if kept is None else whole.between(*kept)
        return whole if grade is None else whole.graded(grade)

    before = found = trip(part.cycle for part in parts)
    if restore:
        from halfshaft.cosim.recording import restored

        found = trip(restored(part.cycle, longest_gap=longest_gap) if part.recorded else part.cycle for part in parts)
    found = found if smooth is None else found.smoothed(smooth)
    changed = found is not before
    found = found if scale is None else found.scaled(scale)
    found = found if name is None else replace(found, name=name)
    road = out.with_name(f"{out.stem}-grade.csv") if out is not None and found.grade_by_distance is not None else None
    if out is not None:
        found.save(out, road)
    if plot is not None:
        from halfshaft.cosim.cycle_plot import plot_cycle

        plot_cycle(found, before=before if changed and scale is None else None, units=units, path=plot)
    if as_json:
        _print_json(found)
        return
    print_cycle(found, units)
    for text in found.doubts:
        print_line(f"  ! {text}", "yellow")
    print_written(out, road, plot)


class _Part(NamedTuple):
    """A cycle, how often it is driven, and whether it is from a file."""

    cycle: Cycle
    times: int = 1
    recorded: bool = False


def _part(item: str) -> _Part:
    """Return what an argument says."""
    from halfshaft.cosim.cycle import Cycle
    from halfshaft.cosim.trip import rest

    word, equals, value = item.partition("=")
    if equals and word in ("pause", "soak"):
        return _Part(rest(value, key_on=word == "pause"))
    found = _ITEM.fullmatch(item)
    if found is None or found["times"] == "0":
        raise HalfshaftError(f"'{item}': must be a cycle, NAME, NAME*3 or NAME@2%, or pause=60 or soak=600")
    return _Part(Cycle.load(found["name"], found["grade"]), int(found["times"] or 1), found["name"].lower().endswith(".csv"))


def _window(text: str) -> tuple[float, float]:
    begin, colon, end = text.partition(":")
    if not colon or not number(begin) < number(end):
        raise HalfshaftError(f"--window {text}: must be two times in s that rise, such as 0:505")
    return float(begin), float(end)


def _print_json(cycle: Cycle) -> None:
    from halfshaft.cosim.recording import gaps

    edges = [k * 10 / 3.6 for k in range(int(cycle.statistics().v_max * 0.36) + 2)]
    told = {"name": cycle.name, "title": cycle.title, "source": cycle.source, "statistics": cycle.statistics()._asdict()}
    times = {"from_mps": edges[:-1], "time_s": cycle.time_at(edges)}
    holes = [gap._asdict() for gap in gaps(cycle) if gap.moving]
    print_json({**told, "time_at_speed": times, "gaps": holes, "warnings": list(cycle.doubts)})
