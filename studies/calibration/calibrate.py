"""Numbers of a vehicle from what was measured on drives.

Each evaluation runs the vehicle over all drives with exact derivatives (`halfshaft.cosim.gradient`); `record` says how a run predicts
what was measured, and `least_squares` how numbers and what is known of them follow.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, get_args

import numpy as np

from halfshaft.cosim.compiled import MODES
from halfshaft.cosim.gradient import slopes
from halfshaft.cosim.simulate import stepper_of
from halfshaft.cosim.ways import Mode
from halfshaft.library.base.errors import InputError, nearest, not_a, number
from halfshaft.library.base.parameters import Spec
from halfshaft.library.files.component_file import Reader, shown
from halfshaft.library.files.notebook import Grid, card
from halfshaft.models.vehicle import OWN, Vehicle
from halfshaft.studies.calibration.least_squares import Array, Fit, Loss, Measured, Unknown, fit
from halfshaft.studies.calibration.record import Predicted, Record, density_of, problems_of

if TYPE_CHECKING:
    from halfshaft.cosim.plot import Picture

#: Between what a number may lie: a text such as ``0.2..0.5`` or ``50..100 kW``, a pair in SI, or nothing for its own bounds.
Bounds: TypeAlias = str | tuple[float, float] | None
_NUMBER = re.compile(r"[-+]?[\d.]+(?:[eE][-+]?\d+)?")
MOST_STARTS = 100_000
#: What the columns of the tables are.
FOUND = ("number", "before", "found", "95 % interval", "unit")
MATCHED = ("series", "rows", "uncertainty", "", "residual before", "after", "unit")


class Matched(NamedTuple):
    """How one series was met: residuals are roots of mean squares, uncertainties means, SI."""

    name: str
    unit: str
    rows: int
    sigma: float
    stated: bool
    before: float
    after: float


@dataclass(frozen=True, eq=False)
class Calibration:
    """What a calibration found.

    Parameters
    ----------
    base, vehicle
        As it was, and with the numbers found: to run, save and change as any other.
    records
        The drives.
    predicted
        How each series was predicted, drive by drive.
    fit
        What least squares found: values, covariance, residuals.
    mode, dt
        How the runs were made.
    notes
        What to know about it: what the data cannot tell, what speaks against the model, and what was left out.

    """

    base: Vehicle
    vehicle: Vehicle
    records: tuple[Record, ...]
    predicted: tuple[tuple[Predicted, ...], ...]
    fit: Fit
    mode: Mode
    dt: float
    notes: tuple[str, ...]

    @property
    def values(self) -> dict[str, float]:
        """The numbers found, by name [SI]."""
        return {u.name: float(x) for u, x in zip(self.fit.unknowns, self.fit.x, strict=True)}

    @property
    def intervals(self) -> dict[str, tuple[float, float]]:
        """Their 95 % intervals, by name [SI]; infinite where the data do not tell."""
        return {u.name: (float(a), float(b)) for u, (a, b) in zip(self.fit.unknowns, self.fit.intervals, strict=True)}

    @cached_property
    def matched(self) -> tuple[Matched, ...]:
        """How each series was met."""
        found, off, units = [], (self.fit.before - self.fit.measured, self.fit.after - self.fit.measured), self._units
        for i, g in enumerate(self.fit.groups):
            rows = self.fit.rows(i)
            before, after = (float(np.sqrt(np.mean(r[rows] ** 2))) for r in off)
            sigma = float(np.sqrt(np.mean(self.fit.sigma[rows] ** 2)))
            found.append(Matched(g.name, units[i], len(g.values), sigma, g.sigma is not None, before, after))
        return tuple(found)

    @property
    def _units(self) -> list[str]:
        flat = [p for of in self.predicted for p in of]
        return [f"{p.output.unit}.s" if p.form == "gain" and not p.state else f"{p.output.unit}/s" if p.form == "rate" and p.state
                else p.output.unit for p in flat]  # fmt: skip

    def rows(self) -> list[tuple[str, str, str, str, str]]:
        """Return the numbers found as texts, by `FOUND`."""
        told = []
        for u, x, (low, high), bound in zip(self.fit.unknowns, self.fit.x, self.fit.intervals, self.fit.at_bound, strict=True):
            interval = "at its bound" if bound else f"{low:.5g} to {high:.5g}" if np.isfinite(high) else "not told"
            told.append((u.name, f"{u.start:.5g}", f"{x:.5g}", interval, u.unit))
        return told

    def series_rows(self) -> list[tuple[str, str, str, str, str, str, str]]:
        """Return how each series was met as texts, by `MATCHED`."""
        return [
            (m.name, f"{m.rows}", f"{m.sigma:.3g}", "stated" if m.stated else "found", f"{m.before:.3g}", f"{m.after:.3g}", m.unit)
            for m in self.matched
        ]

    def __repr__(self) -> str:
        found = ", ".join(f"{name} = {x:.5g}" for name, x in self.values.items())
        return f"<Calibration {self.base.name}: {found}>"

    def _repr_html_(self) -> str:
        names = [u.name for u in self.fit.unknowns]
        grids = [Grid(FOUND, self.rows()), Grid(MATCHED, self.series_rows())]
        if len(names) > 1:
            grid = [(name, *(f"{x:.2f}" for x in row)) for name, row in zip(names, self.fit.correlation, strict=True)]
            grids.append(Grid(("correlation", *names), grid, "correlations"))
        facts = {"drives": ", ".join(record.name for record in self.records), "notes": "; ".join(self.notes)}
        return card(self.base.name, "calibrated", facts, *grids)

    def plot(self, path: str | Path | None = None) -> Picture:
        """Draw what was measured, what was predicted before and after, and residuals; `path` is a PNG, SVG or PDF file to write."""
        from halfshaft.studies.calibration.pictures import plot_calibration  # matplotlib takes a quarter of a second

        return plot_calibration(self, path=path)


def calibrate(
    vehicle: Vehicle,
    records: Record | Sequence[Record],
    unknowns: Mapping[str, Bounds] | Sequence[str],
    *,
    loss: Loss = "linear",
    starts: int = 16,
    mode: Mode = "hybrid",
    dt: float = 1.0,
) -> Calibration:
    """Fit numbers of a vehicle to what was measured on drives.

    Parameters
    ----------
    vehicle
        Its numbers are where the fit starts.
    records
        The drives, one or several.
    unknowns
        The numbers by ``role.parameter``, each with the range that it is looked for in: ``"0.2..0.5"``, ``"1000..1600 kg"``, a pair in
        SI, or None for all that is allowed.
    loss
        How residuals count: ``linear`` squares; ``soft_l1``, ``huber``, ``cauchy`` let outliers count less.
    starts
        At how many places of the ranges the vehicle is tried before the fit, which goes on from its own and the best of them: a control
        that switches can make several minima.
    mode, dt
        As for `run`.

    Raises
    ------
    InputError
        If numbers, series, units or rows do not fit; everything that is wrong is named at once.
    SolveError
        If a run on the way gives no finite number.

    """
    records = (records,) if isinstance(records, Record) else tuple(records)
    problems = not_a(Vehicle, vehicle=vehicle) + [problem for record in records for problem in not_a(Record, record=record)]
    if problems:
        raise InputError("calibrate", problems)
    if not records:
        problems.append("has no record")
    if mode not in MODES:
        problems.append(f"mode = {mode!r}, must be one of {', '.join(MODES)}{nearest(str(mode), MODES)}")
    if not (isinstance(starts, int) and 1 <= starts <= MOST_STARTS):
        problems.append(f"starts = {starts!r}, must be a whole number from 1 to {MOST_STARTS}")
    if not 0 < number(dt) < np.inf:
        problems.append(f"dt = {dt!r} s, must be a number > 0 s")
    if loss not in get_args(Loss):
        problems.append(f"loss = {loss!r}, must be one of {', '.join(get_args(Loss))}{nearest(str(loss), get_args(Loss))}")
    ranges = dict(unknowns) if isinstance(unknowns, Mapping) else dict.fromkeys(unknowns)
    wanted = _unknowns(vehicle, ranges, problems)
    outputs = {d.name: d for d in stepper_of(vehicle).step.outputs}
    of_records: list[tuple[Predicted, ...]] = []
    cars, notes = [], []
    for record in records:
        wrong = problems_of(record, vehicle, outputs)
        if not wrong:
            wrong += [f"record {record.name}: {name} is fitted, it cannot be set" for name in record.values if name in ranges]
            try:
                cars.append(vehicle.with_values(record.values) if record.values else vehicle)
            except InputError as error:
                wrong += [f"record {record.name}: {p}" for p in error.problems]
            ends = np.append(record.cycle.time[0], record.cycle.sampled(dt if 0 < number(dt) < np.inf else 1.0).t)
            here: list[str] = []
            found = [
                Predicted(s, outputs[s.output], density_of(vehicle, s.output), ends, here) for s in record.series if s.output in outputs
            ]
            wrong += [f"record {record.name}: {p}" for p in here]
            of_records.append(tuple(found))
            notes += [f"{record.name}: {note}" for note in (*record.cycle.doubts, *(note for p in found for note in p.notes))]
        problems += wrong
    if problems:
        raise InputError("calibrate", problems)
    prefix = [f"{record.name}: " if len(records) > 1 else "" for record in records]
    groups = [Measured(f"{pre}{p.output.name}", p.values, p.sigma) for pre, of in zip(prefix, of_records, strict=True) for p in of]
    names = [u.name for u in wanted]
    # The same outputs of all drives, so that one code serves them.
    kept = tuple(sorted({p.output.name for of in of_records for p in of}))
    firsts = [(name, "first") for name in kept if outputs[name].state is not None]

    def model(x: Array) -> tuple[Array, Array]:
        values, derivatives = [], []
        given = dict(zip(names, x.tolist(), strict=True))
        for car, record, of in zip(cars, records, of_records, strict=True):
            ran = slopes(car.with_values(given), record.cycle, names, firsts, history=kept, mode=mode, dt=dt)
            for p in of:
                name = p.output.name
                first = np.array(ran.values.get((name, "first"), 0.0))
                values.append(p.of(ran.history[name], first))
                derivatives.append(p.of(ran.history_gradient[name], np.asarray(ran.gradient.get((name, "first"), np.zeros(len(names))))))
        return np.concatenate(values), np.concatenate(derivatives)

    try:
        done = fit(wanted, model, groups, loss, starts)
    except InputError as error:
        raise InputError("calibrate", error.problems) from None
    source = vehicle.source if vehicle.source.startswith(OWN) else f"{OWN} {vehicle.name} ({vehicle.source})"
    source += f"; {', '.join(names)} fitted to {', '.join(record.name for record in records)}"
    changed = replace(vehicle.with_values(dict(zip(names, done.x.tolist(), strict=True))), source=source)
    return Calibration(vehicle, changed, records, tuple(of_records), done, mode, float(dt), (*done.blind, *done.doubts, *notes))


def _unknowns(vehicle: Vehicle, ranges: Mapping[str, Bounds], problems: list[str]) -> list[Unknown]:
    """Return what is fitted, and add to `problems` all that is wrong with it."""
    if not ranges:
        problems.append("nothing is to be fitted: name a number, such as body.c_d with 0.2..0.5")
    found = []
    for name, given in ranges.items():
        if name in vehicle.rated:
            problems.append(f"{name} stands for {name.partition('.')[0]}.{vehicle.rated[name].scale}: fit that")
        elif name not in vehicle.specs:
            problems.append(f"{name} is not known{nearest(name, vehicle.specs)}")
        else:
            spec, start = vehicle.specs[name], float(vehicle.values[name])
            before = len(problems)
            low, high = _bounds(name, given, spec, problems)
            if len(problems) == before and not low <= start <= high:
                problems.append(f"{name} = {spec.shown(start)}, where the fit starts, must lie within {low:g} and {high:g}")
            scale = high - low if given is not None else abs(start) or 1.0
            found.append(Unknown(name, spec.unit, start, low, high, scale))
    return found


def _bounds(name: str, given: Any, spec: Spec, problems: list[str]) -> tuple[float, float]:
    """Return between what a number may lie [SI]."""
    own = (-np.inf if spec.lowest is None else spec.lowest, np.inf if spec.highest is None else spec.highest)
    if given is None:
        return own
    if isinstance(given, str):
        ends: Any = [end.strip() for end in given.split("..", 1)]
        if len(ends) == 2 and _NUMBER.fullmatch(ends[0]) and (unit := _NUMBER.sub("", ends[1], count=1).strip()):
            # A unit at the end counts for both.
            ends = (f"{ends[0]} {unit}", ends[1])
    else:
        ends = tuple(given) if isinstance(given, list | tuple) else ()
    if len(ends) != 2:
        problems.append(f"{name} = {shown(given)}, must be a range such as 0.2..0.5")
        return own
    reader = Reader()
    plain = [float(x) if isinstance(x, str) and _NUMBER.fullmatch(x) else x for x in ends]
    low, high = (reader.number(x.item() if isinstance(x, np.generic) else x, spec, name, plain=True) for x in plain)
    if not reader.problems and not low < high:
        reader.problems.append(f"{name} = {shown(given)}, the first end must be below the second")
    problems.extend(reader.problems)
    return (low, high) if not reader.problems else own
