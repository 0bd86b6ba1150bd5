"""What a user should know about a run: what was missed, which limit acted, when, and what it cost.

What is looked for stands in `LIMITS`, over the last part of an output's name, so any number of batteries, motors or
wheels is covered.  Where a run kept its time series, times and energies are told; without them, the time in all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from halfshaft.cosim.compiled import Array
from halfshaft.cosim.units import Units, shown
from halfshaft.library.electric.battery import SOC_FULL

if TYPE_CHECKING:
    from halfshaft.cosim.result import Result

#: Relative residual of the energy account from which a run is doubtful.
OPEN_BALANCE = 1e-6
#: Share of the fuel's energy from which what the battery gave or took spoils a fuel economy (SAE J1711: 1 %).
UNBALANCED = 0.01
#: State of charge below which a pack is empty.
SOC_EMPTY = 1e-3

Mask: TypeAlias = npt.NDArray[np.bool_]


class Found(NamedTuple):
    """One way in which a limit acted: its name, the steps, and the power that it kept back in each step [W]."""

    what: str
    steps: Mask
    power: Array | None
    cost: str


class Limit(NamedTuple):
    """A flag by the last part of its name, what it means, and how to look closer."""

    flag: str
    text: str
    look: Callable[[Result, str], Iterator[Found]]


def _power_missing(result: Result, part: str) -> Array | None:
    """Return what is asked of a part less what it gives, as its neighbour toward the wheel books it [W]."""
    names = [d.name for d in result.outputs]
    for required in (n for n in reversed(names) if n.endswith("_required") and ".P_in" in n):
        given = required.removesuffix("_required")
        # With several sources the input is named after its own.
        single = given.endswith(".P_in") and np.array_equal(result[given], result[f"{part}.P_out"])
        if given.endswith(f".P_in_{part}") or single:
            return np.asarray(result[required] - result[given])
    return None


def _battery(result: Result, part: str) -> Iterator[Found]:
    soc = np.concatenate([[result.first.get(f"{part}.soc", np.nan)], result[f"{part}.soc"][:-1]])
    acts, missing = result[f"{part}.battery_limited"] > 0, _power_missing(result, part)
    discharging = missing > 0 if missing is not None else result[f"{part}.P_out"] > 0
    yield Found("empty", acts & discharging & (soc <= SOC_EMPTY), missing, "not given")
    yield Found("lowest voltage", acts & discharging & (soc > SOC_EMPTY), missing, "not given")
    yield Found("full", acts & ~discharging & (soc >= SOC_FULL), missing, "not taken")
    yield Found("highest voltage", acts & ~discharging & (soc < SOC_FULL), missing, "not taken")


def _grip(result: Result, part: str) -> Iterator[Found]:
    acts, cut = result[f"{part}.slip_limited"] > 0, result["body.F_required"] - result[f"{part}.F_limited"]
    power = cut * result[f"{part}.v_limited"]
    yield Found("driving", acts & (cut > 0), power, "not put on the road")
    yield Found("braking", acts & (cut < 0), power, "not braked")


LIMITS = (Limit("slip_limited", "grip limit", _grip), Limit("battery_limited", "battery limit", _battery))


def remarks(result: Result, units: Units = "metric") -> tuple[str, ...]:
    """Return what a user should know, each as one line of text."""
    if not len(result.time):
        return ("the cycle has no length: nothing was run",)
    misses = (*_missed(result, units), *_too_fast(result, units))
    return (*misses, *_limits(result, units), *_speeds(result), *_energies(result, units), *result.notes)


def _when(result: Result, steps: Mask) -> str:
    """Return how long and from when on something was so."""
    total, at = float(result.dt[steps].sum()), result.time[steps]
    return f"at t = {at[0]:g} s" if len(at) == 1 else f"{total:.4g} s in all, first at t = {at[0]:g} s, last at {at[-1]:g} s"


def _missed(result: Result, units: Units) -> Iterator[str]:
    most, allowed = result.highest["body.trace_miss"], result.inputs.parameters["body.v_miss"]
    if not most > allowed:
        return
    text = f"trace missed by up to {shown('speed', most, units, 1)}"
    if result.has_history:
        miss = result["body.trace_miss"]
        text += f" at t = {result.time[int(miss.argmax())]:g} s"
        steps = miss > allowed
        if steps.sum() > 1:
            text += f" ({_when(result, steps)})"
    yield f"{text}; {shown('way', result.energies['body.trace_miss'], units)} short of the request"


def _too_fast(result: Result, units: Units) -> Iterator[str]:
    most, allowed = result.highest.get("body.overspeed", 0.0), result.inputs.parameters["body.v_miss"]
    if most > allowed:
        text = f"too fast for the trace by up to {shown('speed', most, units, 1)}"
        yield f"{text} at t = {result.time[int(result['body.overspeed'].argmax())]:g} s" if result.has_history else text


def _limits(result: Result, units: Units) -> Iterator[str]:
    for limit in LIMITS:
        for name in (d.name for d in result.outputs if d.name.endswith(f".{limit.flag}")):
            if not result.highest.get(name, 0) > 0:
                continue
            if not result.has_history:
                yield f"{limit.text} reached: {result.energies[name]:.4g} s in all"
                continue
            for found in limit.look(result, name.split(".")[0]):
                if not found.steps.any():
                    continue
                cost = ""
                if found.power is not None:
                    energy = abs(float((found.power * result.dt)[found.steps].sum()))
                    cost = f"; {shown('small energy', energy, units)} {found.cost}"
                yield f"{limit.text} reached, {found.what}: {_when(result, found.steps)}{cost}"


def _speeds(result: Result) -> Iterator[str]:
    """Yield which parts turn at a top speed of their own."""
    p = result.inputs.parameters
    for part in [name.removesuffix(".omega_max") for name in p if name.endswith(".omega_max")]:
        top, name = p[f"{part}.omega_max"] * p[f"{part}.speed_scale"] * (1 - 1e-9), f"{part}.omega"
        if result.highest.get(name, 0) >= top:
            when = f": {_when(result, result[name] >= top)}" if result.has_history else ""
            yield f"{part.replace('_', ' ')} at its top speed{when}"
    for name in (d.name for d in result.outputs if d.name.endswith(".speed_limited") and result.highest[d.name] > 0):
        when = f": {_when(result, result[name] > 0)}" if result.has_history else ""
        yield f"{name.split('.')[0].replace('_', ' ')} at its top speed{when}"


def _energies(result: Result, units: Units) -> Iterator[str]:
    for name, end in result.last.items():
        if name.endswith(".soc") and end < SOC_EMPTY:
            yield f"{name.split('.')[0].replace('_', ' ')} empty"
    burns, a, s = any(d.booking == "fuel" for d in result.outputs), result.account, result.figures
    if burns and a.fuel == 0:
        yield "no fuel used: the engine never ran"
    if burns and abs(a.battery) > UNBALANCED * a.fuel:
        gave = "gave" if a.battery > 0 else "took"
        text = f"the battery {gave} {shown('energy', abs(a.battery), units)}, which the fuel economy leaves out"
        if s["fuel_equivalent_L_per_100km"] is not None:
            text += f"; turned into fuel it would be {shown('economy', s['fuel_equivalent_L_per_100km'], units, 2)}"
            text += f" (at {100 * s['fuel_equivalent_efficiency']:.1f} %, {s['fuel_equivalent_basis']})"
        yield text
    # Written so that a number that was lost is caught.
    if not abs(a.balance_relative) <= OPEN_BALANCE:
        yield f"the energy account is open by {a.balance_relative:.1e} of the turnover"
