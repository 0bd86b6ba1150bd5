"""What one part may ask another for beyond signals: laws, through a small interface that the other's class implements.

A component reads it with `halfshaft.library.base.component.From`; an argument of that name is then the other part.
"""

from __future__ import annotations

from halfshaft.library.base.ports import Expr


class Machine:
    """What turns a gearbox: an engine or a motor."""

    def tau_envelope(self, omega: Expr) -> Expr:
        """Return the largest torque that it gives for long at a speed [N.m]."""
        raise NotImplementedError

    @property
    def omega_max(self) -> Expr:
        """Highest speed [rad/s]."""
        raise NotImplementedError

    @property
    def tau_largest(self) -> Expr:
        """Largest torque of the envelope [N.m]."""
        raise NotImplementedError

    @property
    def P_largest(self) -> Expr:
        """Largest power of the envelope's points [W]."""
        raise NotImplementedError


class Rolling:
    """What rolls under a body."""

    def rolling(self, W: Expr, front_share: Expr) -> tuple[Expr, Expr, Expr]:
        """Return the rolling resistance [N] of a vehicle of this weight [N], of which the front axle carries a share.

        It is given as the coefficients of a polynomial in speed: N, N.s/m, N.s^2/m^2.
        """
        raise NotImplementedError

    def bearing(self, m: Expr) -> Expr:
        """Return what bearings and released brakes of a vehicle of this mass [kg] take at the road [N]."""
        raise NotImplementedError
