"""Optimal energy management: a toy whose optimum is known in closed form, and a parallel hybrid with its gears."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from halfshaft.app.cli import app
from halfshaft.cosim.cycle import Cycle
from halfshaft.cosim.result import Result
from halfshaft.library.base.errors import InputError, SolveError
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.optimal import optimal

#: Fuel of the toy: c0 + c1 P + c2 P^2 [W] at the powers that are tried, in between straight; least per power at 10 kW.
C0, C1, C2 = 4000.0, 1.5, 4e-5
H = 120e6
P = np.linspace(0, 50e3, 21)
FUEL = C0 + C1 * P + C2 * P**2
CELL = """
schema = 1
kind = "fuel-cell"
name = "toy-cell"
title = "Fuel by a parabola"
source = "made up"
[parameters]
rho_fuel = "18 kg/m^3"
H_fuel = "{H} J/kg"
[parameters.fuel]
P = {{unit = "W", values = {P}}}
values = {{unit = "kg/s", values = {fuel}}}
"""
STORE = """
schema = 1
kind = "battery"
name = "toy-store"
title = "A store without loss"
source = "made up"
[parameters]
n_modules = 25
u_min = "1 V"
u_max = "100 V"
mass = "10 kg"
c_p = "1000 J/(kg K)"
R_th_fan = "1 K/W"
R_th_still = "1 K/W"
airflow = "0.01 kg/s"
u_oc = {{T = {{unit = "K", values = [250, 350]}}, soc = [0, 1], values = {{unit = "V", values = [[12, 12], [12, 12]]}}}}
r_discharge = {{T = {{unit = "K", values = [250, 350]}}, soc = [0, 1], values = {{unit = "ohm", values = [[1e-9, 1e-9], [1e-9, 1e-9]]}}}}
r_charge = {{T = {{unit = "K", values = [250, 350]}}, soc = [0, 1], values = {{unit = "ohm", values = [[1e-9, 1e-9], [1e-9, 1e-9]]}}}}
Q = {{T = {{unit = "K", values = [250, 350]}}, values = {{unit = "C", values = [2e5, 2e5]}}}}
eta_coulomb = {{T = {{unit = "K", values = [250, 350]}}, values = [1, 1]}}
"""


@pytest.fixture(scope="module")
def toy(tmp_path_factory):
    """Return a car with a fuel cell that burns by a parabola, and a store without loss."""
    folder = tmp_path_factory.mktemp("toy")
    (folder / "toy-cell.toml").write_text(CELL.format(H=H, P=P.tolist(), fuel=(FUEL / H).tolist()))
    (folder / "toy-store.toml").write_text(STORE.format())
    car = Vehicle.load("small-car-fuel-cell").with_parts({"fuel_cell": folder / "toy-cell.toml", "battery": folder / "toy-store.toml"})
    car = car.with_values({"battery.soc_start": 0.5, "control.on_start": 1})
    return Vehicle.load(car.save(folder / "toy.toml"))


def trace(*v):
    """Return a cycle with these speeds, a minute apart."""
    return Cycle(name="moving", time=60.0 * np.arange(len(v)), speed=np.array(v, dtype=float))


FAST = trace(25, 33, 25, 30, 33)
SLOW = trace(8, 12, 10, 14, 8)


@pytest.fixture(scope="module")
def at_speed(toy):
    """Return what is found of the toy on the fast cycle."""
    return optimal(toy, FAST, charge="used", places=30, threads=1)


def check_toy(found, steady):
    """Hold an optimum of the toy against the closed form."""
    energy, time = found.in_use.result.energies["fuel_cell.P_out"], found.cycle.duration
    mean = energy / time
    # A parabola is least at one power all the time; below the power of least fuel per energy that one is given a part of the time.
    assert (mean > 10e3) == steady
    least = time * np.interp(mean, P, FUEL) if steady else energy * np.min(FUEL[1:] / P[1:])
    # The charge may end too high by one step of what is tried.
    step = (FUEL[-1] - FUEL[-2]) if steady else FUEL[4]
    for way in (found.best, found.ecms):
        assert found.fuel(way) == pytest.approx(least, rel=1e-4)
        assert least * (1 - 1e-6) < way.fuel < least + 1.001 * step
        assert way.fuel < found.in_use.fuel
    given = found.best.result["fuel_cell.P_out"]
    beside = [2.5e3 * np.floor(mean / 2.5e3), 2.5e3 * np.ceil(mean / 2.5e3)] if steady else [0, 10e3]
    assert np.sum(~np.isin(given.round(-2), beside)) <= 1


def test_a_convex_source_without_losses_beside_it_gives_one_power(at_speed):
    check_toy(at_speed, steady=True)
    # What the energy costs is the slope of the fuel there; the price bends a little.
    mean = at_speed.in_use.result.energies["fuel_cell.P_out"] / FAST.duration
    k = int(mean // 2.5e3)
    assert at_speed.price == pytest.approx((FUEL[k + 1] - FUEL[k]) / 2.5e3, rel=1e-2)


def test_below_its_best_power_the_source_is_given_a_part_of_the_time(toy):
    check_toy(optimal(toy, SLOW, charge="used", places=30), steady=False)


def test_threads_change_nothing(toy, at_speed):
    other = optimal(toy, FAST, charge="used", places=30, threads=3)
    assert other.passes == at_speed.passes
    for name, row in other.best.commands.items():
        assert np.array_equal(row, at_speed.best.commands[name])


def test_what_is_found_can_be_looked_at(at_speed, tmp_path):
    figures = at_speed.figures()
    assert list(figures) == ["control in use", "ECMS", "best"]
    assert figures["best"]["excess"] == 0 < figures["control in use"]["excess"]
    data = at_speed.dataset.sel(way="best")
    assert data["fuel_cell.P_out"].values == pytest.approx(at_speed.best.result["fuel_cell.P_out"])
    assert set(np.unique(data["control.run"])) <= {0, 1}
    at_speed.plot(path=tmp_path / "best.png")
    assert (tmp_path / "best.png").read_bytes()[1:4] == b"PNG"


def test_command_shows_all_three(toy, tmp_path):
    toy.save(tmp_path / "toy.toml")
    FAST.save(tmp_path / "moving.csv")
    asked = ["optimal", str(tmp_path / "toy.toml"), "--cycle", str(tmp_path / "moving.csv"), "--charge", "used", "--places", "10"]
    told = CliRunner().invoke(app, [*asked, "--json", "--out", str(tmp_path / "best.nc")])
    assert told.exit_code == 0, told.output
    ways = json.loads(told.stdout)["ways"]
    assert ways["best"]["fuel_J"] < ways["control in use"]["fuel_J"]
    assert Result.load(tmp_path / "best.nc").account.fuel == pytest.approx(ways["best"]["fuel_J"])
    table = CliRunner().invoke(app, asked, env={"COLUMNS": "120"}).stdout
    assert "control in use" in table
    assert "over best" in table
    wrong = CliRunner().invoke(app, [*asked, "--window", "0.8..0.4", "--keep", "shift", "--points", "1"])
    assert wrong.exit_code
    for what in ("window", "shift obeys no commands", "points = 1"):
        assert what in wrong.output


UDDS = Cycle.load("udds").between(0, 100)


@pytest.fixture(scope="module")
def parallel():
    """Return optima of a parallel hybrid, gears and all, by the fineness of what is tried."""
    vehicle = Vehicle.load("small-car-parallel")
    return [optimal(vehicle, UDDS, charge="used", places=n, points=2 * n + 1) for n in (10, 20)]


def test_a_finer_search_changes_little(parallel):
    coarse, fine = parallel
    assert coarse.best.fuel == pytest.approx(fine.best.fuel, rel=2e-3)
    for found in parallel:
        assert found.best.fuel <= found.ecms.fuel
        assert abs(found.excess(found.ecms)) < 0.01
        assert found.best.fuel < found.in_use.fuel


def test_all_ways_drive_the_cycle_and_keep_the_charge(parallel):
    for way in parallel[1].ways:
        assert way.result["body.v"] == pytest.approx(UDDS.sampled(1.0).v, abs=2e-3)
        assert parallel[1].charge(way)[-1] >= parallel[1].charge(parallel[1].in_use)[-1] - 1e-9
        assert way.result.account.balance_relative == pytest.approx(0, abs=1e-9)
        assert not way.result.audit.failures


@pytest.mark.parametrize(
    ("name", "given", "told"),
    [
        ("small-car-electric", {}, "nothing that burns fuel"),
        ("small-car-conventional", {}, "no battery"),
        ("small-car-plug-in-series", {}, "burns no fuel over"),
        ("small-car-series", {"charge": "all"}, "charge = 'all', must be kept or used"),
        ("small-car-series", {"places": 1.5}, "places = 1.5"),
        ("small-car-series", {"dt": 0}, "dt = 0 s"),
        ("small-car-fuel-cell", {"keep": ["control"]}, "nothing is left to decide"),
    ],
)
def test_what_cannot_be_asked_for_is_said(name, given, told):
    with pytest.raises(InputError, match=told):
        optimal(Vehicle.load(name), UDDS, **given)


def test_a_window_that_nothing_keeps_is_said(toy):
    with pytest.raises(SolveError, match="no price of the charge"):
        optimal(toy, FAST, charge="used", window=(0.1, 0.2), places=5, points=3)
