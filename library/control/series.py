"""Control of a series hybrid: thermostat and power follower, one law with two parameter sets.

In each step:

1. the engine power that would supply the bus through the generator, at the locus of best genset speed;
2. plus a charging power in proportion to how far the state of charge is below the middle of its window;
3. cut to the range of normal power (no upper cut when the battery is short) and slewed;
4. engine on below the lower end of the window, off above the upper end, or by demand after the least off time;
5. the operating point: speed from the locus, torque by power.

The thermostat has equal lowest and highest power and no slew, so it runs at one point.  In the first half second (at
least one step) after a start the engine only spins up.  The average of the demand over five seconds is kept in
one-second parts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from halfshaft.library.base.component import Component, From, Signal, State, Variable, face
from halfshaft.library.base.errors import InputError
from halfshaft.library.base.expressions import clip, where
from halfshaft.library.base.parameters import Parameters, Relation, param, table
from halfshaft.library.base.ports import Expr
from halfshaft.library.base.tables import Axis, Table
from halfshaft.library.electric.generator import Generator, GeneratorParameters
from halfshaft.library.engine.engine import Engine, EngineParameters

#: Of a genset's locus: speeds to choose from and power, at most, and the least efficiency that it reckons with [1, W, 1].
MOST_SPEEDS, MOST_POWER, LOWEST_EFFICIENCY = 20_000, 1e12, 1e-3
#: One-second parts of the five-second average.
PARTS = 5


@dataclass(frozen=True, kw_only=True)
class SeriesControlParameters(Parameters):
    """Window of the state of charge, powers and times."""

    soc_high: float = param("1", "state of charge above which the engine is off", 0.8, ge=1e-3, le=1, tag="highest charge")
    soc_low: float = param("1", "state of charge below which the engine is on", 0.4, ge=0, le=0.999)
    on_start: float = param("1", "1 if the engine is on at the start", 0.0, ge=0, le=1)
    P_min_share: float = param("1", "lowest engine power over its largest", 0.5, ge=1e-3, le=1)
    P_max_share: float = param("1", "highest normal engine power over its largest", 0.5, ge=1e-3, le=1)
    P_charge: float = param("W", "charging power at the lower end of the window", 0.0, ge=0, le=1e8)
    t_off_min: float = param("s", "shortest time off; very long for a thermostat", 1e9, ge=0, le=1e12)
    P_rise: float = param("W/s", "fastest rise of engine power", 0.0, ge=0, le=1e9)
    P_fall: float = param("W/s", "fastest fall of engine power", 0.0, ge=0, le=1e9)
    charge_depleting: float = param("1", "1 to start the engine only in the lower half of the window", 0.0, ge=0, le=1)
    omega_locus: Table = table("rad/s", "genset speed of least fuel, for engine scales of 1", Axis("P", "W"), clip=True, ge=0)

    relations = (Relation(lambda p: p.soc_low >= p.soc_high, "soc_low = {soc_low:g} must be below soc_high = {soc_high:g}"),)


@dataclass(frozen=True)
class SeriesControl(Component):
    """Decides when the engine runs, and at which point."""

    kind = "series-control"
    p: SeriesControlParameters
    parameters = SeriesControlParameters
    states = (
        State("on_before", "1", "whether the engine was on in the previous step"),
        State("t_on", "s", "time since the engine was started"),
        State("t_off", "s", "time since the engine was stopped, below 0 in the step that stops it"),
        State("P_before", "W", "slewed engine power of the previous step; below 0 before the first"),
        State("turned_before", "1", "whether the genset had a speed command in the previous step"),
        State("part_time", "s", "time in the present part of the average"),
        State("part_energy", "J", "demand in the present part of the average"),
        *(State(f"part_{i}", "J", f"demand in the part {i} s ago") for i in range(1, PARTS + 1)),
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
    reads = (
        From("bus", P_bus="W"),
        From("battery", soc_before="1", P_battery_max="W", P_battery_min="W"),
        From("engine", Engine),
        From("generator", Generator),
    )

    def start(self) -> Mapping[str, Any]:
        """Return the start values."""
        return dict.fromkeys((s.name for s in self.states), 0.0) | {"on_before": self.p.on_start, "P_before": -1.0, "t_on": self.p.on_start}

    @face("omega_idle")
    def law(self) -> Mapping[str, Any]:
        """Publish the idling speed: a genset does not idle."""
        return {"omega_idle": 0.0}

    @face(
        "engine_on", "clutch_open", "omega_command", "tau_genset", "omega_genset", "P_engine_request", "next_on_before", "next_t_on",
        "next_t_off", "next_P_before", "next_turned_before", "next_part_time", "next_part_energy",
        *(f"next_part_{i}" for i in range(1, PARTS + 1)),
    )  # fmt: skip
    def control(
        self, P_bus: Expr, soc_before: Expr, P_battery_max: Expr, P_battery_min: Expr, key_on: Expr, dt: Expr, engine: Engine,
        generator: Generator, on_before: Expr, t_on: Expr, t_off: Expr, P_before: Expr, turned_before: Expr,
        part_time: Expr, part_energy: Expr, part_1: Expr, part_2: Expr, part_3: Expr, part_4: Expr, part_5: Expr,
    ) -> Mapping[str, Any]:  # fmt: skip
        """Decide for this step."""
        p, scale = self.p, engine.p.speed_scale * engine.p.torque_scale
        P_lowest, P_highest = (scale * x for x in p.omega_locus.inside(0))
        P_min, P_max = p.P_min_share * engine.P_largest, p.P_max_share * engine.P_largest
        short = P_bus >= P_battery_max

        def speed_of(P: Expr) -> Expr:
            return engine.p.speed_scale * p.omega_locus(P / scale)

        P_supply = clip(P_bus, P_lowest, P_highest)
        omega = speed_of(P_supply)
        eta = generator.power(P_supply / omega, omega) / P_supply
        P_supply = where(P_bus > 0, P_supply / ca.fmax(eta, 1e-6), 0)

        middle, half = (p.soc_high + p.soc_low) / 2, (p.soc_high - p.soc_low) / 2
        P_charge = p.P_charge * clip((middle - soc_before) / half, -1, 1)
        P_charge = where(P_bus <= 0, ca.fmin(P_bus - P_battery_min, P_charge), P_charge)
        P_asked = P_supply + P_charge

        P = ca.fmax(P_asked, P_min)
        P = where(ca.logic_and(ca.logic_not(short), soc_before >= p.soc_low), ca.fmin(P, P_max), P)
        P = where(P_before < 0, P, clip(P, P_before - p.P_fall * dt, P_before + p.P_rise * dt))

        parts = [part_1, part_2, part_3, part_4, part_5]
        average = sum(parts) / PARTS
        # The present step counts; the one after a stop begins to count at 0.
        off = where(t_off < 0, 0, t_off + dt)
        restart = ca.logic_and(off >= p.t_off_min - 1e-9, average >= 1.2 * P_min)
        wanted = ca.logic_or(ca.logic_or(on_before, restart), soc_before <= p.soc_low)
        wanted = ca.logic_and(wanted, ca.logic_or(soc_before <= p.soc_high, P_asked >= P_min))
        wanted = ca.logic_and(wanted, ca.logic_or(ca.logic_not(p.charge_depleting), soc_before <= middle))
        full = ca.logic_and(P_min > P_bus - P_battery_min, P_bus < 0)
        on = ca.logic_and(ca.logic_and(key_on, ca.logic_or(wanted, short)), ca.logic_not(full))

        P_genset = clip(P, P_lowest, P_highest)
        omega_locus = speed_of(P_genset)
        omega_command = where(on, where(turned_before, omega_locus, omega_locus / 2), 0)
        ready = ca.logic_and(on, t_on >= 0.5 - 1e-9)

        energy, time = part_energy + P_asked * dt, part_time + dt
        turn = time >= 1 - 1e-9
        shifted = [energy, *parts[:-1]]
        return {
            "engine_on": on,
            "clutch_open": ca.logic_not(ready),
            "omega_command": omega_command,
            "tau_genset": where(ready, P_genset / omega_locus, 0),
            "omega_genset": omega_command,
            "P_engine_request": P_asked,
            "next_on_before": on,
            "next_t_on": where(on, t_on + dt, 0),
            "next_t_off": where(ca.logic_and(on_before, ca.logic_not(on)), -1, off),
            "next_P_before": P,
            "next_turned_before": on,
            "next_part_time": where(turn, 0, time),
            "next_part_energy": where(turn, 0, energy),
            **{f"next_part_{i}": where(turn, new, old) for i, (new, old) in enumerate(zip(shifted, parts, strict=True), 1)},
        }


@np.errstate(all="ignore")
def genset_locus(engine: EngineParameters, generator: GeneratorParameters, n: int = 11) -> Table:
    """Return the genset speed of least fuel over engine power, for engine scales of 1.

    Fuel per work and generator efficiency are put on a grid of ``n`` by ``n`` points that both machines cover.  For each
    of ``n - 1`` equal parts of the power range every whole-numbered speed is tried; the cost is the engine's fuel per
    work over the generator's efficiency, plus 10 000 g/kWh outside of either envelope.  Where the generator's torques end
    below the lowest of the fuel map, the engine runs below its map, and burns what it burns at the map's lowest.

    Raises
    ------
    InputError
        If the two have no speed in common, or the engine's maps hold no power.

    """
    omega_engine, tau_engine = engine.fuel.points
    omega_generator = generator.P_electric.points[0] * generator.speed_scale
    tau_generator = generator.P_electric.points[1] * generator.torque_scale
    turning, driving = omega_engine > 0, tau_engine > 0
    omega_engine, tau_engine, fuel = omega_engine[turning], tau_engine[driving], engine.fuel.values[turning][:, driving]
    power = engine.tau_max.points[0] * engine.tau_max.values
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
    omega = np.linspace(low, high, n)
    tau = np.linspace(max(tau_engine[0], tau_generator[0]), min(tau_engine[-1], tau_generator[-1]), n)
    grid = np.stack(np.meshgrid(omega, tau, indexing="ij"), axis=-1)

    per_work = 3.6e9 * fuel / np.outer(omega_engine, tau_engine)
    per_work = _read((omega_engine, tau_engine), per_work, grid)
    scale = generator.speed_scale * generator.torque_scale
    electric = _read((omega_generator, tau_generator), scale * generator.P_electric.values, grid)
    efficiency = np.maximum(electric / np.outer(omega, tau), LOWEST_EFFICIENCY)
    envelope_engine = np.interp(omega, engine.tau_max.points[0], engine.tau_max.values)
    envelope_generator = generator.overtorque * generator.torque_scale * generator.tau_max.values
    envelope_generator = np.interp(omega, generator.tau_max.points[0] * generator.speed_scale, envelope_generator)

    P_low, P_top = omega_engine[0] * engine.fuel.points[1][driving][0], power.max()
    P_points, omega_points = [P_low], [omega_engine[0]]
    for P in P_low + (P_top - P_low) * np.arange(1, n - 1) / (n - 1):
        torques = np.clip(P / speeds, tau[0], tau[-1])
        points = np.stack([speeds, torques], axis=-1)
        over = (torques > np.interp(speeds, omega, envelope_engine)) | (torques > np.interp(speeds, omega, envelope_generator))
        cost = _read((omega, tau), per_work, points) / _read((omega, tau), efficiency, points)
        P_points.append(P)
        omega_points.append(speeds[np.argmin(cost + 10000 * over)])
    return Table.of([*P_points, P_top], values=[*omega_points, engine.tau_max.points[0][power.argmax()]])


def _read(axes: tuple[Any, Any], values: Any, points: Any) -> Any:
    """Return a map over two axes at points, of shape ``(..., 2)``."""
    read = ca.interpolant("read", "linear", [x.tolist() for x in axes], values.ravel(order="F").tolist())
    return np.array(read(points.reshape(-1, 2).T)).reshape(points.shape[:-1])
