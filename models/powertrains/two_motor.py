"""Battery electric car with two motors: one on the front axle and one on the rear axle."""

from halfshaft.models.model import Model
from halfshaft.models.powertrain import Derived, Powertrain
from halfshaft.models.rules import SumOfParts, TopSpeed

AXLES = ("front", "rear")
DRIVELINE = {
    "axle": ("axle",),
    "final_drive": ("final-drive",),
    "gearbox": ("gearbox",),
    "shift": ("gear-choice",),
    "motor": ("motor",),
}
ROLES = {
    "body": ("body",),
    "wheel": ("wheel",),
    "divider": ("axle-divider",),
    **{f"{role}_{axle}": kinds for axle in AXLES for role, kinds in DRIVELINE.items()},
    "node": ("electric-node",),
    "accessories": ("electric-accessories",),
    "bus": ("bus",),
    "battery": ("battery",),
}


def connect(m: Model) -> None:
    """Connect the parts from the wheel to the source, axle by axle, and say which driveline a part belongs to."""
    m.chain("body", "wheel", "divider")
    for axle, place in zip(AXLES, ("node.load", "node.other"), strict=True):
        own = {role: f"{role}_{axle}" for role in DRIVELINE}
        m.chain(f"divider.{axle}", own["axle"], own["final_drive"], own["gearbox"], own["motor"], place)
        m.bind(own["gearbox"], shift=own["shift"])
        m.bind(own["shift"], gearbox=own["gearbox"])
        m.bind(own["motor"], shift=own["shift"], wheel=own["axle"])
    m.chain("node", "accessories", "bus.battery", "battery")


two_motor = Powertrain(
    "two_motor", "battery electric car with a motor on each axle", ROLES, connect,
    (
        Derived("body.m", (SumOfParts,)),
        *(Derived(f"gearbox_{a}.ratios", (TopSpeed,), {"motor": f"motor_{a}", "final_drive": f"final_drive_{a}"}) for a in AXLES),
    ),
)  # fmt: skip
