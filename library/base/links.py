"""Chains of links: the physics once, and every use of it derived.

A *link* is a law from the load point to the source point, and the rule for the way back.  A `TwoSided` component is a
chain of links between its two ports.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, ClassVar, Literal, NamedTuple, TypeAlias

from halfshaft.library.base.component import ROTOR, Assumed, Component, Face, Variable, arguments
from halfshaft.library.base.errors import InputError
from halfshaft.library.base.expressions import where
from halfshaft.library.base.ports import Expr, Port, Shaft


class Books(NamedTuple):
    """Powers that the links of a way take [W]: lost, stored in rotors, error of difference quotients, speed mismatch."""

    loss: Expr
    kinetic: Expr
    discretisation: Expr
    mismatch: Expr


#: Links with the points asked and sent.
Way: TypeAlias = tuple[tuple["Link", Any, Any], ...]


class Link(NamedTuple):
    """One law on the way from the wheel to the source.

    ``law`` maps the load point to the source point: the physics.  ``back`` gives the delivered load point from the
    point asked for, the point sent up, and the point offered from the source.  ``books`` says where the power that
    the link takes goes.  ``limit`` marks a cut that a required point gets and that the way back leaves alone; the
    forward-facing model has its limits elsewhere and skips it.  ``omega`` is the speed at which the law holds, where that is
    not the load point's but an estimate of the one achieved: the power between the two is speed mismatch, not loss.
    """

    law: Callable[[Any], Any]
    back: Callable[[Any, Any, Any], Any]
    books: Literal["loss", "kinetic", ""] = "loss"
    limit: bool = False
    name: str = ""
    omega: Callable[[Any], Expr] | None = None


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


def deliver(link: Link, asked: Any, sent: Any, offered: Any) -> Any:
    """Return what a link delivers on the way back.

    Where the whole of what was sent for is offered, the delivered torque, force or power is the one asked for, to the
    last bit; so nothing is lost to rounding while no limit acts, and a processor need not wait for the way back.
    """
    delivered = link.back(asked, sent, offered)
    if link.limit:
        return delivered
    return delivered._replace(**{delivered._fields[0]: where(offered[0] == sent[0], asked[0], delivered[0])})


def kinetic_rate(J: Expr, before: Expr, after: Expr, dt: Expr) -> Expr:
    """Return the mean rate at which a rotor's kinetic energy changes in a step from one speed to another [W]."""
    return J * (1 / (2 * dt)) * (after**2 - before**2)


def outward(links: Iterable[Link], asked: Any) -> Way:
    """Return the required way from a load point through links."""
    way = []
    for link in links:
        sent = link.law(asked)
        way.append((link, asked, sent))
        asked = sent
    return tuple(way)


def homeward(way: Way, offered: Any, dt: Expr) -> tuple[Any, Books]:
    """Return what comes back through a way, and the powers that its links take."""
    loss, kinetic, error, mismatch = 0, 0, 0, 0
    for link, asked, sent in reversed(way):
        delivered = deliver(link, asked, sent, offered)
        taken = offered.P - delivered.P
        if link.omega is not None:
            moved = delivered.tau * (link.omega(asked) - delivered.omega)
            mismatch, taken = mismatch + moved, taken - moved
        if link.books == "loss":
            loss += taken
        elif link.books == "kinetic":
            J_alpha = sent.tau - asked.tau
            rate = J_alpha * (asked.omega - asked.alpha * dt / 2)
            kinetic, error = kinetic + rate, error + taken - rate
        offered = delivered
    return offered, Books(loss, kinetic, error, mismatch)


def continuous(links: Iterable[Link], point: Any) -> tuple[Any, Books]:
    """Return the source point and the powers in continuous time: no limits, nothing assumed."""
    booked: dict[str, Any] = {"loss": 0, "kinetic": 0}
    for link in links:
        if not link.limit:
            sent = link.law(point)
            if link.books:
                booked[link.books] += sent.P - point.P
            point = sent
    return point, Books(booked["loss"], booked["kinetic"], 0, 0)


class TwoSided(Component):
    """A component between two ports, given by a chain of links from the load to the source.

    Subclasses declare one port toward the wheel and one toward the source and implement `chain`.  From it follow

    * ``required``: the asked point through all links, limits included;
    * ``available``: the offered point back through them, with what ``required`` found (the paper's second assumption);
    * a plant face: the same links without limits and memories, for the forward-facing model.
    """

    #: Whether a link of the chain has a speed of its own.
    estimates: ClassVar[bool] = False

    def chain(self) -> tuple[Link, ...]:
        """Return the links from the wheel's side to the source's side; arguments are injected like a face's."""
        raise NotImplementedError

    def found(self, way: Mapping[str, tuple[Any, Any]]) -> Mapping[str, Any]:
        """Return next values of memories, and variables, from the required way: of each named link the points asked and sent."""
        return {}

    @classmethod
    def sides(cls) -> tuple[Port, Port]:
        """Return the port toward the wheel and the port toward the source."""
        ports = cls.ports().values()
        return next(p for p in ports if p.side == "wheel"), next(p for p in ports if p.side == "source")

    def all_variables(self) -> tuple[Variable, ...]:
        """Return the declared variables, the booked powers and the named links."""
        books = [Variable("P_loss", "W", "power lost", "loss")]
        books += ROTOR if self.turns() else ()
        if self.estimates:
            books.append(Variable("P_mismatch", "W", "power at the estimated speed less that at the required one", "mismatch"))
        return (*self.variables, *books)

    def faces(self) -> Iterator[Face]:
        """Yield the two derived faces and the declared ones."""
        load, source = self.sides()
        takes, optional = arguments(self.chain)
        rotor = ("P_kinetic", "P_discretisation") if self.turns() else ()
        booked = ("P_loss", *rotor, *(("P_mismatch",) if self.estimates else ()))
        declared = {g for other in super().faces() for g in other.gives} | {"_way"}
        names = tuple(v.name for v in self.variables if v.name not in declared)

        def required(**x: Any) -> Mapping[str, Any]:
            asked = x.pop(load.name)
            way = outward(self.chain(**x), asked)
            if not self.turns() and any(link.books == "kinetic" for link, *_ in way):
                raise InputError(type(self).__name__, ["has an inertia among its links; its parameter must be called J"])
            named = {}
            for link, _, sent in way:
                fields = {f"{k}_{link.name}": v for k, v in sent._asdict().items()} if link.name else {}
                named.update({k: v for k, v in fields.items() if k in names})
            passed = {link.name: (asked, sent) for link, asked, sent in way if link.name}
            return {source.name: way[-1][2] if way else asked, "_way": way, **named, **self.found(passed)}

        def available(**x: Any) -> Mapping[str, Any]:
            delivered, books = homeward(x["_way"], x[source.name], x["dt"])
            return {load.name: delivered, **{name: getattr(books, name.removeprefix("P_")) for name in booked}}

        memory = tuple(f"next_{s.name}" for s in self.states if f"next_{s.name}" not in declared)
        yield Face("required", (load.name, *takes), optional, (source.name, "_way", *names, *memory), required)
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
            asked = x.pop(load.name)
            point, booked = continuous(self.chain(**x), asked)
            return {source.name: point, **{name: getattr(booked, name.removeprefix("P_")) for name in books}}

        yield Face("flow", (load.name, *takes), optional, (source.name, *books), flow)

    def audit_faces(self) -> Iterator[Face]:
        """Yield the law and the audit: the chain, without limits, from the point delivered to the power that came for it."""
        yield from (f for f in super().audit_faces() if f.name == "law")
        load, source = self.sides()
        takes, optional = arguments(self.chain)
        rotor = ("P_kinetic", "P_discretisation") if self.turns() else ()

        def audit(**x: Any) -> Mapping[str, Any]:
            point, came = x.pop(load.name), x.pop(source.name)
            inertia_power = sum(x.pop(name) for name in rotor)
            links = self.chain(**x)
            if rotor:
                per_alpha = continuous(links, point._replace(alpha=1))[1].kinetic
                point = point._replace(alpha=where(per_alpha != 0, inertia_power / where(per_alpha != 0, per_alpha, 1), 0))
            return {"_audit": {"law": Assumed(came.P - continuous(links, point)[0].P)}}

        yield Face("audit", (load.name, source.name, *rotor, *takes), optional, ("_audit",), audit)
