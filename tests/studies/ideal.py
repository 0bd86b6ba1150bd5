"""An electric car without losses: a constant power P from a base speed on, a constant force F below it; drag as wanted.

Its times, distances, grades and top speed are known in closed form.
"""

import numpy as np

from halfshaft import Vehicle

P, F, M, R = 60e3, 6000.0, 1500.0, 0.3
V_BASE, G, RHO = P / F, 9.81, 1.2

MOTOR = """
schema = 1
kind = "motor"
name = "ideal-motor"
title = "Constant power, no losses"
source = "made for a test"

[parameters]
omega_max = "1000 rad/s"
J = "0 kg m^2"
I_max = "1e9 A"

[parameters.tau_max]
omega = {{unit = "rad/s", values = {omega}}}
values = {{unit = "N m", values = {tau}}}

[parameters.tau_min]
omega = {{unit = "rad/s", values = [0, 1000]}}
values = {{unit = "N m", values = [-2000, -2000]}}

[parameters.P_electric]
omega = {{unit = "rad/s", values = [0, 1000]}}
tau = {{unit = "N m", values = [-2000, 2000]}}
values = {{unit = "W", values = [[0, 0], [-2e6, 2e6]]}}
"""
WHEEL = """
schema = 1
kind = "wheel"
name = "ideal-wheel"
title = "No slip, no drag"
source = "made for a test"

[parameters]
r = "0.3 m"
J = "0 kg m^2"
f_0 = 0
mu_max = 2
front_driven = 1
rear_driven = 1

[parameters.slip]
adhesion = [0, 2]
values = [0, 0]

[parameters.tau_bearing]
m = {unit = "kg", values = [0, 2000]}
values = {unit = "N m", values = [0, 0]}

[parameters.share_driveline]
v = {unit = "m/s", values = [0, 1000]}
values = [1, 1]

[parameters.share_front]
v = {unit = "m/s", values = [0, 1000]}
values = [0.5, 0.5]
"""


def car(folder, drag=0.0, rolling=0.0):
    """Return the car with a drag area [m^2] and a coefficient of rolling resistance."""
    # Near the base speed the points are closer, where the torque bends most.
    omega = np.concatenate([[0.0], np.geomspace(V_BASE / R, 1000, 2000)])
    tau = np.concatenate([[F * R], P / omega[1:]])
    (folder / "ideal-motor.toml").write_text(MOTOR.format(omega=omega.tolist(), tau=tau.tolist()))
    (folder / "ideal-wheel.toml").write_text(WHEEL)
    parts = {"motor": folder / "ideal-motor.toml", "wheel": folder / "ideal-wheel.toml", "gearbox": "single-polynomial"}
    base = Vehicle.load("small-car-electric").with_parts(parts)
    lossless = {f"gearbox.c{i}": 0.0 for i in range(1, 7)} | {"gearbox.ratios_1": 1.0, "gearbox.J": 0.0, "accessories.P_on": 0.0}
    # A pack of so much charge that neither its voltage nor its temperature moves.
    pack = {"battery.capacity_scale": 1000.0, "battery.n_modules": 1000.0, "battery.soc_start": 0.9}
    body = {"body.m": M, "body.c_d": 1.0, "body.A": drag, "body.rho": RHO, "body.g": G, "wheel.f_0": rolling}
    return base.with_values(lossless | pack | body)
