"""Fuel cell hybrid: the electric car with a fuel cell on its bus."""

from halfshaft.models.model import Model
from halfshaft.models.powertrain import Powertrain
from halfshaft.models.powertrains import electric

ROLES = {**electric.ROLES, "control": ("fuel-cell-control",), "fuel_cell": ("fuel-cell",)}


def connect(m: Model) -> None:
    """Connect the parts of the electric car, then the fuel cell."""
    electric.connect(m)
    m.chain("bus.generator", "fuel_cell")


fuel_cell = Powertrain("fuel_cell", "fuel cell hybrid", ROLES, connect, electric.electric.derived)
