"""Finds the order in which the faces of a model's parts are computed.

Every face names what it takes and gives (`halfshaft.library.base.component`).  Here the names are resolved to their makers and
the faces sorted; all that cannot be resolved is reported at once, and a loop that no memory breaks is refused with the
names of the faces in it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields
from functools import cached_property, partial
from typing import Any, NamedTuple, get_args

from halfshaft.library.base.component import Booking, Component, Face, From, arguments
from halfshaft.library.base.errors import WiringError, nearest
from halfshaft.library.base.links import TwoSided
from halfshaft.library.base.parameters import spec_of
from halfshaft.library.base.tags import Tag
from halfshaft.library.files.catalog import component_kinds
from halfshaft.models.model import Model

#: Where a value lives: what it is, the part that it belongs to (empty for the model's own), its name.
Key = tuple[str, str, str]

REQUESTS = ("v_request", "grade", "key_on", "dt", "decided")
LAWS = ("turning", "direction")
#: Lines of the energy account, and what results ask of a part that books fuel.
BOOKED = [line for line in get_args(Booking) if line]
FUEL: tuple[Tag, ...] = ("fuel mass", "fuel density", "fuel heating value")


class Each(NamedTuple):
    """Where the values live that are read of each of several parts."""

    keys: tuple[Key, ...]


class Tried(NamedTuple):
    """What signals would be, were something else asked at a port: the place of what is asked, and those of the signals."""

    asked: Key
    signals: Mapping[str, Key]


class Unread(NamedTuple):
    """Why a signal cannot be read; of no matter where no face takes it."""

    problems: list[str]


class Published(NamedTuple):
    """A signal of a part: where its value lives, and its unit."""

    key: Key
    unit: str


@dataclass(frozen=True)
class Bound:
    """A face of a part with its names resolved."""

    part: str
    face: Face
    takes: Mapping[str, Key | Each | Tried]
    gives: Mapping[str, Key]

    def __str__(self) -> str:
        """Return ``part.face``."""
        return f"{self.part}.{self.face.name}"

    def needs(self) -> Iterator[tuple[str, Key]]:
        """Yield every name that the face takes with its place."""
        for name, place in self.takes.items():
            if isinstance(place, Tried):
                continue  # What a trial needs follows from what is asked in it.
            yield from ((name, key) for key in (place.keys if isinstance(place, Each) else (place,)))


class Wiring:
    """All faces of a model with their names resolved; the parts that are `free` obey commands.

    Raises
    ------
    WiringError
        With everything that does not fit, both ends named.

    """

    def __init__(self, model: Model, parts: Mapping[str, Component], free: Collection[str] = ()) -> None:
        self.model, self.parts = model, parts
        problems = model.check()
        self.published = {name: self.signals_of(name, part) for name, part in parts.items()}
        self._shapes(problems)
        self.states = {name: self.states_of(part) for name, part in parts.items()}
        self._ends: dict[tuple[str, str], tuple[str, str]] = {}
        for c in model.connections:
            self._ends[c.load, c.load_port.name] = self._ends[c.supply, c.supply_port.name] = (c.supply, c.supply_port.name)
        self.read = {name: self._reads(name, part, problems) for name, part in parts.items()}
        self.faces = [self._bind(name, face, problems) for name, part in parts.items() for face in self.faces_of(part)]
        commanded = [self._bind(name, face, problems) for name in parts if name in free for face in parts[name].commanded_faces()]
        # What obeys commands stands in place of the law.
        self.maker = self._makers(problems) | {key: bound for bound in commanded for key in bound.gives.values()}
        self.faces += commanded
        self.finish(problems)
        if problems:
            raise WiringError(model.name, problems)

    def states_of(self, part: Component) -> set[str]:
        """Return the names of a part's states in this wiring."""
        return {s.name for s in part.states}

    def signals_of(self, name: str, part: Component) -> dict[str, Published]:
        """Return what a part publishes."""
        found = {v.name: Published(("variable", name, v.name), v.unit) for v in part.all_variables() if v.signal}
        found |= {s.name: Published(("law", name, s.name), s.unit) for s in part.signals}
        found |= {s.name: Published(("state", name, s.name), s.unit) for s in part.states if s.signal}
        return found | {f"next_{s.name}": Published(("next", name, s.name), s.unit) for s in part.states if s.signal}

    def _reads(self, name: str, part: Component, problems: list[str]) -> dict[str, Key | Each | Tried | Unread | None]:
        """Return the place of everything that a part reads of others; None of what may be absent and is."""
        found: dict[str, Key | Each | Tried | Unread | None] = {}
        bound = self.model.bindings.get(name, {})
        named = {source.owner for source in part.reads}
        problems += [
            f"{name} is bound to a {owner}, of which it reads nothing{nearest(owner, named)}" for owner in bound if owner not in named
        ]
        # One owner is one part: what may be absent is read of the part that gives the rest.
        known = dict(bound)
        for source in sorted(part.reads, key=lambda source: source.optional):
            slips: list[str] = []
            if source.owner in known and known[source.owner] is None:
                if not source.optional:
                    slips.append(f"{name} is bound to no {source.owner}, of which it must read {', '.join(source.arguments)}")
                found |= dict.fromkeys(source.arguments, Unread(slips) if slips else None)
                continue
            owners = self._owners(name, source, known.get(source.owner), slips)
            if len(owners) == 1 and not source.each:
                known.setdefault(source.owner, owners[0])
            if slips:
                found |= dict.fromkeys(source.arguments, Unread(slips))
            elif source.each:
                found |= {signal: Each(tuple(self.published[owner][signal].key for owner in owners)) for signal in source.signals}
            elif owners:
                (owner,) = owners
                published = {signal: self.published[owner][signal] for signal in source.signals}
                problems += [
                    f"{name} reads the signal {signal} in {source.signals[signal]}, {owner} publishes it in {given}"
                    for signal, (_, given) in published.items()
                    if given != source.signals[signal]
                ]
                places = {signal: key for signal, (key, _) in published.items()}
                if source.tried:
                    found[source.owner] = Tried(("required", *self._ends[name, source.along[0]]), places)
                else:
                    found |= places
                if source.interface:
                    found[source.owner] = ("part", owner, "")
            else:
                found |= dict.fromkeys(source.arguments)
        return found

    def _owners(self, name: str, source: From, bound: str | None, problems: list[str]) -> list[str]:
        """Return the part that answers what another reads, or all of them."""
        others = {n: part for n, part in self.parts.items() if n != name}
        if source.interface:
            fitting = [n for n, part in others.items() if isinstance(part, source.interface)]
            what = f"{source.owner} ({source.interface.__name__})"
        else:
            fitting = [n for n in others if source.signals.keys() <= self.published[n].keys()]
            what = f"signal{'s'[: len(source.signals) > 1]} {', '.join(source.signals)} of its {source.owner}"
        if bound is not None:
            if bound not in fitting and not (source.optional and bound in others):
                missing = [] if source.interface or bound not in others else [s for s in source.signals if s not in self.published[bound]]
                why = f"does not publish {', '.join(missing)}" if missing else "is no such part"
                problems.append(f"{name} reads the {what} from {bound}, which {why}")
            return [bound] if bound in fitting else []
        if source.tried:
            fitting = self._along(name, source, fitting)
            if not fitting and not source.optional:
                problems.append(f"{name} reads the {what}, but nothing behind its {source.along[0]} publishes it")
                return []
        if source.each or len(fitting) == 1:
            return fitting
        if fitting:
            near = self._along(name, source, fitting) if source.along else []
            if len(near) != 1:
                problems.append(
                    f"{name} reads the {what}, which {' and '.join(near or fitting)} publish; "
                    f'the powertrain must say which: bind("{name}", {source.owner}=...)'
                )
            return near if len(near) == 1 else []
        if not source.optional:
            self._nobody(name, source, others, problems)
        for signal in source.signals if source.optional else ():
            if signal not in self._publishable:
                problems.append(f"{name} reads the signal {signal}, which no part publishes{nearest(signal, self._publishable)}")
        return []

    def _nobody(self, name: str, source: From, others: Mapping[str, Component], problems: list[str]) -> None:
        """Say what nobody publishes, or that nobody publishes it all."""
        if source.interface:
            problems.append(f"{name} reads of a {source.owner} that is a {source.interface.__name__}, but there is none")
            return
        everything = {signal for n in others for signal in self.published[n]}
        lacking = [signal for signal in source.signals if signal not in everything]
        problems += [f"{name} reads the signal {signal}, which no part publishes{nearest(signal, everything)}" for signal in lacking]
        if not lacking:
            owners = {signal: " and ".join(n for n in others if signal in self.published[n]) for signal in source.signals}
            told = ", ".join(f"{signal} by {owner}" for signal, owner in owners.items())
            problems.append(f"{name} reads signals of one {source.owner}, which no part publishes all: {told}")

    def _along(self, name: str, source: From, fitting: Iterable[str]) -> list[str]:
        """Return the fitting parts that are nearest along the connections."""
        *owner, port = source.along
        start = name
        if owner:
            other = next(s for s in self.parts[name].reads if s.owner == owner[0])
            (start,) = self._owners(name, other, self.model.bindings.get(name, {}).get(other.owner), []) or (name,)
        toward = {(c.load, c.load_port.name): c.supply for c in self.model.connections}
        toward |= {(c.supply, c.supply_port.name): c.load for c in self.model.connections}
        side = self.parts[start].ports()[port].side if port in self.parts[start].ports() else ""
        ends, seen = [(start, port)], {start}
        while ends:
            near = [toward[end] for end in ends if end in toward and toward[end] not in seen]
            if found := [n for n in fitting if n in near]:
                return found
            seen |= set(near)
            ends = [(n, p.name) for n in near for p in self.parts[n].ports().values() if p.side == side]
        return []

    def faces_of(self, part: Component) -> Iterable[Face]:
        """Return the faces of a part that this wiring connects."""
        return part.faces()

    def finish(self, problems: list[str]) -> None:
        """Check that everything taken, and everything declared, is given."""
        for bound in self.faces:
            for name, key in bound.needs():
                if key[0] not in ("state", "request", "command", "law of the model", "part", "unknown") and key not in self.maker:
                    problems.append(f"{bound} takes {name}, but nothing gives {key[1]}.{key[2]} ({key[0]})")
        for name, part in self.parts.items():
            in_plant = {given for face in part.plant_faces() for given in face.gives}
            declared = [("variable", v.name, v.name) for v in part.all_variables()]
            declared += [("law", s.name, s.name) for s in part.signals if s.name not in in_plant]
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
            bookings, tags = {v.booking for v in part.all_variables()}, {s.tag for s in part.states}
            tags |= {spec_of(f).tag for f in fields(part.parameters)}
            unknown = sorted(bookings - set(get_args(Booking)))
            problems += [f"{name} books {line}, which is no line of the energy account{nearest(line, BOOKED)}" for line in unknown]
            untold = [tag for tag in FUEL if tag not in tags] if "fuel" in bookings else []
            if untold:
                problems.append(f"{name} books fuel, but nothing of it is tagged {' or '.join(untold)}")
            read = {argument: source.owner for source in part.reads for argument in source.arguments}
            own = {s.name: "state" for s in part.states} | {v.name: "variable" for v in part.all_variables()}
            own |= {s.name: "signal" for s in part.signals}
            for what, kind in own.items():
                if what in (*REQUESTS, *LAWS) and kind != "variable":
                    problems.append(f"{name} declares the {kind} {what}, which every part can read as the request or law of that name")
                elif what in read:
                    problems.append(f"{name} declares the {kind} {what}, which it reads of its {read[what]}; its own would hide it")

    @cached_property
    def _publishable(self) -> set[str]:
        """Signals that some kind of component publishes, in this model or another; only these may be absent."""
        kinds = {*component_kinds().values(), *(type(part) for part in self.parts.values())}
        variables = {v.name for kind in kinds for v in kind.variables if v.signal}
        states = {s.name for kind in kinds for s in kind.states if s.signal}
        return variables | states | {s.name for kind in kinds for s in kind.signals}

    def _bind(self, part: str, face: Face, problems: list[str]) -> Bound:
        takes: dict[str, Key | Each | Tried] = {}
        gives: dict[str, Key] = {}
        component = self.parts[part]
        ports, laws, states, read = component.ports(), {s.name for s in component.signals}, self.states[part], self.read[part]
        variables = {v.name for v in component.all_variables()}
        unknowns, commands = {u.name for u in component.unknowns}, {c.name for c in component.commands}
        absent = {argument for source in component.reads if source.optional for argument in source.arguments}
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
            elif name in commands:
                takes[name] = ("command", part, name)
            elif name in unknowns:
                takes[name] = ("unknown", part, name)
            elif name in variables:
                takes[name] = ("variable", part, name)
            elif name.startswith("next_") and name[5:] in states:
                takes[name] = ("next", part, name[5:])
            elif name in laws:
                takes[name] = ("law", part, name)
            elif name in LAWS:
                takes[name] = ("law of the model", "", name)
            elif name in read:
                place = read[name]
                if isinstance(place, Unread):
                    problems += [slip for slip in place.problems if slip not in problems]
                elif place is not None:
                    takes[name] = place
                elif name not in face.optional and name in absent:
                    problems.append(f"{part}.{face.name} takes {name}, which may be absent; it must have a default")
            else:
                told = f"{part}.{face.name} takes {name}, which {type(component).__name__} neither has nor reads of another part"
                problems.append(told + nearest(name, [*read, *states, *variables, *ports, *laws, *REQUESTS, *LAWS]))
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
            elif name in variables or any(name == s.name for s in component.states if s.shown):
                # What the step keeps as a state, a plant may work out.
                gives[name] = ("variable", part, name)
            elif name in laws:
                gives[name] = ("law", part, name)
            else:
                problems.append(f"{part}.{face.name} gives {name}, which {type(component).__name__} does not declare")
        return Bound(part, face, takes, gives)

    def evaluate(self, known: Mapping[Key, Any], wanted: Iterable[Key] | None = None, within: tuple[Bound, ...] = ()) -> dict[Key, Any]:
        """Compute all faces, or only those that `wanted` needs, from what is `known`; `within` are the faces that try it.

        Raises
        ------
        WiringError
            If the faces form a loop.

        """
        values: dict[Key, Any] = {("part", name, ""): part for name, part in self.parts.items()} | dict(known)
        done: set[int] = set()

        def value(place: Key | Each | Tried, bound: Bound) -> Any:
            if isinstance(place, Tried):
                return partial(tried, place, bound)
            return tuple(values[key] for key in place.keys) if isinstance(place, Each) else values[place]

        def tried(place: Tried, bound: Bound, asked: Any) -> dict[str, Any]:
            # Whoever tries goes before whoever asks, so what is known by now does not depend on what is asked.
            found = self.evaluate(values | {place.asked: asked}, place.signals.values(), (*within, bound))
            return {signal: found[key] for signal, key in place.signals.items()}

        def need(key: Key, path: tuple[Bound, ...]) -> None:
            if key not in values:
                run(self.maker[key], path)

        def run(bound: Bound, path: tuple[Bound, ...]) -> None:
            if id(bound) in done:
                return
            if bound in path:
                loop = " -> ".join(str(b) for b in (*path[path.index(bound) :], bound))
                raise WiringError(self.model.name, [f"undeclared loop, a memory must break it: {loop}"])
            for _, key in bound.needs():
                need(key, (*path, bound))
            given = bound.face.run(**{name: value(place, bound) for name, place in bound.takes.items()})
            if given.keys() != bound.gives.keys():
                lost, surplus = sorted(bound.gives.keys() - given.keys()), sorted(given.keys() - bound.gives.keys())
                slips = [f"{bound} returns no {name}, which it declares to give" for name in lost]
                slips += [f"{bound} returns {name}, which it does not declare to give" for name in surplus]
                raise WiringError(self.model.name, slips)
            for name, key in bound.gives.items():
                if self.maker[key] is bound:
                    values.setdefault(key, given[name])
            done.add(id(bound))

        if wanted is None:
            for bound in self.faces:
                run(bound, within)
        else:
            for key in wanted:
                need(key, within)
        return values

    def start(self) -> dict[Key, Any]:
        """Return the start value of every state."""
        laws = [key for key, bound in self.maker.items() if key[0] == "law" and bound.face.name == "law"]
        values = self.evaluate({}, laws)
        waiting, problems = dict(self.parts), list[str]()
        wanted = {name: self._starting(name, part, problems) for name, part in self.parts.items()}
        while waiting and not problems:
            ready = [name for name in waiting if all(key in values for key in wanted[name].values())]
            if not ready:
                problems.append(f"start values form a loop: {', '.join(waiting)}")
            for name in ready:
                part = waiting.pop(name)
                given = part.start(**{argument: values[key] for argument, key in wanted[name].items()})
                problems += [f"{name}.start gives no {s.name}" for s in part.states if s.name not in given]
                values |= {("state", name, s.name): given.get(s.name, 0.0) for s in part.states}
        if problems:
            raise WiringError(self.model.name, problems)
        return values

    def _starting(self, name: str, part: Component, problems: list[str]) -> dict[str, Key]:
        """Return the places of what the start values of a part depend on."""
        found: dict[str, Key] = {}
        takes, optional = arguments(part.start)
        for argument in takes:
            key = self.read[name].get(argument)
            if isinstance(key, tuple) and not isinstance(key, Each | Tried | Unread) and key[0] in ("state", "law", "part"):
                found[argument] = key
            elif argument not in optional:
                told = f"{name}.start reads {argument}, which is no state and no law of a part that it reads of"
                problems.append(told + nearest(argument, self.read[name]))
        return found
