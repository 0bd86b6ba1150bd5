"""Derivatives of whole runs: how what a run gives changes with the numbers of its vehicle.

Tangents are marched beside the values, eight at a time, by compiled code (`halfshaft.fmu_build.tangents`): exact for the step as it is,
to rounding.  A step is smooth but for kinks, at which a derivative is that of the side taken, and jumps, which have none: a gear that
changes a step later, an engine that starts once more.  How the numbers of the step follow from those that are set (a mass from sizes) is
found by differences of fourth order of the vehicle's rules, which are algebra; the mass is not rounded, and maps stay as they are.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from halfshaft.cosim.compiled import MODES, Array, Mode, address, march_code, read_by_c
from halfshaft.cosim.cycle import TIME_STEP, Cycle, Samples
from halfshaft.cosim.figures import figures, needs
from halfshaft.cosim.simulate import Build, parameters_of, stepper_of
from halfshaft.fmu_build.compiler import shared_library
from halfshaft.fmu_build.lanes import WIDTHS, widths
from halfshaft.fmu_build.tangents import TANGENTS, tangents_code
from halfshaft.library.base.errors import InputError, SolveError, nearest, not_a, number
from halfshaft.models.assembly import Step
from halfshaft.models.vehicle import Vehicle

#: An output, and what of it: one of `HOWS`, or its value in the step that holds a time [s].
What: TypeAlias = tuple[str, str | float]
#: In the order in which C has them; the start value has a place of its own.
HOWS = ("last", "integral", "max", "min")
#: Places and weights of the difference of fourth order, and its step over the size of a number.
PLACES, WEIGHTS, APART = np.array([-2.0, -1.0, 1.0, 2.0]), np.array([1.0, -8.0, 8.0, -1.0]) / 12, 1e-3


@dataclass(frozen=True)
class Slopes:
    """What was asked for of a run, and its derivatives.

    Parameters
    ----------
    names
        The numbers by which is derived.
    time
        End of each step [s], shape ``(n,)``.
    values, gradient
        Of each output and what of it: a number, and its derivatives, shape ``(len(names),)``.
    history, history_gradient
        Of each output that was asked for: its values, shape ``(n,)``, and their derivatives, shape ``(n, len(names))``.
    unsolved
        Steps in which no end speed was reached; their derivatives are those of the plain step.

    """

    names: tuple[str, ...]
    time: Array
    values: Mapping[What, float]
    gradient: Mapping[What, Array]
    history: Mapping[str, Array]
    history_gradient: Mapping[str, Array]
    unsolved: int


def slopes(
    vehicle: Vehicle,
    cycle: Cycle,
    names: Sequence[str],
    wanted: Sequence[What],
    *,
    history: Sequence[str] = (),
    mode: Mode = "hybrid",
    dt: float = 1.0,
    initial: Mapping[str, float] | None = None,
) -> Slopes:
    """Run a vehicle over a cycle and derive what it gives by numbers of the vehicle.

    Parameters
    ----------
    vehicle, cycle
        What runs where.
    names
        Numbers by ``role.parameter``, or ratings; what follows from them by rules follows.
    wanted
        Outputs, each with ``integral``, ``max``, ``min``, ``last``, ``first`` (of what shows a state) or a time [s].
    history
        Outputs of which values and derivatives are kept of all steps.
    mode, dt
        As for `run`.
    initial
        Start values of states by name [SI], in place of those that the parameters give; nothing moves them.

    Raises
    ------
    InputError
        If names or arguments are not what they must be; everything that is wrong is named at once.
    CompileError
        If there is no C compiler.
    SolveError
        If a number is lost.

    """
    names, initial = tuple(names), dict(initial or {})
    _check(vehicle, cycle, names, wanted, history, mode, dt, initial)
    outputs, asked = {*(name for name, _ in wanted), *history}, mode != "hybrid" or cycle.grade_by_distance is not None
    plan = _plan(Build(vehicle), tuple(sorted(outputs)), asked)
    samples = cycle.sampled(dt)
    p = parameters_of(vehicle, plan.step, samples.v_start)
    return plan.slopes(samples, p, rates(vehicle, plan.step, names), names, wanted, history, initial, mode)


def rates(vehicle: Vehicle, step: Step, names: Sequence[str]) -> Array:
    """Return how the parameters of a step change with numbers of the vehicle, shape ``(n_parameters, len(names))``."""
    at, start = step.parameter_index, step.tags.the("start speed")
    found = np.zeros((len(at), len(names)))
    for near in _nearby(vehicle, names):
        for name, x in near.fleet.values.items():
            if isinstance(x, np.ndarray) and name in at and name != start:
                found[at[name], near.of] = near.slope(x)
    return found


def figure_gradient(
    vehicle: Vehicle, cycle: Cycle, names: Sequence[str], *, mode: Mode = "hybrid", dt: float = 1.0
) -> dict[str, dict[str, float]]:
    """Return the derivatives of the main figures of a run, by the figures' names and those of the numbers."""
    found = slopes(vehicle, cycle, names, list(needs(stepper_of(vehicle).step)), mode=mode, dt=dt)
    return figure_slopes(vehicle, cycle, found)[1]


def figure_slopes(vehicle: Vehicle, cycle: Cycle, found: Slopes) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
    """Return the main figures of a run with its derivatives, where these are of all that figures need; and the figures' derivatives."""
    step, names, gradient = stepper_of(vehicle).step, found.names, dict[str, dict[str, float]]()
    duration, rated = float(found.time[-1]) - float(cycle.time[0]), {role: p.ratings() for role, p in vehicle.parameters.items()}
    values = figures(step, lambda *what: np.array([found.values[what]]), vehicle.values, rated, duration)
    for near in _nearby(vehicle, names):

        def get(output: str, how: str, near: _Near = near) -> Array:
            # Along each tangent, as far as the numbers were displaced.
            return (found.values[output, how] + np.outer(found.gradient[output, how][near.of] * near.apart, PLACES)).ravel()

        ratings = {role: p.ratings() for role, p in near.fleet.parameters.items()}
        for figure, x in figures(step, get, near.fleet.values, ratings, duration).items():
            each = np.broadcast_to(x, len(near.of) * len(PLACES))
            gradient.setdefault(figure, {}).update(zip([names[i] for i in near.of], near.slope(each).tolist(), strict=True))
    whole = {figure: {name: of[name] for name in names} for figure, of in gradient.items()}
    return {figure: float(np.ravel(x)[0]) for figure, x in values.items()}, whole


def value_of(vehicle: Vehicle, name: str) -> float:
    """Return a number of a vehicle, or what a part of it is rated at."""
    if name in vehicle.rated:
        return float(vehicle.rated[name].of(vehicle.parameters[name.partition(".")[0]]))
    return float(vehicle.values[name])


class _Near(NamedTuple):
    """Vehicles near to one, four for each of some numbers: their positions, by how much these are displaced, and the vehicles."""

    of: list[int]
    apart: Array
    fleet: Vehicle

    def slope(self, x: Array) -> Array:
        """Return the derivatives of what these vehicles have."""
        each = x.reshape(-1, len(PLACES))
        # What stays as it is has no rounding error either.
        found: Array = (each - each[:, :1]) @ WEIGHTS / self.apart
        return found


def _nearby(vehicle: Vehicle, names: Sequence[str]) -> Iterator[_Near]:
    """Yield vehicles near to one.  A number that a rule gives is displaced alone: displaced with others, it would not follow them."""
    apart = np.array([APART * (abs(value_of(vehicle, name)) or 1.0) for name in names])
    alone = [[i] for i, name in enumerate(names) if name in vehicle.derived]
    together = [i for i, name in enumerate(names) if name not in vehicle.derived]
    for of in ([together] if together else []) + alone:
        arrays = {}
        for k, i in enumerate(of):
            arrays[names[i]] = np.full(len(of) * len(PLACES), value_of(vehicle, names[i]))
            arrays[names[i]][len(PLACES) * k : len(PLACES) * (k + 1)] += apart[i] * PLACES
        yield _Near(of, apart[of], vehicle.displaced(arrays))


class _Found(NamedTuple):
    """What a march leaves, with tangents."""

    first: Array
    dfirst: Array
    totals: Array
    dtotals: Array
    rows: Array
    drows: Array
    unsolved: int


class Plan(NamedTuple):
    """A step with tangents, as machine code."""

    library: ctypes.CDLL
    step: Step

    @classmethod
    def of(cls, step: Step, moved: Sequence[int] = (), still: int = 0) -> Plan:
        """Return the machine code of a step; the arguments are those of `tangents_code`."""
        own = files("halfshaft.cosim").joinpath("march_tangents.c").read_text(encoding="utf-8")
        code = "\n".join([march_code(step), tangents_code(step, moved, still), own])
        # Found as fast as with more, in half the time of the compiler.
        flags = ("-O1", *(WIDTHS[widths()[0]][0] if widths() else ()))
        library = ctypes.CDLL(str(shared_library(code, f"{step.name}_tangents", flags=flags)))
        library.hs_march_tangents.restype = ctypes.c_long
        return cls(library, step)

    def slopes(
        self, samples: Samples, p: Array, dp: Array, names: tuple[str, ...], wanted: Sequence[What], history: Sequence[str],
        initial: Mapping[str, float] | None = None, mode: Mode = "hybrid", more: Array | None = None,
    ) -> Slopes:  # fmt: skip
        """Run a cycle and derive what is asked for; `dp` has a column for each name, and `more` is as for `CompiledStep.march`."""
        samples, kept = read_by_c(samples), bool(history) or any(not isinstance(how, str) for _, how in wanted)
        each = [dp[:, k : k + TANGENTS] for k in range(0, max(len(names), 1), TANGENTS)]
        found = [self.march(samples, p, seeds, initial or {}, mode, kept, more) for seeds in each]
        totals, rows, first = found[0].totals, found[0].rows, found[0].first
        sides = ([f.dtotals for f in found], [f.drows for f in found], [f.dfirst for f in found])
        dtotals, drows, dfirst = (np.concatenate(parts, axis=-1)[..., : len(names)] for parts in sides)
        at = self.step.output_index
        values: dict[What, float] = {}
        gradient: dict[What, Array] = {}
        for name, how in wanted:
            if how == "first":
                i = self.step.state_index[name]
                values[name, how], gradient[name, how] = float(first[i]), dfirst[i]
            elif isinstance(how, str):
                i = HOWS.index(how)
                values[name, how], gradient[name, how] = float(totals[i, at[name]]), dtotals[i, at[name]]
            else:
                k = int(np.searchsorted(samples.t, how - TIME_STEP))
                values[name, how], gradient[name, how] = float(rows[k, at[name]]), drows[k, at[name]]
        shown, dshown = ({name: x[:, at[name]] for name in history} for x in (rows, drows))
        return Slopes(names, samples.t, values, gradient, shown, dshown, found[0].unsolved)

    def march(
        self, samples: Samples, p: Array, dp: Array, initial: Mapping[str, float], mode: Mode, kept: bool, more: Array | None = None
    ) -> _Found:
        """Run a cycle with up to eight tangents."""
        n, n_outputs, n_states = len(samples.t), len(self.step.outputs), len(self.step.states)
        seeds = np.zeros((len(p), TANGENTS))
        seeds[:, : dp.shape[1]] = dp
        first, dfirst = np.empty(n_states), np.empty((n_states, TANGENTS))
        totals, dtotals = np.empty((4, n_outputs)), np.empty((4, n_outputs, TANGENTS))
        rows, drows = (np.empty((n, n_outputs)), np.empty((n, n_outputs, TANGENTS))) if kept else (np.empty(0), np.empty((0, TANGENTS)))
        x, x_of = np.array([*initial.values()], float), np.array([self.step.state_index[name] for name in initial], np.intc)
        distance, grade = samples.grade_by_distance or (None, None)
        unsolved = ctypes.c_long()
        done = self.library.hs_march_tangents(
            ctypes.c_long(n), *map(_place, (samples.dt, samples.v, samples.grade, samples.key_on, more)),
            ctypes.c_long(0 if distance is None else len(distance)), *map(_place, (distance, grade, p, seeds)), ctypes.c_long(len(x)),
            *map(_place, (x, x_of, first, dfirst)), *map(_place, (rows, drows) if kept else (None, None)),
            *map(_place, (totals, dtotals)), MODES.index(mode), ctypes.byref(unsolved),
        )  # fmt: skip
        if done < n:
            raise SolveError(f"{self.step.name}: by t = {samples.t[done]:g} s a result is not a number; check the inputs")
        return _Found(first, dfirst, totals, dtotals, rows, drows, unsolved.value)


def _place(array: Any) -> ctypes.c_void_p:
    return ctypes.c_void_p(address(array))


@lru_cache(maxsize=32)
def _plan(build: Build, outputs: tuple[str, ...], asked: bool) -> Plan:
    """Return the step with some outputs; `asked` is whether the request has tangents too."""
    whole = stepper_of(build.vehicle).step
    step = whole.only({*outputs, *(whole.tags.the(tag) for tag in ("request", "miss", "overspeed"))})
    moved = [i for i, d in enumerate(step.requests) if d.name in ("v_request", "grade")] if asked else []
    return Plan.of(step, moved)


def _check(
    vehicle: Any, cycle: Any, names: Sequence[str], wanted: Sequence[What], history: Sequence[str], mode: Any, dt: Any,
    initial: Mapping[str, float],
) -> None:  # fmt: skip
    problems = not_a(Vehicle, vehicle=vehicle) + not_a(Cycle, cycle=cycle)
    if mode not in MODES:
        problems.append(f"mode = {mode!r}, must be one of {', '.join(MODES)}{nearest(str(mode), MODES)}")
    if not 0 < number(dt) < np.inf:
        problems.append(f"dt = {dt} s, must be a number > 0 s")
    if not problems:
        step, ends = stepper_of(vehicle).step, (float(cycle.time[0]), float(cycle.time[-1]))
        problems += [*unknown_numbers(vehicle, names), *unknown_outputs(step, wanted, history, ends)]
        problems += [f"{name} is no state{nearest(name, step.state_index)}" for name in initial if name not in step.state_index]
    if problems:
        raise InputError("gradient", problems)


def unknown_numbers(vehicle: Vehicle, names: Sequence[str]) -> Iterator[str]:
    """Yield which names are of no number of a vehicle by which could be derived."""
    known = {**vehicle.specs, **{name: rated.spec for name, rated in vehicle.rated.items()}}
    yield from (f"{name} is no number of the vehicle{nearest(name, known)}" for name in names if name not in known)
    factors = {name: f"{name.partition('.')[0]}.{vehicle.rated[name].scale}" for name in names if name in vehicle.rated}
    yield from (f"{name} and {factor} both say how large it is; ask for one of them" for name, factor in factors.items() if factor in names)
    yield from (f"{name} stands {names.count(name)} times" for name in dict.fromkeys(names) if names.count(name) > 1)


def unknown_outputs(step: Step, wanted: Sequence[What], history: Sequence[str], ends: tuple[float, float]) -> Iterator[str]:
    """Yield what is wrong with outputs of a run between two times that are asked for."""
    for name in dict.fromkeys((*(name for name, _ in wanted), *history)):
        if name not in step.output_index:
            yield f"{name} is no output{nearest(name, step.output_index)}"
    for name, how in wanted:
        if isinstance(how, str):
            if how not in (*HOWS, "first"):
                yield f"{name}: {how!r} must be a time or one of {', '.join((*HOWS, 'first'))}{nearest(how, HOWS)}"
            elif how == "first" and name in step.output_index and name not in step.state_index:
                yield f"{name} shows no state, so it has no first value"
        elif not ends[0] < how <= ends[1]:
            yield f"{name}: {how:g} s is no time of the cycle, which lasts from {ends[0]:g} s to {ends[1]:g} s"
