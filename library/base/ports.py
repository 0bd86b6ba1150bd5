"""What crosses a connection, and which way is positive.

Power that flows from the source to the wheel is positive, everywhere: a positive torque drives, a negative one brakes;
a positive battery power discharges.  Two streams use every connection.  The *required* one runs from the wheel to the
source (what must come?), the *available* one from the source to the wheel (what does come?).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

from halfshaft.library.base.tags import Tag

if TYPE_CHECKING:
    from halfshaft.library.base.component import Component

#: An expression: `casadi.SX` in an assembled model, a number in a test.
Expr: TypeAlias = Any
Side: TypeAlias = Literal["wheel", "source"]


class Tyre(NamedTuple):
    """Contact between tyre and road: mean force [N], mean speed [m/s], acceleration [m/s^2]."""

    F: Expr
    v: Expr
    a: Expr

    @property
    def P(self) -> Expr:
        """Power [W]."""
        return self.F * self.v


class Shaft(NamedTuple):
    """Rotating connection: torque [N.m], speed [rad/s], acceleration [rad/s^2].

    ``alpha`` is a difference quotient in the step and a derivative in the forward-facing model.
    """

    tau: Expr
    omega: Expr
    alpha: Expr

    @property
    def P(self) -> Expr:
        """Power [W]."""
        return self.tau * self.omega


class Electric(NamedTuple):
    """Electric connection: power [W]."""

    P: Expr


Kind: TypeAlias = type[Tyre] | type[Shaft] | type[Electric]

UNITS = {"F": "N", "v": "m/s", "a": "m/s^2", "tau": "N.m", "omega": "rad/s", "alpha": "rad/s^2", "P": "W"}
MEANINGS = {"F": "force", "v": "speed", "tau": "torque", "omega": "speed", "P": "power"}
SHOWN: dict[Kind, tuple[str, ...]] = {Tyre: ("F", "v"), Shaft: ("tau", "omega"), Electric: ("P",)}


@dataclass(frozen=True)
class PortOf:
    """A port of one component, as used in `Model.connect`."""

    component: Component
    port: Port


class Port:
    """Declaration of a port in the body of a component class.

    An ``optional`` port may be left open.  At one that ``offers``, the source decides by itself what flows, and is not asked.
    ``tags`` says of fields what they are.
    """

    name: str

    def __init__(
        self,
        kind: Kind,
        side: Side,
        *,
        optional: bool = False,
        offers: bool = False,
        tags: Mapping[str, Tag] = MappingProxyType({}),
    ) -> None:
        self.kind, self.side, self.optional, self.offers, self.tags = kind, side, optional, offers, tags

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    def __get__(self, instance: Component | None, owner: type) -> Any:
        """Return the declaration on the class, a `PortOf` on an instance."""
        return self if instance is None else PortOf(instance, self)
