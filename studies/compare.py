"""Several runs beside each other: what differs in what made them, and in what came of it."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast

from halfshaft.cosim.cycle import Cycle
from halfshaft.cosim.facts import table
from halfshaft.cosim.result import Result
from halfshaft.cosim.simulate import run
from halfshaft.cosim.units import SYSTEMS, Units, shown
from halfshaft.cosim.ways import Mode
from halfshaft.library.base.errors import InputError
from halfshaft.models.vehicle import Vehicle

if TYPE_CHECKING:
    import pandas as pd

    from halfshaft.cosim.plot import Picture


class Metric(NamedTuple):
    """A number of a run that is compared: its key in `Result.figures`, title, quantity of `cosim.units`, and a system if not both."""

    key: str
    title: str
    quantity: str
    units: Units | None = None


#: What is compared, where a run has it.
METRICS = (
    Metric("distance_m", "distance", "distance"),
    Metric("duration_s", "duration", "time"),
    Metric("fuel_L", "fuel", "volume"),
    Metric("fuel_economy_L_per_100km", "economy, fuel alone", "economy"),
    Metric("fuel_equivalent_L_per_100km", "with battery as fuel", "economy"),
    Metric("energy_from_battery_J", "battery gave", "energy"),
    Metric("energy_Wh_per_km", "consumption", "consumption"),
    Metric("energy_MPGe", "economy", "equivalent", "us"),
    Metric("range_m", "range on a full battery", "range"),
    Metric("motor_input_J", "motor input", "energy"),
    Metric("soc_start", "charge at the start", "share"),
    Metric("soc_end", "charge at the end", "share"),
    Metric("trace_miss_max_mps", "largest trace miss", "speed"),
)


class Difference(NamedTuple):
    """Something that made the runs and is not the same in all: what it is, its unit, and its value in each; None where there is none."""

    name: str
    unit: str
    values: tuple[Any, ...]


@dataclass(frozen=True)
class Comparison:
    """Runs, and what to call them."""

    results: tuple[Result, ...]
    labels: tuple[str, ...]

    def __repr__(self) -> str:
        return f"<Comparison of {', '.join(self.labels)}: {len(self.differences())} differences>"

    def differences(self, *, all_parameters: bool = False) -> list[Difference]:
        """Return what differs in what made the runs: how they ran, their parts, and their parameters.

        Parameters
        ----------
        all_parameters
            Also those of roles that are filled by different parts, or not by all.

        """
        inputs = [r.inputs for r in self.results]
        rows = [Difference(name, "", tuple(getattr(i, name) for i in inputs)) for name in ("vehicle", "powertrain", "cycle", "via", "mode")]
        rows += [Difference("dt", "s", tuple(i.dt for i in inputs)), Difference("version", "", tuple(i.version for i in inputs))]
        rows = [row for row in rows if len(set(row.values)) > 1]
        cycles = [i.hashes.get("cycle") for i in inputs]
        if len(set(cycles)) > 1 and len({i.cycle for i in inputs}) == 1:
            rows.append(Difference("cycle, by its points", "", tuple((text or "")[:8] for text in cycles)))
        other = set()
        parts = [r.origin.parts if r.origin else {} for r in self.results]
        for role in dict.fromkeys(role for of_run in parts for role in of_run):
            filled = [of_run.get(role) for of_run in parts]
            if len({part and part.sha256 for part in filled}) > 1:
                other.add(role)
                names = [part and part.name for part in filled]
                told = [part and f"{part.name} ({part.sha256[:8]})" for part in filled] if len(set(names)) == 1 else names
                rows.append(Difference(role, "", tuple(told)))
        sets = [i.parameters for i in inputs]
        specs = {name: spec.unit for r in self.results if r.made for name, spec in r.vehicle.specs.items()}
        for name in dict.fromkeys(name for of_run in sets for name in of_run):
            values = tuple(of_run.get(name) for of_run in sets)
            if len(set(values)) > 1 and (all_parameters or (name.partition(".")[0] not in other and None not in values)):
                rows.append(Difference(name, specs.get(name, ""), values))
        return rows

    def _metrics(self, units: Units) -> list[tuple[Metric, list[float | None]]]:
        """Return what at least one run has, with its values."""
        told = [(m, [r.figures[m.key] for r in self.results]) for m in METRICS if m.units in (None, units)]
        # Miles per gallon of no fuel are no number.
        told = [(m, [None if x == 0 and m.quantity == "economy" else x for x in values]) for m, values in told]
        return [(m, values) for m, values in told if any(x is not None for x in values)]

    def metrics(self, units: Units = "metric") -> list[Difference]:
        """Return the main numbers of the runs in the units of a reader; those that no run has are left out."""
        seen = [(m, SYSTEMS[units][m.quantity], values) for m, values in self._metrics(units)]
        return [Difference(m.title, unit.name, tuple(None if x is None else unit.of(x) for x in values)) for m, unit, values in seen]

    def to_pandas(self, units: Units = "metric") -> pd.DataFrame:
        """Return the main numbers as a table: a row for each, a column for each run."""
        import pandas as pd  # takes a third of a second

        rows = self.metrics(units)
        index = pd.Index([f"{row.name} [{row.unit}]" for row in rows], name="metric")
        return pd.DataFrame([row.values for row in rows], index=index, columns=list(self.labels))

    def tables(self, units: Units = "metric") -> tuple[list[tuple[str, ...]], list[tuple[str, ...]]]:
        """Return both tables as texts: what differs, and the main numbers, each with its difference from the first run's."""
        made = [(_named(row), *map(_text, row.values)) for row in self.differences()]
        found = []
        for m, values in self._metrics(units):
            texts = [shown(m.quantity, x, units) for x in values]
            of = SYSTEMS[units][m.quantity].of
            against = [_against(of, values[0], x) if i and m.quantity != "share" else "" for i, x in enumerate(values)]
            found.append((m.title, *(text + more for text, more in zip(texts, against, strict=True))))
        return made, found

    def plot(self, panels: str | Sequence[str] | None = None, *, units: Units = "metric", path: str | Path | None = None) -> Picture:
        """Draw the runs over each other, as `halfshaft.plot_run` does; a panel may be any output."""
        from halfshaft.cosim.plot import Picture, plot_run

        figure = plot_run(*self.results, panels=panels, labels=self.labels, units=units, path=path)
        assert isinstance(figure, Picture)
        return figure

    def plot_metrics(self, *, units: Units = "metric", path: str | Path | None = None) -> Picture:
        """Draw the main numbers as bars."""
        from halfshaft.studies.bars import plot_bars

        rows = [row for row in self.metrics(units) if row.name != "duration" and not row.name.startswith("charge")]
        return plot_bars([(f"{row.name} [{row.unit}]", row.values) for row in rows], self.labels, path=path)

    def plot_points(self, parts: Sequence[str] | None = None, *, units: Units = "metric", path: str | Path | None = None) -> Picture:
        """Draw the operating points of machines on their maps."""
        from halfshaft.cosim.points import plot_points

        return plot_points(*self.results, parts=parts, labels=self.labels, units=units, path=path)

    def plot_flows(self, *, path: str | Path | None = None) -> Picture:
        """Draw where the energy of each run flowed, to the same scale."""
        from halfshaft.cosim.flow_plot import plot_flows

        return plot_flows(*self.results, labels=self.labels, path=path)

    def _repr_html_(self) -> str:
        made, found = self.tables()
        head = ("", *self.labels)
        drawn = ""
        if all(r.has_history and len(r.time) for r in self.results):
            picture = b64encode(self.plot(panels="speed")._repr_png_()).decode()
            drawn = f'<img alt="speed over time" style="max-width:100%" src="data:image/png;base64,{picture}">'
        titles = [f"<b>{escape(text)}</b>" for text in ("What differs", "What came of it")]
        return f"{titles[0]}{table(made, head)}{titles[1]}{table(found, head)}{drawn}"


def compare(
    *things: Vehicle | Result, cycle: Cycle | None = None, mode: Mode = "hybrid", dt: float = 1.0, labels: Sequence[str] | None = None
) -> Comparison:
    """Put runs beside each other.

    Parameters
    ----------
    things
        Results, and vehicles that are run first.
    cycle, mode, dt
        How vehicles are run, as in `halfshaft.run`.
    labels
        What to call the runs; without them, what tells them apart.

    Raises
    ------
    InputError
        If there are less than two, a vehicle has no cycle to run, or something is neither vehicle nor result.

    """
    problems = [] if len(things) > 1 else [f"{len(things)} to compare, must be at least 2"]
    problems += [f"must be vehicles or results, not {type(x).__name__}" for x in things if not isinstance(x, Vehicle | Result)]
    if cycle is None and any(isinstance(x, Vehicle) for x in things):
        problems.append("a vehicle needs a cycle to run over")
    if labels is not None and len(labels) != len(things):
        problems.append(f"{len(labels)} labels for {len(things)} runs")
    if problems:
        raise InputError("comparison", list(dict.fromkeys(problems)))
    from halfshaft.cosim.plot import labels_of

    results = [x if isinstance(x, Result) else run(x, cast("Cycle", cycle), mode=mode, dt=dt) for x in things]
    return Comparison(tuple(results), tuple(labels or labels_of(results)))


def _named(row: Difference) -> str:
    return row.name if row.unit in ("", "1") else f"{row.name} [{row.unit}]"


def _text(value: Any) -> str:
    return "-" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)


def _against(of: Callable[[float], float], first: float | None, x: float | None) -> str:
    """Return by how much a number differs from the first, as a reader sees both."""
    said = f"{100 * (of(x) / of(first) - 1):+.1f}" if first and x else ""
    return f" ({said} %)".replace("-", "\u2212") if said.strip("+-0.") else ""
