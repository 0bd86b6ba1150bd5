"""Parallel hybrid with its motor behind the gearbox: the motor pulls while gears are changed."""

from halfshaft.models.model import Model
from halfshaft.models.powertrain import Derived, Powertrain
from halfshaft.models.powertrains import parallel
from halfshaft.models.rules import CouplerTopSpeed, SumOfParts


def connect(m: Model) -> None:
    """Connect the parts from the wheel to the engine, then from the coupler to the battery."""
    m.chain("body", "wheel", "final_drive", "coupler.engine", "gearbox", "clutch", "mechanical_accessories", "engine")
    m.chain("coupler.motor", "motor", "electric_accessories", "bus.battery", "battery")
    # No gear helps the motor, and no change of gear stops it.
    m.bind("shift", machine="engine", control=None)
    m.bind("motor", shift=None)


parallel_post = Powertrain(
    "parallel_post", "parallel hybrid, motor behind the gearbox", parallel.ROLES, connect,
    (Derived("body.m", (SumOfParts,)), Derived("coupler.n", (CouplerTopSpeed,))),
    hybridisation=0.3,
)  # fmt: skip
