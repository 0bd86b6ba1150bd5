"""What a test sets of a vehicle before it drives: charge, mass, and which of its sources work."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

from halfshaft.cosim.compiled import CompiledStep
from halfshaft.cosim.simulate import stepper_of
from halfshaft.cosim.units import M_PER_MILE
from halfshaft.cosim.ways import Mode
from halfshaft.library.base.errors import InputError, number
from halfshaft.models.vehicle import Vehicle

#: Which source rests: none, the batteries (they give nothing), or engine and fuel cell (the key is off).
Resting: TypeAlias = Literal["none", "battery", "converter"]
#: An end or the middle of the window that the control keeps, a full battery, or the charge of the vehicle itself.
Place: TypeAlias = Literal["low", "middle", "high", "full", "own"]
#: The tests of ADVISOR as they were in 1999, and with the options of 2000.
Routine: TypeAlias = Literal["1999", "2000"]
RESTING, PLACES = get_args(Resting), get_args(Place)
#: Rise of a source's power that takes no time [W/s].
AT_ONCE = 1e9
#: A battery that rests is empty up to this share of full.
NEARLY = 0.99
MPH = M_PER_MILE / 3600


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """How a vehicle comes to a test.

    Parameters
    ----------
    soc
        State of charge at the start [1]: a number, ``full``, or a place in the window that the control keeps (``low``, ``middle``,
        ``high``); without a window, and with ``own``, that of the vehicle.
    added_mass
        Load beside the vehicle's mass [kg].
    mass
        Mass in place of all that [kg].
    resting
        What does not work: the ``battery`` (it is empty and stays so, and a genset takes no time to follow), or engine and fuel
        cell, the ``converter`` (the key is off, so that the accessories rest too).

    What is None is as the test has it.

    """

    soc: float | Place | None = None
    added_mass: float = 0.0
    mass: float | None = None
    resting: Resting | None = None

    def problems(self) -> list[str]:
        """Return what is wrong with the options, whatever the vehicle."""
        problems = []
        if self.soc is not None and self.soc not in PLACES and not 0 <= number(self.soc) <= 1:
            problems.append(f"soc = {self.soc!r}, must be >= 0 and <= 1, or {' or '.join(PLACES)}")
        if self.resting is not None and self.resting not in RESTING:
            problems.append(f"resting = {self.resting!r}, must be {' or '.join(RESTING)}")
        return problems

    def applied(self, vehicle: Vehicle, soc: float | Place, resting: Resting = "none", more: Mapping[str, float] | None = None) -> Vehicle:
        """Return the vehicle as it comes to the test.

        Parameters
        ----------
        vehicle
            What is tested.
        soc, resting
            What the test has where nothing is said.
        more
            Other numbers to set.

        Raises
        ------
        InputError
            If an option is not what it must be, or the vehicle cannot be so.

        """
        problems = self.problems()
        resting, soc = self.resting or resting, soc if self.soc is None else self.soc
        if resting != "none" and not is_hybrid(vehicle):
            problems.append(f"resting = {resting}: only a hybrid can drive without it, and vehicle '{vehicle.name}' is none")
        if problems:
            raise InputError("test", problems)
        values = dict(more or {})
        if self.mass is not None or self.added_mass:
            values[vehicle.tags.the("vehicle mass")] = vehicle.mass + self.added_mass if self.mass is None else self.mass
        tags = vehicle.tags
        if resting == "battery":
            for start, empty, full in zip(*(tags.all_of(tag) for tag in ("start charge", "empty charge", "full charge")), strict=True):
                values |= {start: vehicle.values[empty], empty: NEARLY * vehicle.values[full]}
            values |= dict.fromkeys(tags.all_of("source rise"), AT_ONCE)
        elif (start := charge_at(vehicle, soc)) is not None:
            values |= dict.fromkeys(tags.all_of("start charge"), start)
        return vehicle.with_values(values) if values else vehicle

    def solved(self, vehicle: Vehicle, mode: Mode | None) -> Mode:
        """Return how the steps of a test at full effort are solved, unless told.

        Refined, where there is a compiler.  But what looks for the speed that is reached when it is asked for finds only crawling where no
        battery balances what a source gives: then hybrid.
        """
        return mode or ("hybrid" if self.resting == "battery" else best_mode(vehicle))


def is_hybrid(vehicle: Vehicle) -> bool:
    """Return whether a vehicle has both a store and an engine or a fuel cell."""
    return bool(vehicle.tags.all_of("start charge") and vehicle.tags.all_of("fuel density"))


def window(vehicle: Vehicle) -> tuple[float, float] | None:
    """Return the window of the state of charge that the control keeps; None where it keeps none."""
    ends = [vehicle.values[name] for tag in ("lowest charge", "highest charge") for name in vehicle.tags.all_of(tag)]
    return (ends[0], ends[-1]) if len(ends) > 1 else None


def charge_at(vehicle: Vehicle, soc: float | Place) -> float | None:
    """Return a state of charge to start at; None for that of the vehicle."""
    if soc not in PLACES:
        return number(soc)
    full = [vehicle.values[name] for name in vehicle.tags.all_of("full charge")]
    if soc == "full":
        return min(full, default=None)
    ends = window(vehicle)
    return None if soc == "own" or ends is None else {"low": ends[0], "middle": sum(ends) / 2, "high": ends[1]}[str(soc)]


def best_mode(vehicle: Vehicle) -> Mode:
    """Return the better way to solve the steps of a vehicle: refined, or hybrid where there is no compiler."""
    return "refined" if isinstance(stepper_of(vehicle), CompiledStep) else "hybrid"
