"""Electric car whose motor drives through a propeller shaft."""

from halfshaft.models.powertrain import Powertrain
from halfshaft.models.powertrains import electric

ROLES = {**electric.ROLES, "propshaft": ("propshaft",)}


def connect(m):
    """Connect the parts from the wheel to the source."""
    m.chain("body", "wheel", "final_drive", "propshaft", "gearbox", "motor", "accessories", "bus.battery", "battery")


rear_motor = Powertrain("rear_motor", "electric car with a propeller shaft", ROLES, connect, electric.electric.derived)
