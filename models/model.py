"""A model: parts and connections.

Reading a model is reading a diagram: there is no arithmetic in it.  Power ports are connected; signals need no lines, but
where several parts could answer what one reads.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

from halfshaft.library.base.component import Component
from halfshaft.library.base.errors import WiringError, nearest
from halfshaft.library.base.ports import Port, PortOf, Side


class Connection:
    """A connection from a port toward the source (of the load) to a port toward the wheel (of the supply)."""

    def __init__(self, load: str, load_port: Port, supply: str, supply_port: Port) -> None:
        self.load, self.load_port, self.supply, self.supply_port = load, load_port, supply, supply_port


class Model:
    """Parts by name, listed from the wheel to the source, and their connections."""

    def __init__(self, name: str, parts: Mapping[str, Component]) -> None:
        self.name = name
        self.parts = dict(parts)
        self.connections: list[Connection] = []
        #: Which part stands for what a part reads from, by the reader and its name for it.
        self.bindings: dict[str, dict[str, str | None]] = {}
        self._problems: list[str] = []
        self._tried: set[tuple[str, str]] = set()
        roles: dict[int, str] = {}
        for part, component in self.parts.items():
            if id(component) in roles:
                self._problems.append(
                    f"{roles[id(component)]} and {part} are one and the same {type(component).__name__}; each needs its own"
                )
            roles[id(component)] = part

    def _place(self, end: PortOf) -> str:
        for name, part in self.parts.items():
            if part is end.component:
                return name
        raise WiringError(self.name, [f"{type(end.component).__name__}.{end.port.name} belongs to no part of this model"])

    def connect(self, one: PortOf, other: PortOf) -> None:
        """Connect two ports, in any order; what does not fit is reported together by `check`."""
        names = {id(end): f"{self._place(end)}.{end.port.name} ({end.port.kind.__name__})" for end in (one, other)}
        self._tried |= {(self._place(end), end.port.name) for end in (one, other)}
        both = f"cannot connect {names[id(one)]} to {names[id(other)]}"
        if one.port.kind is not other.port.kind:
            self._problems.append(f"{both}: the kinds differ")
            return
        if one.port.side == other.port.side:
            side = "the wheel" if one.port.side == "wheel" else "the source"
            self._problems.append(f"{both}: both ports look toward {side}")
            return
        load, supply = (one, other) if one.port.side == "source" else (other, one)
        for end in (one, other):
            for c in self.connections:
                if (self._place(end), end.port) in ((c.load, c.load_port), (c.supply, c.supply_port)):
                    self._problems.append(f"{both}: {names[id(end)]} is connected already")
                    return
        self.connections.append(Connection(self._place(load), load.port, self._place(supply), supply.port))

    def bind(self, reader: str, **owners: str | None) -> None:
        """Say which parts a part reads from, by its own names for them (`From`), where several could be meant, or none should."""
        lost = [name for name in (reader, *owners.values()) if name is not None and name not in self.parts]
        self._problems += [f"{name} is no part of this model{nearest(name, self.parts)}" for name in lost]
        self.bindings.setdefault(reader, {}).update(owners)

    def chain(self, *places: str) -> None:
        """Connect parts one after the other, from the wheel to the source.

        A place is a part by name; ``part.port`` says which of several ports toward the source the chain goes on from, or which
        of several toward the wheel it arrives at.
        """
        for one, other in pairwise(places):
            ends = [self._end(one, "source"), self._end(other, "wheel")]
            if ends[0] and ends[1]:
                self.connect(ends[0], ends[1])

    def _end(self, place: str, side: Side) -> PortOf | None:
        """Return the port of a place in a chain that looks toward a side."""
        name, _, given = place.partition(".")
        if name not in self.parts:
            self._problems.append(f"{name} is no part of this model{nearest(name, self.parts)}")
            return None
        part = self.parts[name]
        if given and given not in part.ports():
            self._problems.append(f"{name} has no port {given}{nearest(given, part.ports())}")
            return None
        ports = [port for port in part.ports().values() if port.side == side]
        named = [port for port in ports if port.name == given]
        if len(named or ports) == 1:
            return PortOf(part, (named or ports)[0])
        several = " and ".join(port.name for port in ports)
        said = f"has the ports toward the {side} {several}; say which" if ports else f"has no port toward the {side}"
        self._problems.append(f"{name} {said}")
        return None

    @property
    def commandable(self) -> tuple[str, ...]:
        """Names of the parts that can obey commands in place of their own law."""
        return tuple(name for name, part in self.parts.items() if part.commands)

    def suffixes(self, c: Connection) -> tuple[str, str]:
        """Return what follows the names of outputs at the load's and at the supply's end, where a part has several ports that way."""
        load = f"_{c.load_port.name}" if sum(other.load == c.load for other in self.connections) > 1 else ""
        return load, f"_{c.supply_port.name}" if sum(other.supply == c.supply for other in self.connections) > 1 else ""

    def check(self) -> list[str]:
        """Return what is wrong with the connections."""
        used = {(c.load, c.load_port.name) for c in self.connections} | {(c.supply, c.supply_port.name) for c in self.connections}
        loose = [
            f"{name}.{port.name} ({port.kind.__name__}) is not connected"
            for name, part in self.parts.items()
            for port in part.ports().values()
            if not port.optional and (name, port.name) not in used | self._tried
        ]
        return [*self._problems, *loose]
