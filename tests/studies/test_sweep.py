"""Sweeps: the points of grids and samples, what is found there, and what is refused."""

import pickle
import sys
from dataclasses import dataclass

import numpy as np
import pytest

from halfshaft import Cycle, InputError, Vehicle, vehicle_names
from halfshaft.cosim.figures import title_of, unit_of
from halfshaft.studies import batch
from halfshaft.studies.acceleration import AccelerationTest
from halfshaft.studies.design import Axis, Sample, design_of, read_axes
from halfshaft.studies.sweep import sweep, table
from halfshaft.studies.task import Drive, Found

CAR = Vehicle.load("small-car-electric")
SHORT = Cycle(name="short", time=[0, 10, 20, 30], speed=[0, 10, 10, 0])


@dataclass(frozen=True)
class Weigh:
    """A task that costs nothing: what the numbers of the vehicle are; it fails above a mass."""

    fails_above: float = 1e9
    name: str = "weigh"

    def __call__(self, vehicle):
        if vehicle.mass > self.fails_above:
            raise ZeroDivisionError("too heavy")
        return Found({"mass_kg": vehicle.mass, "drag": vehicle.values["body.c_d"], "fuel_L": None}, (f"weighs {vehicle.mass:g} kg",))


def design(axes, sample=None, cars=(CAR,)):
    problems = []
    found = design_of(cars, axes, sample, problems)
    assert not problems, problems
    return found


def problems(*args, **kwargs):
    with pytest.raises(InputError) as error:
        sweep(*args, **kwargs)
    return list(error.value.problems)


def test_a_grid_has_all_combinations_and_the_last_axis_varies_fastest():
    d = design({"body.m": "1000..1600:3", "body.c_d": [0.2, 0.3]})
    assert d.points == [(1000, 0.2), (1000, 0.3), (1300, 0.2), (1300, 0.3), (1600, 0.2), (1600, 0.3)]
    assert (d.dims, d.shape) == (("body.m", "body.c_d"), (3, 2))


@pytest.mark.parametrize(
    "given",
    ["50..100 kW:3", "50 kW .. 100 kW : 3", "50000..1e5:3", "50, 75, 100 kW", "50 kW, 75000 W, 100 kW", [50e3, 75e3, 100e3],
     ["50 kW", "75 kW", 1e5], np.linspace(50e3, 100e3, 3)],
)  # fmt: skip
def test_values_are_si_or_have_units(given):
    (axis,) = design({"motor.P_max": given}).axes
    assert axis.values == (50e3, 75e3, 100e3)
    assert axis.unit == "W"


def test_ends_may_be_negative_or_have_a_point_next_to_the_range():
    (axis,) = design({"body.c_d": "0.2...4:3"}).axes
    assert axis.values == (0.2, 0.3, 0.4)


def test_a_sample_takes_any_number_of_a_range_and_each_of_a_list_as_often():
    d = design({"body.m": "1000..1600", "motor": "ac-75kw,ac-83kw"}, Sample.read("lhs:8"))
    mass, motor = zip(*d.points, strict=True)
    # A Latin hypercube has one point in each eighth of every axis.
    assert sorted((np.array(mass) - 1000) // 75) == list(range(8))
    assert sorted(motor) == ["ac-75kw"] * 4 + ["ac-83kw"] * 4
    assert (d.dims, d.shape) == (("point",), (8,))


def test_a_seed_draws_the_same_points_and_another_one_others():
    one, same, other = (Sample.read("sobol:8", seed).shares(2) for seed in (1, 1, 2))
    assert np.array_equal(one, same)
    assert not np.array_equal(one, other)


def test_the_points_of_saltelli_are_two_matrices_and_their_mixtures():
    rows = Sample.read("saltelli:4").shares(3).reshape(5, 4, 3)
    a, b, *mixed = rows
    for i, m in enumerate(mixed):
        assert np.array_equal(m[:, i], b[:, i])
        others = [j for j in range(3) if j != i]
        assert np.array_equal(m[:, others], a[:, others])


def test_shares_of_an_axis_reach_all_of_its_values():
    axis = Axis("motor", "", "", ("a", "b", "c"))
    assert [axis.at(u) for u in (0.0, 0.33, 0.34, 0.67, 0.999999)] == ["a", "a", "b", "c", "c"]


def test_a_sweep_finds_what_single_runs_find():
    found = sweep(CAR, {"body.m": [1000, 1400], "motor": ["ac-75kw", "ac-83kw"]}, Drive(SHORT))
    for m in (1000, 1400):
        for motor in ("ac-75kw", "ac-83kw"):
            alone = Drive(SHORT)(CAR.with_parts({"motor": motor}).with_values({"body.m": m})).figures
            there = found.sel({"body.m": m, "motor": motor})
            assert float(there["energy_from_battery_J"]) == alone["energy_from_battery_J"]
            assert float(there["soc_end"]) == alone["soc_end"]
    assert found["energy_Wh_per_km"].attrs == {"units": "Wh/km", "long_name": "energy"}
    assert found["body.m"].attrs == {"units": "kg", "long_name": "test mass"}
    # The car burns nothing.
    assert "fuel_L" not in found


def test_many_plain_runs_are_made_in_batches_and_find_the_same(monkeypatch, tmp_path):
    frame = {"body.h": [0.5, 1.32, 0.6], "body.wheelbase": [2.7, 2.6]}
    axes = {**frame, "motor": "ac-75kw,ac-83kw", "motor.P_max": ["60 kW", "80 kW"]}
    tasks = [Drive(SHORT), Drive(Cycle(name="rest", time=[0, 9], speed=[0, 0]), "refined")]
    alone = sweep(CAR, axes, tasks, workers=1)
    module = sys.modules["halfshaft.studies.sweep"]
    monkeypatch.setattr(module, "BATCHED", 24)
    monkeypatch.setattr(module, "BATCH", 7)
    together = sweep(CAR, axes, tasks, folder=tmp_path)
    about_the_method = {f"{task.name}.{name}" for task in tasks for name in ("balance_relative", "speed_mismatch_relative")}
    assert set(alone) - set(together) == about_the_method
    assert alone[[*together]].drop_vars("notes").equals(together.drop_vars("notes"))
    assert (together["notes"] == "").all()
    # A centre of gravity above half of the wheelbase: 4 of 24 points.
    assert (together["failure"] != "").sum() == 4
    assert "h = 1.32 m must be below half of wheelbase = 2.6 m" in str(together["failure"].values[1, 1, 0, 0])
    # In portions of another size they are the same.
    monkeypatch.setattr(module, "BATCH", 24)
    assert sweep(CAR, axes, tasks).equals(together)
    assert sweep(CAR, axes, tasks, folder=tmp_path).equals(together)


def test_a_run_of_a_batch_that_loses_a_number_is_a_failing_point(monkeypatch):
    def losing(*args, **kwargs):
        found = batch.run_batch.__wrapped__(*args, **kwargs)
        lost = found["body.m"] == 1200
        return found.where(~lost).assign(status=lost.astype(int), lost_by=found["lost_by"].where(~lost, 3.0))

    losing.__wrapped__ = batch.run_batch
    monkeypatch.setattr(batch, "run_batch", losing)
    monkeypatch.setattr(sys.modules["halfshaft.studies.sweep"], "BATCHED", 2)
    found = sweep(CAR, {"body.m": [1000, 1200, 1400]}, Drive(SHORT))
    assert found["failure"].values.tolist() == ["", "Small battery electric car: by t = 3 s a result is not a number; check the inputs", ""]
    assert found["soc_end"].isnull().values.tolist() == [False, True, False]


def test_several_vehicles_are_an_axis():
    cars = [CAR, Vehicle.load("small-car-conventional")]
    found = sweep(cars, {"body.m": [1000, 1400]}, Drive(SHORT), responses=["fuel_L", "distance_m"])
    assert found["fuel_L"].dims == ("vehicle", "body.m")
    assert found["vehicle"].values.tolist() == [car.name for car in cars]
    assert found["fuel_L"].isnull().values.tolist() == [[True, True], [False, False]]
    assert (
        float(found["fuel_L"].sel({"vehicle": cars[1].name, "body.m": 1400}))
        == Drive(SHORT)(cars[1].with_values({"body.m": 1400})).figures["fuel_L"]
    )


def test_a_failing_point_is_recorded_and_the_others_go_on():
    found = sweep(CAR, {"body.m": "1000..1600:4"}, [Weigh(1300.0), Weigh(name="free")])
    assert found["weigh.mass_kg"].isnull().values.tolist() == [False, False, True, True]
    assert found["free.mass_kg"].values.tolist() == [1000, 1200, 1400, 1600]
    assert found["failure"].values.tolist() == ["", "", *["weigh: ZeroDivisionError: too heavy"] * 2]
    assert found["notes"].values[0] == "weigh: weighs 1000 kg\nfree: weighs 1000 kg"


def test_a_vehicle_that_cannot_be_is_a_failing_point():
    found = sweep(Vehicle.load("small-car-series"), {"control.soc_low": [0.3, 0.5], "control.soc_high": [0.4, 0.6]}, Weigh())
    assert found["mass_kg"].isnull().values.tolist() == [[False, False], [True, False]]
    assert "soc_low = 0.5" in str(found["failure"].values[1, 0])


@pytest.mark.parametrize("name", vehicle_names())
def test_a_vehicle_that_was_looked_at_can_be_sent_to_another_process(name):
    car = Vehicle.load(name)
    assert car.rated is not None
    assert car.tags
    assert car.notes is not None
    assert car.structure
    sent = pickle.loads(pickle.dumps(car))
    assert sent.structure == car.structure
    assert sent.to_toml() == car.to_toml()
    assert sent.with_values({"body.m": 1000}).values == car.with_values({"body.m": 1000}).values


def test_a_task_that_cannot_be_sent_is_refused_by_other_processes():
    @dataclass(frozen=True)
    class Local(Weigh):
        pass

    with pytest.raises(InputError, match="cannot be sent to other processes, only workers=1"):
        sweep(CAR, {"body.m": "1000..1600:4"}, Local(), workers=2)


def test_progress_counts_every_point_once():
    told = []
    sweep(CAR, {"body.m": "1000..1600:4"}, Weigh(), progress=lambda done, total: told.append((done, total)))
    assert told == [(0, 4), (1, 4), (2, 4), (3, 4), (4, 4)]


def test_a_table_has_a_row_for_each_point():
    grid = table(sweep(CAR, {"body.m": [1000, 1400], "body.c_d": [0.2, 0.3]}, Weigh()))
    assert (grid["body.m"], grid["body.c_d"]) == ([1000, 1000, 1400, 1400], [0.2, 0.3, 0.2, 0.3])
    assert grid["mass_kg"] == grid["body.m"]
    drawn = table(sweep(CAR, {"body.m": "1000..1400"}, Weigh(), sample="lhs:3"))
    assert drawn["mass_kg"] == drawn["body.m"]
    assert "point" not in drawn


def test_all_that_is_wrong_is_said_at_once():
    axes = {
        "body.mass": "1..2:2", "motor.P_max": "50..100 kW", "motor.torque_scale": [1, 1], "engine": "x,y", "battery": "pb-25ah",
        "body.c_d": "0.3..0.2:4", "body.A": "-1..2:4", "body.rho": [], "wheel.r": ["0.3 kg", 0.2], "motor": "ac-75kw,si-41kw",
        "wheel.J": "1..2:1",
    }  # fmt: skip
    said = "\n".join(problems(CAR, axes, Weigh()))
    for part in (
        "axis body.mass is not known, did you mean 'body.m'?",
        'axis motor.P_max = "50..100 kW" has no number of values',
        "axis motor.torque_scale has 1 2 times",
        "axis engine: vehicle 'small-car-electric' has no such role",
        "axis battery has one value",
        'axis body.c_d = "0.3..0.2:4", the first end must be below the second',
        "axis body.A = -1, must be >= 0 m^2",
        "axis body.rho has no value",
        'axis wheel.r = "0.3 kg", must be a length such as m',
        'axis motor = "si-41kw" is of kind engine, must be motor',
        'axis wheel.J = "1..2:1" has the number of values 1, must have at least two',
        "axes motor.P_max and motor.torque_scale both say how large it is",
    ):
        assert part in said


def test_a_range_with_a_number_of_values_does_not_go_with_a_sample():
    assert problems(CAR, {"body.m": "1000..1200:4"}, Weigh(), sample="lhs:4") == [
        'axis body.m = "1000..1200:4", a sample takes any value between the ends: leave out :4'
    ]


@pytest.mark.parametrize(
    ("sample", "said"),
    [
        ("sobl:8", "did you mean 'sobol'?"),
        ("sobol", "no points"),
        ("sobol:x", '"x" points'),
        ("saltelli:12", "8 or 16"),
        ("lhs:1", "at least 2"),
    ],
)
def test_a_sample_that_there_is_not_is_refused(sample, said):
    (problem,) = problems(CAR, {"body.m": "1000..1200"}, Weigh(), sample=sample)
    assert said in problem


def test_what_is_no_vehicle_or_task_is_refused():
    assert problems("small-car", {"body.m": [1000, 1200]}, Weigh())[0].startswith("vehicle must be a Vehicle")
    assert problems(CAR, {}, [])[:2] == [
        "has no task, must have at least one, such as Drive(cycle)",
        "has no axis, must have at least one, such as body.m=1000..1600:4",
    ]
    assert "frozen dataclass" in problems(CAR, {"body.m": [1000, 1200]}, lambda car: car)[0]
    assert problems(CAR, {"body.m": [1000, 1200]}, [Weigh(), Weigh(1.0)]) == ["has 2 tasks called 'weigh'"]
    assert problems([CAR, CAR], {"body.m": [1000, 1200]}, Weigh()) == ["vehicle 'small-car-electric' is given 2 times"]


def test_what_is_no_list_and_what_is_too_much_is_refused():
    axes = {"body.m": 1000, "motor": None, "body.c_d": "0.2..0.3:100001", "body.A": [1, None]}
    assert problems(CAR, axes, Weigh()) == [
        "axis motor has one value, must have at least two",
        "axis body.m = 1000, must be a list or a range such as 1000..1600:4",
        'axis body.c_d = "0.2..0.3:100001" has 100001 values, must have at most 100000',
        'axis body.A = None, must be a number and a unit in quotes such as "1 m^2"',
    ]
    assert problems(CAR, {name: "1..2:5000" for name in ("wheel.J", "body.A")}, Weigh()) == [
        "has 25000000 points, must have at most 10000000; draw a sample"
    ]
    assert problems(CAR, {"wheel.J": "1..2"}, Weigh(), sample="saltelli:4194304") == [
        "has 12582912 points, must have at most 10000000; draw a sample"
    ]


def test_one_response_may_be_a_text():
    assert list(sweep(CAR, {"body.m": [1000, 1200]}, Weigh(), responses="drag").data_vars) == ["drag", "failure", "notes"]


def test_what_is_no_whole_number_is_refused():
    assert problems(CAR, {"body.m": "1000..1200"}, Weigh(), sample="lhs:4", seed=0.5, workers=2.5) == [
        "sample lhs:4 has seed 0.5, must be a whole number >= 0",
        "workers = 2.5, must be a whole number from 1 to 1000",
    ]


def test_options_of_a_test_that_cannot_be_are_refused_before_it_runs():
    task = AccelerationTest(pairs=((60, 40),))
    assert problems(CAR, {"body.m": [1000, 1200]}, task) == [f"acceleration: {problem}" for problem in task.problems()]
    assert "frozen dataclass" in problems(CAR, {"body.m": [1000, 1200]}, Weigh)[0]


def test_points_that_fail_do_not_hide_a_response_that_there_is_not():
    car, axes = Vehicle.load("small-car-series"), {"control.soc_low": [0.5, 0.3], "control.soc_high": [0.4, 0.6]}
    assert problems(car, axes, Weigh(), responses=["mass"]) == ["response mass is not known, did you mean 'mass_kg'?"]
    found = sweep(CAR, {"body.m": [1000, 1200]}, Weigh(fails_above=900.0), responses=["mass_kg"])
    assert found["mass_kg"].isnull().all()


def test_a_response_that_there_is_not_is_refused_before_the_sweep_runs():
    told = []
    said = problems(CAR, {"body.m": "1000..1600:50"}, Weigh(), responses=["mas_kg", "fuel_L"], progress=lambda *n: told.append(n))
    assert said == [
        "response mas_kg is not known, did you mean 'mass_kg'?",
        "response fuel_L: small-car-electric (electric) has none at all 2 points that were tried",
    ]
    assert told == [(0, 50), (1, 50), (2, 50)]


@pytest.mark.parametrize(
    ("figure", "unit", "title"),
    [("fuel_economy_L_per_100km", "L/100 km", "fuel economy"), ("udds.grade_percent", "%", "udds: grade"), ("soc_end", "1", "soc end"),
     ("distance_m", "m", "distance")],
)  # fmt: skip
def test_a_figure_is_named_and_has_the_unit_that_its_name_ends_with(figure, unit, title):
    assert (unit_of(figure), title_of(figure)) == (unit, title)


def test_axes_of_the_command_line_are_read_or_named():
    said = []
    assert read_axes(["body.m = 1..2:3", "motor=a,b", "body.m=1", "x", "=3"], said.append) == {"body.m": "1..2:3", "motor": "a,b"}
    assert len(said) == 3
