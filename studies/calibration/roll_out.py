"""How a car rolls out: speed over time and its derivatives, in closed form.

On a straight road of constant grade a car in neutral is slowed by::

    m_e dv/dt = -(a + b v + c v^2)                                           (1)

a Riccati equation.  With ``v = x / y`` it is linear, and its matrix has no trace, so that for whatever sign of ``b^2 - 4 a c``::

    z = (b^2 / 4 - a c) (t / m_e)^2,   C = cosh sqrt z,   S = sinh sqrt z / sqrt z
    v = [C v_0 - S (t / m_e) (a + b v_0 / 2)] / [C + S (t / m_e) (c v_0 + b / 2)]          (2)

``C`` and ``S`` are entire functions of ``z``, with ``dC/dz = S / 2`` and ``dS/dz = (C - S) / (2 z)``; below zero they are cosine and sine.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from halfshaft.studies.calibration.least_squares import Array

#: Below this the slope of ``S`` is summed as a series.
_SMALL = 1e-2
#: Coefficients of that series: ``dS/dz = sum_n (n + 1) z^n / (2 n + 3)!``.
_SERIES = (1 / 6, 2 / 120, 3 / 5040, 4 / 362880, 5 / 39916800)


def rolled(t: Array, v_0: float, load: Sequence[float], m: float) -> tuple[Array, Array]:
    """Return speeds [m/s] and their derivatives by ``a, b, c`` and ``v_0``, shapes ``(n,)`` and ``(n, 4)``.

    Parameters
    ----------
    t
        Times since the start [s].
    v_0
        Speed there [m/s].
    load
        The coefficients of equation (1) [N, N.s/m, N.s^2/m^2].
    m
        Mass with that of what rotates [kg].

    """
    a, b, c = load
    s = t / m
    z = (b**2 / 4 - a * c) * s**2
    root = np.sqrt(np.abs(z))
    C = np.where(z > 0, np.cosh(root), np.cos(root))
    S = np.where(z > 0, np.sinh(root), np.sin(root)) / np.where(root > 0, root, 1.0)
    S = np.where(root > 0, S, 1.0)
    small = np.abs(z) < _SMALL
    slope = np.where(small, np.polyval(_SERIES[::-1], z), (C - S) / (2 * np.where(small, 1.0, z)))
    up, down = C * v_0 - S * s * (a + b * v_0 / 2), C + S * s * (c * v_0 + b / 2)
    v = up / down
    # By z, which a, b and c move; then by themselves.
    by_z = ((S / 2 * v_0 - slope * s * (a + b * v_0 / 2)) - v * (S / 2 + slope * s * (c * v_0 + b / 2))) / down
    by_a = by_z * (-c * s**2) - S * s / down
    by_b = by_z * (b / 2 * s**2) - S * s * (v_0 + v) / (2 * down)
    by_c = by_z * (-a * s**2) - v * S * s * v_0 / down
    by_v_0 = (C - S * s * b / 2 - v * S * s * c) / down
    return v, np.column_stack([by_a, by_b, by_c, by_v_0])
