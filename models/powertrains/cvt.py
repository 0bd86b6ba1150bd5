"""Conventional car with a continuous ratio between clutch and wheels."""

from halfshaft.models.model import Model
from halfshaft.models.powertrain import Powertrain
from halfshaft.models.powertrains import conventional

ROLES = {**conventional.ROLES, "gearbox": ("cvt",), "shift": ("cvt-control",)}


def connect(m: Model) -> None:
    """Connect the parts of the conventional car."""
    conventional.connect(m)


cvt = Powertrain("cvt", "conventional car with a continuous ratio", ROLES, connect, conventional.conventional.derived)
