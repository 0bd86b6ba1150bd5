"""What a run says: fuel with the battery in it, consumption, range, limits, and what it was made of."""

import json
from dataclasses import replace
from functools import cache

import h5py
import numpy as np
import pytest

from halfshaft import Cycle, InputError, Result, Vehicle, run
from halfshaft.cosim import older
from halfshaft.cosim.facts import facts
from halfshaft.cosim.origin import Ratings
from halfshaft.cosim.remarks import remarks

WH = 3600
vehicle_of, cycle_of = cache(Vehicle.load), cache(Cycle.load)
ELECTRIC, SERIES, CONVENTIONAL = "small-car-electric", "small-car-series", "small-car-conventional"


def done(name, cycle="us06", soc=None, **kwargs):
    car = vehicle_of(name)
    return run(car if soc is None else car.with_values({"battery.soc_start": soc}), cycle_of(cycle), **kwargs)


def warning(result, text):
    (found,) = [w for w in result.warnings if text in w]
    return found


# Fuel with the battery in it.


def test_an_unbalanced_fuel_economy_comes_with_its_correction():
    result = done(SERIES, "hwfet")
    s = result.summary
    assert s["fuel_economy_L_per_100km"] == pytest.approx(1.142, abs=5e-4)
    # Turned into fuel by the genset of this run; balanced runs of the same car take 5.70 L/100 km.
    efficiency = result.energies["generator.P_out"] / result.energies["engine.P_fuel"]
    litres = s["fuel_L"] * (1 + s["energy_from_battery_J"] / efficiency / result.energies["engine.P_fuel"])
    assert s["fuel_equivalent_L"] == pytest.approx(litres)
    assert s["fuel_equivalent_efficiency"] == efficiency
    assert s["fuel_equivalent_L_per_100km"] == pytest.approx(5.70, abs=0.03)
    assert s["fuel_equivalent_basis"] == "the run's own mean genset efficiency"
    assert "the battery gave 2.083 kWh" in warning(result, "which the fuel economy leaves out")
    assert "5.68 L/100 km" in warning(result, "which the fuel economy leaves out")


def test_repeated_until_balanced_the_equivalent_hardly_moves():
    """From 0.43 the engine runs nearly all the time; over many cycles the charge is the same at both ends."""
    long = cycle_of("hwfet")
    times = 30
    cycle = Cycle(
        name="long",
        time=np.concatenate([long.time[:-1] + k * long.duration for k in range(times)]),
        speed=np.concatenate([long.speed[:-1]] * times),
    )
    s = run(vehicle_of(SERIES), cycle).summary
    assert abs(s["energy_from_battery_J"]) < 0.02 * 3.2e7 * s["fuel_L"]
    short = done(SERIES, "hwfet").summary
    assert s["fuel_economy_L_per_100km"] == pytest.approx(short["fuel_equivalent_L_per_100km"], rel=0.03)


def test_where_the_engine_never_ran_the_efficiency_is_a_stated_one():
    s = done(SERIES, "udds").summary
    assert s["fuel_L"] == 0
    assert s["fuel_equivalent_basis"] == "a nominal genset efficiency"
    # 0.749 kg/L of 42.6 MJ/kg.
    assert s["fuel_equivalent_L"] == pytest.approx(s["energy_from_battery_J"] / 0.3 / (0.749 * 42.6e6), rel=1e-3)
    assert any("nominal" in w for w in s["warnings"])


def test_a_battery_that_was_charged_takes_fuel_off():
    s = done("small-car-series-follower", "udds").summary
    assert s["energy_from_battery_J"] < 0
    assert s["fuel_equivalent_L"] < s["fuel_L"]
    assert any("the battery took 0.4" in w for w in s["warnings"])


@pytest.mark.parametrize("name", [ELECTRIC, CONVENTIONAL])
def test_without_both_there_is_nothing_to_correct(name):
    result = done(name)
    assert result.summary["fuel_equivalent_L"] is None
    assert not any("leaves out" in w for w in result.warnings)


# What the owner of an electric car asks first.


def test_consumption_range_and_ratings():
    result = done(ELECTRIC, "udds")
    s = result.summary
    assert s["energy_Wh_per_km"] == pytest.approx(result.energies["battery.P_stored"] / WH / (s["distance_m"] / 1000))
    assert s["energy_MPGe"] == pytest.approx(33705 / (s["energy_Wh_per_km"] * 1.609344))
    assert s["motor_power_max_W"] == pytest.approx(137.1e3, abs=50)
    # 25 modules of 26 Ah and 12 V.
    assert s["pack_energy_J"] / 3.6e6 == pytest.approx(7.71, abs=0.01)
    assert s["range_m"] / 1000 == pytest.approx(s["pack_energy_J"] / WH / s["energy_Wh_per_km"])


def test_a_car_that_is_driven_until_it_stops_comes_as_far_as_its_range():
    """At one calm speed, so that neither temperature nor the ends of the pack count for much."""
    steady = Cycle(name="steady", time=np.array([0.0, 20.0, 20000.0]), speed=np.array([0.0, 12.0, 12.0]))
    part = run(vehicle_of(ELECTRIC), Cycle(name="part", time=np.array([0.0, 20.0, 1000.0]), speed=np.array([0.0, 12.0, 12.0])))
    result = run(vehicle_of(ELECTRIC), steady)
    assert result.last["battery.soc"] < 2e-3
    assert part.summary["range_m"] == pytest.approx(result.last["body.distance"], rel=0.05)


def test_a_car_that_gains_energy_downhill_has_no_consumption():
    down = Cycle(name="down", time=np.array([0.0, 60.0]), speed=np.array([15.0, 15.0]), grade=np.array([-0.1, -0.1]))
    s = run(vehicle_of(ELECTRIC).with_values({"battery.soc_start": 0.5}), down).summary
    assert s["energy_from_battery_J"] < 0
    assert s["energy_Wh_per_km"] is s["range_m"] is s["energy_MPGe"] is None


def test_units_that_people_know():
    result = done(ELECTRIC, "udds")
    ours, theirs = dict(facts(result)), dict(facts(result, "us"))
    assert (ours["consumption"].split()[1], theirs["consumption"].split()[1]) == ("Wh/km", "Wh/mi")
    assert theirs["economy"].endswith("MPGe")
    assert theirs["distance"] == "7.450 mi"
    assert "mph" in " ".join(remarks(done(ELECTRIC), "us"))


# Limits: which, when, and what they cost.


def test_a_battery_limit_says_which_when_and_how_much():
    result = done(ELECTRIC)
    acts = result["battery.battery_limited"] > 0
    missing = (result["bus.P_in_required"] - result["bus.P_in"])[acts].sum() / WH
    at = result.time[acts]
    expected = f"lowest voltage: {acts.sum()} s in all, first at t = {at[0]:g} s, last at {at[-1]:g} s; {missing:.1f} Wh not given"
    assert warning(result, "battery limit reached") == f"battery limit reached, {expected}"


def test_a_full_and_an_empty_battery_are_told_apart():
    stop = Cycle(name="stop", time=np.array([0.0, 60.0]), speed=np.array([30.0, 0.0]))
    full = run(vehicle_of(ELECTRIC).with_values({"battery.soc_start": 1.0}), stop)
    assert "Wh not taken" in warning(full, "battery limit reached, full")
    empty = done(ELECTRIC, soc=0.02)
    assert "Wh not given" in warning(empty, "battery limit reached, empty")
    assert warning(empty, "battery empty")


def test_without_history_the_time_in_all_is_told():
    kept, summed = done(ELECTRIC), done(ELECTRIC, history=False)
    seconds = kept["battery.battery_limited"].sum()
    assert warning(summed, "battery limit") == f"battery limit reached: {seconds:.4g} s in all"
    assert warning(summed, "trace missed").startswith("trace missed by up to 3.0 km/h; ")


def test_a_missed_trace_says_how_long_and_how_far():
    result = done(CONVENTIONAL)
    missed = result["body.trace_miss"] > result.inputs.parameters["body.v_miss"]
    text = warning(result, "trace missed")
    assert f"{missed.sum()} s in all" in text
    assert f"{result['body.trace_miss'].sum():.1f} m short" in text


def test_a_grip_limit_says_what_was_not_put_on_the_road():
    result = run(vehicle_of(ELECTRIC).with_values({"wheel.mu_max": 0.2}), cycle_of("us06"))
    assert "Wh not put on the road" in warning(result, "grip limit reached, driving")


def test_a_motor_at_its_top_speed_says_when():
    fast = Cycle(name="fast", time=np.array([0.0, 60.0, 120.0]), speed=np.array([0.0, 60.0, 60.0]))
    assert "in all, first at t = " in warning(run(vehicle_of(ELECTRIC), fast), "motor at its top speed")


@pytest.mark.parametrize("lost", [float("nan"), 1e9])
def test_an_account_that_is_open_or_no_number_warns(lost):
    result = done(ELECTRIC)
    broken = replace(result, energies={**result.energies, "motor.P_loss": lost})
    assert warning(broken, "the energy account is open")


# Runs without history.


def test_without_history_what_needs_it_says_so(tmp_path):
    result = done(ELECTRIC, history=False)
    for ask in (lambda: result.dataset, lambda: result["body.v"], lambda: result.save(tmp_path / "run.nc")):
        with pytest.raises(InputError, match="the run kept no time series: it was made with history=False"):
            ask()
    assert not list(tmp_path.iterdir())
    assert result.summary["distance_m"] == done(ELECTRIC).summary["distance_m"]


def test_duration_counts_from_where_the_cycle_begins():
    late = Cycle(name="late", time=np.array([100.0, 110.0, 130.0]), speed=np.array([0.0, 10.0, 0.0]))
    for dt in (1.0, 7.0, 50.0):
        result = run(vehicle_of(ELECTRIC), late, dt=dt)
        assert result.summary["duration_s"] == 30.0
        assert result.dt.sum() == pytest.approx(30.0)


# What a run was made of.


def weaker():
    """Return the electric car with a motor that takes 3 kW more at every point."""
    car = vehicle_of(ELECTRIC)
    motor = car.parts["motor"]
    table = motor.values["P_electric"]
    worse = replace(motor, values={**motor.values, "P_electric": replace(table, values=table.values + 3000.0)})
    return replace(car, parts={**car.parts, "motor": worse})


def test_a_saved_run_says_which_car_it_was(tmp_path):
    ours, theirs = (
        Result.load(run(car, cycle_of("us06")).save(tmp_path / f"{i}.nc")).origin for i, car in enumerate((vehicle_of(ELECTRIC), weaker()))
    )
    differ = [role for role in ours.parts if ours.parts[role].sha256 != theirs.parts[role].sha256]
    assert differ == ["motor"]
    assert ours.cycle == theirs.cycle


def test_inputs_are_equal_only_where_parts_and_cycle_are():
    ours, theirs = run(vehicle_of(ELECTRIC), cycle_of("us06")).inputs, run(weaker(), cycle_of("us06")).inputs
    assert ours == run(vehicle_of(ELECTRIC), cycle_of("us06")).inputs
    assert ours != theirs
    assert ours.parameters == theirs.parameters
    faster = replace(cycle_of("us06"), speed=1.01 * cycle_of("us06").speed)
    assert ours != run(vehicle_of(ELECTRIC), faster).inputs


def test_the_origin_makes_the_same_run_again(tmp_path):
    result = run(weaker(), cycle_of("us06"))
    origin = Result.load(result.save(tmp_path / "run.nc")).origin
    for role, part in origin.parts.items():
        (tmp_path / f"{part.name}.toml").write_text(part.text)
        assert part.kind == vehicle_of(ELECTRIC).parts[role].kind
    (tmp_path / f"{origin.vehicle.name}.toml").write_text(origin.vehicle.text)
    (tmp_path / "us06.csv").write_text(origin.cycle.text)
    car = Vehicle.load(tmp_path / f"{origin.vehicle.name}.toml").with_parts(
        {role: tmp_path / f"{part.name}.toml" for role, part in origin.parts.items()}
    )
    car = car.with_values(result.inputs.parameters)
    np.testing.assert_array_equal(run(car, Cycle.load(tmp_path / "us06.csv")).history, result.history)


def test_the_origin_names_date_machine_and_versions(tmp_path):
    result = done(ELECTRIC)
    origin = Result.load(result.save(tmp_path / "run.nc")).origin
    assert origin == result.origin
    assert origin.date.startswith("20")
    assert origin.date.endswith("+00:00")
    assert origin.machine
    assert origin.versions.keys() == {"python", "halfshaft", "casadi", "numpy"}
    assert origin.ratings.motor_power_max_W == result.summary["motor_power_max_W"]


def test_making_a_run_works_out_no_origin(monkeypatch):
    """Texts and hashes take as long as a hundred runs, so they wait until they are asked for."""
    monkeypatch.setattr("halfshaft.cosim.origin.Made.origin", property(lambda _: pytest.fail("worked out")))
    assert done(ELECTRIC).summary["range_m"] > 0


def test_a_grade_over_distance_is_part_of_the_origin(tmp_path):
    cycle = replace(cycle_of("us06"), grade_by_distance=(np.array([0.0, 1000.0]), np.array([0.01, 0.02])))
    text = run(vehicle_of(ELECTRIC), cycle).origin.cycle.text
    assert "distance_m,grade\n0.0,0.01\n1000.0,0.02\n" in text


def rewritten(result, path, change):
    """Save a result with its description changed, as another version would have written it."""
    with h5py.File(result.save(path), "r+") as data:
        plain = json.loads(data.attrs["result"])
        change(plain)
        data.attrs["result"] = json.dumps(plain)
    return path


def as_in_0_1(plain):
    for name in ("format", "origin"):
        del plain[name]
    del plain["inputs"]["compiled"], plain["inputs"]["hashes"], plain["first"]["time"]


def test_a_file_of_version_0_1_is_read_without_an_origin(tmp_path):
    result = done(SERIES)
    old = Result.load(rewritten(result, tmp_path / "old.nc", as_in_0_1))
    assert old.origin is None
    unknown = {"range_m", "pack_energy_J", "motor_power_max_W"}
    assert old.summary == {name: None if name in unknown else x for name, x in result.summary.items()}
    assert repr(old) == repr(result)
    assert Result.load(old.save(tmp_path / "again.nc")).summary == old.summary


def as_in_format_2(plain):
    plain["format"] = 2
    plain["outputs"] = [d[:10] for d in plain["outputs"]]
    del plain["inputs"]["tags"], plain["origin"]["ratings"]["energies_J"]


@pytest.mark.parametrize("name", [ELECTRIC, SERIES, CONVENTIONAL])
def test_a_file_without_tags_is_given_them(name, tmp_path):
    result = done(name)
    old = Result.load(rewritten(result, tmp_path / "old.nc", as_in_format_2))
    # Tags that came later are for tests of vehicles.
    assert old.tags == {name: tag for name, tag in result.tags.items() if tag in older.TAGS.values()}
    assert old.outputs == result.outputs
    assert old.summary == result.summary
    assert repr(old) == repr(result)


def beside(result, twins, **ratings):
    """Return a run in which outputs are there once more, under the names and times the factors that are given."""
    names, factor = [d.name for d in result.outputs], dict(twins.values())
    kept = {name: new for name, (new, _) in twins.items() if name in names}
    outputs = (*result.outputs, *(result.outputs[names.index(name)]._replace(name=new) for name, new in kept.items()))

    def more(values):
        return {**values, **{new: factor[new] * values[name] for name, new in kept.items() if name in values}}

    p, tags = dict(result.inputs.parameters), dict(result.inputs.tags)
    for name, (new, by) in twins.items():
        if name in p:
            p[new], tags[new] = by * p[name], tags[name]
    known = replace(result.origin, ratings=Ratings(**ratings))
    rows = np.column_stack([result.history, *(factor[new] * result[name] for name, new in kept.items())])
    return replace(
        result, inputs=replace(result.inputs, parameters=p, tags=tags), outputs=outputs, history=rows,
        energies=more(result.energies), highest=more(result.highest), first=more(result.first), last=more(result.last), made=known,
    )  # fmt: skip


def test_of_several_batteries_and_motors_energies_add_and_charge_is_weighted():
    one = done(ELECTRIC)
    twins = {"battery.soc": ("pack.soc", 0.5), "motor.P_in": ("rear.P_in", 0.25)}
    two = beside(one, twins, pack_energy_J=4e7, motor_power_max_W=1e5, energies_J={"battery": 3e7, "pack": 1e7})
    assert two.summary["motor_input_J"] == pytest.approx(1.25 * one.summary["motor_input_J"])
    for name in ("soc_start", "soc_end"):
        assert two.summary[name] == pytest.approx((0.75 + 0.25 * 0.5) * one.summary[name])
    assert two.summary["pack_energy_J"] == 4e7
    # Of files that do not say how large the packs are, all count alike.
    assert beside(one, twins).summary["soc_end"] == pytest.approx(0.75 * one.summary["soc_end"])


def test_an_engine_and_a_fuel_cell_burn_and_generate_together():
    one = done(SERIES, "hwfet")
    twins = {
        "engine.fuel_used": ("cell.fuel_used", 0.5), "engine.P_fuel": ("cell.P_fuel", 0.75), "generator.P_out": ("cell.P_out", 0.8),
        "engine.rho_fuel": ("cell.rho", 0.1), "engine.H_fuel": ("cell.H", 1.5),
    }  # fmt: skip
    two = beside(one, twins)
    s, t = one.summary, two.summary
    assert t["fuel_L"] == pytest.approx((1 + 0.5 / 0.1) * s["fuel_L"])
    assert t["fuel_equivalent_efficiency"] == pytest.approx(1.8 / 1.75 * s["fuel_equivalent_efficiency"])
    burnt = two.energies["engine.P_fuel"] + two.energies["cell.P_fuel"]
    litres = t["fuel_L"] * (1 + t["energy_from_battery_J"] / t["fuel_equivalent_efficiency"] / burnt)
    assert t["fuel_equivalent_L"] == pytest.approx(litres)
    none = dict.fromkeys(two.energies, 0.0)
    idle = replace(two, energies=none, last=two.last | {"engine.fuel_used": 0.0, "cell.fuel_used": 0.0})
    assert "no fuel used: the engine and the cell never ran" in idle.warnings


def test_two_parts_that_warn_of_the_same_are_told_apart():
    one = done(ELECTRIC, soc=0.03)
    both = beside(one, {f"battery.{x}": (f"pack_2.{x}", 1.0) for x in ("soc", "P_out", "battery_limited")})
    (text,) = (text for text in one.warnings if text.startswith("battery limit reached, empty"))
    assert {f"battery: {text}", f"pack 2: {text}"} <= set(both.warnings)
    assert text not in both.warnings


def test_a_file_of_a_later_version_is_refused(tmp_path):
    path = rewritten(done(SERIES), tmp_path / "new.nc", lambda plain: plain.update(format=99))
    with pytest.raises(InputError, match="is a result of format 99, this version reads up to 3"):
        Result.load(path)


def test_series_follow_the_climate_and_forecast_conventions():
    import pint

    data = done(SERIES).dataset
    known = pint.UnitRegistry()
    assert data.attrs["Conventions"].startswith("CF-")
    assert data.attrs["title"] == "small-car-series over us06"
    for name, series in data.variables.items():
        assert series.attrs["long_name"], name
        known.parse_units(series.attrs["units"])
    flag = data["control.engine_on"].attrs
    assert (flag["flag_values"].tolist(), flag["flag_meanings"]) == ([0, 1], "no yes")


# Prompt and notebook.


@pytest.mark.parametrize("name", [ELECTRIC, SERIES, CONVENTIONAL])
def test_a_result_is_short_at_the_prompt_and_a_table_in_a_notebook(name):
    result = done(name)
    assert len(repr(result)) < 200
    assert repr(result).startswith(f"<Result {name} over us06: ")
    assert len(repr(result.account)) < 100
    page = result._repr_html_()
    assert 1000 < len(page) < 20_000
    assert "<svg" in page
    assert "trace miss" in page
    assert "<svg" not in done(name, history=False)._repr_html_()
    assert result.account._repr_html_().count("<tr>") > 12


def test_text_of_a_user_is_escaped_in_a_notebook():
    result = run(vehicle_of(ELECTRIC), cycle_of("us06"))
    named = replace(result, inputs=replace(result.inputs, vehicle="<script>"))
    assert "&lt;script&gt;" in named._repr_html_()
    assert "<script>" not in named._repr_html_()


def test_a_car_without_a_battery_has_none_in_its_account():
    a = done(CONVENTIONAL).account
    assert (a.battery, done(ELECTRIC).account.fuel) == (0.0, 0.0)
    assert a.fuel > 0
