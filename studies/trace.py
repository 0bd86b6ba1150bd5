"""How well a run followed its trace: the five numbers of ADVISOR, and those of SAE J2951.

SAE J2951 holds the driven trace (D) against its target (T), smoothed twice over half a second, at ten points a second::

    E    = sum of max(F_0 + F_1 v + F_2 v^2 + 1.015 m a, 0) v dt
    ER   = (E_D - E_T) / E_T          energy rating
    DR   = (s_D - s_T) / s_T          distance rating
    EER  = 1 - (1 + DR) / (1 + ER)    energy economy rating
    ASCR   the same of the sum of |a| dt, IWR of the sum of max(1.015 m a, 0) v dt
    RMSSE  root of the mean square of v_D - v_T

The road load is fitted to what the run itself lost to air and tyres.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from halfshaft.cosim.compiled import Array
from halfshaft.cosim.result import Result
from halfshaft.studies.conditions import MPH

#: Speed by which a trace may be missed [m/s].
ALLOWED = 2 * MPH
#: Rotating masses count so much on top of the vehicle's [1]; spacing of points [s], points of a mean, and speed that counts as rest [m/s].
ROTATING, SPACING, POINTS, REST = 1.015, 0.1, 5, 0.03


class Driven(NamedTuple):
    """Speeds at the start and at the end of each step of a run, as driven and as asked for [m/s], with the times [s]."""

    t: Array
    v: Array
    target: Array

    @classmethod
    def of(cls, result: Result, steps: slice = slice(None)) -> Driven:
        """Return the speeds of some steps of a run."""
        v, target = (np.concatenate([[result.first[result.tags.the("speed")]], result.the(tag)]) for tag in ("speed", "request"))
        t = np.concatenate([[result.t_start], result.time])
        first, last, _ = steps.indices(len(result.time))
        return cls(*(x[first : last + 1] for x in (t, v, target)))


def miss_figures(driven: Driven) -> dict[str, float]:
    """Return the five numbers of ADVISOR; each point weighs half of the steps beside it.

    They are the mean miss and the largest one, the share of time in which it is above 2 mph, and the largest miss over the largest speed
    asked for, and over that at the same time; of both largest ones also when they were.
    """
    miss, dt = np.abs(driven.target - driven.v), np.diff(driven.t)
    share = np.divide(miss, driven.target, out=np.zeros_like(miss), where=driven.target != 0)
    weight = (np.append(dt, 0.0) + np.append(0.0, dt)) / 2
    return {
        "trace_miss_mean_mps": float(np.average(miss, weights=weight)),
        "trace_miss_time_percent": 100 * float(weight[miss > ALLOWED].sum() / weight.sum()),
        "trace_miss_max_mps": float(miss.max()),
        "trace_miss_max_at_s": float(driven.t[miss.argmax()]),
        "trace_miss_of_top_speed_percent": 100 * float(miss.max() / max(driven.target.max(), 1e-12)),
        "trace_miss_of_speed_percent": 100 * float(share.max()),
        "trace_miss_of_speed_at_s": float(driven.t[share.argmax()]),
    }


def j2951_figures(driven: Driven, mass: float, road: tuple[float, float, float]) -> dict[str, float | None]:
    """Return the numbers of SAE J2951 for a test mass [kg] and the three coefficients of a road load [N, N.s/m, N.s^2/m^2]."""
    t = np.arange(driven.t[0], driven.t[-1] + SPACING / 2, SPACING)
    v, target = (_smoothed(_smoothed(np.interp(t, driven.t, x))) for x in (driven.v, driven.target))
    F_0, F_1, F_2 = road
    work, inertial, change, way = (np.empty(2) for _ in range(4))
    for i, u in enumerate((v, target)):
        u = np.where(u <= REST, 0.0, u)
        a = np.gradient(u, SPACING)
        F_i = ROTATING * mass * a
        work[i] = np.sum(np.maximum(F_0 + F_1 * u + F_2 * u**2 + F_i, 0) * u)
        inertial[i], change[i], way[i] = np.sum(np.maximum(F_i, 0) * u), np.sum(np.abs(a)), np.sum(u)

    def rating(of: Array) -> float | None:
        return float(of[0] / of[1] - 1) if of[1] > 0 else None

    ER, DR = rating(work), rating(way)
    ratings = {"ER": ER, "DR": DR, "EER": None if ER is None or DR is None or ER <= -1 else 1 - (1 + DR) / (1 + ER)}
    ratings |= {"ASCR": rating(change), "IWR": rating(inertial)}
    figures = {f"{name}_percent": None if x is None else 100 * x for name, x in ratings.items()}
    return {**figures, "RMSSE_mps": float(np.sqrt(np.mean((v - target) ** 2)))}


def _smoothed(v: Array) -> Array:
    """Return the means over five points; beyond the ends the trace stays at its end."""
    half = POINTS // 2
    return np.convolve(np.pad(v, half, mode="edge"), np.full(POINTS, 1 / POINTS), mode="valid")


def road_load(result: Result) -> tuple[float, float, float]:
    """Return the coefficients of a road load that is nearest to what a run lost to air and tyres."""
    lost = sum(result[name] for tag in ("air drag", "rolling resistance") for name in result.tags.all_of(tag))
    v = result.the("speed")
    v = (v + np.append(result.first[result.tags.the("speed")], v[:-1])) / 2
    moving = v > 1.0
    if moving.sum() < POINTS:
        return 0.0, 0.0, 0.0
    rows = np.column_stack([v[moving] ** i for i in range(1, 4)])
    a, b, c = np.linalg.lstsq(rows, np.asarray(lost)[moving], rcond=None)[0]
    return float(a), float(b), float(c)


def trace_figures(result: Result, steps: slice = slice(None)) -> dict[str, float | None]:
    """Return all numbers of some steps of a run with its history."""
    driven = Driven.of(result, steps)
    mass = result.inputs.parameters[result.tags.the("vehicle mass")]
    return {**miss_figures(driven), **j2951_figures(driven, mass, road_load(result))}
