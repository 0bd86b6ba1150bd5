"""Flows of energy: they close at every part, agree with sums made by hand, and are drawn as wide as they are."""

import numpy as np
import pytest
from matplotlib.patches import Rectangle

from halfshaft import Cycle, InputError, Result, Vehicle, run
from halfshaft.cosim.cycle import Cycle as Road
from halfshaft.cosim.flow_plot import _THICK, _Layout, _thickest, plot_flows
from halfshaft.cosim.flows import flows

CARS = ("small-car-series", "small-car-power-split", "small-car-electric", "small-car-conventional")


@pytest.fixture(scope="module")
def runs():
    return {car: run(Vehicle.load(car), Cycle.load("us06")) for car in CARS}


@pytest.mark.parametrize("car", CARS)
def test_every_part_gives_what_it_takes(runs, car):
    found = flows(runs[car])
    assert len(found.stations) > 4
    assert max(abs(found.open(name)) for name in found.stations) < 1e-12 * found.turnover
    account = runs[car].account
    assert sum(s.lost for s in found.stations.values()) == pytest.approx(sum(account.losses.values()))
    assert sum(s.burnt for s in found.stations.values()) == pytest.approx(account.fuel)
    assert sum(s.drawn - s.charged for s in found.stations.values()) == pytest.approx(account.battery)


def test_what_went_forth_and_back_is_the_sum_of_each_sign(runs):
    result = runs["small-car-electric"]
    (flow,) = [f for f in flows(result).flows if f.load == "gearbox"]
    power = result["motor.P_out"]
    forth = sum(float(p) for p in power if p > 0)
    back = sum(-float(p) for p in power if p < 0)
    assert (flow.supply, flow.carrier) == ("motor", "Shaft")
    assert (flow.forth, flow.back) == (pytest.approx(forth), pytest.approx(back))
    assert back > 0.1 * forth


def test_parts_that_only_pass_on_are_left_out_and_their_neighbours_joined(runs):
    found = flows(runs["small-car-electric"])
    assert not {"bus", "final_drive"} & found.stations.keys()
    assert {(f.supply, f.load) for f in found.flows} >= {("battery", "accessories"), ("gearbox", "wheel")}
    # Where it joins two sources it is there.
    assert "bus" in flows(runs["small-car-series"]).stations


def test_an_engine_that_never_ran_is_not_there():
    # On a short and slow trip a plug-in drives on its battery.
    found = flows(run(Vehicle.load("small-car-plug-in-series"), Cycle.load("nycc").between(0, 100)))
    assert not any(s.burnt for s in found.stations.values())
    assert "engine" not in found.stations


def test_without_time_series_flows_are_netted_and_still_close(runs):
    car = "small-car-power-split"
    net = flows(run(Vehicle.load(car), Cycle.load("us06"), history=False))
    assert max(abs(net.open(name)) for name in net.stations) < 1e-12 * net.turnover
    gross = {(f.supply, f.load): f.forth - f.back for f in flows(runs[car]).flows}
    for f in net.flows:
        assert f.forth == 0 or f.back == 0
        assert f.forth - f.back == pytest.approx(gross[f.supply, f.load], rel=1e-9)


def test_a_loaded_run_flows_as_it_did(runs, tmp_path):
    result = runs["small-car-series"]
    read = Result.load(result.save(tmp_path / "run.nc"))
    assert flows(read) == flows(result)
    assert read.vehicle.values == result.vehicle.values
    assert read.vehicle.structure == result.vehicle.structure


@pytest.mark.parametrize("car", CARS)
def test_the_picture_is_as_wide_as_the_energy_and_parts_do_not_overlap(runs, car):
    found = flows(runs[car])
    lay = _Layout(found, _THICK / _thickest(found))
    # Bars are as high as the larger side, and no higher than the room.
    assert _THICK <= max(lay.height.values()) <= _THICK + 0.3
    for name, s in lay.stations.items():
        if name != lay.road:
            into = s.burnt + s.drawn + sum(f.forth for f in lay.into[name]) + sum(f.back for f in lay.out[name])
            out = s.charged + sum(f.back for f in lay.into[name]) + sum(f.forth for f in lay.out[name]) + s.lost + s.rest
            assert into == pytest.approx(out)
    boxes = [(lay.column[name], lay.top[name], lay.top[name] + lay.height[name]) for name in lay.stations]
    assert not [
        (one, other) for i, one in enumerate(boxes) for other in boxes[:i] if one[0] == other[0] and one[1] < other[2] and other[1] < one[2]
    ]
    figure = plot_flows(runs[car])
    (ax,) = figure.axes
    said = [text.get_text() for text in ax.texts]
    assert any(text.startswith("rolling resistance") for text in said)
    assert any("open by" in text for text in said)
    box = figure.bbox
    for text in ax.texts:
        e = text.get_window_extent()
        assert e.x0 >= 0
        assert e.x1 <= box.width
        assert e.y0 >= 0
        assert e.y1 <= box.height


def test_several_runs_are_drawn_to_the_same_scale(runs):
    several = [runs[car] for car in ("small-car-electric", "small-car-series")]
    (ax,) = plot_flows(*several, labels=["one", "other"]).axes
    assert {"2 runs", "one", "other"} <= {text.get_text() for text in ax.texts}
    assert sum("open by" in text.get_text() for text in ax.texts) == 2
    found = [flows(r) for r in several]
    scale = _THICK / max(map(_thickest, found))
    bars = sorted(patch.get_height() for patch in ax.patches if isinstance(patch, Rectangle))
    assert bars == pytest.approx(sorted(h for each in found for h in _Layout(each, scale).height.values()))


def test_a_run_that_moves_nothing_and_a_file_that_is_none_are_refused():
    still = Road(name="still", time=np.array([0.0]), speed=np.array([0.0]))
    with pytest.raises(InputError, match="moved no energy"):
        flows(run(Vehicle.load("small-car-electric"), still))
    with pytest.raises(InputError) as e:
        plot_flows(path="flows.txt", labels=["a"])
    assert [p.partition(",")[0] for p in e.value.problems] == [
        "a plot is written as .png", "there is no run to draw", "1 labels for 0 runs"
    ]  # fmt: skip
