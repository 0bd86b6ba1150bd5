"""Optimal energy management: a toy whose optimum is known in closed form, and a parallel hybrid with its gears."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from halfshaft.app.cli import app
from halfshaft.cosim.cycle import Cycle
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


@pytest.mark.parametrize(("cycle", "steady"), [(FAST, True), (SLOW, False)])
def test_toy_meets_its_closed_form(toy, cycle, steady):
    found = optimal(toy, cycle, charge="used", places=50)
    energy, time = found.in_use.result.energies["fuel_cell.P_out"], cycle.duration
    mean = energy / time
    # A parabola is least at one power all the time; below the power of least fuel per energy that one is given a part of the time.
    assert (mean > 10e3) == steady
    least = time * np.interp(mean, P, FUEL) if steady else energy * np.min(FUEL[1:] / P[1:])
    for way in (found.best, found.ecms):
        assert found.fuel(way) == pytest.approx(least, rel=2e-4)
        # A step more or less of the cell's power is what the charge may end too high by.
        assert least * (1 - 2e-4) < way.fuel < least + 2.5e3 * 10 if steady else least * 1.01
    assert found.best.fuel < found.in_use.fuel
    given = found.best.result["fuel_cell.P_out"]
    assert set(given[given > 1].round(-2)) <= ({2.5e3 * np.floor(mean / 2.5e3), 2.5e3 * np.ceil(mean / 2.5e3)} if steady else {10e3})
