"""Lanes against the scalar march, to the last bit, whatever the lanes drive and whether they come to an end.

Compiling takes most of the time, so here are the cars with the most different steps; the slow checks have every powertrain.
"""

import ctypes
import math

import numpy as np
import pytest

from halfshaft import Cycle, Vehicle
from halfshaft.cosim.simulate import parameters_of, stepper_of
from halfshaft.fmu_build import lanes
from halfshaft.fmu_build.compiler import shared_library
from halfshaft.library.base.tables import axis_source
from halfshaft.studies import batch

CARS = ("small-car-electric", "small-car-conventional", "small-car-series", "small-car-automatic", "small-car-power-split")
#: Not a whole number of groups, so that the last one is filled up; and some runs that begin without a number.
RUNS, LOST = 29, [4, 20, 21]
HILL = Cycle(
    name="hill", time=[0.0, 30.0, 90.0, 120.0], speed=[0.0, 22.0, 22.0, 0.0],
    grade_by_distance=([0.0, 300.0, 600.0, 5000.0], [0.0, 0.07, -0.05, 0.02]),
)  # fmt: skip
PARKED = Cycle(name="parked", time=[0.0, 8.0, 21.0, 40.0], speed=[5.0, 14.0, 0.0, 0.0], key_on=[1.0, 1.0, 0.0, 0.0])
CYCLES = (Cycle.load("us06").scaled(1.2), HILL, PARKED, Cycle.load("nedc"))
ENDS = {"body.m": (700, 6000), "body.c_d": (0.2, 0.6), "motor.torque_scale": (0.3, 1.5), "engine.torque_scale": (0.4, 1.5)}


def bits(x):
    return np.ascontiguousarray(x, dtype=float).view(np.int64)


def check(name, mode, dt, width, monkeypatch):
    """Hold a batch in lanes of a width against marches of its runs, one by one."""
    monkeypatch.setattr(batch, "widths", lambda: (width,))
    car, rng = Vehicle.load(name), np.random.default_rng(3)
    values = {number: rng.uniform(*ends, RUNS) for number, ends in ENDS.items() if number in car.values}
    cycles = [CYCLES[i] for i in rng.integers(0, len(CYCLES), RUNS)]
    compiled = stepper_of(car)
    step = compiled.step
    state = next(d.name for d in step.states if d.tag in ("charge", "fuel mass"))
    begin = np.full(RUNS, 0.6 if step.tags.all_of("charge") else 0.0)
    begin[LOST] = np.nan
    outputs = [d.name for d in step.outputs]
    summary = {output: ["integral", "max", "min", "last"] for output in outputs}
    found = batch.run_batch(car, values, cycles, mode=mode, dt=dt, initial={state: begin}, summary=summary, history=outputs[::7])
    assert np.flatnonzero(found.status).tolist() == LOST
    columns = {how: np.column_stack([found[f"{output}.{how}"].values for output in outputs]) for how in ("integral", "max", "min", "last")}
    histories = np.stack([found[output].values for output in outputs[::7]], axis=-1)
    missed = 0
    for i in set(range(RUNS)) - set(LOST):
        samples = cycles[i].sampled(dt)
        parameters = parameters_of(car.with_values({number: float(x[i]) for number, x in values.items()}), step, samples.v_start)
        first = compiled.first(parameters)
        first[step.state_index[state]] = begin[i]
        march = compiled.march(samples, parameters, first, mode)
        for how, x in (("integral", march.sums), ("max", march.highest), ("last", march.last)):
            assert np.array_equal(bits(columns[how][i]), bits(x))
        assert np.array_equal(columns["min"][i], march.history.min(axis=0))
        assert np.array_equal(bits(histories[i, : len(samples.t)]), bits(march.history[:, ::7]))
        assert mode == "hybrid" or found.unsolved[i] == march.unsolved
        missed += march.highest[step.output_index[step.tags.the("miss")]] > 0.1
    # Some of them are too weak for their cycles.
    assert 0 < missed < RUNS - len(LOST)


@pytest.mark.skipif(not lanes.widths(), reason="the processor has no wide vectors")
@pytest.mark.parametrize("name", CARS)
@pytest.mark.parametrize("mode", ["hybrid", "refined"])
def test_each_lane_has_the_bits_of_a_scalar_march(name, mode, monkeypatch):
    check(name, mode, 1.0, lanes.widths()[0], monkeypatch)


@pytest.mark.skipif(len(lanes.widths()) < 2, reason="the processor has vectors of one width at most")
@pytest.mark.parametrize("name", ["small-car-series", "small-car-automatic"])
def test_so_it_has_in_narrower_vectors_and_odd_steps(name, monkeypatch):
    check(name, "iteration", 0.7, lanes.widths()[1], monkeypatch)


@pytest.mark.skipif(not lanes.widths(), reason="the processor has no wide vectors")
def test_so_it_has_where_steps_are_no_power_of_two(monkeypatch):
    check("small-car-electric", "refined", 0.3, lanes.widths()[0], monkeypatch)


#: Each of the functions of lanes.h that has something to get wrong, for many numbers at once.
PROBE = """
#include "lanes.h"
#define EXPORT __attribute__((visibility("default")))
#define EACH(name, ...) EXPORT void name(long n, const double *a, const double *b, double *out) { \\
  for (long k = 0; k < n; k += W) { \\
    const vd x = v_load(a + k), y = v_load(b + k); \\
    double inverse[W] __attribute__((aligned(64))); \\
    for (int l = 0; l < W; ++l) inverse[l] = hs_inverse(b[k + l]); \\
    const vd r = v_load(inverse); \\
    vm special; \\
    const vd s = v_inverse(y, &special); \\
    (void)x, (void)r, (void)s, (void)special; \\
    v_store(out + k, __VA_ARGS__); \\
  } \\
}
EACH(ratio, v_ratio(x, y, r))
EACH(quotient, v_quotient(x, y, s, special))
EACH(least, v_min(x, y))
EACH(most, v_max(x, y))
EACH(sign, v_sign(x))
EACH(clip, v_clip(x, -1.5, 2.5))
EACH(power, v_pow(x, y))
EACH(choice, v_choose(v_and(v_lt(x, y), v_not(v_eq(x, v_set(1)))), x, v_number(v_or(v_le(y, x), v_ne(x, x)))))
"""


def numbers(n):
    """Return numbers of all sizes, and those that are no such, aligned as vectors are."""
    rng = np.random.default_rng(11)
    odd = [
        0.0,
        -0.0,
        np.inf,
        -np.inf,
        np.nan,
        1.0,
        -1.0,
        5e-324,
        -5e-324,
        1.7976931348623157e308,
        2.2250738585072014e-308,
        1 + 2**-52,
        2 - 2**-52,
    ]
    plain, wide = rng.normal(size=n), rng.normal(size=n) * 2.0 ** rng.integers(-1070, 1020, n)
    mixed = np.choose(rng.integers(0, 3, n), [plain, wide, rng.choice(odd, n)])
    room = np.empty(n + 8)
    aligned = room[-(room.ctypes.data // 8) % 8 :][:n]
    aligned[:] = mixed
    return aligned


@pytest.mark.parametrize("width", lanes.widths())
def test_operations_have_the_bits_of_their_scalar_forms(width):
    library = ctypes.CDLL(str(shared_library(PROBE, "probe", lanes.lanes_header(), ("-O1", *lanes.WIDTHS[width][0]))))
    n = 400_000
    a, both = numbers(n), numbers(2 * n)
    b, out = both[n:], numbers(n)
    with np.errstate(all="ignore"):
        quotient = a / b
        expected = {
            "ratio": quotient, "quotient": quotient, "least": np.where(a < b, a, b), "most": np.where(a > b, a, b),
            "sign": np.where(a < 0, -1.0, np.where(a > 0, 1.0, a)), "clip": np.where(a < -1.5, -1.5, np.where(a > 2.5, 2.5, a)),
            "power": np.array([_pow(x, y) for x, y in zip(a[:5000], b[:5000], strict=True)]),
            "choice": np.where((a < b) & (a != 1), a, (b <= a) | np.isnan(a)),
        }  # fmt: skip
    for name, values in expected.items():
        getattr(library, name)(ctypes.c_long(n), *(ctypes.c_void_p(x.ctypes.data) for x in (a, b, out)))
        found, wanted = out[: len(values)], values.astype(float)
        differ = (bits(found) != bits(wanted)) & ~(np.isnan(found) & np.isnan(wanted))
        assert not differ.any(), (name, a[: len(values)][differ][:3], b[: len(values)][differ][:3])


def _pow(x, y):
    try:
        return math.pow(x, y)
    except ValueError:
        return np.inf if x == 0 else np.nan
    except OverflowError:
        return math.copysign(np.inf, x) if y % 2 == 1 else np.inf


@pytest.mark.parametrize("width", lanes.widths())
def test_intervals_are_those_of_the_scalar_search(width):
    axes = {n: np.cumsum(np.random.default_rng(n).uniform(0.01, 1, n) ** 3) - 3.0 for n in (2, 3, 8, 9, 12, 17, 20, 33, 34, 58, 97)}
    # One library for all of them: reading lanes.h takes most of the compiler's time.
    code = "#include <math.h>\n" + "".join(axis_source(f"axis_{n}", x) for n, x in axes.items()) + '\n#include "lanes.h"\n'
    for n, points in axes.items():
        code += f"""{lanes.axis_source(f"axis_{n}", points)}
__attribute__((visibility("default"))) void both_{n}(long n, const double *x, double *wide, double *narrow) {{
  for (long k = 0; k < n; ++k) narrow[k] = axis_{n}_find(x[k]);
  for (long k = 0; k < n; k += W) {{
    long long at[W] __attribute__((aligned(64)));
    v_keep(at, {lanes.find(f"axis_{n}", points, "v_load(x + k)")});
    for (int l = 0; l < W; ++l) wide[k + l] = at[l];
  }}
}}
"""
    library = ctypes.CDLL(str(shared_library(code, "probe", lanes.lanes_header(), ("-O1", *lanes.WIDTHS[width][0]))))
    for n, points in axes.items():
        x = numbers(40_000)
        x[:20_000] = np.random.default_rng(n).uniform(points[0] - 0.5, points[-1] + 0.5, 20_000)
        x[20_000 : 20_000 + 3 * n] = np.concatenate([points, np.nextafter(points, 9), np.nextafter(points, -9)])
        wide, narrow = np.empty(len(x)), np.empty(len(x))
        library[f"both_{n}"](ctypes.c_long(len(x)), *(ctypes.c_void_p(y.ctypes.data) for y in (x, wide, narrow)))
        assert np.array_equal(wide, narrow), n


def test_a_compiler_without_the_instructions_gives_the_scalar_march(monkeypatch):
    car, values = Vehicle.load("small-car-electric"), {"body.m": [900.0, 1400.0]}
    expected = batch.run_batch(car, values, HILL)
    monkeypatch.setattr(batch, "widths", lambda: ("avx512",))
    monkeypatch.setitem(batch.WIDTHS, "avx512", (("-mno-such-thing",), set()))
    batch._plan.cache_clear()
    assert batch.run_batch(car, values, HILL).identical(expected)
    batch._plan.cache_clear()
