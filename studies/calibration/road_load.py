"""Road load: what air, tyres and bearings take at a steady speed, and the numbers of a body and its wheels that take the same.

::

    F(v) = A + B v + C v^2                                                   (1)

It comes from a coast-down (`halfshaft.studies.calibration.coast_down`), or as the target coefficients of a chassis dynamometer that
authorities publish, in lbf and mph with the equivalent test weight in lb.  Set coefficients of a dynamometer are no road load: they
are what it adds to the losses of the car on its rollers.

A vehicle takes it *exactly* as a body by these coefficients, or *by shape*: the numbers of its own body and wheels that are
tagged ``road load`` (drag coefficient, rolling resistance) are fitted to (1) at the mass of the test over a range of speeds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from halfshaft.cosim.units import KG_PER_POUND, N_PER_POUND
from halfshaft.library.base.errors import InputError, nearest, not_a, number
from halfshaft.library.base.interfaces import Rolling
from halfshaft.library.base.tags import part_of
from halfshaft.library.chassis.body import Body
from halfshaft.library.chassis.coast_down import CoastDownBody, CoastDownBodyParameters
from halfshaft.library.files.component_file import component_names
from halfshaft.library.files.notebook import Grid, card
from halfshaft.models.vehicle import OWN, Vehicle
from halfshaft.studies.calibration.least_squares import Array, Fit, Measured, Model, Unknown, fit, quantile
from halfshaft.studies.conditions import MPH

if TYPE_CHECKING:
    from halfshaft.cosim.plot import Picture

#: The coefficients and their units; in the parameters of a body by coast-down they are `F_0`, `F_1` and `F_2`.
COEFFICIENTS = {"A": "N", "B": "N.s/m", "C": "N.s^2/m^2"}
#: The same in lbf and mph.
POUNDS = {"A": N_PER_POUND, "B": N_PER_POUND / MPH, "C": N_PER_POUND / MPH**2}
#: Speeds between which a road load counts where nothing is said [m/s], and at how many of them shapes are compared.
RANGE, POINTS = (15 / 3.6, 115 / 3.6), 101


@dataclass(frozen=True, kw_only=True, eq=False)
class RoadLoad:
    """Coefficients of a road load.

    Parameters
    ----------
    A, B, C
        Equation (1) [N, N.s/m, N.s^2/m^2].
    m
        Mass of the vehicle at the test [kg].
    source
        Where they are from.
    v
        Lowest and highest speed of the test [m/s].
    covariance
        Of the three, shape ``(3, 3)``; None where it is not known.
    dof
        Degrees of freedom of the covariance.

    Raises
    ------
    InputError
        If a number is not what it must be.

    """

    A: float
    B: float
    C: float
    m: float
    source: str = ""
    v: tuple[float, float] = RANGE
    covariance: Array | None = None
    dof: float = np.inf

    def __post_init__(self) -> None:
        """Check the numbers."""
        problems = [
            f"{name} = {x!r}, must be a finite number"
            for name, x in zip("ABC", self.coefficients, strict=True)
            if not np.isfinite(number(x))
        ]
        if not 10 <= number(self.m) <= 1e6:
            problems.append(f"m = {number(self.m):g} kg, must be >= 10 kg and <= 1e+06 kg")
        if not (len(self.v) == 2 and 0 <= number(self.v[0]) < number(self.v[1]) < np.inf):
            problems.append(f"v = {self.v}, must be two rising speeds in m/s")
        if not problems and min(self.force(np.linspace(*self.v, POINTS))) <= 0:
            problems.append(f"the load is not above 0 N at all speeds between {self.v[0]:.4g} and {self.v[1]:.4g} m/s")
        if problems:
            raise InputError("road load", problems)

    def __repr__(self) -> str:
        return f"<RoadLoad {self.A:.4g} N, {self.B:.4g} N.s/m, {self.C:.4g} N.s^2/m^2 at {self.m:g} kg>"

    def _repr_html_(self) -> str:
        return card(
            "road load",
            f"at {self.m:g} kg",
            {"source": self.source},
            Grid(("", "value", "95 % interval", "unit", "in lbf and mph"), self.rows()),
        )

    @classmethod
    def of_pounds(cls, A: float, B: float, C: float, weight: float, source: str = "target coefficients") -> RoadLoad:
        """Return a road load of target coefficients in lbf, lbf/mph and lbf/mph^2 and an equivalent test weight in lb."""
        A, B, C = (number(x) * POUNDS[name] for name, x in (("A", A), ("B", B), ("C", C)))
        return cls(A=A, B=B, C=C, m=number(weight) * KG_PER_POUND, source=source)

    @property
    def coefficients(self) -> tuple[float, float, float]:
        """A, B and C."""
        return self.A, self.B, self.C

    @property
    def pounds(self) -> tuple[float, float, float]:
        """A, B and C in lbf, lbf/mph and lbf/mph^2."""
        A, B, C = (x / POUNDS[name] for name, x in zip("ABC", self.coefficients, strict=True))
        return A, B, C

    def force(self, v: Any) -> Any:
        """Return the force [N] at speeds [m/s]."""
        return self.A + self.B * v + self.C * v**2

    @property
    def std(self) -> Array | None:
        """Standard uncertainties of the three."""
        return None if self.covariance is None else np.sqrt(np.diag(self.covariance))

    def half_width(self, v: Array) -> Array:
        """Return half the width of the 95 % interval of the force at speeds [N]."""
        powers = np.column_stack([np.ones_like(v), v, v**2])
        inner = np.zeros((3, 3)) if self.covariance is None else self.covariance
        return np.asarray(quantile(self.dof) * np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", powers, inner, powers), 0)))

    def rows(self) -> list[tuple[str, str, str, str, str]]:
        """Return the coefficients as texts: name, value, half the width of the interval, unit, and value in lbf and mph."""
        std = self.std
        told = ["" if std is None else f"\u00b1 {quantile(self.dof) * s:.2g}" for s in (std if std is not None else np.zeros(3))]
        found = zip(COEFFICIENTS.items(), self.coefficients, told, self.pounds, strict=True)
        return [(name, f"{x:.5g}", half, unit, f"{lbf:.5g}") for (name, unit), x, half, lbf in found]

    def exactly(self, vehicle: Vehicle) -> Vehicle:
        """Return the vehicle with a body that has these coefficients; its mass and what follows from it stay.

        Raises
        ------
        InputError
            If its powertrain takes no such body, or a coefficient is not what a body may have.

        """
        if problems := not_a(Vehicle, vehicle=vehicle):
            raise InputError("road load", problems)
        role = part_of(vehicle.tags.the("vehicle mass"))
        changed = vehicle
        if not issubclass(vehicle.parts[role].component, CoastDownBody):
            changed = vehicle.with_parts({role: component_names(CoastDownBody.kind)[0]})
            # What the mass follows from, and all that both bodies have, is as it was.
            rules = {target: rule for target, rule in vehicle.rules.items() if part_of(target) == role}
            changed = replace(changed, rules={**changed.rules, **rules})
            same = {f"{role}.{f.name}" for f in fields(CoastDownBodyParameters)} & vehicle.values.keys() - (
                rules.keys() - vehicle.given.keys()
            )
            changed = changed.with_values({name: vehicle.values[name] for name in same if vehicle.values[name] != changed.values[name]})
        given = dict(zip(("F_0", "F_1", "F_2", "m_test"), (*self.coefficients, self.m), strict=True))
        changed = changed.with_values({f"{role}.{name}": x for name, x in given.items()})
        return replace(changed, source=self._source(vehicle))

    def by_shape(self, vehicle: Vehicle, names: Sequence[str] = (), v: tuple[float, float] | None = None) -> Shaped:
        """Return the vehicle with the drag of its own body and the rolling resistance of its own wheels fitted to the load.

        Parameters
        ----------
        vehicle
            What is fitted.
        names
            The numbers of its body and wheels that may change; all that are tagged ``road load``, unless given.
        v
            Speeds between which the forces are compared [m/s]; those of the test unless given.

        Raises
        ------
        InputError
            If it has no such numbers, or the speeds are not what they must be.

        """
        if problems := not_a(Vehicle, vehicle=vehicle):
            raise InputError("road load", problems)
        known = {name: vehicle.specs[name] for name in vehicle.tags.all_of("road load")}
        names = tuple(names) or tuple(known)
        problems = [
            f"{name} is not known{nearest(name, known) or ', must be one of ' + ', '.join(known)}" for name in names if name not in known
        ]
        role = part_of(vehicle.tags.the("vehicle mass"))
        if issubclass(vehicle.parts[role].component, CoastDownBody):
            problems.append(f"the body of vehicle '{vehicle.name}' has the coefficients themselves: set them exactly")
        low, high = v or self.v
        if not 0 <= number(low) < number(high) < np.inf:
            problems.append(f"v = {v}, must be two rising speeds in m/s")
        if problems:
            raise InputError("road load", problems)
        speeds = np.linspace(low, high, POINTS)
        model = _model(vehicle.with_values({vehicle.tags.the("vehicle mass"): self.m}), names, speeds)
        bounds = [(known[n].lowest, known[n].highest) for n in names]
        unknowns = [
            Unknown(
                n, known[n].unit, vehicle.values[n], -np.inf if a is None else a, np.inf if b is None else b, abs(vehicle.values[n]) or 1e-3
            )
            for n, (a, b) in zip(names, bounds, strict=True)
        ]
        found = fit(unknowns, model, [Measured("force", self.force(speeds))])
        changed = vehicle.with_values(dict(zip(names, found.x.tolist(), strict=True)))
        return Shaped(replace(changed, source=self._source(vehicle)), self, speeds, found)

    def _source(self, vehicle: Vehicle) -> str:
        base = vehicle.source if vehicle.source.startswith(OWN) else f"{OWN} {vehicle.name} ({vehicle.source})"
        return f"{base}; road load: {self.source or 'own figures'}"

    def plot(self, path: str | Path | None = None) -> Picture:
        """Draw the load over speed, with its interval; `path` is a PNG, SVG or PDF file to write."""
        from halfshaft.studies.calibration.pictures import plot_load  # matplotlib takes a quarter of a second

        return plot_load(self, path=path)


@dataclass(frozen=True, eq=False)
class Shaped:
    """A vehicle whose body and wheels were fitted to a road load.

    Parameters
    ----------
    vehicle
        With the numbers found.
    load
        What was to be met.
    v
        Speeds at which forces were compared [m/s].
    fit
        What least squares found.

    """

    vehicle: Vehicle
    load: RoadLoad
    v: Array
    fit: Fit

    @property
    def misfit(self) -> Array:
        """Force of the vehicle at the mass of the test less the load, at each speed [N]."""
        return self.fit.after - self.fit.measured

    @property
    def rms(self) -> float:
        """Root of the mean square of the misfit [N]."""
        return float(np.sqrt(np.mean(self.misfit**2)))

    @property
    def worst(self) -> tuple[float, float]:
        """The largest misfit [N], and the speed that it is at [m/s]."""
        i = int(np.argmax(np.abs(self.misfit)))
        return float(self.misfit[i]), float(self.v[i])

    @property
    def values(self) -> dict[str, float]:
        """The numbers found, by name."""
        return {u.name: float(x) for u, x in zip(self.fit.unknowns, self.fit.x, strict=True)}

    def __repr__(self) -> str:
        return f"<Shaped {self.vehicle.name}: {', '.join(f'{n} = {x:.4g}' for n, x in self.values.items())}, misfit {self.rms:.3g} N>"


def load_of(vehicle: Vehicle, speeds: Array) -> Array:
    """Return the force that a vehicle needs at steady speeds on a flat road, without its driveline [N]."""
    return _model(vehicle, (), speeds)(np.empty(0))[0]


def _model(vehicle: Vehicle, names: Sequence[str], speeds: Array) -> Model:
    """Return how the force at speeds, and its derivatives, follow from numbers of body and wheels."""
    symbols = {name: ca.SX.sym(name) for name in names}
    parts = {}
    for role, component in vehicle.components().items():
        if isinstance(component, Body | Rolling):
            own: dict[str, Any] = {name.partition(".")[2]: symbol for name, symbol in symbols.items() if part_of(name) == role}
            parts[role] = replace(component, p=replace(component.p, **own))
    body = next(part for part in parts.values() if isinstance(part, Body))
    wheel = next(part for part in parts.values() if isinstance(part, Rolling))
    v = ca.SX.sym("v")
    force = ca.SX(body.resistance(0.0, wheel).at(v, 1.0) + wheel.bearing(body.p.m))
    x = ca.vertcat(*symbols.values())
    at = ca.Function("force", [v, x], [force, ca.jacobian(force, x)]).map(len(speeds))

    def model(values: Array) -> tuple[Array, Array]:
        force, slopes = at(speeds[None, :], np.repeat(np.asarray(values, dtype=float)[:, None], len(speeds), axis=1))
        return np.array(force).ravel(), np.array(slopes).reshape(len(values), len(speeds), order="F").T

    return model
