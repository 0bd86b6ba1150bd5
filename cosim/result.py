"""What a run returns: time series with units, summary, warnings, energy account, and the inputs that made it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from halfshaft.cosim import older
from halfshaft.cosim.account import Account, account
from halfshaft.cosim.audit import Audit
from halfshaft.cosim.compiled import Array
from halfshaft.cosim.facts import in_html, in_line
from halfshaft.cosim.origin import Made, Origin, Ratings
from halfshaft.cosim.remarks import remarks
from halfshaft.cosim.units import mpg, mpge
from halfshaft.library.base.errors import InputError, nearest
from halfshaft.library.base.tags import Tag, Tags
from halfshaft.library.files.texts import open_regular
from halfshaft.library.files.writing import written_whole
from halfshaft.models.assembly import Description
from halfshaft.models.vehicle import Vehicle

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

#: What a saved run is written as; 1 had no origin, 2 no tags.
FORMAT = 3
#: Efficiency of a genset that did not run, or hardly: that of the library's small cars is 0.31 on HWFET.
GENSET_NOMINAL = 0.30
#: Fuel over the battery's energy from which a run knows its genset's efficiency.
GENSET_RAN = 0.1


@dataclass(frozen=True)
class Inputs:
    """What made a run; enough to make it again."""

    vehicle: str
    powertrain: str
    cycle: str
    via: str
    mode: str
    dt: float
    version: str
    parameters: Mapping[str, float]
    #: Whether the step ran as machine code.
    compiled: bool = True
    #: Hashes of the cycle and of the parts by role; empty for files of version 0.1.
    hashes: Mapping[str, str] = field(default_factory=dict, repr=False)
    #: What the parameters are, by name.
    tags: Mapping[str, str] = field(default_factory=dict, repr=False)


@dataclass(frozen=True)
class Result:
    """One run of one vehicle over one cycle.

    Parameters
    ----------
    inputs
        What made it.
    time
        End of each step [s], shape ``(n,)``.
    outputs
        What the columns of `history` are.
    history
        Outputs at the end of each step, shape ``(n, n_outputs)``; empty rows if only the summary was asked for.
    energies
        Time integral of every output; of a power it is an energy [J].
    highest
        Maximum of every output.
    first, last
        Outputs at start and end, by name; `first` has the time too, and of the outputs speed, charges and temperatures.
    made
        What the run was made of; None for files of version 0.1.
    notes
        What is doubtful about vehicle, cycle and run and does not show in the outputs.
    gradient
        Derivatives of the main figures by numbers of the vehicle, by the names of both [SI of the figure over SI of the number].

    """

    inputs: Inputs
    time: Array
    outputs: tuple[Description, ...]
    history: Array
    energies: Mapping[str, float]
    highest: Mapping[str, float]
    first: Mapping[str, float]
    last: Mapping[str, float]
    made: Made | Origin | None = field(default=None, repr=False, compare=False)
    notes: tuple[str, ...] = ()
    gradient: Mapping[str, Mapping[str, float]] = field(default_factory=dict, repr=False)

    def __getitem__(self, name: str) -> Array:
        """Return one time series, shape ``(n,)``.

        Raises
        ------
        InputError
            If there is no such output, the nearest name is given; or if the run kept no time series.

        """
        for i, d in enumerate(self.outputs):
            if d.name == name:
                return self._rows[:, i]
        raise InputError("result", [f"no output is called {name}{nearest(name, {d.name: d for d in self.outputs})}"])

    def __repr__(self) -> str:
        return f"<Result {in_line(self)}>"

    def _repr_html_(self) -> str:
        return in_html(self)

    @cached_property
    def tags(self) -> Tags:
        """What outputs and parameters are, whatever their parts are called."""
        return Tags({**self.inputs.tags, **Tags.of(self.outputs)})

    def the(self, tag: Tag) -> Array:
        """Return the time series of the one output with a tag, shape ``(n,)``."""
        return self[self.tags.the(tag)]

    @property
    def has_history(self) -> bool:
        """Whether the run kept its time series."""
        return len(self.history) == len(self.time)

    @property
    def _rows(self) -> Array:
        if not self.has_history:
            raise InputError("result", ["the run kept no time series: it was made with history=False"])
        return self.history

    @cached_property
    def dt(self) -> Array:
        """Length of each step [s]."""
        return np.diff(self.time, prepend=self.t_start)

    @property
    def t_start(self) -> float:
        """Time at the start of the first step [s]."""
        if "time" in self.first or not len(self.time):
            return self.first.get("time", 0.0)
        return float(self.time[0]) - self.inputs.dt

    @property
    def origin(self) -> Origin | None:
        """What the run was made of: vehicle, parts and cycle as texts, date, machine, versions; None for files of version 0.1."""
        return self.made.origin if isinstance(self.made, Made) else self.made

    @cached_property
    def vehicle(self) -> Vehicle:
        """What ran; of a run that was loaded, made again of what its file keeps.

        Raises
        ------
        InputError
            If the file is of version 0.1, or its powertrain is not installed.

        """
        if self.made is None:
            raise InputError("result", ["a file of version 0.1 does not say what the vehicle was made of"])
        return self.made.vehicle if isinstance(self.made, Made) else self.made.rebuilt()

    @cached_property
    def account(self) -> Account:
        """The energy account."""
        return account(self.outputs, self.energies)

    @property
    def auditable(self) -> bool:
        """Whether the run can be audited: a run of the step that kept its history and was not loaded from a file."""
        return isinstance(self.made, Made) and self.inputs.via != "forward" and len(self.history) > 0

    @cached_property
    def audit(self) -> Audit:
        """The audit: every part held against its own laws; takes some ten milliseconds when first asked for.

        Raises
        ------
        InputError
            If the run kept no history, is forward-facing, or was loaded from a file.

        """
        from halfshaft.cosim.simulate import audit_of  # which makes results

        if not isinstance(self.made, Made) or not self.auditable:
            raise InputError("audit", ["only a run of the step that kept its history can be audited, right after it was made"])
        return audit_of(self.made.vehicle, self.made.cycle.sampled(self.inputs.dt), self.history)

    @cached_property
    def dataset(self) -> xr.Dataset:
        """All time series with units and meanings, as a labelled dataset; built when first asked for."""
        import xarray as xr  # takes a fifth of a second

        rows = self._rows
        series = {d.name: ("time", rows[:, i], _attributes(d)) for i, d in enumerate(self.outputs)}
        time = ("time", self.time, {"units": "s", "long_name": "end of the step", "axis": "T"})
        attributes = {
            "Conventions": "CF-1.11",
            "title": f"{self.inputs.vehicle} over {self.inputs.cycle}",
            "source": f"halfshaft {self.inputs.version}, {self.inputs.via}, {self.inputs.mode}, steps of {self.inputs.dt:g} s",
        }
        if self.made is not None:
            attributes["history"] = f"{self.made.date}: made on {self.made.machine}"
        return xr.Dataset(series, {"time": time}, attributes)

    def to_pandas(self) -> pd.DataFrame:
        """Return all time series as a table, a column for each output, its index the end of each step [s]; units are SI."""
        return self.dataset.to_dataframe()

    def save_csv(self, path: str | Path) -> None:
        """Write all time series to a CSV file, whole or not at all; titles end with the unit in brackets.

        Raises
        ------
        InputError
            If the run kept no time series, or the file cannot be written.

        """
        table = self.to_pandas()
        table.columns = [f"{d.name} [{d.unit}]" for d in self.outputs]
        table.index.name = "time [s]"
        with written_whole(path) as part:
            table.to_csv(part)

    @cached_property
    def figures(self) -> dict[str, Any]:
        """The main numbers, SI or the unit in the names' endings; None is what the vehicle does not have.

        Of several engines, fuel cells, motors or batteries fuels, energies and powers are sums; the state of charge is the mean
        of all packs, each weighted by its rated energy.
        """
        tags, a, ratings = self.tags, self.account, self.made.ratings if self.made else Ratings()
        distance = self.last[tags.the("distance")]
        inputs = [self.energies[name] for name in tags.all_of("traction input")]
        too_slow, too_fast = (max((self.highest[name] for name in tags.all_of(tag)), default=0.0) for tag in ("miss", "overspeed"))
        out: dict[str, Any] = {
            "distance_m": distance,
            "duration_s": float(self.time[-1]) - self.t_start if len(self.time) else 0.0,
            **_fuel(self, distance),
            "energy_from_battery_J": None,
            "energy_Wh_per_km": None,
            "energy_MPGe": None,
            "range_m": None,
            "pack_energy_J": ratings.pack_energy_J,
            "motor_power_max_W": ratings.motor_power_max_W,
            "motor_input_J": sum(inputs) if inputs else None,
            "soc_start": _charge(self, self.first),
            "soc_end": _charge(self, self.last),
            "trace_miss_max_mps": max(too_slow, 0.0) if len(self.time) else 0.0,
            "overspeed_max_mps": max(too_fast, 0.0) if len(self.time) else 0.0,
            "balance_relative": a.balance_relative,
            "speed_mismatch_relative": a.mismatch_relative,
        }
        if any(d.booking == "stored" for d in self.outputs):
            out["energy_from_battery_J"] = a.battery
            if out["fuel_L"] is None and distance > 0 and a.battery > 0:
                out["energy_Wh_per_km"] = a.battery / 3.6 / distance
                out["energy_MPGe"] = mpge(out["energy_Wh_per_km"])
                out["range_m"] = out["pack_energy_J"] and out["pack_energy_J"] * distance / a.battery
        return out

    @property
    def genset_ran(self) -> bool:
        """Whether enough fuel became electricity to tell the genset's efficiency by it."""
        return _generated(self) > 0 and self.account.fuel > GENSET_RAN * abs(self.account.battery)

    @cached_property
    def summary(self) -> dict[str, Any]:
        """What was run, the main numbers, and what to know about them."""
        inputs = {name: getattr(self.inputs, name) for name in ("vehicle", "cycle", "via", "mode")}
        return {**inputs, **self.figures, "warnings": list(self.warnings)}

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """What a user should know about this run."""
        return remarks(self)

    def _plain(self) -> dict[str, Any]:
        return {
            "format": FORMAT,
            "origin": self.origin and self.origin.plain(),
            "inputs": {**self.inputs.__dict__, "parameters": dict(self.inputs.parameters), "hashes": dict(self.inputs.hashes)},
            "outputs": [list(d) for d in self.outputs],
            "energies": dict(self.energies), "highest": dict(self.highest), "first": dict(self.first), "last": dict(self.last),
            "notes": list(self.notes), "gradient": {name: dict(of) for name, of in self.gradient.items()},
        }  # fmt: skip

    def save(self, path: str | Path) -> Path:
        """Write the run to a netCDF file, whole or not at all.

        Raises
        ------
        InputError
            If the file cannot be written.

        """
        # HDF5 does not take a full disk well, so the file is made in memory.
        content = self.dataset.assign_attrs(result=json.dumps(self._plain())).to_netcdf(engine="h5netcdf")
        with written_whole(path) as part:
            part.write_bytes(content)
        return Path(path)

    @classmethod
    def load(cls, path: str | Path) -> Result:
        """Read a run that `save` wrote.

        Raises
        ------
        InputError
            If the file is missing or not a result.

        """
        import h5py

        with open_regular(path) as file:
            try:
                with h5py.File(file) as data:
                    plain = json.loads(data.attrs["result"])
                    written = plain.get("format", 1)
                    if written > FORMAT:
                        raise InputError(str(path), [f"is a result of format {written}, this version reads up to {FORMAT}"])
                    if written < FORMAT:
                        older.add_tags(plain)
                    outputs = tuple(Description(*d) for d in plain["outputs"])
                    history = np.stack([data[d.name][()] for d in outputs], axis=1).astype(float)
                    time = data["time"][()].astype(float)
                origin = Origin.of_plain(plain["origin"]) if plain.get("origin") else None
                inputs = Inputs(**plain["inputs"])
                energies, highest, first, last = (plain[x] for x in ("energies", "highest", "first", "last"))
                notes, gradient = tuple(plain.get("notes", ())), plain.get("gradient", {})
                result = cls(inputs, time, outputs, history, energies, highest, first, last, origin, notes, gradient)
                # Nothing is missing from what the summary can be made of.
                _ = result.summary
            # What HDF5 and a changed text raise has no common base.
            except Exception as error:
                if isinstance(error, InputError) and error.where == str(path):
                    raise
                raise InputError(str(path), [f"is not a result of halfshaft: {type(error).__name__}: {error}"]) from error
        return result


def _attributes(d: Description) -> dict[str, Any]:
    """Return what CF tools ask of a variable."""
    flag = {"flag_values": np.array([0.0, 1.0]), "flag_meanings": "no yes"} if d.kind == "flag" else {}
    return {"units": d.unit, "long_name": d.doc, **flag}


def _generated(result: Result) -> float:
    """Return the energy that generators and fuel cells made [J]."""
    return sum(result.energies[name] for name in result.tags.all_of("generated"))


def _charge(result: Result, values: Mapping[str, float]) -> float | None:
    """Return the state of charge of all packs; of several the mean by rated energy, or the plain one where that is not known."""
    charges = {part: values[name] for part, name in result.tags.by_part("charge").items() if name in values}
    if len(charges) < 2:
        return next(iter(charges.values()), None)
    rated = result.made.ratings.energies_J if result.made else {}
    weights = [rated[part] for part in charges] if rated.keys() >= charges.keys() else None
    return float(np.average(list(charges.values()), weights=weights))


def _fuel(result: Result, distance: float) -> dict[str, Any]:
    """Return fuel and fuel economy, and both with the battery's energy turned into fuel; None without an engine."""
    p, a = result.inputs.parameters, result.account
    names = ("fuel_L", "fuel_economy_L_per_100km", "fuel_economy_mpg")
    more = ("fuel_equivalent_L", "fuel_equivalent_L_per_100km", "fuel_equivalent_efficiency", "fuel_equivalent_basis")
    out: dict[str, Any] = dict.fromkeys((*names, *more))
    burnt = {part: result.last[name] for part, name in result.tags.by_part("fuel mass").items()}
    if not burnt:
        return out
    density, heating = (
        {part: p[name] for part, name in result.tags.by_part(tag).items()} for tag in ("fuel density", "fuel heating value")
    )  # fmt: skip

    def economy(litres: float) -> float | None:
        return 1e5 * litres / distance if distance > 0 else None

    out["fuel_L"] = sum(1e3 * mass / density[part] for part, mass in burnt.items())
    out["fuel_economy_L_per_100km"] = x = economy(out["fuel_L"])
    out["fuel_economy_mpg"] = mpg(x) if x else None
    if any(d.booking == "stored" for d in result.outputs):
        own = result.genset_ran
        efficiency = _generated(result) / a.fuel if own else GENSET_NOMINAL
        # A litre of the fuels burnt, all engines together; of one engine's where none ran.
        energy = [1e-3 * density[part] * heating[part] for part in burnt]
        per_litre = a.fuel / out["fuel_L"] if out["fuel_L"] else sum(energy) / len(energy)
        out["fuel_equivalent_L"] = out["fuel_L"] + a.battery / efficiency / per_litre
        out["fuel_equivalent_L_per_100km"] = economy(out["fuel_equivalent_L"])
        out["fuel_equivalent_efficiency"] = efficiency
        out["fuel_equivalent_basis"] = "the run's own mean genset efficiency" if own else "a nominal genset efficiency"
    return out
