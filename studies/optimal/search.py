"""Search for the commands that burn least: compiled code that steps many vehicles at once, each with its whole state.

What is done stands in ``search.c``.  The result is a row of commands that the exact step obeys: nothing is interpolated, so a fuel that is
found can be had.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib.resources import files
from itertools import product
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from halfshaft.cosim.compiled import Array, CompiledStep, address, march_code, read_by_c
from halfshaft.cosim.cycle import Samples
from halfshaft.cosim.simulate import Build, parameters_of
from halfshaft.fmu_build.compiler import shared_library
from halfshaft.fmu_build.lanes import WIDTHS, lanes_code, lanes_header, widths
from halfshaft.library.base.component import Command
from halfshaft.library.base.errors import CompileError, SolveError
from halfshaft.models.assembly import Step, assemble
from halfshaft.models.vehicle import Vehicle

#: So many gears are told apart; so many parts of a share whose effect lasts beside places of the charge, and without.
GEARS, PARTS, MOST = 16, 8, 1e6
#: Lines of the account that a price is paid for, with their worth over the store's energy: what the store gains, and what moves, which
#: gives most of it back; what the method gains by its own errors is paid for, so that no way is found that lives on them.
HELD: Mapping[str, float] = {"stored": -1.0, "kinetic": 0.9}
ERRORS: Mapping[str, float] = {"discretisation": 0.9, "mismatch": 0.9}
#: Speed that counts as none [m/s].
HAIR = 1e-4


class Found(NamedTuple):
    """A row of commands, ``(n, n_commands)``, and what it comes to: fuel [J] and charge at the end."""

    commands: Array
    fuel: float
    charge: float


class Bounds(NamedTuple):
    """What may be after each step, and what is planned: rows of ``n`` numbers.

    A price falls by `bend` of itself with each joule that is held beyond the plan [1/J, J].  Low and high are charges, slowest and
    fastest speeds [m/s].
    """

    bend: float
    plan: Array
    low: Array
    high: Array
    slowest: Array
    fastest: Array


@dataclass(frozen=True, eq=False)
class Problem:
    """What is to be driven: a vehicle whose parts `free` obey commands, over the samples of a cycle."""

    vehicle: Vehicle
    free: tuple[str, ...]
    samples: Samples

    @cached_property
    def parameters(self) -> Array:
        """The numbers of the vehicle."""
        return parameters_of(self.vehicle, self.step, self.samples.v_start)

    @cached_property
    def compiled(self) -> CompiledStep:
        """The step that obeys, with all outputs."""
        return obedient(Build(self.vehicle), self.free)

    @property
    def step(self) -> Step:
        """The step that obeys."""
        return self.compiled.step

    def candidates(self, points: int) -> Array:
        """Return all that may be commanded, with about so many points of a share, whole numbers among them; ``(n, n_commands)``."""
        commands, rows = self.step.commands, list[Sequence[float]]()
        for values in product(*(_values(c, points) for c in commands.values())):
            chosen = dict(zip(commands, values, strict=True))
            # A share that is of no effect is tried once.
            idle = (name for name, c in commands.items() if c.needs and not chosen[f"{name.partition('.')[0]}.{c.needs}"])
            if all(chosen[name] == commands[name].lowest for name in idle):
                rows.append(values)
        return np.array(rows, dtype=float)

    def kinds(self, candidates: Array, parts: float) -> Array:
        """Return of each candidate by what nodes are told apart that it leads to: flags, and parts of shares whose effect lasts."""
        kept = [(i, parts if c.lasts else 1) for i, c in enumerate(self.step.commands.values()) if c.lasts or c.kind == "flag"]
        return np.column_stack([np.floor(candidates[:, i] * n) for i, n in kept])

    def replay(self, commands: Array) -> tuple[Array, Array]:
        """Return outputs and last state of the exact step under commands."""
        s, x = self.samples, self.compiled.first(self.parameters)
        rows = np.empty((len(s.t), len(self.step.outputs)))
        distance = self.step.state_index[self.step.tags.the("distance")]
        for k, command in enumerate(commands):
            grade = _grade_at(x[distance], s.grade_by_distance) if s.grade_by_distance else s.grade[k]
            x, rows[k] = self.compiled(x, np.array([s.v[k], grade, s.key_on[k], s.dt[k], 0.0, *command]), self.parameters)
        return rows, x

    def search(self, candidates: Array, prices: Array, places: int, bounds: Bounds, threads: int) -> Ends:
        """Return what is left at the end: by the price of the charge, and by its place between the bounds.

        Parameters
        ----------
        candidates
            What may be commanded, ``(n_candidates, n_commands)``, or the same for each step.
        prices
            Fuel for the energy that is held [1]; each is searched for by itself.  A row of them is for all steps, or there is one for each.
        places
            By how many charges nodes are told apart.
        bounds, threads
            What may be after each step; and how many threads.

        Raises
        ------
        SolveError
            If there is too little memory, or a parameter is no number.

        """
        step, n = self.step, len(self.samples.t)
        memories = [step.state_index[f"{name.partition('.')[0]}.{c.memory}"] for name, c in step.commands.items() if c.memory]
        kinds, kind = np.unique(self.kinds(candidates, PARTS if places > 1 else MOST), axis=0, return_inverse=True)
        bookings = [d.booking for d in _in_lanes(step).outputs]
        held, errors = ([i for i, booking in enumerate(bookings) if booking in lines] for lines in (HELD, ERRORS))
        worth = [*(HELD[bookings[i]] for i in held), *(ERRORS[bookings[i]] for i in errors)]
        fuels = step.tags.by_part("fuel mass")
        heating = {part: self.vehicle.values[name] for part, name in self.vehicle.tags.by_part("fuel heating value").items()}
        each = np.ascontiguousarray(np.broadcast_to(candidates, (n, *candidates.shape)))
        families = prices.shape[-1]
        most = families * len(kinds) * places * GEARS ** len(memories)
        whole = [np.array(x, dtype=np.intc) for x in ([step.state_index[f] for f in fuels.values()], held, errors, memories, kind)]
        rows = (np.broadcast_to(prices, (n, families)), [heating[part] for part in fuels], worth, *bounds[1:])
        numbers = [np.ascontiguousarray(x, dtype=float) for x in rows]
        count, origin, by = np.zeros(n, np.intc), np.zeros((n, most), np.intc), np.zeros((n, most), np.short)
        x, end = self.compiled.first(self.parameters), np.zeros((most, 3))
        s = read_by_c(self.samples)
        distance, grade = s.grade_by_distance or (None, None)
        job = _Job(
            n, *map(address, (s.dt, s.v, s.grade, s.key_on)), 0 if distance is None else len(distance), *map(address, (distance, grade)),
            address(self.parameters), address(x), len(candidates), address(each), address(whole[4]), len(kinds), families, places,
            address(numbers[0]), bounds.bend, *map(address, numbers[3:]), step.state_index[step.tags.the("charge")],
            len(fuels), address(whole[0]), address(numbers[1]), len(held), len(errors),
            *map(address, whole[1:3]), address(numbers[2]),
            len(memories), address(whole[3]), most, *map(address, (count, origin, by, end)), 0,
        )  # fmt: skip
        failed = _library(Build(self.vehicle), self.free, bool(np.all(np.frexp(s.dt)[0] == 0.5))).hs_search(ctypes.byref(job), threads)
        if failed:
            raise SolveError(f"{step.name}: the search {'needs more memory' if failed < 0 else 'met a parameter that is no number'}")
        return Ends(each, origin, by, end[: count[-1]], float(s.t[job.dead - 1]) if job.dead else None)


class Ends(NamedTuple):
    """Nodes at the end of a search, and where they came from.

    `end` holds place of the price, fuel [J] and charge of each; `dead` is the time at which nothing was allowed any more, if so.
    """

    candidates: Array
    origin: npt.NDArray[np.intc]
    by: npt.NDArray[np.short]
    end: Array
    dead: float | None

    def found(self, node: int) -> Found:
        """Return the commands that lead to a node."""
        _, fuel, charge = self.end[node]
        commands = np.empty((len(self.by), self.candidates.shape[2]))
        for k in range(len(self.by) - 1, -1, -1):
            commands[k] = self.candidates[k, self.by[k, node]]
            node = self.origin[k, node]
        return Found(commands, float(fuel), float(charge))


def _values(command: Command, points: int) -> Sequence[float]:
    """Return what may be tried of a command."""
    whole = command.highest - command.lowest
    parts = max(round((points - 1) / whole), 1) if command.kind == "share" else 1
    return [command.lowest + i / parts for i in range(round(whole * parts) + 1)]


def _grade_at(distance: float, road: tuple[Array, Array]) -> float:
    """Return the grade at a distance, to the bits of C."""
    s, grade = road
    i = min(max(int(np.searchsorted(s, distance, side="right")) - 1, 0), len(s) - 2)
    if distance <= s[0]:
        return float(grade[0])
    if distance >= s[-1]:
        return float(grade[-1])
    return float(grade[i] + (grade[i + 1] - grade[i]) * (distance - s[i]) / (s[i + 1] - s[i]))


@lru_cache(maxsize=64)
def obedient(build: Build, free: tuple[str, ...]) -> CompiledStep:
    """Return the step of a vehicle whose parts obey commands."""
    return CompiledStep(assemble(build.vehicle.model(), build.vehicle.title, free=free))


def _in_lanes(step: Step) -> Step:
    """Return the step with what a search needs of it."""
    # The march itself needs the request and what is missed of it.
    needed = {step.tags.the(tag) for tag in ("request", "miss", "overspeed")}
    return step.only({*needed, *(d.name for d in step.outputs if d.booking in {**HELD, **ERRORS})})


@lru_cache(maxsize=64)
def _library(build: Build, free: tuple[str, ...], halved: bool, width: str | None = None) -> ctypes.CDLL:
    width = next(iter(widths()), "") if width is None else width
    whole = obedient(build, free).step
    step = _in_lanes(whole)
    own = files("halfshaft.studies.optimal").joinpath("search.c").read_text(encoding="utf-8")
    code = "\n".join([march_code(step), lanes_code(step, halved=halved) if width else "", own])
    flags = ("-pthread", *(("-O1", *WIDTHS[width][0]) if width else ()))
    try:
        return ctypes.CDLL(str(shared_library(code, f"{step.name}_search", lanes_header() if width else {}, flags)))
    except CompileError:
        if not width:
            raise
        # The compiler does not know these instructions, or there is none: then the next try says so.
        return _library(build, free, halved, "")


class _Job(ctypes.Structure):
    """``search_job`` in ``search.c``."""

    _fields_ = tuple(
        (name, kind)
        for kind, names in (
            (ctypes.c_long, "n"), (ctypes.c_void_p, "dt v grade key_on"), (ctypes.c_long, "n_grade"),
            (ctypes.c_void_p, "grade_distance grade_value p x"), (ctypes.c_long, "candidates"), (ctypes.c_void_p, "commands kind"),
            (ctypes.c_long, "kinds families places"), (ctypes.c_void_p, "price"), (ctypes.c_double, "bend"),
            (ctypes.c_void_p, "plan low high slowest fastest"),
            (ctypes.c_long, "at_charge fuels"), (ctypes.c_void_p, "at_fuel heating"), (ctypes.c_long, "powers errors"),
            (ctypes.c_void_p, "at_power at_error worth"),
             (ctypes.c_long, "memories"), (ctypes.c_void_p, "at_memory"),
            (ctypes.c_long, "most"), (ctypes.c_void_p, "count origin by end"), (ctypes.c_long, "dead"),
        )
        for name in names.split()
    )  # fmt: skip
