"""What a run was made of, so that a file of results says which car it was, and on which road, with which program."""

from __future__ import annotations

import hashlib
import platform
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache, cached_property, lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import tomlkit

from halfshaft.cosim.cycle import Cycle
from halfshaft.library.files.component_file import ComponentFile
from halfshaft.models.vehicle import Vehicle

#: Packages whose version may move a result.
PACKAGES = ("halfshaft", "casadi", "numpy")


class Text(NamedTuple):
    """One input of a run: what it is, where its figures come from, its content as the text of a file, and the hash of that."""

    kind: str
    name: str
    title: str
    source: str
    sha256: str
    text: str

    def __repr__(self) -> str:
        return f"<Text of the {self.kind} {self.name}: {len(self.text)} characters, sha256 {self.sha256[:12]}>"


class Ratings(NamedTuple):
    """Energy of all batteries and peak power of all motors of a vehicle; None if it has none; the energies by part."""

    pack_energy_J: float | None = None
    motor_power_max_W: float | None = None
    energies_J: Mapping[str, float] = {}


@dataclass(frozen=True)
class Origin:
    """What a run was made of, as a file of results keeps it.

    Parameters
    ----------
    vehicle, cycle
        The vehicle and the cycle, as texts of files in SI units.
    parts
        The components by role.
    date
        When the run was made, UTC.
    machine
        Operating system and processor.
    versions
        Of Python and of the packages that make the numbers.
    ratings
        What the vehicle's batteries and motors are rated at.

    """

    vehicle: Text
    cycle: Text
    parts: Mapping[str, Text]
    date: str
    machine: str
    versions: Mapping[str, str]
    ratings: Ratings

    def __repr__(self) -> str:
        return f"<Origin {self.vehicle.name} over {self.cycle.name}: {self.date}, halfshaft {self.versions.get('halfshaft', '?')}>"

    def plain(self) -> dict[str, Any]:
        """Return what JSON can hold."""
        parts = {role: part._asdict() for role, part in self.parts.items()}
        texts = {"vehicle": self.vehicle._asdict(), "cycle": self.cycle._asdict(), "parts": parts}
        return {**self.__dict__, **texts, "ratings": self.ratings._asdict()}

    def rebuilt(self) -> Vehicle:
        """Return the vehicle, made again of the texts; its powertrain must be installed."""
        with tempfile.TemporaryDirectory() as folder:
            data = tomlkit.parse(self.vehicle.text)
            data["parts"] = {role: f"{role}/{part.name}.toml" for role, part in self.parts.items()}
            for role, part in self.parts.items():
                Path(folder, role).mkdir()
                Path(folder, role, f"{part.name}.toml").write_text(part.text, encoding="utf-8")
            path = Path(folder, f"{self.vehicle.name}.toml")
            path.write_text(tomlkit.dumps(data), encoding="utf-8")
            return Vehicle.load(path)

    @classmethod
    def of_plain(cls, plain: Mapping[str, Any]) -> Origin:
        """Return what `plain` gave."""
        texts = {"vehicle": Text(**plain["vehicle"]), "cycle": Text(**plain["cycle"])}
        parts = {role: Text(**part) for role, part in plain["parts"].items()}
        return cls(**{**plain, **texts, "parts": parts, "ratings": Ratings(**plain["ratings"])})


@dataclass(frozen=True, eq=False)
class Made:
    """Vehicle, cycle and time [s since 1970] of a run that was just made; the rest of its origin is worked out when asked for."""

    vehicle: Vehicle
    cycle: Cycle
    time: float

    @property
    def notes(self) -> tuple[str, ...]:
        """What is doubtful about vehicle and cycle."""
        return (*self.vehicle.notes, *self.cycle.doubts)

    @cached_property
    def ratings(self) -> Ratings:
        """What the vehicle's batteries and motors are rated at."""
        rated = {role: p.ratings() for role, p in self.vehicle.parameters.items()}
        energies, powers = ({role: r[what] for role, r in rated.items() if what in r} for what in ("energy", "traction power"))
        return Ratings(sum(energies.values()) if energies else None, sum(powers.values()) if powers else None, energies)

    @property
    def date(self) -> str:
        """When the run was made, UTC."""
        return datetime.fromtimestamp(self.time, UTC).isoformat(timespec="seconds")

    @property
    def machine(self) -> str:
        """Operating system and processor."""
        return machine()

    @cached_property
    def origin(self) -> Origin:
        """What the run was made of, in full."""
        return Origin(
            vehicle=vehicle_text(self.vehicle),
            cycle=_cycle(self.cycle),
            parts={role: part_text(part) for role, part in self.vehicle.parts.items()},
            date=self.date,
            machine=self.machine,
            versions=versions(),
            ratings=self.ratings,
        )


class Hashes(Mapping[str, str]):
    """Hashes of the cycle and of all parts by role, worked out when asked for."""

    def __init__(self, made: Made) -> None:
        self._made = made

    def __getitem__(self, name: str) -> str:
        """Return one hash."""
        return (self._made.origin.cycle if name == "cycle" else self._made.origin.parts[name]).sha256

    def __iter__(self) -> Iterator[str]:
        """Yield ``cycle`` and the roles."""
        return iter(("cycle", *self._made.vehicle.parts))

    def __len__(self) -> int:
        """Return how many there are."""
        return 1 + len(self._made.vehicle.parts)


@lru_cache(maxsize=16)
def _cycle(cycle: Cycle) -> Text:
    return _text("cycle", cycle, _csv(cycle))


def machine() -> str:
    """Return operating system and processor."""
    return f"{platform.system()} {platform.release()} {platform.machine()}"


@cache
def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that make the numbers."""
    return {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}}


def vehicle_text(vehicle: Vehicle) -> Text:
    """Return a vehicle as the text of a file."""
    return _text("vehicle", vehicle, vehicle.to_toml())


@lru_cache(maxsize=256)
def part_text(part: ComponentFile) -> Text:
    """Return a component as the text of a file."""
    # Large maps take a tenth of a second to write.
    return _text(part.kind, part, part.to_toml())


def _text(kind: str, named: Any, text: str) -> Text:
    return Text(kind, named.name, named.title, named.source, hashlib.sha256(text.encode()).hexdigest(), text)


def _csv(cycle: Cycle) -> str:
    """Return a cycle as the text of its file; a grade over distance follows as a second one."""
    return "\n".join(filter(None, cycle.texts()))
