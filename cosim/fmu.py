"""A vehicle as an FMU: driven from outside, or with a cycle inside."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from halfshaft.cosim.cycle import Cycle, Samples, cycle_names
from halfshaft.fmu_build import package
from halfshaft.fmu_build.code import step_code
from halfshaft.fmu_build.variables import SHORTEST_STEP, CycleTable, Version
from halfshaft.library.base.errors import InputError, not_a, number
from halfshaft.models.assembly import Step, assemble
from halfshaft.models.vehicle import Vehicle


def build_fmu(vehicle: Vehicle, path: str | Path, *, fmi: Version, cycle: Cycle | None = None, dt: float = 1.0) -> Path:
    """Write a vehicle as a co-simulation FMU and return its path.

    Parameters
    ----------
    vehicle
        Its numbers are the start values of the FMU's parameters.
    path
        The file to write; it appears complete or not at all.
    fmi
        Version of the standard, 2 or 3.
    cycle
        The cycle to put inside.  Without one, requested speed, grade and key are inputs of the FMU.
    dt
        Length of the internal steps [s].

    Raises
    ------
    InputError
        If the input is not usable or the file cannot be written.
    CompileError
        If there is no C compiler.

    """
    wrong = not_a(Vehicle, vehicle=vehicle) + ([] if cycle is None else not_a(Cycle, cycle=cycle))
    if wrong:
        raise InputError("FMU", wrong)
    problems = fmu_problems(fmi, cycle, dt)
    if problems:
        raise InputError(f"FMU of '{vehicle.name}'", problems)
    table = None if cycle is None else _cycle_table(cycle.name, cycle.sampled(dt))
    step = assemble(vehicle.model(), vehicle.title)
    stop_time = default_stop_time() if cycle is None else None
    return package.build_fmu(step, step_code(step), path, fmi=fmi, step_size=dt, cycle=table, name=vehicle.name, stop_time=stop_time)


@cache
def default_stop_time() -> float:
    """Return how long a tool simulates a driven FMU unless told: as long as the longest cycle of the library [s]."""
    return max(Cycle.load(name).duration for name in cycle_names())


def build_driven(step: Step, path: Path, *, fmi: Version, dt: float) -> Path:
    """Write an assembled step as a driven FMU and return its path."""
    return package.build_fmu(step, step_code(step), path, fmi=fmi, step_size=dt)


def fmu_problems(fmi: int, cycle: Cycle | None, dt: float) -> list[str]:
    """Return why no FMU can be made, as far as that shows without making it."""
    problems = [] if fmi in (2, 3) else [f"fmi = {fmi}, must be 2 or 3"]
    dt = number(dt)
    if not SHORTEST_STEP <= dt < float("inf"):
        return [*problems, f"dt = {dt:g} s, must be >= {SHORTEST_STEP:g} s"]
    if cycle is None:
        return problems
    return problems + ([uneven] if (uneven := uneven_grid(cycle.sampled(dt), dt)) else [])


def uneven_grid(samples: Samples, dt: float) -> str:
    """Return what is wrong with samples that are not on a grid of constant length; empty if nothing is."""
    if not len(samples.dt):
        return "the cycle has no length"
    if samples.dt[-1] != dt:
        return f"dt = {dt:g} s leaves a last step of {samples.dt[-1]:g} s; the steps of an FMU are of one length"
    return ""


def _cycle_table(name: str, samples: Samples) -> CycleTable:
    return CycleTable(name, samples.v, samples.grade, samples.key_on, samples.grade_by_distance, samples.v_start)
