"""The audit of a run: every part held against its own laws, at the points that the run recorded at its ports.

The energy account closes by construction: a loss is what came in less what went out.  The audit can fail.  In each step it
takes the recorded points of a part's ports and asks the part what its laws (map, polynomial, circuit, drag, slip) say
about them; what differs is a power.  It also looks for losses below zero, and holds the energies in the states against
the integrals of their powers.

Where a limit acts, the paper's second assumption moves a loss on purpose: what is delivered is not on the map.  Such
steps are summed up apart, as `Check.assumed`; they are no failure.  A refined run has next to none of them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from halfshaft.cosim.compiled import Array
from halfshaft.cosim.cycle import Samples
from halfshaft.library.base.component import Assumed, Component, Face
from halfshaft.library.base.ports import SHOWN
from halfshaft.library.base.tables import interpolants
from halfshaft.models.assembly import Step, StepDirection, all_tables, step_turning, symbolic
from halfshaft.models.model import Connection, Model
from halfshaft.models.wiring import Key, Wiring

#: A power that differs by less than this share of the part's largest power, or by less than this many watts, does not differ.
SHARE, WATTS = 1e-7, 1e-3


class Check(NamedTuple):
    """One law of one part over a run.

    ``worst`` is the largest difference [W] in a step where no limit acts, at the time ``when`` [s]; ``scale`` is the part's largest
    power [W]; ``assumed`` is the time integral of the differences where one does [J].
    """

    part: str
    law: str
    worst: float
    when: float
    scale: float
    assumed: float

    @property
    def holds(self) -> bool:
        """Whether the part obeys its law."""
        return abs(self.worst) <= max(SHARE * self.scale, WATTS)


class Negative(NamedTuple):
    """A loss below zero: name, number of steps, the lowest value [W] and when [s]."""

    name: str
    steps: int
    lowest: float
    when: float


@dataclass(frozen=True)
class Audit:
    """What the audit of a run found."""

    checks: tuple[Check, ...]
    negative: tuple[Negative, ...]

    def __repr__(self) -> str:
        return f"<Audit {len(self.checks)} laws: {'; '.join(self.failures) or 'all hold'}>"

    @property
    def failures(self) -> tuple[str, ...]:
        """What does not hold, with part and time; empty for a run to be trusted."""
        laws = [
            f"{c.part}: {c.law} differs from what the ports carry by {c.worst:.3g} W at t = {c.when:g} s"
            for c in self.checks
            if not c.holds
        ]
        below = [f"{n.name} is negative in {n.steps} steps, {n.lowest:.3g} W at t = {n.when:g} s" for n in self.negative]
        return (*laws, *below)


class _Recorded(Wiring):
    """The audits of a model's parts, wired to what a run records."""

    def faces_of(self, part: Component) -> Iterable[Face]:
        return part.audit_faces()

    def finish(self, problems: list[str]) -> None:
        """Take what no law gives from the record."""


class Auditor:
    """The audit of a model, as one function of two rows of outputs; built once for a structure."""

    def __init__(self, model: Model, step: Step) -> None:
        self._step, outputs = step, step.output_index
        symbols = symbolic(model, interpolants(all_tables(model)))
        wiring = _Recorded(model, symbols.parts)
        row, before = ca.SX.sym("row", len(outputs)), ca.SX.sym("before", len(outputs))
        requests = {name: ca.SX.sym(name) for name in ("grade", "key_on", "dt")}
        known: dict[Key, Any] = {("request", "", name): symbol for name, symbol in requests.items()}
        known |= {("law of the model", "", "turning"): step_turning, ("law of the model", "", "direction"): StepDirection()}
        for name, part in symbols.parts.items():
            for v in part.all_variables():
                known["variable", name, v.name] = row[outputs[f"{name}.{v.name}"]]
            for s in part.states:
                full = f"{name}.{s.name}"
                unseen = ca.SX.nan() if s.neutral is None else s.neutral
                known["state", name, s.name] = before[outputs[full]] if s.shown else unseen
                if s.shown:
                    known["next", name, s.name] = row[outputs[full]]
        self._limits: dict[str, list[tuple[int, int]]] = {name: [] for name in symbols.parts}
        self._powers: dict[str, list[int]] = {name: [] for name in symbols.parts}
        for c in model.connections:
            point = self._point(c, model, row, outputs)
            known["required", c.supply, c.supply_port.name] = known["available", c.supply, c.supply_port.name] = point
            self._limits[c.load] += self._pairs(c, model, outputs)
            for end in (c.load, c.supply):
                self._powers[end].append(outputs[f"{c.supply}.P_out{model.suffixes(c)[1]}"])
        audits = [(b.part, key) for b in wiring.faces for name, key in b.gives.items() if name == "_audit"]
        values = wiring.evaluate(known, [key for _, key in audits])
        found = [(part, law, x) for part, key in audits for law, x in values[key].items()]
        #: Part, law, and whether the second assumption may keep the law from holding.
        self._laws = [(part, law, isinstance(x, Assumed)) for part, law, x in found]
        self._run = ca.Function(
            "audit",
            [row, before, ca.vertcat(*requests.values()), symbols.parameters],
            [ca.vertcat(*(x.difference if isinstance(x, Assumed) else x for *_, x in found))],
        )

    @staticmethod
    def _point(c: Connection, model: Model, row: ca.SX, outputs: Mapping[str, int]) -> Any:
        fields, (_, out) = SHOWN[c.supply_port.kind], model.suffixes(c)
        places = {f: f"{c.supply}.{'P_out' if f == 'P' else f}{out}" for f in fields}
        return c.supply_port.kind(*(row[outputs[places[f]]] if f in places else ca.SX.nan() for f in c.supply_port.kind._fields))

    @staticmethod
    def _pairs(c: Connection, model: Model, outputs: Mapping[str, int]) -> list[tuple[int, int]]:
        """Return the places of what was required and of what was available at a connection."""
        fields, (into, out) = [f for f in SHOWN[c.supply_port.kind] if f != "P"], model.suffixes(c)
        if fields:
            return [(outputs[f"{c.supply}.{f}{out}_required"], outputs[f"{c.supply}.{f}{out}"]) for f in fields]
        place = f"{c.load}.P_in{into}"
        return [(outputs[f"{place}_required"], outputs[place])] if f"{place}_required" in outputs else []

    def __call__(self, samples: Samples, rows: Array, start: Array, parameters: Array) -> Audit:
        """Audit a run of the step.

        Parameters
        ----------
        samples
            What the run was asked for.
        rows
            Outputs, shape ``(n, n_outputs)``.
        start, parameters
            In the order of the step's states and parameters.

        """
        if not len(rows):
            return Audit((), ())
        t, dt, places = samples.t, samples.dt, self._step.output_index
        # Outputs that are no states are not looked at before the first step.
        first = np.array([0.0 if d.state is None else start[d.state] for d in self._step.outputs])
        before = np.vstack([first, rows[:-1]])
        requests = np.column_stack([self._slope(before, rows) if samples.grade_by_distance else samples.grade, samples.key_on, dt])
        residuals = np.asarray(self._run(rows.T, before.T, requests.T, parameters)).T
        missed = before[:, places[self._step.tags.the("miss")]] > 0
        checks, excused = [], dict[str, Any]()
        for i, (part, law, assumed) in enumerate(self._laws):
            scale = float(np.abs(rows[:, self._powers[part]]).max(initial=0.0))
            limited = missed & assumed
            for required, available in self._limits[part] if assumed else ():
                limited |= rows[:, required] != rows[:, available]
            excused[part] = excused.get(part, False) | limited
            free = np.where(limited, 0.0, residuals[:, i])
            k = int(np.argmax(np.abs(free)))
            checks.append(Check(part, law, float(free[k]), float(t[k]), scale, float(dt @ np.where(limited, residuals[:, i], 0.0))))
        negative = []
        for name in (d.name for d in self._step.outputs if d.booking == "loss"):
            # Where something else comes than was asked for, the slip, or an efficiency, is still that of the request.
            loss = np.where(excused.get(name.partition(".")[0], False), 0.0, rows[:, places[name]])
            below = loss < -max(SHARE * np.abs(loss).max(initial=0.0), WATTS)
            if below.any():
                k = int(np.argmin(loss))
                negative.append(Negative(name, int(below.sum()), float(loss[k]), float(t[k])))
        return Audit(tuple(checks), tuple(negative))

    def _slope(self, before: Array, rows: Array) -> Array:
        """Return the grade on which the vehicle moved, from its states; where it stands, none."""
        i, j = (self._step.output_index[self._step.tags.the(tag)] for tag in ("distance", "elevation"))
        moved, climbed = rows[:, i] - before[:, i], rows[:, j] - before[:, j]
        return np.divide(climbed, np.sqrt(np.maximum(moved**2 - climbed**2, 1e-300)), out=np.zeros(len(rows)), where=moved > 0)
