"""Pictures of runs: what panels there are, what they show, and whose axes they use."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from matplotlib.figure import Figure

from halfshaft import Cycle, InputError, Vehicle, plot_run, run
from halfshaft.cosim.plot import COLOURS, _bars
from halfshaft.cosim.plot import labels_of as names_of


@cache
def done(car="small-car-electric", cycle="us06", **values):
    vehicle = Vehicle.load(car)
    return run(vehicle.with_values({f"body.{k}": x for k, x in values.items()}) if values else vehicle, Cycle.load(cycle))


def labels_of(figure):
    return [ax.get_ylabel() for ax in figure.axes]


def texts_of(figure):
    return [text.get_text() for text in figure.texts]


@pytest.mark.parametrize(
    ("car", "cycle", "panels"),
    [
        ("small-car-electric", "us06", ["speed [km/h]", "power [kW]", "charge [%]"]),
        ("small-car-conventional", "us06", ["speed [km/h]", "power [kW]", "gear"]),
        ("small-car-series", "hwfet-mtn", ["speed [km/h]", "grade [%]", "power [kW]", "charge [%]"]),
    ],
)
def test_a_run_has_the_panels_of_its_parts_and_road(car, cycle, panels):
    figure = plot_run(done(car, cycle))
    assert isinstance(figure, Figure)
    assert labels_of(figure) == [*panels, ""]
    assert figure.axes[-1].get_title(loc="left") == "Where the energy went [Wh]"


@pytest.mark.parametrize(
    ("car", "powers"),
    [
        ("small-car-electric", ["motor input", "battery"]),
        ("small-car-series", ["engine", "motor input", "battery"]),
        ("small-car-conventional", ["engine"]),
    ],
)
def test_the_powers_are_those_of_sources_and_of_the_machine_at_the_wheels(car, powers):
    (ax,) = plot_run(done(car), panels="power").axes
    assert [text.get_text() for text in ax.get_legend().get_texts()] == powers
    assert ax.lines[-1].get_ydata() == [0, 0]


def test_the_grade_is_that_of_the_road():
    result = done("small-car-series", "hwfet-mtn")
    road = Cycle.load("hwfet-mtn").grade_by_distance
    (ax,) = plot_run(result, panels="grade").axes
    (line, _) = ax.lines
    there = np.isfinite(line.get_ydata())
    assert there.sum() > 700
    # The step reads the road at its start, and climbs by the sine where the grade is the tangent.
    before = np.concatenate([[0.0], result["body.distance"][:-1]])
    assert np.allclose(line.get_ydata()[there], 100 * np.interp(before, *road)[there], atol=1e-6)


def test_the_grades_of_two_runs_have_the_colours_of_the_runs():
    runs = [done(car, "hwfet-mtn") for car in ("small-car-series", "small-car-series-follower")]
    (ax,) = plot_run(*runs, panels="grade").axes
    assert [line.get_color() for line in ax.lines[:2]] == list(COLOURS[:2])
    # The axis is at level road.
    assert ax.lines[2].get_ydata() == [0, 0]


def test_runs_over_each_other_have_one_line_each_and_their_names():
    runs = [done("small-car-electric"), done("small-car-series"), done("small-car-conventional")]
    figure = plot_run(*runs)
    labels = ["speed [km/h]", "engine [kW]", "motor input [kW]", "battery [kW]", "charge [%]", "gear", ""]
    assert labels_of(figure) == labels
    assert [len(ax.lines) for ax in figure.axes[1:6]] == [2, 2, 2, 2, 1]
    # The request is common, so it is there once.
    assert len(figure.axes[0].lines) == 4
    assert {"3 runs", "us06, hybrid step of 1 s", *(r.inputs.vehicle for r in runs)} <= set(texts_of(figure))


def test_names_of_runs_say_what_differs():
    light, heavy, other = done(), done(m=1600), done(cycle="nycc")
    assert names_of([light, other]) == ["us06", "nycc"]
    assert names_of([light, heavy]) == ["body.m = 1144", "body.m = 1600"]
    assert names_of([light, light, heavy]) == ["body.m = 1144 (1)", "body.m = 1144 (2)", "body.m = 1600"]
    assert names_of([light, heavy, other]) == ["us06, body.m = 1144", "us06, body.m = 1600", "nycc"]
    assert {"before", "after"} <= set(texts_of(plot_run(light, heavy, labels=["before", "after"])))


@pytest.mark.parametrize("others", [(), ("small-car-electric",), ("small-car-series-follower",)])
def test_no_line_of_the_head_leaves_the_picture_or_meets_another(others):
    figure = plot_run(done("small-car-series"), *(done(car, "hwfet-mtn") for car in others), panels="speed")
    extents = [text.get_window_extent() for text in figure.texts if text.get_text()]
    assert all(e.x0 >= 0 and e.x1 <= figure.bbox.width for e in extents)
    assert not any(a.overlaps(b) for i, a in enumerate(extents) for b in extents[:i])


def test_any_output_is_a_panel_in_the_units_of_a_reader():
    result = done()
    figure = plot_run(result, panels=("battery.T", "motor.P_out"))
    assert labels_of(figure) == ["battery.T [\u00b0C]", "motor.P_out [kW]"]
    assert np.allclose(figure.axes[0].lines[0].get_ydata(), result["battery.T"] - 273.15)
    assert np.allclose(figure.axes[1].lines[0].get_ydata(), result["motor.P_out"] / 1000)


@pytest.mark.parametrize(("copies", "unit", "start", "end"), [(1, "s", 3600, 4200), (4, "min", 60, 100), (30, "h", 1, 6)])
def test_long_runs_count_minutes_or_hours(copies, unit, start, end):
    us06 = Cycle.load("us06")
    speed = np.concatenate([[0.0], *[us06.speed[1:]] * copies])
    result = run(Vehicle.load("small-car-conventional"), replace(us06, time=np.arange(len(speed)) + 3600.0, speed=speed))
    (ax,) = plot_run(result, panels="speed").axes
    assert ax.get_xlabel() == f"time [{unit}]"
    assert ax.get_xlim() == pytest.approx((start, end))


def test_axes_of_the_user_are_drawn_into():
    figure = Figure()
    one, two = figure.subplots(2)
    assert plot_run(done(), panels=("speed", "charge"), axes=(one, two)) is figure
    assert (one.get_ylabel(), two.get_ylabel()) == ("speed [km/h]", "charge [%]")
    assert len(figure.axes) == 2
    assert plot_run(done(), panels="energy", axes=one) is figure


def test_a_notebook_shows_the_picture():
    assert plot_run(done(), panels="speed")._repr_png_().startswith(b"\x89PNG")


def test_what_cannot_be_drawn_is_said_at_once():
    with pytest.raises(InputError) as e:
        plot_run(done(), panels=("sped", "gear"), axes=Figure().subplots())
    assert e.value.problems[0] == "there is no panel 'sped', did you mean 'speed'?"
    assert e.value.problems[1].startswith("there is no panel 'gear'")
    assert e.value.problems[2] == "1 axes for 2 panels: sped, gear"
    with pytest.raises(InputError, match="8 runs, at most 7 can be told apart\n  3 labels for 8 runs"):
        plot_run(*[done()] * 8, labels=["a", "b", "c"])


def test_the_speed_lies_over_the_request_and_what_was_missed_is_marked():
    result = done("small-car-conventional", m=3000)
    (ax,) = plot_run(result, panels="speed").axes
    wanted, achieved = 3.6 * result.the("request"), 3.6 * result.the("speed")
    asked, driven = (line.get_ydata() for line in ax.lines)
    assert np.allclose(asked, wanted)
    assert np.allclose(driven, achieved)
    missed = wanted - achieved > 3.6 * result.inputs.parameters[result.tags.the("miss threshold")]
    assert missed.sum() > 10
    (marks,) = ax.collections
    spans = np.array([(path.vertices[:, 0].min(), path.vertices[:, 0].max()) for path in marks.get_paths()])
    assert np.allclose(spans, np.column_stack([result.time - 1, result.time])[missed])
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["requested", "achieved", "trace missed"]


def test_a_request_that_nobody_can_follow_does_not_flatten_what_was_achieved():
    full = Cycle(name="full", time=np.array([0.0, 1, 20]), speed=np.array([0.0, 100, 100]))
    result = run(Vehicle.load("small-car-electric"), full)
    (ax,) = plot_run(result, panels="speed").axes
    assert ax.get_ylim() == pytest.approx((0, 1.1 * 1.25 * 3.6 * result.the("speed").max()))
    (ax,) = plot_run(done(), panels="speed").axes
    assert ax.get_ylim() == pytest.approx((0, 1.1 * 3.6 * done().the("request").max()))


@pytest.mark.parametrize("cars", [("small-car-electric",), ("small-car-electric", "small-car-series", "small-car-conventional")])
def test_bars_of_runs_lie_one_below_the_other_around_their_label(cars):
    (ax,) = plot_run(*map(done, cars), panels="energy").axes
    labels = [text.get_text() for text in ax.get_yticklabels()]
    bottom, top = ax.get_ylim()
    assert top < -0.5 < len(labels) - 0.5 < bottom
    middles = [bar.get_y() + bar.get_height() / 2 for bar in ax.patches]
    places = {round(y - label, 9) for y in middles for label in range(len(labels)) if abs(y - label) < 0.5}
    thick = 0.84 / len(cars)
    assert sorted(places) == pytest.approx([0] if len(cars) == 1 else [-thick, 0, thick])
    # No two on top of each other.
    assert min(np.diff(sorted(middles))) > 0.9 * thick
    for car in cars:
        lost = {bar.label: bar.energy / 3600 for bar in _bars(done(car))}
        assert set(lost) <= set(labels)
        widths = [bar.get_width() for bar in ax.patches]
        assert all(any(x == pytest.approx(width) for width in widths) for x in lost.values())
