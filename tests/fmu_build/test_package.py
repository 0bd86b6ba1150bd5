import os
import subprocess
import zipfile

import fmpy
import numpy as np
import pytest
from fmpy.build import build_platform_binary

from halfshaft.fmu_build.package import build_fmu
from halfshaft.library.errors import InputError
from halfshaft.models.assembly import Description


def test_equal_input_makes_equal_files(kit, fmi, driven, tmp_path, monkeypatch):
    again = build_fmu(kit.model, kit.code, tmp_path / "again.fmu", fmi=fmi)
    assert again.read_bytes() == driven.read_bytes()
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    later = build_fmu(kit.model, kit.code, again, fmi=fmi)
    assert later.read_bytes() != driven.read_bytes()
    a, b = (fmpy.read_model_description(str(path)) for path in (driven, later))
    assert (a.generationDateAndTime, b.generationDateAndTime) == ("1980-01-01T00:00:00Z", "2023-11-14T22:13:20Z")
    assert a.guid == b.guid


def test_token_follows_the_content(kit, fmi, driven, self_contained, tmp_path):
    other = build_fmu(kit.model, kit.code.replace("10 *", "9 *"), tmp_path / "other.fmu", fmi=fmi)
    assert len({fmpy.read_model_description(str(path)).guid for path in (driven, self_contained, other)}) == 3


def test_content(fmi, driven):
    with zipfile.ZipFile(driven) as archive:
        names = archive.namelist()
        assert names == sorted(names)
        assert {"modelDescription.xml", "documentation/index.html", "documentation/licenses/halfshaft.txt", "sources/core.h"} < set(names)
        assert f"sources/fmi{fmi}.c" in names
        assert f"sources/fmi{5 - fmi}.c" not in names
        assert ("sources/buildDescription.xml" in names) == (fmi == 3)
        everything = b"".join(archive.read(name) for name in names)
    assert b"FMI" in everything
    assert os.fsencode(driven.parent) not in everything


def test_units(driven):
    units = {u.name: u for u in fmpy.read_model_description(str(driven)).unitDefinitions}

    def exponents(name):
        base = units[name].baseUnit
        return {e: int(getattr(base, e)) for e in ("kg", "m", "s", "A", "K", "mol", "cd", "rad") if int(getattr(base, e) or 0)}

    assert exponents("1") == {}
    assert exponents("N.m") == {"kg": 1, "m": 2, "s": -2}
    assert exponents("W.s^3/rad^3") == {"kg": 1, "m": 2, "rad": -3}
    assert [(d.name, float(d.factor)) for d in units["m/s"].displayUnits] == [("km/h", 3.6)]


@pytest.mark.parametrize("unit", ["furlong_per", "m^0.5", "EUR"])
def test_unit_that_is_none(kit, tmp_path, unit):
    model = kit.model._replace(parameters=(*kit.model.parameters[:2], Description("body.c", unit, "a strange one")))
    with pytest.raises(InputError, match=f"unit '{unit.replace('^', '.')}'"):
        build_fmu(model, kit.code, tmp_path / "x.fmu", fmi=2)
    assert list(tmp_path.iterdir()) == []


def test_variables_as_published(driven, self_contained):
    d, s = (fmpy.read_model_description(str(path)) for path in (driven, self_contained))
    assert [v.name for v in d.modelVariables if v.causality == "input"] == ["v_request", "grade", "key_on"]
    assert not [v for v in s.modelVariables if v.causality == "input"]
    a_max, _, v_start = (v for v in d.modelVariables if v.name.startswith("body.") and v.causality == "parameter")
    assert (a_max.variability, a_max.start, a_max.min, a_max.max, a_max.unit) == ("fixed", "1.5", "0.0", "20.0", "m/s^2")
    assert (v_start.unit, v_start.displayUnit) == ("m/s", "km/h")


def test_all_problems_of_a_cycle_at_once(kit, tmp_path):
    bad = kit.cycle._replace(grade=np.zeros(3), v_request=np.full(60, np.nan), grade_distance=(np.array([1.0, 1.0]), np.zeros(2)))
    with pytest.raises(InputError, match=r"did you mean 'body\.a_max'") as error:
        build_fmu(kit.model, kit.code, tmp_path / "x.fmu", fmi=2, step_size=0.0, cycle=bad, values={"body.amax": 1.0})
    assert len(error.value.problems) == 5


def test_values_replace_those_of_the_step(kit, tmp_path):
    path = build_fmu(kit.model, kit.code, tmp_path / "x.fmu", fmi=3, values={"body.a_max": 0.5})
    assert fmpy.simulate_fmu(str(path), stop_time=1.0, start_values={"v_request": 3.0}, output=["body.v"])[-1][1] == 0.5


def test_place_that_cannot_be_written(kit, tmp_path):
    with pytest.raises(InputError, match="there is no folder"):
        build_fmu(kit.model, kit.code, tmp_path / "missing" / "x.fmu", fmi=2)


def test_full_disk_leaves_the_old_file(kit, tmp_path):
    resource = pytest.importorskip("resource")
    target = tmp_path / "x.fmu"
    target.write_bytes(b"old")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    build_fmu(kit.model, kit.code, tmp_path / "warm.fmu", fmi=2)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, limits[1]))
    try:
        with pytest.raises(InputError, match="cannot be written"):
            build_fmu(kit.model, kit.code, target, fmi=2)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert target.read_bytes() == b"old"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["warm.fmu", "x.fmu"]


def test_rebuilds_from_its_sources(driven, tmp_path):
    pytest.importorskip("cmake")
    folder = tmp_path / "fmu"
    fmpy.extract(str(driven), str(folder))
    (binary,) = (folder / "binaries").rglob("toy.*")
    binary.unlink()
    (build := tmp_path / "build").mkdir()
    try:
        build_platform_binary(folder, build)
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"cmake does not run here: {error}")
    assert binary.exists()
    first, second = (fmpy.simulate_fmu(str(place), stop_time=5.0, start_values={"v_request": 3.0}) for place in (driven, folder))
    assert first.tolist() == second.tolist()
