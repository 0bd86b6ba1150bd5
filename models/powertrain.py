"""What a powertrain is: roles, what may fill them, what follows from other parts, and the connections.

One file of `halfshaft.models.powertrains` makes one powertrain.  Further ones come from packages that register as entry
points of the group ``halfshaft.powertrains``; vehicles are the files of the folder ``data/vehicles`` of the same packages.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib.resources.abc import Traversable
from types import ModuleType
from typing import Any

from halfshaft.library.base.component import Component
from halfshaft.library.base.errors import InputError, nearest
from halfshaft.library.files.catalog import component_kinds, data_files, modules, packages
from halfshaft.models.model import Model
from halfshaft.models.rules import Rule, Sets

#: Names of powertrains and roles.
NAME = re.compile("[a-z][a-z0-9]*(_[a-z0-9]+)*")


@dataclass(frozen=True)
class Derived:
    """A parameter that may follow from other parts.

    ``target`` is ``role.parameter``; ``rules`` are those that can derive it; the first derives it where a vehicle says nothing
    and the part's file leaves it open.  ``of`` gives the roles of the parts that a rule looks at, where they are not called as
    the rule calls them.
    """

    target: str
    rules: tuple[type[Rule], ...]
    of: Mapping[str, str] = field(default_factory=dict)

    @property
    def role(self) -> str:
        """The role that has the parameter."""
        return self.target.partition(".")[0]

    @property
    def parameter(self) -> str:
        """The parameter."""
        return self.target.partition(".")[2]

    def value(self, rule: Rule, sets: Sets) -> Any:
        """Return what a rule derives from the parameters by role."""
        needs = [role for role in sets if role != self.role] if rule.needs is None else rule.needs
        return rule({name: sets[self.of.get(name, name)] for name in needs})


@dataclass(frozen=True)
class Powertrain:
    """A powertrain: ``roles`` lists from the wheel to the source what kinds, or families of kinds, may fill each role.

    ``hybridisation`` is for powertrains whose engine reaches the wheels beside a motor.  A sizing may then share between the two what
    the engine needs more for full acceleration than for a grade: 0 leaves it all to the engine, 1 to motor and store.  Without it
    the motor drives with the power of both engine and store, and the engine is sized for the grade.

    Raises
    ------
    InputError
        If a name is none that C, FMI and files can all use, or something is derived for a role that there is not.

    """

    name: str
    title: str
    roles: Mapping[str, tuple[str, ...]]
    connect: Callable[[Model], None]
    derived: tuple[Derived, ...] = ()
    hybridisation: float | None = None

    def __post_init__(self) -> None:
        """Check the names, and the share."""
        problems = [
            f"{name!r} must be of lower-case words with _ between them" for name in (self.name, *self.roles) if not NAME.fullmatch(name)
        ]
        problems += [f"{d.target} is derived, but there is no role {d.role}" for d in self.derived if d.role not in self.roles]
        if self.hybridisation is not None and not 0 <= self.hybridisation <= 1:
            problems.append(f"hybridisation = {self.hybridisation:g}, must be >= 0 and <= 1")
        if problems:
            raise InputError(f"powertrain '{self.name}'", problems)

    def misfits(self) -> list[str]:
        """Return what roles take that is no kind or family of components."""
        known = {*component_kinds(), *(cls.family for cls in component_kinds().values())}
        taken = [(role, kind) for role, kinds in self.roles.items() for kind in kinds]
        return [f"role {role} takes {kind}, which is no kind or family{nearest(kind, known)}" for role, kind in taken if kind not in known]

    def kinds(self, role: str) -> list[str]:
        """Return the kinds that may fill a role."""
        return [kind for kind, cls in component_kinds().items() if kind in self.roles[role] or cls.family in self.roles[role]]

    def derivable(self, role: str) -> list[str]:
        """Return the parameters of a role that may follow from other parts."""
        return [d.parameter for d in self.derived if d.role == role]

    def model(self, parts: Mapping[str, Component]) -> Model:
        """Return the model that parts make."""
        model = Model(self.name, parts)
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
    for name, powertrain in found.items():
        if misfits := powertrain.misfits():
            raise InputError(f"powertrain '{name}'", misfits)
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
