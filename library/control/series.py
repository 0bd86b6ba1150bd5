"""Control of a series hybrid: thermostat and power follower, one law with two parameter sets.

When the engine runs and with what power is the power follower's part (`halfshaft.library.control.power_follower`); the
supply of the bus goes through the generator, at the locus of best genset speed.  Of the power follows the operating point:
speed from the locus, torque by power.  In the first half second (at least one step) after a start the engine only spins up.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from halfshaft.library.base.component import From, Signal, State, Variable, face
from halfshaft.library.base.errors import InputError
from halfshaft.library.base.expressions import clip, where
from halfshaft.library.base.parameters import table
from halfshaft.library.base.ports import Expr
from halfshaft.library.base.tables import Axis, Table
from halfshaft.library.control.power_follower import Demand, PowerFollower, PowerFollowerParameters, Supply
from halfshaft.library.electric.generator import Generator
from halfshaft.library.engine.engine import Engine

#: Of a genset's locus: speeds to choose from and power, at most, and the least efficiency that it reckons with [1, W, 1].
MOST_SPEEDS, MOST_POWER, LOWEST_EFFICIENCY = 20_000, 1e12, 1e-3


@dataclass(frozen=True, kw_only=True)
class SeriesControlParameters(PowerFollowerParameters):
    """Power follower for a genset."""

    omega_locus: Table = table("rad/s", "genset speed of least fuel, for engine scales of 1", Axis("P", "W"), clip=True, ge=0)


@dataclass(frozen=True)
class SeriesControl(PowerFollower):
    """Decides when the engine runs, and at which point."""

    kind = "series-control"
    p: SeriesControlParameters
    parameters = SeriesControlParameters
    states = (
        *PowerFollower.states,
        State("t_on", "s", "time since the engine was started"),
        State("turned_before", "1", "whether the genset had a speed command in the previous step"),
    )
    variables = (
        Variable("engine_on", "1", "whether the engine runs", signal=True, kind="flag"),
        Variable("clutch_open", "1", "whether the genset only spins", signal=True, kind="flag"),
        Variable("omega_command", "rad/s", "commanded engine speed", signal=True),
        Variable("tau_genset", "N.m", "commanded engine torque", signal=True),
        Variable("omega_genset", "rad/s", "speed at which the torque is asked for", signal=True),
        Variable("P_engine_request", "W", "engine power that demand and charging ask for"),
    )
    signals = (Signal("omega_idle", "rad/s", "idling speed"),)
    commands = tuple(c._replace(lasts=c.kind == "share") for c in PowerFollower.commands)
    reads = (*PowerFollower.reads, From("engine", Engine), From("generator", Generator))

    def start(self) -> Mapping[str, Any]:
        """Return the start values."""
        return {**super().start(), "t_on": self.p.on_start}

    @face("omega_idle")
    def law(self) -> Mapping[str, Any]:
        """Publish the idling speed: a genset does not idle."""
        return {"omega_idle": 0.0}

    def speed_of(self, P: Expr, engine: Engine) -> Expr:
        """Return the speed of the locus at an engine power [rad/s]."""
        scale = engine.p.speed_scale * engine.p.torque_scale
        return engine.p.speed_scale * self.p.omega_locus(P / scale)

    def on_locus(self, P: Expr, engine: Engine) -> Expr:
        """Return a power cut to the ends of the locus [W]."""
        scale = engine.p.speed_scale * engine.p.torque_scale
        P_lowest, P_highest = (scale * x for x in self.p.omega_locus.inside(0))
        return clip(P, P_lowest, P_highest)

    @face("_supply")
    def supply(self, P_bus: Expr, engine: Engine, generator: Generator) -> Mapping[str, Any]:
        """Return the engine power that supplies the bus through the generator."""
        P = self.on_locus(P_bus, engine)
        omega = self.speed_of(P, engine)
        eta = generator.power(P / omega, omega) / P
        P = where(P_bus > 0, P / ca.fmax(eta, 1e-6), 0)
        return {"_supply": Supply(P, self.p.P_min_share * engine.P_largest, self.p.P_max_share * engine.P_largest, engine.P_largest)}

    @face(
        "engine_on", "clutch_open", "omega_command", "tau_genset", "omega_genset", "P_engine_request", "next_t_on", "next_turned_before",
    )  # fmt: skip
    def operating_point(
        self, dt: Expr, engine: Engine, _demand: Demand, _P: Expr, _on: Expr, t_on: Expr, turned_before: Expr
    ) -> Mapping[str, Any]:
        """Return speed and torque of the genset."""
        P_genset = self.on_locus(_P, engine)
        omega_locus = self.speed_of(P_genset, engine)
        omega_command = where(_on, where(turned_before, omega_locus, omega_locus / 2), 0)
        ready = ca.logic_and(_on, t_on >= 0.5 - 1e-9)
        return {
            "engine_on": _on,
            "clutch_open": ca.logic_not(ready),
            "omega_command": omega_command,
            "tau_genset": where(ready, P_genset / omega_locus, 0),
            "omega_genset": omega_command,
            "P_engine_request": _demand.P,
            "next_t_on": where(_on, t_on + dt, 0),
            "next_turned_before": _on,
        }


#: The map and the envelope of a machine.
Maps: TypeAlias = tuple[Table, Table]


@np.errstate(all="ignore")
def genset_locus(engine: Maps, generator: Maps, speed_scale: float, torque_scale: float, overtorque: float, n: int = 11) -> Table:
    """Return the genset speed of least fuel over engine power, for engine scales of 1.

    The engine is given by its fuel map and its envelope, the generator by its map of power, its envelope and its factors.

    Fuel per work and generator efficiency are put on a grid of ``n`` by ``n`` points that both machines cover.  For each
    of ``n - 1`` equal parts of the power range every whole-numbered speed is tried; the cost is the engine's fuel per
    work over the generator's efficiency, plus 10 000 g/kWh outside of either envelope.  Where the generator's torques end
    below the lowest of the fuel map, the engine runs below its map, and burns what it burns at the map's lowest.

    Raises
    ------
    InputError
        If the two have no speed in common, or the engine's maps hold no power.

    """
    (fuel_map, tau_max), (P_electric, generator_tau_max) = engine, generator
    omega_engine, tau_engine = fuel_map.points
    omega_generator = P_electric.points[0] * speed_scale
    tau_generator = P_electric.points[1] * torque_scale
    turning, driving = omega_engine > 0, tau_engine > 0
    omega_engine, tau_engine, fuel = omega_engine[turning], tau_engine[driving], fuel_map.values[turning][:, driving]
    power = tau_max.points[0] * tau_max.values
    if not len(omega_engine) or not len(tau_engine) or not omega_engine[0] * tau_engine[0] < power.max() < MOST_POWER:
        raise InputError("genset_locus", ["the engine's maps hold no range of power"])
    low, high = max(omega_engine[0], omega_generator[0]), min(omega_engine[-1], omega_generator[-1])
    speeds = np.arange(np.ceil(low), np.floor(min(high, low + MOST_SPEEDS)) + 1)
    if low >= high or not len(speeds) or high - low > MOST_SPEEDS or tau_generator[-1] <= 0:
        ends = "engine {:.0f} to {:.0f}, generator {:.0f} to {:.0f} rad/s".format(*omega_engine[[0, -1]], *omega_generator[[0, -1]])
        raise InputError("genset_locus", [f"engine and generator have no range of speeds in common: {ends}"])
    if tau_generator[-1] <= max(tau_engine[0], tau_generator[0]):
        below = tau_generator[-1] * np.arange(1, n + 1) / (n + 1)
        tau_engine, fuel = np.append(below, tau_engine), np.hstack([np.repeat(fuel[:, :1], n, axis=1), fuel])
    if min(len(axis) for axis in (omega_engine, tau_engine, omega_generator, tau_generator)) < 2:
        raise InputError("genset_locus", ["the maps of engine and generator must have two points along each axis, the engine's above 0"])
    omega = np.linspace(low, high, n)
    tau = np.linspace(max(tau_engine[0], tau_generator[0]), min(tau_engine[-1], tau_generator[-1]), n)
    grid = np.stack(np.meshgrid(omega, tau, indexing="ij"), axis=-1)

    per_work = 3.6e9 * fuel / np.outer(omega_engine, tau_engine)
    per_work = _read((omega_engine, tau_engine), per_work, grid)
    scale = speed_scale * torque_scale
    electric = _read((omega_generator, tau_generator), scale * P_electric.values, grid)
    efficiency = np.maximum(electric / np.outer(omega, tau), LOWEST_EFFICIENCY)
    envelope_engine = np.interp(omega, tau_max.points[0], tau_max.values)
    envelope_generator = overtorque * torque_scale * generator_tau_max.values
    envelope_generator = np.interp(omega, generator_tau_max.points[0] * speed_scale, envelope_generator)

    P_low, P_top = omega_engine[0] * fuel_map.points[1][driving][0], power.max()
    P = P_low + (P_top - P_low) * np.arange(1, n - 1) / (n - 1)
    torques = np.clip(P[:, None] / speeds, tau[0], tau[-1])
    points = np.stack([np.broadcast_to(speeds, torques.shape), torques], axis=-1)
    over = (torques > np.interp(speeds, omega, envelope_engine)) | (torques > np.interp(speeds, omega, envelope_generator))
    cost = _read((omega, tau), per_work, points) / _read((omega, tau), efficiency, points)
    best = speeds[np.argmin(cost + 10000 * over, axis=1)]
    return Table.of([P_low, *P, P_top], values=[omega_engine[0], *best, tau_max.points[0][power.argmax()]])


def _read(axes: tuple[Any, Any], values: Any, points: Any) -> Any:
    """Return a map over two axes at points, of shape ``(..., 2)``; the outermost pieces are extended."""
    (i, t), (j, s) = (_place(axis, points[..., k]) for k, axis in enumerate(axes))
    low = (1 - t) * values[i, j] + t * values[i + 1, j]
    return (1 - s) * low + s * ((1 - t) * values[i, j + 1] + t * values[i + 1, j + 1])


def _place(axis: Any, x: Any) -> tuple[Any, Any]:
    """Return the interval of an axis in which each number lies, and where in it."""
    i = np.searchsorted(axis[1:-1], x, side="right")
    return i, (x - axis[i]) / (axis[i + 1] - axis[i])
