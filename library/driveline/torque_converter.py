"""Torque converter between an automatic gearbox and the engine, with a lock-up clutch.

With the speeds of pump (the engine's side) and turbine (the gearbox's side) and the speed ratio ``nu = omega_t / omega_p``::

    tau_p = C(nu) omega_p^2                                                  (1)
    tau_t = R(nu) tau_p                                                      (2)

``C`` is the capacity, one over the square of what the field calls the K factor; it is zero where both turn equally fast and
negative where the wheels drive the engine.  ``R`` is the torque ratio.  Locked, torque and speed pass unchanged.

*Required* knows the turbine and looks for the pump.  (1) and (2) give no more than the ratio of ``tau_t`` to the square of a
speed, so that with ``Q^2 = omega_t^2 + tau_t / (R(0) C(0))``, the size of ``tau_t`` meant, the pump's speed is

    omega_p = Q q(omega_t / Q)                                               (3)

with one table ``q`` that follows from ``C`` and ``R``, from stall (0) over equal speeds (1) to overrun (beyond 1, counted back
down).  Between the points of the data (3) is the law, in the step and in the forward-facing model alike; solved for ``Q`` it is
straight between the same points, ``Q = omega_p r(nu)``, and gives the turbine's torque at two speeds.  ``R`` is read at the same
place ``omega_t / Q``.

The pump turns at idling speed at least: below it the car creeps, and what it creeps more than was asked for the brakes take.
To come to the pump's speed in this step from ``omega_own``, the one that the rotor has reached, the engine needs

    tau_p(omega_p) + tau_accessory + J (omega_p - omega_own) / dt            (4)

and nothing is cut if that lies between closed and full throttle there.  Else the pump comes no further, with the one or the other,
than to

    (J / dt omega_own + c omega_f) / (J / dt + c)                            (5)

where ``omega_f`` is the speed at which the pump takes all that the engine gives there, and ``c`` the mean slope of the pump's
torque between the two.  As that torque rises the faster the higher the speed, (5) mostly lies a little inside of what (4) allows.
Behind an open clutch (neutral) nothing passes.  After a missed trace the turbine's speed is the one really reached (paper eq. 10),
as in a motor.

The original takes (3) from the turbine's K factor alone, which needs no torque at equal speeds up to a limit; here a converter
that does not slip carries nothing.  It does not load an idling engine at standstill; this one does.  Left out: the oil's
temperature; the inertias of pump and turbine, which count to engine and gearbox.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from halfshaft.library.base.component import From, State, Variable, face, plant
from halfshaft.library.base.expressions import clip, where
from halfshaft.library.base.links import Link, TwoSided, limit
from halfshaft.library.base.parameters import Parameters, param, table
from halfshaft.library.base.ports import Expr, Port, Shaft
from halfshaft.library.base.tables import Axis, Table
from halfshaft.library.driveline.clutch import CAPACITY, OMEGA_SLIP
from halfshaft.library.engine.engine import Engine

RATIO = Axis("speed_ratio", "1")
#: Speed [rad/s] that rounds off (3) at standstill without torque.
OMEGA_FLOOR = 1e-3
#: Difference of speeds [rad/s] below which the slope of (5) fades: between two speeds so near it says nothing.
GAP_FLOOR = 0.1


def lengths(nu: npt.NDArray[np.float64], factor: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return Q over the pump's speed from a torque over the square of that speed, at speed ratios."""
    return np.asarray(np.sqrt(nu**2 + np.abs(factor) / factor[0]))


def pump_table(nu: npt.NDArray[np.float64], factor: npt.NDArray[np.float64]) -> Table:
    """Return the table of (3) from a torque over the square of the pump's speed at speed ratios."""
    Q = lengths(nu, factor)
    return Table.of(np.where(factor >= 0, nu / Q, 2 - nu / Q), values=1 / Q, clip=False)


@dataclass(frozen=True, kw_only=True)
class TorqueConverterParameters(Parameters):
    """Characteristic of a converter."""

    capacity: Table = table("N.m.s^2/rad^2", "pump's torque over the square of its speed", RATIO, clip=False)
    torque_ratio: Table = table("1", "turbine's torque over pump's torque", RATIO, clip=True, gt=0, le=10)
    capacity_scale: float = param(
        "1", "factor on the capacity, as the fifth power of the diameter", 1.0, ge=1e-3, le=1e3, tag="follows source"
    )

    def check(self) -> list[str]:
        """Return what is wrong: a pump's speed must follow from every torque."""
        nu, C = self.capacity.points[0], self.capacity.values
        problems = super().check()
        if nu[0] != 0 or C[0] <= 0:
            problems.append("capacity must begin at a speed ratio of 0, with a value > 0")
        elif np.any(np.diff(self.factor[1:] / nu[1:] ** 2) >= 0):
            problems.append("capacity times torque_ratio over the square of the speed ratio must fall from each point to the next")
        elif 1.0 not in nu or C[nu == 1] != 0:
            problems.append("capacity must have a point at a speed ratio of 1, with a value of 0")
        return problems

    @property
    def factor(self) -> npt.NDArray[np.float64]:
        """Turbine's torque over the square of the pump's speed at the points of the capacity."""
        return self.capacity.values * np.interp(self.capacity.points[0], self.torque_ratio.points[0], self.torque_ratio.values)

    @cached_property
    def pump_by_turbine(self) -> Table:
        """Table of (3) for the turbine's torque."""
        return pump_table(self.capacity.points[0], self.factor)

    @cached_property
    def ratio_by_turbine(self) -> Table:
        """Torque ratio at the places of that table."""
        ratio = np.interp(self.capacity.points[0], self.torque_ratio.points[0], self.torque_ratio.values)
        return Table.of(*self.pump_by_turbine.points, values=ratio)

    @cached_property
    def pump_by_pump(self) -> Table:
        """The same for the pump's torque."""
        return pump_table(self.capacity.points[0], self.capacity.values)

    @cached_property
    def length(self) -> Table:
        """Table of (3) solved for Q, over the pump's speed, by the speed ratio."""
        nu = self.capacity.points[0]
        return Table.of(nu, values=lengths(nu, self.factor), clip=False)


@dataclass(frozen=True)
class TorqueConverter(TwoSided):
    """Hydrodynamic torque converter with a lock-up clutch."""

    kind = "torque-converter"
    p: TorqueConverterParameters
    parameters = TorqueConverterParameters
    output = Port(Shaft, "wheel")
    input = Port(Shaft, "source")
    states = (State("omega_before", "rad/s", "required speed of the gearbox's output in the previous step"),)
    variables = (Variable("omega_pump", "rad/s", "required speed of the pump", signal=True),)
    estimates = True
    reads = (
        From("body", trace_missed="1", speed_ratio="1"),
        From("shift", geared="1", ratio="1"),
        From("control", clutch_open="1", omega_idle="rad/s"),
        From("engine", Engine),
        From("engine", omega_own="rad/s"),
        From("engine", omega_engine="rad/s"),
        From("accessories", optional=True, tau_accessory_before="N.m"),
        From("wheel", tau_grip_out="N.m", tau_grip_in="N.m"),
    )

    @property
    def stall_capacity(self) -> Expr:
        """Pump's torque over the square of its speed at stall [N.m.s^2/rad^2]."""
        return self.p.capacity_scale * float(self.p.capacity.values[0])

    @property
    def stall_factor(self) -> Expr:
        """Turbine's torque over the square of the pump's speed at stall [N.m.s^2/rad^2]."""
        return self.stall_capacity * float(self.p.torque_ratio.values[0])

    def omega_pump(self, tau: Expr, omega: Expr) -> Expr:
        """Return the pump's speed at a point of the turbine, equation (3) [rad/s]."""
        Q, place = self._place(tau / self.stall_factor, omega)
        return Q * self.p.pump_by_turbine(place)

    def tau_pump(self, tau: Expr, omega: Expr) -> Expr:
        """Return the pump's torque at a point of the turbine, equation (2) [N.m]."""
        return tau / self.p.ratio_by_turbine(self._place(tau / self.stall_factor, omega)[1])

    def omega_settled(self, tau: Expr, omega: Expr) -> Expr:
        """Return the speed at which the pump takes a torque, with the turbine at a speed [rad/s]."""
        Q, place = self._place(tau / self.stall_capacity, omega)
        return Q * self.p.pump_by_pump(place)

    def _place(self, square: Expr, omega: Expr) -> tuple[Expr, Expr]:
        # By cases, as the derivative of a size is zero at zero.
        Q = ca.sqrt(omega**2 + where(square >= 0, square, -square) + OMEGA_FLOOR**2)
        return Q, where(square >= 0, omega / Q, 2 - omega / Q)

    def tau_turbine(self, omega_pump: Expr, omega: Expr) -> Expr:
        """Return the turbine's torque at the speeds of pump and turbine, equation (3) solved for Q [N.m]."""
        nu = omega / ca.fmax(omega_pump, 1)
        square = (omega_pump * self.p.length(nu)) ** 2 - omega**2 - OMEGA_FLOOR**2
        return self.stall_factor * where(nu <= 1, square, -square)

    def tau_taken(self, omega_pump: Expr, omega: Expr) -> Expr:
        """Return the pump's torque at the speeds of pump and turbine [N.m]."""
        return self.tau_pump(self.tau_turbine(omega_pump, omega), omega)

    def within(
        self, tau: Expr, omega: Expr, engine: Engine, omega_own: Expr, omega_idle: Expr, tau_accessory: Expr, dt: Expr
    ) -> tuple[Expr, Expr, Expr]:
        """Return the turbine's torque that the engine can bring in this step, (4) and (5), and the pump's [N.m] and speed [rad/s]."""
        pump, tau_pump, J_dt = self.omega_pump(tau, omega), self.tau_pump(tau, omega), ca.fmax(engine.p.J, 1e-6) / dt
        wanted = clip(pump, omega_idle, engine.omega_max)
        closed, full = engine.tau_closed(wanted) - tau_accessory, engine.tau_max(wanted) - tau_accessory

        def settled(tau_engine: Expr) -> Expr:
            return clip(self.omega_settled(tau_engine - tau_accessory, omega), omega_idle, engine.omega_max)

        def needed(tau_pump: Expr) -> tuple[Expr, Expr]:
            """Return what the engine needs for the speed wanted, and whether it has that."""
            tau = tau_pump + J_dt * (wanted - omega_own)
            return tau, ca.logic_and(closed <= tau, tau <= full)

        # The pump comes to where it is asked to, else to idling or top speed, else to what the engine can do.
        asked = ca.logic_and(pump == wanted, needed(tau_pump)[1])
        tau_wanted = self.tau_turbine(wanted, omega)
        tau_pump_wanted = self.tau_pump(tau_wanted, omega)
        need, bound = needed(tau_pump_wanted)
        much = need > full
        # Full torque is that at the speed where the pump ends up, found from that at the present one.
        given = where(much, engine.tau_max(settled(engine.tau_max(omega_own))), engine.tau_closed(omega_own))
        end = settled(given)
        change = end - omega_own
        c = ca.fmax((given - tau_accessory - self.tau_taken(omega_own, omega)) * change, 0) / (change**2 + GAP_FLOOR**2)
        reached = ca.fmax((J_dt * omega_own + c * end) / (J_dt + c), omega_idle)
        reached = where(much, ca.fmin(wanted, reached), ca.fmax(wanted, reached))
        tau_reached = self.tau_turbine(reached, omega)
        return (
            where(asked, tau, where(bound, tau_wanted, tau_reached)),
            where(asked, tau_pump, where(bound, tau_pump_wanted, self.tau_pump(tau_reached, omega))),
            where(asked, pump, where(bound, wanted, reached)),
        )

    def chain(  # type: ignore[override]
        self, geared: Expr, clutch_open: Expr, engine: Engine, omega_own: Expr, omega_idle: Expr, dt: Expr,
        trace_missed: Expr, speed_ratio: Expr, omega_before: Expr, ratio: Expr, tau_accessory_before: Expr = 0.0,
    ) -> tuple[Link, ...]:  # fmt: skip
        """Return what the engine can do, and the converter itself."""
        rigid = ca.logic_or(geared, clutch_open)
        # Torque and speed of the pump, where the limit has found them.
        known: list[Expr] = []

        def turbine(load: Shaft) -> Expr:
            return where(ca.logic_and(trace_missed, ca.logic_not(rigid)), omega_before * speed_ratio * ratio, load.omega)

        def cut(load: Shaft) -> Shaft:
            tau, *known[:] = self.within(load.tau, turbine(load), engine, omega_own, omega_idle, tau_accessory_before, dt)
            return load._replace(tau=where(rigid, where(clutch_open, 0, load.tau), tau))

        def law(load: Shaft) -> Shaft:
            omega = turbine(load)
            tau, pump = known or (self.tau_pump(load.tau, omega), ca.fmax(self.omega_pump(load.tau, omega), omega_idle))
            return Shaft(where(rigid, load.tau, tau), where(rigid, load.omega, pump), load.alpha)

        def back(asked: Shaft, sent: Shaft, offered: Shaft) -> Shaft:
            passes = sent.tau != 0
            tau = offered.tau * where(passes, asked.tau / where(passes, sent.tau, 1), 1)
            locked = ca.logic_and(geared, ca.logic_not(clutch_open))
            return Shaft(where(clutch_open, 0, tau), where(locked, offered.omega, asked.omega), asked.alpha)

        return limit(cut), Link(law, back, name="oil", omega=turbine)

    @face("next_omega_before")
    def remember(self, output: Shaft, ratio: Expr) -> Mapping[str, Any]:
        """Remember the required speed, as that of the gearbox's output, which no change of gear makes jump."""
        return {"next_omega_before": output.omega / ratio}

    def found(self, way: Mapping[str, tuple[Shaft, Shaft]]) -> Mapping[str, Any]:
        """Return the required speed of the pump, which the control commands."""
        return {"omega_pump": way["oil"][1].omega}

    @plant("input", "P_loss", "balance")
    def flow(
        self, output: Shaft, omega_engine: Expr, geared: Expr, clutch_open: Expr, engine: Engine, tau_grip_out: Expr, tau_grip_in: Expr
    ) -> Mapping[str, Any]:  # fmt: skip
        """Return the torque of the pump at the engine's speed in continuous time.

        Equation (3) is the balance, as squares of speeds so that it is a torque; locked, the lock-up clutch is a friction pair.  The
        tyres' grip cuts what passes.
        """
        tau, omega = output.tau, output.omega
        pump = self.omega_pump(tau, omega)
        oil = (omega_engine**2 - ca.fabs(pump) * pump) * self.stall_factor
        friction = CAPACITY * engine.tau_largest * ca.tanh((omega_engine - omega) / OMEGA_SLIP) - tau
        gap = where(clutch_open, -tau, where(geared, friction, oil))
        tau_pump = where(ca.logic_or(geared, clutch_open), tau, self.tau_pump(tau, omega))
        return {
            "input": Shaft(tau_pump, omega_engine, 0.0),
            "P_loss": tau_pump * omega_engine - tau * omega,
            "balance": ca.fmax(ca.fmin(gap, ca.fmax(tau_grip_out, -tau)), ca.fmin(-tau_grip_in, -tau)),
        }
