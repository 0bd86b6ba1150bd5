"""A sizing as a page of HTML that needs nothing else."""

from __future__ import annotations

from base64 import b64encode
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from halfshaft.library.files.writing import written_whole

if TYPE_CHECKING:
    from halfshaft.studies.sizing.optimum import Optimum

_STYLE = (
    "body{font:15px/1.45 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;color:#222}"
    "table{border-collapse:collapse;margin:.5rem 0 1.5rem}th,td{padding:.2rem .8rem;border-bottom:1px solid #ddd}img{max-width:100%}"
)


def write_report(optimum: Optimum, path: str | Path) -> Path:
    """Write the page, whole or not at all: what was asked for, what was found, what it costs, and how it went."""
    problem, e = optimum.problem, optimum.effort
    picture = b64encode(optimum.plot()._repr_png_()).decode()
    found = "every limit holds on the exact step" if optimum.holds else f"{optimum.status}: not every limit holds"
    effort = f"{e.cycles} evaluations of the cycle, {e.slopes} gradients among them, {e.limits} of the limits alone"
    runs = [
        f"<li>from start {i}: {escape(r.status)}, {len(r.iterates)} iterations, {r.goal:.6g}</li>" for i, r in enumerate(optimum.runs, 1)
    ]
    notes = [f"<li>{escape(note)}</li>" for note in optimum.notes]
    slopes = [
        f"<li>{escape(v.variable.name)}: {v.slope:+.4g} per {escape(v.variable.unit or 'unit')}</li>"
        for v in optimum.variables if v.slope == v.slope
    ]  # fmt: skip
    body = [
        f"<p>{escape(problem.vehicle.name)}, {escape(optimum.method)}: {escape(found)}; {effort}.</p>",
        optimum._repr_html_(),
        f"<h2>Slope of the goal where it ended</h2><ul>{''.join(slopes)}</ul>" if slopes else "",
        f"<h2>Runs of IPOPT, relaxed</h2><ol>{''.join(runs)}</ol>" if runs else "",
        f"<h2>Notes</h2><ul>{''.join(notes)}</ul>" if notes else "",
        f'<h2>How it went</h2><img alt="goal, limits and variables, vehicle by vehicle" src="data:image/png;base64,{picture}">',
    ]
    title = escape(problem.title or problem.name)
    head = f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{title}</title><style>{_STYLE}</style><h1>{title}</h1>'
    page = f"{head}{''.join(body)}</html>\n"
    target = Path(path)
    with written_whole(target) as part:
        part.write_text(page, encoding="utf-8")
    return target
