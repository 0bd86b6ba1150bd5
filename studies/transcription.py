"""Direct transcription: the split of power over a whole cycle, and sizes with it, in one sparse nonlinear program.

Dynamic programming (`halfshaft.studies.optimal`) chooses among a grid of commands, for one vehicle.  Here all steps of the cycle
are written down at once, with the states between them, the commands of each, and the sizes of the vehicle as unknowns (multiple shooting
with an interval a step), and IPOPT solves for all of them through CasADi, with the sparse derivatives of the smooth form of the
vehicle's own step (`halfshaft.fmu_build.smooth`).  So sizes are not tied to a control's strategy::

    minimise    fuel burnt, or energy drawn from the store where nothing is burnt
    subject to  x[k + 1] = step(x[k], command[k], sizes),  charge at the end >= that of the best known way
                trace missed[k] <= a little,  charge within its window,  time to a speed from rest <= a limit

Three things are settled outside of the program.  *Decisions*, such as when the source runs, are those of dynamic programming at the
sizes to begin with.  *What matters*: of all states only those are unknowns that a command or a size moves, and that in turn move
fuel, charge or what is missed; the derivatives of the first run tell which, and of a series hybrid's thirty six remain.  All other
values are numbers, put in before anything is written down.  *Times to a speed* are followed by their tangents
(`halfshaft.cosim.gradient`), from stage to stage anew, as is the mass, which follows sizes.

Stages make the width smaller.  Behind each one the commands drive the exact step; they are scaled until its charge ends where it shall.
What is returned is the best way that was driven so, never what the program alone says.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import casadi as ca
import numpy as np

from halfshaft.cosim.compiled import Array, CompiledStep
from halfshaft.cosim.cycle import Cycle, Samples
from halfshaft.cosim.forward import Interrupts
from halfshaft.cosim.gradient import rates, unknown_numbers, value_of
from halfshaft.cosim.result import Result
from halfshaft.cosim.simulate import Build, parameters_of, recorded
from halfshaft.cosim.smooth import Smooth, record_of
from halfshaft.fmu_build.smooth import Rounding, SmoothStep, smooth_step, smooth_values
from halfshaft.library.base.errors import InputError, not_a, number
from halfshaft.library.base.rounded import rounded
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.acceleration import AccelerationTest
from halfshaft.studies.optimal.optimum import Optimum, optimal
from halfshaft.studies.optimal.search import obedient
from halfshaft.studies.probes import probe_of
from halfshaft.studies.sizing.ipopt import INTERRUPTED, Watch

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Widths of the stages; a table is rounded over so many times more of its intervals, up to all of them.
WIDTHS, WIDER = (0.03, 0.01), 10.0
#: Most iterations of a stage.
ITERATIONS = 150
#: So many iterations whose goals differ by less than this part, and that miss no equation by more, end a stage.
PATIENCE, GAIN, NEARLY = 10, 1e-4, 1e-3
#: A derivative counts if what it moves is more than this part of its size.
COUNTS = 1e-7
#: What may be missed of the trace beyond the best known way [m/s], and the charge at the end.
MISSED, CHARGED = 0.05, 1e-6
#: With sizes, the last width is repeated at most so often, until none moves by more than this part of it.
AGAIN, SETTLED = 6, 5e-3
#: Part by which a program stays below a time: as far as a tangent may be wrong.
SURE = 1e-3
#: Part of a size by which a stage may move it: as far as tangents hold.
MOVED = 0.3
#: Least curvature of a step, over the inverse of the number of steps and the width, and that of sizes.
STIFF, CURVED = 1.0, 1.0


class Reach(NamedTuple):
    """A speed that is to be reached from rest within a time, by the refined step."""

    speed: float
    time: float


class Stage(NamedTuple):
    """A stage: its width, what IPOPT said and how long it took [s], the goal in its program and on the exact step, and the sizes."""

    width: float
    iterations: int
    status: str
    seconds: float
    smooth: float
    exact: float
    sizes: Mapping[str, float]
    holds: bool


@dataclass(frozen=True)
class Transcribed:
    """The best way to drive a cycle that direct transcription found.

    Parameters
    ----------
    vehicle, cycle
        What is driven, with the sizes that were found.
    commands
        What is commanded at each step, by name.
    result
        The run of the exact step under them.
    goal, before
        Fuel burnt [kg], or energy drawn from the store [J] where nothing is burnt; and that of the best known way, at the sizes to
        begin with.
    stages
        What was done.
    reached
        Time that each speed takes from rest [s].
    holds
        Whether charge, trace and times are kept on the exact step.
    optimum
        Dynamic programming at the sizes to begin with; None without commands.
    n_states, n_unknowns
        States that count, and all unknowns of the program.

    """

    vehicle: Vehicle
    cycle: Cycle
    commands: Mapping[str, Array]
    result: Result
    goal: float
    before: float
    stages: tuple[Stage, ...]
    reached: tuple[float, ...]
    holds: bool
    optimum: Optimum | None
    n_states: int
    n_unknowns: int

    def __repr__(self) -> str:
        kept = "" if self.holds else ", which does not hold"
        return f"<Transcribed {self.vehicle.name} over {self.cycle.name}: {100 * (self.goal / self.before - 1):+.2f} %{kept}>"

    def plot(self) -> Figure:
        """Return speed, powers and charge over time; with commands, what the source gives, over dynamic programming's."""
        from halfshaft.cosim.plot import plot_run

        if self.optimum is None:
            return plot_run(self.result, panels=("speed", "power", "charge"))
        tags = self.result.tags
        return plot_run(self.optimum.best.result, self.result, panels=("speed", *tags.all_of("generated"), tags.the("charge")))


def transcribe(
    vehicle: Vehicle,
    cycle: Cycle,
    sizes: Mapping[str, tuple[float, float]] | None = None,
    *,
    reach: Sequence[tuple[float, float]] = (),
    dt: float = 1.0,
    widths: Sequence[float] = WIDTHS,
    iterations: int = ITERATIONS,
) -> Transcribed:
    """Find the commands of a series or fuel cell hybrid, and sizes of it or of an electric car, that take the least fuel over a cycle.

    Parameters
    ----------
    vehicle, cycle
        What drives where.
    sizes
        Numbers of the vehicle that are free, by ``role.parameter``, each from a lowest to a highest value; what follows from them follows.
    reach
        Speeds [m/s] that must be reached from rest, each within a time [s].
    dt
        Length of the step [s].
    widths
        Widths of the smooth form, a stage each.
    iterations
        Most iterations of a stage.

    Raises
    ------
    InputError
        If the vehicle chooses gears, nothing is free, or an argument is not what it must be; everything that is wrong is named at once.

    """
    sizes, limits = dict(sizes or {}), tuple(Reach(*r) for r in reach)
    _check(vehicle, cycle, sizes, widths, iterations)
    free = vehicle.model().commandable
    optimum = optimal(vehicle, cycle, dt=dt) if free else None
    car = optimum.vehicle if optimum else vehicle
    compiled = obedient(Build(vehicle), free)
    samples = cycle.sampled(dt)
    commands = np.column_stack([*optimum.best.commands.values()]) if optimum else np.zeros((len(samples.t), 0))
    task = _Task(car, commands, cycle, samples, dt, compiled, smooth_step(compiled.step), sizes, limits, optimum, iterations)
    before = task.driven(car, commands)
    # At the sizes to begin with a speed may take too long: then that way is no answer.
    best, stages, counted, now = before, list[Stage](), (0, 0), before
    settled = False
    # An interrupt ends the search with the best way so far.
    with suppress(KeyboardInterrupt):
        for k in range(len(widths) + (AGAIN if sizes else 0)):
            if k >= len(widths) and settled:
                break
            width = widths[min(k, len(widths) - 1)]
            program = _Program(task, now)
            counted = len(program.kept), program.n_unknowns
            began = time.perf_counter()
            point = program.solve(width)
            tried = task.driven(now.car.with_values(point.sizes) if sizes else now.car, point.commands)
            taken = time.perf_counter() - began
            stages.append(Stage(width, point.iterations, point.status, taken, point.goal, tried.goal, point.sizes, tried.holds))
            settled = tried.holds and all(abs(x / value_of(now.car, name) - 1) < SETTLED for name, x in point.sizes.items())
            # Sizes go on from where they are; commands alone, from the best ones.
            now = tried if sizes else max(tried, best, key=lambda way: (way.holds, -way.goal))
            if (tried.holds, -tried.goal) > (best.holds, -best.goal):
                best = tried
            if point.status == INTERRUPTED:
                break
    return Transcribed(
        best.car, cycle, dict(zip(compiled.step.commands, best.commands.T, strict=True)), task.result(best), best.goal, before.goal,
        tuple(stages), best.reached, best.holds, optimum, *counted,
    )  # fmt: skip


class _Way(NamedTuple):
    """A vehicle under commands on the exact step."""

    car: Vehicle
    commands: Array
    rows: Array
    goal: float
    charge: float
    missed: float
    reached: tuple[float, ...]
    holds: bool


class _Point(NamedTuple):
    """What a program found."""

    commands: Array
    sizes: dict[str, float]
    goal: float
    iterations: int
    status: str


@dataclass(frozen=True)
class _Task:
    """What is asked for, the way to set out from, and the steps that it is asked of."""

    car: Vehicle
    commands: Array
    cycle: Cycle
    samples: Samples
    dt: float
    compiled: CompiledStep
    form: SmoothStep
    sizes: Mapping[str, tuple[float, float]]
    reach: tuple[Reach, ...]
    optimum: Optimum | None
    iterations: int

    @cached_property
    def charge(self) -> int:
        """Position of the charge among the states."""
        return self.compiled.step.state_index[self.compiled.step.tags.the("charge")]

    @cached_property
    def fuel(self) -> int | None:
        """Position of the fuel burnt among the states."""
        fuels = self.compiled.step.tags.all_of("fuel mass")
        return self.compiled.step.state_index[fuels[0]] if fuels else None

    @cached_property
    def stored(self) -> list[int]:
        """Positions of the powers that are drawn from stores among the outputs."""
        return [i for i, d in enumerate(self.compiled.step.outputs) if d.booking == "stored"]

    @cached_property
    def shares(self) -> list[int]:
        """Positions of the commands that are solved for."""
        return [i for i, c in enumerate(self.compiled.step.commands.values()) if c.kind == "share"]

    @cached_property
    def most_missed(self) -> float:
        """What may be missed of the trace [m/s]."""
        return self.missed(self.march(self.car, self.commands)[0]) + MISSED

    def missed(self, rows: Array) -> float:
        """Return what is missed of the trace at most [m/s]."""
        return float(rows[:, self.compiled.step.output_index[self.compiled.step.tags.the("miss")]].max())

    def march(self, car: Vehicle, commands: Array) -> tuple[Array, Array]:
        """Return outputs and last state of the exact step."""
        p = parameters_of(car, self.compiled.step, self.samples.v_start)
        march = self.compiled.march(self.samples, p, more=commands)
        assert march.history is not None
        return march.history, march.state

    def driven(self, car: Vehicle, commands: Array) -> _Way:
        """Return how the exact step drives, with the shares scaled until the charge ends where it shall."""
        rows, state = self.march(car, commands)
        if self.optimum:
            target = float(self.optimum.charge(self.optimum.best)[-1])
            low, high = 0.8, 1.25
            for _ in range(60 if self.shares and abs(state[self.charge] - target) > CHARGED / 100 else 0):
                scaled, middle = commands.copy(), (low + high) / 2
                scaled[:, self.shares] = np.minimum(middle * commands[:, self.shares], 1)
                rows, state = self.march(car, scaled)
                low, high = (low, middle) if state[self.charge] >= target else (middle, high)
            if low > 0.8 or high < 1.25:
                commands = commands.copy()
                commands[:, self.shares] = np.minimum(high * commands[:, self.shares], 1)
                rows, state = self.march(car, commands)
            kept = bool(state[self.charge] >= target - CHARGED)
        else:
            kept = bool(state[self.charge] > 0)
        missed = self.missed(rows)
        reached = tuple(self.times(car, ())[0])
        holds = kept and missed <= self.most_missed and all(t <= r.time for t, r in zip(reached, self.reach, strict=True))
        goal = state[self.fuel] if self.fuel is not None else self.samples.dt @ rows[:, self.stored].sum(axis=1)
        return _Way(car, commands, rows, float(goal), float(state[self.charge]), missed, reached, holds)

    def times(self, car: Vehicle, names: Sequence[str]) -> tuple[list[float], Array]:
        """Return the time that each speed takes from rest, and its derivatives."""
        if not self.reach:
            return [], np.zeros((0, len(names)))
        pairs = tuple((0.0, 3.6 * r.speed) for r in self.reach)
        figures = [f"time_0_to_{high:g}_kmh_s" for _, high in pairs]
        found = probe_of(AccelerationTest(pairs=pairs, unit="km/h")).slopes(car, names, figures)
        times = [found.values[figure] for figure in figures]
        return [np.inf if np.isnan(t) else t for t in times], np.nan_to_num([found.gradients[figure] for figure in figures])

    def result(self, way: _Way) -> Result:
        """Return a way as a run."""
        told = ("the commands are those of a direct transcription",) if way.commands.size else ()
        return recorded(way.car, self.cycle, self.compiled, self.samples, way.rows, self.dt, told)


class _Program:
    """The nonlinear program around a way that was driven."""

    def __init__(self, task: _Task, way: _Way) -> None:
        self.task, self.way, self.step = task, way, task.compiled.step
        p = parameters_of(way.car, self.step, task.samples.v_start)
        self.record = record_of(task.compiled, task.form.exact, task.samples, p, way.commands)
        self.smooth = Smooth(way.car, task.samples, "fixed", task.compiled, task.form, self.record)
        self.n, self.names = len(task.samples.t), list(task.sizes)
        self.size = np.array([value_of(way.car, name) for name in self.names])
        self.rates = rates(way.car, self.step, self.names)
        self.last = task.march(way.car, way.commands)[1]
        whole = np.column_stack([self.record.x, self.last])
        largest, span = np.abs(whole).max(axis=1), np.ptp(whole, axis=1)
        #: A state is its first value and a number times how far it moves in the run.
        self.base, self.scale = whole[:, 0], np.where(span > 0, span, np.where(largest > 0, largest, 1.0))
        self.width = ca.SX.sym("width")
        outputs = task.form.exact.outputs
        #: What a stage gives beside the states: what is missed, and the power drawn where that is the goal.
        self.asked = [outputs[self.step.output_index[self.step.tags.the("miss")]]]
        self.asked += [outputs[i] for i in task.stored] if task.fuel is None else []
        n_requests = len(self.step.requests) - len(self.step.commands)
        self.commanded = [f"u[{n_requests + i}]" for i in task.shares]
        self.kept = self._kept()
        self.n_unknowns = len(self.kept) * (self.n + 1) + len(self.commanded) * self.n + len(self.names)

    def _stage(self, kept: Sequence[int], steps: Any, wanted: Sequence[str]) -> tuple[ca.Function, Array]:
        """Return what follows from some steps as a function of unknown states, commands and sizes, and the numbers of each step."""
        x, u, z = ca.SX.sym("x", len(kept)), ca.SX.sym("u", len(self.commanded)), ca.SX.sym("z", len(self.names))
        moved = {f"x[{i}]": float(self.base[i]) + x[k] * float(self.scale[i]) for k, i in enumerate(kept)}
        moved |= {name: u[k] for k, name in enumerate(self.commanded)}
        for i in np.flatnonzero(np.any(self.rates != 0, axis=1)) if self.names else ():
            apart = ca.dot(ca.DM(self.rates[i] * self.size), z - 1)
            moved[f"p[{i}]"] = float(self.record.p[i]) + apart
        exact, following = self.task.form.exact, set(moved)
        ops = [*exact.graph.prepared, *exact.stepped]
        for op in ops:
            if any(name in following for name in op.of):
                following.add(op.name)
        known, columns, symbols = dict(moved), list[Array](), list[ca.SX]()

        def value(name: str, numbers: Array) -> Any:
            """Return a number where it is the same in all of these steps, else a symbol."""
            if np.ptp(numbers) == 0:
                return ca.SX(float(numbers[0]))
            symbols.append(ca.SX.sym(name))
            columns.append(numbers)
            return symbols[-1]

        needed, taken = set(wanted), set[str]()
        for op in reversed(ops):
            if op.name in needed and op.name in following:
                needed.update(op.of)
                taken.add(op.name)
        for name in sorted(needed):
            if name not in following and not name.startswith("("):
                known[name] = value(name, self.record.of(name)[steps])
        learnt, position = self.smooth.learnt, {op.name: i for i, op in enumerate(self.task.form.compared)}
        weights = {
            name: (learnt[f"given.{name}"], value(f"w{name}", self.smooth.weights[steps, i]), learnt[f"offset.{name}"])
            for name, i in position.items() if name in taken
        }  # fmt: skip
        tables, wide = exact.graph.tables, ca.fmin(WIDER * self.width, 1)
        scales = {op.name: learnt[f"scale.{op.name}"] for op in self.task.form.rounded}
        rounding = Rounding(self.width, scales, weights, lambda name, at: rounded(tables[name], at, wide))
        found = smooth_values(exact, known, wanted, rounding)
        numbers = np.array(columns).reshape(len(columns), len(self.record.u[0, steps]))
        return ca.Function("stage", [x, u, z, ca.vertcat(ca.SX(0, 1), *symbols), self.width], [ca.vertcat(*found)]), numbers

    def _kept(self) -> list[int]:
        """Return the positions of the states that are unknowns: those that commands or sizes move, and that move what is asked for."""
        exact, n_x = self.task.form.exact, len(self.step.states)
        every = slice(None)
        stage, numbers = self._stage(range(n_x), every, [*exact.following, *self.asked])
        x, u, z, d = (ca.SX.sym(name, stage.size1_in(i)) for i, name in enumerate("xuzd"))
        moved = ca.vertcat(x, u, z)
        by = ca.Function("by", [x, u, z, d, self.width], [ca.jacobian(stage(x, u, z, d, self.width), moved)])
        ones = np.ones((len(self.names), self.n))
        found = np.array(by.map(self.n)((self.record.x - self.base[:, None]) / self.scale[:, None], self._shares, ones, numbers, WIDTHS[0]))
        size = [*self.scale, 1.0, *[abs(self.way.goal) / float(self.task.samples.dt.sum())] * (len(self.asked) - 1)]
        large = np.abs(found.reshape(len(size), self.n, -1)).max(axis=1) / np.array(size)[:, None] > COUNTS

        def closed(seeds: set[int], ways: Array) -> set[int]:
            while more := {int(i) for j in seeds for i in np.flatnonzero(ways[j])} - seeds:
                seeds = seeds | more
            return seeds

        asked = {self.task.charge, *([] if self.task.fuel is None else [self.task.fuel]), *np.flatnonzero(large[n_x:, :n_x].any(axis=0))}
        between = large[:n_x, :n_x]
        movable = closed(set(np.flatnonzero(large[:n_x, n_x:].any(axis=1))), between.T)
        return sorted(movable & closed({int(i) for i in asked}, between))

    @property
    def _runs(self) -> Array:
        """Where each command that is solved for is of effect."""
        commands = self.step.commands
        names = [name for i, name in enumerate(commands) if i in self.task.shares]
        flags = [list(commands).index(f"{name.rpartition('.')[0]}.{commands[name].needs}") for name in names]
        return (self.way.commands[:, flags].T > 0).astype(float)

    @property
    def _shares(self) -> Array:
        return self.way.commands[:, self.task.shares].T

    def solve(self, width: float) -> _Point:
        """Solve at a width."""
        task, n, kept, exact = self.task, self.n, self.kept, self.task.form.exact
        x: Any = ca.MX.sym("x", len(kept), n + 1)
        u: Any = ca.MX.sym("u", len(self.commanded), n)
        z: Any = ca.MX.sym("z", len(self.names))
        base, scale, wanted = self.base[kept], self.scale[kept], [*(exact.following[i] for i in kept), *self.asked]
        given = self.smooth.weights[:, [self.smooth.learnt[f"given.{op.name}"] == 1 for op in task.form.compared]]
        _, group = np.unique(np.column_stack([given, task.samples.dt]), axis=0, return_inverse=True)
        parts, order = list[Any](), list[int]()
        for k in range(int(group.max()) + 1):
            # Steps with the same decisions have the same equations, of which what is not decided for falls away.
            steps = np.flatnonzero(group.ravel() == k)
            stage, numbers = self._stage(kept, steps, wanted)
            at = steps.tolist()
            parts.append(stage.map(len(at))(x[:, at], u[:, at], ca.repmat(z, 1, len(at)), numbers, width))
            order += at
        follows = ca.horzcat(*parts)[:, np.argsort(order).tolist()]
        gaps = (follows[: len(kept), :] - ca.DM(base)) / ca.DM(scale) - x[:, 1:]
        charge = kept.index(task.charge)
        target = float(task.optimum.charge(task.optimum.best)[-1]) if task.optimum else 0.0
        if task.fuel is not None:
            fuel = kept.index(task.fuel)
            zero, largest, goal = float(base[fuel]), float(scale[fuel]), x[fuel, n]
        else:
            zero, largest = 0.0, abs(self.way.goal)
            goal = ca.mtimes(ca.sum1(follows[len(kept) + 1 :, :]), ca.DM(task.samples.dt)) / largest
        times, dtimes = task.times(self.way.car, self.names)
        reached = ca.MX(ca.DM(times)) + ca.mtimes(ca.DM(dtimes * self.size), z - 1) if self.names and times else ca.MX(0, 1)
        g = ca.vertcat(ca.vec(gaps), ca.vec(follows[len(kept), :]), x[charge, n] - (target - base[charge]) / scale[charge], reached)
        # The exact step's own misses stay as they are; rounding adds to them.
        most = np.full(n, task.most_missed + width * np.abs(task.samples.v).max())
        low = np.concatenate([np.zeros(gaps.numel()), np.full(n, -np.inf), [0.0], np.full(reached.numel(), -np.inf)])
        high = np.concatenate([np.zeros(gaps.numel()), most, [np.inf], [r.time * (1 - SURE) for r in task.reach][: reached.numel()]])

        shares, runs = self._shares, self._runs
        low_u, high_u = np.where(runs > 0, 0.0, shares), np.where(runs > 0, 1.0, shares)
        start = (np.column_stack([self.record.x, self.last])[kept] - base[:, None]) / scale[:, None]
        low_x, high_x = np.full(start.shape, -np.inf), np.full(start.shape, np.inf)
        first: Any = self._first(kept)(z)
        low_x[charge], high_x[charge] = -base[charge] / scale[charge], (1 - base[charge]) / scale[charge]
        g, zeros = ca.vertcat(g, x[:, 0] - first), np.zeros(len(kept))
        low, high = np.append(low, zeros), np.append(high, zeros)
        bounds = np.array([task.sizes[name] for name in self.names]).reshape(-1, 2) / self.size[:, None]
        low_z, high_z = np.maximum(bounds[:, 0], 1 - MOVED), np.minimum(bounds[:, 1], 1 + MOVED)
        unknowns = ca.vertcat(ca.vec(x), ca.vec(u), z)
        options = {
            "max_iter": task.iterations, "print_level": 0, "sb": "yes", "mu_init": 1e-3,
            "tol": 1e-6, "constr_viol_tol": 1e-8,
        }  # fmt: skip
        program: Any = {"x": unknowns, "f": goal, "g": g}
        seen, listening, settled = list[tuple[float, float]](), Interrupts(), list[int]()

        def note(_: Array, f: float, g: Array) -> bool:
            seen.append((f, float(np.max(np.maximum(low - g, g - high), initial=0.0))))
            goals, missed = np.array(seen[-PATIENCE:]).T
            if len(seen) > PATIENCE and np.ptp(goals) < GAIN * abs(f) and missed.max() < NEARLY:
                settled.append(len(seen))
            return bool(settled) or listening.came

        silent: Any = {
            "ipopt": options, "print_time": False, "error_on_fail": False,
            "iteration_callback": Watch(unknowns.numel(), g.numel(), note),
        }  # fmt: skip
        if task.shares:
            # Kinks of maps, rounded, bend the program both ways: curvature that bends it down is left out, and steps are kept as short
            # as the narrower kinks ask for.
            curvature = _Curvature(x, u, z, goal, g, STIFF / (n * width))
            silent["hess_lag"] = curvature
        else:
            options["hessian_approximation"] = "limited-memory"
        solver = ca.nlpsol("transcription", "ipopt", program, silent)
        found: Any = None
        with suppress(KeyboardInterrupt), listening.listened_to():
            found = solver(
                x0=np.concatenate([start.ravel("F"), shares.ravel("F"), np.clip(np.ones(len(self.names)), low_z, high_z)]),
                lbx=np.concatenate([low_x.ravel("F"), low_u.ravel("F"), low_z]),
                ubx=np.concatenate([high_x.ravel("F"), high_u.ravel("F"), high_z]),
                lbg=low,
                ubg=high,
            )
        if found is None:
            raise KeyboardInterrupt
        values = np.array(found["x"]).ravel()
        commands = self.way.commands.copy()
        cut = start.size + shares.size
        commands[:, task.shares] = np.clip(values[start.size : cut].reshape(n, -1), 0, 1)
        sizes = {name: float(x) for name, x in zip(self.names, values[cut:] * self.size, strict=True)}
        told = solver.stats()
        status = INTERRUPTED if listening.came else "settled" if settled else str(told["return_status"]).replace("_", " ").lower()
        return _Point(commands, sizes, zero + float(found["f"]) * largest, told["iter_count"], status)

    def _first(self, kept: list[int]) -> ca.Function:
        """Return the first states over their scales as a function of the sizes."""
        z = ca.SX.sym("z", len(self.names))
        p = ca.DM(self.record.p) + ca.mtimes(ca.DM(self.rates * self.size), z - 1)
        (start,) = self.step.start.call([p])
        return ca.Function("first", [z], [(start[kept] - ca.DM(self.base[kept])) / ca.DM(self.scale[kept])])


class _Curvature(ca.Callback):
    """Second derivatives of the Lagrangian by states and commands, a block for each step, each made positive definite.

    Parameters
    ----------
    x, u, z
        States of each step, a column more than commands; commands; sizes, whose curvature is one number for all.
    goal, g
        What is minimised, and what is limited.
    least
        Least eigenvalue of a block.

    """

    def __init__(self, x: Any, u: Any, z: Any, goal: Any, g: Any, least: float) -> None:
        ca.Callback.__init__(self)
        (n_x, _), (n_u, n) = x.shape, u.shape
        f, lam, states = ca.MX.sym("f"), ca.MX.sym("lam", g.numel()), x.numel()
        self.whole, self.least, self.sizes = states + u.numel() + z.numel(), least, (states + u.numel() + z.numel(), 0, 1, g.numel())
        found: Any = ca.triu(ca.hessian(f * goal + ca.dot(lam, g), ca.vertcat(ca.vec(x), ca.vec(u)))[0])
        self.hessian = ca.Function("hessian", [ca.vertcat(ca.vec(x), ca.vec(u), z), ca.MX.sym("none", 0), f, lam], [found])
        own = np.arange(n)[:, None]
        members = np.column_stack([n_x * own + np.arange(n_x), states + n_u * own + np.arange(n_u)])
        block, place = np.full(self.whole, -1), np.zeros(self.whole, dtype=int)
        block[members], place[members] = own, np.arange(n_x + n_u)
        row, column = (np.array(i) for i in found.sparsity().get_triplet())
        self.at, self.shape = (block[row], place[row], place[column]), (n, n_x + n_u, n_x + n_u)
        upper = np.triu_indices(n_x + n_u)
        rest = np.setdiff1d(np.arange(self.whole), members)
        rows, columns = (np.concatenate([members[:, i].ravel(), rest]) for i in upper)
        self.upper, self.order = upper, np.lexsort((rows, columns))
        #: What is in no block is linear: the last states, and sizes.
        self.rest = np.where(rest < states, least, CURVED)
        self.pattern = ca.Sparsity.triplet(self.whole, self.whole, rows.tolist(), columns.tolist())
        self.construct("curvature", {})

    def get_n_in(self) -> int:
        return 4

    def get_n_out(self) -> int:
        return 1

    def get_name_in(self, i: int) -> str:
        return ("x", "p", "lam_f", "lam_g")[i]

    def get_name_out(self, _: int) -> str:
        return "hess"

    def get_sparsity_in(self, i: int) -> Any:
        return ca.Sparsity.dense(self.sizes[i], 1)

    def get_sparsity_out(self, _: int) -> Any:
        return self.pattern

    def eval(self, given: Any) -> Any:
        blocks = np.zeros(self.shape)
        # A root at the end of its range has none.
        blocks[self.at] = np.nan_to_num(self.hessian(*given).nonzeros(), nan=0.0, posinf=0.0, neginf=0.0)
        values, vectors = np.linalg.eigh(blocks, UPLO="U")
        blocks = vectors * np.maximum(values, self.least)[:, None, :] @ vectors.transpose(0, 2, 1)
        return [ca.DM(self.pattern, np.concatenate([blocks[:, *self.upper].ravel(), self.rest])[self.order])]


def _check(vehicle: Any, cycle: Any, sizes: Mapping[str, Any], widths: Sequence[float], iterations: Any) -> None:
    problems = not_a(Vehicle, vehicle=vehicle) + not_a(Cycle, cycle=cycle)
    if not problems:
        model = vehicle.model()
        commands = [c for name in model.commandable for c in model.parts[name].commands]
        chosen = [c.name for c in commands if c.kind == "step"]
        if chosen:
            problems.append(f"{vehicle.name} chooses gears; a transcription takes series and fuel cell hybrids, and electric cars")
        if not sizes and not commands:
            problems.append("nothing is free: a vehicle without commands needs sizes")
        problems += unknown_numbers(vehicle, list(sizes))
    for name, bounds in sizes.items():
        ends = [number(x) for x in bounds] if isinstance(bounds, Sequence) and len(bounds) == 2 else []
        if not ends or not 0 < ends[0] < ends[1] < np.inf:
            problems.append(f"{name} = {bounds}, must be a lowest and a highest value > 0")
    if not widths or not all(0 < number(w) <= 1 for w in widths):
        problems.append(f"widths = {widths}, must be numbers > 0 and <= 1")
    if not (isinstance(iterations, int) and iterations > 0):
        problems.append(f"iterations = {iterations}, must be a whole number > 0")
    if problems:
        raise InputError("transcription", problems)
