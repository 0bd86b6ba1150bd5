from pathlib import Path

import numpy as np
import pytest

from halfshaft import Cycle, InputError, Vehicle, run
from halfshaft.cosim.units import M_PER_MILE
from halfshaft.studies.procedure import Procedure, joined, kinds_of
from halfshaft.studies.procedure_file import Plan, procedure_names
from halfshaft.studies.soc_correction import ZeroDelta

CONVENTIONAL, ELECTRIC, PARALLEL = (Vehicle.load(f"small-car-{n}") for n in ("conventional", "electric", "parallel"))
PLUG_IN = Vehicle.load("small-car-plug-in-series")
HEAD = 'schema = 1\nkind = "procedure"\nname = "{name}"\ntitle = "T"\nsource = "S"\n'


def written(folder, body, name="mine"):
    path = folder / f"{name}.toml"
    path.write_text(HEAD.format(name=name) + body)
    return path


def problems(folder, body):
    with pytest.raises(InputError) as e:
        Plan.load(written(folder, body))
    return list(e.value.problems)


def udds_with_soak(second_until):
    """Return UDDS, a soak of 600 s with the key off, and UDDS again until a time, second by second, by hand."""
    c = Cycle.load("udds")
    n = int(c.time[-1])
    v = [float(np.interp(k, c.time, c.speed)) for k in range(n + 1)]
    speed = v + [0.0] * 600 + v[1 : second_until + 1]
    key = [1.0] * (n + 1) + [0.0] * 600 + [1.0] * second_until
    time = [float(k) for k in range(len(speed))]
    # The key turns right behind the last second that has it.
    time[n + 1] = time[n + 1]
    return Cycle(name="by-hand", time=time, speed=speed, key_on=key), n


def by_hand(result, name, bags):
    """Return the weighted integral of an output over bags of (start, end, weight) [s]."""
    total = 0.0
    for start, end, weight in bags:
        for t, dt, x in zip(result.time, result.dt, result[name], strict=True):
            if start < t <= end:
                total += weight * x * dt
    return total


def weighted_distance(result, bags):
    s = np.concatenate([[0.0], result.the("distance")])
    return sum(weight * (s[int(end)] - s[int(start)]) for start, end, weight in bags)


def test_the_weights_of_the_ftp_by_hand():
    cycle, n = udds_with_soak(505)
    result = run(CONVENTIONAL, cycle)
    bags = [(0, 505, 0.43), (505, n, 1.0), (n + 600, n + 1105, 0.57)]
    litres = 1e3 * by_hand(result, "engine.fuel_flow", bags) / CONVENTIONAL.values["engine.rho_fuel"]
    found = Procedure.load("ftp")(CONVENTIONAL).figures
    assert found["city_fuel_economy_L_per_100km"] == pytest.approx(1e5 * litres / weighted_distance(result, bags), rel=1e-9)
    miles_per_gallon = weighted_distance(result, bags) / M_PER_MILE / (litres / 3.785411784)
    assert found["combined_fuel_economy_mpg"] == pytest.approx(miles_per_gallon, rel=1e-9)


def test_the_weights_of_the_ftp_of_hybrids_by_hand():
    found = Procedure.load("ftp")(PARALLEL)
    cycle, n = udds_with_soak(1369)
    car = PARALLEL.with_values({"battery.soc_start": found.tests["city_hybrid"].search.record[-1].soc})
    result = run(car, cycle)
    bags = [(0, 505, 0.43), (505, n, 0.43), (n + 600, n + 1105, 0.57), (n + 1105, n + 600 + n, 0.57)]
    litres = 1e3 * by_hand(result, "engine.fuel_flow", bags) / PARALLEL.values["engine.rho_fuel"]
    distance = weighted_distance(result, bags)
    figures = found.figures
    assert figures["city_hybrid_fuel_economy_L_per_100km"] == pytest.approx(1e5 * litres / distance, rel=1e-9)
    kWh = by_hand(result, "battery.P_stored", bags) / 3.6e6
    assert figures["city_hybrid_energy_kWh_per_100km"] == pytest.approx(1e5 * kWh / distance, rel=1e-9)
    assert figures["city_hybrid_soc_change"] == pytest.approx(result.figures["soc_end"] - result.figures["soc_start"], abs=1e-12)


def test_the_distances_of_the_bags_add_up():
    # In the original the second bag begins one sample late.
    for car, test, parts in ((CONVENTIONAL, "city", 1), (PARALLEL, "city_hybrid", 2)):
        outcome = Procedure.load("ftp")(car)
        found, distance = outcome.figures, outcome.tests[test].result.the("distance")
        first, second, third = (found[f"{test}_bag_{i}_distance_m"] for i in (1, 2, 3))
        assert first + second == pytest.approx(distance[1368], rel=1e-12)
        assert third == pytest.approx(first, abs=1)
        if parts == 2:
            assert found[f"{test}_bag_4_distance_m"] == pytest.approx(second, abs=1)
            assert first + second + third + found[f"{test}_bag_4_distance_m"] == pytest.approx(distance[-1], rel=1e-12)


def test_city_and_highway_combine_harmonically():
    found = Procedure.load("city-highway")(CONVENTIONAL).figures
    city, highway = found["city_fuel_economy_mpg"], found["highway_fuel_economy_mpg"]
    assert found["combined_fuel_economy_mpg"] == pytest.approx(1 / (0.55 / city + 0.45 / highway), rel=1e-12)
    assert city == Procedure.load("ftp")(CONVENTIONAL).figures["combined_fuel_economy_mpg"]
    assert highway == pytest.approx(run(CONVENTIONAL, Cycle.load("hwfet")).figures["fuel_economy_mpg"], rel=1e-9)


def test_nedc_of_a_hybrid_is_its_zero_delta_run():
    found = Procedure.load("nedc")(PARALLEL).figures
    alone = ZeroDelta(cycle=Cycle.load("nedc"))(PARALLEL.with_values({"battery.T_start": 296.15})).figures
    assert found["nedc_fuel_economy_L_per_100km"] == pytest.approx(alone["fuel_economy_L_per_100km"], rel=1e-9)
    assert found["nedc_runs"] == alone["runs"]


def test_the_utility_factor_weights_round_by_round():
    found = Procedure.load("wltp")(PLUG_IN)
    depleting, plan = found.tests["depleting"], Plan.load("wltp").utility
    kept = found.figures["sustaining_fuel_economy_L_per_100km"]
    litres, before = 0.0, 0.0
    for distance, consumption in depleting.rounds:
        share = float(np.interp(distance, plan.distance, plan.share))
        litres += (share - before) * 1e5 * consumption.fuel
        before = share
    assert len(depleting.rounds) == found.figures["depleting_rounds"] > 1
    assert found.figures["combined_fuel_economy_L_per_100km"] == pytest.approx(litres + (1 - before) * kept, rel=1e-12)
    # The battery gives most in all rounds that count, and next to nothing in the one behind them.
    r = depleting.result
    ends = [int(d) for d in np.searchsorted(r.the("distance"), [d for d, _ in depleting.rounds])]
    stored = np.cumsum(r["battery.P_stored"] * r.dt)
    assert np.all(np.diff(stored[ends], prepend=0.0)[:-1] > 5e6)
    assert found.figures["depleting_range_m"] == pytest.approx(depleting.rounds[-1][0], rel=1e-6)


def test_a_battery_is_depleted_until_it_gives_less_than_4_percent_of_what_a_cycle_takes():
    tested = Procedure.load("wltp")(PLUG_IN).tests["depleting"]
    r, whole = tested.result, 1800 + 600
    v = np.concatenate([[0.0], r.the("speed")])
    shares = []
    for start in range(0, len(r.time), whole):
        steps = range(start, start + 1800)
        stored = sum(r["battery.P_stored"][k] for k in steps)
        driven = sum(max(r["body.F_required"][k], 0) * (v[k] + v[k + 1]) / 2 for k in steps)
        shares.append(abs(stored) / driven)
    first = next(k for k, share in enumerate(shares) if share < 0.04)
    assert shares[first - 1] > 0.1
    assert tested.figures["rounds"] == first


def test_points_of_the_utility_factor_of_the_wltp_follow_its_formula():
    c = (26.25, -38.94, -631.05, 5964.83, -25095, 60380.2, -87517, 75513.8, -35749, 7154.94)
    u = Plan.load("wltp").utility
    for d, share in zip(u.distance, u.share, strict=True):
        assert share == pytest.approx(1 - np.exp(-sum(x * (d / 800e3) ** i for i, x in enumerate(c, 1))), abs=1e-5)


def test_half_of_all_driving_lies_within_39_miles():
    u = Plan.load("j1711").utility
    assert u(np.array([38.9, 196.0]) * M_PER_MILE) == pytest.approx([0.5, 0.9])


def test_j1711_of_a_plug_in_hybrid():
    found = Procedure.load("j1711")(PLUG_IN)
    city = found.tests["city_depleting"]
    # At least four rounds, and the engine runs in the last one alone, or the third already ran it.
    assert len(city.rounds) >= 4
    burnt = [c.fuel > 0 for _, c in city.rounds]
    assert burnt[-1] or len(burnt) == 4
    f = found.figures
    assert f["city_weighted_fuel_economy_L_per_100km"] < f["city_fuel_economy_L_per_100km"]
    both = 0.55 * f["city_weighted_fuel_economy_L_per_100km"] + 0.45 * f["highway_weighted_fuel_economy_L_per_100km"]
    assert f["combined_fuel_economy_L_per_100km"] == pytest.approx(both, rel=1e-12)
    # A hybrid without a plug has no share that depletes.
    plain = Procedure.load("j1711")(PARALLEL).figures
    assert plain["city_weighted_fuel_economy_L_per_100km"] == plain["city_fuel_economy_L_per_100km"]


def test_a_test_is_driven_at_least_so_often(tmp_path):
    body = '[tests.far]\nsoc = 0.1\nrepeat = {until = "engine", at_least = 3, at_most = 9}\ndrive = [{cycle = "nycc"}]\n'
    found = Procedure.load(written(tmp_path, body))(PLUG_IN)
    assert found.figures["far_rounds"] == 3
    assert all(c.fuel > 0 for _, c in found.tests["far"].rounds)


def test_electricity_counts_33_705_kwh_a_gallon():
    found = Procedure.load("city-highway")(ELECTRIC).figures
    kWh_per_mile = found["combined_energy_kWh_per_100km"] / 100 * M_PER_MILE / 1e3
    assert found["combined_energy_MPGe"] == pytest.approx(33.705 / kWh_per_mile, rel=1e-12)


def test_a_warm_up_does_not_count():
    tested = Procedure.load("j1711")(PARALLEL).tests["highway"]
    r = tested.result
    soc = np.concatenate([[r.first["battery.soc"]], r["battery.soc"]])
    assert tested.figures["soc_change"] == pytest.approx(soc[-1] - soc[765 + 15], abs=1e-12)
    assert tested.figures["soc_change"] != pytest.approx(soc[-1] - soc[0], abs=1e-4)
    assert tested.search.record[-1].change == tested.figures["soc_change"]
    distance = r.the("distance")
    assert tested.figures["distance_m"] == pytest.approx(distance[-1] - distance[765 + 15 - 1], rel=1e-12)
    assert not r["engine.fuel_flow"][766:780].any()


def test_the_range_of_an_electric_car_ends_where_it_no_longer_follows():
    found = Procedure.load("electric-range")(ELECTRIC)
    r = found.tests["city"].result
    late, end = 0, None
    for k, (miss, soc) in enumerate(zip(r.the("miss"), r["battery.soc"], strict=True)):
        late = late + 1 if miss > 2 * M_PER_MILE / 3600 else 0
        if late == 2 or soc < 1e-3:
            end = k - 2 if late == 2 else k
            break
    assert found.figures["city_range_m"] == pytest.approx(r.the("distance")[end], rel=1e-12)
    energy = (r["battery.P_stored"] * r.dt)[: end + 1].sum() / 3.6e6
    assert found.figures["city_energy_kWh_per_100km"] == pytest.approx(1e5 * energy / found.figures["city_range_m"], rel=1e-3)
    assert 30e3 < found.figures["city_range_m"] < 50e3


def test_what_never_ends_is_said(tmp_path):
    body = '[tests.far]\nrepeat = {until = "empty", at_most = 2}\ndrive = [{cycle = "hwfet"}]\n'
    found = Procedure.load(written(tmp_path, body))(ELECTRIC)
    assert found.figures["far_range_m"] is None
    assert found.notes[0] == "far: after 2 rounds the battery is not empty"


def test_a_procedure_of_ones_own(tmp_path):
    (tmp_path / "hill.csv").write_text("time_s,speed_mps,grade\n0,0,0\n20,15,0\n60,15,0.04\n80,0,0\n")
    body = """
report = ["both_energy_kWh_per_100km"]
grid.efficiency = 0.8
[tests.warm]
temperature = "40 degC"
soc = 0.6
drive = [{cycle = "hill.csv"}, {soak = "10 s"}, {cycle = "hill.csv", bag = "again", weight = 3}]
[tests.flat]
drive = [{cycle = "nycc"}]
[combined.both]
warm = 1
flat = 3
"""
    found = Procedure.load(written(tmp_path, body))(ELECTRIC)
    assert next(iter(found.figures)) == "both_energy_kWh_per_100km"
    warm, flat, both = (found.figures[f"{n}_energy_kWh_per_100km"] for n in ("warm", "flat", "both"))
    assert both == pytest.approx((warm + 3 * flat) / 4, rel=1e-12)
    r = found.tests["warm"].result
    assert r.first["battery.T"] == pytest.approx(313.15)
    assert r.first["battery.soc"] == 0.6
    nycc = run(ELECTRIC, Cycle.load("nycc"))
    assert flat == pytest.approx(1e5 * nycc.account.battery / 3.6e6 / nycc.figures["distance_m"] / 0.8, rel=1e-9)
    assert r.time[-1] == 170
    assert max(r.the("elevation")) > 20


@pytest.mark.parametrize("name", procedure_names())
def test_every_procedure_of_the_library_is_right(name):
    plan = Plan.load(name)
    assert plan.title
    assert plan.source
    for test in plan.tests:
        cycle, spans = joined(test, 2 if test.repeat else 1)
        assert spans[-1].end == cycle.time[-1]
    kinds = {kind for test in plan.tests for kind in test.vehicles}
    car = next(c for c in (CONVENTIONAL, ELECTRIC, PARALLEL) if kinds & kinds_of(c))
    found = Procedure(plan)(car)
    assert found.reported
    assert found.figures.keys() >= set(found.reported)


def test_a_procedure_for_other_vehicles_is_refused():
    with pytest.raises(InputError, match="procedure 'j1711': vehicle 'small-car-electric' is electric, and no test is for such"):
        Procedure.load("j1711")(ELECTRIC)
    with pytest.raises(InputError, match="procedure 'fpt': not in the library, did you mean 'ftp'"):
        Procedure.load("fpt")


def test_every_problem_of_a_file_is_named_with_its_place(tmp_path):
    found = problems(
        tmp_path,
        """
colour = "red"
report = [1]
[tests.city]
vehicle = ["fuel"]
vehicles = ["diesel"]
soc = 1.5
temperature = "20"
correction = "luck"
drive = [{cycle = "uddss"}, {soak = "5 km"}, {}, {cycle = "udds", from = "100 s", to = "50 s"}, {cycle = "udds", weight = -1, bags = "x"}]
[tests.far]
repeat = {until = "tired", at_least = 5, at_most = 2}
drive = []
[combined.city]
town = 1
[weighted.u]
depleting = "city"
sustaining = "nothing"
[weighted.w]
depleting = "city"
sustaining = "far"
[utility]
distance = {unit = "km", values = [0, 10, 5]}
share = [0, 0.5, 2]
""",
    )
    text = "\n".join(found)
    for said in (
        "colour is not known",
        "report = 1, must be a text",
        "tests.city.vehicle is not known, did you mean 'vehicles'?",
        'tests.city.vehicles = "diesel", must be fuel or hybrid or plug-in or electric',
        "tests.city.soc = 1.5, must be >= 0 and <= 1",
        'tests.city.temperature = "20", must have a unit',
        'tests.city.correction = "luck", must be zero-delta or none',
        "tests.city.drive[1].cycle: cycle 'uddss': not in the library, did you mean 'udds'?",
        "tests.city.drive[2].soak",
        "tests.city.drive[3] must have either a cycle or a soak",
        "tests.city.drive[4].from 100 s to 50 s: must rise",
        "tests.city.drive[5].bags is not known",
        "tests.city.drive[5].weight = -1",
        'tests.far.repeat.until = "tired"',
        "tests.far.repeat.at_most = 2 is below at_least = 5",
        "tests.far.drive = [], must be a list",
        "combined.city.town is not known",
        "combined.city has no share above 0",
        "city is the name of 2 things",
        'weighted.u.sustaining = "nothing"',
        "that test is not repeated",
        "utility.share[3] = 2",
    ):
        assert said in text, f"{said}\n\n{text}"


def test_wrong_kinds_of_things_are_refused(tmp_path):
    for body in (
        "[tests]\n", "tests = 3\n", "[tests]\na = 1\n", "[tests.a]\ndrive = 3\n", "[tests.a]\ndrive = [1]\n",
        "[tests.a]\nsoc = []\ndrive = [{cycle = 1}]\n", "[tests.a]\nrepeat = 1\ndrive = [{cycle = 'udds', from = 'nan s'}]\n",
        "[tests.a]\nvehicles = 1\ndrive = [{cycle = 'udds', bag = 3}]\n",
        "combined = {b = {}}\nweighted = {c = 1}\n[tests.a]\ndrive = [{soak = '5 s'}]\n",
        "grid = 5\n[tests.a]\ndrive = [{cycle = 'udds'}]\n",
    ):  # fmt: skip
        assert problems(tmp_path, body)


def test_a_figure_to_report_that_does_not_exist_is_refused(tmp_path):
    body = 'report = ["speed"]\n[tests.a]\ndrive = [{cycle = "nycc"}]\n'
    with pytest.raises(InputError, match="report: no figure is called speed"):
        Procedure.load(written(tmp_path, body))(ELECTRIC)


def test_legs_fit_each_other_and_the_step(tmp_path):
    jump = '[tests.a]\ndrive = [{cycle = "udds", to = "100 s"}, {soak = "5 s"}]\n'
    with pytest.raises(InputError, match=r"test 'a': a leg begins at 0 m/s where the one before ends at 13"):
        Procedure.load(written(tmp_path, jump))(ELECTRIC)
    between = Plan.load(written(tmp_path, '[tests.a]\ndrive = [{cycle = "udds", to = "10.5 s"}, {cycle = "udds", from = "10.5 s"}]\n'))
    with pytest.raises(InputError, match=r"steps of 1 s: a leg ends at 10.5 s, within a step"):
        Procedure(between)(ELECTRIC)
    assert Procedure(between, dt=0.5)(ELECTRIC).figures["a_bag_1_distance_m"] == 0


def test_files_lie_where_the_package_looks():
    folder = Path(__file__).parents[2] / "studies" / "data" / "procedures"
    assert procedure_names() == sorted(p.stem for p in folder.glob("*.toml"))
