"""No text that a user writes gets into C, and XML holds any, whether or not it was checked on reading."""

import ast
import copy
import re
import unicodedata
import xml.etree.ElementTree as ET
import zipfile

import fmpy
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from halfshaft.cosim.cycle import Cycle
from halfshaft.cosim.fmu import build_fmu
from halfshaft.cosim.simulate import run
from halfshaft.fmu_build import package
from halfshaft.fmu_build.sources import literal
from halfshaft.fmu_build.variables import identifier
from halfshaft.fmu_build.xml import plain
from halfshaft.models.vehicle import Vehicle, vehicle_names

PIECES = [
    "*\\\n/", "*/", "/*", "//", '"', "\\", "\\\n", "??/", "??/\n", "%s%n", "#include", "\r\n", "\x00", "\x1b[2J", "\x85", "\u2028",
    "\ufffe", "\ud800", "]]>", "-->", "&amp;", "<", ">", "../../", "{0}", "{title}", "ü", "漢",
]  # fmt: skip
TEXTS = st.lists(st.sampled_from(PIECES) | st.text(max_size=5), max_size=8).map("".join)
CYCLE = Cycle(name="ramp", time=np.array([0.0, 2.0]), speed=np.array([0.0, 3.0]))
CAR = Vehicle.load("small-car-electric")


def with_texts(made, **texts):
    """Return what was made with other texts, past all checks."""
    changed = copy.copy(made)
    for name, text in texts.items():
        object.__setattr__(changed, name, text)
    return changed


def built(vehicle, cycle, fmi, folder, monkeypatch):
    """Return the C that the compiler gets without its literals, and the files of the FMU."""
    said = []

    def compiler(source, name, headers):
        said.extend([name, source, *(headers[file] for file in sorted(headers))])
        (folder / "library").write_bytes(b"")
        return folder / "library"

    monkeypatch.setattr(package, "shared_library", compiler)
    with zipfile.ZipFile(build_fmu(vehicle, folder / "x.fmu", fmi=fmi, cycle=cycle)) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    name, *c = said
    assert re.fullmatch("[A-Za-z][A-Za-z0-9_]*", name)
    # The headers of the standard come as they are; of ours, every character is a plain one.
    assert all(text.isascii() and text.replace("\n", "").isprintable() for text in c if "HS_TOKEN" in text)
    assert all(files[f"sources/{place}"].decode() in c for place in ("model.h", "core.h", f"fmi{fmi}.c"))
    return [re.sub(r'"(\\.|[^"\\\n])*"', '""', text) for text in c], files


@pytest.mark.parametrize(("fmi", "cycle"), [(2, None), (3, None), (2, CYCLE), (3, CYCLE)])
def test_texts_change_no_c_and_come_back_from_the_xml(fmi, cycle, tmp_path):
    with pytest.MonkeyPatch.context() as patch:
        harmless, files = built(CAR, cycle, fmi, tmp_path, patch)
        plain_page = files["documentation/index.html"]

        @settings(max_examples=15, deadline=None)
        @given(name=TEXTS, title=TEXTS, source=TEXTS, cycle_name=TEXTS)
        def check(name, title, source, cycle_name):
            texts = {"name": name, "title": title, "source": source}
            vehicle = with_texts(CAR, **texts, parts={role: with_texts(part, **texts) for role, part in CAR.parts.items()})
            hostile = cycle and with_texts(cycle, **texts | {"name": cycle_name})
            c, files = built(vehicle, hostile, fmi, tmp_path, patch)
            assert c == harmless
            root = ET.fromstring(files["modelDescription.xml"])
            shown, driven = (name or "electric"), (title or "electric")
            assert root.get("modelName") == plain(f"{shown}.{cycle_name}" if cycle else shown)
            assert root.get("description") == plain(f"{driven}, driven over {cycle_name}" if cycle else driven)
            assert re.fullmatch("[A-Za-z][A-Za-z0-9_]*", root.find("CoSimulation").get("modelIdentifier"))
            assert all(re.fullmatch("[A-Za-z0-9_./-]+", file) and ".." not in file for file in files)
            page = files["documentation/index.html"].decode()
            assert not [x for x in page if unicodedata.category(x) == "Cc" and x != "\n"]
            assert page.count("<") == plain_page.count(b"<")

        check()


@given(st.text())
def test_control_characters_and_nothing_else_are_lost(text):
    kept = [x for x in text if unicodedata.category(x) not in ("Cc", "Cs") and x not in "\ufffe\uffff"]
    assert list(plain(text)) == kept


@given(TEXTS)
def test_a_literal_is_printable_and_says_the_same(text):
    c = literal(text)
    assert c.isascii()
    assert c.isprintable()
    assert "?" not in c
    assert ast.literal_eval(f"b{c}") == text.encode("utf-8", "surrogatepass")


@given(TEXTS)
def test_every_name_gives_an_identifier(name):
    assert re.fullmatch("[A-Za-z][A-Za-z0-9_]{0,63}", identifier(name))


def test_identifiers_of_the_library_tell_vehicles_apart():
    names = vehicle_names()
    assert len({identifier(name) for name in names}) == len(names)
    assert identifier("small-car-electric") == "small_car_electric"
    assert identifier("Größe") != identifier("Grüße")


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_title_executes_nothing(fmi, tmp_path):
    code = f'static __attribute__((constructor)) void f(void) {{ int system(const char *); system("touch {tmp_path}/done"); }}'
    vehicle = with_texts(CAR, title=f"car *\\\n/ {code} /*")
    path = build_fmu(vehicle, tmp_path / "car.fmu", fmi=fmi)
    fmpy.simulate_fmu(str(path), stop_time=2.0)
    assert run(vehicle, CYCLE, via=f"fmu{fmi}").history.tolist() == run(CAR, CYCLE).history.tolist()
    assert list(tmp_path.iterdir()) == [path]
