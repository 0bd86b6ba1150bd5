"""Junctions: one port toward the wheel, several toward the source; the split and the sum once, and every use of them derived.

A *junction* asks its sources one after the other, in the order of its ports, and joins what they offer.  A subclass says for
each port what is asked there (`ask_<port>`), and what all of them together give (`join`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import reduce
from typing import Any, ClassVar

import casadi as ca

from halfshaft.library.base.component import ROTOR, Component, Face, Unknown, Variable, arguments
from halfshaft.library.base.expressions import where
from halfshaft.library.base.links import Link, continuous, homeward, outward
from halfshaft.library.base.ports import MEANINGS, UNITS, Electric, Port, Shaft


class Junction(Component):
    """A component between one load and several sources.

    Subclasses declare one port toward the wheel and several toward the source and implement

    * ``ask_<port>`` for each source port that is not marked ``offers``: the point that is asked for there.  Its arguments are
      the load port (what is required), the source ports before it (what they offer), and whatever a face may take;
    * ``join``: the point that the offers make together; its arguments are the load port and all source ports;
    * ``chain``, if links lie between the load port and the split: drag, inertia, a ratio.

    In the forward-facing model a source that ``offers`` decides itself what flows.  Of the others the last gets what is
    left; how much each of those before it takes is an algebraic unknown, for which the source must give a balance.  Where
    kinematics divide further, `free` names the ports that keep an unknown, and plant faces of the subclass give the points.
    """

    def chain(self) -> tuple[Link, ...]:
        """Return the links between the load port and the split; arguments are injected like a face's."""
        return ()

    join: Callable[..., Any]

    #: The source ports whose flows divide freely, where these are not all that are asked but the last.
    free: ClassVar[tuple[str, ...] | None] = None

    def __init_subclass__(cls, **given: Any) -> None:
        """Declare how the flow divides as unknowns."""
        super().__init_subclass__(**given)
        fields = ((port.kind._fields[0], port.name) for port in cls.free_ports())
        own = (Unknown(f"{f}_{name}", UNITS[f], f"{MEANINGS[f]} from {name}") for f, name in fields)
        # A subclass's own subclass has its parent's ports.
        cls.unknowns = tuple(dict.fromkeys((*cls.unknowns, *own)))

    @classmethod
    def load_port(cls) -> Port:
        """Return the port toward the wheel."""
        return next(port for port in cls.ports().values() if port.side == "wheel")

    @classmethod
    def source_ports(cls) -> list[Port]:
        """Return the ports toward the source, in the order in which they are asked."""
        return [port for port in cls.ports().values() if port.side == "source"]

    @classmethod
    def asked_ports(cls) -> list[Port]:
        """Return the source ports that something is asked of."""
        return [port for port in cls.source_ports() if not port.offers]

    @classmethod
    def free_ports(cls) -> list[Port]:
        """Return the source ports that take a share of the flow which only the motion decides."""
        asked = cls.asked_ports()
        return asked[:-1] if cls.free is None else [port for port in asked if port.name in cls.free]

    def all_variables(self) -> tuple[Variable, ...]:
        """Return the declared variables and the booked powers."""
        books = [Variable("P_loss", "W", "power lost", "loss")]
        books += ROTOR if self.turns() else ()
        if self.load_port().kind is not Electric:
            books.append(Variable("P_mismatch", "W", "power that the sources offer less that at the joint's speed", "mismatch"))
        return (*self.variables, *books)

    def _takes(self, *methods: Callable[..., Any]) -> tuple[tuple[str, ...], dict[str, Any]]:
        """Return what methods take besides the load port, and what of it may be absent."""
        takes: dict[str, None] = {}
        optional: dict[str, Any] = {}
        for method in methods:
            names, absent = arguments(method)
            takes |= dict.fromkeys(n for n in names if n != self.load_port().name)
            optional |= absent
        return tuple(takes), optional

    def faces(self) -> Iterator[Face]:
        """Yield the derived faces and the declared ones."""
        load, sources = self.load_port().name, [port.name for port in self.source_ports()]
        takes, optional = arguments(self.chain)

        def required(**x: Any) -> Mapping[str, Any]:
            way = outward(self.chain(**{n: v for n, v in x.items() if n != load}), x[load])
            return {"_way": way, "_split": way[-1][2] if way else x[load]}

        def asking(port: str) -> Face:
            law = getattr(self, f"ask_{port}")
            names, absent = self._takes(law)

            def ask(_split: Any, **x: Any) -> Mapping[str, Any]:
                sent = _called(law, {load: _split} | x)
                return {port: sent, f"_sent_{port}": sent}

            return Face(f"ask_{port}", ("_split", *names), absent, (port, f"_sent_{port}"), ask)

        yield Face("required", (load, *takes), optional, ("_way", "_split"), required)
        yield from (asking(port.name) for port in self.asked_ports())
        names, absent = self._takes(self.join)
        sent = {port.name: f"_sent_{port.name}" for port in self.asked_ports()}
        made_up = {name for port in sent for name in arguments(getattr(self, f"ask_{port}"))[0]} & sent.keys()
        booked = tuple(v.name for v in self.all_variables() if v not in self.variables)

        def available(_way: Any, _split: Any, dt: Any, **x: Any) -> Mapping[str, Any]:
            given = {port: x[port][0] == x.pop(private)[0] for port, private in sent.items()}
            reached = [given[port] for port in given if port not in made_up]
            joined = _called(self.join, {load: _split} | x)
            # Where all sources give what they were asked for, so does the joint, to the last bit; what one of them did not give,
            # those that saw its offer were asked for, unless they must not make it up.
            whole = reduce(ca.logic_and, reached)
            if made_up:
                whole = ca.logic_and(whole, ca.fabs(joined[0] - _split[0]) <= 1e-9 * (1 + ca.fabs(_split[0])))
            joint = joined._replace(**{joined._fields[0]: where(whole, _split[0], joined[0])})
            delivered, books = homeward(_way, joint, dt)
            surplus = sum(x[port].P for port in sources if port in x) - joint.P
            powers = {"P_loss": books.loss, "P_kinetic": books.kinetic, "P_discretisation": books.discretisation}
            powers["P_mismatch" if "P_mismatch" in booked else "P_loss"] = surplus + (0 if "P_mismatch" in booked else books.loss)
            return {load: delivered, **{name: powers[name] for name in booked}}

        private = tuple(dict.fromkeys((*sources, *names, *sent.values())))
        yield Face("available", ("_way", "_split", "dt", *private), absent, (load, *booked), available)
        yield from super().faces()

    def plant_faces(self) -> Iterator[Face]:
        """Yield the split in continuous time, and the declared plant faces."""
        declared = list(super().plant_faces())
        yield from declared
        asked, load = self.asked_ports(), self.load_port().name
        if any(port.name in f.gives for f in declared for port in asked):
            return
        laws = {port.name: getattr(self, f"ask_{port.name}") for port in asked}
        names, optional = self._takes(self.chain, *laws.values())
        own = {port.name for port in asked}
        unknowns = {port.name: f"{port.kind._fields[0]}_{port.name}" for port in self.free_ports()}
        offering = [port.name for port in self.source_ports() if port.offers]
        chain, _ = arguments(self.chain)
        rotor = ("P_kinetic",) if self.turns() else ()

        def flow(**x: Any) -> Mapping[str, Any]:
            split, books = continuous(self.chain(**{n: x[n] for n in chain}), x[load])
            points: dict[str, Any] = {}
            for port, law in laws.items():
                known = {**x, **points, load: split}
                point = _called(law, known)
                points[port] = point._replace(**{point._fields[0]: x[unknowns[port]]}) if port in unknowns else point
            surplus = sum(p.P for p in points.values()) + sum(x[n].P for n in offering if n in x) - split.P
            return {**points, "P_loss": books.loss + surplus, **({"P_kinetic": books.kinetic} if rotor else {})}

        takes = (load, *unknowns.values(), *(n for n in dict.fromkeys((*offering, *names)) if n not in own))
        yield Face("flow", takes, optional, (*laws, "P_loss", *rotor), flow)

    def audit_faces(self) -> Iterator[Face]:
        """Yield the law, and the audit: what came is what went, and what was booked."""
        yield from (f for f in super().audit_faces() if f.name == "law")
        ports = [port.name for port in self.source_ports()]
        booked = tuple(v.name for v in self.all_variables() if v.booking)
        load = self.load_port().name

        def audit(**x: Any) -> Mapping[str, Any]:
            return {"_audit": {"sum": sum(x[p].P for p in ports if p in x) - x[load].P - sum(x[name] for name in booked)}}

        yield Face("audit", (load, *ports, *booked), {}, ("_audit",), audit)


def _called(law: Callable[..., Any], known: Mapping[str, Any]) -> Any:
    """Return what a law gives for those of its arguments that are known."""
    return law(**{n: known[n] for n in arguments(law)[0] if n in known})


def shared_speed(load: Shaft, *turning: Shaft) -> Any:
    """Return the speed of a joint whose parts turn together: that of the slowest."""
    omega = load.omega
    for part in turning:
        omega = ca.fmin(omega, part.omega)
    return omega
