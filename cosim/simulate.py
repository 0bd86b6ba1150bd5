"""Runs a vehicle over a cycle: by the step, by an FMU through FMPy, or forward-facing."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache

import numpy as np

from halfshaft import __version__
from halfshaft.cosim.audit import Audit, Auditor
from halfshaft.cosim.compiled import Array, InterpretedStep, Mode, Stepper, stepper
from halfshaft.cosim.cycle import Cycle, Samples
from halfshaft.cosim.forward import Driver, Forward
from halfshaft.cosim.origin import Hashes, Made
from halfshaft.cosim.result import Inputs, Result
from halfshaft.cosim.ways import Via as Via
from halfshaft.library.errors import InputError
from halfshaft.models.assembly import Description, Step
from halfshaft.models.powertrains import model_of, structure_of
from halfshaft.models.vehicle import Vehicle


class Build:
    """A vehicle in the eyes of the compiler: equal when parts and tables are, whatever the numbers."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.vehicle = vehicle
        self._key = structure_of(vehicle)

    def __hash__(self) -> int:
        """Return the hash of what is built in."""
        return hash(self._key)

    def __eq__(self, other: object) -> bool:
        """Return whether the same code serves both."""
        return isinstance(other, Build) and self._key == other._key


@lru_cache(maxsize=64)
def _stepper(build: Build) -> Stepper:
    return stepper(model_of(build.vehicle), build.vehicle.title)


@lru_cache(maxsize=64)
def _auditor(build: Build) -> Auditor:
    return Auditor(model_of(build.vehicle), _stepper(build).step)


def audit_of(vehicle: Vehicle, samples: Samples, rows: Array) -> Audit:
    """Return the audit of a run of the vehicle's step."""
    build = Build(vehicle)
    stepper = _stepper(build)
    parameters = parameters_of(vehicle, stepper.step, samples.v_start)
    return _auditor(build)(samples, rows, stepper.first(parameters), parameters)


@lru_cache(maxsize=8)
def _forward(build: Build) -> Forward:
    return Forward(model_of(build.vehicle), build.vehicle.title)


def stepper_of(vehicle: Vehicle) -> Stepper:
    """Return the vehicle's step, compiled once for all vehicles of the same parts."""
    return _stepper(Build(vehicle))


def parameters_of(vehicle: Vehicle, step: Step, v_start: float = 0.0) -> Array:
    """Return the parameter vector of a step; the vehicle starts at the speed of its trace."""
    values = {**vehicle.values, "body.v_start": v_start}
    return np.array([values[d.name] for d in step.parameters])


def run(vehicle: Vehicle, cycle: Cycle, *, via: Via = "step", dt: float = 1.0, mode: Mode = "hybrid", history: bool = True) -> Result:
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

    Raises
    ------
    InputError
        If `dt` is not positive, or the mode does not go with the way of running.

    """
    problems = []
    if not (np.isfinite(dt) and dt > 0):
        problems.append(f"dt = {dt} s, must be > 0 s")
    if mode != "hybrid" and via != "step":
        problems.append(f"mode {mode} runs via step only, not via {via}")
    if problems:
        raise InputError("run", problems)
    made = Made(vehicle, cycle, time.time())
    inputs = Inputs(
        vehicle.name, vehicle.powertrain, cycle.name, via, mode, dt, __version__, dict(vehicle.values), hashes=Hashes(made),
        notes=(*vehicle.notes, *cycle.doubts),
    )  # fmt: skip
    if via == "forward":
        return _run_forward(vehicle, cycle, inputs, made)
    if via in ("fmu2", "fmu3"):
        from halfshaft.cosim.by_fmu import march_fmu

        step, samples = stepper_of(vehicle).step, cycle.sampled(dt)
        parameters = parameters_of(vehicle, step, samples.v_start)
        rows = march_fmu(step, samples, parameters, dt, 2 if via == "fmu2" else 3)
        return _result(inputs, step.outputs, samples, rows, _integrals(step, rows, samples), _first(vehicle, cycle, samples), made)
    compiled = stepper_of(vehicle)
    if isinstance(compiled, InterpretedStep):
        inputs = replace(inputs, compiled=False)
    samples = cycle.sampled(dt)
    march = compiled.march(samples, parameters_of(vehicle, compiled.step, samples.v_start), mode=mode, history=history)
    names = [d.name for d in compiled.step.outputs]
    energies = dict(zip(names, march.sums.tolist(), strict=True))
    highest = dict(zip(names, march.highest.tolist(), strict=True))
    last = {d.name: float(march.state[d.state]) for d in compiled.step.outputs if d.state is not None}
    rows = np.empty((0, len(names))) if march.history is None else march.history
    return Result(inputs, samples.t, compiled.step.outputs, rows, energies, highest, _first(vehicle, cycle, samples), last, made)


def _first(vehicle: Vehicle, cycle: Cycle, samples: Samples) -> dict[str, float]:
    first = {"time": float(cycle.time[0]), "body.v": samples.v_start}
    if "battery.soc_start" in vehicle.values:
        first["battery.soc"] = vehicle.values["battery.soc_start"]
    return first


def _integrals(step: Step, rows: Array, samples: Samples) -> dict[str, float]:
    return dict(zip((d.name for d in step.outputs), (rows.T @ samples.dt).tolist(), strict=True))


def _result(
    inputs: Inputs,
    outputs: tuple[Description, ...],
    samples: Samples,
    rows: Array,
    energies: Mapping[str, float],
    first: Mapping[str, float],
    made: Made,
) -> Result:
    names = [d.name for d in outputs]
    highest = dict(zip(names, rows.max(axis=0).tolist(), strict=True)) if len(rows) else dict.fromkeys(names, 0.0)
    last = dict(zip(names, rows[-1].tolist(), strict=True)) if len(rows) else dict.fromkeys(names, 0.0) | dict(first)
    return Result(inputs, samples.t, outputs, rows, energies, highest, first, last, made)


def _run_forward(
    vehicle: Vehicle,
    cycle: Cycle,
    inputs: Inputs,
    made: Made,
    driver: Driver = Driver(),  # noqa: B008
) -> Result:
    forward = _forward(Build(vehicle))
    samples = cycle.sampled(driver.dt)
    parameters = parameters_of(vehicle, forward.stepper.step, samples.v_start)
    done = forward.run(samples, parameters)
    outputs = (
        *forward.plant.shown,
        Description("body.v_request", "m/s", "requested speed"),
        Description("body.trace_miss", "m/s", "request less achieved speed"),
    )
    v = done.history[:, [d.name for d in forward.plant.shown].index("body.v")]
    rows = np.column_stack([done.history, samples.v, samples.v - v])
    # Powers are integrated by IDAS; of all else the sum over the samples must do.
    energies = {d.name: float(e) for d, e in zip(outputs, rows.T @ samples.dt, strict=True)} | done.energies
    return _result(inputs, outputs, samples, rows, energies, _first(vehicle, cycle, samples), made)
