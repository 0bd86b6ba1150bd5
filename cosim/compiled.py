"""The step as machine code, driven over a whole cycle by a C loop.

The generated C (`halfshaft.fmu_build.code`) and the loop in ``march.c`` make one shared library, compiled once and kept
in the user's cache.  `ctypes` releases the interpreter lock during a call, so threads scale.  Without a compiler the
same step runs on CasADi's virtual machine, some 400 times slower, with one warning.
"""

from __future__ import annotations

import ctypes
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from typing import Protocol, TypeAlias

import casadi as ca
import numpy as np
import numpy.typing as npt

from halfshaft.cosim.cycle import Samples
from halfshaft.cosim.ways import MODES as MODES
from halfshaft.cosim.ways import Mode as Mode
from halfshaft.fmu_build.code import compiled_tables, step_code
from halfshaft.fmu_build.compiler import SlowWarning, shared_library
from halfshaft.library.errors import CompileError, SolveError
from halfshaft.library.tables import interpolants
from halfshaft.models.assembly import Step, assemble
from halfshaft.models.model import Model

Array: TypeAlias = npt.NDArray[np.float64]


@dataclass(frozen=True)
class March:
    """What a march over a cycle leaves: outputs of shape ``(n, n_outputs)``, or only their totals; the last state."""

    history: Array | None
    totals: tuple[Array, Array] | None
    dt: Array
    state: Array
    evaluations: int

    @cached_property
    def sums(self) -> Array:
        """Time integral of each output."""
        if self.totals is not None:
            return self.totals[0]
        assert self.history is not None
        return np.asarray(self.dt @ self.history)

    @cached_property
    def highest(self) -> Array:
        """Maximum of each output; minus infinity if there was no step."""
        if self.totals is not None:
            return self.totals[1]
        assert self.history is not None
        return np.asarray(np.max(self.history, axis=0, initial=-np.inf))


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
    try:
        return CompiledStep(assemble(model, title, compiled_tables))
    except CompileError as error:
        warnings.warn(f"running without compiled code, some 400 times slower: {error}", SlowWarning, stacklevel=3)
        return InterpretedStep(assemble(model, title, interpolants))


def _address(array: Array | None) -> int | None:
    # Half the time of ``array.ctypes.data``; a dozen of them count beside a cycle.
    return None if array is None else int(array.__array_interface__["data"][0])


_LONG, _PLACE = ctypes.c_long, ctypes.c_void_p
#: Argument types of the functions in ``march.c``.
_ARGUMENTS = {
    "hs_march": (_LONG, *(_PLACE,) * 4, _LONG, *(_PLACE,) * 3, ctypes.c_int, *(_PLACE,) * 4, ctypes.c_int, _PLACE),
    "hs_one": (_PLACE,) * 5,
    "hs_first": (_PLACE,) * 2,
}


def _lost(step: Step, samples: Samples, k: int) -> SolveError:
    return SolveError(f"{step.name}: by t = {samples.t[k]:g} s a result is not a number; check the inputs")


class CompiledStep:
    """A step in a shared library of its own."""

    def __init__(self, step: Step) -> None:
        self.step = step
        positions = {
            "HS_X_V": step.state_index["body.v"],
            "HS_X_DISTANCE": step.state_index["body.distance"],
            "HS_X_MISSED": step.state_index["body.trace_missed"],
            "HS_P_MISS": step.parameter_index["body.v_miss"],
            "HS_Y_REQUEST": step.output_index["body.v_request"],
            "HS_Y_MISS": step.output_index["body.trace_miss"],
        }
        defines = "".join(f"#define {name} {i}\n" for name, i in positions.items())
        decisions = [*step.decisions, -1]
        defines += f"static const int hs_decisions[] = {{{', '.join(map(str, decisions))}}};\n"
        loop = files("halfshaft.cosim").joinpath("march.c").read_text()
        self._library = ctypes.CDLL(str(shared_library(step_code(step) + defines + loop, step.name)))
        for name, types in _ARGUMENTS.items():
            getattr(self._library, name).argtypes = types
        self._library.hs_march.restype = ctypes.c_long

    def first(self, parameters: Array) -> Array:
        """Return the start state."""
        state = np.empty(len(self.step.states))
        self._library.hs_first(_address(np.ascontiguousarray(parameters, dtype=float)), _address(state))
        return state

    def __call__(self, state: Array, request: Array, parameters: Array) -> tuple[Array, Array]:
        """Return next state and outputs of one step.

        Raises
        ------
        SolveError
            If an input or a result is not a number.

        """
        following, outputs = np.empty(len(self.step.states)), np.empty(len(self.step.outputs))
        inputs = [np.ascontiguousarray(x, dtype=float) for x in (state, request, parameters)]
        if self._library.hs_one(*(_address(x) for x in (*inputs, following, outputs))):
            raise SolveError(f"{self.step.name}: an input or a result of the step is not a number")
        return following, outputs

    def march(self, samples: Samples, parameters: Array, state: Array | None = None, mode: Mode = "hybrid", history: bool = True) -> March:
        """Run a whole cycle in one call, with the interpreter lock released.

        Raises
        ------
        SolveError
            If a result is not a number.

        """
        n, n_outputs = len(samples.t), len(self.step.outputs)
        parameters = np.ascontiguousarray(parameters, dtype=float)
        x = np.empty(len(self.step.states)) if state is None else np.array(state, dtype=float)
        rows = np.empty((n, n_outputs)) if history else None
        sums, highest = (None, None) if history else (np.empty(n_outputs), np.empty(n_outputs))
        evaluations = ctypes.c_long()
        distance, grade = samples.grade_by_distance or (None, None)
        done = self._library.hs_march(
            n, *map(_address, (samples.dt, samples.v, samples.grade, samples.key_on)),
            0 if distance is None else len(distance), *map(_address, (distance, grade, parameters)),
            state is not None, *map(_address, (x, rows, sums, highest)), MODES.index(mode), ctypes.byref(evaluations),
        )  # fmt: skip
        if done < n:
            raise _lost(self.step, samples, done)
        return March(rows, None if sums is None or highest is None else (sums, highest), samples.dt, x, evaluations.value)


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
        x = self.first(parameters) if state is None else np.array(state, dtype=float)
        distance = self.step.state_index["body.distance"]
        rows = np.empty((len(samples.t), len(self.step.outputs)))
        for k, (v, grade, key_on, dt) in enumerate(zip(samples.v, samples.grade, samples.key_on, samples.dt, strict=True)):
            if samples.grade_by_distance:
                grade = np.interp(x[distance], *samples.grade_by_distance)
            try:
                x, rows[k] = self(x, np.array([v, grade, key_on, dt, 0.0]), parameters)
            except SolveError:
                raise _lost(self.step, samples, k) from None
        return March(rows, None, samples.dt, x, len(rows))
