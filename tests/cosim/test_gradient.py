"""Derivatives of whole runs against differences of the exact step, and against CasADi's own derivative."""

import casadi as ca
import numpy as np
import pytest

from halfshaft import Cycle, InputError, Vehicle, run
from halfshaft.cosim.gradient import rates, slopes
from halfshaft.cosim.result import Result
from halfshaft.cosim.simulate import parameters_of, stepper_of
from halfshaft.cosim.smooth import record_of
from halfshaft.fmu_build.graph import step_graph

CAR, UDDS = Vehicle.load("small-car-electric"), Cycle.load("udds")
#: Eight numbers that every car has some of, sizes and others; of each car those that it has.
SCALES = (
    "motor.torque_scale", "engine.torque_scale", "battery.n_modules", "motor.efficiency_scale", "generator.torque_scale", "body.c_d",
    "wheel.r", "body.A", "final_drive.i", "engine.fuel_scale", "battery.capacity_scale", "accessories.P",
)  # fmt: skip
FLOOR = Cycle(name="floor", time=[0.0, 1.0, 30.0], speed=[0.0, 60.0, 60.0])


def scales(car):
    return [name for name in SCALES if name in car.values][:8]


def ends(step):
    """Return the outputs that tell fuel and energy, integrated, and a few others."""
    booked = [(d.name, "integral") for d in step.outputs if d.booking in ("fuel", "stored")]
    return [*booked, (step.tags.the("distance"), "last"), (step.tags.the("miss"), "max")]


@pytest.mark.parametrize(
    ("name", "cycle", "mode"),
    [
        ("small-car-electric", UDDS, "hybrid"), ("small-car-series", UDDS, "refined"), ("small-car-parallel", FLOOR, "refined"),
        ("small-car-conventional", FLOOR, "iteration"),
    ],
)  # fmt: skip
def test_the_values_are_those_of_a_run_to_the_bit(name, cycle, mode):
    car = Vehicle.load(name)
    step = stepper_of(car).step
    outputs = [d.name for d in step.outputs][::3]
    wanted = [(output, how) for output in outputs for how in ("last", "integral", "max", "min")] + [(outputs[0], 17.0)]
    found = slopes(car, cycle, scales(car), wanted, history=outputs[:2], mode=mode)
    result = run(car, cycle, mode=mode)
    for output in outputs:
        assert found.values[output, "last"] == result.last[output]
        assert found.values[output, "max"] == result.highest[output]
        assert found.values[output, "min"] == result[output].min()
        assert found.values[output, "integral"] == pytest.approx(result.energies[output], rel=1e-12, abs=1e-9)
    assert np.array_equal(found.history[outputs[1]], result[outputs[1]])
    assert found.values[outputs[0], 17.0] == result[outputs[0]][16]


#: On which side of a kink an operation is.
SIDES = {
    "min": lambda a, b: a < b, "max": lambda a, b: a > b, "fabs": lambda a: a < 0, "clip": lambda x, a, b: (x < a) + 2 * (x > b),
    "sign": np.sign, "floor": np.floor, "ceil": np.ceil, "lt": np.less, "le": np.less_equal, "eq": np.equal, "ne": np.not_equal,
    "true": lambda a: a != 0,
}  # fmt: skip


def sides(car, cycle):
    """Return of all operations with a kink on which side they are, in each step of a run."""
    compiled, samples = stepper_of(car), cycle.sampled(1.0)
    found, p = step_graph(compiled.step), parameters_of(car, compiled.step, samples.v_start)
    record = record_of(compiled, found, samples, p)
    # The values are the run's own.
    history = compiled.march(samples, p).history
    assert all(np.allclose(record.of(name), history[:, i], rtol=1e-9, atol=1e-9) for i, name in enumerate(found.outputs))
    taken = {op.name: record.of(op.name) for op in found.stepped if op.what == "find"}
    kinks = [op for op in (*found.prepared, *found.stepped) if op.what in SIDES]
    return taken | {f"{op.what} {op.name}": SIDES[op.what](*(record.of(name) for name in op.of)) for op in kinks}


def of(result, what):
    """Return what of an output a run has."""
    return {"integral": result.energies, "last": result.last, "max": result.highest}[what[1]][what[0]]


def crossed(car, name, apart, cycle):
    """Name the first operation that is on different sides in two runs, and the time."""
    value = car.values[name]
    low, high = (sides(car.displaced({name: value + sign * apart}), cycle) for sign in (-1, 1))
    found = [(int(np.argmax(low[op] != high[op])), op) for op in low if np.any(low[op] != high[op])]
    return f"t = {min(found)[0] + 1} s: {min(found)[1]}" if found else ""


@pytest.mark.parametrize("name", ["small-car-electric", "small-car-series", "small-car-conventional"])
def test_gradients_are_central_differences_where_no_kink_is_crossed(name, record_property):
    # Its mass not rounded, as those near to it.
    car = Vehicle.load(name).displaced({})
    names, wanted, kinks = scales(car), ends(stepper_of(car).step), {}
    found = slopes(car, UDDS, names, wanted)
    for i, number in enumerate(names):
        value = car.values[number]

        def differences(apart, number=number, value=value):
            up, down = (run(car.displaced({number: value + sign * apart}), UDDS, history=False) for sign in (1, -1))
            return {what: (of(up, what) - of(down, what)) / (2 * apart) for what in wanted}

        # The nearer, the less is crossed, until rounding is all there is.
        for apart in (1e-4 * value, 1e-5 * value, 1e-6 * value):
            wide, near = differences(apart), differences(apart / 2)
            # Without the error of second order.
            exact = {what: (4 * near[what] - wide[what]) / 3 for what in wide}
            if all(found.gradient[w][i] == pytest.approx(x, rel=1e-6, abs=1e-9 * abs(found.values[w]) / value) for w, x in exact.items()):
                break
            kinks[number] = crossed(car, number, apart, UDDS)
            assert kinks[number], (number, exact, found.gradient)
        else:
            continue
        kinks.pop(number, None)
    record_property("kinks crossed", str(kinks))
    assert len(kinks) < len(names) / 2


def test_the_gradient_is_casadis_own_over_a_hundred_steps():
    car = Vehicle.load("small-car-series")
    step, part = stepper_of(car).step, Cycle(name="part", time=UDDS.time[20:121], speed=UDDS.speed[20:121])
    names, wanted = scales(car), ends(step)
    found, samples = slopes(car, part, names, wanted), part.sampled(1.0)
    requests = np.array([samples.v, samples.grade, samples.key_on, samples.dt, np.zeros(len(samples.t))])
    n, p = requests.shape[1], parameters_of(car, step, samples.v_start)
    free = ca.MX.sym("free", len(names))
    moved = ca.DM(p) + ca.mtimes(ca.DM(rates(car, step, names)), free)
    _, outputs = step.function.mapaccum(n)(step.start(moved), ca.DM(requests), ca.repmat(moved, 1, n))
    sums = [ca.sum2(outputs[step.output_index[output], :]) for output, how in wanted if how == "integral"]
    theirs = np.array(ca.Function("f", [free], [ca.jacobian(ca.vertcat(*sums), free)])(np.zeros(len(names))))
    ours = np.array([found.gradient[what] for what in wanted if what[1] == "integral"])
    assert n == 100
    assert np.allclose(ours, theirs, rtol=1e-12, atol=1e-12 * np.abs(theirs).max())


@pytest.mark.parametrize("name", ["small-car-electric", "small-car-conventional"])
def test_a_speed_that_is_solved_for_tells_what_it_depends_on(name):
    car = Vehicle.load(name).displaced({})
    step = stepper_of(car).step
    speed, names = step.tags.the("speed"), scales(car)
    wanted = [(speed, 12.0), (step.tags.the("distance"), "last"), (step.tags.the("miss"), 20.0)]
    found = slopes(car, FLOOR, names, wanted, mode="iteration", history=[speed])
    assert found.unsolved == 0
    assert np.array_equal(found.history_gradient[speed][11], found.gradient[speed, 12.0])
    for i, number in enumerate(names):
        apart = 1e-5 * car.values[number]
        up, down = (run(car.displaced({number: car.values[number] + sign * apart}), FLOOR, mode="iteration") for sign in (1, -1))
        theirs = [
            (up[speed][11] - down[speed][11]),
            up.the("distance")[-1] - down.the("distance")[-1],
            up.the("miss")[19] - down.the("miss")[19],
        ]
        ours = [found.gradient[what][i] for what in wanted]
        assert ours == pytest.approx(np.array(theirs) / (2 * apart), rel=2e-4, abs=1e-7 / apart * 1e-3), number


def test_the_road_ahead_depends_on_the_way_made():
    car = CAR.displaced({"motor.torque_scale": 0.2})
    hill = Cycle(name="hill", time=FLOOR.time, speed=FLOOR.speed, grade_by_distance=([0.0, 100.0, 900.0], [0.0, 0.05, -0.02]))
    step = stepper_of(car).step
    wanted = (step.tags.the("distance"), "last")
    found = slopes(car, hill, ["body.c_d", "motor.torque_scale"], [wanted]).gradient[wanted]
    for slope, number in zip(found, ("body.c_d", "motor.torque_scale"), strict=True):
        apart = 1e-5 * car.values[number]
        up, down = (run(car.displaced({number: car.values[number] + sign * apart}), hill, history=False) for sign in (1, -1))
        assert slope == pytest.approx((of(up, wanted) - of(down, wanted)) / (2 * apart), rel=1e-6)


def test_figures_follow_sizes_masses_ratings_and_ratios(tmp_path):
    car = Vehicle.load("small-car-parallel").displaced({})
    names = ["motor.torque_scale", "battery.E", "body.m", "motor.P_max", "coupler.n"]
    with pytest.raises(InputError, match=r"motor\.P_max and motor\.torque_scale both say how large it is"):
        run(car, UDDS, gradient=names)
    names.remove("motor.P_max")
    result = run(car, UDDS, gradient=names)
    for name in names:
        value = car.values[name] if name in car.values else car.rated[name].of(car.parameters["battery"])
        up, down = (run(car.displaced({name: value * (1 + sign * 1e-6)}), UDDS).figures for sign in (1, -1))
        for figure, of_numbers in result.gradient.items():
            theirs = (up[figure] - down[figure]) / (2e-6 * value)
            assert of_numbers[name] == pytest.approx(theirs, rel=1e-5, abs=3e-8 * abs(result.figures[figure]) / value), (figure, name)
    # A size brings its mass along, which counts alone as well.
    heavier = car.displaced({"motor.torque_scale": 2.0}).mass - car.mass
    assert result.gradient["fuel_L"]["motor.torque_scale"] != pytest.approx(0)
    assert rates(car, stepper_of(car).step, names)[stepper_of(car).step.parameter_index["body.m"]][0] == pytest.approx(heavier)
    result.save(tmp_path / "run.nc")
    assert Result.load(tmp_path / "run.nc").gradient == result.gradient


def test_all_that_is_wrong_is_named_at_once():
    with pytest.raises(InputError) as error:
        slopes(CAR, UDDS, ["motor.torque", "body.m", "body.m"], [("motor.P", "sum"), ("body.v", 1e6)], history=["body.w"])
    assert error.value.problems == (
        "motor.torque is no number of the vehicle, did you mean 'motor.torque_scale'?",
        "body.m stands 2 times",
        "motor.P is no output, did you mean 'motor.P_map'?",
        "body.w is no output",
        "motor.P: 'sum' must be a time or one of last, integral, max, min, first",
        "body.v: 1e+06 s is no time of the cycle, which lasts from 0 s to 1369 s",
    )
    with pytest.raises(InputError, match="via step only"):
        run(CAR, UDDS, via="forward", gradient=["body.m"])
