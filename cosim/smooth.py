"""Runs the smooth form of a vehicle's step (`halfshaft.fmu_build.smooth`) over a cycle, with what an exact run teaches it.

The exact run gives the scale of every rounding, and the decisions.  A *decision* is a comparison at which the step jumps: a change of
gear, an engine that starts, a battery beyond its window, and what a control remembers of them.  Which comparisons these are is found
by trial: where one changes from step to step, or does when the vehicle is asked for something else, the point between is searched at
which it changes, and the step is taken there on both sides.  If what follows differs, it decides; if not, both sides meet, and only
the kink has to be rounded.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Literal, TypeAlias, get_args

import numpy as np
import numpy.typing as npt

from halfshaft.cosim.compiled import Array, CompiledStep, March, Stepper
from halfshaft.cosim.cycle import Cycle, Samples
from halfshaft.cosim.gradient import Plan, Slopes, What, rates, unknown_numbers, unknown_outputs
from halfshaft.cosim.simulate import Build, parameters_of, stepper_of
from halfshaft.fmu_build.evaluate import evaluate, number, of_names
from halfshaft.fmu_build.graph import ZERO, Op, StepGraph
from halfshaft.fmu_build.smooth import COMPARISONS, SmoothStep, smooth_step
from halfshaft.library.base.errors import InputError, not_a
from halfshaft.models.assembly import REQUESTED, Step
from halfshaft.models.vehicle import Vehicle

#: What a comparison does: where one decides, the step jumps, and where it bends, there is a kink.  Others change nothing: one saves work
#: where two values are equal, or guards a quotient, which would be none.
Role: TypeAlias = Literal["decides", "bends", "saves", "guards"]
#: How decisions are taken: as in the exact run, or by weights that pass smoothly from one side to the other.
Decisions: TypeAlias = Literal["fixed", "relaxed"]
#: A scale is at least this part of the size of what is rounded: where both sides are always the same, their difference tells nothing.
LEAST_SCALE = 0.1
#: Constants up to this size are guards.
GUARD = 1e-3
#: What follows on both sides of a decision differs by more than this part of its largest value in the run.
JUMP = 1e-3
#: Part of the largest value of a unit that may be rounding.
ROUNDING = 1e-6
#: Two values are near, and on a threshold, if they differ by these parts of their scale.
NEAR, TIED = 1e-3, 1e-4
#: Places at which a comparison is tried, and halvings of the way between two steps that compare differently.
TRIALS, HALVINGS = 6, 45


@dataclass(frozen=True)
class Record:
    """States and requests of an exact run, a column a step, and all values of the step in it."""

    x: Array
    u: Array
    p: Array
    values: dict[str, Array]

    def of(self, name: str) -> Array:
        """Return a value in every step."""
        return np.broadcast_to(number(name) if name.startswith("(") else self.values[name], self.x.shape[1]).astype(float)


@dataclass(frozen=True)
class Smooth:
    """The smooth form of a vehicle's step for one cycle."""

    vehicle: Vehicle
    samples: Samples
    decisions: Decisions
    compiled: CompiledStep
    form: SmoothStep
    record: Record

    @property
    def step(self) -> Step:
        """The smooth step."""
        return self.form.step

    @property
    def ends(self) -> tuple[float, float]:
        """Times at which the cycle begins and ends [s]."""
        return float(self.samples.t[0] - self.samples.dt[0]), float(self.samples.t[-1])

    @cached_property
    def roles(self) -> Mapping[str, Role]:
        """What each comparison does, by its name among the values of the exact step."""
        return _roles(self.form, self.record)

    @cached_property
    def learnt(self) -> Mapping[str, float]:
        """Values of the parameters that the exact run gives."""
        learnt = {f"scale.{op.name}": _scale(op, self.record) for op in self.form.rounded}
        for op in self.form.compared:
            decides, saves = self.roles[op.name] == "decides", self.roles[op.name] == "saves"
            relaxed = decides and self.decisions == "relaxed" and np.ptp(self.record.of(op.name)) > 0
            learnt[f"given.{op.name}"] = float(saves or (decides and not relaxed))
            learnt[f"offset.{op.name}"] = _offset(op, self.record) if relaxed else 0.0
        return learnt

    @cached_property
    def weights(self) -> Array:
        """What each comparison is given, a row a step: where it decides, as in the exact run; where it saves, that nothing is equal."""
        n = self.record.x.shape[1]
        saved = {op.name: np.full(n, float(op.what == "ne")) for op in self.form.compared if self.roles[op.name] == "saves"}
        given = [saved.get(op.name, self.record.of(op.name)) for op in self.form.compared]
        return np.array(given).reshape(len(given), n).T.copy()

    @property
    def more(self) -> Array:
        """What the smooth step requests beyond `REQUESTED`, a row a step: commands where there are any, and weights."""
        return np.column_stack([self.record.u[len(REQUESTED) :].T, self.weights])

    def parameters(self, width: float, vehicle: Vehicle | None = None) -> Array:
        """Return the parameters of the smooth step, for this vehicle or one with other numbers."""
        own = parameters_of(vehicle or self.vehicle, stepper_of(self.vehicle).step, self.samples.v_start)
        more = [width if d.name == "width" else self.learnt[d.name] for d in self.step.parameters[len(own) :]]
        return np.array([*own, *more])

    def march(self, width: float, vehicle: Vehicle | None = None) -> March:
        """Run the cycle by the smooth step."""
        return self.compiled.march(self.samples, self.parameters(width, vehicle), more=self.more)

    def slopes(
        self, names: Sequence[str], wanted: Sequence[What], width: float, vehicle: Vehicle | None = None, history: Sequence[str] = ()
    ) -> Slopes:
        """Run the cycle and derive what it gives by numbers of the vehicle, as `halfshaft.cosim.gradient.slopes` of the exact step."""
        vehicle = vehicle or self.vehicle
        problems = [*unknown_numbers(vehicle, names), *unknown_outputs(self.step, wanted, history, self.ends)]
        if problems:
            raise InputError("smooth slopes", problems)
        plan = _plan(Build(self.vehicle), tuple(sorted({*(name for name, _ in wanted), *history})), bool(self.samples.grade_by_distance))
        p = self.parameters(width, vehicle)
        exact, dp = stepper_of(self.vehicle).step, np.zeros((len(p), len(names)))
        dp[: len(exact.parameters)] = rates(vehicle, exact, names)
        return plan.slopes(self.samples, p, dp, tuple(names), wanted, history, more=self.more)


def smoothed(vehicle: Vehicle, cycle: Cycle, *, decisions: Decisions = "fixed", dt: float = 1.0) -> Smooth:
    """Return the smooth form of a vehicle's step for a cycle, from an exact run of it.

    Parameters
    ----------
    vehicle, cycle
        What runs where; an exact run of it, by the hybrid mode, gives scales and decisions.
    decisions
        ``fixed`` to take decisions as in that run, ``relaxed`` to let them pass smoothly from one side to the other.
    dt
        Length of the step [s].

    """
    problems = not_a(Vehicle, vehicle=vehicle) + not_a(Cycle, cycle=cycle)
    if decisions not in get_args(Decisions):
        problems.append(f"decisions = {decisions!r}, must be one of {', '.join(get_args(Decisions))}")
    if problems:
        raise InputError("smoothed", problems)
    form, compiled = _form(Build(vehicle))
    samples = cycle.sampled(dt)
    stepper = stepper_of(vehicle)
    record = record_of(stepper, form.exact, samples, parameters_of(vehicle, stepper.step, samples.v_start))
    return Smooth(vehicle, samples, decisions, compiled, form, record)


@lru_cache(maxsize=16)
def _form(build: Build) -> tuple[SmoothStep, CompiledStep]:
    form = smooth_step(stepper_of(build.vehicle).step)
    # Nearly as fast as with more, in a third of the time of the compiler.
    return form, CompiledStep(form.step, ("-O1",))


@lru_cache(maxsize=32)
def _plan(build: Build, outputs: tuple[str, ...], graded: bool) -> Plan:
    form, whole = _form(build)[0], _form(build)[0].step
    step = whole.only({*outputs, *(whole.tags.the(tag) for tag in ("request", "miss", "overspeed"))})
    grade = [i for i, d in enumerate(step.requests) if d.name == "grade"] if graded else []
    return Plan.of(step, grade, sum(map(len, (form.rounded, form.compared, form.compared))) + 1)


def record_of(stepper: Stepper, found: StepGraph, samples: Samples, p: Array, commands: Array | None = None) -> Record:
    """Return an exact run step by step, with what is commanded in each step where controls obey."""
    step = stepper.step
    distance, n = step.state_index[step.tags.the("distance")], len(samples.t)
    u = np.column_stack([samples.v, samples.grade, samples.key_on, samples.dt, np.zeros(n), *([] if commands is None else commands.T)])
    x, states = stepper.first(p), []
    for request in u:
        if samples.grade_by_distance:
            request[1] = np.interp(x[distance], *samples.grade_by_distance)
        states.append(x)
        x, _ = stepper(x, request, p)
    rows = np.array(states).reshape(n, len(step.states)).T
    return Record(rows, u.T, p, evaluate(found, rows, u.T, p))


def _size(values: Array) -> float:
    """Return how large values are; those that are not finite aside."""
    finite = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else 0.0


def _scale(op: Op, record: Record) -> float:
    """Return how large the two sides of what is rounded usually are, and their difference."""
    sides = [record.of(name) for name in op.of]
    # A small constant guards a quotient, or allows for rounding: it tells nothing of a size.
    sizes = [_size(side) for name, side in zip(op.of, sides, strict=True) if not name.startswith("(") or abs(number(name)) > GUARD]
    if op.what in COMPARISONS and all(np.all(side == np.round(side)) for side in sides):
        return max(sizes, default=0.0) or 1.0
    # The smaller side: a limit that is out of reach tells nothing of the size of what it limits.
    largest = min((size for size in sizes if size > 0), default=1.0)
    return largest if len(sides) == 1 else min(max(_size(sides[0] - sides[1]), LEAST_SCALE * largest), largest)


def _offset(op: Op, record: Record) -> float:
    """Return by how much of its rounding a threshold is moved: to the side where steps lie on the threshold itself."""
    if op.what not in ("lt", "le"):
        return 1.0
    apart = np.abs(record.of(op.of[0]) - record.of(op.of[1]))
    tied = record.of(op.name)[apart <= TIED * _scale(op, record)]
    return float(np.sign(np.mean(tied) - 0.5)) if len(tied) else 0.0


def _roles(form: SmoothStep, record: Record) -> dict[str, Role]:
    """Return what each comparison does."""
    trial, roles = _Trial(form, record), dict[str, Role]()
    for op in form.compared:
        own = record.of(op.name)
        sides = [record.of(name) for name in op.of] + [np.zeros(1)] * (len(op.of) == 1)
        whole = all(np.all(side == np.round(side)) for side in sides)
        if op.what in ("eq", "ne"):
            equal = np.flatnonzero(own == (op.what == "eq"))
            change, lost = (0.0, True) if whole or not len(equal) else trial.turned(op.name, equal)
            roles[op.name] = (
                "guards" if lost and not whole and (len(equal) or ZERO in op.of) else "saves" if not lost and change < JUMP else "decides"
            )
        elif op.what == "true":
            roles[op.name] = "decides" if np.ptp(own) else "guards"
        else:
            near = np.flatnonzero(np.abs(sides[0] - sides[1]) < NEAR * _scale(op, record))
            decides = whole or not np.ptp(own) or trial.turned(op.name, near)[0] > JUMP
            roles[op.name] = "decides" if decides else "bends"
    for name in trial.at_the_threshold([name for name, role in roles.items() if role == "bends"]):
        roles[name] = "decides"
    return roles


class _Trial:
    """Takes steps with a comparison turned round."""

    def __init__(self, form: SmoothStep, record: Record) -> None:
        self.form, self.record, self.n = form, record, record.x.shape[1]
        found = form.exact
        shown = [(name, d) for name, d in zip(found.outputs, form.step.outputs, strict=True) if d.kind not in ("flag", "count")]
        #: What follows from a step, and how large it gets in the run.
        self.wanted = [*found.following, *(name for name, _ in shown)]
        units = [*(d.unit for d in form.step.states), *(d.unit for _, d in shown)]
        scale = np.max(np.abs(of_names(record.values, self.wanted, self.n)), axis=1, initial=0.0)
        # What is but rounding beside others of its unit is no size.
        largest = {unit: max(x for x, other in zip(scale, units, strict=True) if other == unit) for unit in units}
        scale = np.maximum(scale, [ROUNDING * largest[unit] for unit in units])
        self.scale = np.where(scale > 0, scale, 1.0)[:, None]

    def difference(self, one: dict[str, Array], two: dict[str, Array], n: int) -> Array:
        """Return how far what follows lies apart at most, over its largest value in the run."""
        apart = np.abs(of_names(one, self.wanted, n) - of_names(two, self.wanted, n)) / self.scale
        furthest: Array = np.max(np.nan_to_num(apart, nan=np.inf), axis=0, initial=0.0)
        return furthest

    def turned(self, name: str, steps: npt.NDArray[np.intp]) -> tuple[float, bool]:
        """Return what turning a comparison round changes in some steps of the run, and whether some value is lost by it."""
        if not len(steps):
            return 0.0, False
        x, u = self.record.x[:, steps], self.record.u[:, steps]
        plain = {name: np.broadcast_to(value, self.n)[steps] for name, value in self.record.values.items()}
        turned = evaluate(self.form.exact, x, u, self.record.p, {name: 1.0 - plain[name]})
        lost = any(np.any(np.isfinite(value) & ~np.isfinite(turned[name])) for name, value in plain.items())
        return float(np.max(self.difference(plain, turned, len(steps)))), lost

    def at_the_threshold(self, names: list[str]) -> Iterator[str]:
        """Yield the comparisons at which the step jumps, just where they change between two steps of the run."""
        found = self.form.exact
        ends = [(name, k) for name in names for k in np.flatnonzero(np.diff(self.record.of(name)))[:TRIALS]]
        if not ends:
            return
        of, steps = [name for name, _ in ends], np.array([k for _, k in ends])
        low, high = ((self.record.x[:, k], self.record.u[:, k]) for k in (steps, steps + 1))

        def between(share: Array) -> tuple[Array, Array, Array]:
            x, u = (a + share * (b - a) for a, b in zip(low, high, strict=True))
            return x, u, self.record.p

        def flags(values: dict[str, Array]) -> Array:
            return np.array([np.broadcast_to(values[name], len(of))[j] for j, name in enumerate(of)], dtype=float)

        first = flags(evaluate(found, *between(np.zeros(len(of)))))
        a, b = np.zeros(len(of)), np.ones(len(of))
        for _ in range(HALVINGS):
            middle = (a + b) / 2
            same = flags(evaluate(found, *between(middle))) == first
            a, b = np.where(same, middle, a), np.where(same, b, middle)
        turned = {name: np.where([other == name for other in of], 1.0 - first, np.nan) for name in set(of)}
        plain, other, behind = evaluate(found, *between(a)), evaluate(found, *between(a), turned), evaluate(found, *between(b))
        jumped = np.minimum(self.difference(plain, other, len(of)), self.difference(plain, behind, len(of))) > JUMP
        # Where the two sides are far from each other there, something else has jumped between the steps, and turned it round.
        ops = {op.name: op for op in self.form.compared}
        sides = [[of_names(plain, [side], len(of))[0, j] for side in ops[name].of] for j, name in enumerate(of)]
        crossed = [abs(a - b) < NEAR * _scale(ops[name], self.record) for name, (a, b) in zip(of, sides, strict=True)]
        yield from dict.fromkeys(name for name, jumps, meets in zip(of, jumped, crossed, strict=True) if jumps and meets)
