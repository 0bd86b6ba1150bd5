"""The step as machine code, driven over a whole cycle by a C loop.

The generated C (`halfshaft.fmu_build.code`) and the loop in ``march.c`` make one shared library, compiled once and kept
in the user's cache.  `ctypes` releases the interpreter lock during a call, so threads scale.  Without a compiler the
same step runs on CasADi's virtual machine, some 400 times slower, with one warning.
"""

from __future__ import annotations

import ctypes
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from typing import Any, Protocol, TypeAlias

import casadi as ca
import numpy as np
import numpy.typing as npt

from halfshaft.cosim.cycle import Samples
from halfshaft.cosim.ways import MODES as MODES
from halfshaft.cosim.ways import Mode as Mode
from halfshaft.fmu_build.code import step_code
from halfshaft.fmu_build.compiler import SlowWarning, shared_library
from halfshaft.library.base.errors import CompileError, InputError, SolveError
from halfshaft.models.assembly import REQUESTED, Step, assemble
from halfshaft.models.model import Model

Array: TypeAlias = npt.NDArray[np.float64]
#: At most so many outputs are named.
NAMED = 5


@dataclass(frozen=True)
class March:
    """What a march over a cycle leaves.

    The totals are worked out when they are first asked for, where a history was kept; a `SolveError` then says what is not finite.
    """

    #: Outputs of shape ``(n, n_outputs)``; None where only their totals were asked for.
    history: Array | None
    #: Gives last values, time integrals and maxima.
    total: Callable[[], tuple[Array, Array, Array]]
    #: The last state.
    state: Array
    evaluations: int
    #: Steps in which the search of the refined mode, or the iteration, found no speed that is reached.
    unsolved: int = 0

    @cached_property
    def _totals(self) -> tuple[Array, Array, Array]:
        return self.total()

    @property
    def last(self) -> Array:
        """Outputs of the last step; zero if there was none."""
        return self._totals[0]

    @property
    def sums(self) -> Array:
        """Time integral of each output."""
        return self._totals[1]

    @property
    def highest(self) -> Array:
        """Maximum of each output; minus infinity if there was no step."""
        return self._totals[2]


def integrals(name: str, outputs: Iterable[str], samples: Samples, history: Array) -> Array:
    """Return the time integral of each output; what is not finite in any step shows in it.

    Raises
    ------
    SolveError
        If an output is not finite in some step; the message names the first such step and the outputs.

    """
    sums: Array = np.dot(samples.dt, history)
    if not np.isfinite(sums).all():
        raise _not_finite(name, outputs, samples, history, sums)
    return sums


def _not_finite(name: str, outputs: Iterable[str], samples: Samples, history: Array, sums: Array) -> SolveError:
    """Return the error that names the first step with an output that is not finite."""
    rows = np.flatnonzero(~np.isfinite(history).all(axis=1))
    k = int(rows[0]) if len(rows) else len(history) - 1
    return _lost(name, samples, k, outputs, history[k] if len(rows) else sums)


class Stepper(Protocol):
    """A step that can be called once, or marched over a cycle."""

    step: Step

    def first(self, parameters: Array) -> Array:
        """Return the start state."""

    def __call__(self, state: Array, request: Array, parameters: Array) -> tuple[Array, Array]:
        """Return next state and outputs of one step."""

    def march(self, samples: Samples, parameters: Array, state: Array | None = None, mode: Mode = "hybrid", history: bool = True) -> March:
        """Run a whole cycle."""


def stepper(model: Model, title: str = "") -> Stepper:
    """Return the fastest stepper that this machine can make for a model."""
    step = assemble(model, title)
    try:
        return CompiledStep(step)
    except CompileError as error:
        warnings.warn(f"running without compiled code, some 400 times slower: {error}", SlowWarning, stacklevel=3)
        return InterpretedStep(step)


def address(array: npt.NDArray[Any] | None) -> int | None:
    """Return where an array begins, for C."""
    # Half the time of ``array.ctypes.data``; a dozen of them count beside a cycle.
    return None if array is None else int(array.__array_interface__["data"][0])


_LONG, _PLACE = ctypes.c_long, ctypes.c_void_p
#: Argument types of the functions in ``march.c``.
_ARGUMENTS = {
    "hs_march": (_LONG, *(_PLACE,) * 5, _LONG, *(_PLACE,) * 3, ctypes.c_int, *(_PLACE,) * 5, ctypes.c_int, _PLACE),
    "hs_total": (_LONG, *(_PLACE,) * 4),
    "hs_one": (_PLACE,) * 5,
    "hs_first": (_PLACE,) * 2,
}


def _lost(name: str, samples: Samples, k: int, outputs: Iterable[str] = (), values: Array | None = None) -> SolveError:
    lost = [] if values is None else [output for output, x in zip(outputs, values, strict=True) if not np.isfinite(x)]
    what = ", ".join(lost[:NAMED]) + (f" and {len(lost) - NAMED} more" if len(lost) > NAMED else "")
    return SolveError(
        f"{name}: by t = {samples.t[k]:g} s {f'not finite: {what}' if lost else 'a result is not a number'}; check the inputs"
    )


def _doubles(what: str, values: npt.ArrayLike, n: int) -> Array:
    """Return `n` numbers as C reads them, whatever they came in: doubles of this machine, one behind the other."""
    try:
        array = np.ascontiguousarray(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError("step", [f"{what}: {error}"]) from error
    if array.shape != (n,):
        raise InputError("step", [f"{what} has the shape {array.shape}, must be ({n},)"])
    return array if array.flags.aligned else array.copy()


def read_by_c(samples: Samples) -> Samples:
    """Return samples as C reads them."""
    n, grades = len(samples.t), samples.grade_by_distance
    return samples._replace(
        dt=_doubles("dt", samples.dt, n),
        v=_doubles("v", samples.v, n),
        grade=_doubles("grade", samples.grade, n),
        key_on=_doubles("key_on", samples.key_on, n),
        grade_by_distance=grades and (_doubles("distance", grades[0], len(grades[0])), _doubles("grade", grades[1], len(grades[0]))),
    )


def march_code(step: Step, rows: Mapping[str, int] | None = None) -> str:
    """Return the C of a step and of the loop that drives it; `rows` as for `step_code`."""
    the = step.tags.the
    positions = {
        "HS_X_V": step.state_index[the("speed")],
        "HS_X_DISTANCE": step.state_index[the("distance")],
        "HS_X_MISSED": step.state_index[the("missed")],
        "HS_P_MISS": step.parameter_index[the("miss threshold")],
        "HS_Y_REQUEST": step.output_index[the("request")],
        "HS_Y_MISS": step.output_index[the("miss")],
        "HS_Y_OVERSPEED": step.output_index[the("overspeed")],
    }
    defines = "".join(f"#define {name} {i}\n" for name, i in positions.items())
    decisions = [*step.decisions, -1]
    defines += f"static const int hs_decisions[] = {{{', '.join(map(str, decisions))}}};\n"
    return step_code(step, rows) + defines + files("halfshaft.cosim").joinpath("march.c").read_text()


class CompiledStep:
    """A step in a shared library of its own."""

    def __init__(self, step: Step, flags: tuple[str, ...] = ()) -> None:
        self.step = step
        self._library = ctypes.CDLL(str(shared_library(march_code(step), step.name, flags=flags)))
        for name, types in _ARGUMENTS.items():
            getattr(self._library, name).argtypes = types
        self._library.hs_march.restype = ctypes.c_long

    def first(self, parameters: Array) -> Array:
        """Return the start state."""
        state = np.empty(len(self.step.states))
        parameters = _doubles("parameters", parameters, len(self.step.parameters))
        self._library.hs_first(address(parameters), address(state))
        return state

    def __call__(self, state: Array, request: Array, parameters: Array) -> tuple[Array, Array]:
        """Return next state and outputs of one step.

        Raises
        ------
        SolveError
            If an input or a result is not a number.

        """
        following, outputs = np.empty(len(self.step.states)), np.empty(len(self.step.outputs))
        inputs = (
            _doubles("state", state, len(self.step.states)),
            _doubles("request", request, len(self.step.requests)),
            _doubles("parameters", parameters, len(self.step.parameters)),
        )
        if self._library.hs_one(*(address(x) for x in (*inputs, following, outputs))):
            raise SolveError(f"{self.step.name}: an input or a result of the step is not a number")
        return following, outputs

    def march(
        self, samples: Samples, parameters: Array, state: Array | None = None, mode: Mode = "hybrid", history: bool = True,
        more: Array | None = None,
    ) -> March:  # fmt: skip
        """Run a whole cycle in one call, with the interpreter lock released.

        A step that requests more than `REQUESTED` takes a row of `more` each time.

        Raises
        ------
        SolveError
            If a state is not a number, or without `history` an output is not finite; with it, the totals tell.
        InputError
            If an array is of another length.

        """
        n, n_outputs, n_states = len(samples.t), len(self.step.outputs), len(self.step.states)
        samples = read_by_c(samples)
        parameters = _doubles("parameters", parameters, len(self.step.parameters))
        x = np.empty(n_states) if state is None else _doubles("state", state, n_states).copy()
        n_more = len(self.step.requests) - len(REQUESTED)
        more = _doubles("more", np.ravel([] if more is None else more), n * n_more) if n_more else None
        rows = np.empty((n, n_outputs)) if history else None
        last, sums, highest = np.empty((3, n_outputs))
        counts = (ctypes.c_long * 2)()
        distance, grade = samples.grade_by_distance or (None, None)
        done = self._library.hs_march(
            n, *map(address, (samples.dt, samples.v, samples.grade, samples.key_on, more)),
            0 if distance is None else len(distance), *map(address, (distance, grade, parameters)),
            state is not None, *map(address, (x, rows, last, sums, highest)), MODES.index(mode), counts,
        )  # fmt: skip
        if done < n:
            raise _lost(self.step.name, samples, done, self.step.output_index, None if history else sums)

        def total() -> tuple[Array, Array, Array]:
            if rows is not None:
                self._library.hs_total(n, *map(address, (samples.dt, rows, sums, highest)))
                if not np.isfinite(sums).all():
                    raise _not_finite(self.step.name, self.step.output_index, samples, rows, sums)
                last[:] = rows[-1] if n else 0.0
            return last, sums, highest

        return March(rows, total, x, *counts)


class InterpretedStep:
    """A step on CasADi's virtual machine: needs no compiler."""

    def __init__(self, step: Step) -> None:
        self.step = step

    def first(self, parameters: Array) -> Array:
        """Return the start state."""
        return np.array(self.step.start(parameters), dtype=float).ravel()

    def __call__(self, state: Array, request: Array, parameters: Array) -> tuple[Array, Array]:
        """Return next state and outputs of one step."""
        following, outputs = (np.array(r, dtype=float).ravel() for r in self._run(state, request, parameters))
        if not all(np.all(np.isfinite(a)) for a in (following, state, request, parameters)):
            raise SolveError(f"{self.step.name}: an input or a result of the step is not a number")
        return following, outputs

    @cached_property
    def _run(self) -> Callable[..., tuple[ca.DM, ca.DM]]:
        return self.step.function  # type: ignore[return-value]

    def march(self, samples: Samples, parameters: Array, state: Array | None = None, mode: Mode = "hybrid", history: bool = True) -> March:
        """Run a whole cycle; only the plain hybrid mode."""
        if mode != "hybrid":
            raise CompileError(f"the {mode} mode needs a C compiler")
        samples = read_by_c(samples)
        parameters = _doubles("parameters", parameters, len(self.step.parameters))
        x = self.first(parameters) if state is None else _doubles("state", state, len(self.step.states))
        distance = self.step.state_index[self.step.tags.the("distance")]
        rows = np.empty((len(samples.t), len(self.step.outputs)))
        for k, (v, grade, key_on, dt) in enumerate(zip(samples.v, samples.grade, samples.key_on, samples.dt, strict=True)):
            if samples.grade_by_distance:
                grade = np.interp(x[distance], *samples.grade_by_distance)
            try:
                x, rows[k] = self(x, np.array([v, grade, key_on, dt, 0.0]), parameters)
            except SolveError:
                raise _lost(self.step.name, samples, k) from None

        def total() -> tuple[Array, Array, Array]:
            last = rows[-1] if len(rows) else np.zeros(rows.shape[1])
            return last, integrals(self.step.name, self.step.output_index, samples, rows), np.max(rows, axis=0, initial=-np.inf)

        return March(rows, total, x, len(rows))
