"""Slow: every hybrid of the library finds the charge that it keeps, and the difference of both corrections is accounted for."""

from __future__ import annotations

import pytest

from halfshaft.models.vehicle import Vehicle, vehicle_names
from halfshaft.studies.conditions import is_hybrid
from halfshaft.validation.soc_correction import ALIKE, MOST_RUNS, TOLD, Row, rows, table

HYBRIDS = [name for name in vehicle_names() if is_hybrid(Vehicle.load(name))]


@pytest.fixture(scope="module", params=HYBRIDS)
def found(request: pytest.FixtureRequest) -> list[Row]:
    """Return the rows of a vehicle."""
    return list(rows([request.param]))


def test_zero_delta_converges_within_eight_runs(found: list[Row]) -> None:
    for row in found:
        assert row.zero.status == "converged", (row.vehicle, row.cycle)
        # What uses its charge up first has none that it keeps.
        assert len(row.zero.record) <= MOST_RUNS or not row.keeps, (row.vehicle, row.cycle)
        last = row.zero.record[-1]
        assert abs(last.change) < 0.005 or (last.energy_ratio is not None and abs(last.energy_ratio) < 0.01)


def test_the_difference_is_what_is_lost_and_stored_more(found: list[Row]) -> None:
    for row in found:
        if row.difference is not None:
            assert sum(row.reasons.values()) == pytest.approx(row.difference, abs=1e-9)
            assert abs(row.difference) <= ALIKE or any(abs(x) > TOLD for x in row.reasons.values())


def test_the_table_has_a_line_for_each_row(found: list[Row]) -> None:
    lines = list(table(found))
    assert len(lines) == 2 + len(found)
    assert all(line.count("|") == 11 for line in lines)
