"""Gearbox of one or several ratios; its loss by a polynomial or by an efficiency map.

With the ratio ``G`` of the gear::

    omega_in = G omega_out
    tau_in   = tau_out / G + tau_loss(tau_out, omega_out, G) + J alpha_in    (1)

On the way back the loss is the same share of the input torque, without inertia, as in *required* (the paper's second
assumption), also where the torque comes back reversed: a gearbox never gives power.  Where more comes than was sent for, or the
ratio of output to input torque is zero or negative, which a small negative output torque gives, the same loss is taken instead: a
loss beside next to no torque says nothing of more.

Two losses::

    P_loss = (c1 G + c2) omega + (c3 / G + c4) |tau| + c5 |tau| omega + c6   (2)
    tau_loss = max(0, P_loss / (omega G))

is the regression that NREL used until 2001, after measurements of a Volkswagen gearbox by van Dongen (SAE 820741);
the other looks up the efficiency ``e(omega, tau, gear)`` of the output point::

    tau_loss = (1 - e) |tau| / (G e)  driving,   (1 - e) |tau| / G  braking  (3)

The maps come from (2), clipped to efficiencies between 0 and 1.  Near standstill the polynomial is negative, and what is left
of it are zeros beside ones; so a map is read at ``omega_lookup`` at least, and as ``e_lowest`` at least.  Both at 0 read it
as the original does; where the efficiency is zero, that one loses ``G |tau|`` at the input.

While shifting, the gearbox asks for no torque.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca

from halfshaft.library.base.component import From, Signal, State, face
from halfshaft.library.base.expressions import Direction, Turning, clip, where
from halfshaft.library.base.links import Link, TwoSided, inertia, limit
from halfshaft.library.base.parameters import Parameters, param, params, table
from halfshaft.library.base.ports import Expr, Port, Shaft
from halfshaft.library.base.tables import Axis, Table

#: Output speed [rad/s] below which the power of equation (2) fades to nothing, so that the torque stays finite.
OMEGA_FLOOR = 0.2


@dataclass(frozen=True, kw_only=True)
class GearboxParameters(Parameters):
    """Ratios and inertia, common to all gearboxes."""

    ratios: tuple[float, ...] = params("1", "ratio of input speed to output speed, gear by gear", ge=0.01, le=100, tag="gear ratios")
    J: float = param("kg.m^2", "inertia at the input", 0.0, ge=0, le=100)
    speed_scale: float = param("1", "factor on the speeds of the loss", 1.0, ge=0.01, le=100)
    torque_scale: float = param("1", "factor on the torques of the loss", 1.0, ge=0.01, le=100)


@dataclass(frozen=True, kw_only=True)
class PolynomialGearboxParameters(GearboxParameters):
    """Coefficients of equation (2)."""

    c1: float = param("N.m", "loss that grows with ratio and speed", 0.614307976, ge=-1e3, le=1e3)
    c2: float = param("N.m", "loss that grows with speed", 5.530953616, ge=-1e3, le=1e3)
    c3: float = param("rad/s", "loss that grows with torque over ratio", -0.861652506, ge=-100, le=100)
    c4: float = param("rad/s", "loss that grows with torque", 0.229546756, ge=-100, le=100)
    c5: float = param("1", "loss that grows with power", 0.023981187, ge=-1, le=1)
    c6: float = param("W", "constant loss", -92.07523029, ge=-1e5, le=1e5)


@dataclass(frozen=True, kw_only=True)
class MapGearboxParameters(GearboxParameters):
    """Efficiency of the output point."""

    efficiency: Table = table("1", "efficiency", Axis("omega", "rad/s"), Axis("tau", "N.m"), Axis("gear", "1"), clip=True, ge=0, le=1)
    efficiency_scale: float = param("1", "factor on the efficiency, which stays below 1", 1.0, ge=0.01, le=100)
    omega_lookup: float = param("rad/s", "output speed below which the map is read at this speed; the original's is 0", 5.0, ge=0, le=1e4)
    e_lowest: float = param("1", "lowest efficiency; the original's is 0", 0.05, ge=0, lt=1)


def same_efficiency(asked: Shaft, sent: Shaft, offered: Shaft, G: Expr) -> Shaft:
    """Return what is delivered when the share of the input torque that *required* lost is lost, whichever way it goes, and no more."""
    useful = asked.tau * sent.tau > 0
    share = ca.fmin(where(useful, ca.fabs(offered.tau) / where(useful, ca.fabs(sent.tau), 1), 1), 1)
    return Shaft(G * offered.tau - share * (G * sent.tau - asked.tau), offered.omega / G, offered.alpha / G)


@dataclass(frozen=True)
class _Gearbox(TwoSided):
    """What both gearboxes share; the law of the loss is theirs."""

    output = Port(Shaft, "wheel")
    input = Port(Shaft, "source")
    states = (State("torque_ratio", "1", "output over input torque of the previous step, both at the input's speed", signal=True),)
    signals = (
        Signal("ratios", "1", "ratio of input speed to output speed, gear by gear"),
        Signal("tau_gearbox", "N.m", "required output torque"),
        Signal("omega_gearbox", "rad/s", "required output speed"),
        Signal("omega_gearbox_input", "rad/s", "offered input speed"),
    )
    reads: ClassVar[tuple[From, ...]] = (From("shift", ratio="1", gear="1"), From("shift", optional=True, shifting="1"))

    @face("ratios")
    def law(self) -> Mapping[str, Any]:
        """Publish the ratios, which the shift logic chooses from."""
        return {"ratios": self.p.ratios}

    @face("tau_gearbox", "omega_gearbox")
    def request(self, output: Shaft) -> Mapping[str, Any]:
        """Publish the required output point, which the shift logic looks at."""
        return {"tau_gearbox": output.tau, "omega_gearbox": output.omega}

    @face("omega_gearbox_input")
    def offer(self, input: Shaft) -> Mapping[str, Any]:
        """Publish the offered input speed, from which the shift logic estimates the next one."""
        return {"omega_gearbox_input": input.omega}

    def tau_loss(self, output: Shaft, G: Expr, gear: Expr, direction: Direction) -> Expr:
        """Return the loss torque at the input [N.m], not yet cut at standstill."""
        raise NotImplementedError

    def chain(self, ratio: Expr, gear: Expr, turning: Turning, direction: Direction, shifting: Expr = 0.0) -> tuple[Link, ...]:  # type: ignore[override]
        """Return equation (1)."""

        def law(load: Shaft) -> Shaft:
            loss = self.tau_loss(load, ratio, gear, direction)
            tau = load.tau / ratio + turning(load.omega) * loss
            return Shaft(tau, load.omega * ratio, load.alpha * ratio)

        return (
            Link(law, lambda asked, sent, offered: same_efficiency(asked, sent, offered, ratio), name="mesh"),
            inertia(self.p.J),
            limit(lambda shaft: shaft._replace(tau=where(shifting, 0, shaft.tau))),
        )

    def found(self, way: Mapping[str, tuple[Shaft, Shaft]]) -> Mapping[str, Any]:
        """Return the ratio of torques for the shift logic's estimate."""
        asked, sent = way["mesh"]
        tau = asked.tau * asked.omega / where(sent.omega > 0, sent.omega, 1)
        return {"next_torque_ratio": where(tau * sent.tau > 0, tau / where(tau * sent.tau > 0, sent.tau, 1), 0)}


@dataclass(frozen=True)
class PolynomialGearbox(_Gearbox):
    """Gearbox with the loss of equation (2)."""

    kind = "gearbox-polynomial"
    family = "gearbox"
    p: PolynomialGearboxParameters
    parameters = PolynomialGearboxParameters

    def tau_loss(self, output: Shaft, G: Expr, gear: Expr, direction: Direction) -> Expr:
        """Return equation (2) as a torque at the input [N.m]."""
        p = self.p
        omega, tau = output.omega / p.speed_scale, direction.size(output.tau) / p.torque_scale
        P = (p.c1 * G + p.c2) * omega + (p.c3 / G + p.c4) * tau + p.c5 * tau * omega + p.c6
        return ca.fmax(0, P / (ca.fmax(omega, OMEGA_FLOOR) * G)) * p.torque_scale


@dataclass(frozen=True)
class MapGearbox(_Gearbox):
    """Gearbox with the loss of equation (3)."""

    kind = "gearbox-map"
    family = "gearbox"
    p: MapGearboxParameters
    parameters = MapGearboxParameters

    def tau_loss(self, output: Shaft, G: Expr, gear: Expr, direction: Direction) -> Expr:
        """Return equation (3) [N.m]."""
        p = self.p
        omega = ca.fmax(output.omega, p.omega_lookup)

        def efficiency(tau: Expr) -> Expr:
            e = clip(p.efficiency_scale * p.efficiency(omega / p.speed_scale, tau / p.torque_scale, gear), p.e_lowest, 1)
            # Zero, of which only a lowest efficiency of zero lets any through, stands for a driving loss of G tau.
            return where(e > 0, e, where(tau >= 0, 1 / (1 + G**2), 0))

        return direction.loss(output.tau, efficiency) / G
