"""Runs the electric car that ``twin/electric.c`` writes by hand: an independent check of the generated step, and its rival in speed."""

from __future__ import annotations

import ctypes
from importlib.resources import files
from typing import NamedTuple

import numpy as np

from halfshaft.cosim.compiled import Array
from halfshaft.cosim.cycle import Samples
from halfshaft.fmu_build.compiler import shared_library
from halfshaft.library.base.parameters import tables
from halfshaft.models.vehicle import Vehicle


class _Map(ctypes.Structure):
    """The ``map`` of the C file."""

    _fields_ = (
        ("nx", ctypes.c_long),
        ("ny", ctypes.c_long),
        ("x", ctypes.c_void_p),
        ("y", ctypes.c_void_p),
        ("value", ctypes.c_void_p),
        ("i", ctypes.c_long),
        ("j", ctypes.c_long),
    )


class TwinMarch(NamedTuple):
    """Outputs of shape ``(n, n_outputs)``, their integrals and their maxima."""

    history: Array
    sums: Array
    highest: Array


class Twin:
    """The hand-written car with the numbers and maps of a vehicle.

    The vehicle must be electric, with a gearbox of one ratio and an efficiency map.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        source = files("halfshaft.validation").joinpath("twin", "electric.c").read_text()
        self._library = ctypes.CDLL(str(shared_library(source, "electric_twin")))
        self._library.twin_march.restype = None
        self.outputs = self._names("twin_outputs")
        self._numbers = self._names("twin_parameters")
        self._values = vehicle.values
        found = {f"{role}.{name}": t for role, p in vehicle.parameters.items() for name, t in tables(p)}
        self._maps = [self._map(found[name].points, found[name].values) for name in self._names("twin_maps")]

    def _names(self, symbol: str) -> list[str]:
        listed = ctypes.cast(getattr(self._library, symbol), ctypes.POINTER(ctypes.c_char_p))
        names: list[str] = []
        while (name := listed[len(names)]) is not None:
            names.append(name.decode())
        return names

    def _map(self, points: tuple[Array, ...], values: Array) -> tuple[_Map, list[Array]]:
        axes = [np.ascontiguousarray(x) for x in points if len(x) > 1]
        kept = [*axes, np.ascontiguousarray(values)]
        x, y, value = axes[0].ctypes.data, axes[1].ctypes.data if len(axes) > 1 else None, kept[-1].ctypes.data
        # The C file addresses these arrays as long as the twin lives.
        return _Map(len(axes[0]), len(axes[1]) if len(axes) > 1 else 0, x, y, value, 0, 0), kept

    def march(self, samples: Samples, *, totals: bool = True) -> TwinMarch:
        """Drive over a cycle without a grade over distance; without `totals`, integrals and maxima are left out."""
        n, n_outputs = len(samples.t), len(self.outputs)
        values = {**self._values, "body.v_start": samples.v_start}
        parameters = np.array([values[name] for name in self._numbers])
        maps = (_Map * len(self._maps))(*(m for m, _ in self._maps))
        done = TwinMarch(np.empty((n, n_outputs)), np.empty(n_outputs), np.empty(n_outputs))
        filled = done if totals else (done.history,)
        inputs = (samples.dt, samples.v, samples.grade, samples.key_on, parameters)
        self._library.twin_march(
            ctypes.c_long(n),
            *(ctypes.c_void_p(a.ctypes.data) for a in inputs),
            maps,
            *(ctypes.c_void_p(a.ctypes.data) for a in filled),
            *(ctypes.c_void_p(None) for _ in done[len(filled) :]),
        )
        return done
