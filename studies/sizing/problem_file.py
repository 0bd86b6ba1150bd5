"""Problems of sizings as TOML files: read, never executed.

A file holds ``schema``, ``kind = "sizing"``, ``name``, ``title`` and what `Problem` says::

    vehicle = "small-car-series"            # of the library, or a file beside this one
    minimise = "fuel"
    limits = ["0-60 mph <= 12 s", "grade at 55 mph >= 6 %"]
    sensitivities = ["body.c_d", "engine.efficiency_scale"]

    [tasks]
    city = {cycle = "udds", correction = "linear"}    # or none, zero-delta; mode, dt
    trip = {procedure = "city-highway"}

    [vary]
    source = "20..80 kW"
    "gearbox.ratios_1" = "5..12"
    motor = ["ac-75kw", "pm-58kw"]

    [define]
    cost = "0.02 * source + 150 * store"

    [set]
    "body.c_d" = 0.3
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from halfshaft.cosim.compiled import MODES
from halfshaft.cosim.cycle import Cycle
from halfshaft.library.base.errors import InputError, nearest
from halfshaft.library.base.parameters import Spec
from halfshaft.library.files.component_file import LARGEST, Reader, shown
from halfshaft.library.files.texts import read_text
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.procedure import Procedure
from halfshaft.studies.procedure_file import Plan
from halfshaft.studies.sizing.problem import Problem
from halfshaft.studies.soc_correction import Linear, ZeroDelta
from halfshaft.studies.task import Drive, Task

CORRECTIONS: Mapping[str, type[Any]] = {"none": Drive, "linear": Linear, "zero-delta": ZeroDelta}
SECONDS = Spec("s", "", gt=0)


def problem_names() -> list[str]:
    """Return the names of the library's problems."""
    return sorted(_library())


def read_problem(source: str | Path) -> Problem:
    """Return a problem of the library by name, or of a file ending in ``.toml``.

    Raises
    ------
    InputError
        If there is none, or the file is not right; everything that is wrong is named at once.

    """
    path: Path | Traversable = Path(source)
    if isinstance(source, str) and not source.endswith(".toml"):
        if source not in _library():
            raise InputError(f"sizing '{source}'", [f"not in the library{nearest(source, _library())}"])
        path = _library()[source]
    return _Reader(path).problem()


def _library() -> dict[str, Traversable]:
    folder = files("halfshaft.studies") / "data" / "sizings"
    return {p.name.removesuffix(".toml"): p for p in folder.iterdir() if p.name.endswith(".toml")}


class _Reader(Reader):
    """Reads one file, and collects everything that is wrong with it."""

    def __init__(self, path: Path | Traversable) -> None:
        super().__init__()
        self.path = path

    def problem(self) -> Problem:
        """Return what the file says."""
        extra = {
            "vehicle": str,
            "minimise": str,
            "limits": list,
            "tasks": dict,
            "vary": dict,
            "define": dict,
            "set": dict,
            "sensitivities": list,
        }
        data = self.toml(str(self.path), read_text(self.path, LARGEST), ["sizing"], extra)
        self.required(data, ("vehicle", "minimise", "vary"), "")
        vehicle = self.taken(lambda: Vehicle.load(self.beside(data["vehicle"])), "vehicle") if "vehicle" in data else None
        if vehicle and "set" in data:
            vehicle = self.taken(lambda: vehicle.with_values(_flat(data["set"])), "set")
        tasks = {name: self.task(x, f"tasks.{name}") for name, x in data.get("tasks", {}).items()}
        vary = {name: self.varied(x, f"vary.{name}") for name, x in _flat(data.get("vary", {})).items()}
        for name, x in data.get("define", {}).items():
            if not isinstance(x, str):
                self.problems.append(f"define.{name} = {shown(x)}, must be an expression in quotes")
        self.problems += [f"limits: {shown(x)} must be a text" for x in data.get("limits", ()) if not isinstance(x, str)]
        if vehicle is None:
            raise InputError(str(self.path), self.problems)
        problem = Problem(
            vehicle=vehicle, vary={name: x for name, x in vary.items() if x}, minimise=data.get("minimise", ""),
            limits=tuple(data.get("limits", ())), tasks={name: task for name, task in tasks.items() if task},
            define=data.get("define", {}), sensitivities=tuple(map(str, data.get("sensitivities", ()))), name=data.get("name", ""),
            title=data.get("title", ""),
        )  # fmt: skip
        # Where a task is not right, nobody knows what figures there are.
        self.problems += problem.problems(figures=not self.problems)
        self.finish(str(self.path))
        return problem

    def beside(self, name: str) -> str | Path:
        """Return a name of the library, or the path of a file beside this one."""
        own = name.lower().endswith((".toml", ".csv")) and isinstance(self.path, Path)
        return self.path.parent / name if own and isinstance(self.path, Path) else name

    def taken(self, load: Any, where: str) -> Any:
        """Return what is loaded, or None and note why."""
        try:
            return load()
        except InputError as e:
            self.problems += [f"{where}: {p}" for p in e.problems]
            return None

    def varied(self, value: Any, where: str) -> str | tuple[str, ...]:
        """Return two bounds, or names of parts."""
        if isinstance(value, list) and value and all(isinstance(x, str) for x in value):
            return tuple(str(self.beside(x)) for x in value)
        if not isinstance(value, str):
            self.problems.append(f'{where} = {shown(value)}, must be bounds in quotes such as "20..80 kW", or a list of names of parts')
            return ""
        return value

    def task(self, given: Any, where: str) -> Task | None:
        """Return what finds figures."""
        if not isinstance(given, dict) or ("cycle" in given) == ("procedure" in given):
            self.problems.append(f'{where} = {shown(given)}, must be a table with either cycle or procedure, such as {{cycle = "udds"}}')
            return None
        if "procedure" in given:
            self.keys(given, ("procedure",), f"{where}.")
            return self.taken(lambda: Procedure(Plan.load(self.beside(str(given["procedure"])))), f"{where}.procedure")  # type: ignore[no-any-return]
        self.keys(given, ("cycle", "correction", "mode", "dt"), f"{where}.")
        correction, mode = given.get("correction", "none"), given.get("mode", "hybrid")
        for key, value, known in (("correction", correction, CORRECTIONS), ("mode", mode, MODES)):
            if value not in known:
                self.problems.append(f"{where}.{key} = {shown(value)}, must be {' or '.join(known)}{nearest(str(value), known)}")
        dt = self.number(given.get("dt", "1 s"), SECONDS, f"{where}.dt")
        cycle = self.taken(lambda: Cycle.load(self.beside(str(given["cycle"]))), f"{where}.cycle")
        if cycle is None or correction not in CORRECTIONS or mode not in MODES:
            return None
        return CORRECTIONS[correction](cycle=cycle, mode=mode, dt=dt)  # type: ignore[no-any-return]


def _flat(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return what belongs to each ``role.parameter``, whether or not the name was quoted."""
    nested = {name: x for name, x in data.items() if "." not in name and isinstance(x, dict)}
    return {k: x for k, x in data.items() if k not in nested} | {f"{n}.{k}": x for n, own in nested.items() for k, x in own.items()}
