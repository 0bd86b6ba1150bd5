"""Vehicle body by the coefficients of a coast-down test.

A car that rolls out on a flat road is slowed by::

    F(v) = F_0 + F_1 v + F_2 v^2                                             (1)

which has in it all that a car has between road and gearbox: air, tyres, bearings and brakes that drag.  Of these the wheels of
a model bring their own, so the body takes (1) less what the wheels bring at the mass of the test::

    F_res(v) = F(v) - [F_roll(v) + tau_bearing / r] at m_test + F_roll(v) at m and theta + m g sin(theta)          (2)

On a flat road at the mass of the test a car then needs (1), whatever its wheels are; with another mass and on slopes their
rolling resistance follows the load.  What grows with the square of speed in (1) is booked as air drag, the rest as rolling.
"""

from __future__ import annotations

from dataclasses import dataclass

from halfshaft.library.base.interfaces import Rolling
from halfshaft.library.base.parameters import param
from halfshaft.library.base.ports import Expr
from halfshaft.library.chassis.body import Body, MassParameters, Resistance


@dataclass(frozen=True, kw_only=True)
class CoastDownBodyParameters(MassParameters):
    """Mass, geometry and road load of the vehicle."""

    F_0: float = param("N", "road load, constant part (A)", ge=0, le=1e5)
    F_1: float = param("N.s/m", "road load, part that grows with speed (B)", 0.0, ge=-1e3, le=1e4)
    F_2: float = param("N.s^2/m^2", "road load, part that grows with its square (C)", ge=0, le=1e3)
    m_test: float = param("kg", "mass at which the road load was measured", ge=10, le=1e6)


@dataclass(frozen=True)
class CoastDownBody(Body):
    """The vehicle by its measured road load."""

    kind = "coast-down-body"
    p: CoastDownBodyParameters
    parameters = CoastDownBodyParameters

    def resistance(self, grade: Expr, wheel: Rolling) -> Resistance:
        """Return equation (2)."""
        p, W = self.p, self.weight(grade)
        here, there = wheel.rolling(W, p.front_share), wheel.rolling(p.m_test * p.g, p.front_share)
        roll_0, roll_1, roll_2 = (now - then for now, then in zip(here, there, strict=True))
        return Resistance(p.F_0 - wheel.bearing(p.m_test) + roll_0, p.F_1 + roll_1, roll_2, W * grade, p.F_2)
