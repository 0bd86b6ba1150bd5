"""Road load: from coast-downs and published coefficients to vehicles."""

import json

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from typer.testing import CliRunner

from halfshaft import Cycle, InputError, Vehicle, run
from halfshaft.app.cli import app
from halfshaft.studies.calibration.coast_down import CoastDown, coast_down
from halfshaft.studies.calibration.road_load import RoadLoad, load_of
from halfshaft.studies.calibration.roll_out import rolled

LOAD, M, TURNING = (140.0, 1.5, 0.42), 1500.0, 45.0
CAR = Vehicle.load("small-car-electric")


def rolling_out(load=LOAD, direction=1, wind=0.0, grade=0.0, noise=0.03, seed=0, n=200):
    """Return a coast-down by SciPy's integrator, with noise."""
    A, B, C = load
    M_e, time = M + TURNING, np.linspace(0, 100, n)

    def slowing(_, v):
        return -(A + B * v + C * (v + direction * wind) ** 2 + direction * M * 9.81 * grade) / M_e

    v = solve_ivp(slowing, (0, time[-1]), [33.0], t_eval=time, rtol=1e-10, atol=1e-10).y[0]
    v = v + noise * np.random.default_rng(seed).normal(size=n)
    return CoastDown(name="there" if direction > 0 else "back", time=time, speed=v, direction=direction)


@pytest.mark.parametrize("load", [LOAD, (150, 0, 0), (150, 4, 0), (10, 40, 0.1), (150, 2 * np.sqrt(150 * 0.4), 0.4), (0, 3, 0.4)])
def test_rolling_out_in_closed_form_is_what_an_integrator_finds(load):
    A, B, C = load
    time = np.linspace(0, 100, 40)
    v, slopes = rolled(time, 33.0, load, M)
    reference = solve_ivp(lambda _, v: -(A + B * v + C * v**2) / M, (0, 100), [33.0], t_eval=time, rtol=1e-11, atol=1e-11).y[0]
    np.testing.assert_allclose(v, reference, atol=1e-8)
    x = np.array([*load, 33.0], dtype=float)
    for i, h in enumerate((1e-2, 1e-3, 1e-5, 1e-4)):
        up, down = (rolled(time, y[3], y[:3], M)[0] for y in (x + h * np.eye(4)[i], x - h * np.eye(4)[i]))
        np.testing.assert_allclose(slopes[:, i], (up - down) / (2 * h), rtol=1e-6, atol=1e-7 * np.abs(slopes[:, i]).max())


def test_a_coast_down_without_noise_gives_its_load():
    found = coast_down(rolling_out(noise=0), M, rotating=TURNING)
    assert found.load.coefficients == pytest.approx(LOAD, rel=1e-5)
    assert found.rms < 1e-6
    assert found.notes == ("all runs went the same way: wind and slope of the road, if there were any, are in the coefficients",)


def test_runs_both_ways_tell_wind_and_slope_apart_from_the_load():
    wind, grade = 3.0, 0.004
    runs = [rolling_out(direction=d, wind=wind, grade=grade, seed=d + 1) for d in (1, -1)]
    found = coast_down(runs, f"{M} kg", rotating="3 %")
    assert np.all(np.abs(np.array(found.load.coefficients) - LOAD) < 4 * found.load.std)
    assert (found.wind, found.grade) == pytest.approx((wind, grade), rel=0.1)
    alone = coast_down(runs[0], M, rotating="45 kg")
    # A head wind of 3 m/s and the slope, at 20 m/s.
    assert alone.load.force(20.0) - found.load.force(20.0) == pytest.approx(0.42 * (23**2 - 20**2) + M * 9.81 * grade, rel=0.05)
    assert found.notes == ()


def test_the_interval_of_the_force_holds_the_truth():
    speeds = np.linspace(10, 30, 5)
    inside = [
        np.abs(found.load.force(speeds) - RoadLoad(A=LOAD[0], B=LOAD[1], C=LOAD[2], m=M).force(speeds)) <= found.load.half_width(speeds)
        for found in (coast_down(rolling_out(noise=0.05, seed=seed, n=60), M, rotating=TURNING) for seed in range(15))
    ]
    assert 0.8 <= np.mean(inside) <= 1.0


def test_outliers_and_a_load_without_a_linear_part():
    clean = rolling_out((150.0, 0.0, 0.45))
    speed = clean.speed.copy()
    speed[::15] += 2.0
    found = coast_down(CoastDown(name="dirty", time=clean.time, speed=speed), M, rotating=TURNING, loss="soft_l1", linear=False)
    assert found.load.coefficients == pytest.approx((150.0, 0.0, 0.45), rel=0.02)


def test_pounds_are_converted_by_their_definitions():
    load = RoadLoad.of_pounds(30.0, 0.2, 0.018, 3500)
    assert load.m == pytest.approx(1587.57, abs=0.01)
    # At 50 mph: 30 + 10 + 45 lbf.
    assert load.force(50 * 0.44704) == pytest.approx(85 * 4.4482216, rel=1e-7)
    assert load.pounds == pytest.approx((30.0, 0.2, 0.018))


@pytest.mark.parametrize("name", ["small-car-electric", "small-car-conventional", "paper-series-1459"])
@pytest.mark.parametrize("how", ["exactly", "by shape"])
def test_a_vehicle_at_steady_speeds_needs_the_load(name, how):
    """Driven over a cycle of steady speeds, force at the road and drag of the bearings are the load."""
    load, car = RoadLoad.of_pounds(30.0, 0.2, 0.018, 3500), Vehicle.load(name)
    changed = load.exactly(car) if how == "exactly" else load.by_shape(car).vehicle
    assert changed.mass == car.mass
    assert changed.source.endswith("road load: target coefficients")
    tested = changed.with_values({"body.m": load.m})
    cycle = Cycle(name="steady", time=np.array([0.0, 30, 60, 65, 95]), speed=np.array([0.0, 12, 12, 15, 15]))
    result = run(tested, cycle)
    for t, v in ((55, 12.0), (90, 15.0)):
        needed = result["body.F_required"][t] + result["wheel.P_bearing"][t] / v
        # Where tyres slip, bearings turn a little faster than the road.
        assert needed == pytest.approx(load.force(v), rel=1e-3)
        assert load_of(tested, np.array([v]))[0] == pytest.approx(load.force(v), rel=1e-9)


def test_rules_and_numbers_of_the_body_stay_and_the_vehicle_can_be_saved(tmp_path):
    load = RoadLoad.of_pounds(30.0, 0.2, 0.018, 3500)
    tall = CAR.with_values({"body.h": 0.7, "battery.n_modules": 30})
    changed = Vehicle.load(load.exactly(tall).save(tmp_path / "mine.toml"))
    assert (changed.values["body.h"], changed.mass) == (0.7, tall.mass)
    assert changed.with_values({"battery.n_modules": 31}).mass > tall.mass
    assert load.exactly(changed).values == changed.values
    heavy = load.exactly(CAR.with_values({"body.m": 1300}))
    assert heavy.mass == 1300


def test_a_shape_that_cannot_have_the_load_states_its_misfit():
    load = RoadLoad.of_pounds(30.0, -0.1, 0.02, 3500)
    found = load.by_shape(CAR)
    assert found.values["wheel.f_1"] == 0
    assert 1 < found.rms < abs(found.worst[0]) < 20
    vehicle_force = load_of(found.vehicle.with_values({"body.m": load.m}), found.v)
    np.testing.assert_allclose(vehicle_force - load.force(found.v), found.misfit, atol=1e-8)
    # Nothing else within the bounds is better.
    for name, x in found.values.items():
        for factor in (0.99, 1.01):
            other = found.vehicle.with_values({"body.m": load.m, name: factor * x})
            assert np.linalg.norm(load_of(other, found.v) - load.force(found.v)) >= np.linalg.norm(found.misfit) * (1 - 1e-9)
    only = load.by_shape(CAR, ["body.c_d"], (20, 30))
    assert list(only.values) == ["body.c_d"]


def test_all_that_is_wrong_is_named_at_once(tmp_path):
    with pytest.raises(InputError) as error:
        CoastDown(name="x", time=[0, 1, np.nan], speed=["a"], direction=2)
    assert error.value.problems == ("time is no finite number in row 3", "speed must be a row of numbers", "direction = 2, must be 1 or -1")
    with pytest.raises(InputError) as error:
        coast_down(rolling_out(), "5 km", rotating="200 %", between=(30, 10), sigma=0)
    assert [p.split(",")[0].split(" = ")[0] for p in error.value.problems] == ["m", "between", "sigma"]
    with pytest.raises(InputError, match=r"there: 1 rows between 200 and 300 m/s"):
        coast_down(rolling_out(), M, between=(200, 300))
    speeding = CoastDown(name="up", time=np.arange(9.0), speed=np.arange(9.0) + 10)
    with pytest.raises(InputError, match="up: 1 rows"):
        coast_down(speeding, M)
    with pytest.raises(InputError, match="A = nan, must be a finite number\n  m = 3 kg"):
        RoadLoad(A=np.nan, B=0, C=0, m=3)
    with pytest.raises(InputError, match="not above 0 N"):
        RoadLoad(A=10, B=-10, C=0, m=1000)
    load = RoadLoad.of_pounds(30.0, 0.2, 0.018, 3500)
    with pytest.raises(InputError, match=r"body.cd is not known, did you mean 'body.c_d'"):
        load.by_shape(CAR, ["body.cd"])
    with pytest.raises(InputError, match="set them exactly"):
        load.by_shape(load.exactly(CAR))
    with pytest.raises(InputError, match="F_1"):
        RoadLoad(A=100, B=1e5, C=0, m=1000).exactly(CAR)


def test_command(tmp_path):
    for d in (1, -1):
        r = rolling_out(direction=d, wind=2.0)
        lines = [f"{t:.2f},{3.6 * v:.4f},dry" for t, v in zip(r.time, r.speed, strict=True)]
        (tmp_path / f"{r.name}.csv").write_text("\n".join(["time_s,speed [km/h],road surface", *lines]), encoding="utf-8")
    there, back, out, plot = (str(tmp_path / name) for name in ("there.csv", "back.csv", "mine.toml", "load.png"))
    done = CliRunner().invoke(app, ["road-load", there, "--back", back, "--mass", "1500", "--json", "--plot", plot])
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert (found["A_N"], found["wind_mps"]) == (pytest.approx(140, rel=0.1), pytest.approx(2.0, rel=0.1))
    assert (tmp_path / "load.png").stat().st_size > 10_000
    given = ["--target", "30.1 0.21 0.0185", "--weight", "3500", "--vehicle", "small-car-electric"]
    done = CliRunner().invoke(app, ["road-load", *given, "--shape", "--fit", "body.c_d", "--fit", "wheel.f_0", "--out", out])
    assert done.exit_code == 0, done.output
    assert "misfit" in done.stdout
    assert 0.3 < Vehicle.load(out).values["body.c_d"] < 0.5
    done = CliRunner().invoke(app, ["road-load", there, "--target", "1 2", "--shape", "--sigma", "3 kg", "--between", "x"])
    assert done.exit_code == 2
    for told in ("one of both", "--weight is missing", "three numbers", "--shape goes with --vehicle", "--sigma", "--between x"):
        assert told in done.stderr
