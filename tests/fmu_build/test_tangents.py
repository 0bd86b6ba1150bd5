"""The rule of each operation: its tangent in C against CasADi's derivative of the same expression, at points on all sides."""

import ctypes
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from halfshaft import Vehicle
from halfshaft.cosim.simulate import stepper_of
from halfshaft.fmu_build.code import step_code
from halfshaft.fmu_build.compiler import shared_library
from halfshaft.fmu_build.tangents import TANGENTS, tangents_code
from halfshaft.library.base.tables import Table
from halfshaft.models.assembly import Description

X, U, P = ca.SX.sym("x", 2), ca.SX.sym("u", 5), ca.SX.sym("p", 3)
A, B, C = X[0], X[1], P[0]
HILL = Table.of([0.0, 1.0, 3.0], [-1.0, 0.5, 2.0], values=[[1.0, 4.0, 2.0], [0.0, 7.0, 3.0], [5.0, -2.0, 6.0]], clip=True)
#: Expressions of two states and a parameter, of which each has its own operations.
EXPRESSIONS = {
    "sum": A + B - 3 * C, "product": A * B * C, "quotient": A / (B + 7), "constant over": 2 / (A + 9), "inverse": 1 / (B + 8),
    "square": A**2 + ca.sqrt(C + 5) - B, "root": ca.sqrt(A**2 + 1), "size": ca.fabs(A) * B, "least": ca.fmin(A, B),
    "most": ca.fmax(A * B, C),
    "sign": ca.sign(A) * B, "exp": ca.exp(A / 3), "log": ca.log(B**2 + 2), "power": (A**2 + 1) ** 1.7, "any power": (A**2 + 1) ** (B / 4),
    "tanh": ca.tanh(A), "sin": ca.sin(A * B), "cos": ca.cos(A - B), "atan": ca.atan(2 * A), "floor": ca.floor(A) * B,
    "ceil": ca.ceil(B) + A,
    "modulo": ca.fmod(A, 1.3) * B, "modulo of": ca.fmod(5.0, B**2 + 1), "choice": ca.if_else(A < B, A * C, B**2),
    "one side": ca.if_else(ca.logic_and(A > 0, B > 0), A * B, 0), "flag": (A > 0) * B, "negative": -(A * B), "twice": 2 * (A * B),
    "request": U[0] * A + U[1], "of parameters": ca.exp(C) * P[1] + A,
}  # fmt: skip


@pytest.fixture(scope="module")
def toy():
    """A step with all of these as outputs, the table among them, and as compiled code with tangents."""
    hill = replace(HILL, name="hill")
    outputs = {**EXPRESSIONS, "table": hill.interpolant(ca.vertcat(A, B)) * C}
    function = ca.Function("toy", [X, U, P], [ca.vertcat(A * C, ca.sin(B)), ca.vertcat(*outputs.values())])
    real = stepper_of(Vehicle.load("small-car-electric")).step
    described = [tuple(Description(f"{kind}.{i}", "1", "") for i in range(n)) for kind, n in (("x", 2), ("p", 2), ("y", len(outputs)))]
    start = ca.Function("start", [P], [ca.vertcat(P[0] ** 2, P[1] + P[2])])
    step = replace(
        real, name="toy", function=function, start=start, states=described[0], outputs=described[2], tables={"hill": hill}, decisions=(),
        parameters=(*described[1], Description("start", "m/s", "", tag="start speed")),
    )  # fmt: skip
    shell = """
__attribute__((visibility("default")))
void one(const double *x, const vt *dx, const double *u, const vt *du, const double *p, const vt *dp, double *xn, vt *dxn, double *y,
         vt *dy) {
  double q[HS_NQ];
  vt dq[HS_NQ];
  hs_prepare(p, q);
  hs_prepare_tangents(p, dp, dq);
  hs_step_tangents(x, dx, u, du, p, dp, q, dq, xn, dxn, y, dy);
}
__attribute__((visibility("default"))) void first(const double *p, const vt *dp, double *x, vt *dx) { hs_start_tangents(p, dp, x, dx); }
"""
    code = "\n".join([step_code(step), tangents_code(step, (0, 1)), shell])
    return step, ctypes.CDLL(str(shared_library(code, "toy_tangents"))), list(outputs)


def place(array):
    return ctypes.c_void_p(array.ctypes.data)


def test_each_operation_has_the_tangent_that_casadi_finds(toy):
    step, library, names = toy
    rng, seen = np.random.default_rng(2), 0
    for _ in range(60):
        x, u, p = rng.uniform(-3, 3, 2), rng.uniform(-3, 3, 5), rng.uniform(-1, 2, 3)
        seeds = [rng.normal(size=(n, TANGENTS)) for n in (2, 5, 3)]
        seeds[1][2:] = 0.0
        # The speed at the start is the trace's: nothing moves it.
        seeds[2][2] = 0.0
        out = [np.empty(2), np.empty((2, TANGENTS)), np.empty(len(names)), np.empty((len(names), TANGENTS))]
        library.one(*map(place, (x, seeds[0], u, seeds[1], p, seeds[2], *out)))
        values = [np.array(v).ravel() for v in step.function(x, u, p)]
        derivative = step.function.jacobian()(x, u, p, *step.function(x, u, p))
        for k, (mine, slopes) in enumerate(((out[0], out[1]), (out[2], out[3]))):
            theirs = sum(np.array(derivative[3 * k + i]) @ seed for i, seed in enumerate(seeds))
            np.testing.assert_allclose(mine, values[k], rtol=1e-13, atol=1e-13)
            for row, (a, b) in enumerate(zip(slopes, theirs, strict=True)):
                np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9, err_msg=names[row] if k else f"x.{row}")
                seen += 1
    assert seen == 60 * (2 + len(names))


def test_the_start_has_tangents_too(toy):
    _, library, _ = toy
    p, dp, x, dx = np.array([3.0, 4.0, 5.0]), np.arange(24.0).reshape(3, TANGENTS), np.empty(2), np.empty((2, TANGENTS))
    library.first(*map(place, (p, dp, x, dx)))
    assert x.tolist() == [9.0, 9.0]
    np.testing.assert_allclose(dx, [6 * dp[0], dp[1]])
