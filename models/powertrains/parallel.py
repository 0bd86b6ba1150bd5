"""Parallel hybrid: engine and motor drive the gearbox together, the engine through a clutch."""

from halfshaft.models.model import Model
from halfshaft.models.powertrain import Derived, Powertrain
from halfshaft.models.rules import SumOfParts, TogetherAtTop

ROLES = {
    "body": ("body",),
    "wheel": ("wheel",),
    "final_drive": ("final-drive",),
    "gearbox": ("gearbox",),
    "shift": ("shift",),
    "coupler": ("torque-coupler",),
    "clutch": ("clutch",),
    "mechanical_accessories": ("mechanical-accessories",),
    "engine": ("engine",),
    "control": ("parallel-control",),
    "motor": ("motor",),
    "electric_accessories": ("electric-accessories",),
    "bus": ("bus",),
    "battery": ("battery",),
}


def connect(m: Model) -> None:
    """Connect the parts from the wheel to the engine, then from the coupler to the battery."""
    m.chain("body", "wheel", "final_drive", "gearbox", "coupler.engine", "clutch", "mechanical_accessories", "engine")
    m.chain("coupler.motor", "motor", "electric_accessories", "bus.battery", "battery")
    # Gears are chosen by the engine's load; the motor's is smaller.
    m.bind("shift", machine="engine")


parallel = Powertrain(
    "parallel", "parallel hybrid", ROLES, connect, (Derived("body.m", (SumOfParts,)), Derived("coupler.n", (TogetherAtTop,))),
    hybridisation=0.3,
)  # fmt: skip
