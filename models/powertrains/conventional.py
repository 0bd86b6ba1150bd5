"""Conventional car: engine, clutch and gearbox."""

from halfshaft.models.model import Model
from halfshaft.models.powertrain import Derived, Powertrain
from halfshaft.models.rules import SumOfParts

ROLES = {
    "body": ("body",),
    "wheel": ("wheel",),
    "final_drive": ("final-drive",),
    "gearbox": ("gearbox",),
    "shift": ("shift",),
    "clutch": ("clutch",),
    "accessories": ("mechanical-accessories",),
    "engine": ("engine",),
    "control": ("conventional-control",),
}


def connect(m: Model) -> None:
    """Connect the parts from the wheel to the source."""
    m.chain("body", "wheel", "final_drive", "gearbox", "clutch", "accessories", "engine")


conventional = Powertrain("conventional", "conventional car", ROLES, connect, (Derived("body.m", (SumOfParts,)),))
