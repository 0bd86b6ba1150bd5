"""Mild hybrid: a machine on the crankshaft helps the engine, starts it, and makes the electricity on board."""

from halfshaft.models.model import Model
from halfshaft.models.powertrain import Derived, Powertrain
from halfshaft.models.powertrains import parallel
from halfshaft.models.rules import SumOfParts

ROLES = {**parallel.ROLES, "coupler": ("crankshaft-coupler",), "control": ("mild-control",)}


def connect(m: Model) -> None:
    """Connect the parts from the wheel to the engine, then from the crankshaft to the battery."""
    m.chain("body", "wheel", "final_drive", "gearbox", "clutch", "coupler.engine", "mechanical_accessories", "engine")
    m.chain("coupler.motor", "motor", "electric_accessories", "bus.battery", "battery")
    m.bind("shift", machine="engine")
    m.bind("clutch", engine="engine")
    # The clutch says what the tyres hold of the torque of both, and the machine turns while gears are changed.
    m.bind("motor", wheel=None, shift=None)


mild = Powertrain("mild", "mild hybrid", ROLES, connect, (Derived("body.m", (SumOfParts,)),), hybridisation=0.0)
