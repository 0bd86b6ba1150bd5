"""What a user should know about a run: what was missed, which limit acted, when, and what it cost.

Which flags warn, and in which words, stands with the components that raise them; `LOOKS` says of some how to look closer.  Where
a run kept its time series, times and energies are told; without them, the time in all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from halfshaft.cosim.compiled import Array
from halfshaft.cosim.units import Units, shown
from halfshaft.library.base.tags import part_of
from halfshaft.library.electric.store import SOC_FULL

if TYPE_CHECKING:
    from halfshaft.cosim.result import Result
    from halfshaft.models.assembly import Description

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


def _power_missing(result: Result, part: str) -> Array | None:
    """Return what is asked of a part less what it gives, as its neighbour toward the wheel books it [W]."""
    gives = result[f"{part}.P_out"]
    for required in (d.name for d in reversed(result.outputs) if d.name.endswith("_required") and ".P_in" in d.name):
        # The neighbour gets what the part gives, to the last bit.
        if np.array_equal(result[required.removesuffix("_required")], gives):
            return np.asarray(result[required] - gives)
    return None


def _store(result: Result, part: str, acts: Mask) -> Iterator[Found]:
    name = result.tags.by_part("charge")[part]
    soc = np.concatenate([[result.first.get(name, np.nan)], result[name][:-1]])
    missing = _power_missing(result, part)
    discharging = missing > 0 if missing is not None else result[f"{part}.P_out"] > 0
    set_to = result.inputs.parameters
    empty, full = set_to.get(f"{part}.soc_empty", SOC_EMPTY), set_to.get(f"{part}.soc_full", SOC_FULL)
    yield Found("empty", acts & discharging & (soc <= empty), missing, "not given")
    yield Found("lowest voltage", acts & discharging & (soc > empty), missing, "not given")
    yield Found("full", acts & ~discharging & (soc >= full), missing, "not taken")
    yield Found("highest voltage", acts & ~discharging & (soc < full), missing, "not taken")


def _grip(result: Result, part: str, acts: Mask) -> Iterator[Found]:
    force, speed = (result[result.tags.by_part(tag)[part]] for tag in ("grip force", "grip speed"))
    cut = result.the("asked force") - force
    power = cut * speed
    yield Found("driving", acts & (cut > 0), power, "not put on the road")
    yield Found("braking", acts & (cut < 0), power, "not braked")


#: How to look closer at a flag, by its tag: from the run, the flag's part, and the steps in which it is up.
LOOKS: dict[str, Callable[[Result, str, Mask], Iterator[Found]]] = {"grip limit": _grip, "store limit": _store}


def remarks(result: Result, units: Units = "metric") -> tuple[str, ...]:
    """Return what a user should know, each as one line of text."""
    if not len(result.time):
        return ("the cycle has no length: nothing was run",)
    misses = (*_missed(result, units), *_too_fast(result, units))
    return (*misses, *_limits(result, units), *_speeds(result), *_energies(result, units), *result.notes)


def acted(result: Result, units: Units = "metric") -> tuple[str, ...]:
    """Return which limits acted, and what else parts warn of: what there is to know of a run that asks for all that a vehicle can."""
    return (*_limits(result, units), *_speeds(result), *result.notes)


def _when(result: Result, steps: Mask) -> str:
    """Return how long and from when on something was so."""
    total, at = float(result.dt[steps].sum()), result.time[steps]
    return f"at t = {at[0]:g} s" if len(at) == 1 else f"{total:.4g} s in all, first at t = {at[0]:g} s, last at {at[-1]:g} s"


def _missed(result: Result, units: Units) -> Iterator[str]:
    name, allowed = result.tags.the("miss"), _allowed(result)
    most = result.highest[name]
    if not most > allowed:
        return
    text = f"trace missed by up to {shown('speed', most, units, 1)}"
    if result.has_history:
        miss = result[name]
        text += f" at t = {result.time[int(miss.argmax())]:g} s"
        steps = miss > allowed
        if steps.sum() > 1:
            text += f" ({_when(result, steps)})"
    yield f"{text}; {shown('way', result.energies[name], units)} short of the request"


def _too_fast(result: Result, units: Units) -> Iterator[str]:
    for name in (n for n in result.tags.all_of("overspeed") if result.highest[n] > _allowed(result)):
        text = f"too fast for the trace by up to {shown('speed', result.highest[name], units, 1)}"
        yield f"{text} at t = {result.time[int(result[name].argmax())]:g} s" if result.has_history else text


def _allowed(result: Result) -> float:
    """Return the miss of a trace that is none yet [m/s]."""
    return result.inputs.parameters[result.tags.the("miss threshold")]


def _shown(part: str) -> str:
    return part.replace("_", " ")


def _raised(result: Result) -> Iterator[tuple[Description, str]]:
    """Yield the flags that were up and what they warn of; where several parts may warn of the same, with the part."""
    texts = [d.warning for d in result.outputs]
    for d in result.outputs:
        if d.warning and result.highest.get(d.name, 0) > 0:
            part = _shown(part_of(d.name))
            text = d.warning.format(part=part)
            yield d, f"{part}: {text}" if texts.count(d.warning) > 1 and text == d.warning else text


def _limits(result: Result, units: Units) -> Iterator[str]:
    for d, text in _raised(result):
        if d.tag not in LOOKS:
            continue
        if not result.has_history:
            yield f"{text}: {result.energies[d.name]:.4g} s in all"
            continue
        for found in LOOKS[d.tag](result, part_of(d.name), result[d.name] > 0):
            if not found.steps.any():
                continue
            cost = ""
            if found.power is not None:
                energy = abs(float((found.power * result.dt)[found.steps].sum()))
                cost = f"; {shown('small energy', energy, units)} {found.cost}"
            yield f"{text}, {found.what}: {_when(result, found.steps)}{cost}"


def _speeds(result: Result) -> Iterator[str]:
    """Yield which parts turn at a top speed of their own, and what else parts warn of."""
    p, tags = result.inputs.parameters, result.tags
    highest, scales = tags.by_part("top speed"), tags.by_part("speed scale")
    for part, name in tags.by_part("machine speed").items():
        top = p[highest[part]] * p[scales[part]] * (1 - 1e-9)
        if result.highest.get(name, 0) >= top:
            when = f": {_when(result, result[name] >= top)}" if result.has_history else ""
            yield f"{_shown(part)} at its top speed{when}"
    for d, text in _raised(result):
        if d.tag not in LOOKS:
            yield f"{text}: {_when(result, result[d.name] > 0)}" if result.has_history else text


def _energies(result: Result, units: Units) -> Iterator[str]:
    for part, name in result.tags.by_part("charge").items():
        if result.last[name] < SOC_EMPTY:
            yield f"{_shown(part)} empty"
    a, s = result.account, result.figures
    burns = dict.fromkeys(_shown(part_of(d.name)) for d in result.outputs if d.booking == "fuel")
    if burns and a.fuel == 0:
        yield f"no fuel used: the {' and the '.join(burns)} never ran"
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
