import numpy as np
import pytest

from halfshaft.cosim.cycle import Cycle
from halfshaft.cosim.simulate import parameters_of, stepper_of
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.acceleration import acceleration_cycle
from halfshaft.validation.handwritten import Twin

CAR = Vehicle.load("small-car-electric")
#: Heavy, with little current, rotors and drags everywhere: many limits act.
WEAK = CAR.with_values(
    {
        "body.m": 2000.0, "motor.I_max": 100.0, "motor.J": 0.05, "motor.overtorque": 1.2, "gearbox.J": 0.02, "final_drive.J": 0.1,
        "final_drive.tau_loss": 1.0, "wheel.f_1": 1e-4, "wheel.F_brake_front_max": 2000.0, "battery.soc_start": 0.6,
    }
)  # fmt: skip
#: Full, so that friction brakes do all the braking, and on snow: the tyres are the limit, those of the light rear axle too.
SLIPPERY = CAR.with_values({"wheel.mu_max": 0.2, "body.front_share": 0.8, "battery.soc_start": 1.0})


def cut(samples):
    return samples._replace(grade=0.04 * np.sin(samples.t / 20))


CYCLES = {
    "udds": lambda: Cycle.load("udds").sampled(1.0),
    "us06": lambda: Cycle.load("us06").sampled(1.0),
    "hills": lambda: cut(Cycle.load("hwfet").sampled(1.0)),
    "acceleration": lambda: acceleration_cycle().sampled(0.1),
}


@pytest.mark.parametrize("car", [CAR, WEAK, SLIPPERY], ids=["car", "weak", "slippery"])
@pytest.mark.parametrize("cycle", CYCLES)
def test_hand_written_step_equals_the_generated_one(car, cycle):
    samples, compiled = CYCLES[cycle](), stepper_of(car)
    generated = compiled.march(samples, parameters_of(car, compiled.step, samples.v_start))
    twin = Twin(car)
    by_hand = twin.march(samples)
    assert generated.history is not None
    described = {d.name: (d.unit, i) for i, d in enumerate(compiled.step.outputs)}
    assert set(twin.outputs) <= set(described)
    largest = {}
    for unit, i in described.values():
        largest[unit] = max(largest.get(unit, 0.0), float(np.abs(generated.history[:, i]).max()))
    for j, name in enumerate(twin.outputs):
        unit, i = described[name]
        # Differences of nearly equal numbers have no digits of their own: the largest value of the unit is the scale.
        np.testing.assert_allclose(by_hand.history[:, j], generated.history[:, i], rtol=0, atol=1e-9 * largest[unit], err_msg=name)
        span = largest[unit] * samples.dt.sum()
        assert by_hand.sums[j] == pytest.approx(generated.sums[i], abs=1e-9 * span), name
        assert by_hand.highest[j] == pytest.approx(generated.highest[i], abs=1e-9 * largest[unit]), name


def test_limits_act_in_the_weak_car():
    samples = CYCLES["us06"]()
    twin = Twin(WEAK)
    highest = dict(zip(twin.outputs, twin.march(samples).highest, strict=True))
    assert highest["body.trace_miss"] > 5.0
    assert highest["battery.battery_limited"] == 1.0
