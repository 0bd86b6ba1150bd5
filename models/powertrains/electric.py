"""Battery electric car: one motor on one axle."""

from halfshaft.models.model import Model
from halfshaft.models.powertrain import Derived, Powertrain
from halfshaft.models.rules import SumOfParts, TopSpeed

ROLES = {
    "body": ("body",),
    "wheel": ("wheel",),
    "final_drive": ("final-drive",),
    "gearbox": ("gearbox",),
    "shift": ("gear-choice",),
    "motor": ("motor",),
    "accessories": ("electric-accessories",),
    "bus": ("bus",),
    "battery": ("battery",),
}


def connect(m: Model) -> None:
    """Connect the parts from the wheel to the source."""
    m.chain("body", "wheel", "final_drive", "gearbox", "motor", "accessories", "bus.battery", "battery")


electric = Powertrain(
    "electric", "battery electric car", ROLES, connect, (Derived("body.m", (SumOfParts,)), Derived("gearbox.ratios", (TopSpeed,)))
)  # fmt: skip
