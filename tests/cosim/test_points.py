"""Operating points on maps: where they are, what efficiency stands behind them, and which runs share a map."""

import numpy as np
import pytest

from halfshaft import Cycle, InputError, Vehicle, run
from halfshaft.cosim.points import _machines, plot_points, points


@pytest.fixture(scope="module")
def series():
    return run(Vehicle.load("small-car-series"), Cycle.load("us06"))


def test_points_are_the_machine_s_own_and_a_generator_s_are_its_engine_s(series):
    assert [np.array_equal(a, series[b]) for a, b in zip(points(series, "motor"), ("motor.omega", "motor.tau"), strict=True)] == [
        True,
        True,
    ]
    omega, tau = points(series, "engine")
    assert np.array_equal(omega, series["engine.omega_engine"])
    assert np.array_equal(tau, series["engine.tau_map"])
    assert np.array_equal(points(series, "generator")[0], series["engine.omega"])
    with pytest.raises(InputError, match="body has no omega"):
        points(series, "body")


@pytest.mark.parametrize("part", ["motor", "engine", "generator"])
def test_the_efficiency_is_what_the_run_had_there(series, part):
    """The map's efficiency at the points, weighted by power, is that of the energies in and out."""
    (machine,) = [m for m in _machines(series) if m.part == part]
    from scipy.interpolate import RegularGridInterpolator

    omega, tau = points(series, part)
    work = omega * tau
    drives = work > 0.2 * work.max()
    filled = np.where(np.isfinite(machine.efficiency), machine.efficiency, 0.0)
    there = RegularGridInterpolator((machine.omega, machine.tau), filled, bounds_error=False, fill_value=None)
    map_says = there(np.column_stack([omega, tau]))[drives]
    took = {"motor": series["motor.P_in"], "engine": series["engine.P_fuel"], "generator": series["generator.P_in"]}[part][drives]
    gave = series["generator.P_out"][drives] if part == "generator" else work[drives]
    assert np.sum(map_says * took) / took.sum() == pytest.approx(np.sum(gave) / took.sum(), rel=0.02)


def test_scaled_machines_have_scaled_maps():
    plain, large = Vehicle.load("small-car-electric"), Vehicle.load("small-car-electric").with_values({"motor.torque_scale": 1.5})
    short = Cycle.load("nycc").between(0, 60)
    one, other = (_machines(run(car, short))[0] for car in (plain, large))
    np.testing.assert_allclose(other.tau, 1.5 * one.tau)
    assert one.key != other.key


def test_runs_of_one_map_share_a_panel(series, tmp_path):
    car, us06 = Vehicle.load("small-car-electric"), Cycle.load("us06")
    light, heavy = run(car, us06), run(car.with_values({"body.m": 1500}), us06)
    figure = plot_points(light, heavy, series, units="us", path=tmp_path / "points.png")
    titles = [ax.get_title(loc="left") for ax in figure.axes if ax.axison]
    assert [t.partition(":")[0] for t in titles] == ["motor", "engine", "generator"]
    dots = [line for line in figure.axes[0].lines if line.get_marker() in ("o", "s", "^")]
    assert len(dots) == 3
    assert figure.axes[0].get_ylabel() == "torque [lbf ft]"
    moves = (light["motor.omega"] > 1e-6) & (np.abs(light["motor.tau"]) > 1e-9)
    np.testing.assert_allclose(dots[0].get_ydata(), light["motor.tau"][moves] / 1.3558179483314004)
    np.testing.assert_allclose(dots[0].get_xdata(), light["motor.omega"][moves] * 30 / np.pi)
    assert len(plot_points(series, parts=["engine"]).axes) == 1


def test_what_cannot_be_drawn_is_said(series):
    with pytest.raises(InputError, match="no part motr has a map over speed and torque, did you mean 'motor'"):
        plot_points(series, parts=["motr"])
    with pytest.raises(InputError, match="there is no run to draw"):
        plot_points()
    bare = run(Vehicle.load("small-car-electric"), Cycle.load("nycc"), history=False)
    with pytest.raises(InputError, match="no time series"):
        plot_points(bare)
