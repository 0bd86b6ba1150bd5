"""Motor with its temperature: one node, cooled by the wind and above a threshold by its coolant.

::

    m c_p dT/dt = Q - Q_coolant                                              (1)
    Q = P_loss + h A (T_ambient - T) + 0.9 sigma A (T_ambient^4 - T^4)       (2)
    h = 6 + 6 (|T_ambient - T| / 1000 K)^0.25 + 60 (v / (60 m/s))^0.63       (3) [W/(m^2.K)]
    Q_coolant = min(max(Q, 0), Q_coolant_max) while the key is on and T >= T_coolant     (4)

As in the original the temperature changes nothing, unless it is told to: between T_derate and T_stop the torque that the
envelope allows falls to nothing.  The powers in (3) are those of
``sqrt(x^2 + 1e-24)``, smooth at 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from halfshaft.library.base.component import From, State, face, plant
from halfshaft.library.base.expressions import Turning, clip, where
from halfshaft.library.base.links import Link, limit
from halfshaft.library.base.parameters import Relation, param
from halfshaft.library.base.ports import Expr, Shaft
from halfshaft.library.electric.motor import Motor, MotorParameters

#: Radiation of a black body [W/(m^2.K^4)], and of the motor over that.
SIGMA, EMISSIVITY = 5.67e-8, 0.9
#: Size below which the powers in (3) are smooth.
NEAR = 1e-12


def _power(x: Expr, exponent: float) -> Expr:
    """Return a power of a size, smooth at 0."""
    return (x**2 + NEAR**2) ** (exponent / 2)


@dataclass(frozen=True, kw_only=True)
class ThermalMotorParameters(MotorParameters):
    """Motor with its thermal node."""

    c_p: float = param("J/(kg.K)", "specific heat", 430.0, ge=10, le=1e5)
    A: float = param("m^2", "surface, for scales of 1", ge=0, le=100)
    T_start: float = param("K", "temperature at the start", 293.15, ge=200, le=500, tag="start temperature")
    T_ambient: float = param("K", "temperature of the air", 293.15, ge=200, le=400)
    T_coolant: float = param("K", "temperature above which the coolant runs", 318.15, ge=200, le=1000)
    Q_coolant_max: float = param("W", "largest heat that the coolant takes", 1e9, ge=0, le=1e9)
    T_derate: float = param("K", "temperature above which the torque is cut", 1e4, ge=200, le=1e5)
    T_stop: float = param("K", "temperature at which nothing of it is left", 2e4, ge=200, le=1e5)

    relations = (
        *MotorParameters.relations,
        Relation(lambda p: p.T_derate >= p.T_stop, "T_derate = {T_derate:g} K must be below T_stop = {T_stop:g} K"),
        Relation(lambda p: p.mass <= 0, "mass = {mass:g} kg must be above 0 for a motor with a temperature"),
    )


@dataclass(frozen=True)
class ThermalMotor(Motor):
    """Motor and controller with a temperature."""

    kind = "motor-thermal"
    p: ThermalMotorParameters
    parameters = ThermalMotorParameters
    states = (*Motor.states, State("T", "K", "temperature of the motor", shown=True, tag="temperature"))
    plant_states = ((states[-1], "T"),)
    reads = (*Motor.reads, From("body", v="m/s"))

    def start(self) -> Mapping[str, Any]:
        """Return the start values."""
        return {**super().start(), "T": self.p.T_start}

    def share(self, T: Expr) -> Expr:
        """Return the share of the envelope that is left at a temperature."""
        return clip((self.p.T_stop - T) / (self.p.T_stop - self.p.T_derate), 0, 1)

    def chain(  # type: ignore[override]
        self, trace_missed: Expr, speed_ratio: Expr, omega_before: Expr, U_supply: Expr, turning: Turning, shifting: Expr = 0.0,
        T: Expr = 0.0,
    ) -> tuple[Link, ...]:  # fmt: skip
        """Return the motor's chain, its torque cut once more where it is hot."""
        share = self.share(T)

        def derate(s: Shaft) -> Shaft:
            lowest, highest = self.limits(s.omega)
            return s._replace(tau=where(share < 1, clip(s.tau, share * lowest, share * highest), s.tau))

        links = super().chain(trace_missed, speed_ratio, omega_before, U_supply, turning, shifting)
        at = [link.name for link in links].index("limited") + 1
        return (*links[:at], limit(derate, "derated"), *links[at:])

    def found(self, way: Mapping[str, tuple[Shaft, Shaft]]) -> Mapping[str, Any]:
        """Return the speed for equation (10), and the throttle that is left."""
        return super().found({"limited": (way["limited"][0], way["derated"][1])})

    def warming(self, T: Expr, P_loss: Expr, v: Expr, key_on: Expr) -> Expr:
        """Return the rate of the temperature, equations (1) to (4) [K/s]."""
        p = self.p
        A, cooler = p.A * p.speed_scale * p.torque_scale, p.T_ambient - T
        h = 6 + 6 * _power(cooler / 1000, 0.25) + 60 * _power(v / 60, 0.63)
        Q = ca.fmax(P_loss, 0) + h * A * cooler + EMISSIVITY * SIGMA * A * (p.T_ambient**4 - T**4)
        coolant = where(ca.logic_and(key_on, p.T_coolant <= T), clip(Q, 0, p.Q_coolant_max), 0)
        return (Q - coolant) / (p.mass * p.c_p)

    @face("next_T")
    def warm(self, T: Expr, P_loss: Expr, v: Expr, key_on: Expr, dt: Expr) -> Mapping[str, Any]:
        """Return the temperature at the end of the step."""
        return {"next_T": T + dt * self.warming(T, P_loss, v, key_on)}

    @plant("der_T")
    def heat(self, T: Expr, P_loss: Expr, v: Expr, key_on: Expr) -> Mapping[str, Any]:
        """Return the rate of the temperature in continuous time."""
        return {"der_T": self.warming(T, P_loss, v, key_on)}
