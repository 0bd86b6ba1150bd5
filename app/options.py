"""Options that several commands have, and the check of all that was given before anything runs."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import typer

from halfshaft.cosim.units import Units
from halfshaft.cosim.ways import Mode
from halfshaft.library.base.errors import HalfshaftError
from halfshaft.library.files.writing import target_problem

if TYPE_CHECKING:
    # Each command imports what it runs: the help needs none of it.
    from halfshaft.cosim.cycle import Cycle
    from halfshaft.models.vehicle import Vehicle
    from halfshaft.studies.task import Task

T = TypeVar("T")

#: More steps than this do not fit into the memory of a small machine, all outputs kept.
MOST_STEPS = 2_000_000


def _vehicles(incomplete: str) -> list[str]:
    from halfshaft.models.vehicle import vehicle_names

    return [name for name in vehicle_names() if name.startswith(incomplete)]


def _cycles(incomplete: str) -> list[str]:
    from halfshaft.cosim.cycle import cycle_names

    return [name for name in cycle_names() if name.startswith(incomplete)]


VehicleName = Annotated[
    str, typer.Argument(metavar="VEHICLE", help="Name in the library, or a TOML file.", show_default=False, autocompletion=_vehicles)
]
CycleName = Annotated[
    str, typer.Option("--cycle", metavar="CYCLE", help="Name in the library, or a CSV file.", show_default=False, autocompletion=_cycles)
]
CycleNameOrNone = Annotated[
    str | None, typer.Option("--cycle", metavar="CYCLE", help="Name in the library, or a CSV file.", autocompletion=_cycles)
]
GradeFile = Annotated[
    str | None, typer.Option("--grade", metavar="G", help="Grade of the road: 3% or 0.03, or a CSV file over distance; with --cycle.")
]
VehicleNames = Annotated[
    list[str],
    typer.Argument(metavar="VEHICLE...", help="Names in the library, or TOML files.", show_default=False, autocompletion=_vehicles),
]
CycleNames = Annotated[
    list[str] | None,
    typer.Option("--cycle", metavar="CYCLE", help="Name in the library, or a CSV file; repeatable.", autocompletion=_cycles),
]
TestNames = Annotated[
    list[str] | None,
    typer.Option("--test", metavar="TEST", help="acceleration, gradeability, top-speed, a procedure or its TOML file; repeatable."),
]
Correction = Annotated[
    Literal["zero-delta", "linear"] | None,
    typer.Option("--correction", help="Drive the cycles so that a hybrid keeps its charge."),
]
Smooth = Annotated[float | None, typer.Option(metavar="S", help="Smooth the trace of a recorder over windows of so many seconds.")]
Mass = Annotated[float | None, typer.Option(metavar="KG", help="Mass of the vehicle, body.m.")]
Values = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help='A number with unit, motor.J="0.05 kg m^2", or in SI; repeatable.'),
]
Gradient = Annotated[
    list[str] | None, typer.Option(metavar="NAME", help="A number to derive the figures by, such as body.c_d; repeatable.")
]
Soc = Annotated[float | None, typer.Option(metavar="X", help="State of charge at the start, 0 to 1.")]
Shown = Annotated[Units, typer.Option("--units", help="What to show: km and L/100 km, or miles, mph and mpg.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]


class Checks:
    """Collects what is wrong with the input, so that one message names it all."""

    def __init__(self) -> None:
        self._errors: list[HalfshaftError] = []
        self.step_fits = True

    def problem(self, *texts: str) -> None:
        """Note what is wrong."""
        self._errors.extend(HalfshaftError(text) for text in texts)

    def take(self, load: Callable[[], T]) -> T | None:
        """Return what is loaded, or None and note why."""
        try:
            return load()
        except HalfshaftError as error:
            self._errors.append(error)
            return None

    def vehicle(self, name: str, mass: float | None, values: Sequence[str] | None, soc: float | None) -> Vehicle | None:
        """Return a vehicle with the numbers that were set."""
        from halfshaft.models.vehicle import Vehicle

        car = self.take(lambda: Vehicle.load(name))
        given: list[tuple[str, float | str]] = [] if mass is None or car is None else [(car.tags.the("vehicle mass"), mass)]
        for text in values or ():
            key, sign, value = text.partition("=")
            if not (key.strip() and sign and value.strip()):
                self.problem(f"--set {text}: must be NAME=VALUE, such as body.m=1500 or motor.J='0.05 kg m^2'")
                continue
            given.append((key.strip(), number_or_text(value.strip())))
        if soc is not None:
            stores = [] if car is None else car.tags.all_of("start charge")
            if car is not None and not stores:
                self.problem(f"--soc {soc:g}: vehicle '{car.name}' has no battery")
            given += [(name, soc) for name in stores]
        names = [key for key, _ in given]
        self.problem(*(f"{key} is set {names.count(key)} times" for key in dict.fromkeys(names) if names.count(key) > 1))
        return None if car is None else self.take(lambda: car.with_values(dict(given)))

    def numbers(self, car: Vehicle | None, names: Sequence[str] | None, option: str) -> None:
        """Note what is no number of a vehicle by which can be derived."""
        if car is not None and names:
            from halfshaft.cosim.gradient import unknown_numbers

            self.problem(*(f"{option}: {problem}" for problem in unknown_numbers(car, names)))

    def step(self, dt: float, trace: Cycle | None) -> None:
        """Note a length of step that no run can have."""
        if not (math.isfinite(dt) and dt > 0):
            self.problem(f"--dt {dt:g} s, must be > 0 s")
        elif trace is not None and trace.duration / dt > MOST_STEPS:
            self.problem(f"--dt {dt:g} s makes {trace.duration / dt:.3g} steps of cycle '{trace.name}', must be at most {MOST_STEPS}")
        else:
            return
        self.step_fits = False

    def tasks(
        self,
        cycles: Sequence[str] | None,
        tests: Sequence[str] | None,
        correction: Literal["zero-delta", "linear"] | None,
        mode: Mode,
        dt: float,
    ) -> list[Any]:
        """Return what a study does with a vehicle: the cycles, with or without a correction of the charge, and tests by name."""
        from halfshaft.cosim.cycle import Cycle
        from halfshaft.studies.soc_correction import Linear, ZeroDelta
        from halfshaft.studies.task import Drive

        traces = [self.take(partial(Cycle.load, name)) for name in cycles or ()]
        for trace in traces:
            self.step(dt, trace)
        named = [self.take(partial(_named_test, name)) for name in tests or ()]
        if not (traces or named):
            self.problem("nothing to do: name a cycle or a test, such as --cycle udds or --test acceleration")
        if correction is not None and not traces:
            self.problem(f"--correction {correction} goes with --cycle")
        drive: Any = {None: Drive, "zero-delta": ZeroDelta, "linear": Linear}[correction]
        return [*(drive(cycle=trace, mode=mode, dt=dt) for trace in traces if trace), *(task for task in named if task)]

    def target(self, path: Path | None, option: str) -> None:
        """Note a file that cannot be written."""
        if path is not None and (problem := target_problem(path)):
            self.problem(f"{option} {path}: {problem}")

    def picture(self, path: Path | None, option: str) -> None:
        """Note a picture that cannot be drawn."""
        self.target(path, option)
        if path is not None:
            from halfshaft.cosim.plot import plot_problems  # matplotlib takes a quarter of a second

            self.problem(*(f"{option} {path}: {problem}" for problem in plot_problems(path)))

    def folder(self, path: Path | None, option: str) -> None:
        """Note a folder that cannot be made or written to."""
        if path is None:
            return
        try:
            there = next(p for p in (path.absolute(), *path.absolute().parents) if p.exists())
        except OSError as error:
            self.problem(f"{option} {path}: cannot be written: {error.strerror}")
            return
        if not there.is_dir():
            self.problem(f"{option} {path}: {there} is a file, must be a folder")
        elif not os.access(there, os.W_OK | os.X_OK):
            self.problem(f"{option} {path}: the folder {there} cannot be written to")

    def done(self, value: T | None) -> T:
        """Return what was loaded, or raise one error with everything that is wrong."""
        self.raise_problems()
        if value is None:
            raise HalfshaftError("nothing was loaded")
        return value

    def raise_problems(self) -> None:
        """Raise one error if anything was wrong."""
        if len(self._errors) == 1:
            raise self._errors[0]
        if self._errors:
            raise HalfshaftError("\n  ".join(["several things are wrong:", *(str(e).replace("\n", "\n  ") for e in self._errors)]))


def _named_test(name: str) -> Task:
    """Return a test by its name, as `halfshaft test` runs it where nothing else is said."""
    from halfshaft.studies.acceleration import AccelerationTest, TopSpeedTest
    from halfshaft.studies.gradeability import GradeabilityTest
    from halfshaft.studies.procedure import Procedure

    if name == "acceleration":
        return AccelerationTest(pairs=((0, 50), (0, 100), (80, 120)), unit="km/h")
    plain: dict[str, type[Any]] = {"gradeability": GradeabilityTest, "top-speed": TopSpeedTest}
    return plain[name]() if name in plain else Procedure.load(name)


def number_or_text(text: str) -> float | str:
    """Return a number where there is no unit, which is SI then."""
    try:
        return float(text)
    except ValueError:
        return text
