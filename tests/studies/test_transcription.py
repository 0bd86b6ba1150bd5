import numpy as np
import pytest

from halfshaft import Cycle, InputError, Vehicle
from halfshaft.cosim.simulate import stepper_of
from halfshaft.studies.transcription import transcribe

SHORT = Cycle.load("udds").between(0, 60)


@pytest.fixture(scope="module")
def found():
    """A fuel cell whose fuel is convex in its power, beside a store that loses next to nothing."""
    values = {"battery.capacity_scale": 50.0, "control.always_on": 1.0, "body.m": 1200.0}
    return transcribe(Vehicle.load("small-car-fuel-cell-polarisation").with_values(values), SHORT, widths=(0.03,))


def test_without_losses_a_convex_source_gives_the_same_power_whenever_it_runs(found):
    share, runs = found.commands["control.share"], found.commands["control.run"] > 0
    assert 20 < runs.sum() < 60
    # By Jensen's inequality.  A cell that starts has no auxiliaries yet; and where the store neither gives nor takes there is a kink.
    steady = runs & np.append(False, runs[:-1])
    apart = np.sort(np.abs(share[steady] / np.median(share[steady]) - 1))
    assert apart[-2] < 0.01
    # The grid of dynamic programming is wider than that.
    assert np.ptp(found.optimum.best.commands["control.share"][steady]) > 0.03


def test_the_exact_step_burns_what_the_program_says_and_no_more_than_on_a_fine_grid(found):
    (stage,) = found.stages
    assert found.holds
    assert stage.exact == pytest.approx(found.before, rel=1e-5)
    assert found.goal == min(stage.exact, found.before)
    assert stage.smooth == pytest.approx(stage.exact, rel=1e-4)
    assert found.result["fuel_cell.fuel_used"][-1] == pytest.approx(found.goal, rel=1e-12)
    assert found.result.the("charge")[-1] >= found.optimum.charge(found.optimum.best)[-1] - 1e-6


def test_it_is_drawn_over_dynamic_programming(found):
    drawn = found.plot()
    assert sum(len(ax.lines) >= 2 for ax in drawn.axes) >= 2


def test_few_states_count(found):
    assert found.n_states < 6 < 0.5 * len(stepper_of(found.vehicle).step.states)
    assert found.n_unknowns == found.n_states * 61 + 60


def test_what_is_wrong_is_told_at_once():
    with pytest.raises(InputError) as error:
        transcribe(Vehicle.load("small-car-parallel"), SHORT, {"motor.size": (2, 1)}, widths=(2,), iterations=0)
    assert len(error.value.problems) == 5
    with pytest.raises(InputError, match="nothing is free"):
        transcribe(Vehicle.load("small-car-electric"), SHORT)
