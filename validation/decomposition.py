"""Why a conventional car burns more in the forward-facing model than in the step: one cause after the other taken away.

``python -m halfshaft.validation.decomposition`` prints the table of the manual's page on the forward-facing model; it takes
minutes.  The experiments are

* the forward-facing model as it is: controls sampled each 0.1 s, shifts that interrupt the torque;
* without interruption: its own gears, shifts that take no time;
* with the step's gears: in each second the gear that the step at 1 s had, without interruption;
* the same against the step at 0.1 s with those gears, so that only the plant is different.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from halfshaft.cosim.compiled import Array, Stepper
from halfshaft.cosim.cycle import Cycle, Samples
from halfshaft.cosim.forward import Driver, Forward
from halfshaft.cosim.simulate import parameters_of, run, stepper_of
from halfshaft.library.base.tags import part_of
from halfshaft.models.assembly import Step
from halfshaft.models.vehicle import Vehicle

#: Longer than any cycle [s]: the shift logic changes nothing by itself.
NEVER = 1e12


class Fuel(NamedTuple):
    """Fuel of one car over one cycle [kg], experiment by experiment."""

    step: float
    step_short: float
    step_gears: float
    forward: float
    forward_prompt: float
    forward_gears: float


class Geared:
    """A step whose gear is given from outside, sample by sample; it shifts in no time."""

    def __init__(self, inner: Stepper, gears: Array) -> None:
        self.inner, self.step, self.gears, self.k = inner, inner.step, gears, 0

    def first(self, parameters: Array) -> Array:
        """Return the start state."""
        return self.inner.first(parameters)

    def __call__(self, state: Array, request: Array, parameters: Array) -> tuple[Array, Array]:
        """Return next state and outputs of one step in the gear of this sample."""
        state = np.array(state)
        state[self.step.state_index[f"{part_of(self.step.tags.the('gear'))}.gear_before"]] = self.gears[min(self.k, len(self.gears) - 1)]
        self.k += 1
        return self.inner(state, request, parameters)


def fuel_of(car: Vehicle, cycle: Cycle) -> Fuel:
    """Return the fuel of all experiments.

    Parameters
    ----------
    car
        A car with an engine and a gearbox with a shift logic.
    cycle
        A cycle of points 1 s apart.

    """
    whole, driver = run(car, cycle), Driver()
    fuel = whole.tags.the("fuel mass")
    fine = cycle.sampled(driver.dt)
    # The gear of the step in which each short step lies.
    at = np.searchsorted(whole.time, fine.t - 1e-6)
    gears = whole.the("gear")[np.minimum(at, len(whole.time) - 1)]
    forward = Forward(car.model(), car.title)
    parameters = parameters_of(car, forward.stepper.step, fine.v_start)

    def driven(driver: Driver, gears: Array | None = None) -> float:
        made = Forward(car.model(), car.title, driver=driver)
        if gears is not None:
            made.stepper = Geared(made.stepper, gears)  # type: ignore[assignment]
        done = made.run(fine, parameters)
        return float(done.state[[d.name for d in made.plant.states].index(fuel)])

    return Fuel(
        step=whole.last[fuel],
        step_short=run(car, cycle, dt=driver.dt, mode="refined").last[fuel],
        step_gears=_stepped(stepper_of(car), fine, parameters, gears),
        forward=driven(driver),
        forward_prompt=driven(Driver(t_shift=0.0)),
        forward_gears=driven(Driver(t_shift=0.0, t_hold=NEVER), gears),
    )


def _stepped(stepper: Stepper, samples: Samples, parameters: Array, gears: Array) -> float:
    """Return the fuel of the hybrid step with given gears [kg]."""
    step: Step = stepper.step
    parameters = parameters.copy()
    parameters[step.parameter_index[step.tags.the("hold time")]] = NEVER
    geared = Geared(stepper, gears)
    state = geared.first(parameters)
    for k in range(len(samples.t)):
        state, _ = geared(state, np.array([samples.v[k], samples.grade[k], samples.key_on[k], samples.dt[k], 0.0]), parameters)
    return float(state[step.state_index[step.tags.the("fuel mass")]])


#: Each line: what it is, the experiment, and what it is held against.
LINES = (
    ("forward-facing, as it is", "forward", "step"),
    ("without interruption", "forward_prompt", "step"),
    ("with the step's gears, without interruption", "forward_gears", "step"),
    ("step at 0.1 s with the same gears", "step_gears", "step"),
    ("forward-facing against that: the plant alone", "forward_gears", "step_gears"),
    ("step at 0.1 s, its own gears, refined", "step_short", "step"),
)


def main() -> None:
    """Print the table."""
    car = Vehicle.load("small-car-conventional")
    cycles = ("udds", "hwfet", "us06")
    fuels = [fuel_of(car, Cycle.load(name)) for name in cycles]
    print(f"| fuel | {' | '.join(name.upper() for name in cycles)} |\n|---|---|---|---|")
    for title, of, against in LINES:
        cells = (f"{100 * (getattr(fuel, of) / getattr(fuel, against) - 1):+.2f} %" for fuel in fuels)
        print(f"| {title} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
