"""Distributions, and what they make of figures: against closed forms, and against runs one by one."""

import json
import math
from dataclasses import dataclass

import matplotlib.image
import numpy as np
import pytest
from scipy import stats
from typer.testing import CliRunner

from halfshaft import Cycle, InputError, Vehicle, run, uncertainty
from halfshaft.app.cli import app
from halfshaft.library.base.parameters import Spec
from halfshaft.studies.design import Sample, design_of
from halfshaft.studies.distributions import correlation_matrix, covariance, read_distribution
from halfshaft.studies.sweep import sweep
from halfshaft.studies.task import Drive, Found

CAR = Vehicle.load("small-car-electric")
MASS, KELVIN = Spec("kg", "mass", gt=0), Spec("K", "temperature", gt=0)
VARY = {"body.m": "normal(1300, 40)", "body.c_d": "uniform(0.2, 0.4)", "body.A": "normal(2, 0.1)"}


@dataclass(frozen=True)
class Formula:
    """Figures with known distributions: of mass m, drag c and area A."""

    fails_above: float = 1e9
    name: str = "formula"

    def __call__(self, car):
        m, c, area = (car.values[f"body.{name}"] for name in ("m", "c_d", "A"))
        if m > self.fails_above:
            raise ZeroDivisionError("too heavy")
        return Found(
            {"linear": 0.1 * m + 100 * c - 3 * area, "square": (m - 1250) ** 2, "product": c * area, "light": c if m < 1300 else None}
        )


@pytest.fixture(scope="module")
def formula():
    return uncertainty(CAR, VARY, Formula(), sample="saltelli:512", figures=["linear", "square", "product"], workers=1)


def distribution(given, spec=MASS):
    problems = []
    found = read_distribution(given, spec, "x", problems)
    assert not problems
    return found


def refused(*args, **kwargs):
    with pytest.raises(InputError) as error:
        uncertainty(*args, **kwargs)
    return list(error.value.problems)


@pytest.mark.parametrize(
    ("text", "spec", "same"),
    [
        ("normal(1300, 40)", MASS, stats.norm(1300, 40)),
        ("normal(1300, 40 kg)", MASS, stats.norm(1300, 40)),
        ("normal(1.3 t, 40 kg)", MASS, stats.norm(1300, 40)),
        ("normal( 20, 2 degC )", KELVIN, stats.norm(293.15, 2)),
        ("uniform(1200, 1300)", MASS, stats.uniform(1200, 100)),
        ("triangular(1, 1, 4)", MASS, stats.triang(0, 1, 3)),
        ("normal(0, 1, -1, 2)", Spec("1", "factor"), stats.truncnorm(-1, 2)),
        ("lognormal(1, 0.5)", MASS, stats.lognorm(math.sqrt(math.log(1.25)), scale=1 / math.sqrt(1.25))),
        (stats.gamma(3, scale=2), MASS, stats.gamma(3, scale=2)),
    ],
)
def test_words_give_the_distribution_of_scipy(text, spec, same):
    found, shares = distribution(text, spec), np.linspace(0.01, 0.99, 9)
    assert found.at(shares) == pytest.approx(same.ppf(shares), rel=1e-9)
    assert (found.mean, found.sd) == pytest.approx((same.mean(), same.std()), rel=1e-7)


def test_a_lognormal_has_the_mean_and_the_deviation_that_are_told():
    found = distribution("lognormal(12 kg, 3 kg)")
    assert (found.mean, found.sd) == pytest.approx((12, 3))


def test_the_ends_of_a_distribution_are_finite():
    assert np.isfinite(distribution("normal(1300, 40)").at([0.0, 1.0])).all()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("nomal(1, 2)", 'axis body.m = "nomal(1, 2)", must be one of normal(mean, sd), uniform(low, high), triangular(low, mode, high), '
                        "lognormal(mean, sd), did you mean 'normal'?"),
        ("normal(1300)", 'axis body.m = "normal(1300)", must be normal(mean, sd) or normal(mean, sd, low, high)'),
        ("normal(1300, 0)", 'axis body.m = "normal(1300, 0)", must have sd > 0'),
        ("normal(1300, 40, 1400, 1200)", 'axis body.m = "normal(1300, 40, 1400, 1200)", must have sd > 0 and low < high'),
        ("uniform(2, 1)", 'axis body.m = "uniform(2, 1)", must have low < high'),
        ("triangular(1, 5, 4)", 'axis body.m = "triangular(1, 5, 4)", must have low <= mode <= high and low < high'),
        ("normal(1300, 40 m)", 'axis body.m: sd = "40 m", must be a mass such as kg'),
        ("normal(1300, x)", 'axis body.m: sd = "x", must be a number and a unit such as "1 kg"'),
        ("1000..1600", "axis body.m = '1000..1600', must be a distribution, such as normal(1300, 40)"),
        (stats.norm, "must be a distribution with its numbers, such as scipy.stats.norm(0.3, 0.01)"),
        (stats.cauchy(1300, 40), "axis body.m = cauchy(1300, 40), must have a finite mean and a finite standard deviation > 0"),
    ],
)  # fmt: skip
def test_what_is_no_distribution_is_refused(given, said):
    assert any(problem.endswith(said) for problem in refused(CAR, {"body.m": given}, Formula()))


def test_everything_that_is_wrong_is_named_at_once():
    vary = {"body.mass": "normal(1, 2)", "body.A": "normal(2, 1, 5, 4)", "motor": "normal(0.05, 0.001)"}
    found = refused(CAR, vary, Formula(), sample="sobol:9", correlation={("body.A", "body.B"): 0.5, ("body.A",): 2})
    assert len(found) == 6
    assert refused(CAR, {}, Formula()) == ["no number has a distribution, at least one must, such as body.m=normal(1300, 40)"]
    # A grid has no place for a distribution.
    with pytest.raises(InputError, match="is a distribution, which needs a sample, such as sobol:256"):
        sweep(CAR, {"body.m": "normal(1300, 40)"}, Formula())


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({("a", "b"): 1.0}, "between -1 and 1"),
        ({("a", "b"): 0.9, ("b", "c"): 0.9, ("a", "c"): -0.9}, "not positive definite, its least eigenvalue is -0.8"),
        ({("a", "b"): 0.1, ("b", "a"): 0.2}, "is given twice"),
        (np.eye(2), "must have 3 rows of 3 numbers, in the order of a, b, c"),
        ([[1, 0.5, 0], [0.4, 1, 0], [0, 0, 1]], "the same for a pair in either order"),
        ({("a", "b"): "much"}, "between -1 and 1"),
    ],
)
def test_impossible_correlations_are_refused(given, said):
    problems = []
    correlation_matrix(given, ["a", "b", "c"], problems)
    assert len(problems) == 1
    assert said in problems[0]


def test_covariance_of_the_numbers_is_that_of_closed_forms():
    rho, s = 0.6, math.sqrt(math.log(1.25))
    cases = {
        "normal(1300, 40)": rho,
        # Of uniform numbers by Pearson (1907), of lognormal ones from their moments.
        "uniform(0, 1)": 6 / math.pi * math.asin(rho / 2),
        "lognormal(1, 0.5)": math.expm1(rho * s**2) / math.expm1(s**2),
    }
    for text, expected in cases.items():
        pair = [distribution(text)] * 2
        found = covariance(pair, np.array([[1, rho], [rho, 1]]))
        assert found[0, 1] / pair[0].sd ** 2 == pytest.approx(expected, abs=2e-3 if "uniform" in text else 1e-9)
        assert found[1, 1] == pytest.approx(pair[1].sd ** 2)


def test_samples_have_the_correlation_that_is_told():
    problems = []
    design = design_of((CAR,), VARY, Sample("sobol", 4096), problems, {("body.m", "body.A"): -0.7})
    assert not problems
    found = np.corrcoef(np.array(design.points).T)
    assert found[0, 2] == pytest.approx(-0.7, abs=5e-3)
    assert found[[0, 1], [1, 2]] == pytest.approx(0, abs=5e-3)


def test_a_plane_is_met_exactly(formula):
    parts = {"body.m": (0.1 * 40) ** 2, "body.c_d": (100 * 0.2) ** 2 / 12, "body.A": (3 * 0.1) ** 2}
    variance, mean = sum(parts.values()), 130 + 30 - 6
    of = formula.figures["linear"]
    assert of.first_order[:2] == pytest.approx((mean, math.sqrt(variance)), rel=1e-9)
    assert of.first_order.p95 == pytest.approx(stats.norm(mean, math.sqrt(variance)).ppf(0.95))
    assert of.gradient == pytest.approx({"body.m": 0.1, "body.c_d": 100, "body.A": -3})
    assert of.sampled[:2] == pytest.approx((mean, math.sqrt(variance)), rel=2e-3)
    for share in of.shares:
        expected = parts[share.name] / variance
        assert share.first_order == pytest.approx(expected, rel=1e-6)
        assert share.sobol.first == pytest.approx(expected, abs=0.01)
        assert share.sobol.total == pytest.approx(expected, abs=0.01)
    assert [share.name for share in of.shares] == ["body.c_d", "body.m", "body.A"]


def test_a_square_and_a_product_are_those_of_a_hand_calculation(formula):
    square, product = formula.figures["square"], formula.figures["product"]
    mu, sd = 50, 40
    assert square.first_order[:2] == pytest.approx((mu**2, 2 * mu * sd), rel=1e-9)
    assert square.sampled.mean == pytest.approx(mu**2 + sd**2, rel=0.01)
    assert square.sampled.sd == pytest.approx(math.sqrt(4 * mu**2 * sd**2 + 2 * sd**4), rel=0.02)
    same = stats.ncx2(1, (mu / sd) ** 2, scale=sd**2)
    assert (square.sampled.p50, square.sampled.p95) == pytest.approx(same.ppf([0.5, 0.95]), rel=0.02)
    # Of independent c and A: var(c A) = var c var A + var c (E A)^2 + var A (E c)^2.
    c, a = 0.2**2 / 12, 0.1**2
    variance = c * a + c * 2**2 + a * 0.3**2
    assert product.sampled.sd == pytest.approx(math.sqrt(variance), rel=3e-3)
    assert product.first_order.sd == pytest.approx(math.sqrt(variance - c * a), rel=1e-9)
    by_name = {share.name: share for share in product.shares}
    assert by_name["body.c_d"].sobol.first == pytest.approx(c * 2**2 / variance, abs=0.01)
    assert by_name["body.A"].sobol.total == pytest.approx((c * a + a * 0.3**2) / variance, abs=0.01)
    assert by_name["body.m"].sobol.total == by_name["body.m"].first_order == pytest.approx(0, abs=1e-9)


def test_a_number_alone_has_all_of_the_variance():
    found = uncertainty(CAR, {"body.c_d": "normal(0.3, 0.01)"}, Formula(), figures=["linear", "square"], workers=1)
    (share,) = found.figures["linear"].shares
    assert share.sobol == ("body.c_d", 1.0, (1.0, 1.0), 1.0, (1.0, 1.0))
    assert share.first_order == pytest.approx(1)
    assert found.figures["linear"].sampled.sd == pytest.approx(1, rel=0.02)
    # What it does not move has none.
    assert found.figures["square"].shares[0].sobol is None


def test_correlated_numbers_vary_together():
    rho = {("body.m", "body.A"): 0.8}
    found = uncertainty(CAR, VARY, Formula(), correlation=rho, sample="sobol:1024", figures="linear", workers=1)
    variance = 4**2 + (100 * 0.2) ** 2 / 12 + 0.3**2 - 2 * 0.8 * 4 * 0.3
    of = found.figures["linear"]
    assert of.first_order.sd == pytest.approx(math.sqrt(variance), rel=1e-9)
    assert of.sampled.sd == pytest.approx(math.sqrt(variance), rel=2e-3)
    assert sum(share.first_order for share in of.shares) == pytest.approx(1)
    # What a heavy car gains by its area takes away from what its area costs.
    assert {share.name: share.first_order for share in of.shares}["body.A"] < 0
    assert all(share.sobol is None for share in of.shares)
    assert "independent" in refused(CAR, VARY, Formula(), correlation=rho, sample="saltelli:64")[0]


@pytest.mark.parametrize(("kind", "order"), [("lhs", 0.5), ("sobol", 0.9)])
def test_the_error_of_the_samples_shrinks(kind, order):
    def error(n):
        points = (np.array(design_of((CAR,), VARY, Sample(kind, n, seed), []).points) for seed in range(20))
        means = [np.mean((x[:, 0] - 1300) / 40 * (x[:, 1] - 0.3) * 10 + (x[:, 2] - 2) ** 2 * 30) for x in points]
        return np.sqrt(np.mean((np.array(means) - 0.3) ** 2))

    assert error(512) / error(16) < 1.6 * (512 / 16) ** -order


def test_samples_outside_of_the_bounds_are_refused_or_cut_off():
    vary = {"body.c_d": "normal(0.1, 0.1)", "body.m": "normal(1300, 40)"}
    (said,) = refused(CAR, vary, Formula(), sample="sobol:64")
    assert said.startswith("axis body.c_d = normal(0.1, 0.1): 10 of 64 points are outside, such as -0.")
    assert said.endswith("must be >= 0 and <= 10; narrow it, or truncate it there")
    found = uncertainty(CAR, vary, Formula(), sample="sobol:256", truncate=True, figures="linear", workers=1)
    same = stats.truncnorm(-1, np.inf, 0.1, 0.1)
    assert found.samples["body.c_d"].min() >= 0
    assert found.samples["body.c_d"].mean() == pytest.approx(same.mean(), rel=5e-3)
    assert found.figures["linear"].first_order.sd == pytest.approx(math.hypot(4, 100 * same.std()), rel=1e-6)


def test_lost_runs_and_missing_figures_are_counted():
    found = uncertainty(CAR, VARY, Formula(fails_above=1380.0), sample="saltelli:128", figures=["linear", "light"], workers=1)
    heavy = int((found.samples["body.m"] > 1380).sum())
    assert found.lost == heavy > 0
    assert found.notes[0] == f"{heavy} of 640 runs failed and are left out, the first one: ZeroDivisionError: too heavy"
    light = found.figures["light"]
    assert light.missing == int((found.drawn["body.m"] >= 1300).sum())
    assert light.first_order is None
    assert all(share.sobol is None and share.first_order is None for share in light.shares)
    assert sum("light" in note for note in found.notes) == 3
    assert found.probability("light <= 9") == pytest.approx(0.5, abs=0.02)
    assert "-" in found.rows()[3]


def test_a_run_is_sampled_by_the_batch_and_its_first_order_is_near():
    cycle = Cycle(name="short", time=[0, 10, 40, 50], speed=[0, 12, 12, 0])
    vary = {"body.m": "normal(1300, 30)", "body.c_d": "uniform(0.30, 0.36)"}
    found = uncertainty(CAR, vary, Drive(cycle), sample="saltelli:256")
    point = found.samples.isel(point=300)
    one = run(CAR.with_values({name: float(point[name]) for name in vary}), cycle, history=False).figures
    assert float(point["energy_Wh_per_km"]) == one["energy_Wh_per_km"]
    assert (found.samples.sizes["point"], found.drawn.sizes["point"], found.lost) == (1024, 512, 0)
    of = found.figures["energy_Wh_per_km"]
    assert of.first_order[:2] == pytest.approx(of.sampled[:2], rel=2e-3)
    h = 1.0
    ends = [run(CAR.with_values({"body.m": 1300 + d, "body.c_d": 0.33}), cycle).figures["energy_Wh_per_km"] for d in (-h, h)]
    assert of.gradient["body.m"] == pytest.approx((ends[1] - ends[0]) / (2 * h), rel=1e-6)
    assert "energy_Wh_per_km" in found._repr_html_()


def test_command_prints_draws_and_says_what_is_wrong(tmp_path):
    def called(*arguments, code=0):
        done = CliRunner().invoke(app, ["uncertainty", "small-car-electric", *map(str, arguments)])
        assert done.exit_code == code, done.output
        return done.stdout if code == 0 else done.stderr

    drawn = ("--test", "gradeability", "--vary", "body.m=normal(1300, 30)", "--vary", "body.c_d=uniform(0.3, 0.4)", "--workers", 1)
    picture = tmp_path / "spread.png"
    told = called(*drawn, "--sample", "saltelli:8", "--constraint", "grade_percent>=1", "--plot", picture)
    assert "16 samples, 32 runs" in told
    assert "grade_percent >= 1 with a probability of 100.0 %" in told
    assert matplotlib.image.imread(picture).std() > 0.05
    found = json.loads(called(*drawn, "--sample", "sobol:8", "--correlation", "body.m, body.c_d=0.3", "--json"))
    grade = found["figures"]["grade_percent"]
    assert grade["first_order"]["sd"] == pytest.approx(grade["samples"]["sd"], rel=0.3)
    assert grade["shares"]["body.m"]["first_order"] > 0.7
    assert grade["shares"]["body.m"]["alone"] is None
    said = called("--vary", "body.m", "--correlation", "x", "--constraint", "y", code=2)
    assert all(part in said for part in ("nothing to do", "--vary body.m: must be like", "--correlation x: must be like", "constraint y"))
