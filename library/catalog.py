"""The kinds of components that a file can name."""

from __future__ import annotations

from halfshaft.library.accessories import ElectricAccessories, MechanicalAccessories
from halfshaft.library.battery import Battery
from halfshaft.library.body import Body
from halfshaft.library.bus import Bus
from halfshaft.library.clutch import Clutch
from halfshaft.library.component import Component
from halfshaft.library.conventional_control import ConventionalControl
from halfshaft.library.engine import Engine
from halfshaft.library.final_drive import FinalDrive
from halfshaft.library.gearbox import MapGearbox, PolynomialGearbox
from halfshaft.library.generator import Generator
from halfshaft.library.motor import Motor
from halfshaft.library.series_control import SeriesControl
from halfshaft.library.shift import FixedGear, Shift
from halfshaft.library.wheel import Wheel

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
