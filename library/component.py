"""What a component is: parameters, ports, states, and faces.

A *face* is one of a component's computations in a step.  It names what it takes by its arguments and what it gives in
its decorator; the assembler (`halfshaft.models`) finds the order.  An argument is

* a port: what arrives there, the *required* point at a port toward the wheel, the *available* one at a port toward the source;
* a state or memory of the component, at the start of the step;
* a signal: a request (`v_request`, `grade`, `key_on`, `dt`, `decided`), or a variable or state that one part publishes for all;
* a private hand-over (leading underscore) from another face of the same component.

A face gives ports, variables, signals, private hand-overs, and ``next_x`` for each of its states ``x``.

Most components are a chain of *links* between two ports: see `TwoSided`, which derives every use of the physics from
that one chain.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple, Protocol, TypeAlias

import casadi as ca

from halfshaft.library.parameters import Parameters
from halfshaft.library.ports import Expr, Port, Shaft

Booking: TypeAlias = Literal["", "fuel", "stored", "loss", "kinetic", "potential", "mismatch", "discretisation", "limit"]

#: Signal `turning`: tells of a speed whether something moves, as 0 or 1 in the step and smoothly in the forward-facing model.
Turning: TypeAlias = Callable[[Any], Any]


class Direction(Protocol):
    """Signal `direction`: how a loss depends on whether a torque drives or brakes; smooth in the forward-facing model."""

    def size(self, tau: Any) -> Any:
        """Return the size of a torque."""

    def loss(self, tau: Any, efficiency: Callable[[Any], Any]) -> Any:
        """Return the torque lost behind an output torque: ``(1 - e) / e`` of it driving, ``1 - e`` braking."""


class Variable(NamedTuple):
    """An output of a component.

    ``booking`` says what a power is to the energy account; ``signal`` publishes the variable to all other parts.
    """

    name: str
    unit: str
    doc: str
    booking: Booking = ""
    signal: bool = False
    kind: Literal["real", "flag", "count"] = "real"


class State(NamedTuple):
    """A state or memory of a component.

    ``signal`` publishes its value at the start of the step; ``shown`` makes its end value an output; ``decision`` says
    that it holds a control's decision: where the request ``decided`` is 1, the control keeps what stands there.
    """

    name: str
    unit: str
    doc: str
    signal: bool = False
    shown: bool = False
    decision: bool = False


class Face(NamedTuple):
    """One computation of a component."""

    name: str
    takes: tuple[str, ...]
    optional: Mapping[str, Any]
    gives: tuple[str, ...]
    run: Callable[..., Mapping[str, Any]]


def face(*gives: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Mark a method as a face that gives the named things."""

    def mark(method: Callable[..., Any]) -> Callable[..., Any]:
        method._gives = gives  # type: ignore[attr-defined]
        return method

    return mark


def plant(*gives: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Mark a method as a face of the forward-facing model.

    It gives ports, variables, private hand-overs, ``der_x`` for each plant state ``x``, and ``balance``: what is zero
    when the component delivers the torque that the motion needs.  What it reads and no plant face gives is a variable
    of the step, held between the samples of the controls.
    """

    def mark(method: Callable[..., Any]) -> Callable[..., Any]:
        method._plant_gives = gives  # type: ignore[attr-defined]
        return method

    return mark


def arguments(method: Callable[..., Any]) -> tuple[tuple[str, ...], dict[str, Any]]:
    """Return the argument names of a bound method and the defaults of those that may be absent."""
    found = inspect.signature(method).parameters.values()
    return tuple(a.name for a in found), {a.name: a.default for a in found if a.default is not inspect.Parameter.empty}


@dataclass(frozen=True)
class Component:
    """Base of all components; subclasses declare ports as class attributes and faces as methods."""

    p: Any
    parameters: ClassVar[type[Parameters]]
    states: ClassVar[tuple[State, ...]] = ()
    variables: ClassVar[tuple[Variable, ...]] = ()
    #: States of the forward-facing model; each stands for the step's state or memory named last.
    plant_states: ClassVar[tuple[tuple[State, str], ...]] = ()
    #: What the component publishes to all others besides numbers: functions of its own parameters.
    laws: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def ports(cls) -> dict[str, Port]:
        """Return the ports by name."""
        return {n: v for c in reversed(cls.__mro__) for n, v in vars(c).items() if isinstance(v, Port)}

    def all_variables(self) -> tuple[Variable, ...]:
        """Return the declared variables and those that a subclass derives."""
        return self.variables

    def faces(self) -> Iterator[Face]:
        """Yield the faces."""
        for name in dir(type(self)):
            gives = getattr(getattr(type(self), name), "_gives", None)
            if gives is not None and name != "start":
                method = getattr(self, name)
                takes, optional = arguments(method)
                yield Face(name, takes, optional, gives, method)

    def plant_faces(self) -> Iterator[Face]:
        """Yield the faces of the forward-facing model, laws included."""
        for name in dir(type(self)):
            method = getattr(type(self), name)
            gives = getattr(method, "_plant_gives", getattr(method, "_gives", None) if name == "law" else None)
            if gives is not None:
                takes, optional = arguments(getattr(self, name))
                yield Face(name, takes, optional, gives, getattr(self, name))

    def start(self) -> Mapping[str, Any]:
        """Return the start value of each state; arguments may name signals that are states of other parts."""
        return dict.fromkeys((s.name for s in self.states), 0.0)


class Link(NamedTuple):
    """One law on the way from the wheel to the source.

    ``law`` maps the load point to the source point: the physics.  ``back`` gives the delivered load point from the
    point asked for, the point sent up, and the point offered from the source.  ``books`` says where the power that
    the link takes goes.  ``limit`` marks a cut that a required point gets and that the way back leaves alone; the
    forward-facing model has its limits elsewhere and skips it.
    """

    law: Callable[[Any], Any]
    back: Callable[[Any, Any, Any], Any]
    books: Literal["loss", "kinetic", ""] = "loss"
    limit: bool = False
    name: str = ""


def limit(cut: Callable[[Any], Any], name: str = "") -> Link:
    """Return a link that cuts the required point and lets the available one pass."""
    return Link(cut, lambda asked, sent, offered: offered, "", True, name)


def drag(tau: Expr | Callable[[Shaft], Expr]) -> Link:
    """Return a torque loss at constant speed; the same torque is lost on the way back."""

    def law(load: Shaft) -> Shaft:
        return load._replace(tau=load.tau + (tau(load) if callable(tau) else tau))

    def back(asked: Shaft, sent: Shaft, offered: Shaft) -> Shaft:
        return offered._replace(tau=offered.tau - (sent.tau - asked.tau))

    return Link(law, back)


def inertia(J: Expr) -> Link:
    """Return the torque that accelerates a rotor, ``J alpha``; on the way back it is the required one (eq. 5 and 11)."""

    def law(load: Shaft) -> Shaft:
        return load._replace(tau=load.tau + J * load.alpha)

    def back(asked: Shaft, sent: Shaft, offered: Shaft) -> Shaft:
        return offered._replace(tau=offered.tau - J * asked.alpha)

    return Link(law, back, "kinetic")


def ratio(i: Expr) -> Link:
    """Return a lossless gear: the source turns ``i`` times as fast as the load."""
    return Link(
        lambda load: Shaft(load.tau / i, load.omega * i, load.alpha * i),
        lambda asked, sent, offered: Shaft(offered.tau * i, offered.omega / i, offered.alpha / i),
        "",
    )


def where(condition: Any, then: Any, otherwise: Any) -> Any:
    """Return one of two values; both are evaluated, so both must be finite."""
    return ca.if_else(condition, then, otherwise)


def clip(x: Any, lowest: Any, highest: Any) -> Any:
    """Return `x` cut to an interval."""
    return ca.fmin(ca.fmax(x, lowest), highest)


class TwoSided(Component):
    """A component between two ports, given by a chain of links from the load to the source.

    Subclasses declare one port toward the wheel and one toward the source and implement `chain`.  From it follow

    * ``required``: the asked point through all links, limits included;
    * ``available``: the offered point back through them, with what ``required`` found (the paper's second assumption);
    * a plant face: the same links without limits and memories, for the forward-facing model.
    """

    def chain(self) -> tuple[Link, ...]:
        """Return the links from the wheel's side to the source's side; arguments are injected like a face's."""
        raise NotImplementedError

    @classmethod
    def turns(cls) -> bool:
        """Return whether the component has a rotor."""
        return "J" in cls.parameters.__dataclass_fields__

    def found(self, way: Any) -> Mapping[str, Any]:
        """Return next values of memories, and variables, from the required way: triples of link, point asked, point sent."""
        return {}

    @classmethod
    def sides(cls) -> tuple[Port, Port]:
        """Return the port toward the wheel and the port toward the source."""
        ports = cls.ports().values()
        return next(p for p in ports if p.side == "wheel"), next(p for p in ports if p.side == "source")

    def all_variables(self) -> tuple[Variable, ...]:
        """Return the declared variables, the booked powers and the named links."""
        books = [Variable("P_loss", "W", "power lost", "loss")]
        if self.turns():
            books.append(Variable("P_kinetic", "W", "rate of change of the rotor's kinetic energy", "kinetic"))
            books.append(Variable("P_discretisation", "W", "inertia work by difference quotients less that rate", "discretisation"))
        return (*self.variables, *books)

    def faces(self) -> Iterator[Face]:
        """Yield the two derived faces and the declared ones."""
        load, source = self.sides()
        takes, optional = arguments(self.chain)
        turns = self.turns()
        declared = {g for other in super().faces() for g in other.gives} | {"_way"}
        names = tuple(v.name for v in self.variables if v.name not in declared)

        def required(**x: Any) -> Mapping[str, Any]:
            asked = x.pop(load.name)
            way, named = [asked], {}
            links = self.chain(**x)
            for link in links:
                way.append(link.law(way[-1]))
                if link.name:
                    named.update({f"{k}_{link.name}": v for k, v in way[-1]._asdict().items()})
            handed = tuple(zip(links, way, way[1:], strict=False))
            return {source.name: way[-1], "_way": handed, **named, **self.found(handed)}

        def available(**x: Any) -> Mapping[str, Any]:
            offered, loss, kinetic, error = x[source.name], 0, 0, 0
            for link, asked, sent in reversed(x["_way"]):
                delivered = link.back(asked, sent, offered)
                taken = offered.P - delivered.P
                if link.books == "loss":
                    loss += taken
                elif link.books == "kinetic":
                    J_alpha = sent.tau - asked.tau
                    rate = J_alpha * (asked.omega - asked.alpha * x["dt"] / 2)
                    kinetic, error = kinetic + rate, error + taken - rate
                offered = delivered
            out = {load.name: offered, "P_loss": loss}
            return {**out, "P_kinetic": kinetic, "P_discretisation": error} if turns else out

        memory = tuple(f"next_{s.name}" for s in self.states)
        yield Face("required", (load.name, *takes), optional, (source.name, "_way", *names, *memory), required)
        booked = ("P_loss", "P_kinetic", "P_discretisation") if turns else ("P_loss",)
        yield Face("available", (source.name, "_way", "dt"), {}, (load.name, *booked), available)
        yield from super().faces()

    def plant_faces(self) -> Iterator[Face]:
        """Yield the chain without limits and memories, in continuous time, where no face of the subclass stands for it."""
        declared = list(super().plant_faces())
        yield from declared
        load, source = self.sides()
        if any(source.name in f.gives for f in declared):
            return
        takes, optional = arguments(self.chain)
        books = ("P_loss", "P_kinetic") if self.turns() else ("P_loss",)

        def flow(**x: Any) -> Mapping[str, Any]:
            point, booked = self.continuous(x.pop(load.name), self.chain(**x))
            return {source.name: point, "P_loss": booked["loss"], "P_kinetic": booked["kinetic"]}

        yield Face("flow", (load.name, *takes), optional, (source.name, *books), flow)

    def continuous(self, load: Any, links: tuple[Link, ...]) -> tuple[Any, dict[str, Any]]:
        """Return the source point and the booked powers in continuous time: no limits, nothing assumed."""
        booked: dict[str, Any] = {"loss": 0, "kinetic": 0}
        point = load
        for link in links:
            if not link.limit:
                sent = link.law(point)
                if link.books:
                    booked[link.books] += sent.P - point.P
                point = sent
        return point, booked
