"""What a sweep found so far, kept in a folder, so that it goes on where it was stopped.

``sweep.json`` says which sweep it is, ``parts`` holds netCDF files with finished points, each written whole, and ``sweep.nc``
is everything, once it is finished.  One process at a time works in a folder: the lock that it holds goes with it,
however it ends.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import time
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from halfshaft.library.base.errors import InputError
from halfshaft.library.files.writing import written_whole
from halfshaft.studies.identity import FORMAT, differences
from halfshaft.studies.job import FAILURE, NOTES, Point

if TYPE_CHECKING:
    import xarray as xr

MANIFEST, PARTS, WHOLE, LOCK = "sweep.json", "parts", "sweep.nc", ".lock"
#: What is finished is written after this time [s], and later after this share of the time so far: few files, little lost.
PERIOD, SHARE = 2.0, 0.05


class Kept:
    """Finished points, in memory and, where there is a folder, on the disk."""

    def __init__(self, manifest: dict[str, Any], folder: Path | None = None) -> None:
        self.manifest, self.folder = manifest, folder
        self.found: dict[int, Point] = {}
        self._unwritten: list[int] = []
        self._begin = self._written = time.monotonic()

    def add(self, points: Mapping[int, Point]) -> None:
        """Take what was found; now and then write it."""
        self.found.update(points)
        if self.folder is None:
            return
        self._unwritten.extend(points)
        now = time.monotonic()
        if now - self._written >= max(PERIOD, SHARE * (now - self._begin)):
            self.write()

    def write(self) -> None:
        """Write what is not written yet."""
        if self.folder is None or not self._unwritten:
            return
        indices = sorted(self._unwritten)
        content = part(indices, self.found).to_netcdf(engine="h5netcdf")
        with written_whole(self.folder / PARTS / f"{indices[0]:09}.nc") as file:
            file.write_bytes(content)
        self._unwritten.clear()
        self._written = time.monotonic()

    def finish(self, whole: xr.Dataset) -> None:
        """Write everything as one file."""
        if self.folder is not None:
            content = whole.to_netcdf(engine="h5netcdf")
            with written_whole(self.folder / WHOLE) as file:
                file.write_bytes(content)


@contextmanager
def kept(manifest: dict[str, Any], path: str | Path | None, points: int) -> Iterator[Kept]:
    """Give what was found before; what is added stays, whatever happens.

    Raises
    ------
    InputError
        If the folder is that of another sweep, or holds anything else, or another process works in it.

    """
    if path is None:
        yield Kept(manifest)
        return
    folder = Path(path)
    with _locked(folder):
        found = _opened(folder, manifest)
        keeper = Kept(found, folder)
        keeper.found.update(_read(folder, points))
        try:
            yield keeper
        finally:
            keeper.write()


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder, which is made if there is none."""
    where = f"folder {folder}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        other = sorted(p.name for p in folder.iterdir() if p.name not in (MANIFEST, PARTS, WHOLE, LOCK) and not p.name.startswith(".part-"))
        if other and not (folder / MANIFEST).exists():
            raise InputError(where, [f"is not that of a sweep, it has {other[0]}; name a new or an empty one"])
        lock = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise InputError(where, [f"cannot be used: {error.strerror or error}"]) from error
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            owner = os.read(lock, 100).decode(errors="replace").strip()
            raise InputError(where, [f"another process works in it{f' ({owner})' if owner else ''}; wait for it, or stop it"]) from None
        except OSError as error:
            raise InputError(where, [f"cannot be locked: {error.strerror or error}"]) from error
        os.ftruncate(lock, 0)
        os.pwrite(lock, f"process {os.getpid()} on {os.uname().nodename}\n".encode(), 0)
        yield
    finally:
        os.close(lock)


def _opened(folder: Path, manifest: dict[str, Any]) -> dict[str, Any]:
    """Return the manifest of a folder, which gets this one if it has none."""
    where = f"folder {folder}"
    # A process that was killed while it wrote leaves these.
    for left in (*folder.glob(".part-*"), *(folder / PARTS).glob(".part-*")):
        shutil.rmtree(left, ignore_errors=True)
    path = folder / MANIFEST
    if not path.exists():
        (folder / PARTS).mkdir(exist_ok=True)
        with written_whole(path) as file:
            file.write_text(json.dumps(manifest, indent=1), encoding="utf-8")
        return manifest
    try:
        there = json.loads(path.read_text(encoding="utf-8"))
        number, sweep = there["format"], there["sweep"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(where, [f"{MANIFEST} is not that of a sweep: {error}"]) from error
    if number != FORMAT:
        raise InputError(where, [f"is of format {number}, this version reads format {FORMAT}"])
    if differing := differences(sweep, manifest["sweep"]):
        raise InputError(where, ["is that of another sweep; name another folder", *differing])
    (folder / PARTS).mkdir(exist_ok=True)
    return dict(there)


def _read(folder: Path, points: int) -> dict[int, Point]:
    """Return the points of all parts."""
    import xarray as xr

    found: dict[int, Point] = {}
    for path in sorted((folder / PARTS).glob("*.nc")):
        try:
            with xr.open_dataset(path, engine="h5netcdf") as data:
                found |= points_of(data.load())
        # What HDF5 raises on a damaged file has no common base.
        except Exception as error:
            warnings.warn(f"{path} cannot be read, its points are worked out again: {error}", stacklevel=2)
    return {i: point for i, point in found.items() if 0 <= i < points}


def part(indices: list[int], found: Mapping[int, Point]) -> xr.Dataset:
    """Return some points as a dataset."""
    import xarray as xr

    names = dict.fromkeys(name for i in indices for name in found[i].figures)
    rows = {name: [np.nan if (x := found[i].figures.get(name)) is None else x for i in indices] for name in names}
    texts = {FAILURE: [found[i].failure for i in indices], NOTES: ["\n".join(found[i].notes) for i in indices]}
    variables = {name: ("point", np.array(row, dtype=float)) for name, row in rows.items()}
    variables |= {name: ("point", np.array(row, dtype=object)) for name, row in texts.items()}
    return xr.Dataset(variables, coords={"index": ("point", indices)})


def points_of(data: xr.Dataset) -> dict[int, Point]:
    """Return what `part` was made of."""
    names = [str(name) for name in data.data_vars if name not in (FAILURE, NOTES)]
    columns = {name: data[name].to_numpy().tolist() for name in (*names, FAILURE, NOTES)}
    none = {name: [None if x != x else x for x in columns[name]] for name in names}
    return {
        int(i): Point({name: none[name][k] for name in names}, tuple(filter(None, columns[NOTES][k].split("\n"))), columns[FAILURE][k])
        for k, i in enumerate(data["index"].to_numpy())
    }
