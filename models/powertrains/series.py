"""Series hybrid: the electric car with an engine and a generator on its bus."""

from halfshaft.models.model import Model
from halfshaft.models.powertrain import Derived, Powertrain
from halfshaft.models.powertrains import electric
from halfshaft.models.rules import GensetLocus

ROLES = {**electric.ROLES, "control": ("series-control",), "engine": ("engine",), "generator": ("generator",)}


def connect(m: Model) -> None:
    """Connect the parts of the electric car, then the genset."""
    electric.connect(m)
    m.chain("bus.generator", "generator", "engine")


series = Powertrain(
    "series", "series hybrid", ROLES, connect, (*electric.electric.derived, Derived("control.omega_locus", (GensetLocus,)))
)  # fmt: skip
