"""The kinds of components that a file can name."""

from __future__ import annotations

from halfshaft.library.base.component import Component
from halfshaft.library.chassis.body import Body
from halfshaft.library.chassis.wheel import Wheel
from halfshaft.library.control.conventional import ConventionalControl
from halfshaft.library.control.series import SeriesControl
from halfshaft.library.control.shift import FixedGear, Shift
from halfshaft.library.driveline.clutch import Clutch
from halfshaft.library.driveline.final_drive import FinalDrive
from halfshaft.library.driveline.gearbox import MapGearbox, PolynomialGearbox
from halfshaft.library.electric.accessories import ElectricAccessories
from halfshaft.library.electric.battery import Battery
from halfshaft.library.electric.bus import Bus
from halfshaft.library.electric.generator import Generator
from halfshaft.library.electric.motor import Motor
from halfshaft.library.engine.accessories import MechanicalAccessories
from halfshaft.library.engine.engine import Engine

KINDS: dict[str, type[Component]] = {
    "body": Body,
    "wheel": Wheel,
    "final-drive": FinalDrive,
    "gearbox-polynomial": PolynomialGearbox,
    "gearbox-map": MapGearbox,
    "fixed-gear": FixedGear,
    "shift": Shift,
    "motor": Motor,
    "electric-accessories": ElectricAccessories,
    "mechanical-accessories": MechanicalAccessories,
    "bus": Bus,
    "battery": Battery,
    "engine": Engine,
    "generator": Generator,
    "clutch": Clutch,
    "conventional-control": ConventionalControl,
    "series-control": SeriesControl,
}
