"""How figures of tasks are found: at one vehicle, at many, and their gradients.

Any task can be asked.  Those that have a short cut are a cycle, with or without the linear correction of the charge, and full
acceleration: many at once by the batch engine, and gradients from the tangents of a run.  All others are asked vehicle by vehicle,
and their gradients are central differences.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from halfshaft.cosim.compiled import Array
from halfshaft.cosim.cycle import acceleration_cycle
from halfshaft.cosim.simulate import stepper_of
from halfshaft.library.base.errors import HalfshaftError, InputError
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
    shifting,
)
from halfshaft.studies.batch import run_batch
from halfshaft.studies.conditions import window
from halfshaft.studies.gradeability import GradeabilityTest
from halfshaft.studies.sizes import KINDS, TAGS, amount
from halfshaft.studies.soc_correction import AROUND, OUTSIDE, Linear, first_charge
from halfshaft.studies.task import Drive, Task

#: Figures by name, NaN where there is none; and their gradients.
Figures = dict[str, float]
Gradients = dict[str, Array]
#: Step of a central difference, over the number or 1.
STEP = 2e-3


def numbers(vehicle: Vehicle) -> dict[str, Any]:
    """Return the vehicle's own numbers: parameters, ratings, sizes and mass."""
    rated = {name: r.of(vehicle.parameters[part_of(name)]) for name, r in vehicle.rated.items()}
    sizes = {kind: amount(vehicle, kind) for kind in KINDS if vehicle.tags.all_of(TAGS[kind])}
    return {**vehicle.values, **rated, **sizes, "mass": vehicle.values[vehicle.tags.the("vehicle mass")]}


@dataclass(frozen=True)
class Probe:
    """Any task."""

    task: Task

    @property
    def drives(self) -> bool:
        """Whether it drives a cycle, so that it counts as an evaluation of one."""
        return not isinstance(self.task, AccelerationTest | TopSpeedTest | GradeabilityTest)

    def cost(self, names: Sequence[str]) -> int:
        """Return how many vehicles are tried for a gradient."""
        return 2 * len(names) + 1

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

    def slopes(self, vehicle: Vehicle, names: Sequence[str], wanted: Sequence[str]) -> tuple[Figures, Gradients]:
        """Return figures, and their gradients over numbers of the vehicle."""
        steps = [STEP * (abs(vehicle.values[name]) or 1.0) for name in names]
        columns = {name: np.full(2 * len(names) + 1, vehicle.values[name]) for name in names}
        for i, (name, h) in enumerate(zip(names, steps, strict=True)):
            columns[name][2 * i + 1] += h
            columns[name][2 * i + 2] -= h
        found = self.many(vehicle, columns, wanted)
        gradients = {}
        for figure, x in found.items():
            up, down = x[1::2], x[2::2]
            # At a bound there is one side only.
            both = (up - down) / (2 * np.array(steps))
            one = np.where(np.isnan(up), x[0] - down, up - x[0]) / np.array(steps)
            gradients[figure] = np.where(np.isnan(both), one, both)
        return {figure: float(x[0]) for figure, x in found.items()}, gradients


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
    """A cycle that is driven once."""

    task: Drive

    def batch(self, vehicle: Vehicle, columns: Mapping[str, Array], wanted: Sequence[str]) -> dict[str, Array] | None:
        """Return figures of many vehicles at once; None if there is no way."""
        found = run_batch(vehicle, columns, self.task.cycle, mode=self.task.mode, dt=self.task.dt)
        if not all(figure in found for figure in wanted):
            return None
        return {figure: found[figure].values for figure in wanted}


@dataclass(frozen=True)
class LinearProbe(Probe):
    """A cycle that is driven twice, from either end of the window, for a charge that is kept."""

    task: Linear

    def ends(self, vehicle: Vehicle) -> tuple[float, float]:
        """Return the charges at the start."""
        ends = window(vehicle)
        low, high = (ends[0] - OUTSIDE, ends[1] + OUTSIDE) if ends else (first_charge(vehicle) + x for x in (-AROUND, AROUND))
        return max(low, 0.0), min(high, 1.0)

    def batch(self, vehicle: Vehicle, columns: Mapping[str, Array], wanted: Sequence[str]) -> dict[str, Array] | None:
        """Return figures of many vehicles at once; None if there is no way."""
        starts = vehicle.tags.all_of("start charge")
        if set(wanted) != {"fuel_economy_L_per_100km"} or set(starts) & columns.keys():
            return None
        fuel, change = [], []
        for soc in self.ends(vehicle):
            d = run_batch(vehicle, {**columns, **dict.fromkeys(starts, soc)}, self.task.cycle, mode=self.task.mode, dt=self.task.dt)
            fuel.append(d["fuel_economy_L_per_100km"].values)
            change.append((d["soc_end"] - d["soc_start"]).values)
        with np.errstate(all="ignore"):
            kept = fuel[0] - change[0] * (fuel[1] - fuel[0]) / (change[1] - change[0])
        # As the task has it: one run will do where the charge is kept in it, and of one side only nothing can be told.
        kept = np.where(change[0] * change[1] > 0, np.nan, kept)
        return {wanted[0]: np.where(np.abs(change[0]) <= self.task.tolerance, fuel[0], kept)}


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
                found[figure][i] = end - start
        return found

    def pairs(self, wanted: Sequence[str]) -> list[tuple[float, float]] | None:
        """Return the speeds of the figures; None if one is no time between speeds."""
        named = {f"time_{low:g}_to_{high:g}_{NAMES[self.task.unit]}_s": (low, high) for low, high in self.task.pairs}
        own = self.task.routine == "2000" and self.task.duration is None and self.task.resting is None
        return [named[figure] for figure in wanted] if own and all(figure in named for figure in wanted) else None


@dataclass(frozen=True)
class TopSpeedProbe(Probe):
    """Full acceleration until nothing is gained any more."""

    task: TopSpeedTest

    def batch(self, vehicle: Vehicle, columns: Mapping[str, Array], wanted: Sequence[str]) -> dict[str, Array] | None:
        """Return figures of many vehicles at once; None if there is no way."""
        if set(wanted) != {"top_speed_mps"} or self.task.resting:
            return None
        found = np.full(_runs(columns), np.nan)
        for i, _, v in _driven(self.task, vehicle, columns, np.inf, STEADIEST):
            found[i] = v.max()
        return {wanted[0]: found}


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


def crossing(time: Array, speed: Array, v: float) -> float:
    """Return the time from the start of the first accelerating step to a speed [s]; NaN where it is not reached."""
    above = np.flatnonzero(speed >= v)
    if not len(above):
        return np.nan
    i = int(above[0])
    if i == 0:
        return float(time[0] * v / speed[0]) - T_START
    share = (v - speed[i - 1]) / (speed[i] - speed[i - 1])
    return float(time[i - 1] + share * (time[i] - time[i - 1])) - T_START


def touched(vehicle: Vehicle, columns: Mapping[str, Any]) -> bool:
    """Return whether the window of the charge differs, from which a test takes where to start."""
    ends = [name for tag in ("lowest charge", "highest charge") for name in vehicle.tags.all_of(tag)]
    return bool(set(ends) & columns.keys())


def probe_of(task: Task | None) -> Probe:
    """Return how a task is asked; None stands for the vehicle's own numbers."""
    if task is None:
        return Numbers()
    kinds: dict[type, type[Probe]] = {
        Drive: DriveProbe,
        Linear: LinearProbe,
        AccelerationTest: FullEffortProbe,
        TopSpeedTest: TopSpeedProbe,
    }
    return kinds.get(type(task), Probe)(task)
