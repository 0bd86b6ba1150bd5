import numpy as np
import pytest

from halfshaft.library.control.power_follower import PARTS
from halfshaft.models.vehicle import Vehicle

FOLLOWER = Vehicle.load("small-car-series-follower")


class Control:
    """The power follower, fed with a demand and a charge; `step` returns what it decided."""

    def __init__(self, dt=1.0, **values):
        parts = FOLLOWER.with_values({f"control.{name}": x for name, x in values.items()}).components()
        self.part, self.engine, self.generator, self.dt = parts["control"], parts["engine"], parts["generator"], dt
        self.state = {name: float(x) for name, x in self.part.start().items()}
        self.P_min, self.P_max = (s * self.engine.P_largest for s in (self.part.p.P_min_share, self.part.p.P_max_share))

    def step(self, P_bus, soc=0.6, P_battery_max=1e5, P_battery_min=-1e5):
        known = {
            "P_bus": P_bus, "soc_before": soc, "P_battery_max": P_battery_max, "P_battery_min": P_battery_min, "key_on": 1.0, "dt": self.dt,
            "engine": self.engine, "generator": self.generator, **self.state,
        }  # fmt: skip
        waiting = list(self.part.faces())
        while waiting:
            ready = next(f for f in waiting if known.keys() >= set(f.takes))
            waiting.remove(ready)
            known |= ready.run(**{name: known[name] for name in ready.takes})
        given = {name: x for name, x in known.items() if name.startswith("next_") or name in [v.name for v in self.part.variables]}
        self.state = {name: float(given[f"next_{name}"]) for name in self.state}
        return {name: float(x) for name, x in given.items()}

    def bus_power(self, P_engine):
        """Return the bus power that asks for an engine power at the middle of the window (the generator is 95 % efficient)."""
        return 0.95 * P_engine


@pytest.mark.parametrize("dt", [1.0, 0.5, 0.1])
def test_the_engine_may_start_in_the_step_that_ends_at_its_least_time_off(dt):
    control, n = Control(dt), 0
    while not control.step(20e3)["engine_on"]:
        n += 1
    assert (n + 1) * dt == pytest.approx(control.part.p.t_off_min)


@pytest.mark.parametrize("dt", [1.0, 0.5])
def test_after_a_stop_the_time_off_counts_from_the_step_behind_it(dt):
    control = Control(dt, on_start=1.0)
    assert control.step(20e3)["engine_on"]
    assert not control.step(0.0, soc=0.85)["engine_on"]
    n = 0
    while not control.step(20e3)["engine_on"]:
        n += 1
    # The step behind the stop counts 0, that n steps later n dt.
    assert n * dt == pytest.approx(control.part.p.t_off_min)


def test_the_engine_restarts_on_a_demand_above_one_and_a_fifth_of_its_lowest_power():
    for factor, starts in ((1.19, False), (1.21, True)):
        control = Control(t_off_min=10.0)
        P_bus = control.bus_power(factor * control.P_min)
        assert control.step(P_bus)["P_engine_request"] == pytest.approx(factor * control.P_min, rel=2e-3)
        assert any(control.step(P_bus)["engine_on"] for _ in range(60)) == starts


def test_the_average_holds_five_seconds_and_not_the_present_step():
    control = Control(t_off_min=0.0)
    P_bus = control.bus_power(2 * control.P_min)
    # Of five seconds three must ask for twice the lowest power: 3 * 2 / 5 = 1.2.
    started = [bool(control.step(P_bus * 1.001)["engine_on"]) for _ in range(PARTS)]
    assert started == [False, False, False, True, True]


@pytest.mark.parametrize("dt", [1.0, 0.1])
def test_engine_power_is_slewed_up_and_down_and_not_in_its_first_step(dt):
    control = Control(dt, on_start=1.0)
    rise, fall = control.part.p.P_rise, control.part.p.P_fall
    first = control.step(control.bus_power(control.P_min))
    assert control.state["P_before"] == pytest.approx(control.P_min, rel=2e-3)
    assert first["engine_on"]
    up, down = [], []
    for _ in range(3):
        before = control.state["P_before"]
        control.step(1e6)
        up.append(control.state["P_before"] - before)
    for _ in range(2):
        before = control.state["P_before"]
        control.step(0.0)
        down.append(control.state["P_before"] - before)
    assert up == pytest.approx([rise * dt] * 3)
    assert down == pytest.approx([-fall * dt] * 2)
    assert rise != fall


def test_normal_power_is_cut_unless_the_battery_is_short():
    control = Control(on_start=1.0)
    control.step(30e3)
    assert control.state["P_before"] == pytest.approx(control.P_max)
    short = Control(on_start=1.0)
    short.step(30e3, P_battery_max=20e3)
    assert short.state["P_before"] == pytest.approx(30e3 / 0.95, rel=0.02)
    assert short.state["P_before"] > control.P_max


def test_the_controller_of_the_generator_limits_its_current():
    from halfshaft.library.base.ports import Shaft

    generator = FOLLOWER.components()["generator"]
    known = {"omega_before": 400.0, "dt": 1.0}
    free = generator.available(Shaft(80.0, 400.0, 0.0), U_supply=300.0, **known)
    cut = generator.available(Shaft(80.0, 400.0, 0.0), U_supply=30.0, **known)
    assert float(free["dc"].P) == pytest.approx(0.95 * 80 * 400)
    assert float(cut["dc"].P) == pytest.approx(generator.p.I_max * 30.0)
    assert float(cut["P_loss"]) == pytest.approx(80 * 400 - generator.p.I_max * 30.0)
    assert np.isclose(float(cut["P_kinetic"]), 0)
