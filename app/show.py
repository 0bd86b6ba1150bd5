"""What ``halfshaft list`` and ``halfshaft show`` print: the vehicles, components and cycles of the library or of files."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from pathlib import Path

import typer
from rich.markup import escape
from rich.padding import Padding
from rich.table import Table

from halfshaft.app.output import console, new_table
from halfshaft.cosim.cycle import Cycle, cycle_names
from halfshaft.cosim.units import Units
from halfshaft.library.base.errors import InputError, nearest
from halfshaft.library.base.parameters import described
from halfshaft.library.base.tables import Table as Map
from halfshaft.library.files.catalog import component_kinds
from halfshaft.library.files.component_file import LARGEST, ComponentFile, component_names, read_component
from halfshaft.library.files.texts import read_text
from halfshaft.models.powertrain import powertrains
from halfshaft.models.vehicle import Vehicle, vehicle_names
from halfshaft.studies.procedure_file import Plan, procedure_names

Rows = tuple[list[str], list[list[str]]]


def print_list(what: str, kind: str | None = None) -> None:
    """Print what the library has; of components, all or those of one kind."""
    shelves = {"vehicles": _vehicle_rows, "cycles": _cycle_rows, "procedures": _procedure_rows}
    headings, rows = _component_rows(kind) if what == "components" else shelves[what]()
    table = new_table()
    for i, heading in enumerate(headings):
        table.add_column(heading, justify="right" if "[" in heading else "left", no_wrap=i == 0, overflow="fold")
    for row in rows:
        table.add_row(*(escape(text) for text in row))
    console().print(table)


def _vehicle_rows() -> Rows:
    vehicles = [Vehicle.load(name) for name in vehicle_names()]
    return ["vehicle", "powertrain", "mass \\[kg]", "title"], [[v.name, v.powertrain, f"{v.mass:g}", v.title] for v in vehicles]


def _component_rows(kind: str | None) -> Rows:
    components = [any_component(name) for name in component_names(kind)]
    rows = [[c.name, c.kind, _power(c), _mass(c), c.title] for c in sorted(components, key=lambda c: c.kind)]
    return ["component", "kind", "power \\[kW]", "mass \\[kg]", "title"], rows


def _power(c: ComponentFile) -> str:
    """Return the largest continuous power of what has an envelope of torque over speed."""
    envelope = c.values.get("tau_max")
    return f"{(envelope.points[0] * envelope.values).max() / 1000:.1f}" if isinstance(envelope, Map) else ""


def _mass(c: ComponentFile) -> str:
    mass = c.values.get("mass", 0.0) * c.values.get("n_modules", 1.0)
    return f"{mass:.0f}" if mass else ""


def _cycle_rows() -> Rows:
    cycles = [Cycle.load(name) for name in cycle_names()]
    rows = []
    for c in cycles:
        s = c.statistics()
        rows.append([c.name, f"{s.duration:g}", f"{s.distance / 1000:.2f}", f"{s.v_max * 3.6:.1f}", c.title])
    return ["cycle", "time \\[s]", "distance \\[km]", "top \\[km/h]", "title"], rows


def _procedure_rows() -> Rows:
    plans = [Plan.load(name) for name in procedure_names()]
    return ["procedure", "for", "title"], [
        [p.name, ", ".join(dict.fromkeys(k for t in p.tests for k in t.vehicles)), p.title] for p in plans
    ]


def print_named(name: str, units: Units = "metric") -> None:
    """Print all numbers of a vehicle, a component or a cycle."""
    found = _find(name)
    if isinstance(found, Vehicle):
        _show_vehicle(found)
    elif isinstance(found, Cycle):
        print_cycle(found, units)
    else:
        _show_component(found)


def print_toml(name: str) -> None:
    """Print a vehicle or a component as the text of a file."""
    found = _find(name)
    if isinstance(found, Cycle):
        raise InputError(f"'{name}'", ["is a cycle, a CSV file; only vehicles and components are TOML files"])
    typer.echo(found.to_toml(), nl=False)


def draw(name: str, path: Path, units: Units) -> None:
    """Draw the maps of a component."""
    from halfshaft.cosim.maps import plot_maps

    found = _find(name)
    if not isinstance(found, ComponentFile):
        raise InputError(f"'{name}'", ["only the maps of a component are drawn; 'halfshaft show' names the components of a vehicle"])
    plot_maps(found, path, units)


def _find(name: str) -> Vehicle | Cycle | ComponentFile:
    if name.lower().endswith(".csv"):
        return Cycle.load(name)
    if name.endswith(".toml"):
        return any_component(name) if _is_component(Path(name)) else Vehicle.load(name)
    if name in vehicle_names():
        return Vehicle.load(name)
    if name in component_names():
        return any_component(name)
    if name.lower() in cycle_names():
        return Cycle.load(name)
    known = [*vehicle_names(), *component_names(), *cycle_names()]
    raise InputError(f"'{name}'", [f"no vehicle, component or cycle of the library is called so{nearest(name, known)}"])


def _is_component(path: Path) -> bool:
    try:
        return tomllib.loads(read_text(path, LARGEST)).get("kind") in component_kinds()
    except (InputError, ValueError, RecursionError, TypeError):
        return False  # the reader of vehicles says what is wrong


def any_component(name: str) -> ComponentFile:
    """Return a component, also one that leaves something open for a vehicle to decide."""
    try:
        return read_component(name)
    except InputError:
        # What other parts of a vehicle decide may be left open.
        return read_component(name, [d.parameter for powertrain in powertrains().values() for d in powertrain.derived])


def _head(name: str, title: str, facts: Iterable[tuple[str, str]]) -> None:
    console().print(f"[bold]{escape(name)}[/]  {escape(title)}", highlight=False, soft_wrap=True)
    grid = Table.grid(padding=(0, 2))
    grid.add_column(no_wrap=True)
    grid.add_column(overflow="fold")
    for key, value in facts:
        grid.add_row(f"[dim]{key}[/]", escape(value))
    console().print(Padding(grid, (0, 0, 0, 2)))


def _value_table(*headings: str) -> Table:
    table = new_table()
    table.add_column(headings[0], no_wrap=True)
    table.add_column("value", justify="right", no_wrap=True)
    table.add_column("unit", no_wrap=True)
    table.add_column("meaning", overflow="fold", min_width=18)
    for heading in headings[1:]:
        table.add_column(heading, no_wrap=True)
    return table


def _show_vehicle(v: Vehicle) -> None:
    _head(v.name, v.title, [("powertrain", v.powertrain), ("source", v.source)])
    parts = new_table()
    for heading in ("role", "component", "kind", "title"):
        parts.add_column(heading, no_wrap=heading == "role", overflow="fold")
    for role, part in v.parts.items():
        parts.add_row(role, escape(part.name), part.kind, escape(part.title))
    console().print(parts)
    ruled = v.rules.keys()
    table = _value_table("parameter", "from")
    for role, p in v.parameters.items():
        for name, *rest in described(type(p), vars(p)):
            full = f"{role}.{name}"
            origin = "set" if full in v.explicit else "rule" if full in ruled or full.rpartition("_")[0] in ruled else ""
            table.add_row(full, *map(escape, rest), origin)
        table.add_section()
    console().print(table)


def _show_component(c: ComponentFile) -> None:
    _head(c.name, c.title, [("kind", c.kind), ("source", c.source)])
    table = _value_table("parameter")
    for row in described(c.component.parameters, c.values):
        table.add_row(*map(escape, row))
    console().print(table)


def print_cycle(c: Cycle, units: Units = "metric") -> None:
    """Print the figures of a cycle."""
    _head(c.name, c.title, [("source", c.source)])
    table = _value_table("figure")
    for row in c.figures(units):
        table.add_row(*row)
    console().print(table)
