"""Makes a cycle of what a recorder wrote: gaps found and filled, outliers dropped, noise smoothed away, rests at rest.

The method, in this order:

1. *Gaps.*  A step of more than a second and of three times the usual one is a gap.  In it the speed is taken to be a straight line:
   of any length where the vehicle stands before and after it, of at most `longest_gap` where it moves; longer ones are refused.
2. *Outliers.*  A point farther from the median of a second around it than four standard deviations (1.4826 times the median
   deviation of ten seconds around it) is dropped, and a straight line takes its place (a Hampel filter).
3. *Even steps*, of the usual length.
4. *Rests.*  The vehicle rests where the median over two seconds stays below a threshold for a second and more: 0.3 m/s, or 1.5 times
   the noise.  There the speed is zero.
5. *Smoothing.*  Between rests, a polynomial of second order is fitted by least squares to the `window` around each point (a
   Savitzky-Golay filter), the trace being mirrored about the points where the vehicle starts and stops, so that these stay where they are.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from halfshaft.cosim.cycle import Array, Cycle
from halfshaft.library.base.errors import InputError, number

#: A gap is longer than this [s] and than so many usual steps.
GAP, GAP_STEPS = 1.0, 3.0
#: Windows of the outliers' median, of the noise's, and of the rests' [s].
NEAR, AROUND, RESTING = 1.0, 10.0, 2.0
#: An outlier is so many standard deviations off, and this much [m/s].
OUTLIER, LEAST = 4.0, 0.1
#: Below this speed [m/s], or so many standard deviations of the noise, a vehicle rests; it starts and stops at about this [m/s^2].
REST, REST_NOISE, START = 0.3, 1.5, 1.0
#: Shortest rest, and shortest motion between two [s].
SHORTEST = 1.0
#: A median deviation of normal noise is its standard deviation over this.
NORMAL = 1.4826
#: A trace is no longer than so many of its usual steps.
MOST = 10_000_000
#: A polynomial of second order is fitted to at least so many points.
FEWEST = 5


class Gap(NamedTuple):
    """A time without points: when it begins and ends [s], and the speeds there [m/s]."""

    begin: float
    end: float
    v_begin: float
    v_end: float

    @property
    def length(self) -> float:
        """How long it is [s]."""
        return self.end - self.begin

    @property
    def moving(self) -> bool:
        """Whether the vehicle moved at one of its ends."""
        return max(self.v_begin, self.v_end) > REST

    def __str__(self) -> str:
        """Return its length, place and speeds in words."""
        speeds = f"{self.v_begin * 3.6:.3g} before and {self.v_end * 3.6:.3g} km/h after"
        return f"{self.length:.3g} s without points from t = {self.begin:g} s on, {speeds}"


def gaps(cycle: Cycle) -> tuple[Gap, ...]:
    """Return where a recorder's trace has no points for longer than a second and three usual steps."""
    dt = np.diff(cycle.time)
    usual = float(np.median(dt)) if len(dt) else 0.0
    places = np.flatnonzero(dt > max(GAP, GAP_STEPS * usual) * (1 + 1e-6))
    t, v = cycle.time.tolist(), cycle.speed.tolist()
    return tuple(Gap(t[i], t[i + 1], v[i], v[i + 1]) for i in places)


def restored(cycle: Cycle, *, window: float = 3.0, longest_gap: float = 10.0) -> Cycle:
    """Return a recorder's trace as a vehicle can have driven it; see the head of this file for the method.

    Its distance, its stops and its times stay; what was done stands in its notes.

    Parameters
    ----------
    cycle
        What was recorded, best at 5 Hz and above.
    window
        Time that each polynomial is fitted to [s]; it has five points at least.
    longest_gap
        Longest gap in motion that is filled [s].

    Raises
    ------
    InputError
        If gaps are too long to be filled; all of them are named.

    """
    from scipy.ndimage import binary_closing, binary_erosion, binary_opening, median_filter  # scipy takes a quarter of a second

    width, longest = number(window), number(longest_gap)
    problems = [f"{name} = {x:g} s, must be > 0 s" for name, x in (("window", width), ("longest_gap", longest)) if not 0 < x < np.inf]
    if len(cycle.time) <= 2 * FEWEST:
        problems.append(f"has {len(cycle.time)} points, must have more than {2 * FEWEST}")
    if problems:
        raise InputError(f"cycle '{cycle.name}'", problems)
    dt = float(np.median(np.diff(cycle.time)))
    if cycle.duration / dt > MOST:
        raise InputError(f"cycle '{cycle.name}'", [f"is {cycle.duration / dt:.3g} of its usual steps long, must be at most {MOST:g}"])

    def points(seconds: float) -> int:
        """Return how many points, always odd, lie in a time."""
        return 2 * round(min(seconds, cycle.duration / 2) / dt / 2) + 1

    off = np.abs(cycle.speed - median_filter(cycle.speed, points(NEAR), mode="nearest"))
    noise = NORMAL * float(np.median(off))
    outlier = off > np.maximum(OUTLIER * NORMAL * median_filter(off, points(AROUND), mode="nearest"), LEAST)
    slowest = max(REST, REST_NOISE * noise)
    found = gaps(cycle)
    long = [gap for gap in found if gap.length > longest and max(gap.v_begin, gap.v_end) > slowest]
    if long:
        cure = f"must be at most {longest:g} s, or at rest on both sides; cut the trace there, or allow longer ones"
        raise InputError(f"cycle '{cycle.name}'", [*map(str, long), cure])

    time = np.linspace(cycle.time[0], cycle.time[-1], round(cycle.duration / dt) + 1)
    v = np.interp(time, cycle.time[~outlier], cycle.speed[~outlier])
    shortest = np.ones(max(round(SHORTEST / dt), 1))
    still = median_filter(v, points(RESTING), mode="nearest") < slowest
    # The ends of the trace go on as they are.
    beyond = 2 * len(shortest)
    for change in (binary_closing, binary_opening):
        still = change(np.pad(still, beyond, mode="edge"), shortest)[beyond:-beyond]
    # A vehicle moves some time before it is found to.
    early = round(slowest / START / dt)
    if early:
        still = binary_erosion(np.pad(still, early, mode="edge"), np.ones(2 * early + 1))[early:-early]
    v[still] = 0.0
    fitted = max(points(width), FEWEST)
    _smooth_between(v, still, fitted)
    told = [f"a polynomial of second order was fitted to {(fitted - 1) * dt:.3g} s around each point (Savitzky-Golay)"]
    if outlier.any():
        told.append(f"{outlier.sum()} of {len(outlier)} points were dropped as outliers")
    told += [f"filled by a straight line: {gap}" for gap in found]
    rows = {name: np.interp(time, cycle.time, x) for name in ("grade", "key_on") if (x := getattr(cycle, name)) is not None}
    if "key_on" in rows:
        rows["key_on"] = (rows["key_on"] > 0).astype(float)
    return replace(cycle, name=f"{cycle.name[:80]}-restored", time=time, speed=v, notes=(*cycle.notes, *told), **rows)


def _smooth_between(v: Array, still: npt.NDArray[np.bool_], fitted: int) -> None:
    """Smooth each stretch of motion in place, so that it starts and ends at rest where it does."""
    from scipy.signal import savgol_filter

    edges = np.flatnonzero(np.diff(np.concatenate([[1], still, [1]]).astype(int)))
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        first, beyond = max(begin - 1, 0), min(end + 1, len(v))
        stretch = v[first:beyond]
        half = min(fitted // 2, len(stretch) - 1)
        if half < 2:
            continue
        mirrored = np.pad(stretch, half, mode="reflect", reflect_type="odd")
        v[first:beyond] = np.maximum(savgol_filter(mirrored, 2 * half + 1, 2)[half:-half], 0.0)
