"""Results written before outputs and parameters had tags: what was known by name then."""

from __future__ import annotations

from typing import Any

from halfshaft.library.base.tags import Tag
from halfshaft.models.assembly import Description

#: Roles had fixed names up to format 2.
TAGS: dict[str, Tag] = {
    "body.v": "speed",
    "body.distance": "distance",
    "body.elevation": "elevation",
    "body.v_request": "request",
    "body.trace_miss": "miss",
    "body.overspeed": "overspeed",
    "body.F_required": "asked force",
    "body.P_aero": "air drag",
    "body.P_roll": "rolling resistance",
    "body.P_climb": "vehicle climbing power",
    "body.P_kinetic": "vehicle kinetic power",
    "body.m": "vehicle mass",
    "body.g": "gravity",
    "body.v_start": "start speed",
    "body.v_miss": "miss threshold",
    "wheel.F_limited": "grip force",
    "wheel.v_limited": "grip speed",
    "wheel.slip_limited": "grip limit",
    "wheel.F_brake_front": "brake force",
    "wheel.F_brake_rear": "brake force",
    "wheel.P_brake": "friction brakes",
    "wheel.P_slip": "tyre slip",
    "wheel.P_bearing": "wheel bearings",
    "shift.gear": "gear",
    "shift.t_shift": "shift time",
    "shift.t_hold": "hold time",
    "control.launch_share": "launch share",
    "control.soc_high": "highest charge",
    "engine.fuel_used": "fuel mass",
    "engine.omega_engine": "engine speed",
    "engine.tau_map": "engine torque",
    "engine.rho_fuel": "fuel density",
    "engine.H_fuel": "fuel heating value",
    "motor.omega": "machine speed",
    "motor.omega_max": "top speed",
    "motor.speed_scale": "speed scale",
    "motor.P_in": "traction input",
    "generator.P_out": "generated",
    "battery.soc": "charge",
    "battery.soc_start": "start charge",
    "battery.T": "temperature",
    "battery.battery_limited": "store limit",
}
WARNINGS = {
    "wheel.slip_limited": "grip limit reached",
    "battery.battery_limited": "battery limit reached",
    "engine.speed_limited": "{part} at its top speed",
}


def add_tags(plain: dict[str, Any]) -> None:
    """Add to a saved run of a format below 3 what its outputs and parameters are."""
    outputs = [Description(*d) for d in plain["outputs"]]
    plain["outputs"] = [d._replace(tag=TAGS.get(d.name, ""), warning=WARNINGS.get(d.name, "")) for d in outputs]
    plain["inputs"]["tags"] = {name: TAGS[name] for name in plain["inputs"]["parameters"] if name in TAGS}
