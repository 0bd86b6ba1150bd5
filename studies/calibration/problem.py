"""Calibrations as TOML files: which vehicle, what is fitted, and to which drives.

A file holds ``schema``, ``kind = "calibration"``, ``name``, ``title`` and::

    vehicle = "small-car-electric"            # in the library, or a file beside this one
    loss = "huber"                            # linear unless said; soft_l1, huber, cauchy
    starts = 16
    mode = "hybrid"
    dt = "1 s"

    [set]                                     # numbers of the vehicle before anything is fitted
    "battery.n_modules" = 25

    [fit]                                     # what is fitted, and its range
    "body.c_d" = "0.2..0.5"
    "wheel.f_0" = "0.004..0.02"

    [[drives]]
    file = "monday.csv"
    cycle = "udds"                            # where the trace is not the file's
    set = {"body.m" = "1250 kg"}              # numbers on this drive only
    [drives.series."battery.P_out"]           # all columns called like outputs, unless said
    column = "HV power [kW]"
    sigma = "0.5 kW + 1 %"
    how = "mean"
    offset = "-0.4 s"
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from halfshaft.cosim.cycle import Cycle
from halfshaft.library.base.errors import InputError
from halfshaft.library.base.parameters import Spec
from halfshaft.library.files.component_file import LARGEST, Reader, shown
from halfshaft.library.files.texts import read_text
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.calibration.calibrate import Calibration, calibrate
from halfshaft.studies.calibration.record import Reading, Record

_SECONDS = Spec("s", "")


@dataclass(frozen=True, kw_only=True, eq=False)
class Problem:
    """A calibration as its file says it."""

    name: str
    vehicle: Vehicle
    records: tuple[Record, ...]
    unknowns: Mapping[str, Any]
    options: Mapping[str, Any]

    @classmethod
    def load(cls, path: str | Path) -> Problem:
        """Return the problem of a TOML file.

        Raises
        ------
        InputError
            If the file is not right; everything that is wrong is named at once.

        """
        return _Reader(Path(path)).problem()

    def solve(self) -> Calibration:
        """Fit what is to be fitted."""
        return calibrate(self.vehicle, self.records, self.unknowns, **self.options)


class _Reader(Reader):
    """Reads one file, and collects everything that is wrong with it."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.path = path

    def problem(self) -> Problem:
        extra = {"vehicle": str, "loss": str, "starts": int, "mode": str, "dt": str, "set": dict, "fit": dict, "drives": list}
        data = self.toml(str(self.path), read_text(self.path, LARGEST), ["calibration"], extra)
        self.required(data, ("vehicle", "fit", "drives"), "")
        car = self.loaded(Vehicle.load, data["vehicle"], "vehicle") if "vehicle" in data else None
        if car is not None and "set" in data:
            try:
                car = car.with_values(data["set"])
            except InputError as error:
                self.problems.extend(f"set.{p}" for p in error.problems)
        options: dict[str, Any] = {name: data[name] for name in ("loss", "starts", "mode") if name in data}
        if "dt" in data:
            options["dt"] = self.number(data["dt"], _SECONDS, "dt")
        records = [self.record(x, f"drives[{i}]") for i, x in enumerate(data.get("drives", ()), 1)]
        self.finish(str(self.path))
        assert car is not None
        found = tuple(record for record in records if record is not None)
        return Problem(name=data["name"], vehicle=car, records=found, unknowns=data["fit"], options=options)

    def loaded(self, load: Any, name: str, where: str) -> Any:
        """Return what a name of the library, or a file beside this one, stands for; None if there is none."""
        try:
            return load(self.path.parent / name if name.lower().endswith((".toml", ".csv")) else name)
        except InputError as error:
            self.problems.extend(f"{where}: {error.where}: {p}" for p in error.problems)
            return None

    def record(self, data: Any, where: str) -> Record | None:
        """Return a drive."""
        if not isinstance(data, dict):
            self.problems.append(f"{where} = {shown(data)}, must be a table with a file")
            return None
        kinds = {"file": str, "cycle": str, "set": dict, "series": dict}
        self.keys(data, kinds, f"{where}.")
        self.required(data, ("file",), f"{where}.")
        bad = [key for key, kind in kinds.items() if not isinstance(data.get(key, kind()), kind)]
        self.problems.extend(f"{where}.{key} = {shown(data[key])}, must be {'a table' if kinds[key] is dict else 'a text'}" for key in bad)
        if bad or "file" not in data:
            return None
        series = {name: self.reading(x, f"{where}.series.{name}") for name, x in data.get("series", {}).items()} or None
        cycle = self.loaded(Cycle.load, data["cycle"], f"{where}.cycle") if "cycle" in data else None
        found: Record | None = self.loaded(
            lambda path: Record.load(path, series, cycle=cycle, values=data.get("set")), data["file"], f"{where}.file"
        )
        return found

    def reading(self, data: Any, where: str) -> Reading:
        """Return how an output was measured."""
        if not isinstance(data, dict):
            self.problems.append(f"{where} = {shown(data)}, must be a table with column, sigma, how or offset")
            return Reading()
        self.keys(data, [f.name for f in fields(Reading)], f"{where}.")
        offset = self.number(data["offset"], _SECONDS, f"{where}.offset") if "offset" in data else 0.0
        return Reading(str(data.get("column", "")), data.get("sigma"), data.get("how"), offset)
