"""A toy with the interface of an assembled step, its C, the same arithmetic in Python, and a client for its FMUs."""

import math
import sys
from typing import NamedTuple

import casadi as ca
import fmpy
import numpy as np
import pytest
from fmpy.simulation import instantiate_fmu

from halfshaft.fmu_build.package import build_fmu
from halfshaft.fmu_build.variables import CycleTable
from halfshaft.library.base.parameters import Relation
from halfshaft.models.assembly import Description

_P = ca.SX.sym("p", 3)
ABOVE_0 = sys.float_info.min
STEEP = Relation(lambda p: p.v_start > 10 * p.a_max, "v_start = {v_start:g} m/s is over 10 s at a_max = {a_max:g}")


class Toy(NamedTuple):
    name: str = "toy"
    title: str = "Toy with <two> states"
    states: tuple = (Description("body.v", "m/s", "speed", tag="speed"), Description("body.distance", "m", "distance", tag="distance"))
    requests: tuple = (
        Description("v_request", "m/s", "requested speed at the end of the step"),
        Description("grade", "1", "slope of the road"),
        Description("key_on", "1", "whether the key is on", "flag", 1.0, 0.0, 1.0, allowed=">= 0 and <= 1"),
        Description("dt", "s", "length of the step", "real", 1.0),
        Description("decided", "1", "what a shell leaves at 0", "flag"),
    )
    parameters: tuple = (
        Description("body.a_max", "m/s^2", "largest acceleration", "real", 1.5, ABOVE_0, 20.0, allowed="> 0 m/s^2 and <= 20 m/s^2"),
        Description("body.k", "W.s^3/rad^3", "a coefficient", "real", 4.0),
        Description("body.v_start", "m/s", "speed at the start", "real", 0.0, 0.0, allowed=">= 0 m/s", tag="start speed"),
    )
    outputs: tuple = (
        Description("body.v", "m/s", "speed", state=0),
        Description("body.distance", "m", "distance", state=1),
        Description("body.v_request", "m/s", "requested speed"),
        Description("motor.tau", "N.m", "torque"),
    )
    start: ca.Function = ca.Function("start", [_P], [ca.vertcat(_P[2], 0)])
    broken: ca.Function = ca.Function("broken", [_P], [_P[2] > 10 * _P[0]])
    relations: tuple = (("body", STEEP),)


CODE = """
#include <math.h>
#define HS_NX 2
#define HS_NU 5
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
  y[3] = sqrt(p[1]) * xn[0] + 10 * u[1] + u[4];
  return y[3] != y[3];
}

static void hs_start(const double *p, double *x) {
  x[0] = p[2];
  x[1] = 0;
}
"""


class Twin:
    """The toy in Python; `outputs` in the order of the toy's."""

    def __init__(self, a_max=1.5, k=4.0, v_start=0.0):
        self.a_max, self.k, self.v, self.distance = a_max, k, v_start, 0.0
        self.outputs = [v_start, 0.0, 0.0, 0.0]

    def step(self, v_request, grade=0.0, key_on=1.0, dt=1.0):
        v = self.v + min((v_request * key_on - self.v) / dt, self.a_max) * dt
        self.distance += 0.5 * (self.v + v) * dt
        self.v = v
        self.outputs = [v, self.distance, v_request, math.sqrt(self.k) * v + 10 * grade]
        return self.outputs


class Client:
    """One instance of an FMU of either version, by names of variables."""

    OUTPUTS = tuple(y.name for y in Toy().outputs)

    def __init__(self, folder, fmi):
        self.description = fmpy.read_model_description(str(folder))
        self.reference = {v.name: v.valueReference for v in self.description.modelVariables}
        self.folder, self.fmi, self.log, self.t = folder, fmi, [], 0.0
        self.fmu = self.instantiate()

    def instantiate(self, logging=True):
        return instantiate_fmu(str(self.folder), self.description, "CoSimulation", debug_logging=logging, logger=self._logged)

    def _logged(self, *arguments):
        self.log.append((arguments[-2].decode(), arguments[-1].decode()))

    def set(self, name, value):
        (self.fmu.setReal if self.fmi == 2 else self.fmu.setFloat64)([self.reference[name]], [value])

    def get(self, *names):
        return list((self.fmu.getReal if self.fmi == 2 else self.fmu.getFloat64)([self.reference[name] for name in names]))

    @property
    def outputs(self):
        return self.get(*self.OUTPUTS)

    def initialize(self, start_time=0.0, stop_time=None):
        self.t = start_time
        if self.fmi == 2:
            self.fmu.setupExperiment(startTime=start_time, stopTime=stop_time)
            self.fmu.enterInitializationMode()
        else:
            self.fmu.enterInitializationMode(startTime=start_time, stopTime=stop_time)
        self.fmu.exitInitializationMode()
        return self

    def step(self, h=1.0, **inputs):
        for name, value in inputs.items():
            self.set(name, value)
        self.fmu.doStep(self.t, h)
        self.t += h
        return self.outputs

    def free(self):
        self.fmu.freeInstance()


class Kit(NamedTuple):
    """What the tests of this folder need."""

    model: Toy
    code: str
    twin: type[Twin]
    cycle: CycleTable


@pytest.fixture(scope="session")
def kit():
    t = np.arange(1.0, 61.0)
    cycle = CycleTable(
        "wave", 8 - 8 * np.cos(t / 7.0), 0.01 * np.sin(t / 5.0), (t < 50).astype(float),
        (np.array([0.0, 100.0, 130.0, 400.0]), np.array([0.0, 0.03, -0.02, 0.01])),
    )  # fmt: skip
    return Kit(Toy(), CODE, Twin, cycle)


@pytest.fixture(scope="session", params=[2, 3], ids=["fmi2", "fmi3"])
def fmi(request):
    return request.param


@pytest.fixture(scope="session")
def driven(kit, fmi, tmp_path_factory):
    return build_fmu(kit.model, kit.code, tmp_path_factory.mktemp("mit ü") / "driven.fmu", fmi=fmi)


@pytest.fixture(scope="session")
def self_contained(kit, fmi, tmp_path_factory):
    return build_fmu(kit.model, kit.code, tmp_path_factory.mktemp("fmu") / "wave.fmu", fmi=fmi, cycle=kit.cycle)


@pytest.fixture
def client(fmi, tmp_path):
    """Make instances of an FMU; they are freed at the end."""
    clients = []

    def make(path):
        folder = tmp_path / path.stem
        if not folder.exists():
            fmpy.extract(str(path), str(folder))
        clients.append(Client(folder, fmi))
        return clients[-1]

    yield make
    for c in clients:
        c.free()
