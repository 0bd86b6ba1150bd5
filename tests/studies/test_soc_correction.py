from dataclasses import replace

import pytest

from halfshaft import Cycle, InputError, Vehicle, run
from halfshaft.studies.conditions import window
from halfshaft.studies.soc_correction import Linear, Trial, ZeroDelta, zero_delta

HWFET = Cycle.load("hwfet")
SERIES = Vehicle.load("small-car-series")


def scripted(change, fuel=None):
    """Return a fake that changes the charge by a law, and what it was asked for."""
    asked = []

    def drive(soc):
        asked.append(soc)
        return Trial(soc, change(soc), energy_ratio=fuel and fuel(soc)), soc

    return drive, asked


def test_the_search_follows_its_rules_step_by_step():
    drive, asked = scripted(lambda s: 0.9 * (0.437 - s))
    found = zero_delta(drive, 0.6)
    # From the first run on by d; three times as far; then between the two of opposite sign.
    assert asked[:3] == pytest.approx([0.6, 0.6 - 0.1467, 0.4533 - 3 * 0.01467])
    d = [0.9 * (0.437 - s) for s in asked]
    share = max(0.2, d[2] / (d[2] - d[1]))
    assert asked[3] == pytest.approx(asked[2] + share * (asked[1] - asked[2]))
    assert found.status == "converged"
    assert [t.soc for t in found.record] == asked
    assert found.found == asked[-1]
    assert abs(found.record[-1].change) < 0.005


def test_a_change_of_the_tolerance_is_none_below_it_only():
    for change, runs in ((0.005, 3), (0.00499, 1)):
        drive, asked = scripted(lambda s, change=change: change)
        assert zero_delta(drive, 0.5, most_runs=3).status == ("converged" if runs == 1 else "one_sided")
        assert len(asked) == runs


def test_energy_counts_where_it_may():
    def drive():
        return scripted(lambda s: 0.02, lambda s: 0.009)[0]

    assert zero_delta(drive(), 0.5).status == "converged"
    assert zero_delta(drive(), 0.5, criterion="energy").status == "converged"
    assert zero_delta(drive(), 0.5, criterion="energy", energy=0.005).status == "one_sided"
    assert zero_delta(drive(), 0.5, criterion="charge").status == "one_sided"


def test_a_step_without_a_root_ends_with_the_best_run():
    drive, asked = scripted(lambda s: 0.03 if s < 0.47 else -0.02)
    found = zero_delta(drive, 0.6)
    assert found.status == "max_iterations"
    assert len(asked) == 15
    assert found.record[found.best].change == -0.02
    assert found.found == found.record[found.best].soc


def test_a_step_is_never_near_an_end_of_its_bracket():
    _, asked = (drive := scripted(lambda s: 0.09 if s < 0.45 else -0.006 - 0.01 * (s - 0.45)))
    zero_delta(drive[0], 0.6, most_runs=7)
    below, above = max(s for s in asked[:-1] if s < 0.45), min(s for s in asked[:-1] if s > 0.45)
    assert asked[-1] == pytest.approx(below + 0.8 * (above - below))


def test_a_charge_that_only_falls_ends_at_the_empty_battery():
    drive, asked = scripted(lambda s: -0.05 - s)
    found = zero_delta(drive, 0.5)
    assert found.status == "one_sided"
    assert asked[-1] == 0.0
    assert len(set(asked)) == len(asked)


@pytest.mark.parametrize("root", [0.101, 0.25, 0.437, 0.6, 0.83])
@pytest.mark.parametrize("slope", [0.3, 1.0, 4.0])
def test_steep_and_flat_laws_converge_soon(root, slope):
    drive, asked = scripted(lambda s: max(min(slope * (root - s), 0.15), -0.06))
    assert zero_delta(drive, 0.6).status == "converged"
    assert len(asked) <= 10


def test_zero_delta_is_a_run_that_keeps_its_charge():
    found = ZeroDelta(cycle=HWFET, criterion="charge")(SERIES)
    low, high = window(SERIES)
    assert found.record[0].soc == (low + high) / 2
    assert found.status == "converged"
    assert found.notes == found.result.warnings
    last = found.record[-1]
    again = run(SERIES.with_values({"battery.soc_start": last.soc}), HWFET)
    assert again.figures["soc_end"] - last.soc == last.change == pytest.approx(0, abs=0.005)
    assert found.figures["fuel_L"] == again.figures["fuel_L"]
    assert found.figures["runs"] == len(found.record)
    assert last.energy_ratio == again.account.battery / again.account.fuel


def test_what_did_not_converge_is_said():
    found = ZeroDelta(cycle=HWFET, most_runs=1)(SERIES.with_values({"control.soc_high": 0.99}))
    assert found.status == "one_sided"
    assert found.notes[0].startswith("the charge is not kept: after 1 runs it still changes by")


def test_linear_interpolates_fuel_per_distance():
    found = Linear(cycle=HWFET)(SERIES)
    low, high = window(SERIES)
    first, second = (run(SERIES.with_values({"battery.soc_start": s}), HWFET).figures for s in (low - 0.01, high + 0.01))
    d = [f["soc_end"] - f["soc_start"] for f in (first, second)]
    a, b = (f["fuel_economy_L_per_100km"] for f in (first, second))
    assert d[0] > 0 > d[1]
    assert found.figures["fuel_economy_L_per_100km"] == pytest.approx(a + (b - a) * d[0] / (d[0] - d[1]), rel=1e-12)
    assert found.figures["fuel_economy_mpg"] == pytest.approx(235.214583 / found.figures["fuel_economy_L_per_100km"], rel=1e-8)
    assert found.result.figures["soc_start"] == high + 0.01
    assert found.notes[0] == "time series and warnings are those of the last run"


def test_linear_does_not_extrapolate():
    found = Linear(cycle=Cycle.load("us06"))(Vehicle.load("small-car-mild-hybrid"))
    assert found.status == "one_sided"
    assert found.figures["fuel_economy_L_per_100km"] is None
    assert "the converter is too small to charge on this cycle" in found.notes[0]


def test_linear_runs_once_where_that_is_enough():
    found = Linear(cycle=HWFET, tolerance=0.9)(SERIES)
    assert len(found.record) == found.figures["runs"] == 1
    assert found.figures["fuel_L"] == found.result.figures["fuel_L"]


@pytest.mark.parametrize("task", [ZeroDelta(cycle=HWFET), Linear(cycle=HWFET)])
@pytest.mark.parametrize(("car", "lacks"), [("small-car-conventional", "no battery"), ("small-car-electric", "nothing that burns fuel")])
def test_a_correction_without_a_sense_is_refused(task, car, lacks):
    with pytest.raises(InputError, match=f"correction of the state of charge: vehicle '{car}' has {lacks}: there is no charge to keep"):
        task(Vehicle.load(car))


def test_all_problems_are_named_at_once():
    task = replace(ZeroDelta(cycle=HWFET), charge=0, energy=2, criterion="luck", most_runs=0)
    with pytest.raises(InputError) as error:
        task(Vehicle.load("small-car-conventional"))
    assert len(error.value.problems) == 5


def test_the_gasoline_equivalent_follows_from_the_fuels_energy():
    figures = ZeroDelta(cycle=HWFET)(SERIES).figures
    p = SERIES.values
    burnt = figures["fuel_economy_L_per_100km"] * p["engine.rho_fuel"] * p["engine.H_fuel"]
    assert figures["gasoline_equivalent_L_per_100km"] == pytest.approx(burnt / (749 * 42.6e6), rel=1e-9)
