import contextlib
import ctypes
import math
import re
import shutil
import subprocess
from itertools import pairwise

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu

from halfshaft.cosim.fmu import build_fmu as build_vehicle
from halfshaft.fmu_build.package import build_fmu
from halfshaft.models.vehicle import Vehicle

TRACE = np.array([0.1, 1.3, 2.2, 3.7, 3.1, 0.4, 0.0, 2.9, 9.9, 3.3])


def test_valid(driven, self_contained):
    assert validate_fmu(str(driven)) == []
    assert validate_fmu(str(self_contained)) == []


def test_steps_are_those_of_the_model(kit, driven, client):
    c, twin = client(driven).initialize(), kit.twin()
    for v in TRACE:
        assert c.step(v_request=v, grade=v / 50) == twin.step(v, v / 50)
    assert c.get("time") == [10.0]


@pytest.mark.parametrize("start_time", [0.0, 100.0])
def test_fmpy_with_a_shifted_trace(kit, driven, start_time):
    # FMPy sets inputs at the start of a step, so the first point of the trace is the end of the first step.
    t = start_time + np.arange(len(TRACE))
    trace = np.array(list(zip(t, TRACE, strict=True)), dtype=[("time", float), ("v_request", float)])
    result = fmpy.simulate_fmu(
        str(driven), start_time=start_time, stop_time=start_time + len(TRACE), output_interval=1.0, input=trace,
        start_values={"body.a_max": 2.0, "grade": 0.01},
        output=["body.v", "body.distance", "body.v_request", "motor.tau"],
    )  # fmt: skip
    twin = kit.twin(a_max=2.0)
    assert [list(row)[1:] for row in result] == [twin.outputs, *(twin.step(v, 0.01) for v in TRACE)]


def test_fmi2_derivatives_make_a_trace_exact(kit, driven, client, fmi):
    if fmi == 3:
        pytest.skip("FMI 3.0 has no input derivatives")
    c, twin = client(driven).initialize(), kit.twin()
    inputs = [c.reference[name] for name in ("v_request", "grade", "key_on")]
    rows = [(0.0, 0.0, 1.0), *((v, v / 50, float(v > 0)) for v in TRACE)]
    for row, following in pairwise(rows):
        slopes = [b - a for a, b in zip(row, following, strict=True)]
        c.fmu.setReal(inputs, row)
        c.fmu.setRealInputDerivatives(inputs, [1, 1, 1], slopes)
        # a + (b - a) may differ from b in the last bit.
        assert c.step() == twin.step(*(a + slope for a, slope in zip(row, slopes, strict=True)))
    assert c.step(**dict(zip(("v_request", "grade", "key_on"), rows[1], strict=True))) == twin.step(*rows[1])


def test_fmi2_derivative_may_come_before_its_value(driven, client, fmi):
    if fmi == 3:
        pytest.skip("FMI 3.0 has no input derivatives")
    c = client(driven).initialize()
    c.fmu.setRealInputDerivatives([c.reference["v_request"]], [1], [0.5])
    assert c.step(v_request=0.25)[0] == 0.75
    # It counts for one step.
    assert c.step(v_request=0.25)[0] == 0.25


def test_fmi2_derivative_ends_at_the_bounds(driven, client, fmi):
    if fmi == 3:
        pytest.skip("FMI 3.0 has no input derivatives")
    c = client(driven).initialize()
    c.set("key_on", 1.0)
    c.fmu.setRealInputDerivatives([c.reference["key_on"]], [1], [5.0])
    assert c.step(v_request=1.0)[0] == 1.0


def test_fmi2_derivative_inside_a_long_step(kit, driven, client, fmi):
    if fmi == 3:
        pytest.skip("FMI 3.0 has no input derivatives")
    c, twin = client(driven).initialize(), kit.twin()
    c.set("v_request", 1.0)
    c.fmu.setRealInputDerivatives([c.reference["v_request"]], [1], [0.5])
    c.step(4.0)
    for v in (1.5, 2.0, 2.5, 3.0):
        twin.step(v)
    assert c.outputs == twin.outputs


def test_long_step_interpolates_from_the_start_speed(kit, driven, client):
    c = client(driven)
    c.set("body.v_start", 2.0)
    c.initialize()
    twin = kit.twin(v_start=2.0)
    c.step(4.0, v_request=4.0)
    for v in (2.5, 3.0, 3.5, 4.0):
        twin.step(v)
    assert c.outputs == twin.outputs
    c.step(2.5, v_request=9.0)
    for v in (4.0 + 5.0 * 1.0 / 2.5, 4.0 + 5.0 * 2.0 / 2.5):
        twin.step(v)
    assert c.outputs == twin.outputs


def test_short_steps_hold(kit, driven, client):
    c, twin = client(driven).initialize(), kit.twin()
    held = list(twin.outputs)
    seen = [c.step(0.3, v_request=v) for v in (0.3, 0.6, 0.9)]
    assert seen == [held, held, held]
    # The internal step ends at 1, a third of the way from 0.9 to 1.2.
    np.testing.assert_allclose(c.step(0.3, v_request=1.2), twin.step(1.0), rtol=1e-14)


def test_accumulated_time_and_a_last_crumb(kit, driven, client):
    c, twin = client(driven).initialize(), kit.twin()
    for i in range(100):
        c.step(0.1, v_request=0.1 * (i + 1))
    for i in range(10):
        twin.step(0.1 * (10 * i + 10))
    np.testing.assert_allclose(c.outputs, twin.outputs, rtol=1e-14)
    assert c.t != 10.0
    before = c.outputs
    assert c.step(1e-14) == before


def test_other_internal_step(kit, driven, client):
    c, twin = client(driven), kit.twin()
    c.set("step_size", 0.25)
    c.initialize()
    c.step(1.0, v_request=1.0)
    for v in (0.25, 0.5, 0.75, 1.0):
        twin.step(v, dt=0.25)
    assert c.outputs == twin.outputs


def test_start_values_follow_parameters(driven, client):
    c = client(driven)
    assert c.get("body.v") == [0.0]
    c.set("body.v_start", 3.0)
    assert c.get("body.v") == [3.0]
    assert c.initialize().outputs == [3.0, 0.0, 0.0, 0.0]


def test_whole_cycle_in_one_call(kit, self_contained, client):
    c, twin = client(self_contained).initialize(), kit.twin()
    c.step(float(len(kit.cycle.v_request)))
    last = march(kit, twin)
    assert c.outputs == twin.outputs
    assert c.get("v_request", "grade", "key_on") == last
    # The last row is held.
    c.step(2.0)
    twin.step(last[0], np_grade(kit, twin.distance), last[2])
    twin.step(last[0], np_grade(kit, twin.distance), last[2])
    assert c.outputs == twin.outputs


def march(kit, twin):
    for v, key_on in zip(kit.cycle.v_request, kit.cycle.key_on, strict=True):
        grade = np_grade(kit, twin.distance)
        twin.step(v, grade, key_on)
    return [v, grade, key_on]


def np_grade(kit, distance):
    points, grade = kit.cycle.grade_distance
    i = min(max(int(np.searchsorted(points, distance, side="right")) - 1, 0), len(points) - 2)
    if distance >= points[-1]:
        return grade[-1]
    return grade[i] + (grade[i + 1] - grade[i]) * (distance - points[i]) / (points[i + 1] - points[i])


def test_cycle_through_fmpy(kit, self_contained):
    result = fmpy.simulate_fmu(str(self_contained), output=["body.v", "body.distance", "body.v_request", "motor.tau"])
    twin = kit.twin()
    march(kit, twin)
    assert result["time"][-1] == 60.0
    assert list(result[-1])[1:] == twin.outputs


def test_cycle_with_grade_by_time_and_start_speed(kit, fmi, tmp_path, client):
    cycle = kit.cycle._replace(grade_distance=None, v_start=1.25)
    c, twin = client(build_fmu(kit.model, kit.code, tmp_path / "time.fmu", fmi=fmi, step_size=0.5, cycle=cycle)), kit.twin(v_start=1.25)
    assert c.initialize().outputs == twin.outputs
    assert c.description.defaultExperiment.stopTime == "30.0"
    c.step(30.0)
    for row in zip(cycle.v_request, cycle.grade, cycle.key_on, strict=True):
        twin.step(*row, dt=0.5)
    assert c.outputs == twin.outputs


def test_instances_do_not_meet(kit, driven, client):
    a, b = client(driven), client(driven)
    a.set("body.a_max", 9.0)
    a.initialize()
    b.initialize()
    twin_a, twin_b = kit.twin(a_max=9.0), kit.twin()
    for v in TRACE:
        assert a.step(v_request=v) == twin_a.step(v)
        assert b.step(v_request=v / 2) == twin_b.step(v / 2)


def test_rollback(driven, client, fmi):
    c = client(driven).initialize()
    c.step(2.5, v_request=4.0)
    state, t, before = c.fmu.getFMUState(), c.t, c.outputs
    data = c.fmu.serializeFMUState(state)
    there = [c.step(0.7, v_request=v) for v in TRACE]

    c.fmu.setFMUState(state)
    c.t = t
    assert c.outputs == before
    assert [c.step(0.7, v_request=v) for v in TRACE] == there
    c.fmu.freeFMUState(state)

    other = client(driven)
    moved = other.fmu.deserializeFMUState(data)
    other.fmu.setFMUState(moved)
    other.t = t
    assert [other.step(0.7, v_request=v) for v in TRACE] == there
    for bad in (data[:-1], b"x" * len(data)):
        with pytest.raises(FMICallException):
            other.fmu.deserializeFMUState(bad)
    other.fmu.freeFMUState(moved)


def test_reset(kit, driven, client):
    c = client(driven)
    c.set("body.a_max", 9.0)
    c.initialize().step(3.0, v_request=5.0)
    c.fmu.reset()
    assert c.get("body.a_max", "v_request", "time") == [1.5, 0.0, 0.0]
    c.initialize()
    assert c.step(v_request=1.0) == kit.twin().step(1.0)


@pytest.mark.parametrize(
    ("name", "value", "when", "message"),
    [
        ("body.a_max", 1.0, "after", "body.a_max .* fixed parameter"),
        ("step_size", 1.0, "after", "step_size .* fixed parameter"),
        ("body.a_max", 21.0, "before", r"^body\.a_max = 21 m/s\^2, must be > 0 m/s\^2 and <= 20 m/s\^2$"),
        ("body.a_max", 0.0, "before", r"^body\.a_max = 0 m/s\^2, must be > 0 "),
        ("step_size", 0.0, "before", "^step_size = 0 s, must be >= 1e-06 s$"),
        ("v_request", math.nan, "after", "^v_request = -?nan m/s, must be a finite number$"),
        ("key_on", -7.0, "after", "^key_on = -7, must be >= 0 and <= 1$"),
        ("key_on", 1.5, "before", "^key_on = 1.5, must be >= 0 and <= 1$"),
        ("body.k", math.inf, "before", "body.k = inf .* finite number"),
        ("body.v", 1.0, "before", "neither an input nor a parameter"),
    ],
)
def test_refused_values(kit, driven, client, name, value, when, message):
    c = client(driven)
    if when == "after":
        c.initialize()
    before = c.get(name)
    with pytest.raises(FMICallException) as error:
        c.set(name, value)
    assert error.value.status == 3
    (category, text), *_ = c.log
    assert category == "logStatusError"
    assert re.search(message, text)
    assert c.get(name) == before
    if when == "before":
        c.initialize()
    assert c.step(v_request=1.0) == kit.twin().step(1.0)


def test_lost_number_is_an_error_with_its_time(driven, client):
    c = client(driven)
    c.set("body.k", -1.0)
    c.initialize()
    state = c.fmu.getFMUState()
    with pytest.raises(FMICallException):
        c.step(3.0, v_request=1.0)
    assert c.log[0][1] == "motor.tau is not a number after the internal step that ends at 1 s; check inputs and parameters"
    # What it still shows is the last good step.
    assert c.outputs == [0.0] * 4
    with pytest.raises(FMICallException):
        c.step()
    c.fmu.setFMUState(state)
    c.fmu.freeFMUState(state)
    c.fmu.reset()
    c.initialize()
    c.step()


def test_wrong_calls_are_errors(driven, client, fmi):
    c = client(driven)
    with pytest.raises(FMICallException):
        c.step()
    c.initialize()
    for t, h in ((0.0, -1.0), (0.0, 0.0), (0.0, math.nan), (math.nan, 1.0), (0.0, math.inf), (0.0, 1e300)):
        with pytest.raises(FMICallException):
            c.fmu.doStep(t, h)
        assert "is not possible" in c.log[-1][1]
    with pytest.raises(FMICallException):
        (c.fmu.getReal if fmi == 2 else c.fmu.getFloat64)([10_000])
    with pytest.raises(FMICallException):
        c.fmu.getBoolean([0])
    assert c.fmu.getBoolean([]) == []
    c.fmu.setDebugLogging(False, ["logStatusError"])
    said = len(c.log)
    with pytest.raises(FMICallException):
        c.fmu.doStep(0.0, -1.0)
    assert len(c.log) == said


def test_logging_that_is_off_says_nothing(driven, client):
    c = client(driven)
    quiet = c.instantiate(logging=False)
    with pytest.raises(FMICallException):
        quiet.doStep(0.0, 1.0)
    assert c.log == []
    quiet.setDebugLogging(True, [])
    with pytest.raises(FMICallException):
        quiet.doStep(0.0, 1.0)
    assert len(c.log) == 1
    quiet.freeInstance()


def test_messages_are_whole_whether_or_not_a_tool_takes_them_as_format(driven, client, monkeypatch):
    c = client(driven)
    with pytest.raises(FMICallException):
        c.fmu.setDebugLogging(True, ["50%s of"])
    assert c.log[-1][1] == "unknown log category: 50%s of"
    # Without this FMPy hands over what the FMU gave as a format.
    monkeypatch.setattr("fmpy.logging.addLoggerProxy", lambda _: None)
    raw = client(driven)
    with pytest.raises(FMICallException):
        raw.step()
    assert re.fullmatch("fmi.DoStep may not be called in this state of the instance", raw.log[-1][1])


def test_steps_must_begin_where_the_last_one_ended(kit, driven, client):
    c, twin = client(driven).initialize(), kit.twin()
    assert c.step(v_request=1.0) == twin.step(1.0)
    for t, h in ((500.0, 1.0), (0.0, 1.0), (1.0 + 1e-5, 1.0)):
        with pytest.raises(FMICallException):
            c.fmu.doStep(t, h)
        assert re.fullmatch(r"a step from [0-9.]+ s is not possible: the instance is at 1 s", c.log[-1][1])
    # Nothing happened, and rounding is no error.
    assert c.outputs == twin.outputs
    c.t = 1.0 + 1e-9
    assert c.step(v_request=1.5) == twin.step(1.5)


@pytest.mark.parametrize(("start_time", "apart"), [(0.0, 0.0), (1.7e9, 2.0)])
def test_masters_may_add_or_multiply_their_time(driven, client, start_time, apart):
    added, multiplied = client(driven).initialize(start_time), client(driven).initialize(start_time)
    for i in range(3000):
        added.step(0.1, v_request=2.0)
        multiplied.t = start_time + i * 0.1
        multiplied.step(0.1, v_request=2.0)
    assert added.outputs[0] == multiplied.outputs[0] == 2.0
    # So far from zero 3000 sums are 0.3 ms late, and with them the last internal step.
    assert added.get("body.distance")[0] == pytest.approx(multiplied.get("body.distance")[0], abs=apart)


def test_the_stop_time_ends_the_steps(driven, client):
    c = client(driven).initialize(stop_time=10.0)
    for _ in range(100):
        c.step(0.1)
    assert c.t != 10.0
    c.step(1.95e-14)
    with pytest.raises(FMICallException):
        c.step(0.1)
    assert c.log[-1][1] == "a step from 10 s by 0.1 s is not possible: it goes past the stop time, 10 s"


def test_a_stop_before_the_start_is_refused(driven, client):
    c = client(driven)
    with pytest.raises(FMICallException):
        c.initialize(start_time=5.0, stop_time=4.0)
    assert c.log[-1][1] == "stop time 4 s: it must not be before the start time, 5 s"


def test_the_last_successful_time_is_that_of_the_last_good_step(driven, client, fmi):
    c = client(driven)
    c.set("body.k", 1.0)
    c.initialize()

    def last(t, h):
        if fmi == 2:
            with contextlib.suppress(FMICallException):
                c.fmu.doStep(t, h)
            return c.fmu.getRealStatus(2)
        time = ctypes.c_double(-1.0)
        flags = [ctypes.byref(ctypes.c_bool()) for _ in range(3)]
        c.fmu.dll.fmi3DoStep(c.fmu.component, ctypes.c_double(t), ctypes.c_double(h), True, *flags, ctypes.byref(time))
        return time.value

    assert last(0.0, 2.5) == 2.5
    assert last(2.5, -1.0) == 2.5
    c.set("grade", 1.7e308)
    # The outputs of three internal steps are lost; the last are those that would be seen.
    assert last(2.5, 3.0) == 2.5
    assert c.get("time") == [2.5]
    assert "is not a number after the internal step that ends at 5 s" in c.log[-1][1]


def test_relations_between_parameters_are_checked_when_the_initialization_ends(driven, client):
    c = client(driven)
    c.set("body.v_start", 20.0)
    with pytest.raises(FMICallException):
        c.initialize()
    assert c.log == [("logStatusError", "body: v_start = 20 m/s is over 10 s at a_max = 1.5")]
    c.fmu.reset()
    c.set("body.v_start", 20.0)
    c.set("body.a_max", 2.0)
    c.initialize()


def test_foreign_token_is_refused(driven, client):
    c = client(driven)
    c.description.guid = "{other}"
    with pytest.raises(Exception, match="instantiate"):
        c.instantiate()
    assert "the token is not that of this FMU" in c.log[0][1]


@pytest.mark.parametrize("language", [["cc", "-std=c99", "-pedantic"], ["g++", "-x", "c++", "-std=c++17"]], ids=["C99", "C++"])
@pytest.mark.parametrize("which", ["driven", "self_contained", "small-car-series"])
def test_sources_compile_without_a_warning(request, fmi, tmp_path, which, language):
    if not shutil.which(language[0]):
        pytest.skip(f"no {language[0]}")
    if which.startswith("small"):
        path = build_vehicle(Vehicle.load(which), tmp_path / "car.fmu", fmi=fmi)
    else:
        path = request.getfixturevalue(which)
    fmpy.extract(str(path), str(tmp_path / "x"))
    strict = ["-Wall", "-Wextra", "-Werror", "-O1", "-fPIC", "-shared", "-fvisibility=hidden"]
    subprocess.run([*language, *strict, "-o", "x.so", f"sources/fmi{fmi}.c", "-lm"], cwd=tmp_path / "x", check=True)
    # Nothing but the functions of the standard goes out, under its plain name.
    listed = subprocess.run(["nm", "-D", "--defined-only", "x.so"], cwd=tmp_path / "x", capture_output=True, text=True, check=True)
    names = [line.split()[-1] for line in listed.stdout.splitlines()]
    assert f"fmi{fmi}DoStep" in names
    assert all(name.startswith(f"fmi{fmi}") for name in names)
