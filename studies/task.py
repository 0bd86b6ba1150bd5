"""What a study asks of a vehicle.

A *task* is called with a vehicle and returns an *outcome*: figures by name, in SI or in the unit that the name ends with, as in
`Result.figures`, and what a user should know about them.  A cycle run is a task; so is each test and each procedure of this
package, and a study (a sweep, a sizing) works with any of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from halfshaft.cosim.simulate import run
from halfshaft.cosim.ways import Mode

if TYPE_CHECKING:
    from halfshaft.cosim.cycle import Cycle
    from halfshaft.models.vehicle import Vehicle


class Outcome(Protocol):
    """What a task found."""

    @property
    def figures(self) -> Mapping[str, float | None]:
        """The numbers found, by name; None is what the vehicle does not have or never reached."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What a user should know about them."""


class Task(Protocol):
    """Something to do with a vehicle; a frozen dataclass, so that two of the same options are equal."""

    @property
    def name(self) -> str:
        """A word for it, which the figures of several tasks are told apart by."""

    def __call__(self, vehicle: Vehicle) -> Outcome:
        """Do it."""


@dataclass(frozen=True)
class Found:
    """A plain outcome."""

    figures: Mapping[str, float | None]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Drive:
    """The task to drive a cycle once, without any correction."""

    cycle: Cycle
    mode: Mode = "hybrid"
    dt: float = 1.0

    @property
    def name(self) -> str:
        """The cycle's name."""
        return self.cycle.name

    def __call__(self, vehicle: Vehicle) -> Found:
        """Return the numbers of the run's summary."""
        result = run(vehicle, self.cycle, mode=self.mode, dt=self.dt, history=False)
        return Found({k: x for k, x in result.figures.items() if not isinstance(x, str)}, result.warnings)
