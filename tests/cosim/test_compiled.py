import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from halfshaft import Cycle, InputError, Vehicle, accelerate, build_fmu, run
from halfshaft.cosim import memory
from halfshaft.cosim.compiled import InterpretedStep
from halfshaft.cosim.cycle import Samples
from halfshaft.cosim.memory import MemoryWarning
from halfshaft.cosim.simulate import parameters_of, stepper_of
from halfshaft.library.base.errors import SolveError
from halfshaft.library.base.tables import interpolants
from halfshaft.models.assembly import assemble

CAR = Vehicle.load("small-car-electric")
#: Numbers that are the same as integers and in single precision.
TIME = np.arange(0.0, 21.0)
SAMPLES = Samples(
    t=TIME[1:], dt=np.ones(20), v=np.minimum(TIME[1:], 10.0), grade=np.zeros(20), key_on=np.ones(20), v_start=0.0,
    grade_by_distance=(np.array([0.0, 50.0, 100.0, 200.0]), np.array([0.0, 0.125, -0.125, 0.0])),
)  # fmt: skip


def spread(x, step):
    wide = np.full(len(x) * abs(step), 7.0)
    wide[::step] = x
    return wide[::step]


def unaligned(x):
    place = np.zeros(x.nbytes + 1, dtype=np.uint8)[1:]
    place[:] = np.frombuffer(x.tobytes(), dtype=np.uint8)
    return place.view(np.float64)


#: Ways to hand over the same numbers.
FORMS = {
    "every third": lambda x: spread(x, 3),
    "backwards": lambda x: spread(x, -1),
    "single": lambda x: x.astype(np.float32),
    "swapped": lambda x: x.astype(x.dtype.newbyteorder()),
    "integers": lambda x: x.astype(int) if np.all(x == x.astype(int)) else x,
    "column": lambda x: np.column_stack([x, x + 1])[:, 0],
    "list": lambda x: x.tolist(),
    "objects": lambda x: x.astype(object),
    "unaligned": unaligned,
    "plain": lambda x: x,
}
forms = st.sampled_from(sorted(FORMS))


@pytest.fixture(scope="module")
def marched():
    compiled = stepper_of(CAR)
    parameters = parameters_of(CAR, compiled.step)
    state = compiled.first(parameters)
    return compiled, parameters, state, compiled.march(SAMPLES, parameters)


@given(form=st.tuples(*[forms] * 8))
def test_numbers_arrive_in_C_whatever_they_come_in(form, marched):
    compiled, parameters, state, expected = marched
    of = [FORMS[name] for name in form]
    distance, grade = SAMPLES.grade_by_distance
    samples = SAMPLES._replace(
        dt=of[0](SAMPLES.dt), v=of[1](SAMPLES.v), grade=of[2](SAMPLES.grade), key_on=of[3](SAMPLES.key_on),
        grade_by_distance=(of[4](distance), of[5](grade)),
    )  # fmt: skip
    exact = [FORMS["plain"] if name == "single" else FORMS[name] for name in form]
    march = compiled.march(samples, exact[6](parameters), exact[7](state))
    assert np.array_equal(march.history, expected.history)
    assert np.array_equal(compiled.first(exact[6](parameters)), state)
    request = np.array([1.0, 0.0, 1.0, 1.0, 0.0])
    one, plain = compiled(exact[7](state), of[0](request), exact[6](parameters)), compiled(state, request, parameters)
    assert all(np.array_equal(a, b) for a, b in zip(one, plain, strict=True))


@given(which=st.sampled_from(["dt", "v", "grade", "key_on", "slope", "parameters", "state", "text"]), change=st.sampled_from([-1, 1]))
def test_an_array_of_another_length_is_refused(which, change, marched):
    compiled, parameters, state, _ = marched

    def resized(x):
        return x[:-1] if change < 0 else np.append(x, 0.0)

    samples = SAMPLES
    if which == "slope":
        samples = samples._replace(grade_by_distance=(SAMPLES.grade_by_distance[0], resized(SAMPLES.grade_by_distance[1])))
    elif which == "text":
        samples = samples._replace(v=["fast"] * 20)
    elif which == "parameters":
        parameters = resized(parameters)
    elif which == "state":
        state = resized(state)
    else:
        samples = samples._replace(**{which: resized(getattr(samples, which))})
    for stepper in (compiled, InterpretedStep(compiled.step)):
        with pytest.raises(InputError, match=r"must be|could not convert"):
            stepper.march(samples, parameters, state)
    if which == "state":
        with pytest.raises(InputError, match="state has the shape"):
            compiled(state, np.zeros(5), parameters)
    if which == "parameters":
        with pytest.raises(InputError, match="parameters has the shape"):
            compiled.first(parameters)


@pytest.mark.parametrize("dtype", [int, np.float32])
def test_a_grade_over_distance_may_be_a_column_of_any_type(dtype):
    road = np.array([[0, 0], [500, 1], [1000, 0], [5000, 0]], dtype=dtype)
    cycle = Cycle(
        name="hill", time=np.array([0.0, 20.0, 220.0]), speed=np.array([0.0, 10.0, 10.0]), grade_by_distance=(road[:, 0], road[:, 1] / 32)
    )
    plain = Cycle(
        name="hill", time=cycle.time, speed=cycle.speed, grade_by_distance=(road[:, 0].astype(float), road[:, 1].astype(float) / 32)
    )
    result = run(CAR, cycle)
    assert result["body.distance"][-1] > 2000
    assert np.array_equal(result.history, run(CAR, plain).history)


def broken(step, samples, what):
    """Return samples and parameters with a number that vehicles and cycles refuse."""
    parameters = parameters_of(CAR, step)
    if what == "request":
        return samples._replace(v=np.full(len(samples.t), 1e300)), parameters
    parameters[step.parameter_index["accessories.eta"]] = 1e-310
    return samples, parameters


#: Longer than the march goes without a look.
LONG = Samples(np.arange(1.0, 41.0), np.ones(40), np.full(40, 10.0), np.zeros(40), np.ones(40), 0.0, None)


@pytest.mark.parametrize("history", [True, False])
@pytest.mark.parametrize(("what", "lost"), [("efficiency", r"accessories\.P_in_required"), ("request", r"body\.F_required")])
def test_an_output_that_is_not_finite_is_an_error_that_names_it(history, what, lost):
    compiled = stepper_of(CAR)
    when = "1" if history else "16"
    with pytest.raises(SolveError, match=f"by t = {when} s not finite: .*{lost}"):
        _ = compiled.march(*broken(compiled.step, LONG, what), history=history).sums


def test_an_interpreted_run_looks_at_its_outputs_too():
    stepper = InterpretedStep(assemble(CAR.model(), CAR.title, interpolants))
    with pytest.raises(SolveError, match="by t = 1 s not finite"):
        _ = stepper.march(*broken(stepper.step, SAMPLES, "efficiency")).sums


@pytest.mark.parametrize(
    ("arguments", "messages"),
    [
        ({"via": "stp", "mode": "refind"}, ["via = 'stp', must be one of step, fmu2, fmu3, forward, did you mean 'step'?", "'refined'?"]),
        ({"via": ["step"]}, ["via = ['step'], must be one of"]),
        ({"dt": [1.0]}, ["dt = [1.0] s, must be a number > 0 s"]),
        ({"dt": None}, ["dt = None s"]),
        ({"dt": "fast"}, ["dt = fast s"]),
        ({"dt": 10**400}, ["must be a number > 0 s"]),
        ({"dt": float("inf"), "mode": "rough"}, ["dt = inf s", "mode = 'rough'"]),
        ({"vehicle": "small-car-electric", "cycle": "udds"}, ["vehicle must be a Vehicle, from Vehicle.load(...)", "cycle must be a"]),
        ({"via": "forward", "mode": "refined"}, ["mode refined runs via step only"]),
    ],
)
def test_arguments_of_a_run_are_checked_together(arguments, messages):
    with pytest.raises(InputError) as caught:
        run(**{"vehicle": CAR, "cycle": Cycle.load("im240"), **arguments})
    for message in messages:
        assert message in str(caught.value)


def test_a_name_is_no_vehicle_and_no_cycle_wherever_one_is_asked_for(tmp_path):
    vehicle = "vehicle must be a Vehicle, from Vehicle.load(...), not str"
    with pytest.raises(InputError) as caught:
        accelerate("small-car-electric", to="fast")
    assert caught.value.problems == (vehicle, "target speed nan km/h, must be > 0 and < 322 km/h")
    with pytest.raises(InputError) as caught:
        build_fmu("small-car-electric", tmp_path / "car.fmu", fmi=3, cycle="udds")
    assert caught.value.problems == (vehicle, "cycle must be a Cycle, from Cycle.load(...), not str")


@pytest.mark.parametrize("dt", [np.float32(0.5), np.float64(0.5), np.array(0.5), "0.5"])
def test_a_step_may_be_any_number(dt):
    assert run(CAR, Cycle.load("im240"), dt=dt).inputs.dt == 0.5


def test_numbers_that_are_none_are_refused_wherever_they_are_given(tmp_path):
    cycle = Cycle.load("im240")
    for call in (
        lambda: cycle.scaled([2]),
        lambda: cycle.sampled("fast"),
        lambda: build_fmu(CAR, tmp_path / "car.fmu", fmi=3, dt=[1.0]),
        lambda: CAR.with_values({"body.m": [1200.0]}),
        lambda: accelerate(CAR, to=[20.0]),
        lambda: accelerate(CAR, duration="long"),
    ):
        with pytest.raises(InputError, match=r"must be|not a finite number"):
            call()
    assert cycle.scaled(np.float32(2)).speed.max() == 2 * cycle.speed.max()
    for kind in (np.float32, np.int16):
        assert CAR.with_values({"body.m": kind(1200)}).values["body.m"] == 1200


def test_a_run_that_does_not_fit_into_the_memory_is_refused_with_the_cure(monkeypatch):
    long = Cycle(name="long", time=np.array([0.0, 1e7]), speed=np.array([10.0, 10.0]))
    n_outputs = len(stepper_of(CAR).step.outputs)
    need = 8e7 * (n_outputs + memory.PER_STEP) / 2**30
    monkeypatch.setattr(memory, "available", lambda: 2.0**32)
    text = (
        rf"1e\+07 steps with {n_outputs} outputs each take {need:.1f} GiB of memory, there are 4.0 GiB; .*history=False, .* takes 0.6 GiB"
    )
    with pytest.raises(InputError, match=text):
        run(CAR, long)
    with pytest.raises(InputError, match=r"1e\+12 steps take .* TiB of memory, there are 4.0 GiB; take a longer dt"):
        run(CAR, long, dt=1e-5, history=False)
    with pytest.raises(InputError, match="inf steps take inf TiB"):
        run(CAR, long, dt=1e-310, history=False)
    with pytest.warns(MemoryWarning, match=r"take .* GiB of memory; take a longer dt, or history=False"):
        memory.check_memory(3e6, 100, history=True)


def test_the_memory_of_this_machine_is_known():
    assert memory.available() > 2**20
