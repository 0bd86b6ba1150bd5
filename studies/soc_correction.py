"""Fuel of a hybrid whose battery ends where it began: state-of-charge correction.

A run that draws on the battery or charges it tells nothing of the fuel alone.  *Zero-delta* looks for the state of charge s at the start
from which the run ends where it began.  With d the change of charge of a run:

1. the first run starts in the middle of the window that the control keeps;
2. stop once ``|d|`` is below the tolerance, or what the battery gave is little beside the fuel's energy (SAE J1711: 1 %);
3. with one sign of d only, s moves on from the best run by d, and by three times as much with each further run; between two runs of
   opposite sign, the nearest to each other, it comes by linear interpolation, in which no d counts more than 0.1, but no nearer to
   either than a fifth of their distance;
4. s stays within 0 and 1.

(The original interpolates between the runs of smallest ``|d|``, and moves on by single steps.  With a thermostat, which starts its genset
once more or not, d falls by steps as s grows, and that takes 15 runs and more.  There may then be no charge at all that is kept to
0.005; hence the second criterion, which the original has too, but one at a time.)

The run of the smallest ``|d|`` is the answer, whether or not it met the tolerance; the record shows all.

*Linear* runs twice, from just below and just above the window, and interpolates fuel per distance to d = 0.  It does not extrapolate.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any, Generic, Literal, TypeAlias, TypeVar, get_args

import numpy as np

from halfshaft.cosim.cycle import Cycle
from halfshaft.cosim.result import Result
from halfshaft.cosim.simulate import run
from halfshaft.cosim.units import mpg
from halfshaft.cosim.ways import Mode
from halfshaft.library.base.errors import InputError, number
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.conditions import charge_at, window
from halfshaft.studies.economy import gasoline_L

T = TypeVar("T")
Status: TypeAlias = Literal["converged", "max_iterations", "one_sided"]
#: What is kept: the charge, or an energy of the battery that is little beside the fuel's; either will do.
Criterion: TypeAlias = Literal["either", "charge", "energy"]
CRITERIA: tuple[Criterion, ...] = get_args(Criterion)
#: Change of charge, and energy of the battery over that of the fuel, that count as none [1].
CHARGE, ENERGY = 0.005, 0.01
MOST_RUNS = 15
#: Growth of the steps with one sign; largest change that tells how far it is, and least share of a bracket that a run goes into it [1].
HURRY, LARGE, NEAREST = 3, 0.1, 0.2
#: What is shown first of a corrected run.
REPORTED = (
    "distance_m", "fuel_economy_L_per_100km", "gasoline_equivalent_L_per_100km", "soc_start", "soc_end", "trace_miss_max_mps", "runs",
)  # fmt: skip
#: How far outside of the window the linear correction starts, and how far from the vehicle's own charge where there is no window [1].
OUTSIDE, AROUND = 0.01, 0.05


@dataclass(frozen=True)
class Trial:
    """One run of a correction: the charge at its start, its change [1], and fuel per distance and energy ratio where they are known.

    The energy ratio is the energy that the battery gave over that of the fuel.
    """

    soc: float
    change: float
    fuel_L_per_100km: float | None = None
    energy_ratio: float | None = None


@dataclass(frozen=True)
class Search(Generic[T]):
    """What the search for a charge that is kept found: the trials in their order, which was the best, and what it gave."""

    record: tuple[Trial, ...]
    best: int
    found: T
    status: Status


def zero_delta(
    drive: Callable[[float], tuple[Trial, T]],
    start: float,
    *,
    criterion: Criterion = "either",
    charge: float = CHARGE,
    energy: float = ENERGY,
    most_runs: int = MOST_RUNS,
) -> Search[T]:
    """Look for the charge at the start at which something ends with the charge that it began with.

    Parameters
    ----------
    drive
        Drives from a state of charge and returns how it went, and what is to be kept of it.
    start
        State of charge of the first run.
    criterion
        Whether the ``charge`` must be kept, the ``energy`` of the battery be little beside that of the fuel, or ``either``.
    charge, energy
        Below which a change of charge, and the energy of the battery over that of the fuel, are none [1].
    most_runs
        After so many runs the search ends.

    """
    record: list[Trial] = []
    tolerances = {"charge": charge, "energy": energy}
    best, kept, s = 0, None, start
    while True:
        trial, found = drive(s)
        record.append(trial)
        if len(record) == 1 or abs(trial.change) < abs(record[best].change):
            best, kept = len(record) - 1, found
        measures = {"charge": trial.change, "energy": trial.energy_ratio}
        within = [abs(x) < tolerances[c] for c, x in measures.items() if x is not None and criterion in (c, "either")]
        if any(within):
            return Search(tuple(record), len(record) - 1, found, "converged")
        rises, falls = ([i for i, t in enumerate(record) if sign * t.change > 0] for sign in (1, -1))
        if rises and falls:
            up, down = (record[i] for i in min(product(rises, falls), key=lambda pair: abs(record[pair[0]].soc - record[pair[1]].soc)))
            rise, fall = min(up.change, LARGE), min(-down.change, LARGE)
            s = up.soc + min(max(rise / (rise + fall), NEAREST), 1 - NEAREST) * (down.soc - up.soc)
        else:
            s = record[best].soc + HURRY ** (len(record) - 1) * record[best].change
        s = min(max(s, 0.0), 1.0)
        # A run again from an empty or a full battery would tell nothing new.
        if len(record) >= most_runs or any(t.soc == s for t in record):
            assert kept is not None
            return Search(tuple(record), best, kept, "max_iterations" if rises and falls else "one_sided")


@dataclass(frozen=True)
class Corrected:
    """A fuel economy at a charge that is kept.

    Parameters
    ----------
    figures
        Those of the run (of a linear correction, interpolated ones), and ``runs``.
    status
        ``converged``; ``max_iterations``; or ``one_sided``, where the charge rose in all runs or fell in all.
    record
        All runs, in their order.
    result
        The best run; of a linear correction, the last one.
    notes
        What a user should know.

    """

    figures: Mapping[str, float | None]
    status: Status
    record: tuple[Trial, ...]
    result: Result
    notes: tuple[str, ...] = ()

    @property
    def reported(self) -> tuple[str, ...]:
        """Names of the figures to show first."""
        return tuple(name for name in REPORTED if name in self.figures)


@dataclass(frozen=True, kw_only=True)
class ZeroDelta:
    """The task to drive a cycle with a zero-delta correction.

    Parameters
    ----------
    cycle
        What is driven.
    criterion, charge, energy, most_runs
        As in `zero_delta`.
    mode, dt
        As in `run`.

    """

    cycle: Cycle
    criterion: Criterion = "either"
    charge: float = CHARGE
    energy: float = ENERGY
    most_runs: int = MOST_RUNS
    mode: Mode = "hybrid"
    dt: float = 1.0

    @property
    def name(self) -> str:
        """The cycle's name and the correction's."""
        return f"{self.cycle.name}-zero-delta"

    def __call__(self, vehicle: Vehicle) -> Corrected:
        """Drive the cycle as often as it takes.

        Raises
        ------
        InputError
            If an option is not what it must be, or the vehicle has nothing to correct.

        """
        problems = _problems(charge=self.charge, energy=self.energy)
        if self.criterion not in CRITERIA:
            problems.append(f"criterion = {self.criterion!r}, must be {' or '.join(CRITERIA)}")
        if not number(self.most_runs) >= 1:
            problems.append(f"most_runs = {self.most_runs!r}, must be >= 1")
        check_correctable(vehicle, problems)

        def drive(soc: float) -> tuple[Trial, Result]:
            result = run(started(vehicle, soc), self.cycle, mode=self.mode, dt=self.dt)
            return trial_of(result), result

        search = zero_delta(
            drive, first_charge(vehicle), criterion=self.criterion, charge=self.charge, energy=self.energy, most_runs=self.most_runs
        )
        return Corrected(
            {**plain_figures(search.found), "runs": len(search.record)},
            search.status,
            search.record,
            search.found,
            (*said_of(search), *search.found.warnings),
        )


@dataclass(frozen=True, kw_only=True)
class Linear:
    """The task to drive a cycle with a linear correction.

    Parameters
    ----------
    cycle
        What is driven.
    tolerance
        Change of charge of the first run from which a second one is needed [1].
    mode, dt
        As in `run`.

    """

    cycle: Cycle
    tolerance: float = CHARGE
    mode: Mode = "hybrid"
    dt: float = 1.0

    @property
    def name(self) -> str:
        """The cycle's name and the correction's."""
        return f"{self.cycle.name}-linear"

    def __call__(self, vehicle: Vehicle) -> Corrected:
        """Drive the cycle once or twice.

        Raises
        ------
        InputError
            If an option is not what it must be, or the vehicle has nothing to correct.

        """
        check_correctable(vehicle, _problems(tolerance=self.tolerance))
        ends = window(vehicle)
        low, high = (ends[0] - OUTSIDE, ends[1] + OUTSIDE) if ends else (first_charge(vehicle) + x for x in (-AROUND, AROUND))
        results = [run(started(vehicle, max(low, 0.0)), self.cycle, mode=self.mode, dt=self.dt)]
        if abs(trial_of(results[0]).change) > self.tolerance:
            results.append(run(started(vehicle, min(high, 1.0)), self.cycle, mode=self.mode, dt=self.dt))
        record = tuple(trial_of(r) for r in results)
        shown, figures = results[-1], dict[str, float | None](runs=len(results))
        d = [t.change for t in record]
        status: Status = "converged"
        notes: tuple[str, ...] = ("time series and warnings are those of the last run",)
        if len(record) == 1:
            return Corrected({**plain_figures(shown), **figures}, status, record, shown, shown.warnings)
        names = ("fuel_economy_L_per_100km", "gasoline_equivalent_L_per_100km")
        if d[0] * d[1] > 0:
            status = "one_sided"
            figures |= dict.fromkeys((*names, "fuel_economy_mpg"))
            which = "rose" if d[0] > 0 else "fell"
            cause = "" if d[0] > 0 else ": the converter is too small to charge on this cycle, or kept from it"
            notes = (f"no linear correction: the charge {which} from both ends of the window ({d[0]:+.4f}, {d[1]:+.4f}){cause}", *notes)
        else:
            each = [plain_figures(r) for r in results]
            figures |= {n: float(np.interp(0.0, *_rising(d, [float(f[n] or 0.0) for f in each]))) for n in names}
            x = figures["fuel_economy_L_per_100km"]
            figures["fuel_economy_mpg"] = mpg(x) if x else None
        return Corrected(figures, status, record, shown, (*notes, *shown.warnings))


def _rising(x: list[float], y: list[float]) -> tuple[list[float], list[float]]:
    """Return two points in the order of x."""
    return (x, y) if x[0] < x[1] else (x[::-1], y[::-1])


def _problems(**tolerances: float) -> list[str]:
    return [f"{name} = {x!r}, must be > 0 and < 1" for name, x in tolerances.items() if not 0 < number(x) < 1]


def check_correctable(vehicle: Vehicle, problems: list[str] | None = None) -> None:
    """Raise an error unless a vehicle has both a store and something that burns fuel, and no other problem was found."""
    found = list(problems or ())
    missing = [what for tag, what in (("start charge", "no battery"), ("fuel density", "nothing that burns fuel")) if not has(vehicle, tag)]
    if missing:
        found.append(f"vehicle '{vehicle.name}' has {' and '.join(missing)}: there is no charge to keep at the cost of fuel")
    if found:
        raise InputError("correction of the state of charge", found)


def has(vehicle: Vehicle, tag: Any) -> bool:
    """Return whether a vehicle has a parameter with a tag."""
    return bool(vehicle.tags.all_of(tag))


def first_charge(vehicle: Vehicle) -> float:
    """Return where a search begins: the middle of the window, or the vehicle's own charge."""
    middle = charge_at(vehicle, "middle")
    return vehicle.values[vehicle.tags.all_of("start charge")[0]] if middle is None else middle


def started(vehicle: Vehicle, soc: float) -> Vehicle:
    """Return a vehicle that starts at a state of charge."""
    return vehicle.with_values(dict.fromkeys(vehicle.tags.all_of("start charge"), soc))


def trial_of(result: Result) -> Trial:
    """Return a run as a trial."""
    f, a = result.figures, result.account
    ratio = a.battery / a.fuel if a.fuel > 0 else None
    return Trial(f["soc_start"], f["soc_end"] - f["soc_start"], f["fuel_economy_L_per_100km"], ratio)


def plain_figures(result: Result) -> dict[str, float | None]:
    """Return the numbers of a run's summary, and its gasoline equivalent."""
    figures = {k: x for k, x in result.figures.items() if not isinstance(x, str)}
    distance = figures["distance_m"]
    burnt = figures["fuel_L"] is not None and distance
    return figures | {"gasoline_equivalent_L_per_100km": 1e5 * gasoline_L(result.account.fuel) / distance if burnt and distance else None}


def said_of(search: Search[Any]) -> tuple[str, ...]:
    """Return what to say of a search that did not converge."""
    if search.status == "converged":
        return ()
    d, n = search.record[search.best].change, len(search.record)
    why = ": it moved the same way in all of them" if search.status == "one_sided" else ""
    return (f"the charge is not kept: after {n} runs it still changes by {d:+.4f}{why}",)
