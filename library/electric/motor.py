"""Motor with its controller, as a map of electric input power.

Numbers as in the paper::

    P_map   = f(tau, omega)                                                  (7)
    omega   = min(omega_asked, omega_max)                                    (8)
    tau     = min(tau_asked + J alpha, tau_max(omega))                       (9)
    omega_a = omega_before v_end / v_driveline, all of the previous step     (10)
    P       = min(P_map, I_max U_before)                                     (6)
    tau_out = tau P_available / P_map - J alpha                              (11)

``omega_a``, the speed actually reached, replaces ``omega`` in (7) and in the envelope of (9) after a missed trace.
Braking torques are cut to the generating envelope, with the same overtorque factor.  Two departures from the
original: no cap on ``J alpha``, and the ratio of (11) is kept between 0 and 1, which it leaves only where nearly no
power was asked for.  The controller is off at standstill, a deliberate switch.  Left out: the winding's temperature.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from halfshaft.library.base.component import From, Signal, State, Variable, face, plant
from halfshaft.library.base.expressions import LIFTED, Turning, clip, lifted, where
from halfshaft.library.base.interfaces import Machine
from halfshaft.library.base.links import Link, TwoSided, continuous, inertia, limit
from halfshaft.library.base.parameters import Parameters, Rated, Relation, each, param, plain, table
from halfshaft.library.base.ports import Electric, Expr, Port, Shaft
from halfshaft.library.base.tables import Axis, Table

SPEED, TORQUE = Axis("omega", "rad/s"), Axis("tau", "N.m")

#: Below this speed [rad/s] the controller is off.
OMEGA_OFF = 1e-3


@dataclass(frozen=True, kw_only=True)
class MotorParameters(Parameters):
    """Maps, limits and scales of a motor with its controller."""

    P_electric: Table = table("W", "electric input power", SPEED, TORQUE, clip=False)
    tau_max: Table = table("N.m", "continuous driving torque", SPEED, clip=False)
    tau_min: Table = table("N.m", "continuous braking torque, negative", SPEED, clip=False)
    omega_max: float = param("rad/s", "highest speed", ge=1, le=1e5, tag="top speed")
    J: float = param("kg.m^2", "rotor inertia", ge=0, le=100)
    overtorque: float = param("1", "short-time torque over continuous torque", 1.0, ge=0.01, le=100)
    I_max: float = param("A", "current limit of the controller", ge=0.1, le=1e9)
    U_min: float = param("V", "lowest supply voltage", 0.0, ge=0, le=1e4, tag="lowest supply voltage")
    speed_scale: float = param("1", "factor on all speeds", 1.0, ge=0.01, le=100, tag="speed scale")
    torque_scale: float = param("1", "factor on all torques", 1.0, ge=0.01, le=100, tag="drive size")
    efficiency_scale: float = param("1", "factor on the efficiency", 1.0, ge=0.01, le=100)
    mass: float = param("kg", "mass", 0.0, ge=0, le=1e5)

    relations: ClassVar[tuple[Relation, ...]] = (
        Relation(lambda p: lifted(p.efficiency_scale, p.P_electric, lambda work, P: [(work, P), (-P, -work)]), LIFTED),
    )

    rated: ClassVar[tuple[Rated, ...]] = (
        Rated("P_max", "W", "largest power at the shaft, overtorque included", "torque_scale", lambda p: p.P_peak()),
        Rated("e_max", "1", "best efficiency while driving", "efficiency_scale", lambda p: best_efficiency(p)),
    )

    def P_peak(self) -> float:
        """Return the largest power at the shaft, overtorque included [W]."""
        return peak_power(self)

    def ratings(self) -> Mapping[str, float]:
        """Return the largest power at the shaft [W]."""
        return {"traction power": self.P_peak()}


def peak_power(p: MotorParameters) -> float:
    """Return the largest power at the shaft, overtorque included [W]."""
    return plain(each(_peak, p.tau_max, p.omega_max) * p.overtorque * p.torque_scale * p.speed_scale)


# A sweep asks for the same part again and again.
@lru_cache(maxsize=64)
def _peak(tau_max: Table, omega_max: float) -> float:
    """Return the largest power under an envelope up to a speed [W]."""
    omega, tau = tau_max.points[0], tau_max.values
    if omega[0] > 0 or omega[-1] < omega_max:
        # The outermost pieces of the envelope are extended.
        ends = np.array([0.0, omega_max])
        omega, tau = np.append(omega, ends), np.append(tau, [tau_max(float(x)) for x in ends])
        order = np.argsort(omega, kind="stable")
        omega, tau = omega[order], tau[order]
    inside = (omega >= 0) & (omega <= omega_max)
    best = (tau * omega)[inside].max(initial=0.0)
    # Between two points the torque is a line, so the power is a parabola.
    slope = np.divide(np.diff(tau), np.diff(omega), out=np.zeros(len(omega) - 1), where=np.diff(omega) > 0)
    falls = slope < 0
    top = 0.5 * (omega[:-1][falls] - tau[:-1][falls] / slope[falls])
    between = (top > omega[:-1][falls]) & (top < np.minimum(omega[1:][falls], omega_max))
    return float(max(best, (-slope[falls] * top**2)[between].max(initial=0.0)))


def best_efficiency(p: MotorParameters) -> float:
    """Return the best efficiency of the map while driving."""
    work, P = np.outer(*p.P_electric.points), p.P_electric.values
    return plain(p.efficiency_scale * np.max(np.divide(work, P, out=np.zeros_like(P), where=(work > 0) & (P > 0))))


@dataclass(frozen=True)
class Motor(TwoSided, Machine):
    """Motor and controller between the gearbox's shaft and the supply."""

    kind = "motor"
    family = "motor"
    p: MotorParameters
    parameters = MotorParameters
    shaft = Port(Shaft, "wheel", tags={"omega": "machine speed"})
    dc = Port(Electric, "source", tags={"P": "traction input"})
    states: ClassVar[tuple[State, ...]] = (
        State("omega_before", "rad/s", "required speed of the previous step, below the top speed", neutral=0.0),
    )
    variables: ClassVar[tuple[Variable, ...]] = (
        Variable("tau_limited", "N.m", "required torque with inertia, after the envelope (eq. 9)", signal=True),
        Variable("throttle_motor", "1", "that torque over the envelope, negative while braking", signal=True),
        Variable("P_map", "W", "electric power of the map, before the current limit (eq. 7)"),
    )
    signals = (
        Signal("U_min", "V", "lowest supply voltage"),
        Signal("tau_rotor", "N.m", "required torque with inertia, before the envelope"),
    )
    reads: ClassVar[tuple[From, ...]] = (
        From("body", trace_missed="1", speed_ratio="1"),
        From("battery", U_supply="V"),
        From("shift", optional=True, shifting="1"),
        From("battery", U="V", P_room_out="W", P_room_in="W"),
        From("wheel", optional=True, tau_grip_out="N.m", tau_grip_in="N.m"),
        From("axle", optional=True, along=("shaft",), P_lack_out="W", P_lack_in="W"),
        From("node", optional=True, along=("dc",), forgiven="1"),
        From("coupler", optional=True, along=("shaft",), grip_forgiven="1"),
    )
    estimates = True

    @face("U_min")
    def law(self) -> Mapping[str, Any]:
        """Publish the voltage that the supply must keep."""
        return {"U_min": self.p.U_min}

    @face("tau_rotor")
    def request(self, shaft: Shaft) -> Mapping[str, Any]:
        """Publish what is asked of the rotor."""
        return {"tau_rotor": shaft.tau + self.p.J * shaft.alpha}

    def tau_envelope(self, omega: Expr) -> Expr:
        """Return the continuous driving torque at a speed [N.m]."""
        return self.envelope(omega, self.p.tau_max)

    @property
    def omega_max(self) -> Expr:
        """Highest speed [rad/s]."""
        return self.p.omega_max * self.p.speed_scale

    @property
    def tau_largest(self) -> Expr:
        """Largest torque of the envelope, overtorque left out [N.m]."""
        return self.p.torque_scale * float(self.p.tau_max.values.max())

    @property
    def P_largest(self) -> Expr:
        """Largest power of the envelope's points, overtorque left out [W]."""
        return self.p.speed_scale * self.p.torque_scale * float((self.p.tau_max.values * self.p.tau_max.points[0]).max())

    def envelope(self, omega: Expr, tau: Callable[[Expr], Expr]) -> Expr:
        """Return a scaled envelope at a speed, without overtorque [N.m]."""
        return self.p.torque_scale * tau(omega / self.p.speed_scale)

    def power(self, tau: Expr, omega: Expr) -> Expr:
        """Return the electric input power, equation (7) [W]."""
        p = self.p
        P = p.speed_scale * p.torque_scale * p.P_electric(omega / p.speed_scale, tau / p.torque_scale)
        return where(P >= 0, P / p.efficiency_scale, P * p.efficiency_scale)

    def limits(self, omega: Expr) -> tuple[Expr, Expr]:
        """Return the lowest and the highest torque at a speed, overtorque included [N.m]."""
        p = self.p
        return p.overtorque * self.envelope(omega, p.tau_min), p.overtorque * self.envelope(omega, p.tau_max)

    def chain(  # type: ignore[override]
        self, trace_missed: Expr, speed_ratio: Expr, omega_before: Expr, U_supply: Expr, turning: Turning, shifting: Expr = 0.0
    ) -> tuple[Link, ...]:
        """Return equations (8), (9), (7) and (6) in this order."""
        omega_top = self.omega_max

        def speed(asked: Shaft) -> Shaft:
            return asked._replace(omega=clip(asked.omega, 0, omega_top))

        def omega_map(s: Shaft) -> Expr:
            return where(trace_missed, ca.fmin(omega_before * speed_ratio, omega_top), s.omega)

        def torque(s: Shaft) -> Shaft:
            lowest, highest = self.limits(omega_map(s))
            return s._replace(tau=where(s.tau >= 0, ca.fmin(s.tau, highest), ca.fmax(s.tau, lowest)))

        def on(s: Shaft) -> Expr:
            return ca.fmax(turning(s.omega - OMEGA_OFF), 0) ** 2 * (1 - shifting)

        def off(s: Shaft) -> Shaft:
            return s._replace(tau=where(on(s), s.tau, 0))

        def power(s: Shaft) -> Electric:
            return Electric(on(s) * self.power(s.tau, omega_map(s)))

        def same_efficiency(asked: Shaft, sent: Electric, offered: Electric) -> Shaft:
            ratio = where(sent.P != 0, offered.P / where(sent.P != 0, sent.P, 1), 0)
            return asked._replace(tau=asked.tau * clip(ratio, 0, 1))

        def current(s: Electric) -> Electric:
            P_max = self.p.I_max * U_supply
            return Electric(clip(s.P, -P_max, P_max))

        return (
            limit(speed),
            inertia(self.p.J),
            limit(torque, "limited"),
            limit(off),
            Link(power, same_efficiency, "loss", False, "map", omega_map),
            limit(current),
        )

    def found(self, way: Mapping[str, tuple[Shaft, Shaft]]) -> Mapping[str, Any]:
        """Return the speed for equation (10), and the throttle."""
        asked, sent = way["limited"]
        lowest, highest = self.limits(sent.omega)
        limit = where(sent.tau >= 0, ca.fmax(highest, 1e-9), ca.fmax(-lowest, 1e-9))
        return {"next_omega_before": asked.omega, "throttle_motor": clip(sent.tau / limit, -1, 1)}

    @plant("dc", "P_loss", "P_kinetic", "_tau", "_omega", "_P")
    def flow(self, shaft: Shaft, turning: Turning) -> Mapping[str, Any]:
        """Return the electric power that the motion needs, in continuous time; backward the machine is its own mirror image."""
        facing = where(shaft.omega < 0, -1, 1)
        mirrored = Shaft(*(facing * x for x in shaft))
        power, booked = continuous(self.chain(0, 0, 0, 0, turning), mirrored)
        tau = shaft.tau + self.p.J * shaft.alpha
        return {"dc": power, "P_loss": booked.loss, "P_kinetic": booked.kinetic, "_tau": tau, "_omega": shaft.omega, "_P": power.P}

    @plant("balance")
    def drive(
        self, _tau: Expr, _omega: Expr, _P: Expr, throttle_motor: Expr, P_room_out: Expr, P_room_in: Expr, U: Expr,
        tau_grip_out: Expr = ca.inf, tau_grip_in: Expr = ca.inf, forgiven: Expr = 0.0,
        grip_forgiven: Expr = 0.0, P_lack_out: Expr | None = None, P_lack_in: Expr | None = None,
    ) -> Mapping[str, Any]:  # fmt: skip
        """Say when the motor gives what the motion needs: the throttle's torque, or less where power, current or grip end.

        The torque fades over the last half per cent below the top speed.
        """
        room = P_room_out, P_room_in, U, tau_grip_out, tau_grip_in, forgiven, grip_forgiven, P_lack_out, P_lack_in
        return {"balance": self.short(_tau, ca.fabs(_omega), _P, throttle_motor, *room)}

    def short(
        self, tau: Expr, omega: Expr, P: Expr, throttle: Expr, P_out: Expr, P_in: Expr, U: Expr,
        tau_out: Expr = ca.inf, tau_in: Expr = ca.inf, forgiven: Expr = 0.0,
        grip_forgiven: Expr = 0.0, P_lack_out: Expr | None = None, P_lack_in: Expr | None = None,
    ) -> Expr:  # fmt: skip
        """Return how much torque the machine gives beyond `tau`, at a throttle and with room for power and torque out and in."""
        lowest, highest = self.limits(omega)
        top = self.omega_max
        fade = clip((top - omega) / (0.005 * top), 0, 1)
        given = where(throttle >= 0, throttle * highest * fade, -throttle * lowest)
        scale = ca.fmax(omega, 10)
        P_max = self.p.I_max * U
        # A limit takes torque away, but does not turn it round where accessories, a genset or the brakes alone are beyond it.
        # Where several machines meet the limit of one store, or of the tyres, all balances would be the same; each forgives it a share
        # of what it lacks.
        lacks = scale * (given - tau) if P_lack_out is None else P_lack_out, scale * (tau - given) if P_lack_in is None else P_lack_in
        out, into = P_out + forgiven * lacks[0], P_in + forgiven * lacks[1]
        tau_out, tau_in = tau_out + grip_forgiven * (given - tau), tau_in + grip_forgiven * (tau - given)
        more = ca.fmax(ca.fmin(ca.fmin(out, P_max - P) / scale, tau_out), -tau)
        less = ca.fmin(-ca.fmin(ca.fmin(into, P_max + P) / scale, tau_in), -tau)
        return ca.fmax(ca.fmin(given - tau, more), less)
