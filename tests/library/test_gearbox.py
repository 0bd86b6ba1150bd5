import numpy as np
import pytest

from halfshaft.library.base.ports import Shaft
from halfshaft.library.files.component_file import read_component
from halfshaft.models.assembly import StepDirection, step_turning


def gearbox(name, **values):
    file = read_component(name)
    return file.component(file.build(**values))


def trip(part, tau, omega, offered, gear=2):
    """Return the input point that an output point asks for, and the output torque and the loss when another torque is offered."""
    faces = {f.name: f for f in part.faces()}
    signals = {"ratio": part.p.ratios[gear - 1], "gear": float(gear), "turning": step_turning, "direction": StepDirection()}
    way = faces["required"].run(output=Shaft(tau, omega, 0.0), **signals)
    back = faces["available"].run(input=way["input"]._replace(tau=offered), _way=way["_way"], dt=1.0)
    return way["input"], float(back["output"].tau), float(back["P_loss"])


@pytest.mark.parametrize("name", ["five-speed-map", "five-speed-polynomial"])
def test_no_torque_that_comes_back_makes_power(name):
    part, rng = gearbox(name), np.random.default_rng(1)
    for tau, omega, offered in zip(rng.uniform(-300, 300, 300), rng.uniform(0, 100, 300), rng.uniform(-100, 100, 300), strict=True):
        _, _, loss = trip(part, tau, omega, offered)
        assert loss >= -1e-9 * abs(offered * omega), (tau, omega, offered)


def test_reversed_torque_loses_the_share_that_the_required_torque_lost():
    part = gearbox("five-speed-map")
    asked, ratio = 200.0, part.p.ratios[1]
    source, _, _ = trip(part, asked, 50.0, 0.0)
    share = 1 - asked / (ratio * float(source.tau))
    _, dragged, _ = trip(part, asked, 50.0, -10.0)
    assert 0 < share < 0.2
    assert dragged == pytest.approx(-10 * ratio * (1 + share))
    _, driven, _ = trip(part, asked, 50.0, 10.0)
    assert driven == pytest.approx(10 * ratio * (1 - share))


def test_both_floors_at_zero_read_the_map_as_the_original_does():
    part, tau, omega = gearbox("single-map", omega_lookup=0.0, e_lowest=0.0), 5.0, 5.0
    ratio = part.p.ratios[0]
    assert float(part.p.efficiency(omega, tau, 1.0)) == 0
    source, _, loss = trip(part, tau, omega, 0.0, gear=1)
    # Zero efficiency: the loss torque is the output's times the ratio.
    assert float(source.tau) == pytest.approx(tau * (1 / ratio + ratio))
    assert loss == 0
    braking, _, _ = trip(part, -tau, 0.5, 0.0, gear=1)
    e = float(part.p.efficiency(0.5, -tau, 1.0))
    assert float(braking.tau) == pytest.approx(-tau * e / ratio)
    # With the floors a map is read at 5 rad/s, and as 0.05 at least.
    floored = gearbox("single-map")
    assert float(trip(floored, 50.0, 1.0, 0.0, gear=1)[0].tau) == pytest.approx(50 / (ratio * float(floored.p.efficiency(5.0, 50.0, 1.0))))
    assert float(trip(floored, tau, omega, 0.0, gear=1)[0].tau) == pytest.approx(tau / (0.05 * ratio))


@pytest.mark.parametrize("name", ["single-map", "five-speed-map", "five-speed-si-map", "five-speed-ci-map"])
def test_a_map_without_floors_stays_finite(name):
    part = gearbox(name, omega_lookup=0.0, e_lowest=0.0)
    for omega in (0.0, 0.01, 1.0, 5.0, 100.0):
        for tau in (-500.0, -5.0, -0.01, 0.0, 0.01, 5.0, 500.0):
            for offered in (-50.0, 0.0, 50.0):
                source, given, loss = trip(part, tau, omega, offered, gear=1)
                assert np.isfinite([float(source.tau), given, loss]).all()
                assert loss >= -1e-9 * abs(offered * omega)


@pytest.mark.parametrize("name", ["five-speed-map", "five-speed-polynomial"])
def test_more_torque_than_was_sent_for_loses_no_more_than_was_required(name):
    part = gearbox(name)
    for asked in (0.1, 1.0, 20.0):
        source, _, _ = trip(part, asked, 50.0, 0.0)
        loss = float(source.tau) * float(source.omega) - asked * 50.0
        _, delivered, lost = trip(part, asked, 50.0, 60.0)
        assert loss > 0
        assert lost == pytest.approx(loss, rel=1e-9)
        assert delivered > asked
