"""Fuels and electricity made comparable."""

from __future__ import annotations

#: Lower heating value [J/kg] and density [kg/m^3] of the gasoline that others are compared with.
GASOLINE = (42.6e6, 749.0)
#: The same for diesel.
DIESEL = (43.0e6, 850.0)


def gasoline_L(energy: float) -> float:
    """Return the gasoline of an energy of fuel or electricity [L]."""
    heating, density = GASOLINE
    return 1e3 * energy / (heating * density)
