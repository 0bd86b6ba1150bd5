"""Runs a vehicle over a cycle: by the step, by an FMU through FMPy, or forward-facing."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, replace
from functools import lru_cache
from typing import TYPE_CHECKING, get_args

import numpy as np

from halfshaft import __version__
from halfshaft.cosim.audit import Audit, Auditor
from halfshaft.cosim.compiled import MODES, Array, InterpretedStep, Mode, Stepper, integrals, stepper
from halfshaft.cosim.cycle import Cycle, Samples
from halfshaft.cosim.memory import check_memory
from halfshaft.cosim.origin import Hashes, Made
from halfshaft.cosim.result import Inputs, Result
from halfshaft.cosim.ways import Via as Via
from halfshaft.library.base.errors import InputError, nearest, not_a, number
from halfshaft.library.base.parameters import Parameters, spec_of
from halfshaft.library.base.tags import Tags
from halfshaft.models.assembly import Description, Step
from halfshaft.models.vehicle import Vehicle

if TYPE_CHECKING:
    from halfshaft.cosim.forward import Forward


class Build:
    """A vehicle in the eyes of the compiler: equal when parts and tables are, whatever the numbers."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.vehicle = vehicle
        self._key = vehicle.structure

    def __hash__(self) -> int:
        """Return the hash of what is built in."""
        return hash(self._key)

    def __eq__(self, other: object) -> bool:
        """Return whether the same code serves both."""
        return isinstance(other, Build) and self._key == other._key


@lru_cache(maxsize=64)
def _stepper(build: Build) -> Stepper:
    return stepper(build.vehicle.model(), build.vehicle.title)


@lru_cache(maxsize=64)
def _auditor(build: Build) -> Auditor:
    return Auditor(build.vehicle.model(), _stepper(build).step)


def audit_of(vehicle: Vehicle, samples: Samples, rows: Array) -> Audit:
    """Return the audit of a run of the vehicle's step."""
    build = Build(vehicle)
    stepper = _stepper(build)
    parameters = parameters_of(vehicle, stepper.step, samples.v_start)
    return _auditor(build)(samples, rows, stepper.first(parameters), parameters)


@lru_cache(maxsize=8)
def _forward(build: Build) -> Forward:
    # Only here, because a run of the step needs nothing of it.
    from halfshaft.cosim.forward import Forward

    return Forward(build.vehicle.model(), build.vehicle.title)


def stepper_of(vehicle: Vehicle) -> Stepper:
    """Return the vehicle's step, compiled once for all vehicles of the same parts."""
    return _stepper(Build(vehicle))


def parameters_of(vehicle: Vehicle, step: Step, v_start: float = 0.0) -> Array:
    """Return the parameter vector of a step; the vehicle starts at the speed of its trace."""
    values = {**vehicle.values, step.tags.the("start speed"): v_start}
    return np.array([values[d.name] for d in step.parameters])


def run(
    vehicle: Vehicle,
    cycle: Cycle,
    *,
    via: Via = "step",
    dt: float = 1.0,
    mode: Mode = "hybrid",
    history: bool = True,
    gradient: Sequence[str] = (),
) -> Result:
    """Run a vehicle over a cycle.

    Parameters
    ----------
    vehicle, cycle
        What runs where.
    via
        ``step`` the compiled step, ``fmu2`` and ``fmu3`` an FMU of it through FMPy, ``forward`` the forward-facing model.
    dt
        Length of the step [s]; the forward-facing model samples its controls at its own, shorter time.
    mode
        ``hybrid`` the paper's method, ``refined`` solves for the best end speed where a limit acts, ``iteration`` is
        the paper's benchmark.
    history
        Whether to keep all outputs of all steps, or only the summary.
    gradient
        Numbers of the vehicle, by ``role.parameter``, by which the main figures are derived; see `halfshaft.cosim.gradient`.

    Raises
    ------
    InputError
        If an argument is not what it must be, the mode does not go with the way of running, or the run does not fit
        into the memory.
    SolveError
        If an output is not finite in some step.

    """
    dt = _checked(vehicle, cycle, via, dt, mode, gradient)
    made = Made(vehicle, cycle, time.time())
    what = (vehicle.name, vehicle.powertrain, cycle.name)
    inputs = Inputs(*what, via, mode, dt, __version__, dict(vehicle.values), hashes=Hashes(made), tags=vehicle.tags)
    if via == "forward":
        return _run_forward(vehicle, cycle, inputs, made)
    if via in ("fmu2", "fmu3"):
        from halfshaft.cosim.by_fmu import march_fmu

        step = stepper_of(vehicle).step
        samples = _sampled(cycle, dt, len(step.outputs))
        parameters = parameters_of(vehicle, step, samples.v_start)
        rows = march_fmu(step, samples, parameters, dt, 2 if via == "fmu2" else 3)
        first = _first(stepper_of(vehicle), parameters, cycle)
        return _result(inputs, step.outputs, samples, rows, _integrals(step, rows, samples), made, first)
    compiled = stepper_of(vehicle)
    if isinstance(compiled, InterpretedStep):
        inputs = replace(inputs, compiled=False)
    samples = _sampled(cycle, dt, len(compiled.step.outputs), history)
    parameters = parameters_of(vehicle, compiled.step, samples.v_start)
    march = compiled.march(samples, parameters, mode=mode, history=history)
    names, first = [d.name for d in compiled.step.outputs], _first(compiled, parameters, cycle)
    energies = dict(zip(names, march.sums.tolist(), strict=True))
    highest = dict(zip(names, march.highest.tolist(), strict=True))
    last = dict(zip(names, march.last.tolist(), strict=True)) | ({} if len(samples.t) else first)
    rows = np.empty((0, len(names))) if march.history is None else march.history
    notes = (*made.notes, *_beyond_maps(vehicle, compiled.step.tags, first, highest, last))
    if march.unsolved:
        notes += (f"{march.unsolved} steps reach no speed at all: they are those of the hybrid mode",)
    slopes = {}
    if gradient:
        from halfshaft.cosim.gradient import figure_gradient  # which runs vehicles too

        slopes = figure_gradient(vehicle, cycle, gradient, mode=mode, dt=dt)
    return Result(inputs, samples.t, compiled.step.outputs, rows, energies, highest, first, last, made, notes, slopes)


def recorded(
    vehicle: Vehicle, cycle: Cycle, stepper: Stepper, samples: Samples, rows: Array, dt: float, notes: tuple[str, ...] = ()
) -> Result:
    """Return a run of a vehicle's step, or of one with the same outputs, of which the rows were made elsewhere."""
    made = Made(vehicle, cycle, time.time())
    what = (vehicle.name, vehicle.powertrain, cycle.name)
    inputs = Inputs(*what, "step", "hybrid", dt, __version__, dict(vehicle.values), hashes=Hashes(made), tags=vehicle.tags)
    first = _first(stepper, parameters_of(vehicle, stepper.step, samples.v_start), cycle)
    result = _result(inputs, stepper.step.outputs, samples, rows, _integrals(stepper.step, rows, samples), made, first)
    return replace(result, notes=(*notes, *result.notes))


def _beyond_maps(
    vehicle: Vehicle, tags: Tags, first: Mapping[str, float], highest: Mapping[str, float], last: Mapping[str, float]
) -> Iterator[str]:
    """Yield which parts were colder or warmer than their maps, where those depend on the temperature."""
    for part, name in tags.by_part("temperature").items():
        if not highest[name] > 0:
            continue  # There was no step.
        axes, began = _temperatures(vehicle.parameters[part]), first.get(name, last[name])
        coldest, warmest = min(began, last[name]), max(began, highest[name])
        found = [("cold", coldest, x[0]) for x in axes if coldest < x[0]] + [("warm", warmest, x[-1]) for x in axes if warmest > x[-1]]
        said = f"{part.replace('_', ' ')} as {{}} as {{:.1f}} degC, but maps of it are read at {{:g}} degC, their end"
        yield from dict.fromkeys(said.format(how, T - 273.15, end - 273.15) for how, T, end in found)


# A loop over runs asks for the same part again and again.
@lru_cache(maxsize=64)
def _temperatures(p: Parameters) -> tuple[Array, ...]:
    """Return the temperatures of a part's maps, of those that depend on them."""
    maps = [(getattr(p, f.name), i) for f in fields(p) for i, axis in enumerate(spec_of(f).axes) if axis.unit == "K"]
    return tuple(t.points[i] for t, i in maps if np.any(np.diff(t.values, axis=i)))


def _checked(vehicle: Vehicle, cycle: Cycle, via: str, dt: float, mode: str, gradient: Sequence[str]) -> float:
    """Return the length of the step as a number, or raise an error with all that is wrong with the arguments of a run."""
    problems = not_a(Vehicle, vehicle=vehicle) + not_a(Cycle, cycle=cycle)
    for name, value, known in (("via", via, get_args(Via)), ("mode", mode, MODES)):
        if not (isinstance(value, str) and value in known):
            problems.append(f"{name} = {value!r}, must be one of {', '.join(known)}{nearest(str(value), known)}")
    seconds = number(dt)
    if not 0 < seconds < np.inf:
        problems.append(f"dt = {dt} s, must be a number > 0 s")
    if not problems and mode != "hybrid" and via != "step":
        problems.append(f"mode {mode} runs via step only, not via {via}")
    if gradient and via != "step":
        problems.append(f"a gradient is found via step only, not via {via}")
    if problems:
        raise InputError("run", problems)
    return seconds


def _sampled(cycle: Cycle, dt: float, n_outputs: int, history: bool = True) -> Samples:
    check_memory(cycle.duration / dt, n_outputs, history)
    return cycle.sampled(dt)


def _first(stepper: Stepper, parameters: Array, cycle: Cycle) -> dict[str, float]:
    """Return the time at the start, speed, charges and temperatures."""
    start, places, tags = stepper.first(parameters).tolist(), stepper.step.state_index, stepper.step.tags
    told = [name for tag in ("speed", "charge", "temperature") for name in tags.all_of(tag) if name in places]
    return {"time": float(cycle.time[0]), **{name: start[places[name]] for name in told}}


def _integrals(step: Step, rows: Array, samples: Samples) -> dict[str, float]:
    names = [d.name for d in step.outputs]
    return dict(zip(names, integrals(step.name, names, samples, rows).tolist(), strict=True))


def _result(
    inputs: Inputs,
    outputs: tuple[Description, ...],
    samples: Samples,
    rows: Array,
    energies: Mapping[str, float],
    made: Made,
    first: Mapping[str, float],
) -> Result:
    names = [d.name for d in outputs]
    highest = dict(zip(names, rows.max(axis=0).tolist(), strict=True)) if len(rows) else dict.fromkeys(names, 0.0)
    last = dict(zip(names, rows[-1].tolist(), strict=True)) if len(rows) else dict.fromkeys(names, 0.0) | dict(first)
    notes = (*made.notes, *_beyond_maps(made.vehicle, Tags.of(outputs), first, highest, last))
    return Result(inputs, samples.t, outputs, rows, energies, highest, first, last, made, notes)


def _run_forward(
    vehicle: Vehicle,
    cycle: Cycle,
    inputs: Inputs,
    made: Made,
) -> Result:
    forward = _forward(Build(vehicle))
    samples = _sampled(cycle, forward.driver.dt, len(forward.plant.shown))
    parameters = parameters_of(vehicle, forward.stepper.step, samples.v_start)
    done = forward.run(samples, parameters)
    step = forward.stepper.step
    beside = (step.outputs[step.output_index[step.tags.the(tag)]] for tag in ("request", "miss", "overspeed"))
    outputs = (*forward.plant.shown, *beside)
    v = done.history[:, [d.name for d in forward.plant.shown].index(step.tags.the("speed"))]
    rows = np.column_stack([done.history, samples.v, samples.v - v, v - samples.v])
    # Powers are integrated by IDAS; of all else the sum over the samples must do.
    names = [d.name for d in outputs]
    energies = dict(zip(names, integrals(forward.plant.name, names, samples, rows).tolist(), strict=True)) | done.energies
    return _result(inputs, outputs, samples, rows, energies, made, _first(forward.stepper, parameters, cycle))
