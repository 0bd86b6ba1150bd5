"""Power split: engine and generator on a planetary gear, whose ring a motor drives together with the wheels."""

from halfshaft.models.model import Model
from halfshaft.models.powertrain import Derived, Powertrain
from halfshaft.models.rules import SumOfParts

ROLES = {
    "body": ("body",),
    "wheel": ("wheel",),
    "final_drive": ("final-drive",),
    "planetary": ("planetary-gear",),
    "engine": ("engine",),
    "motor": ("motor",),
    "generator": ("motor-generator",),
    "node": ("priority-node",),
    "accessories": ("electric-accessories",),
    "battery": ("battery",),
    "control": ("power-split-control",),
}


def connect(m: Model) -> None:
    """Connect the parts from the wheel to the sources."""
    m.chain("body", "wheel", "final_drive", "planetary.carrier", "engine")
    m.chain("planetary.motor", "motor", "node.load", "accessories", "battery")
    m.chain("planetary.sun", "generator", "node.other")


power_split = Powertrain("power_split", "power split hybrid", ROLES, connect, (Derived("body.m", (SumOfParts,)),))
