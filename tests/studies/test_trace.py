import math

import numpy as np
import pytest

from halfshaft import Cycle, Vehicle, run
from halfshaft.studies.trace import Driven, j2951_figures, miss_figures, road_load, trace_figures

MASS, ROAD = 1500.0, (100.0, 1.0, 0.5)
T = np.arange(0.0, 61.0)
TARGET = np.concatenate([np.zeros(5), np.linspace(0, 20, 21), np.full(15, 20.0), np.linspace(20, 0, 15), np.zeros(5)])


def test_the_five_numbers_by_hand():
    found = miss_figures(Driven(np.array([0.0, 1, 2, 4]), np.array([0.0, 4, 9, 10]), np.array([0.0, 5, 10, 8])))
    # Times around the points: 0.5, 1, 1.5 and 1 s; misses 0, 1, 1, 2.
    assert found["trace_miss_mean_mps"] == pytest.approx((1 + 1.5 + 2) / 4)
    assert found["trace_miss_time_percent"] == pytest.approx(100 * 3.5 / 4)  # above 2 mph, which is 0.894 m/s
    assert found["trace_miss_max_mps"] == 2
    assert found["trace_miss_of_top_speed_percent"] == 20
    assert found["trace_miss_of_speed_percent"] == 25
    assert (found["trace_miss_max_at_s"], found["trace_miss_of_speed_at_s"]) == (4, 4)


def by_hand(driven, mass, road):
    """Return the numbers of SAE J2951 by plain loops."""
    n = round((driven.t[-1] - driven.t[0]) / 0.1) + 1
    both = []
    for x in (driven.v, driven.target):
        v = [float(np.interp(driven.t[0] + 0.1 * i, driven.t, x)) for i in range(n)]
        for _ in range(2):
            v = [sum(v[min(max(i + j, 0), n - 1)] for j in range(-2, 3)) / 5 for i in range(n)]
        both.append(v)
    square = sum((a - b) ** 2 for a, b in zip(*both, strict=True)) / n
    found = []
    for v in both:
        v = [0.0 if x <= 0.03 else x for x in v]
        E = iw = asc = s = 0.0
        for i in range(n):
            i0, i1 = max(i - 1, 0), min(i + 1, n - 1)
            a = (v[i1] - v[i0]) / (0.1 * (i1 - i0))
            E += max(road[0] + road[1] * v[i] + road[2] * v[i] ** 2 + 1.015 * mass * a, 0) * v[i]
            iw += max(1.015 * mass * a, 0) * v[i]
            asc += abs(a)
            s += v[i]
        found.append((E, s, asc, iw))
    ER, DR, ASCR, IWR = (100 * (d / t - 1) for d, t in zip(*found, strict=True))
    EER = 100 * (1 - (DR / 100 + 1) / (ER / 100 + 1))
    return {
        "ER_percent": ER, "DR_percent": DR, "EER_percent": EER, "ASCR_percent": ASCR, "IWR_percent": IWR, "RMSSE_mps": math.sqrt(square),
    }  # fmt: skip


def test_the_numbers_of_j2951_by_plain_loops():
    rng = np.random.default_rng(7)
    driven = Driven(T, np.maximum(TARGET + rng.normal(0, 0.3, len(T)) * (TARGET > 0), 0), TARGET)
    found, expected = j2951_figures(driven, MASS, ROAD), by_hand(driven, MASS, ROAD)
    assert found.keys() == expected.keys()
    for name, x in expected.items():
        assert found[name] == pytest.approx(x, rel=1e-9, abs=1e-9), name
    assert found["IWR_percent"] > 1


def test_a_perfect_trace_has_nothing_to_tell():
    assert set(j2951_figures(Driven(T, TARGET, TARGET), MASS, ROAD).values()) == {0.0}


def test_a_trace_at_rest_has_no_ratings():
    found = j2951_figures(Driven(T, 0 * TARGET, 0 * TARGET), MASS, ROAD)
    assert found == {**dict.fromkeys(("ER_percent", "DR_percent", "EER_percent", "ASCR_percent", "IWR_percent")), "RMSSE_mps": 0.0}


def test_the_road_load_is_that_of_the_car():
    car = Vehicle.load("small-car-electric")
    p = car.values
    F_0, F_1, F_2 = road_load(run(car, Cycle.load("us06")))
    assert F_2 == pytest.approx(0.5 * p["body.rho"] * p["body.c_d"] * p["body.A"], rel=1e-3)
    assert F_0 == pytest.approx(p["wheel.f_0"] * p["body.m"] * p["body.g"], rel=0.02)
    assert F_1 == pytest.approx(0, abs=0.5)


def test_a_weak_car_misses_the_trace():
    weak = Vehicle.load("small-car-electric").with_values({"body.m": 3000})
    found = trace_figures(run(weak, Cycle.load("us06")))
    assert found["trace_miss_max_mps"] > 2
    assert found["DR_percent"] < 0
    assert found["IWR_percent"] < 0
    assert found["RMSSE_mps"] > 0.3
