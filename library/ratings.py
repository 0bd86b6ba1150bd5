"""What a part is rated at: the energy of a battery pack, the peak power of a motor."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from halfshaft.library.electric.battery import BatteryParameters
from halfshaft.library.electric.motor import MotorParameters


# A sweep asks for the same part again and again.
@lru_cache(maxsize=64)
def pack_energy(p: BatteryParameters) -> float:
    """Return what a full pack stores at its start temperature, by its open-circuit voltage down to empty [J]."""
    T, soc = p.u_oc.points
    points = np.union1d(soc, (0.0, 1.0))
    points = points[(points >= 0) & (points <= 1)]
    u_oc = np.interp(points, soc, [np.interp(p.T_start, T, u) for u in p.u_oc.values.T])
    Q = np.interp(p.T_start, p.Q.points[0], p.Q.values)
    return float(p.n_modules * p.capacity_scale * Q * np.trapezoid(u_oc, points))


@lru_cache(maxsize=64)
def peak_power(p: MotorParameters) -> float:
    """Return the largest power at the shaft, overtorque included [W]."""
    omega, tau = p.tau_max.points[0], p.tau_max.values
    if omega[0] > 0 or omega[-1] < p.omega_max:
        # The outermost pieces of the envelope are extended.
        ends = np.array([0.0, p.omega_max])
        omega, tau = np.append(omega, ends), np.append(tau, [p.tau_max(float(x)) for x in ends])
        order = np.argsort(omega, kind="stable")
        omega, tau = omega[order], tau[order]
    inside = (omega >= 0) & (omega <= p.omega_max)
    best = (tau * omega)[inside].max(initial=0.0)
    # Between two points the torque is a line, so the power is a parabola.
    slope = np.divide(np.diff(tau), np.diff(omega), out=np.zeros(len(omega) - 1), where=np.diff(omega) > 0)
    falls = slope < 0
    top = 0.5 * (omega[:-1][falls] - tau[:-1][falls] / slope[falls])
    between = (top > omega[:-1][falls]) & (top < np.minimum(omega[1:][falls], p.omega_max))
    best = max(best, (-slope[falls] * top**2)[between].max(initial=0.0))
    return float(best * p.overtorque * p.torque_scale * p.speed_scale)
