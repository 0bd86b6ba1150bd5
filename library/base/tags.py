"""What an output or a parameter is, whatever its part is called: the words by which everything above the library finds it.

A component tags its variables, states, port fields and parameters with these words.  What runs a vehicle or tells of a run asks
for them, and so finds any number of engines, fuel cells, motors and batteries, in roles of any name.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property
from typing import Literal, Protocol, TypeAlias, get_args

from halfshaft.library.base.errors import InputError, nearest

Tag: TypeAlias = Literal[
    "",
    # Of the one body: its motion, what was asked of it, and what the driver's test needs of it.
    "speed",
    "distance",
    "elevation",
    "request",
    "miss",  # request less achieved speed
    "overspeed",  # the other way round
    "missed",  # whether the previous step missed its request
    "vehicle kinetic power",
    "vehicle climbing power",
    "vehicle mass",
    "gravity",
    "start speed",
    "road load",  # what of air and tyres a measured road load tells
    "miss threshold",
    # Of tyres and brakes.
    "asked force",  # before any limit
    "grip force",  # after the grip limit
    "grip speed",
    "brake force",  # held by a driver who stands
    # Of gears.
    "gear",
    "gear ratios",
    "final ratio",
    "start gear",
    "shift time",
    "hold time",
    "launch share",
    "electric launch speed",
    # Of what burns or converts fuel.
    "fuel mass",
    "fuel density",
    "fuel heating value",
    "engine speed",
    "engine torque",
    # Of what turns, and of what makes electricity or takes it to drive.
    "machine speed",
    "top speed",
    "speed scale",
    "traction input",
    "generated",
    # Of stores.
    "charge",
    "start charge",
    "highest charge",  # that a control aims at
    "lowest charge",
    "empty charge",  # up to which nothing is drawn
    "full charge",  # from which on nothing is stored
    "source rise",
    "depletes",  # whether a control uses the charge up first
    "start temperature",
    "temperature",
    "lowest supply voltage",
    "lowest module voltage",
    "highest module voltage",
    # Of what a sizing changes: factors, and numbers of modules and cells.
    "source size",  # of an engine or a fuel cell
    "follows source",  # grows in proportion with it
    "store size",
    "drive size",
    # Flags whose warning is looked into.
    "grip limit",
    "store limit",
    # What a loss goes into, where the name of its part says too little.
    "air drag",
    "rolling resistance",
    "friction brakes",
    "tyre slip",
    "wheel bearings",
]


class Tagged(Protocol):
    """What has a name and a tag."""

    @property
    def name(self) -> str:
        """Its full name, ``part.own``."""

    @property
    def tag(self) -> str:
        """What it is."""


class Tags(dict[str, str]):
    """Tags by the full names, ``part.own``, of what has one."""

    @classmethod
    def of(cls, *described: Iterable[Tagged]) -> Tags:
        """Return the tags of what is described."""
        return cls({d.name: d.tag for group in described for d in group if d.tag})

    # Each run asks for a dozen of them.
    @cached_property
    def _names(self) -> dict[str, list[str]]:
        found: dict[str, list[str]] = {}
        for name, tag in self.items():
            found.setdefault(tag, []).append(name)
        return found

    def all_of(self, tag: Tag) -> list[str]:
        """Return all names with a tag."""
        return self._names.get(tag, [])

    def by_part(self, tag: Tag) -> dict[str, str]:
        """Return the names with a tag, by their part."""
        return {part_of(name): name for name in self.all_of(tag)}

    def the(self, tag: Tag) -> str:
        """Return the name of the one thing with a tag.

        Raises
        ------
        InputError
            If there is none, or are several.

        """
        found = self.all_of(tag)
        if len(found) != 1:
            raise InputError("tags", [f"one thing must be tagged '{tag}', here {' and '.join(found) or 'nothing'} is"])
        return found[0]


def part_of(name: str) -> str:
    """Return the part that an output or a parameter belongs to."""
    return name.partition(".")[0]


def unknown(described: Iterable[Tagged]) -> list[str]:
    """Return which tags are no words of this file."""
    known = get_args(Tag)
    return [f"{d.name} has the tag '{d.tag}', which is not known{nearest(d.tag, known)}" for d in described if d.tag not in known]
