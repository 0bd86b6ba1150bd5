"""What a limit costs over a range of its target: a front of vehicles, each found from the one before."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from halfshaft.library.base.errors import InputError, nearest
from halfshaft.studies.size import resized, sized
from halfshaft.studies.sizing.optimum import Optimum
from halfshaft.studies.sizing.problem import Limit, Problem
from halfshaft.studies.sizing.problem_file import read_problem

if TYPE_CHECKING:
    from halfshaft.cosim.plot import Picture


@dataclass(frozen=True)
class Front:
    """A front over the target of a limit: the vehicles, by the targets, the tightest last."""

    limit: Limit
    targets: tuple[float, ...]
    found: tuple[Optimum, ...]

    def plot(self, path: str | Path | None = None) -> Picture:
        """Draw the front; with a path into a PNG, SVG or PDF file."""
        from halfshaft.studies.sizing.picture import plot_front  # matplotlib takes a quarter of a second

        return plot_front(self, path=path)

    def rows(self) -> list[tuple[str, ...]]:
        """Return target, goal, price, the variables, and whether it holds, of each vehicle, as texts."""
        place = next(i for i, f in enumerate(self.found[0].limits) if f.limit.title == self.limit.title)
        return [
            (
                f"{t / self.limit.factor:.5g}",
                f"{o.goal:.5g}",
                o.limits[place].said,
                *(v.variable.shown(v.after) for v in o.variables),
                o.status,
            )
            for t, o in zip(self.targets, self.found, strict=True)
        ]


def pareto(
    problem: Problem | str | Path,
    limit: str,
    targets: Sequence[float],
    *,
    progress: Callable[[str], None] = lambda text: None,
    seed: int = 0,
) -> Front:
    """Size for several targets of a limit, from the loosest to the tightest; each starts at the vehicle before.

    An interrupt (Ctrl-C) ends it: what was found so far is returned.

    Parameters
    ----------
    problem
        A problem, the name of one in the library, or a TOML file.
    limit
        Which limit, by its left side: ``0-60 mph``.
    targets
        Its targets in the unit that the problem has it in.
    progress, seed
        As of `size`.

    Raises
    ------
    InputError
        If the problem has no such limit, or there are no targets; all that is wrong with the problem is named.

    """
    if isinstance(problem, str | Path):
        problem = read_problem(problem)
    bound = problem.bound()
    titles = [x.title for x in bound.limits]
    wrong = [] if limit in titles else [f"limit {limit} is none of the problem's{nearest(limit, titles)}"]
    wrong += ["parts cannot be chosen along a front"] if problem.choices else []
    wrong += [] if len(targets) else ["there are no targets"]
    if wrong:
        raise InputError("pareto", wrong)
    place = titles.index(limit)
    asked = bound.limits[place]
    ordered = sorted((x * asked.factor for x in targets), key=lambda x: -asked.sign * x)
    found: list[Optimum] = []
    for target in ordered:
        progress(f"{limit} {target / asked.factor:.4g} {asked.unit}")
        found.append(resized(found[-1], place, target) if found else sized(bound.moved(place, target), seed=seed))
        if found[-1].status != "holds":
            break
    return Front(asked, tuple(ordered[: len(found)]), tuple(found))
