"""From a model to its step: one pure function of state, request and parameters.

::

    step(state, request, parameters) -> (next state, outputs)
    start(parameters) -> state

Every element of the four vectors has a `Description`.  Numbers of the parts are run-time parameters; their tables are
constants of the build, brought in by `functions`: as interpolants, or as compiled C (`halfshaft.fmu_build`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import casadi as ca

from halfshaft.library.base.component import Command, Component, Variable
from halfshaft.library.base.errors import WiringError
from halfshaft.library.base.parameters import Relation, bind, numbers, tables
from halfshaft.library.base.ports import MEANINGS, SHOWN, UNITS
from halfshaft.library.base.tables import BoundTable, Table, interpolants
from halfshaft.library.base.tags import Tags, unknown
from halfshaft.models.model import Model
from halfshaft.models.wiring import Key, Wiring


class Description(NamedTuple):
    """What one element of a vector is."""

    name: str
    unit: str
    doc: str
    kind: str = "real"
    start: float = 0.0
    lowest: float | None = None
    highest: float | None = None
    booking: str = ""
    state: int | None = None
    allowed: str = ""
    tag: str = ""
    warning: str = ""


REQUESTED = (
    Description("v_request", "m/s", "requested speed at the end of the step"),
    Description("grade", "1", "slope of the road, rise over run"),
    Description("key_on", "1", "whether the key is on", "flag", 1.0, 0.0, 1.0, allowed=">= 0 and <= 1"),
    Description("dt", "s", "length of the step", "real", 1.0),
    Description("decided", "1", "whether the controls keep the decisions that stand in the state", "flag", 0.0),
)


def step_turning(speed: Any) -> Any:
    """Tell whether something moves: 0 or 1, as the paper's method has it."""
    return speed > 0


class StepDirection:
    """Driving and braking as two cases."""

    def size(self, tau: Any) -> Any:
        """Return the size of a torque."""
        return ca.fabs(tau)

    def loss(self, tau: Any, efficiency: Callable[[Any], Any]) -> Any:
        """Return the torque lost behind an output torque."""
        e = efficiency(tau)
        return ca.fabs(tau) * (1 - e) * ca.if_else(tau >= 0, 1 / e, 1)


@dataclass(frozen=True)
class Symbols:
    """The model with symbols for its numbers and functions for its tables."""

    parts: Mapping[str, Component]
    parameters: ca.SX
    descriptions: tuple[Description, ...]
    #: Whether each relation between parameters is broken, and what the relations say, by part.
    broken: ca.SX
    relations: tuple[tuple[str, Relation], ...]


def table_name(model: Model, part: str, field: str) -> str:
    """Return the name of a table's function."""
    return f"{model.name}_{part}_{field}"


def all_tables(model: Model) -> dict[str, Table]:
    """Return the tables of a model by the names of their functions."""
    return {table_name(model, name, field): t for name, part in model.parts.items() for field, t in tables(part.p)}


def symbolic(model: Model, functions: Mapping[str, ca.Function]) -> Symbols:
    """Return the model's parts with numbers as symbols and tables as functions."""
    parts, symbols, described = {}, [], []
    for name, part in model.parts.items():
        own = {}
        for field, spec, value in numbers(part.p):
            own[field] = ca.SX.sym(f"{name}.{field}")
            symbols.append(own[field])
            known = (spec.unit, spec.doc, "real", value, spec.lowest, spec.highest)
            described.append(Description(f"{name}.{field}", *known, allowed=spec.allowed(), tag=spec.tag))
        maps = {field: BoundTable(functions[table_name(model, name, field)], t) for field, t in tables(part.p)}
        parts[name] = replace(part, p=bind(part.p, own, maps))
    relations = tuple((name, relation) for name, part in parts.items() for relation in part.p.relations)
    broken = ca.vertcat(ca.SX(0, 1), *(relation.broken(parts[name].p) for name, relation in relations))
    return Symbols(parts, ca.vertcat(*symbols), tuple(described), broken, relations)


@dataclass(frozen=True)
class Step:
    """The compiled-to-be step of a model."""

    name: str
    title: str
    function: ca.Function
    start: ca.Function
    states: tuple[Description, ...]
    requests: tuple[Description, ...]
    parameters: tuple[Description, ...]
    outputs: tuple[Description, ...]
    tables: Mapping[str, Table]
    #: Positions of the states that hold decisions of the controls.
    decisions: tuple[int, ...]
    #: Whether each of the relations, given with its part, is broken by a parameter vector.
    broken: ca.Function
    relations: tuple[tuple[str, Relation], ...]
    #: Commands by the names of their requests, the last ones, where controls obey them.
    commands: Mapping[str, Command]

    def only(self, outputs: Collection[str]) -> Step:
        """Return the step with some of its outputs alone, in their order; what nobody asks for is not computed."""
        kept = [i for i, d in enumerate(self.outputs) if d.name in outputs]
        state, request, parameters = (ca.SX.sym(name, self.function.size1_in(i)) for i, name in enumerate(("x", "u", "p")))
        following, shown = self.function.call([state, request, parameters])
        function = ca.Function(self.function.name(), [state, request, parameters], [following, shown[kept]])
        return replace(self, function=function, outputs=tuple(self.outputs[i] for i in kept))

    @cached_property
    def output_index(self) -> dict[str, int]:
        """Position of each output by name."""
        return {d.name: i for i, d in enumerate(self.outputs)}

    @cached_property
    def state_index(self) -> dict[str, int]:
        """Position of each state by name."""
        return {d.name: i for i, d in enumerate(self.states)}

    @cached_property
    def parameter_index(self) -> dict[str, int]:
        """Position of each parameter by name."""
        return {d.name: i for i, d in enumerate(self.parameters)}

    @cached_property
    def tags(self) -> Tags:
        """What states, outputs and parameters are."""
        return Tags.of(self.states, self.outputs, self.parameters)


def of_variable(part: str, v: Variable) -> Description:
    """Return the description of a part's variable."""
    return Description(f"{part}.{v.name}", v.unit, v.doc, v.kind, booking=v.booking, tag=v.tag, warning=v.warning)


def _described_outputs(model: Model, parts: Mapping[str, Component], states: list[Description]) -> list[tuple[Description, Key, str]]:
    """Return description, place and field of every output."""
    found: list[tuple[Description, Key, str]] = []
    position = {d.name: i for i, d in enumerate(states)}
    for name, part in parts.items():
        for s in part.states:
            if s.shown:
                full = f"{name}.{s.name}"
                found.append((Description(full, s.unit, s.doc, state=position[full], tag=s.tag), ("next", name, s.name), ""))
        for v in part.all_variables():
            found.append((of_variable(name, v), ("variable", name, v.name), ""))
        for c in model.connections:
            required: Key = ("required", c.supply, c.supply_port.name)
            available: Key = ("available", c.supply, c.supply_port.name)
            into, out = model.suffixes(c)
            fields, supplied = [f for f in SHOWN[c.supply_port.kind] if f != "P"], c.supply_port.tags
            if c.supply == name:
                for f in fields:
                    offered = Description(
                        f"{name}.{f}{out}", UNITS[f], f"{MEANINGS[f]} toward the wheel, available", tag=supplied.get(f, "")
                    )
                    found.append((offered, available, f))
                    asked = Description(f"{name}.{f}{out}_required", UNITS[f], f"{MEANINGS[f]} toward the wheel, required")
                    found.append((asked, required, f))
                power = Description(f"{name}.P_out{out}", "W", "power toward the wheel, available", tag=supplied.get("P", ""))
                found.append((power, available, "P"))
            if c.load == name:
                came = Description(f"{name}.P_in{into}", "W", "power from the source, available", tag=c.load_port.tags.get("P", ""))
                found.append((came, available, "P"))
                if not fields:
                    found.append((Description(f"{name}.P_in{into}_required", "W", "power from the source, required"), required, "P"))
    return found


def assemble(
    model: Model,
    title: str = "",
    functions: Callable[[Mapping[str, Table]], Mapping[str, ca.Function]] = interpolants,
    free: Collection[str] = (),
) -> Step:
    """Return the step of a model.

    Parameters
    ----------
    model, title
        What is assembled, and what it is called.
    functions
        What makes functions of the tables.
    free
        Parts that obey commands in place of their own law: for each of their commands the step has one more request, behind all others.

    Raises
    ------
    WiringError
        If the parts do not fit together; everything that is wrong is named.

    """
    wired = Wiring(model, model.parts)
    named = all_tables(model)
    symbols = symbolic(model, functions(named))
    wiring = Wiring(model, symbols.parts, free)

    states, known = [], dict[Key, Any]()
    for name, part in symbols.parts.items():
        for s in part.states:
            states.append(Description(f"{name}.{s.name}", s.unit, s.doc, tag=s.tag))
            known["state", name, s.name] = ca.SX.sym(f"{name}.{s.name}")
    state = ca.vertcat(*known.values()) if known else ca.SX(0, 1)
    request = {d.name: ca.SX.sym(d.name) for d in REQUESTED}
    known |= {("request", "", name): symbol for name, symbol in request.items()}
    commands = {f"{name}.{c.name}": c for name, part in symbols.parts.items() if name in free for c in part.commands}
    commanded = {name: ca.SX.sym(name) for name in commands}
    known |= {("command", *name.split(".", 1)): symbol for name, symbol in commanded.items()}  # type: ignore[misc]
    known |= {("law of the model", "", "turning"): step_turning, ("law of the model", "", "direction"): StepDirection()}

    values = wiring.evaluate(known)
    following = ca.vertcat(*(values["next", *d.name.split(".", 1)] for d in states))  # type: ignore[index]
    outputs = [o for o in _described_outputs(model, wired.parts, states) if o[1] in values]
    twice = [name for name, n in Counter(d.name for d, *_ in outputs).items() if n > 1]
    problems = [f"{name} is an output twice: a variable or state, and what is shown of a port" for name in twice]
    problems += unknown({d.name: d for d in (*states, *(o[0] for o in outputs), *symbols.descriptions)}.values())
    if problems:
        raise WiringError(model.name, problems)
    shown = ca.vertcat(*(values[key] if not field else getattr(values[key], field) for _, key, field in outputs))

    start = wiring.start()
    first = ca.vertcat(*(start["state", *d.name.split(".", 1)] for d in states))  # type: ignore[index]
    return Step(
        model.name,
        title or model.name,
        ca.Function(
            f"{model.name}_step", [state, ca.vertcat(*request.values(), *commanded.values()), symbols.parameters], [following, shown],
            ["state", "request", "parameters"], ["next_state", "outputs"],
        ),
        ca.Function(f"{model.name}_start", [symbols.parameters], [ca.SX(first)], ["parameters"], ["state"]),
        tuple(states),
        (*REQUESTED, *(Description(n, "1", c.doc, "real", c.lowest, c.lowest, c.highest) for n, c in commands.items())),
        symbols.descriptions,
        tuple(o[0] for o in outputs),
        named,
        tuple(i for i, s in enumerate(s for part in symbols.parts.values() for s in part.states) if s.decision),
        ca.Function(f"{model.name}_broken", [symbols.parameters], [symbols.broken], ["parameters"], ["broken"]),
        symbols.relations,
        commands,
    )  # fmt: skip
