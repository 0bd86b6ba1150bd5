"""Road load from coast-downs: equation (1) of `roll_out` fitted to speeds over time.

A car of mass ``m`` rolls out in neutral; what turns with the wheels counts as a mass of its own, so that its inertia is ``m_e = m + m_r``.
Driven in both directions, the runs share their coefficients, and a wind along the track and its slope are found beside them.  With
``d`` = 1 one way and -1 the other::

    F_d(v) = A + B v + C (v + d w)^2 + d m g theta                           (1)

so that ``A``, ``B`` and ``C`` are those of calm air and a flat road.  Runs of one direction alone say nothing of wind and slope:
what there was of them is in the coefficients.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from halfshaft.cosim.cycle_file import TRACE, read_csv
from halfshaft.library.base.errors import InputError, number
from halfshaft.library.files.component_file import parse_quantity
from halfshaft.library.files.notebook import Grid, card
from halfshaft.studies.calibration.least_squares import Array, Fit, Loss, Measured, Unknown, fit
from halfshaft.studies.calibration.record import checked_rows
from halfshaft.studies.calibration.road_load import COEFFICIENTS, RoadLoad
from halfshaft.studies.calibration.roll_out import rolled

if TYPE_CHECKING:
    from halfshaft.cosim.plot import Picture

#: What turns counts as this share of the mass where nothing is said.
ROTATING = "3 %"
#: A car that rolls out is looked at down to this speed, where nothing is said [m/s].
LOWEST = 15 / 3.6
G = 9.81
#: Least rows of a run between the speeds that are looked at.
FEWEST = 5


@dataclass(frozen=True, kw_only=True, eq=False)
class CoastDown:
    """One run of a car that rolls out.

    Parameters
    ----------
    name
        What it is called.
    time, speed
        Rising times [s], and the speed at each [m/s].
    direction
        1, or -1 for a run the other way along the same track.

    Raises
    ------
    InputError
        If the rows are not what they must be; everything that is wrong is named at once.

    """

    name: str
    time: Array
    speed: Array
    direction: int = 1

    def __post_init__(self) -> None:
        """Check what was given."""
        problems = checked_rows(self, "time", "speed")
        if self.direction not in (1, -1):
            problems.append(f"direction = {self.direction!r}, must be 1 or -1")
        if problems:
            raise InputError(f"coast-down '{self.name}'", problems)

    def __repr__(self) -> str:
        return f"<CoastDown {self.name}: {len(self.time)} rows>"

    @classmethod
    def load(cls, path: str | Path, direction: int = 1) -> CoastDown:
        """Return the run of a CSV file with a time and a speed, as a cycle's; its other columns are left out."""
        _, columns = read_csv(Path(path), {name: TRACE[name] for name in ("time", "speed")}, "time", lambda _: None)
        return cls(name=Path(path).stem, time=columns["time"], speed=columns["speed"], direction=direction)

    def between(self, low: float, high: float) -> CoastDown:
        """Return the part from the last row at `high` or above to the first at `low` or below [m/s]."""
        above, below = np.flatnonzero(self.speed >= high), np.flatnonzero(self.speed <= low)
        # A driver may have set out from rest.
        first = int(above[-1]) if len(above) else int(np.argmax(self.speed))
        after = below[below > first]
        last = int(after[0]) if len(after) else len(self.speed)
        return replace(self, time=self.time[first:last], speed=self.speed[first:last])


@dataclass(frozen=True, eq=False)
class CoastedDown:
    """What coast-downs tell.

    Parameters
    ----------
    load
        The road load in calm air on a flat road, with its covariance.
    runs
        What was looked at of each run.
    inertia
        Mass with that of what turns [kg].
    fit
        What least squares found.
    notes
        What to know about it.

    """

    load: RoadLoad
    runs: tuple[CoastDown, ...]
    inertia: float
    fit: Fit
    notes: tuple[str, ...]

    @property
    def wind(self) -> float | None:
        """Head wind of the runs of direction 1 [m/s]; None where all ran the same way."""
        return self._found("wind")

    @property
    def grade(self) -> float | None:
        """Rise over run that the runs of direction 1 went up; None where all ran the same way."""
        return self._found("grade")

    def _found(self, name: str) -> float | None:
        names = [u.name for u in self.fit.unknowns]
        return float(self.fit.x[names.index(name)]) if name in names else None

    @property
    def rms(self) -> float:
        """Root of the mean square of the speeds' residuals [m/s]."""
        return float(np.sqrt(np.mean((self.fit.after - self.fit.measured) ** 2)))

    def __repr__(self) -> str:
        return f"<CoastedDown {self.load!r}, {len(self.runs)} runs, residuals {self.rms:.2g} m/s>"

    def _repr_html_(self) -> str:
        facts = {"runs": ", ".join(run.name for run in self.runs), "residuals": f"{self.rms:.3g} m/s", "notes": "; ".join(self.notes)}
        return card(
            "road load", f"at {self.load.m:g} kg", facts, Grid(("", "value", "95 % interval", "unit", "in lbf and mph"), self.load.rows())
        )

    def plot(self, path: str | Path | None = None) -> Picture:
        """Draw speeds and their residuals over time, and the load over speed; `path` is a PNG, SVG or PDF file to write."""
        from halfshaft.studies.calibration.pictures import plot_coast_down  # matplotlib takes a quarter of a second

        return plot_coast_down(self, path=path)


def coast_down(
    runs: CoastDown | Sequence[CoastDown],
    m: float | str,
    *,
    rotating: float | str = ROTATING,
    between: tuple[float, float] = (LOWEST, np.inf),
    sigma: float | None = None,
    loss: Loss = "linear",
    linear: bool = True,
) -> CoastedDown:
    """Return the road load that coast-downs tell.

    Parameters
    ----------
    runs
        One run or several; those the other way have ``direction=-1``.
    m
        Mass of the car at the test [kg], or a text with a unit.
    rotating
        What turns with the wheels, as a mass: a number [kg], or a text with a unit or in per cent of the mass.
    between
        Lowest and highest speed that are looked at [m/s].
    sigma
        Standard uncertainty of a speed [m/s]; found from the residuals if None.
    loss
        How residuals count: ``linear`` squares; ``soft_l1``, ``huber``, ``cauchy`` let outliers count less.
    linear
        Whether there is a part B that grows with speed; else it is 0.

    Raises
    ------
    InputError
        If something is not what it must be, or a run is too short; everything that is wrong is named at once.

    """
    runs = (runs,) if isinstance(runs, CoastDown) else tuple(runs)
    problems = [] if runs and all(isinstance(run, CoastDown) for run in runs) else ["runs must be a CoastDown or several"]
    mass = _mass(m, "m", problems)
    turning = _turning(rotating, mass, problems)
    low, high = (number(v) for v in between)
    if not 0 <= low < high:
        problems.append(f"between = {between}, must be two rising speeds in m/s")
    if sigma is not None and not 0 < number(sigma) < np.inf:
        problems.append(f"sigma = {sigma!r} m/s, must be > 0 m/s")
    parts = () if problems else tuple(run.between(low, high) for run in runs)
    for run, part in zip(runs, parts, strict=False):
        if len(part.time) < FEWEST:
            problems.append(f"{run.name}: {len(part.time)} rows between {low:.4g} and {high:.4g} m/s, there must be at least {FEWEST}")
        elif not part.speed[-1] < part.speed[0]:
            problems.append(f"{run.name}: the speed does not fall, from {part.speed[0]:.4g} to {part.speed[-1]:.4g} m/s")
    if problems:
        raise InputError("coast-down", problems)
    inertia, both = mass + turning, len({run.direction for run in parts}) > 1
    longest = max(parts, key=lambda run: run.speed[0] - run.speed[-1])
    v = longest.speed[0]
    F = inertia * (v - longest.speed[-1]) / (longest.time[-1] - longest.time[0])
    unknowns = [Unknown("A", COEFFICIENTS["A"], F / 2, 0.0, np.inf, F)]
    unknowns += [Unknown("B", COEFFICIENTS["B"], 0.0, -np.inf, np.inf, F / v)] * linear
    unknowns += [Unknown("C", COEFFICIENTS["C"], F / v**2, 0.0, np.inf, F / v**2)]
    unknowns += [Unknown("wind", "m/s", 0.0, -50.0, 50.0, 3.0), Unknown("grade", "1", 0.0, -0.2, 0.2, 0.01)] * both
    k = len(unknowns)
    unknowns += [Unknown(f"speed at the start of {run.name}", "m/s", float(run.speed[0]), scale=1.0) for run in parts]

    def model(x: Array) -> tuple[Array, Array]:
        A, (B, C) = x[0], x[1:3] if linear else (0.0, x[1])
        w, theta = x[k - 2 : k] if both else (0.0, 0.0)
        found, slopes = [], []
        for i, run in enumerate(parts):
            d = run.direction
            own = A + C * w**2 + d * mass * G * theta, B + 2 * d * C * w, C
            speed, by = rolled(run.time - run.time[0], x[k + i], own, inertia)
            a, b, c, v_0 = by.T
            columns = [a, *([b] * linear), a * w**2 + b * 2 * d * w + c]
            columns += [a * 2 * C * w + b * 2 * d * C, a * d * mass * G] * both
            others = np.zeros((len(speed), len(parts)))
            others[:, i] = v_0
            found.append(speed)
            slopes.append(np.column_stack([*columns, others]))
        return np.concatenate(found), np.concatenate(slopes)

    # One uncertainty for all: the runs are of one instrument.
    speeds = np.concatenate([run.speed for run in parts])
    done = fit(unknowns, model, [Measured("speed", speeds, None if sigma is None else np.full(len(speeds), float(sigma)))], loss)
    names = [u.name for u in done.unknowns]
    place = [names.index(name) for name in ("A", *("B" * linear), "C")]
    covariance, into = np.zeros((3, 3)), [0, 1, 2] if linear else [0, 2]
    covariance[np.ix_(into, into)] = done.covariance[np.ix_(place, place)]
    A, B, C = (float(done.x[names.index(name)]) if name in names else 0.0 for name in "ABC")
    source = f"coast-down of {', '.join(run.name for run in runs)} at {mass:g} kg and {turning:.4g} kg for what turns"
    span = min(float(run.speed.min()) for run in parts), max(float(run.speed.max()) for run in parts)
    load = RoadLoad(A=A, B=B, C=C, m=mass, source=source, v=(max(span[0], 0.0), span[1]), covariance=covariance, dof=done.dof)
    notes = [*done.doubts, *done.blind]
    if not both:
        notes.append("all runs went the same way: wind and slope of the road, if there were any, are in the coefficients")
    return CoastedDown(load, parts, inertia, done, tuple(notes))


def _mass(given: float | str, name: str, problems: list[str]) -> float:
    """Return a mass [kg], and add to `problems` if it is none."""
    try:
        m = parse_quantity(given, "kg", name) if isinstance(given, str) and not re.fullmatch(r"[\s\d.e+-]*", given) else number(given)
    except InputError as error:
        problems.extend(error.problems)
        return np.nan
    if not 10 <= m <= 1e6:
        problems.append(f"{name} = {given} kg, must be >= 10 kg and <= 1e+06 kg")
    return m


def _turning(given: float | str, mass: float, problems: list[str]) -> float:
    """Return the mass that stands for what turns [kg], and add to `problems` if it is none."""
    text = str(given).strip()
    share = text.endswith("%")
    try:
        x = (
            0.01 * mass * number(text[:-1])
            if share
            else parse_quantity(text, "kg", "rotating")
            if re.search("[a-zA-Z]$", text)
            else number(text)
        )
    except InputError as error:
        problems.extend(error.problems)
        return np.nan
    if not (0 <= x <= mass or np.isnan(mass)):
        problems.append(f"rotating = {text}, must be >= 0 and no more than the mass")
    return x
