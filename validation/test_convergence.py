"""Slow: results settle as the step shrinks, and settle where the forward-facing model is; run with ``make validate``."""

from __future__ import annotations

import numpy as np
import pytest

from halfshaft.models.vehicle import Vehicle, vehicle_names
from halfshaft.validation.convergence import STEPS, TASKS, Row, convergence, table

#: Motors alone turn the wheels.  Where an engine does, fuel goes with the seconds in which gears, clutch and engine change, which other
#: steps place elsewhere: the table has those cars, docs/forward.md says how far they are apart.
DRIVEN = ("electric", "two_motor", "series", "fuel_cell")
CARS = [name for name in vehicle_names() if Vehicle.load(name).powertrain in DRIVEN]

#: What refined results move by below 0.1 s, and how far they may stay from IDAS: slip's rate is neglected there, and the
#: controls of a genset are sampled.
MOVES, APART = 2.5e-3, 3e-3


@pytest.fixture(scope="module", params=CARS)
def rows(request: pytest.FixtureRequest) -> dict[tuple[str, str], Row]:
    """Return the rows of a vehicle by task and mode."""
    return {(row.task, row.mode): row for row in convergence([request.param])}


@pytest.mark.parametrize("task", TASKS)
def test_refined_results_settle_where_idas_is(rows: dict[tuple[str, str], Row], task: str) -> None:
    row = rows[task, "refined"]
    values = np.array(row.values, dtype=float)
    short = values[np.array(STEPS) <= 0.1]
    assert np.ptp(short) < MOVES * values[-1]
    # A second is not yet short.
    assert np.abs(values / values[-1] - 1).max() < 1.5e-2
    assert row.forward == pytest.approx(values[-1], rel=APART)


def test_hybrid_results_are_the_refined_ones_where_no_limit_acts(rows: dict[tuple[str, str], Row]) -> None:
    # The heaviest car misses UDDS in some steps, hardly.
    assert rows["udds", "hybrid"].values == pytest.approx(rows["udds", "refined"].values, rel=1e-4)


def test_the_table_has_a_column_for_each_step_and_one_for_idas(rows: dict[tuple[str, str], Row]) -> None:
    head, _, *lines = table(rows.values())
    assert [cell.strip() for cell in head.split("|")[4:-1]] == [*(f"{dt:g} s" for dt in STEPS), "IDAS"]
    assert len(lines) == len(rows)
    assert all(line.count("|") == head.count("|") for line in lines)
