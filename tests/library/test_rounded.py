import ctypes

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from halfshaft.fmu_build.compiler import shared_library
from halfshaft.library.base.rounded import RoundedTable, ramp, rounded_source, weight
from halfshaft.library.base.tables import Table, axis_source

X, Y = np.array([0.0, 1.0, 3.0, 3.5, 7.0]), np.array([-2.0, 0.0, 5.0])
GEARS = np.array([1.0, 2.0, 3.0])
RNG = np.random.default_rng(1)
TABLES = {
    "line": Table.of(X, values=RNG.normal(size=5), clip=False),
    "plane": Table.of(X, Y, values=RNG.normal(size=(5, 3)), clip=False),
    "gears": Table.of(X, Y, GEARS, values=RNG.normal(size=(5, 3, 3)), clip=False),
    "flat": Table.of(X, Y, values=np.outer(RNG.normal(size=5), np.ones(3)), clip=False),
}


@pytest.fixture(scope="module")
def compiled():
    """The tables in C: place and interval found, value and slopes by the variables."""
    parts = ['#include <math.h>\n#define HS_EXPORT __attribute__((visibility("default")))']
    for name, table in TABLES.items():
        t = RoundedTable.from_table(table).reduced
        parts += [axis_source(f"{name}_{i}", t.points[i]) for i in t.live]
        parts.append(rounded_source(name, t))
        places = [
            f"const int i{i} = {name}_{i}_find(x[{i}]); const double t{i} = (x[{i}] - {name}_{i}_x[i{i}]) * {name}_{i}_s[i{i}];"
            for i in t.live
        ]
        slopes = [f"d[{i}] = g[{i}] * {name}_{i}_s[i{i}];" for i in t.live]
        call = f"{name}_at({''.join(f'i{i}, t{i}, ' for i in t.live)}w, g)"
        head = f"HS_EXPORT double {name}(const double *x, double w, double *d) {{ double g[3];"
        parts.append(f"{head} {' '.join(places)} const double y = {call}; {' '.join(slopes)} return y; }}")
    library = ctypes.CDLL(str(shared_library("\n".join(parts), "rounded")))

    def call(name, x, w):
        function, d = getattr(library, name), np.zeros(3)
        function.restype, function.argtypes = ctypes.c_double, (ctypes.c_void_p, ctypes.c_double, ctypes.c_void_p)
        x = np.ascontiguousarray(x, dtype=float)
        return function(x.ctypes.data, w, d.ctypes.data), d[: len(x)]

    return call


@pytest.mark.parametrize("name", TABLES)
def test_c_and_expression_are_the_same(name, compiled):
    table = RoundedTable.from_table(TABLES[name])
    x = ca.SX.sym("x", len(table.points) + 1)
    value = table.interpolant(x)
    slope = ca.Function("slope", [x], [value, ca.jacobian(ca.SX(value), x)]) if value.is_scalar() else None
    for w in (1e-6, 0.1, 1.0):
        for point in RNG.uniform([-1, -3, 1], [8, 6, 3], (60, 3)):
            own, d = compiled(name, point[: len(table.points)], w)
            y, jacobian = slope([*point[: len(table.points)], w])
            assert own == pytest.approx(float(y), abs=1e-12)
            assert d == pytest.approx(np.array(jacobian).ravel()[:-1], abs=1e-10)


def test_between_its_kinks_a_table_stays_and_nowhere_moves_far(compiled):
    table = TABLES["line"]
    gap = np.diff(X)
    for w in (1.0, 0.3, 1e-3):
        for x in np.linspace(-0.5, 7.5, 400):
            plain = (
                float(np.interp(x, X, table.values))
                if 0 <= x <= 7
                else table.values[0 if x < 0 else -1] + ((x - (0 if x < 0 else 7)) * (np.diff(table.values) / gap)[0 if x < 0 else -1])
            )
            half = w * 0.5 * np.minimum(gap[:-1], gap[1:])
            apart = np.abs(x - X[1:-1])
            bend = np.abs(np.diff(np.diff(table.values) / gap))
            own = compiled("line", [x], w)[0]
            if np.all(apart >= half):
                assert own == pytest.approx(plain, abs=1e-14)
            # In the middle of a kink it is 5/32 of the half times the bend away.
            assert abs(own - plain) <= np.max(np.where(apart < half, 5 / 32 * half * bend, 0)) + 1e-14


@given(st.floats(-3, 3), st.floats(1e-6, 2))
def test_the_kernel_is_the_slope_of_its_ramp_and_exact_outside(t, w):
    x, h = t * w, 1e-5 * w
    assert (float(ramp(x + h, w)) - float(ramp(x - h, w))) / (2 * h) == pytest.approx(float(weight(x, w)), abs=1e-6)
    assert float(weight(x, w)) + float(weight(-x, w)) == pytest.approx(1, abs=1e-14)
    if abs(x) >= w:
        assert float(ramp(x, w)) == pytest.approx(max(x, 0), abs=1e-14)


def test_value_slope_and_curvature_have_no_jump():
    x = ca.SX.sym("x")
    f = ramp(x, 0.5)
    slope = ca.jacobian(f, x)
    derivatives = ca.Function("d", [x], [f, slope, ca.jacobian(slope, x)])
    for kink in (-0.5, 0.5):
        below, above = (np.array(derivatives(kink + side)).ravel() for side in (-1e-9, 1e-9))
        assert below == pytest.approx(above, abs=1e-7)
