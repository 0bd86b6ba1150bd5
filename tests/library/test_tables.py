import casadi as ca
import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from halfshaft.fmu_build.code import compiled_tables
from halfshaft.library.base.tables import Table, interpolants


def table(*lengths, clip, seed):
    """Return a table with rising, uneven axes and random values; axes of very different scale."""
    rng = np.random.default_rng(seed)
    points = [np.cumsum(10.0 ** rng.uniform(-2, 2, n)) - 10 * rng.random() for n in lengths]
    return Table.of(*points, values=rng.normal(scale=100, size=lengths), clip=clip)


SHAPES = {
    "line": (7,), "two_points": (2,), "long_line": (60,), "plane": (5, 9), "space": (4, 3, 6),
    "one_point": (1,), "one_row": (1, 6), "one_column": (6, 1), "one_gear": (5, 4, 1), "one_of_three": (1, 1, 5), "nothing": (1, 1),
}  # fmt: skip
TABLES = {
    f"{name}_{'clip' if clip else 'line'}": table(*shape, clip=clip, seed=i)
    for i, (name, shape) in enumerate(SHAPES.items())
    for clip in (True, False)
}
every_table = pytest.mark.parametrize("name", TABLES)


@pytest.fixture(scope="module")
def compiled():
    return compiled_tables(TABLES)


def places(t, seed, n=400):
    """Return points inside, on the knots, on the edges and outside, one a column."""
    rng = np.random.default_rng(seed)
    columns = []
    for x in t.points:
        span = max(np.ptp(x), 1.0)
        inside = rng.uniform(x[0], x[-1], n)
        around = rng.uniform(x[0] - span, x[-1] + span, n)
        columns.append(np.where(rng.random(n) < 0.4, inside, np.where(rng.random(n) < 0.5, rng.choice(x, n), around)))
    return np.array(columns)


def by_hand(t, x):
    """Return the value by multilinear interpolation in plain NumPy; the outermost cell is extended."""
    corners = [(t.values, 1.0)]
    for p, xi in zip(t.points, x, strict=True):
        if len(p) == 1:
            corners = [(v[0], w) for v, w in corners]
            continue
        xi = min(max(xi, p[0]), p[-1]) if t.clip else xi
        i = min(max(np.searchsorted(p, xi, side="right") - 1, 0), len(p) - 2)
        share = (xi - p[i]) / (p[i + 1] - p[i])
        corners = [pair for v, w in corners for pair in ((v[i], w * (1 - share)), (v[i + 1], w * share))]
    return sum(v * w for v, w in corners)


def size(t):
    # Extrapolation multiplies the values by at most span over smallest cell, once for each axis.
    factor = 1.0
    for p in t.points:
        if len(p) > 1 and not t.clip:
            factor *= 1 + 2 * max(np.ptp(p), 1.0) / min(np.diff(p)[0], np.diff(p)[-1])
    return factor * np.abs(t.values).max()


@every_table
def test_c_interpolant_and_numpy_agree_inside_on_knots_and_outside(name, compiled):
    t = TABLES[name]
    x = places(t, seed=1)
    expected = np.array([by_hand(t, column) for column in x.T])
    # Each of the three adds up to eight products; 1e-13 is a few hundred roundings of the largest.
    np.testing.assert_allclose(compiled[name](x).full().ravel(), expected, rtol=0, atol=1e-13 * size(t))
    np.testing.assert_allclose(interpolants({name: t})[name](x).full().ravel(), expected, rtol=0, atol=1e-13 * size(t))


@every_table
def test_inside_the_axes_a_table_is_that_of_scipy(name, compiled):
    t = TABLES[name]
    live = [i for i, p in enumerate(t.points) if len(p) > 1]
    x = places(t, seed=2)
    x = np.array([np.clip(row, p[0], p[-1]) for row, p in zip(x, t.points, strict=True)])
    if not live:
        expected = np.full(x.shape[1], t.values.flat[0])
    else:
        expected = RegularGridInterpolator([t.points[i] for i in live], t.values.squeeze())(x[live].T)
    np.testing.assert_allclose(compiled[name](x).full().ravel(), expected, rtol=0, atol=1e-13 * np.abs(t.values).max())


@every_table
def test_on_its_knots_a_table_gives_its_values(name, compiled):
    t = TABLES[name]
    knots = np.array([g.ravel() for g in np.meshgrid(*t.points, indexing="ij")])
    np.testing.assert_allclose(compiled[name](knots).full().ravel(), t.values.ravel(), rtol=0, atol=1e-13 * np.abs(t.values).max())


@every_table
def test_derivative_of_the_c_is_the_difference_quotient(name, compiled):
    t, f = TABLES[name], compiled[name]
    x = ca.SX.sym("x", len(t.points))
    gradient = ca.Function("gradient", [x], [ca.densify(ca.jacobian(f(x), x))])
    rng = np.random.default_rng(3)
    for _ in range(100):
        # Somewhere in a cell or outside, away from the kinks by more than the difference.
        place, h = [], []
        for p in t.points:
            edges = np.concatenate([[p[0] - 5], p, [p[-1] + 5]])
            i = rng.integers(len(edges) - 1)
            width = edges[i + 1] - edges[i]
            place.append(edges[i] + width * rng.uniform(0.2, 0.8))
            h.append(0.1 * width)
        found = gradient(place).full().ravel()
        for i, hi in enumerate(h):
            step = np.eye(len(place))[i] * hi
            quotient = float(f(place + step) - f(place - step)) / (2 * hi)
            # A multilinear function: the central difference is exact but for rounding.
            assert found[i] == pytest.approx(quotient, rel=1e-9, abs=1e-12 * size(t) / hi)


@every_table
def test_derivatives_of_c_and_interpolant_agree(name, compiled):
    t = TABLES[name]
    x = ca.SX.sym("x", len(t.points))
    gradients = [ca.Function("g", [x], [ca.densify(ca.jacobian(f(x), x))]) for f in (compiled[name], interpolants({name: t})[name])]
    points = places(t, seed=4)
    # On a kink either side is right; leave knots and edges out.
    away = np.all([np.all(np.abs(row[:, None] - p) > 1e-9, axis=1) for row, p in zip(points, t.points, strict=True)], axis=0)
    first, second = (g(points[:, away]).full() for g in gradients)
    steepest = size(t) / min(np.diff(p).min() for p in (*t.points, np.arange(2.0)) if len(p) > 1)
    np.testing.assert_allclose(first, second, rtol=1e-9, atol=1e-11 * steepest)


@every_table
@pytest.mark.parametrize("made_by", ["compiler", "interpolant"])
def test_a_value_that_is_not_a_number_comes_out_as_such(name, made_by, compiled):
    t = TABLES[name]
    f = compiled[name] if made_by == "compiler" else interpolants({name: t})[name]
    for i, p in enumerate(t.points):
        if len(p) > 1:
            x = [float(q.mean()) for q in t.points]
            x[i] = float("nan")
            assert np.isnan(float(f(x)))


def test_infinite_arguments_are_clipped():
    t = Table.of([0, 1, 3], values=[1.0, 2.0, 5.0])
    f = compiled_tables({"t": t})["t"]
    assert [float(f(x)) for x in (-np.inf, np.inf)] == [1.0, 5.0]


def test_a_table_of_numbers_gives_a_number_and_of_symbols_an_expression():
    t = Table.of([0, 2], values=[1.0, 5.0])
    assert t(0.5) == 2.0
    assert isinstance(t(np.float64(0.5)), float)
    assert isinstance(t(ca.SX.sym("x")), ca.SX)


def test_an_axis_may_be_very_uneven():
    p = np.array([0, 1e-9, 1e-6, 1, 2, 1e9])
    t = Table.of(p, values=np.arange(6.0))
    f = compiled_tables({"uneven": t})["uneven"]
    x = np.concatenate([p, (p[1:] + p[:-1]) / 2])
    np.testing.assert_allclose(f(x[None, :]).full().ravel(), np.interp(x, p, t.values), rtol=1e-12)


@pytest.mark.parametrize(
    ("points", "values", "message"),
    [
        (([0, 1],), [1, 2, 3], r"values have shape \(3,\), the axes ask for \(2,\)"),
        (([0, 1], [0, 1, 2]), np.zeros((3, 2)), r"values have shape \(3, 2\), the axes ask for \(2, 3\)"),
        (([0, 1, 1],), [1, 2, 3], "axis 1 must rise strictly, but 1 follows 1"),
        (([0, 1], [0, 5, 4]), np.zeros((2, 3)), "axis 2 must rise strictly, but 4 follows 5"),
        (([0, np.nan],), [1, 2], "axis 1 has a missing value"),
        (([0, 1], [0, np.inf]), np.zeros((2, 2)), "axis 2 has a missing value"),
        (([0, 1], [0, 1]), [[1, 2], [3, np.nan]], r"the value at position \(2, 2\) is missing or not a number"),
        (([],), [], "axis 1 has no points"),
        (([-1e301, 0, 1],), [1, 2, 3], "axis 1 has points too close to each other, or too far apart"),
        (([0, 1e-300, 1],), [1, 2, 3], "axis 1 has points too close to each other, or too far apart"),
    ],
)
def test_a_table_that_cannot_be_says_why(points, values, message):
    with pytest.raises(ValueError, match=message):
        Table.of(*points, values=values)


def test_tables_are_the_same_when_numbers_and_edges_are():
    one, same, other = (Table.of([0, 1], values=[1, y]) for y in (2, 2, 3))
    assert one.key == same.key != other.key
    assert one.key != Table.of([0, 1], values=[1, 2], clip=False).key


def test_c_gives_bit_for_bit_what_it_gave_when_inlined_elsewhere():
    # The same source in two libraries; the step relies on it.
    t = TABLES["plane_line"]
    first, second = compiled_tables({"plane": t})["plane"], compiled_tables({"plane": t, "other": TABLES["line_clip"]})["plane"]
    x = places(t, seed=5)
    assert np.array_equal(first(x).full(), second(x).full())


def test_compiled_tables_have_exact_second_derivatives():
    rng = np.random.default_rng(7)
    surface = Table.of([0, 1, 3], [0, 2, 5, 6], values=rng.random((3, 4)), clip=False)
    line = Table.of([0, 1, 3], values=[1, 2, 0])
    functions = compiled_tables({"curved_surface": surface, "curved_line": line})
    x = ca.SX.sym("x", 2)
    y = functions["curved_surface"](x) * functions["curved_line"](x[0])
    hessian, value = ca.Function("h", [x], [ca.hessian(y, x)[0]]), ca.Function("y", [x], [y])
    at, h = np.array([0.4, 3.0]), 1e-3
    steps = h * np.eye(2)
    by_differences = [
        [float(value(at + a + b) - value(at + a - b) - value(at - a + b) + value(at - a - b)) / (4 * h * h) for b in steps] for a in steps
    ]
    # Inside one piece y is a polynomial of low degree: only the rounding of the differences is left.
    np.testing.assert_allclose(hessian(at).full(), by_differences, atol=1e-8)
