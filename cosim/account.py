"""The energy account of a run: in, out and loss of every part, what is stored, and the method's own error.

All energies are integrals of powers that the run computed, with the same step values.  Over the whole vehicle::

    fuel + battery = losses + kinetic + potential + speed mismatch + inertia discretisation + speed limit and standstill

The account closes by construction, so it proves that nothing is forgotten, not that a law is right; that is for the audit
(`halfshaft.cosim.audit`).  The last three are lines of the discrete method.  *Speed mismatch*: after a limit
acted, powers upstream are taken at the required speed, the achieved one is lower.  *Inertia discretisation*: work on
rotors by difference quotients less their change of kinetic energy.  *Speed limit and standstill*: driving power that is
not used because a part turns no faster, or because the vehicle stands.  A forward-facing run closes without them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from halfshaft.library.base.tags import part_of
from halfshaft.models.assembly import Description


@dataclass(frozen=True)
class Part:
    """One row of the account [J]: what came from the source, what went toward the wheel, what was lost; `burns` where fuel comes in."""

    name: str
    received: float
    delivered: float
    lost: float
    burns: bool = False


@dataclass(frozen=True)
class Account:
    """Energies of a run [J]; `battery` is what the store gave, negative if it was charged."""

    fuel: float
    battery: float
    parts: tuple[Part, ...]
    losses: Mapping[str, float]
    kinetic: float
    potential: float
    speed_mismatch: float
    inertia_discretisation: float
    speed_limit: float

    def __repr__(self) -> str:
        fuel, battery, lost = (x / 3600 for x in (self.fuel, self.battery, sum(self.losses.values())))
        return f"<Account in Wh: fuel {fuel:.1f}, battery {battery:.1f}, lost {lost:.1f}, balance {self.residual / 3600:.0e}>"

    def _repr_html_(self) -> str:
        from halfshaft.cosim.facts import energy_table

        return energy_table(self)

    @property
    def residual(self) -> float:
        """What is in but not out [J]."""
        lines = self.speed_mismatch + self.inertia_discretisation + self.speed_limit
        return self.fuel + self.battery - sum(self.losses.values()) - self.kinetic - self.potential - lines

    @property
    def turnover(self) -> float:
        """Energy that the residual is held against: the larger of what came in and what was lost; 1 J at least."""
        return max(abs(self.fuel) + abs(self.battery), sum(abs(x) for x in self.losses.values()), 1.0)

    @property
    def balance_relative(self) -> float:
        """Residual over turnover."""
        return self.residual / self.turnover

    @property
    def mismatch_relative(self) -> float:
        """Speed mismatch over turnover."""
        return self.speed_mismatch / self.turnover


def account(outputs: Sequence[Description], energies: Mapping[str, float]) -> Account:
    """Return the account from the time integrals of the outputs."""
    total: dict[str, float] = {}
    losses: dict[str, float] = {}
    for d in outputs:
        if d.booking:
            total[d.booking] = total.get(d.booking, 0.0) + energies[d.name]
        if d.booking == "loss":
            losses[d.name] = energies[d.name]
    owned: dict[str, dict[str, float]] = {}
    for d in outputs:
        owned.setdefault(part_of(d.name), {})[d.name] = energies[d.name]
    entering = {booking: [d.name for d in outputs if d.booking == booking] for booking in ("fuel", "stored")}
    parts = []
    for name, own in owned.items():
        received = [x for n, x in own.items() if n.split(".")[1].startswith("P_in") and not n.endswith("required")]
        received += [own[n] for names_in in entering.values() for n in names_in if n in own]
        lost = sum(x for n, x in own.items() if n in losses)
        if received or lost:
            burns = any(n in own for n in entering["fuel"])
            sent = sum(x for n, x in own.items() if n.split(".")[1].startswith("P_out"))
            parts.append(Part(name, sum(received), sent, lost, burns))
    return Account(
        fuel=total.get("fuel", 0.0),
        battery=total.get("stored", 0.0),
        parts=tuple(parts),
        losses=losses,
        kinetic=total.get("kinetic", 0.0),
        potential=total.get("potential", 0.0),
        speed_mismatch=total.get("mismatch", 0.0),
        inertia_discretisation=total.get("discretisation", 0.0),
        speed_limit=total.get("limit", 0.0),
    )
