"""Main effects, Sobol's indices and pictures of sweeps whose answers are known in closed form."""

from dataclasses import dataclass

import matplotlib.image
import numpy as np
import pytest
from scipy.stats import sobol_indices as by_scipy
from scipy.stats import uniform

from halfshaft import InputError, Vehicle
from halfshaft.studies.effects import Constraint, main_effects, sobol_indices
from halfshaft.studies.pictures import plot_sweep
from halfshaft.studies.sweep import sweep
from halfshaft.studies.task import Found

CAR = Vehicle.load("small-car-electric")
GRID = {"body.m": "1000..1600:4", "body.c_d": "0.2..0.4:5", "motor": "ac-75kw,ac-83kw"}
STEP = {"ac-75kw": 0.0, "ac-83kw": -50.0}


@dataclass(frozen=True)
class Plane:
    """A figure that is linear in mass, drag and area, with a step between motors; another one is missing for heavy cars."""

    name: str = "plane"

    def __call__(self, car):
        v = car.values
        y = 0.1 * v["body.m"] + 1000 * v["body.c_d"] + 10 * v["body.A"] + STEP[car.parts["motor"].name]
        return Found({"y_s": y, "gap_s": None if v["body.m"] > 1300 else 1.0, "same": 1.0})


@dataclass(frozen=True)
class Ishigami:
    """The function of Ishigami and Homma, whose indices are known."""

    name: str = "ishigami"

    def __call__(self, car):
        x = [2 * np.pi * (car.values[name] - low) / (high - low) - np.pi for name, low, high in CUBE]
        return Found({"y": ishigami(np.array(x)), "gap": None if x[0] > 0 else 1.0})


CUBE = (("body.m", 1000.0, 2000.0), ("body.c_d", 0.2, 0.4), ("body.A", 1.0, 3.0))


def ishigami(x):
    return np.sin(x[0]) + 7 * np.sin(x[1]) ** 2 + 0.1 * x[2] ** 4 * np.sin(x[0])


@pytest.fixture(scope="module")
def grid():
    return sweep(CAR, GRID, Plane(), workers=1)


@pytest.fixture(scope="module")
def drawn():
    axes = {"body.m": "1000..1600", "body.c_d": "0.2..0.4", "body.A": "1..3", "motor": "ac-75kw,ac-83kw"}
    return sweep(CAR, axes, Plane(), sample="lhs:16", workers=1)


@pytest.fixture(scope="module")
def cube():
    return sweep(CAR, {name: f"{low}..{high}" for name, low, high in CUBE}, Ishigami(), sample="saltelli:64", workers=1)


def test_main_effects_of_a_grid_are_means_over_the_other_axes(grid):
    effects = {effect.axis: effect for effect in main_effects(grid, "y_s")}
    assert list(effects) == ["body.c_d", "body.m", "motor"]
    mean = float(grid["y_s"].mean())
    assert effects["body.m"].ends == (1000.0, 1600.0)
    assert effects["body.m"].means == pytest.approx((mean - 30, mean + 30))
    assert effects["body.c_d"].means == pytest.approx((mean - 100, mean + 100))
    assert effects["motor"].ends == ("ac-83kw", "ac-75kw")
    assert effects["motor"].means == pytest.approx((mean - 25, mean + 25))


def test_main_effects_of_a_sample_are_the_slopes_between_the_ends_of_the_axes(drawn):
    effects = {effect.axis: effect for effect in main_effects(drawn, "y_s")}
    spans = {axis: effect.span for axis, effect in effects.items()}
    assert spans == pytest.approx({"body.c_d": 200, "body.m": 60, "motor": 50, "body.A": 20})
    assert effects["body.m"].ends == (1000.0, 1600.0)
    assert effects["motor"].ends == ("ac-83kw", "ac-75kw")
    # The plane goes through the mean of all points.
    mean, at = float(drawn["y_s"].mean()), float(drawn["body.m"].mean())
    assert effects["body.m"].means[0] == pytest.approx(mean + 0.1 * (1000 - at))


def test_points_without_a_value_do_not_count(grid):
    (gap,) = [effect for effect in main_effects(grid, "gap_s") if effect.axis == "body.m"]
    assert gap.means[0] == 1.0
    assert np.isnan(gap.means[1])


def test_too_few_points_give_no_effects():
    found = sweep(CAR, {"body.m": "1000..1600", "body.c_d": "0.2..0.4"}, Plane(), sample="lhs:2", workers=1)
    with pytest.raises(InputError, match="2 points are too few for 2 effects"):
        main_effects(found, "y_s")


def test_indices_are_those_of_scipy_at_the_same_points(cube):
    found = {index.axis: index for index in sobol_indices(cube, "y")}
    alone = by_scipy(func=ishigami, n=64, dists=[uniform(-np.pi, 2 * np.pi)] * 3, rng=0)
    for i, (axis, _, _) in enumerate(CUBE):
        # The points are scaled to the axes and back.
        assert found[axis].first == pytest.approx(alone.first_order[i], rel=1e-9, abs=1e-9)
        assert found[axis].total == pytest.approx(alone.total_order[i], rel=1e-9, abs=1e-9)
        assert found[axis].first_bounds[0] < found[axis].first < found[axis].first_bounds[1]
        assert found[axis].total_bounds[0] < found[axis].total < found[axis].total_bounds[1]
    assert sobol_indices(cube, "y") == sobol_indices(cube, "y")


def test_indices_need_all_points_of_their_own_sample(cube, drawn):
    with pytest.raises(InputError, match="gap: 160 of 320 points have no value"):
        sobol_indices(cube, "gap")
    with pytest.raises(InputError, match="saltelli"):
        sobol_indices(drawn, "y_s")


@pytest.mark.parametrize("text", ["y_s", "y_s=3", "y_s<=x", "<=3", "y_s<=1 2"])
def test_what_is_no_constraint_is_refused(text):
    with pytest.raises(InputError, match="must be NAME<=NUMBER"):
        Constraint.read(text)


def test_a_constraint_tells_how_far_it_is_broken(grid):
    assert float(Constraint.read("y_s <= 300").excess(grid).max()) == float(grid["y_s"].max()) - 300
    assert float(Constraint.read("y_s>=300").excess(grid).max()) == 300 - float(grid["y_s"].min())


def test_lines_are_dotted_from_where_a_constraint_is_broken(grid):
    one = grid.sel({"body.c_d": [0.3], "motor": ["ac-75kw"]})
    # 0.1 m + 300 + 20 reaches 450 at 1300 kg.
    figure = plot_sweep(one, ["y_s"], constraints=["y_s<=450"])
    (ax,) = figure.axes
    kept, broken, *_ = ax.lines
    assert np.nanmax(kept.get_xdata()[np.isfinite(kept.get_ydata())]) == pytest.approx(1300, abs=1)
    assert np.nanmin(broken.get_xdata()[np.isfinite(broken.get_ydata())]) == pytest.approx(1300, abs=1.01)
    assert ax.get_xlabel() == "test mass, body.m [kg]"
    assert ax.get_ylabel() == "y [s]"
    assert [text.get_text() for text in figure.texts] == ["small-car-electric", "plane   ·   dotted where y > 450 s"]


def test_a_line_for_each_value_of_the_other_axes(grid):
    figure = plot_sweep(grid.isel({"body.c_d": [0, 1, 2]}), ["y_s"], kind="lines")
    labels = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert labels == ["0.2, ac-75kw", "0.2, ac-83kw", "0.25, ac-75kw", "0.25, ac-83kw", "0.3, ac-75kw", "0.3, ac-83kw"]
    with pytest.raises(InputError, match="too many"):
        plot_sweep(sweep(CAR, {"body.m": "1000..1600:2", "body.c_d": "0.2..0.4:13"}, Plane(), workers=1), kind="lines")


def test_contours_have_the_line_of_a_constraint_where_it_is(grid):
    figure = plot_sweep(grid, ["y_s"], constraints=["y_s<=450"])
    *panels, bar = figure.axes
    assert [ax.get_title(loc="left") for ax in panels] == ["motor ac-75kw", "motor ac-83kw"]
    assert bar.get_title(loc="left") == "s"
    for ax, step in zip(panels, (0, -50), strict=True):
        (x, y) = ax.collections[-1].get_paths()[0].vertices.T
        assert 0.1 * x + 1000 * y + 20 + step == pytest.approx(450)
    assert figure.legends[0].get_texts()[0].get_text() == "y ≤ 450 s"


def test_slices_show_some_of_many_values_with_the_ends():
    found = sweep(CAR, {"body.m": "1000..1600:2", "body.c_d": "0.2..0.4:2", "body.A": "1..3:11"}, Plane(), workers=1)
    titles = [ax.get_title(loc="left") for ax in plot_sweep(found).axes[:-1]]
    assert titles == [f"body.A {x} m²" for x in ("1", "1.4", "1.8", "2.2", "2.6", "3")]


def test_a_tornado_has_a_bar_to_each_side_with_its_end(drawn):
    (ax,) = plot_sweep(drawn, ["y_s"]).axes
    assert [label.get_text() for label in ax.get_yticklabels()] == ["body.c_d", "body.m", "motor", "body.A"]
    widths = [bar.get_width() for bar in ax.patches[:2]]
    assert widths[1] - widths[0] == pytest.approx(200)
    assert [text.get_text() for text in ax.texts[:2]] == ["0.2", "0.4"]


def test_indices_are_drawn_alone_and_in_total(cube):
    (ax,) = plot_sweep(cube, ["y"]).axes
    indices = sobol_indices(cube, "y")
    assert [bar.get_width() for bar in ax.patches[:2]] == pytest.approx([max(indices[0].first, 0), indices[0].total])


def test_a_picture_is_written_and_shows_something(grid, tmp_path):
    path = tmp_path / "y.png"
    plot_sweep(grid, path=path)
    assert np.ptp(matplotlib.image.imread(path)) > 0.5


def test_names_alone_give_dots():
    found = sweep(CAR, {"motor": "ac-75kw,ac-83kw"}, Plane(), workers=1)
    (ax,) = plot_sweep(found).axes
    assert [label.get_text() for label in ax.get_xticklabels()] == ["ac-75kw", "ac-83kw"]


def test_all_that_is_wrong_with_a_picture_is_said_at_once(grid, drawn):
    with pytest.raises(InputError) as error:
        plot_sweep(grid, ["x_s"], kind="slices", constraints=["y", "z<=3"], path="y.gif")
    assert list(error.value.problems) == [
        "y.gif: a plot is written as .png, .svg, .pdf, not as '.gif'",
        "slices need 3 axes over numbers, this sweep has 2: draw lines",
        "response x_s is not known, did you mean 'y_s'?",
        "constraint y: must be NAME<=NUMBER or NAME>=NUMBER, such as soc_end>=0.3",
        "constraint z<=3: response z is not known, must be one of y_s, gap_s, same",
    ]
    with pytest.raises(InputError, match="contours need a grid"):
        plot_sweep(drawn, kind="contours")
    with pytest.raises(InputError, match="did you mean 'tornado'"):
        plot_sweep(drawn, kind="tornados")
    with pytest.raises(InputError, match="nothing varies"):
        plot_sweep(drawn[["same", "failure", "notes"]])
