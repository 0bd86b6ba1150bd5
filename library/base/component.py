"""What a component is: parameters, ports, states, and faces.

A *face* is one of a component's computations in a step.  It names what it takes by its arguments and what it gives in
its decorator; the assembler (`halfshaft.models`) finds the order.  An argument is

* a port: what arrives there, the *required* point at a port toward the wheel, the *available* one at a port toward the source;
* a state or memory of the component, at the start of the step;
* a request (`v_request`, `grade`, `key_on`, `dt`, `decided`), or one of the laws of motion `turning` and `direction`;
* a signal of another part, or that part itself seen as an interface, as the component's `reads` declare it;
* a private hand-over (leading underscore) from another face of the same component.

A signal stays with the part that publishes it: two motors may both have a throttle.  Which part a component reads from
follows from what it asks for; where several could answer, the powertrain says which, or the connections do (`From`).

A face gives ports, variables, signals, private hand-overs, and ``next_x`` for each of its states ``x``.

A control's laws can be left out for *commands* from outside: a face marked `commanded` gives from the component's `commands` what a
face of the law gives otherwise.  An optimum is sought so, or a control tried that is no component.

A component may also have a method ``audit``: from what a run recorded at its ports, it tells how far the component's own
laws are from it, each by name as a power [W] or as `Assumed`.  `halfshaft.cosim.audit` says what the arguments are.

Most components are a chain of *links* between two ports: `halfshaft.library.base.links.TwoSided` derives every use of the
physics from that one chain.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, NamedTuple, TypeAlias

from halfshaft.library.base.parameters import Parameters
from halfshaft.library.base.ports import Port
from halfshaft.library.base.tags import Tag

Booking: TypeAlias = Literal["", "fuel", "stored", "loss", "kinetic", "potential", "mismatch", "discretisation", "limit"]


class Variable(NamedTuple):
    """An output of a component.

    ``booking`` says what a power is to the energy account; ``signal`` publishes the variable to all other parts; ``tag`` says
    what it is (`halfshaft.library.base.tags`); ``warning`` is what a run warns of where a flag is up, ``{part}`` being its part.
    """

    name: str
    unit: str
    doc: str
    booking: Booking = ""
    signal: bool = False
    kind: Literal["real", "flag", "count"] = "real"
    tag: Tag = ""
    warning: str = ""


class State(NamedTuple):
    """A state or memory of a component.

    ``signal`` publishes its value at the start of the step; ``shown`` makes its end value an output; ``decision`` says
    that it holds a control's decision: where the request ``decided`` is 1, the control keeps what stands there.
    ``neutral`` stands for it in the forward-facing model, if what the discrete method remembers has no meaning there;
    ``tag`` says what it is.
    """

    name: str
    unit: str
    doc: str
    signal: bool = False
    shown: bool = False
    decision: bool = False
    neutral: float | None = None
    tag: Tag = ""


class Command(NamedTuple):
    """A decision that may come from outside in place of a control's law.

    A ``flag`` is 0 or 1, a ``step`` a whole number, a ``share`` any number from `lowest` to `highest`; kinks of what follows from a share
    lie at whole numbers.  ``needs`` names the flag without which it is of no effect.  ``memory`` is the state that a step moves; ``lasts``
    says of a share that its effect outlasts the step, as a speed of a rotor does.
    """

    name: str
    doc: str
    kind: Literal["flag", "step", "share"]
    lowest: float = 0.0
    highest: float = 1.0
    needs: str = ""
    memory: str = ""
    lasts: bool = False


class Signal(NamedTuple):
    """What a component publishes for others besides its variables and states."""

    name: str
    unit: str
    doc: str


class Unknown(NamedTuple):
    """An algebraic unknown of the forward-facing model; for each of them some part must give a ``balance``."""

    name: str
    unit: str
    doc: str


class From:
    """What a component reads of one other part, which it calls `owner`.

    Either signals, by name and unit (``From("battery", U="V")``), or the part itself as an interface, a class
    (``From("machine", Machine)``), which is then an argument of the owner's name.

    Parameters
    ----------
    owner
        What the reader calls the part; `Model.bind` says by this name which part it is, where several could be.
    interface
        The class that the part must have.
    along
        Of several parts the nearest along the connections: from a port of the reader's own (``("input",)``), or of another owner
        (``("gearbox", "input")``), away from the part that the port belongs to.
    optional
        Whether there may be no such part; the arguments then have their defaults.
    each
        Whether to read all parts that publish the signals; the arguments are tuples, empty if there is none.
    tried
        Whether to read what the signals would be.  The argument has the owner's name and is a function: it takes what might be asked
        at the reader's own port toward the source that `along` names, and gives the signals by name.  Only parts behind that port fit.

    """

    def __init__(
        self,
        owner: str,
        interface: type | None = None,
        /,
        *,
        along: tuple[str, ...] = (),
        optional: bool = False,
        each: bool = False,
        tried: bool = False,
        **signals: str,
    ) -> None:
        self.owner, self.interface, self.along, self.optional = owner, interface, along, optional
        self.each, self.tried = each, tried
        self.signals: Mapping[str, str] = signals

    @property
    def arguments(self) -> tuple[str, ...]:
        """Names of the arguments that it fills."""
        return (self.owner,) if self.interface or self.tried else tuple(self.signals)


#: What a component with a rotor books besides its losses.
ROTOR = (
    Variable("P_kinetic", "W", "rate of change of the rotor's kinetic energy", "kinetic"),
    Variable("P_discretisation", "W", "inertia work by difference quotients less that rate", "discretisation"),
)


class Assumed(NamedTuple):
    """A difference from a law that the paper's second assumption makes on purpose where a limit acts [W]."""

    difference: Any


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


def commanded(*gives: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Mark a method as a face that gives from commands what the law gives otherwise; only a step with free commands has it."""

    def mark(method: Callable[..., Any]) -> Callable[..., Any]:
        method._commanded_gives = gives  # type: ignore[attr-defined]
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
    #: What a file calls it, and what it can stand for: a role of a powertrain takes kinds or families.
    kind: ClassVar[str] = ""
    family: ClassVar[str] = ""
    parameters: ClassVar[type[Parameters]]
    states: ClassVar[tuple[State, ...]] = ()
    variables: ClassVar[tuple[Variable, ...]] = ()
    #: States of the forward-facing model; each stands for the step's state or memory named last.
    plant_states: ClassVar[tuple[tuple[State, str], ...]] = ()
    #: What the component publishes besides variables and states: laws, parameters, points that are outputs by another name.
    signals: ClassVar[tuple[Signal, ...]] = ()
    #: What it reads of other parts.
    reads: ClassVar[tuple[From, ...]] = ()
    #: Decisions that may come from outside in place of its law.
    commands: ClassVar[tuple[Command, ...]] = ()
    #: Unknowns of the forward-facing model that it brings.
    unknowns: ClassVar[tuple[Unknown, ...]] = ()

    @classmethod
    def turns(cls) -> bool:
        """Return whether the component has a rotor."""
        return "J" in cls.parameters.__dataclass_fields__

    @classmethod
    def ports(cls) -> dict[str, Port]:
        """Return the ports by name."""
        return {n: v for c in reversed(cls.__mro__) for n, v in vars(c).items() if isinstance(v, Port)}

    def all_variables(self) -> tuple[Variable, ...]:
        """Return the declared variables and those that a subclass derives."""
        return self.variables

    def faces(self) -> Iterator[Face]:
        """Yield the faces."""
        return self._marked("_gives")

    def _marked(self, mark: str) -> Iterator[Face]:
        for name in dir(type(self)):
            gives = getattr(getattr(type(self), name), mark, None)
            if gives is not None:
                method = getattr(self, name)
                takes, optional = arguments(method)
                yield Face(name, takes, optional, gives, method)

    def commanded_faces(self) -> Iterator[Face]:
        """Yield the faces that obey commands."""
        return self._marked("_commanded_gives")

    def plant_faces(self) -> Iterator[Face]:
        """Yield the faces of the forward-facing model, laws included."""
        for name in dir(type(self)):
            method = getattr(type(self), name)
            gives = getattr(method, "_plant_gives", getattr(method, "_gives", None) if name == "law" else None)
            if gives is not None:
                takes, optional = arguments(getattr(self, name))
                yield Face(name, takes, optional, gives, getattr(self, name))

    def audit_faces(self) -> Iterator[Face]:
        """Yield the law, and the audit where the component has one."""
        for found in self.faces():
            if found.name == "law":
                yield found
        audit = getattr(self, "audit", None)
        if audit is not None:
            takes, optional = arguments(audit)
            yield Face("audit", takes, optional, ("_audit",), lambda **x: {"_audit": audit(**x)})

    def start(self) -> Mapping[str, Any]:
        """Return the start value of each state; arguments may be signals that are states or laws of other parts."""
        return dict.fromkeys((s.name for s in self.states), 0.0)
