"""Runs a step as an FMU, through FMPy, as another tool would.

The driven form is built into a temporary folder.  Before each communication step the request is set to the speed at the
end of that step, so the trace is met at its own points, and grade and key to what holds during it; a grade over
distance is looked up at the distance that the FMU reports.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from contextlib import chdir, suppress
from pathlib import Path
from typing import Any

import numpy as np

from halfshaft.cosim.compiled import Array
from halfshaft.cosim.cycle import Grades, Samples
from halfshaft.cosim.fmu import build_driven, uneven_grid
from halfshaft.fmu_build.variables import Version
from halfshaft.library.base.errors import CompileError, InputError, SolveError
from halfshaft.models.assembly import Step


def march_fmu(step: Step, samples: Samples, parameters: Array, dt: float, fmi: Version) -> Array:
    """Return the outputs of every step, shape ``(n, n_outputs)``.

    Parameters
    ----------
    step
        What is built.
    samples
        The cycle, on a grid of `dt`.
    parameters
        Values in the order of the step's parameters, set before the initialization.
    dt
        Length of the internal and of the communication steps [s].
    fmi
        Version of the standard.

    Raises
    ------
    InputError
        If the last step is shorter than the others.
    CompileError
        If there is no C compiler, or nothing may be executed in the folder of temporary files.
    SolveError
        If the FMU reports an error.

    """
    rows = np.empty((len(samples.t), len(step.outputs)))
    if not len(rows):
        return rows
    if uneven := uneven_grid(samples, dt):
        raise InputError("run", [uneven])
    with tempfile.TemporaryDirectory(prefix="halfshaft-") as folder:
        path = build_driven(step, Path(folder, f"{step.name}.fmu"), fmi=fmi, dt=dt)
        slave = _Slave(path, Path(folder, "unpacked"), fmi)
        try:
            _march(slave, step, samples, parameters, dt, rows)
        finally:
            slave.free()
    return rows


def _march(slave: _Slave, step: Step, samples: Samples, parameters: Array, dt: float, rows: Array) -> None:
    slave.initialize([d.name for d in step.parameters], parameters)
    requests = slave.references([d.name for d in step.requests[:3]])
    outputs = slave.references([d.name for d in step.outputs])
    distance = step.output_index[step.tags.the("distance")]
    travelled = slave.get(outputs)[distance]
    for k in range(len(rows)):
        grade = samples.grade[k] if samples.grade_by_distance is None else _grade_at(travelled, samples.grade_by_distance)
        slave.step(k * dt, dt, requests, (samples.v[k], grade, samples.key_on[k]))
        rows[k] = slave.get(outputs)
        travelled = rows[k, distance]


def _grade_at(distance: float, grades: Grades) -> float:
    """Return the grade in the same arithmetic as the compiled loop, which np.interp does not have."""
    points, values = grades
    if distance <= points[0]:
        return float(values[0])
    if distance >= points[-1]:
        return float(values[-1])
    i = int(np.searchsorted(points, distance, side="right")) - 1
    return float(values[i] + (values[i + 1] - values[i]) * (distance - points[i]) / (points[i + 1] - points[i]))


class _Slave:
    """One instance of an FMU; an error of the FMU becomes a `SolveError` with what the FMU said."""

    def __init__(self, path: Path, folder: Path, fmi: Version) -> None:
        import fmpy  # takes half a second
        from fmpy.fmi1 import FMICallException
        from fmpy.simulation import instantiate_fmu

        self._error = FMICallException
        self._said: list[str] = []
        fmpy.extract(str(path), str(folder))
        description = fmpy.read_model_description(str(folder))
        self._references = {v.name: v.valueReference for v in description.modelVariables}
        self._name, self._fmi = path.name, fmi
        try:
            # Where a library cannot be loaded, FMPy stays in its folder, and has no error of its own.
            with chdir(Path.cwd()):
                self._fmu: Any = instantiate_fmu(str(folder), description, "CoSimulation", debug_logging=True, logger=self._heard)
        except Exception as error:
            cure = "files of the folder for temporary files must be executable, set TMPDIR to another"
            raise CompileError(f"{self._name} cannot be loaded: {error}; {cure}") from error
        self._set, self._get = (
            (self._fmu.setReal, self._fmu.getReal) if fmi == 2 else (self._fmu.setFloat64, self._fmu.getFloat64)
        )  # fmt: skip

    def _heard(self, *message: Any) -> None:
        self._said.append(message[-1].decode(errors="replace"))

    def references(self, names: Sequence[str]) -> list[int]:
        """Return the value references of variables."""
        return [self._references[name] for name in names]

    def initialize(self, names: Sequence[str], values: Array) -> None:
        """Set parameters and leave the initialization."""
        try:
            if self._fmi == 2:
                self._fmu.setupExperiment(startTime=0.0)
            self._set(self.references(names), values.tolist())
            self._fmu.enterInitializationMode()
            self._fmu.exitInitializationMode()
        except self._error as error:
            raise self._failed("its initialization", error) from error

    def step(self, t: float, dt: float, inputs: Sequence[int], values: Sequence[float]) -> None:
        """Set inputs and take one communication step."""
        try:
            self._set(inputs, values)
            self._fmu.doStep(t, dt)
        except self._error as error:
            raise self._failed(f"the step from t = {t:g} s", error) from error

    def get(self, references: Sequence[int]) -> list[float]:
        """Return values."""
        return list(self._get(references))

    def free(self) -> None:
        """Release the instance and its library."""
        with suppress(self._error):
            self._fmu.terminate()
        self._fmu.freeInstance()

    def _failed(self, when: str, error: Exception) -> SolveError:
        return SolveError(f"{self._name} failed in {when}: {'; '.join(self._said) or error}")
