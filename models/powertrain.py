"""What a powertrain is: roles, what may fill them, what follows from other parts, and the connections.

One file of `halfshaft.models.powertrains` makes one powertrain.  Further ones come from packages that register as entry
points of the group ``halfshaft.powertrains``; vehicles are the files of the folder ``data/vehicles`` of the same packages.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources.abc import Traversable
from types import ModuleType

from halfshaft.library.base.component import Component
from halfshaft.library.base.errors import InputError
from halfshaft.library.files.catalog import KINDS, data_files, modules, packages
from halfshaft.models.model import Model
from halfshaft.models.rules import Rule


@dataclass(frozen=True)
class Derived:
    """A parameter that may follow from other parts.

    ``target`` is ``role.parameter``; ``rules`` are those that can derive it; the first derives it where a vehicle says nothing
    and the part's file leaves it open.
    """

    target: str
    rules: tuple[type[Rule], ...]

    @property
    def role(self) -> str:
        """The role that has the parameter."""
        return self.target.partition(".")[0]

    @property
    def parameter(self) -> str:
        """The parameter."""
        return self.target.partition(".")[2]


@dataclass(frozen=True)
class Powertrain:
    """A powertrain: ``roles`` lists from the wheel to the source what kinds, or families of kinds, may fill each role."""

    name: str
    title: str
    roles: Mapping[str, tuple[str, ...]]
    connect: Callable[[Model], None]
    derived: tuple[Derived, ...] = ()

    def kinds(self, role: str) -> list[str]:
        """Return the kinds that may fill a role."""
        return [kind for kind, cls in KINDS.items() if kind in self.roles[role] or cls.family in self.roles[role]]

    def derivable(self, role: str) -> list[str]:
        """Return the parameters of a role that may follow from other parts."""
        return [d.parameter for d in self.derived if d.role == role]

    def model(self, parts: Mapping[str, Component]) -> Model:
        """Return the model that parts make."""
        # A name of functions in C, too.
        model = Model(self.name.replace("-", "_"), parts)
        self.connect(model)
        return model


def sources() -> tuple[ModuleType, ...]:
    """Return the packages that bring powertrains and vehicles."""
    return packages("halfshaft.powertrains", "halfshaft.models.powertrains")


@cache
def powertrains() -> dict[str, Powertrain]:
    """Return the powertrains by name."""
    found: dict[str, Powertrain] = {}
    for module in (module for package in sources() for module in modules(package)):
        for value in vars(module).values():
            if isinstance(value, Powertrain) and found.setdefault(value.name, value) is not value:
                raise InputError(f"powertrain '{value.name}'", [f"stands twice, a second time in {module.__name__}; rename one"])
    return dict(sorted(found.items()))


@cache
def vehicle_files() -> dict[str, Traversable]:
    """Return the files of the library's vehicles by name."""
    found: dict[str, Traversable] = {}
    for path in (path for package in sources() for path in data_files(package, "vehicles")):
        name = path.name.removesuffix(".toml")
        if found.setdefault(name, path) is not path:
            raise InputError(f"vehicle '{name}'", [f"stands twice in the library: {found[name]} and {path}; rename one"])
    return dict(sorted(found.items()))
