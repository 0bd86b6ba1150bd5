"""The report on the reproduction: one page of HTML that needs nothing else."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping, Sequence
from html import escape
from string import Template
from typing import Any, NamedTuple

from halfshaft import __version__
from halfshaft.validation import paper
from halfshaft.validation.powertrains import HEAD, Row, cells

_PAGE = Template("""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>The 1999 paper, reproduced</title>
<style>
:root { color-scheme: light dark; --page: #f6f7f9; --card: #ffffff; --ink: #1c2430; --faint: #5b6675; --line: #e3e7ec; --ours: #1f5fa8;
  --shade: #0005; }
@media (prefers-color-scheme: dark) {
  :root { --page: #0d1117; --card: #161b22; --ink: #e6eaf0; --faint: #9aa5b3; --line: #2b323c; --ours: #6cb0f5;
    --shade: #000c; }
}
* { box-sizing: border-box; }
body { margin: 0; background: var(--page); color: var(--ink); font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; }
main { max-width: 72rem; margin: 0 auto; padding: 3rem 1.25rem 4rem; }
h1 { font-size: 2rem; line-height: 1.2; margin: 0 0 .5rem; letter-spacing: -.01em; }
h2 { font-size: 1.25rem; margin: 3rem 0 .75rem; }
p { max-width: 46rem; margin: .5rem 0; }
.faint, figcaption, .caption, .note { color: var(--faint); }
.key { display: grid; grid-template-columns: repeat(auto-fit, minmax(13rem, 1fr)); gap: 1rem; margin: 2rem 0 0; }
.key div, .card { background: var(--card); border: 1px solid var(--line); border-radius: .75rem; }
.key div { padding: 1rem 1.25rem; font-size: .9rem; color: var(--faint); line-height: 1.4; }
.key b { display: block; font-size: 1.6rem; font-weight: 600; color: var(--ink); font-variant-numeric: tabular-nums; }
.card { margin: 0 0 1.25rem; padding: 1rem 1.25rem; }
/* A table that is wider than the page shows a shadow at the end that goes on. */
.scroll { overflow-x: auto; background:
  linear-gradient(to right, var(--card) 40%, transparent) left / 3rem 100% no-repeat local,
  linear-gradient(to left, var(--card) 40%, transparent) right / 3rem 100% no-repeat local,
  linear-gradient(to right, var(--shade), transparent) left / .9rem 100% no-repeat scroll,
  linear-gradient(to left, var(--shade), transparent) right / .9rem 100% no-repeat scroll, var(--card); }
table { border-collapse: collapse; width: 100%; font-size: .92rem; font-variant-numeric: tabular-nums; white-space: nowrap; }
.caption { max-width: none; margin: 0 0 .6rem; }
.caption b { color: var(--ink); }
th, td { padding: .35rem .6rem; text-align: right; }
th { font-weight: 500; color: var(--faint); }
thead tr:first-child th { text-align: center; color: var(--ink); }
thead tr:last-child th { border-bottom: 1px solid var(--line); }
th:first-child { text-align: left; position: sticky; left: 0; background: var(--card); }
tbody th { color: var(--ink); font-weight: 400; }
tbody tr + tr > * { border-top: 1px solid var(--line); }
td.ours { color: var(--ours); font-weight: 600; }
.wide { grid-column: 1 / -1; }
.figures { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 26rem), 1fr)); gap: 1.25rem; }
figure { margin: 0; }
figure img { display: block; width: 100%; height: auto; }
figcaption { font-size: .9rem; line-height: 1.45; padding-top: .6rem; border-top: 1px solid var(--line); margin-top: .5rem; }
figcaption b { color: var(--ink); font-weight: 600; }
figcaption span { display: block; margin-top: .25rem; }
.note { font-size: .9rem; }
</style>
</head>
<body>
<main>
<h1>The 1999 paper, reproduced</h1>
<p>$source describes a vehicle model that runs backward, from the road to the energy source, and forward again where a
limit acts. Its printed numbers stand here beside those of halfshaft $version, which re-implements the method.</p>
<p class="faint"><b>Hybrid</b> is the paper's method, <b>iteration</b> its benchmark. <b>Refined</b> solves for the best end
speed where a limit acts. <b>Forward-facing</b> integrates the same parts as a differential-algebraic system with a driver; on US06 its
driver follows the trace in his own way.</p>
<div class="key">$key</div>
<h2>Tables</h2>
$tables
$notes
<h2>Figures</h2>
<p class="faint">Figures 2 to 7 show the 2393-kg vehicle in its full acceleration with the motor's current limited to 57 kW.</p>
<div class="figures">
$figures
</div>
</main>
</body>
</html>
""")


class Sheet(NamedTuple):
    """A table: columns in groups, and rows of a name and cells; a cell says whether its number is ours."""

    number: str
    title: str
    groups: Sequence[tuple[str, tuple[str, ...]]]
    rows: Sequence[tuple[str, Sequence[tuple[str, bool]]]]


def report(result: Mapping[str, Any], light: Mapping[str, bytes], dark: Mapping[str, bytes]) -> str:
    """Return the page; `light` and `dark` hold each figure as a PNG for a page of that kind."""
    said = sentences(result["figures"])
    return _PAGE.substitute(
        source=escape(paper.SOURCE),
        version=escape(__version__),
        key=_key(result["tables"]),
        tables="\n".join(map(_table, [*sheets(result["tables"]), powertrain_sheet(result["powertrains"])])),
        notes="\n".join(f'<p class="note">{escape(note)}</p>' for note in result["notes"]),
        figures="\n".join(_figure(n, image, dark[n], said[n]) for n, image in light.items()),
    )


def sheets(tables: Mapping[str, Any]) -> list[Sheet]:
    """Return tables 2 to 5."""
    accuracy = (("2", paper.TABLE_2), ("3", paper.TABLE_3), ("4", paper.TABLE_4))
    return [*(_accuracy(n, tables[n], printed) for n, printed in accuracy), _speed(tables["5"])]


def _number(x: float | None, digits: int, *, sign: bool = False) -> str:
    if x is None:
        return "\u2013"
    return f"{x:{'+' if sign else ''}.{digits}f}".replace("-", "\u2212")


def _key(tables: Mapping[str, Any]) -> str:
    def gap(pairs: Sequence[tuple[Any, float]]) -> str:
        return "\u2013" if any(x is None for x, _ in pairs) else f"{max(abs(x - printed) for x, printed in pairs):.3f}"

    both = (("hybrid", "paper"), ("iteration", "paper_iteration"))
    times = [pair for ours, printed in both for pair in zip(tables["2"][ours], tables["2"][printed], strict=True)]
    times += [(tables["4"][ours][0], tables["4"][printed][0]) for ours, printed in both]
    energies = [pair for ours, printed in both for pair in zip(tables["3"][ours], tables["3"][printed], strict=True)]
    energies += [(tables["4"][ours][1], tables["4"][printed][1]) for ours, printed in both]
    refined = [abs(x) for n in ("2", "3", "4") for x in tables[n]["difference_refined"] if x is not None]
    ratios = [x for x in tables["5"]["ratio"] if x is not None]
    faster = f"{_round(min(ratios))} to {_round(max(ratios))} times" if ratios else "\u2013"
    error = "\u2013" if not refined else f"{max(refined):.4f} %" if max(refined) > 1e-4 else "< 0.0001 %"
    entries = [
        (f"{gap(times)} s", "largest distance from the paper's eight acceleration times"),
        (f"{gap(energies)} kWh", "largest distance from the paper's eight energies"),
        (error, "largest error of the refined method; the paper's method errs by up to 1.9 %"),
        (faster, "faster than the forward-facing model, by medians of several runs; in the paper 1.7 to 8.0"),
    ]
    return "".join(f"<div><b>{escape(value)}</b>{escape(text)}</div>" for value, text in entries)


def _round(x: float | None) -> str:
    """Return a number with two digits that count."""
    return "\u2013" if x is None else f"{float(f'{x:.2g}'):,.0f}".replace(",", "\u202f")


def _table(sheet: Sheet) -> str:
    top = "".join(f'<th scope="colgroup" colspan="{len(columns)}">{escape(name)}</th>' for name, columns in sheet.groups)
    below = "".join(f'<th scope="col">{escape(c)}</th>' for _, columns in sheet.groups for c in columns)
    head = f"<thead><tr><th></th>{top}</tr><tr><th></th>{below}</tr></thead>"
    body = "".join(
        f'<tr><th scope="row">{escape(name)}</th>'
        + "".join(f"<td{' class=ours' if own else ''}>{escape(x)}</td>" for x, own in cells)
        + "</tr>"
        for name, cells in sheet.rows
    )
    name = f"table-{sheet.number}"
    caption = f'<p id="{name}" class="caption"><b>Table {sheet.number}.</b> {escape(sheet.title)}</p>'
    table = f'<table aria-labelledby="{name}">{head}<tbody>{body}</tbody></table>'
    return f'<div class="card">{caption}<div class="scroll">{table}</div></div>'


def powertrain_sheet(rows: Sequence[Mapping[str, Any]]) -> Sheet:
    """Return the table of all powertrains, which the paper does not have."""
    title = "Every powertrain by the step at 1 s and forward-facing; not in the paper."
    shown = [(f"{row['vehicle']}, {row['task']}", [(text, True) for text in cells(Row(**row))]) for row in rows]
    return Sheet("6", title, (("", HEAD),), shown)


def _accuracy(number: str, t: Mapping[str, Any], printed: paper.Accuracy) -> Sheet:
    pair = ("here", "paper")
    groups = [
        ("Hybrid", pair), ("Iteration", pair), ("Hybrid to iteration", ("here (%)", "paper (%)")),
        ("Refined", ("here", "to iteration (%)")), ("Forward-facing", ("here", "to iteration (%)")),
    ]  # fmt: skip
    rows = [
        (name, [
            (_number(t["hybrid"][i], 3), True), (_number(t["paper"][i], 2), False),
            (_number(t["iteration"][i], 3), True), (_number(t["paper_iteration"][i], 2), False),
            (_number(t["difference"][i], 2, sign=True), True), (f"{t['paper_difference'][i]:+g}".replace("-", "\u2212"), False),
            (_number(t["refined"][i], 3), True), (_number(t["difference_refined"][i], 4, sign=True), True),
            (_number(t["forward"][i], 3), True), (_number(t["difference_forward"][i], 2, sign=True), True),
        ])
        for i, name in enumerate(printed.rows)
    ]  # fmt: skip
    return Sheet(number, f"{printed.title} ({printed.unit})", groups, rows)


def _speed(t: Mapping[str, Any]) -> Sheet:
    groups = [
        ("Hybrid", ("here (ms)", "paper (s)")),
        ("Forward-facing", ("here (s)", "paper (s)")),
        ("Ratio", ("here", "from ... to", "paper")),
    ]
    spreads = ["\u2013" if x is None else f"{_round(x[0])} ... {_round(x[1])}" for x in t["ratio_spread"]]
    rows = [
        (name, [
            (_number(1e3 * t["hybrid"][i], 2), True), (_number(t["paper"][i], 0), False),
            (_number(t["forward"][i], 2), True), (_number(t["paper_forward"][i], 0), False),
            (_round(t["ratio"][i]), True), (spreads[i], True), (_number(t["paper_ratio"][i], 1), False),
        ])
        for i, name in enumerate(paper.TABLE_5.rows)
    ]  # fmt: skip
    title = (
        "Execution times; here medians of processor times of the small conventional car of the library on this machine, "
        "in the paper a Pentium Pro at 200 MHz"
    )
    return Sheet("5", title, groups, rows)


#: What each figure shows.
TITLES = {
    "2": "Force at the tyres",
    "3": "Speed asked for, allowed and achieved",
    "5": "Torque of the motor",
    "6": "Speed of the motor",
    "7": "Power into the motor",
    "9": "Full acceleration by the hybrid method and by iteration",
    "10": "How far the vehicles fall behind US06",
}


def sentences(facts: Mapping[str, Mapping[str, float]]) -> dict[str, str]:
    """Return what each figure shows, in a sentence."""
    two, three, five, six, seven, nine, ten = (facts[n] for n in ("2", "3", "5", "6", "7", "9", "10"))
    behind = ", ".join(f"{x:.1f}" for x in ten.values())
    return {
        "2": f"The request peaks at {two['F_required_max_N'] / 1e6:.2f} MN, the tyres carry {two['F_limited_max_N'] / 1e3:.1f} kN.",
        "3": f"The tyres would allow {three['v_limited_end_kmh']:.1f} km/h after 50 s, the vehicle drives {three['v_end_kmh']:.1f} km/h; "
        "the two curves hardly differ.",
        "5": f"Up to {five['tau_required_max_Nm']:.0f} N m are asked for; the motor has {five['tau_limited_max_Nm']:.0f} N m.",
        "6": f"The motor's top speed of {six['omega_top']:.0f} rad/s limits from {six['t_top_speed_s']:.1f} s on.",
        "7": f"The current limit acts from {seven['t_current_from_s']:.1f} s to {seven['t_current_to_s']:.1f} s; "
        f"the map asks for up to {seven['P_map_max_W'] / 1e3:.0f} kW.",
        "9": f"The two methods differ by at most {nine['largest_gap_kmh']:.2f} km/h below 100 km/h.",
        "10": f"At most {behind} km/h, more the heavier the vehicle.",
    }


def _figure(number: str, light: bytes, dark: bytes, sentence: str) -> str:
    day, night = (f"data:image/png;base64,{b64encode(image).decode()}" for image in (light, dark))
    # A figure of several plots is as wide as the page.
    wide = " wide" if number == "10" else ""
    return (
        f'<figure class="card{wide}"><picture><source srcset="{night}" media="(prefers-color-scheme: dark)">'
        f'<img src="{day}" alt="Figure {number}: {escape(sentence)}"></picture>'
        f"<figcaption><b>Figure {number}.</b> {escape(TITLES[number])}<span><b>Paper:</b> {escape(paper.FIGURES[number])}</span>"
        f"<span><b>Here:</b> {escape(sentence)}</span></figcaption></figure>"
    )
