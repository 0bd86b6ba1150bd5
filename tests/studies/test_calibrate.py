"""Calibration: numbers of vehicles from series that were measured, or made with noise of known numbers."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from halfshaft import Cycle, InputError, Vehicle, run
from halfshaft.app.cli import app
from halfshaft.studies.calibration.calibrate import calibrate
from halfshaft.studies.calibration.problem import Problem
from halfshaft.studies.calibration.record import Reading, Record, Series

DRIVE = Cycle.load("udds").between(0, 330)
TRUTH = {"body.c_d": 0.29, "wheel.f_0": 0.0115}
RANGES = {"body.c_d": "0.2..0.5", "wheel.f_0": "0.004..0.02"}
#: What is measured of each car, and its noise.
CARS = {
    "small-car-electric": {"battery.P_out": 300.0, "battery.soc": 1e-3},
    "small-car-conventional": {"engine.fuel_flow": 3e-5, "engine.fuel_used": 1e-4},
    "small-car-parallel": {"battery.soc": 1e-3, "engine.fuel_flow": 3e-5},
}
ELECTRIC = Vehicle.load("small-car-electric")


@pytest.fixture(scope="module")
def runs():
    """Return runs of the true cars."""
    return {name: run(Vehicle.load(name).with_values(TRUTH), DRIVE) for name in CARS}


def measured(result, noises, seed=0, sigma=True, **more):
    """Return a record of a run, with noise."""
    draw = np.random.default_rng(seed)
    series = tuple(
        Series(
            output=name, time=result.time, values=result[name] + noise * draw.normal(size=len(result.time)),
            reading=Reading(sigma=noise if sigma and noise else None),
        )
        for name, noise in noises.items()
    )  # fmt: skip
    return Record(name="drive", cycle=DRIVE, series=series, **more)


@pytest.mark.parametrize("name", CARS)
def test_known_numbers_are_recovered(name, runs):
    car = Vehicle.load(name)
    clean = calibrate(car, measured(runs[name], dict.fromkeys(CARS[name], 0.0)), RANGES)
    # A jump of a gear or an engine leaves the rest of a drive exact.
    assert clean.values == pytest.approx(TRUTH, rel=1e-4)
    found = calibrate(car, measured(runs[name], CARS[name]), RANGES)
    for i, (number, truth) in enumerate(TRUTH.items()):
        assert abs(found.values[number] - truth) < 3.5 * found.fit.std[i]
    assert found.vehicle.values["body.c_d"] == found.values["body.c_d"]
    assert found.vehicle.source.endswith("body.c_d, wheel.f_0 fitted to drive")
    assert [m.after == pytest.approx(noise, rel=0.15) for m, noise in zip(found.matched, CARS[name].values(), strict=True)]
    assert found.notes == ()


def test_the_interval_is_that_of_differences_of_runs(runs):
    """Standard uncertainties by central differences of plain runs, and the normal equations."""
    noises = CARS["small-car-electric"]
    found = calibrate(ELECTRIC, measured(runs["small-car-electric"], noises), RANGES)
    columns = []
    for name, x in found.values.items():
        up, down = (run(found.vehicle.with_values({name: x + h}), DRIVE) for h in (1e-5 * x, -1e-5 * x))
        columns.append(
            np.concatenate([((up[n] - down[n]) / (2e-5 * x) / noise)[1 if n.endswith("out") else 0 :] for n, noise in noises.items()])
        )
    J = np.column_stack(columns)
    np.testing.assert_allclose(found.fit.std, np.sqrt(np.diag(np.linalg.inv(J.T @ J))), rtol=1e-4)


def test_a_series_is_the_same_in_other_units_counted_or_as_a_rate(runs):
    """Without noise, whatever form a measurement has tells the same numbers."""
    result = runs["small-car-electric"]
    time, power, soc = result.time, result["battery.P_out"], result["battery.soc"]
    ends = np.append(0.0, time)
    energy = 7.0 + np.append(0.0, np.cumsum(power)) / 3.6e6
    coarse = slice(0, None, 10)
    forms = {
        "mean": Series(output="battery.P_out", time=time, values=power / 1e3, unit="kW"),
        "counter": Series(output="battery.P_out", time=ends[coarse], values=energy[coarse], unit="kWh"),
        "mean of ten": Series(
            output="battery.P_out", time=ends[coarse], values=np.append(0, power[:330].reshape(-1, 10).mean(axis=1)), unit="W"
        ),
        "instant": Series(output="battery.P_out", time=time - 0.5, values=power, reading=Reading(how="instant")),
        "late": Series(output="battery.P_out", time=time[:-3] + 3.0, values=power[:-3], reading=Reading(offset=-3.0)),
        "finer": Series(output="battery.P_out", time=np.arange(1, 1321) / 4, values=np.repeat(power, 4)),
        "state": Series(output="battery.soc", time=time, values=100 * soc, unit="%"),
        "between": Series(output="battery.soc", time=time[:-1] + 0.5, values=(soc[1:] + soc[:-1]) / 2),
        "drawn": Series(output="battery.soc", time=time, values=soc + 0.1, reading=Reading(how="counted")),
        "rate": Series(output="battery.soc", time=time, values=np.append(0, np.diff(soc)) * 3600, unit="1/h"),
    }
    # Of each a drive has two, so that one code serves all.
    power_forms, charge_forms = ([s for s in forms.values() if s.output == output] for output in ("battery.P_out", "battery.soc"))
    for k in range(max(len(power_forms), len(charge_forms))):
        pair = power_forms[k % len(power_forms)], charge_forms[k % len(charge_forms)]
        found = calibrate(ELECTRIC, Record(name="drive", cycle=DRIVE, series=pair), RANGES, starts=1)
        assert found.values == pytest.approx(TRUTH, rel=1e-6), pair
        assert [m.after < 1e-6 * np.abs(p.values).max() for m, p in zip(found.matched, found.predicted[0], strict=True)] == [True, True], (
            pair
        )


def test_fuel_may_be_measured_in_litres(runs):
    result = runs["small-car-conventional"]
    density = result.inputs.parameters[result.tags.the("fuel density")]
    rows = {
        "fuel_flow": ("L/h", 3.6e6 / density * result["engine.fuel_flow"]),
        "fuel_used": ("L", 1e3 / density * result["engine.fuel_used"]),
    }
    series = tuple(Series(output=f"engine.{name}", time=result.time, values=x, unit=unit) for name, (unit, x) in rows.items())
    found = calibrate(Vehicle.load("small-car-conventional"), Record(name="drive", cycle=DRIVE, series=series), RANGES)
    assert found.values == pytest.approx(TRUTH, rel=1e-4)


def test_drives_share_what_is_fitted_and_have_numbers_of_their_own(runs):
    noises = {"battery.P_out": 0.0, "battery.soc": 0.0}
    light = measured(runs["small-car-electric"], noises)
    loaded = {"body.m": "1400 kg", "battery.soc_start": 0.8}
    heavy = measured(run(ELECTRIC.with_values({**TRUTH, **loaded}), DRIVE), noises, values=loaded)
    found = calibrate(ELECTRIC, [light, heavy], RANGES)
    assert found.values == pytest.approx(TRUTH, rel=1e-6)
    assert len(found.matched) == 4
    assert found.vehicle.mass == ELECTRIC.mass


def test_numbers_that_only_their_product_tells_are_named(runs):
    record = measured(runs["small-car-electric"], CARS["small-car-electric"])
    found = calibrate(ELECTRIC, record, {**RANGES, "body.A": "1.5..3 m^2", "body.v_miss": None}, starts=1)
    dead, pair = found.notes
    assert dead == "body.v_miss changes nothing that was measured"
    assert pair.startswith(("body.A and body.c_d cannot", "body.c_d and body.A cannot"))
    assert "by 1 % makes up for 1 % more of" in pair
    assert [row[3] == "not told" for row in found.rows()] == [True, False, True, True]
    # Mass and rolling resistance come as a product too, but a heavier car also takes more to accelerate.
    told = calibrate(ELECTRIC, record, {"body.m": "900..1400 kg", "wheel.f_0": "0.004..0.02"})
    assert not [note for note in told.notes if "told apart" in note]


def test_all_that_is_wrong_is_named_at_once(runs):
    result = runs["small-car-electric"]
    with pytest.raises(InputError) as error:
        Series(output="battery.P_out", time=[0, 2, 1], values=[1, np.nan, np.inf], reading=Reading(how="often", offset=np.nan))
    assert error.value.problems == (
        "values is no finite number in row 2, 3",
        "how = 'often', must be one of instant, mean, counted",
        "offset = nan s, must be a finite number",
    )
    time, power = result.time, result["battery.P_out"]
    rows = [
        ("battery.Pout", "W", Reading()), ("battery.U", "kWh", Reading()), ("battery.soc", "%", Reading(how="mean")),
        ("battery.P_out", "kW", Reading(sigma="2 %")), ("battery.I", "A", Reading(sigma="3 kg")),
        ("motor.P_in", "kW", Reading(how="counted")),
        ("battery.battery_limited", "", Reading()), ("battery.P_stored", "W/s", Reading()),
    ]  # fmt: skip
    series = [Series(output=n, time=time, values=0 * power, unit=unit, reading=reading) for n, unit, reading in rows]
    series.append(Series(output="body.v", time=time + 1e4, values=power))
    record = Record(name="bad", cycle=DRIVE, series=tuple(series), values={"body.c_d": 0.3, "body.mm": 3})
    wanted = {"body.cd": None, "body.c_d": "0.4..0.3", "wheel.f_0": "0.02..0.03", "motor.P_max": None, "body.m": "1 V..2 V", "body.A": "2"}
    with pytest.raises(InputError) as error:
        calibrate(ELECTRIC, record, wanted, loss="square", starts=0, mode="hybird", dt=-1)
    told = "\n".join(error.value.problems)
    for part in (
        "mode = 'hybird', must be one of hybrid, refined, iteration, did you mean 'hybrid'?",
        "dt = -1 s, must be a number > 0 s",
        "loss = 'square', must be one of",
        "starts = 0, must be a whole number from 1 to 100000",
        "body.cd is not known, did you mean 'body.c_d'?",
        'body.c_d = "0.4..0.3", the first end must be below the second',
        "wheel.f_0 = 0.009, where the fit starts, must lie within 0.02 and 0.03",
        "motor.P_max stands for motor.torque_scale: fit that",
        "body.m = \"1 V\", must be a mass such as kg",
        'body.A = "2", must be a range such as 0.2..0.5',
        "record bad: battery.Pout is no output of vehicle 'small-car-electric', did you mean 'battery.P_out'?",
    ):  # fmt: skip
        assert part in told, told
    fitting = Record(name="bad", cycle=DRIVE, series=tuple(series[1:]), values=record.values)
    with pytest.raises(InputError) as error:
        calibrate(ELECTRIC, fitting, RANGES)
    told = "\n".join(error.value.problems)
    for part in (
        "body.c_d is fitted, it cannot be set",
        "body.mm is not known",
        "battery.U has the unit 'kWh', must be one such as V or V.s or V/s",
        "battery.soc is a state: it is read instant, or counted",
        "battery.P_out has the uncertainty '2 %', which is 0 where 0 was read: add a constant part",
        "battery.I has the uncertainty '3 kg', must be > 0, such as '1 A'",
        "motor.P_in is a flow: what is counted of it has its unit times one of time",
        "battery.battery_limited is a flag, whose derivatives are 0: nothing can be fitted to it",
        "battery.P_stored is measured in 'W/s', as its rate, which a run does not tell",
        "body.v has times from 10001 to 10330 s, the drive those from 0 to 330 s",
    ):
        assert f"record bad: {part}" in told, told
    few = Record(name="few", cycle=DRIVE, series=(Series(output="battery.P_out", time=[10, 20], values=[1, 2]),))
    with pytest.raises(InputError, match="1 rows do not tell their own uncertainty"):
        calibrate(ELECTRIC, few, RANGES)


@pytest.fixture
def files(tmp_path, runs, monkeypatch):
    """Write a logger's file and a problem, and work beside them."""
    result, draw = runs["small-car-electric"], np.random.default_rng(1)
    power = (result["battery.P_out"] + 300 * draw.normal(size=len(result.time))) / 1e3
    columns = zip(np.append(0, result.time), DRIVE.speed * 3.6, np.append(0, power), np.append(1, result["battery.soc"]), strict=True)
    lines = [f"{t:g};{v:.6f};{p:.4f};{100 * s:.3f};N 52".replace(".", ",") for t, v, p, s in columns]
    (tmp_path / "drive.csv").write_text("\n".join(["time [s];speed [km/h];HV power [kW];battery.soc [%];place", *lines]), encoding="utf-8")
    (tmp_path / "ev.toml").write_text(
        """schema = 1
kind = "calibration"
name = "ev"
title = "A test"
vehicle = "small-car-electric"
loss = "huber"
[fit]
"body.c_d" = "0.2..0.5"
"wheel.f_0" = "0.004..0.02"
[[drives]]
file = "drive.csv"
[drives.series."battery.P_out"]
column = "HV power [kW]"
sigma = "0.3 kW"
[drives.series."battery.soc"]
sigma = "0.05 %"
""",
        encoding="utf-8",
    )
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_command_and_problem_say_the_same(files):
    given = ["calibrate", "small-car-electric", "drive.csv", "--fit", "body.c_d=0.2..0.5", "--fit", "wheel.f_0=0.004..0.02"]
    given += [
        "--series",
        "battery.P_out=HV power [kW]",
        "--sigma",
        "battery.P_out=0.3 kW",
        "--sigma",
        "battery.soc=0.05 %",
        "--loss",
        "huber",
    ]
    done = CliRunner().invoke(app, [*given, "--json", "--plot", "fit.png", "--out", "mine.toml"])
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    found = Problem.load("ev.toml").solve()
    assert {name: x["value"] for name, x in told["found"].items()} == pytest.approx(found.values, rel=1e-12)
    for name, x in told["found"].items():
        assert x["low"] < TRUTH[name] < x["high"]
    assert Vehicle.load("mine.toml").values["wheel.f_0"] == told["found"]["wheel.f_0"]["value"]
    assert (files / "fit.png").stat().st_size > 20_000
    assert "body.c_d" in found._repr_html_()
    assert "correlations" in found._repr_html_()
    done = CliRunner().invoke(app, ["calibrate", "ev.toml"])
    assert done.exit_code == 0, done.output
    assert "correlation of body.c_d and wheel.f_0" in done.stdout


def test_files_that_are_wrong_say_so(files):
    text = (files / "ev.toml").read_text(encoding="utf-8")
    (files / "bad.toml").write_text(
        text.replace('"ev"', '"bad"').replace("HV power", "HV powr").replace("sigma", "sigam").replace("car-electric", "car-elektric")
        + '\n[[drives]]\ncycle = "uds"\n',
        encoding="utf-8",
    )  # fmt: skip
    with pytest.raises(InputError) as error:
        Problem.load("bad.toml")
    told = "\n".join(error.value.problems)
    for part in (
        "did you mean 'small-car-electric'",
        "sigam is not known",
        "no column 'HV powr [kW]', did you mean 'HV power [kW]'?",
        "file is missing",
    ):
        assert part in told, told
    done = CliRunner().invoke(
        app, [*["calibrate", "small-car-electric", "drive.csv", "--fit", "body.c_d=0.2..0.5", "--sigma"], "battery.sok=1 %"]
    )
    assert "has no series battery.sok, did you mean 'battery.soc'?" in done.stderr
    done = CliRunner().invoke(app, ["calibrate", "small-car-electric"])
    assert "name a vehicle and at least one drive" in done.stderr
    done = CliRunner().invoke(app, ["calibrate", "ev.toml", "--fit", "body.c_d=0.2..0.5"])
    assert done.exit_code == 2
    assert "--fit does not go with a problem" in done.stderr
    done = CliRunner().invoke(app, ["calibrate", "small-car-electric", "no.csv", "--fit", "body.c_d", "--offset", "battery.soc=x"])
    assert done.exit_code == 2
    for part in ("no.csv: cannot be read", "--fit body.c_d: must be like", "--offset battery.soc=x: must be a number"):
        assert part in done.stderr
