"""Makes at build what the manual does not hold as text: a page for each kind of component, pictures, formulas as MathML.

A picture stands where a page says ``<!-- picture: name -->``; `PICTURES` says what it shows.  Some take a while: with the environment
variable ``MANUAL_DRAFT`` they stay empty.
"""

from __future__ import annotations

import inspect
import io
import os
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import MISSING, fields
from functools import cache, partial
from typing import Any

import numpy as np
from latex2mathml.converter import convert
from matplotlib.figure import Figure
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from halfshaft import Cycle, Record, Vehicle, calibrate, component_names, optimal, plot_run, run, uncertainty
from halfshaft.app.show import any_component
from halfshaft.cosim.maps import plot_maps
from halfshaft.cosim.plot import drawing, dress
from halfshaft.cosim.smooth import smoothed
from halfshaft.library.base.component import Component
from halfshaft.library.base.parameters import Parameters, Spec, spec_of
from halfshaft.library.base.ports import Port
from halfshaft.library.base.tables import Table
from halfshaft.library.files.catalog import component_kinds
from halfshaft.studies.autosize import Autosize
from halfshaft.studies.calibration.coast_down import CoastDown, coast_down
from halfshaft.studies.calibration.record import Series
from halfshaft.studies.calibration.roll_out import rolled
from halfshaft.studies.size import size
from halfshaft.studies.sizing.pareto import pareto
from halfshaft.studies.task import Drive

PICTURE = re.compile(r"<!-- picture: ([\w-]+) -->")
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)


def one_run() -> tuple[Figure, str]:
    """Return the run of the overview."""
    result = run(Vehicle.load("small-car-series"), Cycle.load("us06"))
    return plot_run(result, panels=("speed", "power", "charge")), "A series hybrid on US06: speed, powers and charge"


def overlaid() -> tuple[Figure, str]:
    """Return the two masses of the tutorial."""
    car, us06 = Vehicle.load("small-car-electric"), Cycle.load("us06")
    results = run(car, us06), run(car.with_values({"body.m": 1500.0}), us06)
    return plot_run(*results, panels=("speed", "motor.P_in", "battery.T")), "The electric car on US06 with two masses"


def sized(name: str) -> tuple[Figure, str]:
    """Return how a car was sized."""
    return Autosize()(Vehicle.load(name)).plot(), f"Sizes of {name}, trial by trial, and by how much each goal is met"


def smooth() -> tuple[Figure, str]:
    """Return how the smooth step comes to the exact one: over a cycle, and across a limit."""
    widths, cycle = 10.0 ** np.arange(-7, -0.5, 0.5), Cycle.load("udds")
    drawn = {
        "parallel": "engine.fuel_used",
        "conventional": "engine.fuel_used",
        "series-follower": "engine.fuel_used",
        "electric": "battery.soc",
    }
    full, scales = Cycle(name="start", time=[0.0, 1.0], speed=[0.0, 4.5]), np.linspace(0.43, 0.49, 121)
    with drawing(None, (9.0, 4.0), 0.75, "smooth step", ["UDDS", "a second at a limit"]) as figure:
        left, right = (figure.add_axes((x, 0.14, 0.39, 0.62)) for x in (0.083, 0.575))
        for (name, output), line in zip(drawn.items(), ("-", "-", "-", "--"), strict=True):
            car = Vehicle.load(f"small-car-{name}")
            form, exact = smoothed(car, cycle), run(car, cycle).last[output]
            at = form.step.output_index[output]
            apart = [abs(form.march(w).last[at] / exact - 1) for w in widths]
            left.loglog(widths, apart, line, marker=".", label=f"{name}, {'charge' if output == 'battery.soc' else 'fuel'}")
        left.set(xlabel="width", ylabel="part of the exact value that is missed")
        car = Vehicle.load("small-car-electric")
        form = smoothed(car, full)
        cars, at = [car.with_values({"motor.torque_scale": float(x), "body.m": 1144.0}) for x in scales], form.step.output_index["body.v"]
        for w in (0.1, 0.03, 0.01):
            right.plot(scales, [form.march(w, other).last[at] for other in cars], lw=1.1, label=f"width {w:g}")
        right.plot(scales, [run(other, full).last["body.v"] for other in cars], "k:", lw=1.1, label="exact")
        right.set(xlabel="motor.torque_scale", ylabel="speed after one second [m/s]")
        for ax in (left, right):
            dress(ax)
            ax.legend(frameon=False, loc="upper left", fontsize=8)
    return figure, "The smooth step comes to the exact one in proportion to the width; a limit is a bend"


def calibrated() -> tuple[Figure, str]:
    """Return a calibration as that of its page, over a shorter drive."""
    car, cycle = Vehicle.load("small-car-electric"), Cycle.load("udds").between(0, 330)
    result, draw = run(car.with_values({"body.c_d": 0.26, "wheel.f_0": 0.014}), cycle), np.random.default_rng(1)
    noises = {"battery.P_out": 500.0, "battery.soc": 1e-3}
    series = tuple(Series(output=n, time=result.time, values=result[n] + x * draw.normal(size=len(result.time))) for n, x in noises.items())
    found = calibrate(car, Record(name="drive", cycle=cycle, series=series), {"body.c_d": "0.2..0.5", "wheel.f_0": "0.004..0.02"})
    return found.plot(), "Power and charge of a drive: measured, before and fitted, and residuals"


def coasted() -> tuple[Figure, str]:
    """Return a coast-down both ways, with wind and slope."""
    time, draw, runs = np.arange(0, 100, 0.5), np.random.default_rng(1), []
    for d, name in ((1, "there"), (-1, "back")):
        load = 140 + 0.42 * 2.0**2 + d * 1500 * 9.81 * 0.002, 1.5 + d * 2 * 0.42 * 2.0, 0.42
        speed = rolled(time, 33.0, load, 1545.0)[0] + 0.03 * draw.normal(size=len(time))
        runs.append(CoastDown(name=name, time=time, speed=speed, direction=d))
    return coast_down(runs, 1500.0).plot(), "Two coast-downs against and with the wind, residuals, and the road load that they tell"


def uncertain() -> tuple[Figure, str]:
    """Return what the page on uncertainty begins with."""
    vary = {"body.c_d": "normal(0.335, 0.010)", "body.m": "uniform(1130, 1230 kg)", "wheel.f_0": "lognormal(0.009, 0.0009)"}
    found = uncertainty(Vehicle.load("small-car-electric"), vary, Drive(Cycle.load("udds")), figures=["energy_Wh_per_km"])
    return found.plot(), "Consumption of the electric car on UDDS: samples, first order, and shares of the variance"


def best() -> tuple[Figure, str]:
    """Return the best way to drive a parallel hybrid, beside its control."""
    found = optimal(Vehicle.load("small-car-parallel"), Cycle.load("udds").between(0, 200), places=20, points=11)
    return found.plot(), "A parallel hybrid: power split, gears, charge and fuel of the best way and of the control in use"


def optimum(name: str) -> tuple[Figure, str]:
    """Return how a problem of the library was solved."""
    return size(name).plot(), f"Goal, limits and sizes of the problem {name}, vehicle by vehicle"


def front() -> tuple[Figure, str]:
    """Return the front of the page on sizing."""
    return pareto("electric", "0-85 mph", range(16, 25)).plot(), "Least energy of the electric car, and its sizes, over the time to 85 mph"


PICTURES: dict[str, Callable[[], tuple[Figure, str]]] = {
    "one-run": one_run,
    "overlaid": overlaid,
    "optimum-parallel": partial(optimum, "parallel"),
    "front-electric": front,
    "smooth": smooth,
    "calibrated": calibrated,
    "coast-down": coasted,
    "uncertain": uncertain,
    "optimal": best,
    **{f"sized-{kind}": partial(sized, f"small-car-{kind}") for kind in ("series", "parallel", "conventional", "electric")},
}


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Add the generated pages to the navigation."""
    assert config.nav is not None
    config.nav.append({"Components": ["components/index.md", *({name: f"components/{name}.md"} for name in component_kinds())]})
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the generated pages and pictures."""
    made: dict[str, str | bytes] = {"components/index.md": index_page()}
    for name in component_kinds():
        made[f"components/{name}.md"] = kind_page(name)
        shown = first_with_maps(name)
        if shown:
            made[f"components/{name}.png"] = png(plot_maps(any_component(shown)))
    made |= {f"pictures/{name}.png": png(picture(name)[0]) for name in PICTURES}
    for path, content in made.items():
        files.append(File.generated(config, path, content=content))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Put pictures where a page names them."""
    return PICTURE.sub(lambda m: f"![{picture(m[1])[1]}](pictures/{m[1]}.png)", markdown)


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Write formulas as MathML."""
    return FORMULA.sub(lambda m: convert(m[2], display="inline" if m[1] == "span" else "block"), html)


@cache
def picture(name: str) -> tuple[Figure, str]:
    """Return a picture and what it shows; in a draft, that of nothing."""
    return (Figure(), name) if os.environ.get("MANUAL_DRAFT") else PICTURES[name]()


def png(figure: Figure) -> bytes:
    """Return a figure as a file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=130, facecolor="white", metadata={"Software": None})
    return buffer.getvalue()


def first_with_maps(kind: str) -> str | None:
    """Return the first component of the library with maps to draw."""
    return next((name for name in component_names(kind) if any(isinstance(x, Table) for x in any_component(name).values.values())), None)


def table(headings: tuple[str, ...], rows: Iterator[tuple[str, ...]]) -> str:
    """Return a table in Markdown; empty without rows."""
    lines = ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
    return "\n".join(["| " + " | ".join(headings) + " |", "|---" * len(headings) + "|", *lines]) if lines else ""


def text_of(docstring: str | None) -> str:
    """Return a docstring as Markdown: its blocks after two colons are code."""
    text = inspect.cleandoc(docstring or "")
    return re.sub(r"^::\n", "", re.sub(r"(?<=\S)::$", ":", text, flags=re.MULTILINE), flags=re.MULTILINE)


def kind_page(kind: str) -> str:
    """Return the page of a kind of component, made from its class."""
    cls = component_kinds()[kind]
    shown = first_with_maps(kind)
    sections = {
        "": text_of(sys.modules[cls.__module__].__doc__),
        "Parameters": table(("name", "unit", "meaning", "allowed", "default"), numbers_of(cls.parameters)),
        "Maps": table(("name", "unit", "meaning", "axes", "outside of them"), maps_of(cls.parameters)),
        "Map picture": f"![Maps of {shown}]({kind}.png)" if shown else "",
        "Ports": table(("port", "toward", "carries"), ports_of(cls)),
        "States": table(("state", "unit", "meaning"), ((f"`{s.name}`", s.unit, s.doc) for s in cls.states)),
        "Outputs": table(("output", "unit", "meaning", "booked as"), ((f"`{v.name}`", v.unit, v.doc, v.booking) for v in cls.variables)),
        "In the library": table(("component", "title"), ((f"`{name}`", any_component(name).title) for name in component_names(kind))),
    }
    body = [f"# {kind}", f'`kind = "{kind}"` in a file; class `{cls.__module__}.{cls.__name__}`.']
    for heading, text in sections.items():
        if text:
            body += [f"## {heading}", text] if heading not in ("", "Map picture") else [text]
    return "\n\n".join(body) + "\n"


def index_page() -> str:
    """Return the list of all kinds."""
    rows = ((f"[{kind}]({kind}.md)", inspect.getdoc(cls) or "", str(len(component_names(kind)))) for kind, cls in component_kinds().items())
    listed = table(("kind", "what it is", "in the library"), rows)
    return f"# Components\n\nThe kinds of components; each page is made from its class.\n\n{listed}\n"


def default_of(value: Any, spec: Spec) -> str:
    """Return a default as text."""
    return "" if value is MISSING else ", ".join(f"{x:g}" for x in value) if spec.row else f"{value:g}"


def numbers_of(kind: type[Parameters]) -> Iterator[tuple[str, ...]]:
    """Yield the numbers and rows of a parameter set."""
    for f in fields(kind):
        spec = spec_of(f)
        if not spec.axes:
            name = f"`{f.name}`" + (" (row)" if spec.row else "")
            yield name, spec.unit, spec.doc, spec.allowed().replace("<", "&lt;"), default_of(f.default, spec)


def maps_of(kind: type[Parameters]) -> Iterator[tuple[str, ...]]:
    """Yield the maps of a parameter set."""
    for f in fields(kind):
        spec = spec_of(f)
        if spec.axes:
            axes = ", ".join(f"`{a.name}`" if a.unit == "1" else f"`{a.name}` [{a.unit}]" for a in spec.axes)
            yield f"`{f.name}`", spec.unit, spec.doc, axes, "clipped" if spec.clip else "extrapolated"


def ports_of(cls: type[Component]) -> Iterator[tuple[str, ...]]:
    """Yield the ports of a component."""
    for name, port in cls.ports().items():
        assert isinstance(port, Port)
        yield f"`{name}`", f"the {port.side}", port.kind.__name__.lower()
