"""What there is to build from: every component that halfshaft and the packages beside it bring.

A component is found where it stands: in any module of `halfshaft.library`, or of a package that registers as an entry
point of the group ``halfshaft.components``.  Its data are the files of the folder ``data/<kind>`` of the same package.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from importlib.resources import files
from importlib.resources.abc import Traversable
from types import ModuleType

from halfshaft.library.base.component import Component
from halfshaft.library.base.errors import InputError

#: Packages that hold no components.
_OTHER = ("halfshaft.library.base", "halfshaft.library.files")


@cache
def packages(group: str, own: str) -> tuple[ModuleType, ...]:
    """Return the package `own` and those that register as entry points of a group.

    Raises
    ------
    InputError
        If one of them cannot be imported.

    """
    found = [import_module(own)]
    for entry in sorted(entry_points(group=group), key=lambda entry: entry.name):
        try:
            found.append(import_module(entry.value))
        except ImportError as e:
            raise InputError(f"entry point {group} of {entry.dist.name if entry.dist else entry.value}", [str(e)]) from e
    return tuple(found)


def modules(package: ModuleType) -> Iterator[ModuleType]:
    """Yield a package and all modules below it."""
    yield package
    for found in pkgutil.iter_modules(getattr(package, "__path__", ()), f"{package.__name__}."):
        if found.name not in _OTHER:
            yield from modules(import_module(found.name))


def data_files(package: ModuleType, folder: str) -> list[Traversable]:
    """Return the TOML files of a folder below a package's data."""
    root = files(package) / "data" / folder
    return sorted((p for p in root.iterdir() if p.name.endswith(".toml")), key=lambda p: p.name) if root.is_dir() else []


def sources() -> tuple[ModuleType, ...]:
    """Return the packages that bring components."""
    return packages("halfshaft.components", "halfshaft.library")


@cache
def component_kinds() -> dict[str, type[Component]]:
    """Return the kinds of components that a file can name."""
    found: dict[str, type[Component]] = {}
    for module in (module for package in sources() for module in modules(package)):
        for cls in vars(module).values():
            if isinstance(cls, type) and issubclass(cls, Component) and cls.__module__ == module.__name__ and "kind" in vars(cls):
                other = found.setdefault(cls.kind, cls)
                if other is not cls:
                    places = f"{other.__module__} and {cls.__module__}"
                    raise InputError(f"kind '{cls.kind}'", [f"is that of two components, in {places}; rename one"])
    return found
