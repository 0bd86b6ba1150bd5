"""What objects look like at a prompt and in a notebook."""

import re
from html.parser import HTMLParser

import pytest

from halfshaft import Cycle, Vehicle, run
from halfshaft.library.base.tables import Table
from halfshaft.library.files.component_file import component_names, read_component


class Checker(HTMLParser):
    """Checks that every tag is closed in turn."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []

    def handle_starttag(self, tag, attrs):
        self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag


def well_formed(html):
    checker = Checker()
    checker.feed(html)
    checker.close()
    assert not checker.open
    return html


@pytest.mark.parametrize(
    ("thing", "text"),
    [
        (Vehicle.load("small-car-electric"), "<Vehicle small-car-electric: electric, 1144 kg, 9 parts>"),
        (Cycle.load("udds"), "<Cycle udds: 1369 s, 11.99 km>"),
        (read_component("si-41kw"), "<ComponentFile si-41kw: engine>"),
        (Table.of([0, 1], [1, 2, 3], values=[[1, 2, 3], [4, 5, 6]]), "<2 x 3 values, 1 to 6>"),
    ],
)
def test_a_prompt_shows_one_line(thing, text):
    assert repr(thing) == text


def test_a_prompt_shows_what_a_run_was_made_of_and_its_audit_in_one_line():
    result = run(Vehicle.load("small-car-electric"), Cycle.load("us06"))
    assert repr(result.origin).startswith("<Origin small-car-electric over us06: 20")
    assert repr(result.origin.cycle).startswith("<Text of the cycle us06: ")
    assert repr(result.audit) == f"<Audit {len(result.audit.checks)} laws: all hold>"


def test_a_prompt_shows_parameters_without_the_values_of_maps():
    for name in component_names("motor"):
        file = read_component(name)
        assert len(repr(file.component(file.parameters))) < 400


def test_a_notebook_shows_every_parameter_of_a_vehicle():
    car = Vehicle.load("small-car-series")
    html = well_formed(car._repr_html_())
    maps = {f"{role}.{name}" for role, p in car.parameters.items() for name, x in vars(p).items() if isinstance(x, Table)}
    assert {name for name in re.findall(r">(\w+\.\w+)</td>", html)} >= car.values.keys() | maps
    assert all(part.title in html for part in car.parts.values())


def test_a_notebook_shows_components_and_cycles():
    for name in component_names("engine"):
        assert "fuel" in well_formed(read_component(name)._repr_html_())
    assert "rotor inertia" in well_formed(read_component("ac-75kw").parameters._repr_html_())
    assert ">-2 to 2<" in well_formed(Cycle.load("hwfet-mtn")._repr_html_())


def test_texts_of_a_file_are_no_html(tmp_path):
    path = tmp_path / "trip.csv"
    path.write_text("# name: trip\n# title: <script>alert(1)</script> & more\ntime_s,speed_mps\n0,0\n1,1\n2,0\n")
    html = well_formed(Cycle.load(path)._repr_html_())
    assert "<script" not in html
    assert "&lt;script&gt;alert(1)&lt;/script&gt; &amp; more" in html
