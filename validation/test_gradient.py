"""Derivatives of whole cycles against differences of the exact step, for every vehicle of the library and forty of its numbers."""

import numpy as np
import pytest

from halfshaft.cosim.cycle import Cycle
from halfshaft.cosim.gradient import What, slopes
from halfshaft.cosim.simulate import run, stepper_of
from halfshaft.cosim.ways import Mode
from halfshaft.library.base.errors import InputError
from halfshaft.models.vehicle import Vehicle, vehicle_names

UDDS = Cycle.load("udds")
#: Displacements over a number: the nearer, the fewer kinks and jumps are crossed.
APART = (1e-4, 1e-5, 1e-6, 1e-7)


@pytest.mark.parametrize("mode", ["hybrid", "iteration"])
@pytest.mark.parametrize("name", vehicle_names())
def test_gradients_are_differences(name: str, mode: Mode) -> None:
    rng, car = np.random.default_rng(1), Vehicle.load(name)
    step = stepper_of(car).step
    numbers = sorted(n for n, x in car.values.items() if x != 0 and n != step.tags.the("start speed"))
    numbers = [str(n) for n in rng.choice(numbers, min(40, len(numbers)), replace=False)]
    # A number of the library is often just where two pieces of a map meet; near to it is no kink.
    for number in list(numbers):
        try:
            car = car.displaced({number: car.values[number] * (1 - 1e-3 * rng.uniform(0.5, 1))})
            car.displaced({number: car.values[number] * (1 + APART[0])})
        except InputError:
            numbers.remove(number)
    wanted: list[What] = [(d.name, "integral") for d in step.outputs if d.booking in ("fuel", "stored")]
    found = slopes(car, UDDS, numbers, wanted, mode=mode)
    wrong = {}
    for i, number in enumerate(numbers):
        for share in APART:
            apart = share * abs(car.values[number])
            up, down = (run(car.displaced({number: car.values[number] + s * apart}), UDDS, history=False, mode=mode) for s in (1, -1))
            pairs = {w: ((up.energies[w[0]] - down.energies[w[0]]) / (2 * apart), found.gradient[w][i]) for w in wanted}
            if all(b == pytest.approx(a, rel=1e-5, abs=1e-8 * abs(found.values[w] / car.values[number])) for w, (a, b) in pairs.items()):
                break
        else:
            wrong[number] = pairs
    assert len(numbers) > 25
    assert not wrong
