"""How results go over into those of the forward-facing model as the step shrinks.

``python -m halfshaft.validation.convergence`` prints the tables of the manual's page on the method, all vehicles of the
library unless some are named; the columns of IDAS take minutes, ``--without-idas`` leaves them out.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from contextlib import suppress
from typing import NamedTuple

from halfshaft.cosim.compiled import Mode
from halfshaft.cosim.cycle import Cycle, acceleration_cycle
from halfshaft.cosim.result import Result
from halfshaft.cosim.simulate import Via, run
from halfshaft.library.base.errors import SolveError
from halfshaft.models.vehicle import Vehicle, vehicle_names
from halfshaft.studies.acceleration import T_START, prepared, time_to

#: Lengths of the step [s].
STEPS = (1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01)
MODES: tuple[Mode, ...] = ("hybrid", "refined")
TASKS = ("udds", "us06", "0-100 km/h")


class Row(NamedTuple):
    """One quantity of one vehicle at every length of the step, and by IDAS."""

    vehicle: str
    task: str
    mode: Mode
    unit: str
    #: At each length of the step; None where it failed.
    values: tuple[float | None, ...]
    #: By IDAS; None where it did not finish, or was not asked.
    forward: float | None

    @property
    def digits(self) -> int:
        """Digits behind the point that are worth to be seen."""
        return 3 if self.unit == "s" else 4


def measured(vehicle: Vehicle, task: str, *, dt: float = 0.1, mode: Mode = "hybrid", via: Via = "step") -> tuple[float | None, str]:
    """Return the time to 100 km/h, the fuel, or the energy that the motors take where there are any, and its unit."""
    if task in ("udds", "us06"):
        result: Result = run(vehicle, Cycle.load(task), dt=dt, mode=mode, via=via)
        driven = result.summary["motor_input_J"]
        return (result.summary["fuel_L"], "L") if driven is None else (driven / 3.6e6, "kWh")
    # The request moves from the first step on, whatever its length.
    cycle = acceleration_cycle(t_start=T_START, duration=50.0)
    return time_to(run(prepared(vehicle), cycle, dt=dt, mode=mode, via=via), 100 / 3.6), "s"


def convergence(names: Iterable[str], *, tasks: Iterable[str] = TASKS, forward: bool = True) -> Iterator[Row]:
    """Yield the rows of the table, as they are made."""
    for name in names:
        vehicle = Vehicle.load(name)
        for task in tasks:
            unit, exact = "", None
            if forward:
                with suppress(SolveError):
                    exact, unit = measured(vehicle, task, via="forward")
            for mode in MODES:
                values = []
                for dt in STEPS:
                    value, unit = measured(vehicle, task, dt=dt, mode=mode)
                    values.append(value)
                yield Row(name, task, mode, unit, tuple(values), exact)


def table(rows: Iterable[Row]) -> Iterator[str]:
    """Yield the lines of a table in Markdown, as the rows come."""
    yield f"| vehicle | | mode | {' | '.join(f'{dt:g} s' for dt in STEPS)} | IDAS |"
    yield "|---|---|---|" + "---|" * (len(STEPS) + 1)
    for row in rows:
        shown = ["-" if x is None else f"{x:.{row.digits}f}" for x in (*row.values, row.forward)]
        yield f"| `{row.vehicle}` | {row.task} [{row.unit}] | {row.mode} | {' | '.join(shown)} |"


if __name__ == "__main__":
    named = [name for name in sys.argv[1:] if not name.startswith("--")]
    for line in table(convergence(named or vehicle_names(), forward="--without-idas" not in sys.argv)):
        sys.stdout.write(line + "\n")
        sys.stdout.flush()
