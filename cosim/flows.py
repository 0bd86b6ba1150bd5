"""Where the energy of a run flowed: between which parts, how much came back, and what each part lost.

A *flow* is a connection of two parts.  What went along it toward the wheels and what came back, while braking or where energy
circles, are told apart where the run kept its time series; without these they are netted.  For each part::

    received + returned to it = delivered + returned by it + losses + rest

where the rest is what is stored in its motion, and its share of the method's own error (`halfshaft.cosim.account`).  Parts that pass
on what they get, whatever it is, are left out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from halfshaft.cosim.result import Result
from halfshaft.library.base.errors import InputError
from halfshaft.library.base.tags import part_of

#: A connection that carries no more than this share of the turnover is left out.
UNUSED = 1e-9
#: A part that loses no more than this share of the turnover, and neither splits nor joins flows, is left out.
NOTHING = 1e-6


class Flow(NamedTuple):
    """Energy [J] that went from `supply` to `load`, toward the wheels, and that came `back`; `carrier` is the kind of port."""

    supply: str
    load: str
    carrier: str
    forth: float
    back: float


@dataclass
class Station:
    """A part: losses by what they are, what came out of its tank or store and went back in, and what else is booked to it [J]."""

    name: str
    losses: dict[str, float] = field(default_factory=dict)
    burnt: float = 0.0
    drawn: float = 0.0
    charged: float = 0.0
    rest: float = 0.0

    @property
    def lost(self) -> float:
        """All that it lost [J]."""
        return sum(self.losses.values())


@dataclass(frozen=True)
class Flows:
    """The flows of a run, from the wheel to the sources, and the parts that they connect, by name."""

    flows: tuple[Flow, ...]
    stations: Mapping[str, Station]
    turnover: float

    def open(self, name: str) -> float:
        """Return what comes into a part but does not leave it [J]; rounding."""
        s = self.stations[name]
        into = sum(f.forth for f in self.flows if f.load == name) + sum(f.back for f in self.flows if f.supply == name)
        out = sum(f.back for f in self.flows if f.load == name) + sum(f.forth for f in self.flows if f.supply == name)
        return into + s.burnt + s.drawn - s.charged - out - s.lost - s.rest


def flows(result: Result) -> Flows:
    """Return where the energy of a run flowed.

    Raises
    ------
    InputError
        If a loaded run does not say what its vehicle was made of, or no energy moved.

    """

    def split(name: str) -> tuple[float, float]:
        """Return the integrals of a power above and below zero; their difference is that of the account."""
        net = float(result.energies[name])
        back = -float(result.dt @ np.minimum(result[name], 0.0)) if result.has_history and len(result.time) else max(-net, 0.0)
        return net + back, back

    model = result.vehicle.model()
    stations = {name: Station(name) for name in model.parts}
    for d in result.outputs:
        at = stations.get(part_of(d.name))
        if at is None or not d.booking:
            continue
        if d.booking == "loss":
            label = result.tags.get(d.name, "loss")
            at.losses[label] = at.losses.get(label, 0.0) + result.energies[d.name]
        elif d.booking == "fuel":
            at.burnt += result.energies[d.name]
        elif d.booking == "stored":
            at.drawn, at.charged = (a + b for a, b in zip((at.drawn, at.charged), split(d.name), strict=True))
        else:
            at.rest += result.energies[d.name]
    found = [
        Flow(c.supply, c.load, c.supply_port.kind.__name__, *split(f"{c.supply}.P_out{model.suffixes(c)[1]}")) for c in model.connections
    ]
    turnover = result.account.turnover
    # An engine that never ran is no part of the picture.
    found = [f for f in found if f.forth + f.back > UNUSED * turnover]
    if not found:
        raise InputError("flows", ["the run moved no energy"])
    for name, s in list(stations.items()):
        own = [f for f in found if name in (f.supply, f.load)]
        into, out = [f for f in own if f.load == name], [f for f in own if f.supply == name]
        idle = max(abs(s.lost), abs(s.rest), s.burnt, s.drawn, s.charged) <= NOTHING * turnover
        if not own:
            del stations[name]
        elif idle and len(into) == len(out) == 1:
            (one,), (other,) = into, out
            found[found.index(other)] = Flow(one.supply, other.load, one.carrier, one.forth, one.back)
            found.remove(one)
            del stations[name]
    return Flows(tuple(found), stations, turnover)
