"""The smooth form of the step of every vehicle of the library: how near it is to the exact step, and its derivatives to those of it."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from halfshaft.cosim.cycle import Cycle
from halfshaft.cosim.gradient import What, slopes
from halfshaft.cosim.simulate import parameters_of, stepper_of
from halfshaft.cosim.smooth import smoothed
from halfshaft.models.assembly import Step
from halfshaft.models.vehicle import Vehicle, vehicle_names

CYCLES = ("udds", "us06")
#: Part of fuel and charge used by which a width of 0.0001 may be off.  These two end nearly with the charge that they began with.
NEAR, EVEN = 6e-4, {("large-car-fuel-cell", "udds"): 1e-2, ("small-car-series", "us06"): 2.5e-3}


def used(step: Step, last: Any, first: Any) -> Mapping[str, float]:
    """Return fuel burnt and charge drawn."""
    states = {d.name: i for i, d in enumerate(step.outputs) if d.tag in ("fuel mass", "charge")}
    return {name: last[i] - first[step.state_index[name]] for name, i in states.items()}


@pytest.mark.parametrize("cycle", CYCLES)
@pytest.mark.parametrize("name", vehicle_names())
def test_fuel_and_charge_come_to_those_of_the_exact_step(name: str, cycle: str) -> None:
    car = Vehicle.load(name)
    form, stepper = smoothed(car, Cycle.load(cycle)), stepper_of(car)
    p = parameters_of(car, stepper.step, form.samples.v_start)
    first, exact = stepper.first(p), stepper.march(form.samples, p).last
    expected = used(stepper.step, exact, first)
    apart = []
    for width in (1e-4, 1e-6, 1e-8):
        found = used(form.step, form.march(width).last, first)
        apart.append(max(abs(found[k] - x) / abs(x) for k, x in expected.items() if x != 0))
    assert apart[0] < EVEN.get((name, cycle), NEAR)
    # In proportion to the width.
    assert apart[1:] == pytest.approx([0.01 * apart[0], 1e-4 * apart[0]], rel=0.05)


@pytest.mark.parametrize("name", vehicle_names())
def test_derivatives_come_to_those_of_the_exact_step(name: str) -> None:
    car, cycle = Vehicle.load(name), Cycle.load("udds")
    form = smoothed(car, cycle)
    names = [n for n in ("motor.torque_scale", "engine.torque_scale", "battery.n_modules", "body.c_d", "wheel.r") if n in car.values]
    wanted: list[What] = [(d.name, "last") for d in form.step.outputs if d.tag in ("fuel mass", "charge")]
    exact = slopes(car, cycle, names, wanted).gradient
    found = form.slopes(names, wanted, 1e-6).gradient
    for key, expected in exact.items():
        assert found[key] == pytest.approx(expected, rel=1e-3, abs=1e-3 * np.abs(expected).max() + 1e-12)
