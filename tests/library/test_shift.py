import pytest
from faces import in_turn

from halfshaft.library.base.interfaces import Machine
from halfshaft.library.files.component_file import read_component


class Steady(Machine):
    def tau_envelope(self, omega):
        return 100.0


MACHINE = Steady()
RATIOS = (13.45, 7.57, 5.01, 3.77, 2.84)


def shift(**values):
    file = read_component("shift-conventional")
    return file.component(file.build(**values))


class Box:
    """A gearbox that is driven at one engine speed, whatever the gear; `load` is the torque over the envelope's 100 N.m."""

    def __init__(self, part, dt):
        self.part, self.dt = part, dt
        self.state = {k: v for k, v in part.start().items() if k != "omega_estimate"}

    def step(self, omega_engine, load):
        ratio = RATIOS[int(self.state["gear_before"]) - 1]
        given = in_turn(
            self.part, "demand", "compare", "control", tau_gearbox=100 * load * ratio,
            omega_gearbox=omega_engine / ratio, slip_limited=0.0, trace_missed=0.0, torque_ratio=1.0,
            ratios=RATIOS, machine=MACHINE, dt=self.dt, decided=0.0, omega_estimate=0.0, **self.state,
        )  # fmt: skip
        self.state = {k: float(given[f"next_{k}"]) for k in self.state}
        return int(self.state["gear_before"])


@pytest.mark.parametrize("dt", [1.0, 0.5, 0.1, 0.01])
def test_a_raised_gear_is_kept_for_two_seconds_at_any_step(dt):
    box = Box(shift(), dt)
    assert box.step(300.0, 0.1) == 2
    kept = 0
    # Nearly full load at a low speed: down at once, if it may.
    while box.step(120.0, 0.95) == 2:
        kept += 1
        assert kept * dt < 10
    assert kept * dt == pytest.approx(2.0)
    # What was lowered may be lowered again.
    box.state["gear_before"] = 3.0
    assert [box.step(120.0, 0.95) for _ in range(2)] == [2, 1]


def test_a_gear_that_was_not_raised_is_lowered_at_once():
    box = Box(shift(), 0.1)
    box.state["gear_before"] = 4.0
    assert box.step(120.0, 0.95) == 3


def test_the_time_in_a_raised_gear_is_a_number_of_the_shift():
    box = Box(shift(t_raised=0.0), 0.1)
    assert [box.step(300.0, 0.1), box.step(120.0, 0.95)] == [2, 1]


@pytest.mark.parametrize(("signal", "seen"), [({}, 300.0), ({"slip_limited": 1.0}, 200.0), ({"trace_missed": 1.0}, 200.0)])
def test_a_request_out_of_reach_shifts_by_the_speed_that_was_reached(signal, seen):
    part, known = shift(), {"slip_limited": 0.0, "trace_missed": 0.0, "torque_ratio": 1.0, "dt": 0.1, "decided": 0.0, **signal}
    state = {"gear_before": 1.0, "raised": 0.0, "t_since_shift": 15.0, "omega_estimate": 200.0}
    given = in_turn(
        part, "demand", tau_gearbox=50 * RATIOS[0], omega_gearbox=300.0 / RATIOS[0], ratios=RATIOS, machine=MACHINE, **known, **state
    )
    assert float(given["omega_input_estimate"]) == pytest.approx(seen)
