import os
import re
import subprocess
import sys
import zipfile
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import casadi as ca
import fmpy
import numpy as np
import pytest
from fmpy.build import build_platform_binary
from fmpy.validation import validate_fmu

from halfshaft.cosim.cycle import Cycle, cycle_names
from halfshaft.cosim.fmu import build_fmu as build_vehicle
from halfshaft.fmu_build.package import build_fmu
from halfshaft.library.base.errors import InputError
from halfshaft.models.assembly import Description
from halfshaft.models.vehicle import Vehicle


def test_equal_input_makes_equal_files(kit, fmi, driven, tmp_path, monkeypatch):
    def built(epoch):
        monkeypatch.setenv("SOURCE_DATE_EPOCH", epoch)
        path = build_fmu(kit.model, kit.code, tmp_path / "x.fmu", fmi=fmi)
        with zipfile.ZipFile(path) as archive:
            (date,) = {entry.date_time for entry in archive.filelist}
        description = fmpy.read_model_description(str(path))
        assert description.guid == fmpy.read_model_description(str(driven)).guid
        return path.read_bytes(), date, description.generationDateAndTime

    first = built("1700000000")
    assert first[1:] == ((2023, 11, 14, 22, 13, 20), "2023-11-14T22:13:20Z")
    assert built("1700000000") == first
    # An archive knows no year before 1980.
    assert built("0")[1:] == ((1980, 1, 1, 0, 0, 0), "1970-01-01T00:00:00Z")
    before = datetime.now(UTC).replace(microsecond=0)
    assert before <= datetime.fromisoformat(built("")[2]) <= datetime.now(UTC)


@pytest.mark.parametrize("epoch", ["yesterday", "1.5", "-1", "9" * 30])
def test_a_date_that_is_none(kit, tmp_path, monkeypatch, epoch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", epoch)
    with pytest.raises(InputError, match=f'SOURCE_DATE_EPOCH = "{epoch}", must be whole seconds since 1970'):
        build_fmu(kit.model, kit.code, tmp_path / "x.fmu", fmi=2)


def test_experiment(kit, fmi, driven, self_contained, tmp_path):
    def experiment(path):
        e = fmpy.read_model_description(str(path)).defaultExperiment
        return e.startTime, e.stopTime, e.stepSize

    assert experiment(driven) == ("0", None, "1.0")
    assert experiment(self_contained) == ("0", "60.0", "1.0")
    assert experiment(build_fmu(kit.model, kit.code, tmp_path / "x.fmu", fmi=fmi, stop_time=1200.0)) == ("0", "1200.0", "1.0")
    # A step size must be less than the whole.
    assert experiment(build_fmu(kit.model, kit.code, tmp_path / "x.fmu", fmi=fmi, stop_time=1.0)) == ("0", "1.0", None)
    longest = max(Cycle.load(name).duration for name in cycle_names())
    car = build_vehicle(Vehicle.load("small-car-electric"), tmp_path / "car.fmu", fmi=fmi)
    assert [float(x) for x in experiment(car)] == [0.0, longest, 1.0]
    assert f"by default tools simulate {longest:g} s" in (Path(__file__).parents[2] / "docs" / "fmu.md").read_text()


def test_vehicles_are_told_apart(fmi, tmp_path):
    descriptions = []
    for name, cycle in (("small-car-electric", None), ("small-car-electric", "us06"), ("subcompact-electric", None)):
        car = replace(Vehicle.load("small-car-electric"), name=name)
        path = build_vehicle(car, tmp_path / "x.fmu", fmi=fmi, cycle=cycle and Cycle.load(cycle))
        assert validate_fmu(str(path)) == []
        descriptions.append(fmpy.read_model_description(str(path)))
    assert [d.modelName for d in descriptions] == ["small-car-electric", "small-car-electric.us06", "subcompact-electric"]
    identifiers = [d.coSimulation.modelIdentifier for d in descriptions]
    assert identifiers == ["small_car_electric", "small_car_electric_us06", "subcompact_electric"]
    assert len({d.guid for d in descriptions}) == 3


def test_step_size_is_called_fixed_only_where_it_is(fmi, driven, self_contained):
    sizes = [fmpy.read_model_description(str(path)).coSimulation.fixedInternalStepSize for path in (driven, self_contained)]
    assert sizes == [None, None if fmi == 2 else "1.0"]


def test_outputs_depend_on_no_input_and_start_values_on_their_parameters(fmi, driven, self_contained, tmp_path):
    car = build_vehicle(Vehicle.load("small-car-series"), tmp_path / "car.fmu", fmi=fmi)
    speed = {"body.v": "body.v_start"}
    battery = {
        "battery.charge_drawn": "battery.capacity_scale battery.soc_start battery.T_start",
        "battery.soc": "battery.soc_start",
        "battery.T": "battery.T_start",
    }
    for path, found in ((driven, speed), (self_contained, speed), (car, speed | battery)):
        d = fmpy.read_model_description(str(path))
        outputs = [v.name for v in d.modelVariables if v.causality == "output"]
        assert [(o.variable.name, o.dependencies) for o in d.outputs] == [(name, []) for name in outputs]
        initial = {u.variable.name: " ".join(v.name for v in u.dependencies) for u in d.initialUnknowns}
        assert initial == dict.fromkeys(outputs, "") | found


def test_casadi_reads_the_structure(driven, fmi, tmp_path):
    if fmi == 2:
        pytest.skip("CasADi reads FMI 3.0 only")
    fmpy.extract(str(driven), str(tmp_path))
    description = tmp_path / "modelDescription.xml"
    # It takes model exchange only, and asks for dependencies there.
    text = re.sub("<CoSimulation [^>]*>", '<ModelExchange modelIdentifier="toy" />', description.read_text())
    description.write_text(text)
    read = ca.DaeBuilder("toy", str(tmp_path))
    assert read.u() == ["v_request", "grade", "key_on"]
    assert len(read.y()) == 4


def test_token_follows_the_content(kit, fmi, driven, self_contained, tmp_path):
    other = build_fmu(kit.model, kit.code.replace("10 *", "9 *"), tmp_path / "other.fmu", fmi=fmi)
    assert len({fmpy.read_model_description(str(path)).guid for path in (driven, self_contained, other)}) == 3


def test_content(fmi, driven):
    with zipfile.ZipFile(driven) as archive:
        names = archive.namelist()
        assert names == sorted(names)
        assert {"modelDescription.xml", "documentation/index.html", "sources/core.h"} < set(names)
        for name, said in (("license", "halfshaft developers"), ("NOTICE", "NREL"), ("LICENSE-source", "Alliance for Sustainable Energy")):
            assert said in archive.read(f"documentation/licenses/{name}.txt").decode()
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
    model = kit.model._replace(parameters=(*kit.model.parameters[:2], Description("body.c", unit, "a strange one")), relations=())
    with pytest.raises(InputError, match=f"unit '{unit.replace('^', '.')}'"):
        build_fmu(model, kit.code, tmp_path / "x.fmu", fmi=2)
    assert list(tmp_path.iterdir()) == []


def test_variables_as_published(driven, self_contained):
    d, s = (fmpy.read_model_description(str(path)) for path in (driven, self_contained))
    assert [v.name for v in d.modelVariables if v.causality == "input"] == ["v_request", "grade", "key_on"]
    assert not [v for v in s.modelVariables if v.causality == "input"]
    a_max, _, v_start = (v for v in d.modelVariables if v.name.startswith("body.") and v.causality == "parameter")
    assert (a_max.variability, a_max.start, a_max.max, a_max.unit) == ("fixed", "1.5", "20.0", "m/s^2")
    # The standard knows no bound that is excluded.
    assert float(a_max.min) == sys.float_info.min
    key_on = next(v for v in d.modelVariables if v.name == "key_on")
    assert (key_on.min, key_on.max) == ("0.0", "1.0")
    assert (v_start.unit, v_start.displayUnit) == ("m/s", "km/h")


def test_all_problems_of_a_cycle_at_once(kit, tmp_path):
    rows = {"v_request": np.full(60, np.nan), "grade": np.zeros(3), "key_on": np.full(60, 2.0)}
    bad = kit.cycle._replace(**rows, grade_distance=(np.array([1.0, 1.0]), np.zeros(2)))
    with pytest.raises(InputError, match=r"did you mean 'body\.a_max'") as error:
        build_fmu(kit.model, kit.code, tmp_path / "x.fmu", fmi=2, step_size=0.0, cycle=bad, values={"body.amax": 1.0, "body.a_max": 0.0})
    assert len(error.value.problems) == 7
    assert "body.a_max = 0, must be > 0 m/s^2 and <= 20 m/s^2" in error.value.problems
    assert "key_on of the cycle must be >= 0 and <= 1" in error.value.problems


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
