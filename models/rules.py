"""Rules: what one parameter of a vehicle is, when others decide it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, replace
from functools import lru_cache
from typing import Any, ClassVar, TypeAlias, cast

import numpy as np

from halfshaft.library.base.parameters import Parameters, each, param, plain
from halfshaft.library.chassis.wheel import AxleParameters
from halfshaft.library.control.series import genset_locus
from halfshaft.library.driveline.final_drive import FinalDriveParameters
from halfshaft.library.electric.generator import GeneratorParameters
from halfshaft.library.electric.motor import MotorParameters
from halfshaft.library.engine.engine import EngineParameters

Sets: TypeAlias = Mapping[str, Parameters]


@dataclass(frozen=True, kw_only=True)
class Rule(Parameters):
    """Derives the value of one parameter from other parts; its own numbers are those that a vehicle's file gives it."""

    #: What a file calls it, and its own names for the parts that it looks at; None is all other parts.
    name: ClassVar[str]
    needs: ClassVar[tuple[str, ...] | None]

    @classmethod
    def lacks(cls) -> bool:
        """Return whether it cannot go by what a vehicle's file leaves out."""
        return any(f.default is MISSING for f in fields(cls))

    def __call__(self, sets: Sets) -> Any:
        """Return the value; `sets` are the parameters by the rule's own names for the parts."""
        raise NotImplementedError

    @property
    def unrounded(self) -> Rule:
        """The rule without the rounding that it may do: what has derivatives."""
        return self


@dataclass(frozen=True, kw_only=True)
class TopSpeed(Rule):
    """The gear ratio at which the motor reaches its top speed when the vehicle drives at `v`."""

    name = "top-speed"
    needs = ("motor", "wheel", "final_drive")
    v: float = param("m/s", "speed of the vehicle", ge=0.1, le=1e3)
    slip: float = param("1", "slip of the tyres at that speed", 0.0, ge=0, le=10)

    def __call__(self, sets: Sets) -> tuple[float]:
        """Return the ratio of a single-speed gearbox."""
        motor, wheel = cast(MotorParameters, sets["motor"]), cast(AxleParameters, sets["wheel"])
        final_drive = cast(FinalDriveParameters, sets["final_drive"])
        return (motor.omega_max * motor.speed_scale / (self.v / wheel.r * (1 + self.slip)) / final_drive.i,)


@dataclass(frozen=True, kw_only=True)
class SumOfParts(Rule):
    """The mass of the vehicle: what its parts weigh, each with its factors on size, and the rest of it."""

    name = "sum-of-parts"
    needs = None
    rest: float = param("kg", "what no part accounts for: body, cargo, gearboxes, tanks", ge=0, le=1e6)
    whole: float = param("kg", "the sum is rounded to a whole number of this; 0 does not round", 1.0, ge=0, le=1e3)

    def __call__(self, sets: Sets) -> float:
        """Return the mass [kg]."""
        m = self.rest + sum(p.weight for p in sets.values())
        return plain(np.rint(m / self.whole) * self.whole) if self.whole else m

    @property
    def unrounded(self) -> Rule:
        """The plain sum."""
        return replace(self, whole=0.0)


@dataclass(frozen=True, kw_only=True)
class GensetLocus(Rule):
    """The genset speeds of least fuel."""

    name = "genset-locus"
    needs = ("engine", "generator")

    def __call__(self, sets: Sets) -> Any:
        """Return the speed over engine power."""
        engine, generator = cast(EngineParameters, sets["engine"]), cast(GeneratorParameters, sets["generator"])
        factors = (generator.speed_scale, generator.torque_scale, generator.overtorque)
        return each(_locus, (engine.fuel, engine.tau_max), (generator.P_electric, generator.tau_max), *factors)


@dataclass(frozen=True, kw_only=True)
class CouplerTopSpeed(TopSpeed):
    """The ratio of a torque coupler behind the gearbox at which the motor reaches its top speed when the vehicle drives at `v`."""

    name = "coupler-top-speed"

    def __call__(self, sets: Sets) -> Any:
        """Return the ratio of the motor's speed to that of the shaft."""
        return super().__call__(sets)[0]


@dataclass(frozen=True, kw_only=True)
class TogetherAtTop(Rule):
    """The ratio of a torque coupler at which the motor turns at a share of its top speed when the engine is at its own."""

    name = "together-at-top"
    needs = ("motor", "engine")
    share: float = param("1", "share of the motor's top speed", 0.99, ge=0.01, le=1)

    def __call__(self, sets: Sets) -> float:
        """Return the ratio of the motor's speed to the engine's."""
        motor, engine = cast(MotorParameters, sets["motor"]), cast(EngineParameters, sets["engine"])
        return self.share * motor.omega_max * motor.speed_scale / (engine.tau_max.inside(0)[1] * engine.speed_scale)


# The locus takes longer than all else here, and most changes leave engine and generator alone.
_locus = lru_cache(maxsize=16)(genset_locus)
