"""Every powertrain by the step and by the forward-facing model, side by side.

``python -m halfshaft.validation.powertrains`` prints the table of the manual's page on the forward-facing model, for one vehicle of
each powertrain unless some are named; ``halfshaft reproduce`` makes it too.  It takes some minutes.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

from halfshaft.cosim.cycle import Cycle
from halfshaft.cosim.forward import Driver
from halfshaft.cosim.simulate import Via, run
from halfshaft.library.base.errors import SolveError
from halfshaft.models.powertrain import powertrains
from halfshaft.models.vehicle import Vehicle, vehicle_names
from halfshaft.studies.acceleration import accelerate

CYCLES = ("udds", "hwfet", "us06")
TASKS = (*CYCLES, "0-100 km/h")
#: Fuel and electric energy together [kWh] below which a difference in per cent says nothing.
NOTHING = 1e-3


_NONE = (None, None)


class Row(NamedTuple):
    """One task of one vehicle: what was used and how the charge ends, by the step and by the forward-facing model.

    ``fuel`` [L], ``battery`` [kWh], ``charge`` at the end [1], ``time`` to 100 km/h [s]; pairs, None where there is no such thing, or
    the forward-facing model did not finish.
    """

    vehicle: str
    task: str
    fuel: tuple[float | None, float | None]
    battery: tuple[float | None, float | None]
    charge: tuple[float | None, float | None]
    time: tuple[float | None, float | None]
    #: All energy that was used, the fuel's heating value included, or the time: forward over step less 1.
    apart: float | None
    #: The same against the step at the driver's 0.1 s and with his times of shifts; of a time, against the hybrid mode.
    alike: float | None


def first_of_each() -> list[str]:
    """Return one small car of each powertrain, the one with the shortest name."""
    found: dict[str, str] = {}
    for name in sorted((n for n in vehicle_names() if n.startswith("small-car")), key=lambda n: (len(n), n)):
        found.setdefault(Vehicle.load(name).powertrain, name)
    return [found[name] for name in powertrains() if name in found]


def as_driven(vehicle: Vehicle) -> Vehicle:
    """Return the vehicle with the times of shifts of the forward-facing model's driver, where it has any."""
    driver, tags = Driver(), vehicle.tags
    least = {name: driver.t_shift for name in tags.all_of("shift time")} | {name: driver.t_hold for name in tags.all_of("hold time")}
    return vehicle.with_values({name: max(vehicle.values[name], x) for name, x in least.items()})


def compared(vehicle: Vehicle, task: str) -> Row:
    """Run a task both ways."""
    ways: tuple[Via, Via] = ("step", "forward")
    if task not in CYCLES:
        times = tuple(accelerate(vehicle, mode="refined" if via == "step" else "hybrid", via=via, duration=60.0).time for via in ways)
        plain = accelerate(vehicle, mode="hybrid", duration=60.0).time
        return Row(vehicle.name, task, _NONE, _NONE, _NONE, times, _ratio(*times), _ratio(plain, times[1]))  # type: ignore[arg-type]
    runs = [run(vehicle, Cycle.load(task), via=via) for via in ways]
    stored = any(d.booking == "stored" for d in runs[0].outputs)
    fuel = tuple(r.summary["fuel_L"] for r in runs)
    battery = tuple(r.account.battery / 3.6e6 if stored else None for r in runs)
    charge = tuple(r.summary["soc_end"] for r in runs)
    fine = run(as_driven(vehicle), Cycle.load(task), dt=Driver().dt, mode="refined")
    step, forward, alike = ((r.account.fuel + r.account.battery) / 3.6e6 for r in (*runs, fine))
    return Row(vehicle.name, task, fuel, battery, charge, _NONE, _ratio(step, forward), _ratio(alike, forward))  # type: ignore[arg-type]


def _ratio(step: float | None, forward: float | None) -> float | None:
    return None if step is None or forward is None or abs(step) < NOTHING else forward / step - 1


def comparison(names: Iterable[str] = (), progress: Callable[[str], None] | None = None) -> Iterator[Row]:
    """Yield the rows, as they are made; a task that the forward-facing model does not finish has none of its numbers."""
    for name in names or first_of_each():
        vehicle = Vehicle.load(name)
        for task in TASKS:
            if progress:
                progress(f"{name}, {task}")
            try:
                yield compared(vehicle, task)
            except SolveError:
                yield Row(name, task, _NONE, _NONE, _NONE, _NONE, None, None)


#: Heads of what `cells` returns.
HEAD = ("fuel [L]: step, forward", "battery [kWh]", "charge at the end", "0-100 km/h [s]", "forward less step", "at 0.1 s")


def cells(row: Row) -> list[str]:
    """Return the texts of a row."""
    pairs = ((row.fuel, 4), (row.battery, 4), (row.charge, 4), (row.time, 3))
    shown = [", ".join("-" if x is None else f"{x:.{n}f}" for x in pair) if any(x is not None for x in pair) else "" for pair, n in pairs]
    return [*shown, *("-" if x is None else f"{x:+.2%}".replace("%", " %") for x in (row.apart, row.alike))]


def table(rows: Iterable[Row]) -> Iterator[str]:
    """Yield the lines of a table in Markdown, as the rows come."""
    yield f"| vehicle | | {' | '.join(HEAD)} |"
    yield "|---" * (2 + len(HEAD)) + "|"
    for row in rows:
        yield f"| `{row.vehicle}` | {row.task} | {' | '.join(cells(row))} |"


if __name__ == "__main__":
    for line in table(comparison(sys.argv[1:])):
        sys.stdout.write(line + "\n")
        sys.stdout.flush()
