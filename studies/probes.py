"""How figures of tasks are found: at one vehicle, at many, and their gradients.

Any task can be asked.  Those that have a short cut are a cycle, with or without the linear correction of the charge, and full
acceleration: many at once by the batch engine, and gradients from the tangents of a run.  All others are asked vehicle by vehicle,
and their gradients are central differences.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from halfshaft.cosim.compiled import Array
from halfshaft.cosim.cycle import acceleration_cycle
from halfshaft.cosim.figures import needs
from halfshaft.cosim.gradient import figure_slopes, slopes, unknown_numbers
from halfshaft.cosim.simulate import stepper_of
from halfshaft.cosim.smooth import Smooth, smoothed
from halfshaft.library.base.errors import HalfshaftError, InputError, nearest
from halfshaft.library.base.tags import part_of
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.acceleration import (
    DT,
    DURATIONS,
    IN_MPS,
    NAMES,
    REQUEST,
    STEADIEST,
    STEADY,
    T_START,
    AccelerationTest,
    TopSpeedTest,
    crossing,
    shifting,
)
from halfshaft.studies.batch import run_batch
from halfshaft.studies.conditions import charge_at, window
from halfshaft.studies.gradeability import GradeabilityTest
from halfshaft.studies.sizes import KINDS, TAGS, amount
from halfshaft.studies.soc_correction import AROUND, OUTSIDE, Linear, first_charge
from halfshaft.studies.task import Drive, Task

#: Figures by name, NaN where there is none.
Figures: TypeAlias = dict[str, float]
FUEL = "fuel_economy_L_per_100km"
#: Step of a central difference, over the number or 1; and how finely a grade is found for one [1].
STEP, FINE = 2e-3, 1e-8


def task_gradient(task: Task, vehicle: Vehicle, names: Sequence[str], figures: Sequence[str] = ()) -> dict[str, dict[str, float]]:
    """Return the derivatives of what a task finds, by figure and number.

    Those of a plain run, of a run with linear correction, of times between speeds and of the top speed are exact, by tangents.  All others
    are central differences, which jump where the vehicle does.

    Parameters
    ----------
    task, vehicle
        What is done with what.
    names
        Numbers by ``role.parameter`` by which is derived.
    figures
        Figures of the task; all that it finds, unless given.

    Raises
    ------
    InputError
        If a name is of no number, or the task does not find a figure; all of them are named at once.

    """
    problems = list(unknown_numbers(vehicle, names))
    found = dict(task(vehicle).figures) if not problems else {}
    problems += [f"{task.name} finds no {figure}{nearest(figure, found)}" for figure in figures if found and figure not in found]
    if problems:
        raise InputError("gradient", problems)
    wanted = [figure for figure, x in found.items() if isinstance(x, int | float) and figure in (figures or found)]
    probe, gradients = probe_of(task), dict[str, Array]()
    for figure in wanted:
        if sloped := probe.tangents(vehicle, names, [figure]):
            gradients |= sloped.gradients
    if rest := [figure for figure in wanted if figure not in gradients]:
        gradients |= probe.differences(vehicle, names, rest).gradients
    return {figure: dict(zip(names, gradients[figure].tolist(), strict=True)) for figure in wanted}


class Sloped(NamedTuple):
    """Figures, their gradients over numbers of the vehicle, and how many vehicles were tried for these."""

    values: Figures
    gradients: dict[str, Array]
    cost: int


def numbers(vehicle: Vehicle) -> dict[str, Any]:
    """Return the vehicle's own numbers: parameters, ratings, sizes and mass."""
    rated = {name: r.of(vehicle.parameters[part_of(name)]) for name, r in vehicle.rated.items()}
    sizes: dict[str, Any] = {str(kind): amount(vehicle, kind) for kind in KINDS if vehicle.tags.all_of(TAGS[kind])}
    return {**vehicle.values, **rated, **sizes, "mass": vehicle.values[vehicle.tags.the("vehicle mass")]}


@dataclass(frozen=True)
class Probe:
    """Any task."""

    task: Task

    @property
    def drives(self) -> bool:
        """Whether it drives a cycle, so that it counts as an evaluation of one."""
        return not isinstance(self.task, AccelerationTest | TopSpeedTest | GradeabilityTest)

    def at(self, vehicle: Vehicle) -> Figures:
        """Return the figures of a vehicle."""
        return {name: np.nan if x is None else float(x) for name, x in self.task(vehicle).figures.items()}

    def many(self, vehicle: Vehicle, columns: Mapping[str, Array], wanted: Sequence[str]) -> dict[str, Array]:
        """Return figures of many vehicles, whose numbers are the columns'; NaN where one cannot be built."""
        with suppress(InputError):
            # A batch stands or falls as a whole: where a vehicle cannot be built, each is asked by itself.
            if not touched(vehicle, columns) and (found := self.batch(vehicle, columns, wanted)):
                return found
        found = {figure: np.full(_runs(columns), np.nan) for figure in wanted}
        for i in range(_runs(columns)):
            with suppress(HalfshaftError):
                figures = self.at(vehicle.with_values({name: float(x[i]) for name, x in columns.items()}))
                for figure in wanted:
                    found[figure][i] = figures.get(figure, np.nan)
        return found

    def batch(self, vehicle: Vehicle, columns: Mapping[str, Array], wanted: Sequence[str]) -> dict[str, Array] | None:
        """Return figures of many vehicles at once; None if there is no way."""
        return None

    def rounded(self, vehicle: Vehicle, width: float) -> Probe:
        """Return the same with tangents of the smooth form of the step, its decisions those of a vehicle, where there is one."""
        return self

    def slopes(self, vehicle: Vehicle, names: Sequence[str], wanted: Sequence[str]) -> Sloped:
        """Return figures with their gradients over numbers of the vehicle."""
        return self.tangents(vehicle, names, wanted) or self.differences(vehicle, names, wanted)

    def differences(self, vehicle: Vehicle, names: Sequence[str], wanted: Sequence[str]) -> Sloped:
        """Return the same by central differences.  A number that a rule gives is displaced alone, so that it follows the others."""
        alone = [[name] for name in names if name in vehicle.derived]
        groups = [*([together] if (together := [name for name in names if name not in vehicle.derived]) else []), *alone]
        values, gradients = Figures(), {figure: np.empty(len(names)) for figure in wanted}
        for group in groups:
            steps = np.array([STEP * (abs(vehicle.values[name]) or 1.0) for name in group])
            columns = {name: np.full(2 * len(group) + 1, vehicle.values[name]) for name in group}
            for i, (name, h) in enumerate(zip(group, steps, strict=True)):
                columns[name][2 * i + 1 : 2 * i + 3] += h, -h
            for figure, x in self.many(vehicle, columns, wanted).items():
                up, down = x[1::2], x[2::2]
                # At a bound there is one side only.
                both, one = (up - down) / (2 * steps), np.where(np.isnan(up), x[0] - down, up - x[0]) / steps
                gradients[figure][[names.index(name) for name in group]] = np.where(np.isnan(both), one, both)
                values[figure] = float(x[0])
        return Sloped(values, gradients, 2 * len(names) + len(groups))

    def tangents(self, vehicle: Vehicle, names: Sequence[str], wanted: Sequence[str]) -> Sloped | None:
        """Return the same by the tangents of runs; None if there is no way."""
        return None


@dataclass(frozen=True)
class Numbers(Probe):
    """The vehicle's own numbers; it has no task."""

    task: Task = None  # type: ignore[assignment]

    @property
    def drives(self) -> bool:
        """No cycle is driven."""
        return False

    def at(self, vehicle: Vehicle) -> Figures:
        """Return the numbers."""
        return {name: float(x) for name, x in numbers(vehicle).items()}


@dataclass(frozen=True)
class DriveProbe(Probe):
    """A cycle that is driven once; with forms, tangents are those of the smooth step."""

    task: Drive
    forms: tuple[Smooth, ...] = ()
    width: float = 0.0

    def rounded(self, vehicle: Vehicle, width: float) -> Probe:
        """Return the same with tangents of the smooth form of the step."""
        if self.task.mode != "hybrid":
            return self
        return replace(self, forms=(smoothed(vehicle, self.task.cycle, dt=self.task.dt),), width=width)

    def batch(self, vehicle: Vehicle, columns: Mapping[str, Array], wanted: Sequence[str]) -> dict[str, Array] | None:
        """Return figures of many vehicles at once; None if there is no way."""
        found = run_batch(vehicle, columns, self.task.cycle, mode=self.task.mode, dt=self.task.dt)
        if not all(figure in found for figure in wanted):
            return None
        return {figure: found[figure].values for figure in wanted}

    def tangents(self, vehicle: Vehicle, names: Sequence[str], wanted: Sequence[str]) -> Sloped | None:
        """Return figures with their gradients by the tangents of a run."""
        form = self.forms[0] if self.forms else None
        values, gradients = _run(vehicle, names, np.eye(len(names)), self.task, form, self.width)
        if not all(figure in values and figure in gradients for figure in wanted):
            return None
        return Sloped({figure: values[figure] for figure in wanted}, {figure: gradients[figure] for figure in wanted}, 1)


def _run(
    vehicle: Vehicle, names: Sequence[str], chain: Array, task: Drive | Linear, form: Smooth | None, width: float
) -> tuple[Figures, dict[str, Array]]:
    """Return the figures of a run and their gradients, of the step or its smooth form; the chain leads from the names to what varies."""
    wanted = list(needs(stepper_of(vehicle).step))
    if form is None:
        found = slopes(vehicle, task.cycle, names, wanted, mode=task.mode, dt=task.dt)
    else:
        found = form.slopes(names, wanted, width, vehicle)
    values, gradients = figure_slopes(vehicle, task.cycle, found)
    return values, {figure: np.array([of[name] for name in names]) @ chain for figure, of in gradients.items()}


def _started(
    vehicle: Vehicle, names: Sequence[str], place: Callable[[Vehicle], float | None], soc: float | None
) -> tuple[Vehicle, Sequence[str], Array]:
    """Return the vehicle at a charge to start from, the numbers by which it is derived, and what these are of the names that vary.

    Where the window of the charge is among these, the start moves with it; its place in the window goes in proportion.
    """
    starts, eye = vehicle.tags.all_of("start charge"), np.eye(len(names))
    if soc is None or not starts:
        return vehicle, names, eye
    car = vehicle.with_values(dict.fromkeys(starts, soc))
    ends = [name for name in _window(vehicle) if name in names]
    if not ends:
        return car, names, eye
    moved = np.zeros(len(names))
    for name in ends:
        h = STEP * (abs(vehicle.values[name]) or 1.0)
        near = [place(vehicle.displaced({name: vehicle.values[name] + x})) or 0.0 for x in (-h, h)]
        moved[names.index(name)] = (near[1] - near[0]) / (2 * h)
    return car, [*names, *starts], np.vstack([eye, *[moved] * len(starts)])


@dataclass(frozen=True)
class LinearProbe(Probe):
    """A cycle that is driven twice, from either end of the window, for a charge that is kept."""

    task: Linear
    forms: tuple[Smooth, ...] = ()
    width: float = 0.0

    def rounded(self, vehicle: Vehicle, width: float) -> Probe:
        """Return the same with tangents of the smooth form of the step."""
        if self.task.mode != "hybrid":
            return self
        starts = vehicle.tags.all_of("start charge")
        cars = [vehicle.with_values(dict.fromkeys(starts, soc)) for soc in self.ends(vehicle)]
        return replace(self, forms=tuple(smoothed(car, self.task.cycle, dt=self.task.dt) for car in cars), width=width)

    def _end(self, i: int, vehicle: Vehicle) -> float:
        return self.ends(vehicle)[i]

    def ends(self, vehicle: Vehicle) -> tuple[float, float]:
        """Return the charges at the start."""
        ends = window(vehicle)
        low, high = (ends[0] - OUTSIDE, ends[1] + OUTSIDE) if ends else (first_charge(vehicle) + x for x in (-AROUND, AROUND))
        return max(low, 0.0), min(high, 1.0)

    def batch(self, vehicle: Vehicle, columns: Mapping[str, Array], wanted: Sequence[str]) -> dict[str, Array] | None:
        """Return figures of many vehicles at once; None if there is no way."""
        starts = vehicle.tags.all_of("start charge")
        if set(wanted) != {FUEL} or set(starts) & columns.keys():
            return None
        fuel, change = [], []
        for soc in self.ends(vehicle):
            d = run_batch(vehicle, {**columns, **dict.fromkeys(starts, soc)}, self.task.cycle, mode=self.task.mode, dt=self.task.dt)
            fuel.append(d[FUEL].values)
            change.append((d["soc_end"] - d["soc_start"]).values)
        with np.errstate(all="ignore"):
            kept = fuel[0] - change[0] * (fuel[1] - fuel[0]) / (change[1] - change[0])
        # As the task has it: one run will do where the charge is kept in it, and of one side only nothing can be told.
        kept = np.where(change[0] * change[1] > 0, np.nan, kept)
        return {wanted[0]: np.where(np.abs(change[0]) <= self.task.tolerance, fuel[0], kept)}

    def tangents(self, vehicle: Vehicle, names: Sequence[str], wanted: Sequence[str]) -> Sloped | None:
        """Return the fuel with its gradient by the tangents of both runs."""
        if set(wanted) != {FUEL} or set(vehicle.tags.all_of("start charge")) & set(names):
            return None
        f, df, d, dd = [], [], [], []
        for i, (soc, form) in enumerate(zip(self.ends(vehicle), self.forms or (None, None), strict=True)):
            values, gradients = _run(*_started(vehicle, names, partial(self._end, i), soc), self.task, form, self.width)
            f.append(values[FUEL])
            df.append(gradients[FUEL])
            d.append(values["soc_end"] - values["soc_start"])
            dd.append(gradients["soc_end"] - gradients["soc_start"])
            if abs(d[0]) <= self.task.tolerance:
                return Sloped({FUEL: f[0]}, {FUEL: df[0]}, 1)
        if d[0] * d[1] > 0:
            return Sloped({FUEL: np.nan}, {FUEL: np.full(len(names), np.nan)}, 1)
        share = d[0] / (d[0] - d[1])
        dshare = (dd[0] * (1 - share) + dd[1] * share) / (d[0] - d[1])
        return Sloped({FUEL: f[0] + share * (f[1] - f[0])}, {FUEL: df[0] + share * (df[1] - df[0]) + dshare * (f[1] - f[0])}, 1)


@dataclass(frozen=True)
class FullEffortProbe(Probe):
    """Full acceleration, as long as it takes: times between speeds."""

    task: AccelerationTest

    def batch(self, vehicle: Vehicle, columns: Mapping[str, Array], wanted: Sequence[str]) -> dict[str, Array] | None:
        """Return figures of many vehicles at once; None if there is no way."""
        test, pairs = self.task, self.pairs(wanted)
        if pairs is None:
            return None
        highest, unit = max(high for _, high in pairs) * IN_MPS[test.unit], IN_MPS[test.unit]
        found = {figure: np.full(_runs(columns), np.nan) for figure in wanted}
        for i, time, v in _driven(test, vehicle, columns, highest, STEADY):
            for figure, (low, high) in zip(wanted, pairs, strict=True):
                start, end = (crossing(time, v, x * unit) if x else 0.0 for x in (low, high))
                found[figure][i] = np.nan if start is None or end is None else end - start
        return found

    def tangents(self, vehicle: Vehicle, names: Sequence[str], wanted: Sequence[str]) -> Sloped | None:
        """Return times with their gradients by the tangents of a run."""
        if (pairs := self.pairs(wanted)) is None:
            return None
        unit = IN_MPS[self.task.unit]
        time, v, dv = _felt(self.task, vehicle, names, max(high for _, high in pairs) * unit, STEADY)
        values, gradients = {}, {}
        for figure, ends in zip(wanted, pairs, strict=True):
            (t0, dt0), (t1, dt1) = (crossing_slope(time, v, dv, x * unit) if x else (0.0, np.zeros(len(names))) for x in ends)
            values[figure], gradients[figure] = t1 - t0, dt1 - dt0
        return Sloped(values, gradients, 1)

    def pairs(self, wanted: Sequence[str]) -> list[tuple[float, float]] | None:
        """Return the speeds of the figures; None if one is no time between speeds."""
        named = {f"time_{low:g}_to_{high:g}_{NAMES[self.task.unit]}_s": (low, high) for low, high in self.task.pairs}
        own = self.task == AccelerationTest(pairs=self.task.pairs, unit=self.task.unit, within=self.task.within, over=self.task.over)
        return [named[figure] for figure in wanted] if own and all(figure in named for figure in wanted) else None


@dataclass(frozen=True)
class TopSpeedProbe(Probe):
    """Full acceleration until nothing is gained any more."""

    task: TopSpeedTest

    def batch(self, vehicle: Vehicle, columns: Mapping[str, Array], wanted: Sequence[str]) -> dict[str, Array] | None:
        """Return figures of many vehicles at once; None if there is no way."""
        if set(wanted) != {"top_speed_mps"} or self.task != TopSpeedTest():
            return None
        found = np.full(_runs(columns), np.nan)
        for i, _, v in _driven(self.task, vehicle, columns, np.inf, STEADIEST):
            found[i] = v.max()
        return {wanted[0]: found}

    def tangents(self, vehicle: Vehicle, names: Sequence[str], wanted: Sequence[str]) -> Sloped | None:
        """Return the speed with its gradient by the tangents of a run."""
        if set(wanted) != {"top_speed_mps"} or self.task != TopSpeedTest():
            return None
        _, v, dv = _felt(self.task, vehicle, names, np.inf, STEADIEST)
        i = int(v.argmax())
        return Sloped({wanted[0]: float(v[i])}, {wanted[0]: dv[i]}, 1)


@dataclass(frozen=True)
class GradeProbe(Probe):
    """A grade, which is found more finely where differences are taken."""

    task: GradeabilityTest

    def differences(self, vehicle: Vehicle, names: Sequence[str], wanted: Sequence[str]) -> Sloped:
        """Return figures with their gradients by central differences."""
        fine = min(FINE, self.task.tolerance or FINE)
        return Probe(replace(self.task, tolerance=fine)).differences(vehicle, names, wanted)


def _felt(
    test: AccelerationTest | TopSpeedTest, vehicle: Vehicle, names: Sequence[str], highest: float, steady: float
) -> tuple[Array, Array, Array]:
    """Return time and speed of a vehicle at full effort with the speed's gradients, held until a speed is reached or nothing is gained."""
    car, own, chain = _started(test.applied(vehicle, "middle", more=shifting(vehicle)), names, _middle, _middle(vehicle))
    mode, speed = test.solved(car, test.mode), stepper_of(car).step.tags.the("speed")
    for held in DURATIONS:
        cycle = acceleration_cycle(REQUEST, t_start=T_START, duration=held)
        found = slopes(car, cycle, own, (), history=(speed,), mode=mode, dt=DT)
        v = found.history[speed]
        late = len(v) - len(v) // 10
        if v.max() >= highest or v[late:].max() - v[:late].max() < steady:
            break
    return found.time, v, found.history_gradient[speed] @ chain


def _driven(
    test: AccelerationTest | TopSpeedTest, vehicle: Vehicle, columns: Mapping[str, Array], highest: float, steady: float
) -> Iterator[tuple[int, Array, Array]]:
    """Yield number, time and speed of each vehicle at full effort, held until a speed is reached or nothing is gained."""
    car = test.applied(vehicle, "middle", more=shifting(vehicle))
    mode, speed = test.solved(car, test.mode), stepper_of(car).step.tags.the("speed")
    left = np.arange(_runs(columns))
    for held in DURATIONS:
        part = {name: x[left] for name, x in columns.items()}
        cycle = acceleration_cycle(REQUEST, t_start=T_START, duration=held)
        d = run_batch(car, part, cycle, mode=mode, dt=DT, history=[speed], summary={})
        time, v, sound = d["time"].values, d[speed].values, d["status"].values == 0
        late = v.shape[1] - v.shape[1] // 10
        done = (v.max(axis=1) >= highest) | (v[:, late:].max(axis=1) - v[:, :late].max(axis=1) < steady) | (held == DURATIONS[-1])
        yield from ((int(left[k]), time, v[k]) for k in np.flatnonzero(done & sound))
        left = left[~done & sound]
        if not len(left):
            break


def _runs(columns: Mapping[str, Array]) -> int:
    return len(next(iter(columns.values())))


def crossing_slope(time: Array, speed: Array, gradient: Array, v: float) -> tuple[float, Array]:
    """Return the time to a speed, and its gradient from those of the speeds on either side; NaN where it is not reached."""
    if (t := crossing(time, speed, v)) is None:
        return np.nan, np.full(gradient.shape[1], np.nan)
    i = int(np.argmax(speed >= v))
    a, b = (speed[i - 1], speed[i]) if i else (0.0, speed[0])
    da, db = (gradient[i - 1], gradient[i]) if i else (np.zeros(gradient.shape[1]), gradient[0])
    length = time[i] - (time[i - 1] if i else 0.0)
    return t, -length * (da * (b - v) + db * (v - a)) / (b - a) ** 2


def touched(vehicle: Vehicle, columns: Mapping[str, Any]) -> bool:
    """Return whether the window of the charge differs, from which a test takes where to start."""
    return bool(set(_window(vehicle)) & columns.keys())


def _middle(vehicle: Vehicle) -> float | None:
    return charge_at(vehicle, "middle")


def _window(vehicle: Vehicle) -> list[str]:
    return [name for tag in ("lowest charge", "highest charge") for name in vehicle.tags.all_of(tag)]


def probe_of(task: Task | None) -> Probe:
    """Return how a task is asked; None stands for the vehicle's own numbers."""
    if task is None:
        return Numbers()
    kinds: dict[type, type[Probe]] = {
        Drive: DriveProbe,
        Linear: LinearProbe,
        AccelerationTest: FullEffortProbe,
        TopSpeedTest: TopSpeedProbe,
        GradeabilityTest: GradeProbe,
    }
    return kinds.get(type(task), Probe)(task)
