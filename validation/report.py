"""The report on the reproduction: one page of HTML that needs nothing else."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping, Sequence
from html import escape
from string import Template
from typing import Any

from halfshaft import __version__
from halfshaft.validation import paper

_PAGE = Template("""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>The 1999 paper, reproduced</title>
<style>
:root { color-scheme: light dark; --page: #f6f7f9; --card: #ffffff; --ink: #1c2430; --faint: #5b6675; --line: #e3e7ec; --ours: #1f5fa8; }
@media (prefers-color-scheme: dark) {
  :root { --page: #0d1117; --card: #161b22; --ink: #e6eaf0; --faint: #9aa5b3; --line: #2b323c; --ours: #6cb0f5; }
}
* { box-sizing: border-box; }
body { margin: 0; background: var(--page); color: var(--ink); font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; }
main { max-width: 72rem; margin: 0 auto; padding: 3rem 1.25rem 4rem; }
h1 { font-size: 2rem; line-height: 1.2; margin: 0 0 .5rem; letter-spacing: -.01em; }
h2 { font-size: 1.25rem; margin: 3rem 0 .75rem; }
p { max-width: 46rem; margin: .5rem 0; }
.faint, figcaption, caption, .note { color: var(--faint); }
.key { display: grid; grid-template-columns: repeat(auto-fit, minmax(13rem, 1fr)); gap: 1rem; margin: 2rem 0 0; }
.key div, .card { background: var(--card); border: 1px solid var(--line); border-radius: .75rem; }
.key div { padding: 1rem 1.25rem; font-size: .9rem; color: var(--faint); line-height: 1.4; }
.key b { display: block; font-size: 1.6rem; font-weight: 600; color: var(--ink); font-variant-numeric: tabular-nums; }
.card { margin: 0 0 1.25rem; padding: 1rem 1.25rem; overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: .92rem; font-variant-numeric: tabular-nums; white-space: nowrap; }
caption { text-align: left; padding-bottom: .6rem; }
caption b { color: var(--ink); }
th, td { padding: .35rem .6rem; text-align: right; }
th { font-weight: 500; color: var(--faint); }
thead tr:first-child th { text-align: center; color: var(--ink); }
thead tr:last-child th { border-bottom: 1px solid var(--line); }
th:first-child { text-align: left; }
tbody th { color: var(--ink); font-weight: 400; }
tbody tr + tr > * { border-top: 1px solid var(--line); }
td.ours { color: var(--ours); font-weight: 600; }
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


def report(result: Mapping[str, Any], light: Mapping[str, bytes], dark: Mapping[str, bytes]) -> str:
    """Return the page; `light` and `dark` hold each figure as a PNG for a page of that kind."""
    tables = result["tables"]
    rendered = [_accuracy(n, tables[n], p) for n, p in (("2", paper.TABLE_2), ("3", paper.TABLE_3), ("4", paper.TABLE_4))]
    sentences = _sentences(result["figures"])
    return _PAGE.substitute(
        source=escape(paper.SOURCE),
        version=escape(__version__),
        key=_key(tables),
        tables="\n".join([*rendered, _speed(tables["5"])]),
        notes="\n".join(f'<p class="note">{escape(note)}</p>' for note in result["notes"]),
        figures="\n".join(_figure(n, image, dark[n], sentences[n]) for n, image in light.items()),
    )


def _number(x: float | None, digits: int, *, sign: bool = False) -> str:
    if x is None:
        return "&ndash;"
    return f"{x:{'+' if sign else ''}.{digits}f}".replace("-", "&minus;")


def _key(tables: Mapping[str, Any]) -> str:
    def gap(pairs: Sequence[tuple[Any, float]]) -> str:
        return "&ndash;" if any(x is None for x, _ in pairs) else f"{max(abs(x - printed) for x, printed in pairs):.3f}"

    both = (("hybrid", "paper"), ("iteration", "paper_iteration"))
    times = [pair for ours, printed in both for pair in zip(tables["2"][ours], tables["2"][printed], strict=True)]
    times += [(tables["4"][ours][0], tables["4"][printed][0]) for ours, printed in both]
    energies = [pair for ours, printed in both for pair in zip(tables["3"][ours], tables["3"][printed], strict=True)]
    energies += [(tables["4"][ours][1], tables["4"][printed][1]) for ours, printed in both]
    refined = [abs(x) for n in ("2", "3", "4") for x in tables[n]["difference_refined"] if x is not None]
    ratios = [x for x in tables["5"]["ratio"] if x is not None]
    faster = f"{_round(min(ratios))} to {_round(max(ratios))} times" if ratios else "&ndash;"
    error = "&ndash;" if not refined else f"{max(refined):.4f} %" if max(refined) > 1e-4 else "&lt; 0.0001 %"
    entries = [
        (f"{gap(times)} s", "largest distance from the paper's eight acceleration times"),
        (f"{gap(energies)} kWh", "largest distance from the paper's eight energies"),
        (error, "largest error of the refined method; the paper's method errs by up to 1.9 %"),
        (faster, "faster than the forward-facing model; in the paper 1.7 to 8.0"),
    ]
    return "".join(f"<div><b>{value}</b>{text}</div>" for value, text in entries)


def _round(x: float) -> str:
    """Return a number with two digits that count."""
    return f"{float(f'{x:.2g}'):,.0f}".replace(",", "&#8239;")


def _row(name: str, cells: Sequence[tuple[str, bool]]) -> str:
    return f'<tr><th scope="row">{escape(name)}</th>' + "".join(f"<td{' class=ours' if own else ''}>{x}</td>" for x, own in cells) + "</tr>"


def _table(number: str, title: str, groups: Sequence[tuple[str, tuple[str, ...]]], rows: Sequence[str]) -> str:
    top = "".join(f'<th scope="colgroup" colspan="{len(columns)}">{name}</th>' for name, columns in groups)
    below = "".join(f'<th scope="col">{c}</th>' for _, columns in groups for c in columns)
    head = f"<thead><tr><th></th>{top}</tr><tr><th></th>{below}</tr></thead>"
    return f'<div class="card"><table><caption><b>Table {number}.</b> {title}</caption>{head}<tbody>{"".join(rows)}</tbody></table></div>'


def _accuracy(number: str, t: Mapping[str, Any], printed: paper.Accuracy) -> str:
    pair = ("here", "paper")
    groups = [
        ("Hybrid", pair), ("Iteration", pair), ("Hybrid to iteration (%)", pair),
        ("Refined", ("here", "to iteration (%)")), ("Forward-facing", ("here", "to iteration (%)")),
    ]  # fmt: skip
    rows = [
        _row(name, [
            (_number(t["hybrid"][i], 3), True), (_number(t["paper"][i], 2), False),
            (_number(t["iteration"][i], 3), True), (_number(t["paper_iteration"][i], 2), False),
            (_number(t["difference"][i], 2, sign=True), True), (f"{t['paper_difference'][i]:+g}".replace("-", "&minus;"), False),
            (_number(t["refined"][i], 3), True), (_number(t["difference_refined"][i], 4, sign=True), True),
            (_number(t["forward"][i], 3), True), (_number(t["difference_forward"][i], 2, sign=True), True),
        ])
        for i, name in enumerate(printed.rows)
    ]  # fmt: skip
    return _table(number, f"{printed.title} ({printed.unit})", groups, rows)


def _speed(t: Mapping[str, Any]) -> str:
    groups = [("Hybrid", ("here (ms)", "paper (s)")), ("Forward-facing", ("here (s)", "paper (s)")), ("Ratio", ("here", "paper"))]
    rows = [
        _row(name, [
            (_number(1e3 * t["hybrid"][i], 2), True), (_number(t["paper"][i], 0), False),
            (_number(t["forward"][i], 2), True), (_number(t["paper_forward"][i], 0), False),
            (_number(t["ratio"][i], 0), True), (_number(t["paper_ratio"][i], 1), False),
        ])
        for i, name in enumerate(paper.TABLE_5.rows)
    ]  # fmt: skip
    title = "Execution times; here the small conventional car of the library on this machine, in the paper a Pentium Pro at 200 MHz"
    return _table("5", title, groups, rows)


def _sentences(facts: Mapping[str, Mapping[str, float]]) -> dict[str, str]:
    two, three, five, six, seven, nine, ten = (facts[n] for n in ("2", "3", "5", "6", "7", "9", "10"))
    behind = ", ".join(f"{x:.1f}" for x in ten.values())
    return {
        "2": f"The request peaks at {two['F_required_max_N'] / 1e6:.2f} MN, the tyres carry {two['F_limited_max_N'] / 1e3:.1f} kN.",
        "3": f"After 50 s the vehicle drives {three['v_end_kmh']:.0f} km/h.",
        "5": f"Up to {five['tau_required_max_Nm']:.0f} N m are asked for; the motor has {five['tau_limited_max_Nm']:.0f} N m.",
        "6": f"The motor's top speed of {six['omega_top']:.0f} rad/s limits from {six['t_top_speed_s']:.1f} s on.",
        "7": f"The current limit acts from {seven['t_current_from_s']:.1f} s to {seven['t_current_to_s']:.1f} s; "
        f"the map asks for up to {seven['P_map_max_W'] / 1e3:.0f} kW.",
        "9": f"The two methods differ by at most {nine['largest_gap_kmh']:.2f} km/h below 100 km/h.",
        "10": f"The largest deviations are {behind} km/h.",
    }


def _figure(number: str, light: bytes, dark: bytes, sentence: str) -> str:
    day, night = (f"data:image/png;base64,{b64encode(image).decode()}" for image in (light, dark))
    return (
        f'<figure class="card"><picture><source srcset="{night}" media="(prefers-color-scheme: dark)">'
        f'<img src="{day}" alt="Figure {number}: {escape(sentence)}"></picture>'
        f"<figcaption><b>Figure {number}.</b><span><b>Paper:</b> {escape(paper.FIGURES[number])}</span>"
        f"<span><b>Here:</b> {escape(sentence)}</span></figcaption></figure>"
    )
