"""Conventional car with an automatic gearbox and a torque converter that can be locked."""

from halfshaft.models.model import Model
from halfshaft.models.powertrain import Derived, Powertrain
from halfshaft.models.rules import SumOfParts

ROLES = {
    "body": ("body",),
    "wheel": ("wheel",),
    "final_drive": ("final-drive",),
    "gearbox": ("gearbox",),
    "shift": ("automatic-shift",),
    "converter": ("torque-converter",),
    "accessories": ("mechanical-accessories",),
    "engine": ("engine",),
    "control": ("automatic-control",),
}


def connect(m: Model) -> None:
    """Connect the parts from the wheel to the source."""
    m.chain("body", "wheel", "final_drive", "gearbox", "converter", "accessories", "engine")


automatic = Powertrain("automatic", "conventional car with torque converter", ROLES, connect, (Derived("body.m", (SumOfParts,)),))
