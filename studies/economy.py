"""What a vehicle consumes over a distance, fuels and electricity made comparable.

Gasoline is that of ADVISOR, 42600 J/g and 749 g/L; electricity counts 33.705 kWh a gallon (EPA).
"""

from __future__ import annotations

from dataclasses import dataclass

from halfshaft.cosim.units import L_PER_GALLON, M_PER_MILE, WH_PER_GALLON, mpg

#: Lower heating value [J/kg] and density [kg/m^3] of the gasoline that others are compared with.
GASOLINE = (42.6e6, 749.0)


def gasoline_L(energy: float) -> float:
    """Return the gasoline of an energy of fuel [L]."""
    heating, density = GASOLINE
    return 1e3 * energy / (heating * density)


@dataclass(frozen=True)
class Consumption:
    """What is consumed: fuel [L], its energy [J], and energy of the battery or of the grid [J]; None of what the vehicle does not have.

    Over a distance it is per metre.
    """

    fuel: float | None
    fuel_energy: float | None
    electric: float | None

    def __add__(self, other: Consumption) -> Consumption:
        """Return the sum."""
        return Consumption(*(None if a is None or b is None else a + b for a, b in zip(self._row, other._row, strict=True)))

    def __mul__(self, factor: float) -> Consumption:
        """Return a multiple."""
        return Consumption(*(None if a is None else factor * a for a in self._row))

    @property
    def _row(self) -> tuple[float | None, float | None, float | None]:
        return self.fuel, self.fuel_energy, self.electric

    def figures(self) -> dict[str, float | None]:
        """Return the figures of a consumption per metre."""
        fuel = None if self.fuel is None else 1e5 * self.fuel
        gasoline = None if self.fuel_energy is None else 1e5 * gasoline_L(self.fuel_energy)
        kWh = None if self.electric is None else 1e5 * self.electric / 3.6e6
        # Gallons of gasoline, or as much electricity, per 100 km.
        gallons = (gasoline or 0.0) / L_PER_GALLON + 1e3 * (kWh or 0.0) / WH_PER_GALLON
        return {
            "fuel_economy_L_per_100km": fuel,
            "fuel_economy_mpg": mpg(fuel) if fuel else None,
            "gasoline_equivalent_L_per_100km": gasoline,
            "gasoline_equivalent_mpg": mpg(gasoline) if gasoline else None,
            "energy_kWh_per_100km": kWh,
            "energy_MPGe": 1e5 / M_PER_MILE / gallons if gallons > 0 else None,
        }
