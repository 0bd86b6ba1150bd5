"""A toy with the interface of an assembled step, its C, and the same arithmetic in Python."""

import math
from typing import NamedTuple


class Description(NamedTuple):
    name: str
    unit: str
    doc: str
    start: float = 0.0
    lowest: float | None = None
    highest: float | None = None
    state: int | None = None


class Toy(NamedTuple):
    name: str = "toy"
    title: str = "Toy with <two> states"
    states: tuple = (Description("body.v", "m/s", "speed"), Description("body.distance", "m", "distance"))
    requests: tuple = (
        Description("v_request", "m/s", "requested speed at the end of the step"),
        Description("grade", "1", "slope of the road"),
        Description("key_on", "1", "whether the key is on", 1.0),
        Description("dt", "s", "length of the step", 1.0),
    )
    parameters: tuple = (
        Description("body.a_max", "m/s^2", "largest acceleration", 1.5, 0.0, 20.0),
        Description("body.k", "W.s^3/rad^3", "a coefficient", 4.0),
        Description("body.v_start", "m/s", "speed at the start", 0.0, 0.0),
    )
    outputs: tuple = (
        Description("body.v", "m/s", "speed", state=0),
        Description("body.distance", "m", "distance", state=1),
        Description("body.v_request", "m/s", "requested speed"),
        Description("motor.tau", "N.m", "torque"),
    )


TOY = Toy()

CODE = """
#define HS_NX 2
#define HS_NU 4
#define HS_NP 3
#define HS_NY 4

static int hs_step(const double *x, const double *u, const double *p, double *xn, double *y) {
  double a = (u[0] * u[2] - x[0]) / u[3];
  a = a > p[0] ? p[0] : a;
  xn[0] = x[0] + a * u[3];
  xn[1] = x[1] + 0.5 * (x[0] + xn[0]) * u[3];
  y[0] = xn[0];
  y[1] = xn[1];
  y[2] = u[0];
  y[3] = sqrt(p[1]) * xn[0] + 10 * u[1];
  return y[3] != y[3];
}

static void hs_start(const double *p, double *x) {
  x[0] = p[2];
  x[1] = 0;
}
"""


class Twin:
    """The toy in Python."""

    def __init__(self, a_max=1.5, k=4.0, v_start=0.0):
        self.a_max, self.k, self.v, self.distance = a_max, k, v_start, 0.0
        self.outputs = [v_start, 0.0, 0.0, 0.0]

    def step(self, v_request, grade=0.0, key_on=1.0, dt=1.0):
        a = min((v_request * key_on - self.v) / dt, self.a_max)
        v = self.v + a * dt
        self.distance += 0.5 * (self.v + v) * dt
        self.v = v
        self.outputs = [v, self.distance, v_request, math.sqrt(self.k) * v + 10 * grade]
        return self.outputs
