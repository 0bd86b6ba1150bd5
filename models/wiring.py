"""Finds the order in which the faces of a model's parts are computed.

Every face names what it takes and gives (`halfshaft.library.base.component`).  Here the names are resolved to their makers and the
faces sorted; all that cannot be resolved is reported at once, and a loop that no memory breaks is refused with the
names of the faces in it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from halfshaft.library.base.component import Component, Face, arguments
from halfshaft.library.base.errors import WiringError, nearest
from halfshaft.library.base.links import TwoSided
from halfshaft.library.files.catalog import KINDS
from halfshaft.models.model import Model

#: Where a value lives: what it is, the part that it belongs to (empty for the model's own), its name.
Key = tuple[str, str, str]

REQUESTS = ("v_request", "grade", "key_on", "dt", "decided")
LAWS = ("turning", "direction")


@dataclass(frozen=True)
class Bound:
    """A face of a part with its names resolved."""

    part: str
    face: Face
    takes: Mapping[str, Key]
    gives: Mapping[str, Key]

    def __str__(self) -> str:
        """Return ``part.face``."""
        return f"{self.part}.{self.face.name}"


class Wiring:
    """All faces of a model with their names resolved.

    Raises
    ------
    WiringError
        With everything that does not fit, both ends named.

    """

    def __init__(self, model: Model, parts: Mapping[str, Component]) -> None:
        self.model, self.parts = model, parts
        problems = model.check()
        self.bus = self._signals(problems)
        self._shapes(problems)
        self.states = {name: {s.name for s in part.states} for name, part in parts.items()}
        self._ends: dict[tuple[str, str], tuple[str, str]] = {}
        for c in model.connections:
            self._ends[c.load, c.load_port.name] = self._ends[c.supply, c.supply_port.name] = (c.supply, c.supply_port.name)
        self.faces = [self._bind(name, face, problems) for name, part in parts.items() for face in self.faces_of(part)]
        self.maker = self._makers(problems)
        self.finish(problems)
        if problems:
            raise WiringError(model.name, problems)

    def faces_of(self, part: Component) -> Iterable[Face]:
        """Return the faces of a part that this wiring connects."""
        return part.faces()

    def finish(self, problems: list[str]) -> None:
        """Check that everything taken, and everything declared, is given."""
        for bound in self.faces:
            for name, key in bound.takes.items():
                if key[0] not in ("state", "request", "law of the model") and key not in self.maker:
                    problems.append(f"{bound} takes {name}, but nothing gives {key[1]}.{key[2]} ({key[0]})")
        for name, part in self.parts.items():
            in_plant = {given for face in part.plant_faces() for given in face.gives}
            declared = [("variable", v.name, v.name) for v in part.all_variables()]
            declared += [("law", law, law) for law in part.laws if law not in in_plant]
            declared += [("next", s.name, f"next_{s.name}") for s in part.states]
            lost = [(what, given) for kind, what, given in declared if (kind, name, what) not in self.maker]
            problems += [f"{name} declares {what}, but no face gives {given}" for what, given in lost]

    def _makers(self, problems: list[str]) -> dict[Key, Bound]:
        """Return which face gives what."""
        maker: dict[Key, Bound] = {}
        for bound in self.faces:
            for name, key in bound.gives.items():
                if (first := maker.setdefault(key, bound)) is not bound:
                    problems.append(f"{first} and {bound} both give {name}; one of them must")
        return maker

    def _shapes(self, problems: list[str]) -> None:
        """Check what each part declares, by itself and beside the signals of the others."""
        for name, part in self.parts.items():
            for side in ("wheel", "source") if isinstance(part, TwoSided) else ():
                ports = [p.name for p in part.ports().values() if p.side == side]
                if len(ports) != 1:
                    found = " and ".join(ports) or "no port"
                    problems.append(f"{name} has {found} toward the {side}; a {type(part).__name__} is two-sided and has one")
            own = {s.name: "state" for s in part.states} | {v.name: "variable" for v in part.all_variables()}
            for what, kind in own.items():
                if kind == "state" and what in (*REQUESTS, *LAWS):
                    problems.append(f"{name} declares the state {what}, which every part can read as the request or law of that name")
                elif (owner := self.bus.get(what, ("", name, ""))[1]) not in (name, ""):
                    problems.append(f"{name} declares the {kind} {what}, which is a signal of {owner}; its own would hide it")

    @cached_property
    def _publishable(self) -> set[str]:
        """Signals that some kind of component publishes, in this model or another; only these may be absent."""
        kinds = {*KINDS.values(), *(type(part) for part in self.parts.values())}
        variables = {v.name for kind in kinds for v in kind.variables if v.signal}
        states = {s.name for kind in kinds for s in kind.states if s.signal}
        return variables | states | {law for kind in kinds for law in kind.laws}

    def _signals(self, problems: list[str]) -> dict[str, Key]:
        found: list[tuple[str, Key]] = []
        for name, part in self.parts.items():
            found += [(v.name, ("variable", name, v.name)) for v in part.all_variables() if v.signal]
            found += [(law, ("law", name, law)) for law in part.laws]
            found += [(s.name, ("state", name, s.name)) for s in part.states if s.signal]
            found += [(f"next_{s.name}", ("next", name, s.name)) for s in part.states if s.signal]
        for name, n in Counter(name for name, _ in found).items():
            if n > 1:
                owners = " and ".join(key[1] for other, key in found if other == name)
                # Of several torque envelopes the one nearest to the wheels counts: it is what the gearbox feels.
                if name != "tau_envelope":
                    problems.append(f"the signal {name} is published by {owners}; one part must own it")
        return dict(reversed(found))

    def _bind(self, part: str, face: Face, problems: list[str]) -> Bound:
        takes, gives, ports = {}, {}, self.parts[part].ports()
        laws, states = self.parts[part].laws, self.states[part]
        variables = {v.name for v in self.parts[part].all_variables()}
        for name in face.takes:
            if name.startswith("_"):
                takes[name] = ("private", part, name)
            elif name in ports:
                if (part, name) in self._ends:
                    takes[name] = ("required" if ports[name].side == "wheel" else "available", *self._ends[part, name])
            elif name in states:
                takes[name] = ("state", part, name)
            elif name in REQUESTS:
                takes[name] = ("request", "", name)
            elif name in variables:
                takes[name] = ("variable", part, name)
            elif name.startswith("next_") and name[5:] in states:
                takes[name] = ("next", part, name[5:])
            elif name in laws:
                takes[name] = ("law", part, name)
            elif name in LAWS:
                takes[name] = ("law of the model", "", name)
            elif name in self.bus:
                takes[name] = self.bus[name]
            elif name not in face.optional or name not in self._publishable:
                known = self._publishable if name in face.optional else self.bus
                problems.append(f"{part}.{face.name} reads the signal {name}, which no part publishes{nearest(name, known)}")
        for name in face.gives:
            if name.startswith("_"):
                gives[name] = ("private", part, name)
            elif name in ports:
                if (part, name) in self._ends:
                    gives[name] = ("available" if ports[name].side == "wheel" else "required", *self._ends[part, name])
            elif name.startswith("next_") and name[5:] in states:
                gives[name] = ("next", part, name[5:])
            elif name.startswith("der_") and name[4:] in states:
                gives[name] = ("derivative", part, name[4:])
            elif name == "balance":
                gives[name] = ("balance", part, name)
            elif name in variables or any(name == s.name for s in self.parts[part].states if s.shown):
                # What the step keeps as a state, a plant may work out.
                gives[name] = ("variable", part, name)
            elif name in laws:
                gives[name] = ("law", part, name)
            else:
                problems.append(f"{part}.{face.name} gives {name}, which {type(self.parts[part]).__name__} does not declare")
        return Bound(part, face, takes, gives)

    def evaluate(self, known: Mapping[Key, Any], wanted: Iterable[Key] | None = None) -> dict[Key, Any]:
        """Compute all faces, or only those that `wanted` needs, from what is `known`.

        Raises
        ------
        WiringError
            If the faces form a loop.

        """
        values = dict(known)
        done: set[int] = set()

        def need(key: Key, path: tuple[Bound, ...]) -> None:
            if key not in values:
                run(self.maker[key], path)

        def run(bound: Bound, path: tuple[Bound, ...]) -> None:
            if id(bound) in done:
                return
            if bound in path:
                loop = " -> ".join(str(b) for b in (*path[path.index(bound) :], bound))
                raise WiringError(self.model.name, [f"undeclared loop, a memory must break it: {loop}"])
            for key in bound.takes.values():
                need(key, (*path, bound))
            given = bound.face.run(**{name: values[key] for name, key in bound.takes.items()})
            if given.keys() != bound.gives.keys():
                lost, surplus = sorted(bound.gives.keys() - given.keys()), sorted(given.keys() - bound.gives.keys())
                slips = [f"{bound} returns no {name}, which it declares to give" for name in lost]
                slips += [f"{bound} returns {name}, which it does not declare to give" for name in surplus]
                raise WiringError(self.model.name, slips)
            for name, key in bound.gives.items():
                values.setdefault(key, given[name])
            done.add(id(bound))

        if wanted is None:
            for bound in self.faces:
                run(bound, ())
        else:
            for key in wanted:
                need(key, ())
        return values

    def start(self) -> dict[Key, Any]:
        """Return the start value of every state."""
        laws = [key for key, bound in self.maker.items() if key[0] == "law" and bound.face.name == "law"]
        values = self.evaluate({}, laws)
        waiting, problems = dict(self.parts), list[str]()
        for name, part in self.parts.items():
            unknown = [a for a in arguments(part.start)[0] if self.bus.get(a, ("",))[0] not in ("state", "law")]
            problems += [f"{name}.start reads {a}, which is no state and no law of any part{nearest(a, self.bus)}" for a in unknown]
        while waiting and not problems:
            ready = {name: part for name, part in waiting.items() if all(self.bus[a] in values for a in arguments(part.start)[0])}
            if not ready:
                problems.append(f"start values form a loop: {', '.join(waiting)}")
            for name, part in ready.items():
                given = part.start(**{a: values[self.bus[a]] for a in arguments(part.start)[0]})
                problems += [f"{name}.start gives no {s.name}" for s in part.states if s.name not in given]
                values |= {("state", name, s.name): given.get(s.name, 0.0) for s in part.states}
                del waiting[name]
        if problems:
            raise WiringError(self.model.name, problems)
        return values
