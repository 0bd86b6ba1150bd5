"""The forward-facing model: the same parts and connections as a differential-algebraic system.

The laws of the parts stand in continuous time.  From the speed and the acceleration of the body the chain of links
gives what every shaft must carry; where the chain meets a part that obeys a pedal (the motor, the clutch), the torque
that the motion needs must equal the torque delivered::

    d v/dt = a,    0 = tau_delivered(throttle, omega) - tau_needed(v, a)

so ``a`` is implicit and stays so.  There is one speed state for all that turns rigidly with the wheels, and one for an
engine.  The controls are those of the step, unchanged: they are sampled, and what the system reads of them is held
between samples (`Plant.held`).

Smooth here are two things that are switches in the step: whether something moves (over `V_SMOOTH`; the friction
brakes fade with it), and whether a gearbox drives or brakes (over `TAU_SMOOTH`).  The slip's rate is
neglected, as in the paper (its effect on 0-100 km/h is 0.1 %).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from halfshaft.library.base.component import Component, Face, Variable
from halfshaft.library.base.ports import SHOWN
from halfshaft.models.assembly import Description, Step, of_variable, symbolic
from halfshaft.models.model import Model
from halfshaft.models.wiring import Key, Published, Wiring

#: Speed over which motion sets in [m/s or rad/s].
V_SMOOTH = 0.05

#: Torque over which a gearbox's law for driving takes over from that for braking [N.m].
TAU_SMOOTH = 3.0
#: Torque below which a gearbox's efficiency is no longer read from its map [N.m].
TAU_LOOKUP = 10.0


def plant_turning(speed: Any) -> Any:
    """Tell whether something moves, smoothly."""
    return ca.tanh(speed / V_SMOOTH)


class PlantDirection:
    """Driving and braking, one going over into the other.

    An efficiency says nothing where no torque flows: maps fall to zero there.  It is read at `TAU_LOOKUP` at least.
    """

    def _driving(self, tau: Any) -> Any:
        return 0.5 * (1 + ca.tanh(tau / TAU_SMOOTH))

    def size(self, tau: Any) -> Any:
        """Return the size of a torque."""
        return tau * (2 * self._driving(tau) - 1)

    def loss(self, tau: Any, efficiency: Callable[[Any], Any]) -> Any:
        """Return the torque lost behind an output torque."""
        driving, lookup = self._driving(tau), ca.sqrt(tau**2 + TAU_LOOKUP**2)
        ahead, back = efficiency(lookup), efficiency(-lookup)
        return self.size(tau) * (driving * (1 - ahead) / ahead + (1 - driving) * (1 - back))


class PlantWiring(Wiring):
    """The wiring of the plant faces; what none of them gives is held from the step."""

    def __init__(self, model: Model, parts: Mapping[str, Component]) -> None:
        self.held: dict[Key, None] = {}
        super().__init__(model, parts)

    def faces_of(self, part: Component) -> Iterable[Face]:
        """Return the plant faces."""
        return part.plant_faces()

    def states_of(self, part: Component) -> set[str]:
        """Return the names of the plant's states, and of what stands for memories of the step."""
        return {s.name for s, _ in part.plant_states} | {s.name for s in part.states if s.neutral is not None}

    def signals_of(self, name: str, part: Component) -> dict[str, Published]:
        """Return what a part publishes; a state of the plant comes before a variable of the step."""
        states = {s.name: Published(("state", name, s.name), s.unit) for s, _ in part.plant_states if s.signal}
        return super().signals_of(name, part) | states

    def finish(self, problems: list[str]) -> None:
        """Take what no plant face gives from the step, and count unknowns against balances."""
        for bound in self.faces:
            for name, key in bound.needs():
                if key[0] in ("variable", "required", "available", "private", "law") and key not in self.maker:
                    if key[0] == "variable":
                        self.held[key] = None
                    else:
                        told = f"{bound} takes {name}, but in the forward-facing model nothing gives {key[1]}.{key[2]} ({key[0]})"
                        problems.append(f"{told}: {key[1]} must have a plant face for it")
                elif key[0] == "state" and key[2] not in self.states[key[1]]:
                    problems.append(f"{bound} takes {name}, a memory of {key[1]} in the step that has nothing neutral to stand for it")
        balances = [key[1] for key in self.maker if key[0] == "balance"]
        unknowns = [f"{name}.{u.name}" for name, part in self.parts.items() for u in part.unknowns]
        if len(balances) != len(unknowns) and not problems:
            had, given = ", ".join(unknowns) or "none", ", ".join(balances) or "none"
            problems.append(
                f"the forward-facing model has the unknowns {had}, but balances of {given}: "
                "a machine or clutch at the end of a chain gives one, a part that divides a flow brings one unknown"
            )


@dataclass(frozen=True)
class Plant:
    """The forward-facing model of a vehicle.

    ``dae`` has the states ``x``, the unknowns ``z`` (the acceleration, and how flows divide), ``p`` (held values, grade,
    key, then parameters), and the integrals ``quad`` of all powers.  ``held`` names the outputs of the step that are held;
    ``memories`` tells which state of the step each state ``x`` stands for.  ``outputs`` maps ``(x, z, p)`` to the ``shown`` variables.
    """

    name: str
    dae: Mapping[str, ca.SX]
    outputs: ca.Function
    states: tuple[Description, ...]
    memories: tuple[str, ...]
    held: tuple[str, ...]
    powers: tuple[Description, ...]
    shown: tuple[Description, ...]


def assemble_plant(model: Model, step: Step, functions: Mapping[str, ca.Function]) -> Plant:
    """Return the forward-facing model; `functions` are those of the model's tables."""
    symbols = symbolic(model, functions)
    wiring = PlantWiring(model, symbols.parts)
    states, memories, x, z = [], [], [], []
    known: dict[Key, Any] = {}
    for name, part in symbols.parts.items():
        known |= {("state", name, s.name): s.neutral for s in part.states if s.neutral is not None}
        for u in part.unknowns:
            z.append(ca.SX.sym(f"{name}.{u.name}"))
            known["unknown", name, u.name] = z[-1]
        for s, memory in part.plant_states:
            states.append(Description(f"{name}.{s.name}", s.unit, s.doc, tag=s.tag))
            memories.append(f"{name}.{memory}")
            x.append(ca.SX.sym(f"{name}.{s.name}"))
            known["state", name, s.name] = x[-1]
    grade, key_on = ca.SX.sym("grade"), ca.SX.sym("key_on")
    held = {f"{key[1]}.{key[2]}": ca.SX.sym(f"{key[1]}.{key[2]}") for key in wiring.held}
    known |= {key: held[f"{key[1]}.{key[2]}"] for key in wiring.held}
    known |= {
        ("request", "", "grade"): grade,
        ("request", "", "key_on"): key_on,
        ("law of the model", "", "turning"): plant_turning,
    }
    known["law of the model", "", "direction"] = PlantDirection()

    values = wiring.evaluate(known)
    balance = [value for key, value in values.items() if key[0] == "balance"]
    rates = ca.vertcat(*(values["derivative", *d.name.split(".", 1)] for d in states))  # type: ignore[index]
    shown = list(zip(states, x, strict=True))
    for name, part in symbols.parts.items():
        for v in (*part.all_variables(), *(Variable(s.name, s.unit, s.doc, tag=s.tag) for s in part.states)):
            if (key := ("variable", name, v.name)) in values and key not in known:
                shown.append((of_variable(name, v), values[key]))
        for c in model.connections:
            point: Any = values.get(("required", c.supply, c.supply_port.name), values.get(("available", c.supply, c.supply_port.name)))
            into, out = model.suffixes(c)
            for field in SHOWN[c.supply_port.kind]:
                if c.supply == name and field != "P":
                    shown.append((_described(step, f"{name}.{field}{out}"), getattr(point, field)))
            if c.supply == name:
                shown.append((_described(step, f"{name}.P_out{out}"), point.P))
            if c.load == name:
                shown.append((_described(step, f"{name}.P_in{into}"), point.P))
    integrals = [(d, value) for d, value in shown if d.unit == "W"]
    p = ca.vertcat(*held.values(), grade, key_on, symbols.parameters)
    quad = ca.vertcat(*(value for _, value in integrals))
    dae = {"x": ca.vertcat(*x), "z": ca.vertcat(*z), "p": p, "ode": rates, "alg": ca.vertcat(*balance), "quad": quad}
    outputs = ca.Function("outputs", [dae["x"], dae["z"], p], [ca.vertcat(*(value for _, value in shown))])
    return Plant(
        model.name, dae, outputs, tuple(states), tuple(memories), tuple(held),
        tuple(d for d, _ in integrals), tuple(d for d, _ in shown),
    )  # fmt: skip


def _described(step: Step, name: str) -> Description:
    return step.outputs[step.output_index[name]]._replace(state=None, booking="")
