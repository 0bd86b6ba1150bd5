"""Vehicle body: mass, drag, climbing resistance, and the speed that follows.

With the mean speed of the step ``v`` and the acceleration ``a``::

    F = m a + F_res(v)                                                       (1), paper eq. 2 and 3
    F_res(v) = m g (f_0 + f_1 v) cos(theta) + m g sin(theta) + 0.5 rho c_d A v^2      (2)
    tan(theta) = grade

*Required* takes ``a`` from the requested end speed.  *Available* solves (1) for the mean speed, a quadratic, in the
form that survives zero drag; the end speed of the step is ``2 v - v_0``.  The body also says, once for all parts,
whether the trace was missed in the previous step and by what ratio (paper eq. 10).

Left out: rotating masses (each component has its own), cornering, wind.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca

from halfshaft.library.base.component import Assumed, Component, From, State, Unknown, Variable, face, plant
from halfshaft.library.base.expressions import Turning, where
from halfshaft.library.base.interfaces import Rolling
from halfshaft.library.base.parameters import Parameters, Relation, param
from halfshaft.library.base.ports import Expr, Port, Tyre

#: A body never brakes harder than this [m/s^2]; keeps the quadratic real.
A_FLOOR = -70.0


class Resistance(NamedTuple):
    """Equation (2) as a polynomial in speed; rolling and climbing parts kept apart."""

    roll_0: Expr
    roll_1: Expr
    roll_2: Expr
    climb: Expr
    aero: Expr

    def roll(self, v: Expr) -> Expr:
        """Return the rolling resistance of a moving body [N]."""
        return self.roll_0 + self.roll_1 * v + self.roll_2 * v**2

    def at(self, v: Expr, moving: Expr) -> Expr:
        """Return the force at a speed ahead [N]."""
        return moving * self.roll(v) + self.climb + self.aero * v**2

    def powers(self, v: Expr, moving: Expr, size: Expr) -> dict[str, Expr]:
        """Return what drag, tyres and slope take at a speed of this size [W]; backward too, the first two oppose the motion."""
        return {"P_aero": self.aero * size * v * v, "P_roll": moving * self.roll(size) * v, "P_climb": self.climb * v}


@dataclass(frozen=True, kw_only=True)
class MassParameters(Parameters):
    """Mass and geometry of the vehicle."""

    m: float = param("kg", "test mass", ge=10, le=1e6, tag="vehicle mass")
    g: float = param("m/s^2", "gravity", 9.81, ge=0.1, le=100, tag="gravity")
    front_share: float = param("1", "share of the weight on the front axle at rest", 0.6, ge=0, le=1)
    h: float = param("m", "height of the centre of gravity", 0.5, ge=0, le=10)
    wheelbase: float = param("m", "wheelbase", 2.6, ge=0.1, le=100)
    v_miss: float = param(
        "m/s", "a trace is missed when the vehicle is slower than the request by more than this", 0.44704, ge=1e-6, le=1e3,
        tag="miss threshold",
    )  # fmt: skip
    v_start: float = param("m/s", "speed at the start", 0.0, ge=0, le=1e3, tag="start speed")

    # A body this tall would tip over its wheels before they slip.
    relations = (Relation(lambda p: p.h >= p.wheelbase / 2, "h = {h:g} m must be below half of wheelbase = {wheelbase:g} m"),)


@dataclass(frozen=True)
class Body(Component):
    """The vehicle as a mass on the road; speeds are never negative.  A subclass gives its resistance."""

    family = "body"
    p: MassParameters
    tyre = Port(Tyre, "source")
    states = (
        State("v", "m/s", "speed of the vehicle", signal=True, shown=True, tag="speed"),
        State("distance", "m", "distance driven", shown=True, tag="distance"),
        State("elevation", "m", "height above the start", shown=True, tag="elevation"),
        State("trace_missed", "1", "whether the previous step missed its request", signal=True, neutral=0.0, tag="missed"),
        State("speed_ratio", "1", "end speed over the mean speed that the driveline offered, previous step", signal=True, neutral=1.0),
    )
    variables = (
        Variable("v_request", "m/s", "requested speed at the end of the step", tag="request"),
        Variable("F_required", "N", "force that the request needs, before any limit", tag="asked force"),
        Variable("v_mean", "m/s", "mean speed of the step"),
        Variable("trace_miss", "m/s", "request less achieved speed", tag="miss"),
        Variable("overspeed", "m/s", "achieved less requested speed", tag="overspeed"),
        Variable("P_aero", "W", "power lost to air drag", "loss", tag="air drag"),
        Variable("P_roll", "W", "power lost to rolling resistance", "loss", tag="rolling resistance"),
        Variable("P_climb", "W", "rate of change of potential energy", "potential", tag="vehicle climbing power"),
        Variable("P_kinetic", "W", "rate of change of the body's kinetic energy", "kinetic", tag="vehicle kinetic power"),
        Variable("P_mismatch", "W", "power offered at the required speed less that at the achieved speed", "mismatch"),
        Variable("P_limit", "W", "power not used because a speed limit or standstill acts", "limit"),
        Variable("a_request", "m/s^2", "requested acceleration", signal=True),
    )
    plant_states = ((states[0], "v"), (states[1], "distance"), (states[2], "elevation"))
    unknowns = (Unknown("a", "m/s^2", "acceleration"),)
    reads = (From("wheel", Rolling), From("wheel", v_driveline="m/s"))

    def start(self) -> Mapping[str, Any]:
        """Return the start values."""
        return {"v": self.p.v_start, "distance": 0.0, "elevation": 0.0, "trace_missed": 0.0, "speed_ratio": 0.0}

    def weight(self, grade: Expr) -> Expr:
        """Return the weight that presses on the road [N]."""
        return self.p.m * self.p.g * (1 / ca.sqrt(1 + grade**2))

    def loads(self, a: Expr, grade: Expr) -> tuple[Expr, Expr]:
        """Return the loads of the front and the rear axle at an acceleration [N]."""
        p, W = self.p, self.weight(grade)
        transfer = p.h / p.wheelbase * (p.m * a + W * grade)
        return p.front_share * W - transfer, (1 - p.front_share) * W + transfer

    def resistance(self, grade: Expr, wheel: Rolling) -> Resistance:
        """Return what opposes the motion on a slope."""
        raise NotImplementedError

    @face("tyre", "v_request", "a_request", "F_required", "_asked", "_resistance")
    def required(self, v_request: Expr, v: Expr, grade: Expr, dt: Expr, wheel: Rolling, turning: Turning) -> Mapping[str, Any]:
        """Return the force and mean speed that reach the requested end speed, equation (1)."""
        v_mean, a = (v + v_request) / 2, (v_request - v) / dt
        resistance = self.resistance(grade, wheel)
        # A vehicle that stands and shall stand is held by its brakes, on a slope too.
        F = where(v_mean > 0, self.p.m * a + resistance.at(v_mean, turning(v_mean)), 0)
        asked = Tyre(F, v_mean, a)
        return {"tyre": asked, "_asked": asked, "v_request": v_request, "a_request": a, "F_required": F, "_resistance": resistance}

    @face(
        "v_mean", "trace_miss", "overspeed", "next_v", "next_distance", "next_elevation", "next_trace_missed", "next_speed_ratio",
        "P_aero", "P_roll", "P_climb", "P_kinetic", "P_mismatch", "P_limit",
    )  # fmt: skip
    def available(
        self, tyre: Tyre, v_driveline: Expr, v: Expr, distance: Expr, elevation: Expr, v_request: Expr,
        grade: Expr, dt: Expr, turning: Turning, _resistance: Resistance, _asked: Tyre,
    ) -> Mapping[str, Any]:  # fmt: skip
        """Solve equation (1) for the mean speed and publish what was achieved."""
        m, drag = self.p.m, _resistance
        moving = turning(tyre.v)
        A, B = drag.aero + drag.roll_2 * moving, 2 * m / dt + drag.roll_1 * moving
        C = -2 * m * v / dt - ca.fmax(tyre.F, A_FLOOR * m) + drag.roll_0 * moving + drag.climb
        v_force = -2 * C / (B + ca.sqrt(ca.fmax(B**2 - 4 * A * C, 0)))
        # The driveline's speed bounds the speed from above, in hard braking from below.  The original tells braking by
        # the force alone; a large inertia torque in a step without drive would then lift the speed.
        braking = ca.logic_and(tyre.F < -m, v_request < v)
        v_mean = where(braking, ca.fmax(v_force, tyre.v), ca.fmin(v_force, tyre.v))
        v_end = 2 * v_mean - v
        v_end = where(v_end >= 1e-9, v_end, 0)
        # No limit acted: the request is reached, to the last bit.
        v_end = where(ca.logic_and(tyre.F == _asked.F, tyre.v == _asked.v), v_request, v_end)
        v_mean = (v + v_end) / 2
        F_used = m * (v_end - v) / dt + drag.at(v_mean, moving)
        return {
            "v_mean": v_mean,
            "trace_miss": v_request - v_end,
            "overspeed": v_end - v_request,
            "next_v": v_end,
            "next_distance": distance + v_mean * dt,
            "next_elevation": elevation + v_mean * dt * grade / ca.sqrt(1 + grade**2),
            "next_trace_missed": v_request - v_end > self.p.v_miss,
            "next_speed_ratio": where(v_driveline > 0, v_end / ca.fmax(v_driveline, 1e-12), 0),
            **drag.powers(v_mean, moving, v_mean),
            "P_kinetic": m * (v_end - v) / dt * v_mean,
            "P_mismatch": tyre.F * (tyre.v - v_mean),
            "P_limit": (tyre.F - F_used) * v_mean,
        }

    def audit(
        self, tyre: Tyre, v: Expr, next_v: Expr, elevation: Expr, next_elevation: Expr, grade: Expr, dt: Expr,
        P_aero: Expr, P_roll: Expr, P_climb: Expr, P_kinetic: Expr, wheel: Rolling, turning: Turning,
    ) -> Mapping[str, Any]:  # fmt: skip
        """Compare powers with the states, and the force with equation (1)."""
        m, drag, v_mean = self.p.m, self.resistance(grade, wheel), (v + next_v) / 2
        resisting = drag.at(v_mean, turning(tyre.v))
        used = m * (next_v - v) / dt + resisting
        return {
            "drag": P_aero + P_roll + P_climb - resisting * v_mean,
            "forces": Assumed((tyre.F - used) * v_mean),
            "kinetic energy": P_kinetic - m * (next_v**2 - v**2) / (2 * dt),
            "potential energy": P_climb - m * self.p.g * (next_elevation - elevation) / dt,
        }

    @plant("tyre", "der_v", "der_distance", "der_elevation", "P_aero", "P_roll", "P_climb", "P_kinetic")
    def motion(self, v: Expr, a: Expr, grade: Expr, wheel: Rolling, turning: Turning) -> Mapping[str, Any]:
        """Return what the tyres must carry at a speed and an acceleration, equation (1)."""
        drag, moving, size = self.resistance(grade, wheel), turning(v), ca.fabs(v)
        # Drag and tyres oppose the motion, backward too.
        resisting = moving * drag.roll(size) + drag.climb + drag.aero * size * v
        return {
            "tyre": Tyre(self.p.m * a + resisting, v, a),
            "der_v": a,
            "der_distance": v,
            "der_elevation": v * grade / ca.sqrt(1 + grade**2),
            **drag.powers(v, moving, size),
            "P_kinetic": self.p.m * a * v,
        }


@dataclass(frozen=True, kw_only=True)
class BodyParameters(MassParameters):
    """Mass, shape and geometry of the vehicle."""

    c_d: float = param("1", "drag coefficient", ge=0, le=10, tag="road load")
    A: float = param("m^2", "frontal area", ge=0, le=100)
    rho: float = param("kg/m^3", "air density", 1.2, ge=0, le=10)


@dataclass(frozen=True)
class ShapedBody(Body):
    """The vehicle by its shape."""

    kind = "body"
    p: BodyParameters
    parameters = BodyParameters

    def resistance(self, grade: Expr, wheel: Rolling) -> Resistance:
        """Return equation (2)."""
        W = self.weight(grade)
        return Resistance(*wheel.rolling(W, self.p.front_share), W * grade, 0.5 * self.p.rho * self.p.c_d * self.p.A)
