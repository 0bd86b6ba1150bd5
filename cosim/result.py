"""What a run returns: time series with units, summary, warnings, energy account, and the inputs that made it."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from halfshaft.cosim.account import Account, account
from halfshaft.cosim.audit import Audit
from halfshaft.cosim.compiled import Array
from halfshaft.library.errors import InputError
from halfshaft.library.texts import open_regular
from halfshaft.library.writing import written_whole
from halfshaft.models.assembly import Description

if TYPE_CHECKING:
    import xarray as xr

#: Relative residual of the energy account from which a run is doubtful.
OPEN_BALANCE = 1e-6


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
    #: What is doubtful about the vehicle and the cycle.
    notes: tuple[str, ...] = ()


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
        Speed and state of charge at start and end, by output name.

    """

    inputs: Inputs
    time: Array
    outputs: tuple[Description, ...]
    history: Array
    energies: Mapping[str, float]
    highest: Mapping[str, float]
    first: Mapping[str, float]
    last: Mapping[str, float]
    #: Makes the audit; a run that was loaded, or is forward-facing, has none.
    audited: Callable[[], Audit] | None = field(default=None, repr=False, compare=False)

    def __getitem__(self, name: str) -> Array:
        """Return one time series, shape ``(n,)``.

        Raises
        ------
        InputError
            If there is no such output; the nearest name is given.

        """
        from halfshaft.library.errors import nearest

        for i, d in enumerate(self.outputs):
            if d.name == name:
                return self.history[:, i]
        raise InputError("result", [f"no output is called {name}{nearest(name, [d.name for d in self.outputs])}"])

    @cached_property
    def account(self) -> Account:
        """The energy account."""
        return account(self.outputs, self.energies)

    @cached_property
    def audit(self) -> Audit:
        """The audit: every part held against its own laws; takes some ten milliseconds when first asked for.

        Raises
        ------
        InputError
            If the run kept no history, is forward-facing, or was loaded from a file.

        """
        if self.audited is None or not len(self.history):
            raise InputError("audit", ["only a run of the step that kept its history can be audited, right after it was made"])
        return self.audited()

    @cached_property
    def dataset(self) -> xr.Dataset:
        """All time series with units and meanings, as a labelled dataset; built when first asked for."""
        import xarray as xr  # takes a fifth of a second

        series = {
            d.name: xr.DataArray(self.history[:, i], dims="time", attrs={"units": d.unit, "long_name": d.doc})
            for i, d in enumerate(self.outputs)
        }
        attributes = {"result": json.dumps(self._plain())}
        time = xr.DataArray(self.time, dims="time", attrs={"units": "s", "long_name": "end of the step"})
        return xr.Dataset(series, coords={"time": time}, attrs=attributes)

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The main numbers, SI units in the names' endings."""
        distance = self.last["body.distance"]
        out: dict[str, Any] = {
            "vehicle": self.inputs.vehicle,
            "cycle": self.inputs.cycle,
            "via": self.inputs.via,
            "mode": self.inputs.mode,
            "distance_m": distance,
            "duration_s": float(self.time[-1]) if len(self.time) else 0.0,
            "fuel_L": None,
            "fuel_economy_L_per_100km": None,
            "motor_input_J": self.energies.get("motor.P_in"),
            "soc_start": self.first.get("battery.soc"),
            "soc_end": self.last.get("battery.soc"),
            "trace_miss_max_mps": max(self.highest["body.trace_miss"], 0.0) if len(self.time) else 0.0,
            "balance_relative": self.account.balance_relative,
            "speed_mismatch_relative": self.account.mismatch_relative,
            "warnings": list(self.warnings),
        }
        if "engine.fuel_used" in self.last:
            litres = 1e3 * self.last["engine.fuel_used"] / self.inputs.parameters["engine.rho_fuel"]
            out["fuel_L"] = litres
            out["fuel_economy_L_per_100km"] = 1e5 * litres / distance if distance > 0 else None
        return out

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """What a user should know about this run."""
        found, p, n = [], self.inputs.parameters, len(self.time)
        if not n:
            return ("the cycle has no length: nothing was run",)
        miss = self.highest["body.trace_miss"]
        if miss > p["body.v_miss"]:
            when = f" at t = {self.time[int(np.argmax(self['body.trace_miss']))]:g} s" if len(self.history) else ""
            found.append(f"trace missed by up to {miss * 3.6:.1f} km/h{when}")
        if self.highest.get("wheel.slip_limited", 0) > 0:
            found.append("grip limit reached")
        if self.highest.get("battery.battery_limited", 0) > 0:
            found.append("battery limit reached")
        if "battery.soc" in self.last and self.last["battery.soc"] < 1e-3:
            found.append("battery empty")
        if "motor.omega_max" in p and self.highest.get("motor.omega", 0) >= p["motor.omega_max"] * p["motor.speed_scale"] * (1 - 1e-9):
            found.append("motor at its top speed")
        if "engine.fuel_used" in self.last and self.last["engine.fuel_used"] == 0:
            found.append("no fuel used: the engine never ran")
        if abs(self.account.balance_relative) > OPEN_BALANCE:
            found.append(f"the energy account is open by {self.account.balance_relative:.1e} of the turnover")
        return (*found, *self.inputs.notes)

    def _plain(self) -> dict[str, Any]:
        return {
            "inputs": {**self.inputs.__dict__, "parameters": dict(self.inputs.parameters)},
            "outputs": [list(d) for d in self.outputs],
            "energies": dict(self.energies), "highest": dict(self.highest), "first": dict(self.first), "last": dict(self.last),
        }  # fmt: skip

    def save(self, path: str | Path) -> Path:
        """Write the run to a netCDF file, whole or not at all.

        Raises
        ------
        InputError
            If the file cannot be written.

        """
        # HDF5 does not take a full disk well, so the file is made in memory.
        content = self.dataset.to_netcdf(engine="h5netcdf")
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
        import xarray as xr

        with open_regular(path) as file:
            try:
                with xr.open_dataset(file, engine="h5netcdf", decode_times=False) as data:
                    plain = json.loads(data.attrs["result"])
                    outputs = tuple(Description(*d) for d in plain["outputs"])
                    history = np.stack([data[d.name].to_numpy() for d in outputs], axis=1).astype(float)
                    time = data["time"].to_numpy().astype(float)
                inputs = Inputs(**{**plain["inputs"], "notes": tuple(plain["inputs"].get("notes", ()))})
                result = cls(inputs, time, outputs, history, *(plain[x] for x in ("energies", "highest", "first", "last")))
                # Nothing is missing from what the summary can be made of.
                _ = result.summary
            # What HDF5 and a changed text raise has no common base.
            except Exception as error:
                raise InputError(str(path), [f"is not a result of halfshaft: {type(error).__name__}: {error}"]) from error
        return result
