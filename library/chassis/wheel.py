"""Wheels and axles: slip, grip, weight transfer, brakes, bearing drag and inertia.

::

    omega = v (1 + slip(F / W)) / r                                          (1), paper eq. 1 and 4
    tau   = F_driveline r + tau_bearing(m) + J alpha                         (2), paper eq. 5
    W_f   = m g a_f cos(theta) - (h / L) (m a + m g sin(theta))              (3), rear axle likewise with the opposite sign

*Required* cuts the request to the grip of the driven axle (paper eq. 2, 3), splits braking between driveline and
friction brakes by speed, and applies (1) and (2).  *Available* returns the driveline's force, adds the friction brakes
that the request still needs within the grip, and where a speed limit acted turns (1) round (paper eq. 12).  No axle
brakes harder than its tyres hold: what one cannot take goes to the other.

``alpha`` is the acceleration of the required mean speed at the present slip.  The slip's rate is neglected, as in the
forward-facing model: in a short step a jump of slip would take more torque than there is.  Drag inside the grip limit is
linearised with ``v_end^2 ~ v_0 v_end``.  Left out: combined slip, tyre temperature, a dynamic rolling radius.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca

from halfshaft.library.base.component import Assumed, Component, From, Signal, State, Variable, face, plant
from halfshaft.library.base.expressions import Turning, clip, where
from halfshaft.library.base.interfaces import Rolling
from halfshaft.library.base.links import Link, Way, continuous, drag, homeward, inertia, outward
from halfshaft.library.base.parameters import Parameters, Relation, param, table
from halfshaft.library.base.ports import Expr, Port, Shaft, Tyre
from halfshaft.library.base.tables import Axis, Table
from halfshaft.library.chassis.body import Body

SPEED, SHARE = Axis("v", "m/s"), Axis("adhesion", "1")

#: Speed over which the friction brakes of the forward-facing model turn round [m/s]; on 20 % a car creeps 1.3 mm in a minute.
V_BRAKE = 1e-4


@dataclass(frozen=True, kw_only=True)
class AxleParameters(Parameters):
    """All wheels, axles and brakes of the vehicle together."""

    r: float = param("m", "rolling radius", ge=0.05, le=10)
    J: float = param("kg.m^2", "inertia of all wheels and axles", ge=0, le=1e4)
    mu_max: float = param("1", "largest force over weight", ge=0.01, le=2)
    front_driven: float = param("1", "1 if the front axle is driven", 1.0, ge=0, le=1)
    rear_driven: float = param("1", "1 if the rear axle is driven", 0.0, ge=0, le=1)
    F_brake_front_max: float = param("N", "largest friction brake force, front", 1e7, ge=1, le=1e9)
    F_brake_rear_max: float = param("N", "largest friction brake force, rear", 1e7, ge=1, le=1e9)
    slip: Table = table("1", "slip over force per weight", SHARE, clip=True, ge=0)
    tau_bearing: Table = table("N.m", "drag of bearings and released brakes over the vehicle's mass", Axis("m", "kg"), clip=False, ge=0)
    share_driveline: Table = table("1", "share of a braking force that the driveline takes", SPEED, clip=True, ge=0, le=1)
    share_front: Table = table("1", "share of a braking force that the front friction brakes take", SPEED, clip=True, ge=0, le=1)

    relations = (
        Relation(
            lambda p: p.front_driven + p.rear_driven == 0,
            "front_driven and rear_driven are both 0, at least one axle must be driven",
        ),
    )


class Grip(NamedTuple):
    """The request cut to the grip, and what the way back needs of it."""

    F: Expr
    v: Expr
    W_front: Expr
    W_rear: Expr
    W_driven: Expr
    limited: Expr


class Split(NamedTuple):
    """A force at the tyres, split between the driveline and the friction brakes."""

    driveline: Expr
    axle: Expr


@dataclass(frozen=True)
class Wheel(Component, Rolling):
    """Wheels, axles, tyres and brakes between the road and the final drive; a subclass gives their rolling resistance."""

    family = "wheel"
    p: AxleParameters
    tyre = Port(Tyre, "wheel")
    axle = Port(Shaft, "source")
    states = (State("v_before", "m/s", "required mean speed of the previous step"),)
    variables = (
        Variable("F_limited", "N", "required force after the grip limit", tag="grip force"),
        Variable("v_limited", "m/s", "required mean speed after the grip limit", signal=True, tag="grip speed"),
        Variable(
            "slip_limited", "1", "whether the grip limit acts", signal=True, kind="flag", tag="grip limit", warning="grip limit reached"
        ),
        Variable("slip", "1", "slip of the driven axle, required"),
        Variable("F_brake_front", "N", "friction brake force, front", signal=True, tag="brake force"),
        Variable("F_brake_rear", "N", "friction brake force, rear", signal=True, tag="brake force"),
        Variable("F_friction_required", "N", "friction brake force that the split of the request asks for"),
        Variable("F_driveline_required", "N", "driveline force that the split of the request asks for"),
        Variable("v_driveline", "m/s", "mean vehicle speed that the driveline's speed allows", signal=True),
        Variable("P_brake", "W", "power lost in the friction brakes", "loss", tag="friction brakes"),
        Variable("P_slip", "W", "power lost by slip", "loss", tag="tyre slip"),
        Variable("P_bearing", "W", "power lost in bearings", "loss", tag="wheel bearings"),
        Variable("P_kinetic", "W", "rate of change of the wheels' kinetic energy", "kinetic"),
        Variable("P_discretisation", "W", "inertia work by difference quotients less that rate", "discretisation"),
    )
    signals = (
        Signal("tau_grip_out", "N.m", "what the driven axle may drive more before its tyres slip"),
        Signal("tau_grip_in", "N.m", "what it may brake more"),
        Signal("share_front", "1", "share of the load of the driven axles that the front one bears"),
        Signal("tau_front_out", "N.m", "what the driveline may drive the front axle before its tyres slip"),
        Signal("tau_front_in", "N.m", "what it may brake it"),
        Signal("tau_rear_out", "N.m", "what it may drive the rear axle"),
        Signal("tau_rear_in", "N.m", "what it may brake it"),
    )
    reads = (From("body", Body), From("body", v="m/s"))

    def start(self, v: Expr) -> Mapping[str, Any]:  # type: ignore[override]
        """Return the start values: rolling without slip."""
        return {"v_before": v}

    def bearing(self, m: Expr) -> Expr:
        """Return the drag of bearings and released brakes at the road [N]."""
        return self.p.tau_bearing(m) / self.p.r

    def grip(self, tyre: Tyre, v: Expr, grade: Expr, dt: Expr, body: Body) -> Grip:
        """Return the request cut to what the driven axle can transmit (paper eq. 2, 3)."""
        p, q, W = self.p, body.p, body.weight(grade)
        m, drag = q.m, body.resistance(grade, self)
        climb, aero = drag.climb, drag.aero + drag.roll_2
        static = p.mu_max * W * (p.front_driven * q.front_share + p.rear_driven * (1 - q.front_share))
        transfer = p.mu_max * q.h / q.wheelbase * (p.front_driven - p.rear_driven)
        rest = -drag.roll_0 - climb - 0.5 * drag.roll_1 * v - 0.25 * aero * v**2 + m * v / dt
        slope = 0.75 * aero * v + 0.5 * drag.roll_1 + m / dt
        v_highest = (static - transfer * climb + rest + transfer * m * v / dt) / (slope + transfer * m / dt)
        v_lowest = (-static + transfer * climb + rest - transfer * m * v / dt) / (slope - transfer * m / dt)
        v_mean = clip(tyre.v, (v_lowest + v) / 2, (v_highest + v) / 2)
        front, rear = body.loads(2 * (v_mean - v) / dt, grade)
        W_driven = p.front_driven * front + p.rear_driven * rear
        F_max = p.mu_max * W_driven
        F = clip(tyre.F, -F_max, F_max)
        return Grip(F, v_mean, front, rear, W_driven, F != tyre.F)

    def split(self, F: Expr, v: Expr) -> Split:
        """Return the driveline's share of a force and the force on the driven axle.

        A driving force is the driveline's alone.  A braking force is shared by speed; friction brakes of an axle
        that is not driven never load the driven one.
        """
        p = self.p
        driveline, front = p.share_driveline(v), p.share_front(v)
        rear = clip(1 - driveline - front, 0, 1)
        other = (1 - p.front_driven) * front + (1 - p.rear_driven) * rear
        return Split(where(F >= 0, F, F * driveline), where(F >= 0, F, F * (1 - other)))

    def slip(self, F: Expr, W: Expr) -> Expr:
        """Return the slip at a force on an axle that carries the weight `W`."""
        return ca.sign(F) * self.p.slip(ca.fabs(F) / ca.fmax(W, 1e-3))

    def shaft(self, F: Expr, omega: Expr, alpha: Expr) -> Shaft:
        """Return the shaft point at the tread: force times radius, before bearings and inertia."""
        return Shaft(F * self.p.r, omega, alpha)

    def chain(self, turning: Turning, body: Body) -> tuple[Link, Link]:
        """Return bearing drag and inertia, equation (2)."""
        return drag(lambda shaft: turning(shaft.omega) * self.p.tau_bearing(body.p.m)), inertia(self.p.J)

    @face(
        "axle", "F_limited", "v_limited", "slip_limited", "slip", "F_friction_required", "F_driveline_required",
        "next_v_before", "_asked", "_grip", "_split", "_way", "share_front",
        "tau_front_out", "tau_front_in", "tau_rear_out", "tau_rear_in",
    )  # fmt: skip
    def required(self, tyre: Tyre, v: Expr, grade: Expr, dt: Expr, body: Body, v_before: Expr, turning: Turning) -> Mapping[str, Any]:
        """Return the axle point that the request needs, equations (1) and (2)."""
        grip = self.grip(tyre, v, grade, dt, body)
        split = self.split(grip.F, tyre.v)
        slip = self.slip(split.axle, grip.W_driven)
        omega = grip.v * (1 + slip) / self.p.r
        tread = self.shaft(split.driveline, omega, (grip.v - v_before) / dt * (1 + slip) / self.p.r)
        way = outward(self.chain(turning, body), tread)
        F_front, F_rear = self.friction(grip.F - split.driveline, tyre.v, ca.inf, ca.inf)
        F_most = self.p.front_driven * self.p.mu_max * grip.W_front, self.p.rear_driven * self.p.mu_max * grip.W_rear
        return {
            "axle": way[-1][2],
            "F_limited": grip.F,
            "v_limited": grip.v,
            "slip_limited": grip.limited,
            "slip": slip,
            "F_friction_required": grip.F - split.driveline,
            "F_driveline_required": split.driveline,
            "next_v_before": grip.v,
            "_asked": tyre,
            "_grip": grip,
            "_split": split,
            "_way": way,
            "share_front": self.p.front_driven * grip.W_front / grip.W_driven,
            **self.held(*F_most, F_front, F_rear, way[-1][2].tau - tread.tau),
        }

    @face(
        "tyre", "v_driveline", "F_brake_front", "F_brake_rear",
        "P_brake", "P_slip", "P_bearing", "P_kinetic", "P_discretisation",
    )  # fmt: skip
    def available(self, axle: Shaft, dt: Expr, _asked: Tyre, _grip: Grip, _split: Split, _way: Way) -> Mapping[str, Any]:
        """Return the force and speed at the road that the offered axle point gives."""
        p = self.p
        tread, books = homeward(_way, axle, dt)
        (_, at_tread, _), (_, _, at_axle) = _way
        F_driveline = where(tread.tau == at_tread.tau, _split.driveline, tread.tau / p.r)
        # Brakes within their limits bring just what the request still needs, as far as the tyres hold it.
        F_needed = where(_grip.F < 0, ca.fmin(_grip.F, F_driveline), F_driveline)
        room_front, room_rear = self.room(F_driveline, _grip)
        F = ca.fmax(F_needed, F_driveline - room_front - room_rear)
        F_front, F_rear = self.friction(F_needed - F_driveline, _asked.v, room_front, room_rear)
        F_driven = F_driveline + where(p.front_driven, F_front, 0) + where(p.rear_driven, F_rear, 0)
        v_driveline = p.r * axle.omega / (1 + self.slip(F_driven, _grip.W_driven))
        v_tyre = where(ca.fabs(at_axle.omega - axle.omega) > 1e-3, v_driveline, _grip.v)
        return {
            "tyre": Tyre(F, v_tyre, _asked.a),
            "v_driveline": v_driveline,
            "F_brake_front": F_front,
            "F_brake_rear": F_rear,
            "P_brake": -(F_driven - F_driveline) * p.r * axle.omega - (F - F_driven) * v_tyre,
            "P_slip": F_driven * (p.r * axle.omega - v_tyre),
            "P_bearing": books.loss,
            "P_kinetic": books.kinetic,
            "P_discretisation": books.discretisation,
        }

    def audit(
        self, tyre: Tyre, axle: Shaft, F_brake_front: Expr, F_brake_rear: Expr, P_brake: Expr, P_slip: Expr, P_bearing: Expr,
        P_kinetic: Expr, P_discretisation: Expr, v: Expr, dt: Expr, grade: Expr, body: Body, turning: Turning,
    ) -> Mapping[str, Any]:  # fmt: skip
        """Compare the axle with the forces at the road: equations (1) and (2), each as it stands in the text."""
        p = self.p
        F_driveline = tyre.F - F_brake_front - F_brake_rear
        F_driven = tyre.F - (1 - p.front_driven) * F_brake_front - (1 - p.rear_driven) * F_brake_rear
        front, rear = body.loads(2 * (tyre.v - v) / dt, grade)
        slip = self.slip(F_driven, p.front_driven * front + p.rear_driven * rear)
        v_tread = p.r * axle.omega
        bearing = turning(axle.omega) * p.tau_bearing(body.p.m) * axle.omega
        return {
            "torque at the tread": axle.P - bearing - P_kinetic - P_discretisation - F_driveline * v_tread,
            "slip": Assumed(P_slip - F_driven * tyre.v * slip),
            # A brake on the driven axle turns with its wheels, one on the other axle with the road.
            "brakes": P_brake + (F_driven - F_driveline) * v_tread + (tyre.F - F_driven) * tyre.v,
            "bearings": P_bearing - bearing,
        }

    def room(self, F_driveline: Expr, grip: Grip) -> tuple[Expr, Expr]:
        """Return the largest friction brake forces, front and rear: what the brakes can, and the tyres beside the driveline.

        Two driven axles share the driveline's force in halves.
        """
        p = self.p
        share = p.front_driven / (p.front_driven + p.rear_driven)
        front, rear = p.mu_max * grip.W_front + share * F_driveline, p.mu_max * grip.W_rear + (1 - share) * F_driveline
        return clip(front, 0, p.F_brake_front_max), clip(rear, 0, p.F_brake_rear_max)

    def friction(self, F: Expr, v: Expr, room_front: Expr, room_rear: Expr) -> tuple[Expr, Expr]:
        """Return the friction brake forces, front and rear, that make up `F` (negative) at the speed `v` within their room."""
        p = self.p
        driveline = p.share_driveline(v)
        share = where(driveline < 1, clip(p.share_front(v) / ca.fmax(1 - driveline, 1e-12), 0, 1), 0.6)
        front = ca.fmax(ca.fmin(share * F, F + room_rear), -room_front)
        return front, ca.fmax(F - front, -room_rear)

    @plant(
        "axle", "P_brake", "P_slip", "P_bearing", "P_kinetic", "tau_grip_out", "tau_grip_in",
        "tau_front_out", "tau_front_in", "tau_rear_out", "tau_rear_in",
    )  # fmt: skip
    def flow(self, tyre: Tyre, F_brake_front: Expr, F_brake_rear: Expr, grade: Expr, body: Body, turning: Turning) -> Mapping[str, Any]:
        """Return the axle point in continuous time, and how far the driven axle is from its grip.

        The friction brakes' forces are held between samples.  They oppose the motion, hold at standstill what the tyres can
        hold, and keep the vehicle from rolling back.
        """
        p, loads = self.p, body.loads(tyre.a, grade)

        def brake(F: Expr, F_most: Expr, load: Expr) -> Expr:
            lowest = ca.fmax(-F_most, -p.mu_max * ca.fmax(load, 0))
            return where(tyre.v < 0, lowest, ca.fmax(F, lowest)) * ca.tanh(tyre.v / V_BRAKE)

        front, rear = brake(F_brake_front, p.F_brake_front_max, loads[0]), brake(F_brake_rear, p.F_brake_rear_max, loads[1])
        F_driveline = tyre.F - front - rear
        F_driven = F_driveline + where(p.front_driven, front, 0) + where(p.rear_driven, rear, 0)
        W_driven = p.front_driven * loads[0] + p.rear_driven * loads[1]
        slip = turning(tyre.v) * self.slip(F_driven, W_driven)
        point = self.shaft(F_driveline, tyre.v * (1 + slip) / p.r, tyre.a * (1 + slip) / p.r)
        axle, books = continuous(self.chain(turning, body), point)
        return {
            "axle": axle,
            "P_brake": -(F_driven - F_driveline) * p.r * point.omega - (tyre.F - F_driven) * tyre.v,
            "P_slip": F_driven * (p.r * point.omega - tyre.v),
            "P_bearing": books.loss,
            "P_kinetic": books.kinetic,
            "tau_grip_out": p.r * (p.mu_max * W_driven - F_driven),
            "tau_grip_in": p.r * (p.mu_max * W_driven + F_driven),
            **self.held(p.mu_max * loads[0], p.mu_max * loads[1], front, rear, axle.tau - point.tau),
        }

    def held(self, F_most_front: Expr, F_most_rear: Expr, front: Expr, rear: Expr, tau: Expr) -> Mapping[str, Any]:
        """Return what tyres hold of a driveline beside the friction brakes, axle by axle; of bearings and inertia each bears half."""
        r = self.p.r
        return {
            "tau_front_out": r * (F_most_front - front) + tau / 2,
            "tau_front_in": r * (F_most_front + front) - tau / 2,
            "tau_rear_out": r * (F_most_rear - rear) + tau / 2,
            "tau_rear_in": r * (F_most_rear + rear) - tau / 2,
        }


@dataclass(frozen=True, kw_only=True)
class WheelParameters(AxleParameters):
    """Wheels whose rolling resistance is a share of the weight."""

    f_0: float = param("1", "rolling resistance, constant part", ge=0, le=1, tag="road load")
    f_1: float = param("s/m", "rolling resistance, part that grows with speed", 0.0, ge=0, le=0.1, tag="road load")


@dataclass(frozen=True)
class PlainWheel(Wheel):
    """Wheels whose rolling resistance is a share of the weight."""

    kind = "wheel"
    p: WheelParameters
    parameters = WheelParameters

    def rolling(self, W: Expr, front_share: Expr) -> tuple[Expr, Expr, Expr]:
        """Return the rolling resistance by speed [N]."""
        return W * self.p.f_0, W * self.p.f_1, 0


@dataclass(frozen=True, kw_only=True)
class J2452WheelParameters(AxleParameters):
    """Wheels whose rolling resistance was measured after SAE J2452; the regression is in kPa, N and km/h."""

    pressure: float = param("Pa", "pressure of the tyres", ge=1e4, le=2e6)
    alpha: float = param("1", "exponent of the pressure", ge=-3, le=1)
    beta: float = param("1", "exponent of the load", ge=0.1, le=3)
    a: float = param("1", "constant coefficient", ge=0, le=100, tag="road load")
    b: float = param("1", "coefficient of the speed", 0.0, ge=-1, le=1, tag="road load")
    c: float = param("1", "coefficient of its square", 0.0, ge=-0.1, le=0.1, tag="road load")
    r_drum: float = param("m", "radius of the drum of the test", ge=0.1, le=1e6)


@dataclass(frozen=True)
class J2452Wheel(Wheel):
    """Wheels whose rolling resistance is that of SAE J2452, by pressure, load of each tyre and speed.

    ::

        F = p^alpha [2 (W_front / 2)^beta + 2 (W_rear / 2)^beta] (a + b v + c v^2) sqrt(r_drum / (r_drum + r))

    with the loads at rest; the root takes the bend of the drum back, on which a tyre is pressed in further than on a road.
    """

    kind = "wheel-j2452"
    p: J2452WheelParameters
    parameters = J2452WheelParameters

    def rolling(self, W: Expr, front_share: Expr) -> tuple[Expr, Expr, Expr]:
        """Return the rolling resistance by speed [N]."""
        p = self.p
        loads = 2 * (front_share * W / 2) ** p.beta + 2 * ((1 - front_share) * W / 2) ** p.beta
        F = (p.pressure / 1000) ** p.alpha * loads * ca.sqrt(p.r_drum / (p.r_drum + p.r))
        return F * p.a, F * p.b * 3.6, F * p.c * 3.6**2
