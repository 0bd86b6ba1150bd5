"""The solver against autosize, differential evolution and sizing again; the page of the manual; some minutes."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from halfshaft.studies.size import size
from halfshaft.validation.sizing import CARS, SMOOTH, case, smooth_price, ways

PAGE = Path(__file__).parents[1] / "docs" / "sizing.md"


@pytest.mark.parametrize("name", CARS)
def test_the_solver_is_no_worse_with_a_twentieth_of_the_evaluations(name: str) -> None:
    found = case(name)
    assert found.ipopt.holds
    assert found.ipopt.goal <= found.autosize.goal
    assert found.worse <= 1e-3
    assert found.fewer >= 20


@pytest.mark.parametrize("x", SMOOTH, ids=str)
def test_a_multiplier_is_the_price_of_one_percent(x: tuple[str, tuple[tuple[str, str], ...], str, str]) -> None:
    # Of a curve, the slope in its middle is that of the chord.
    price = smooth_price(*x)
    assert (price.tighter + price.looser) / 2 == pytest.approx(price.multiplier, rel=0.05)


@pytest.mark.parametrize("name", ["conventional", "electric"])
def test_what_one_percent_costs_is_the_integral_of_the_multipliers(name: str) -> None:
    assert len(ways(name)) == 2
    for way in ways(name):
        paid, risen = way.paid, way.rises
        # A gear that changes a step earlier is a jump, which no slope sees; the conventional car has three on both ways.
        smooth = np.abs(risen - paid) <= 0.1 * np.abs(paid)
        assert np.sum(~smooth) <= (2 if name == "conventional" else 0), way
        assert np.sum(risen[smooth]) == pytest.approx(np.sum(paid[smooth]), rel=0.02), way


def test_continuation_in_the_width_ends_at_the_same_vehicle() -> None:
    plain, led = case("electric").ipopt, size("electric", widths=(0.1, 0.01))
    assert led.holds
    assert led.goal == pytest.approx(plain.goal, rel=1e-4)
    # From width to width the relaxed goal comes to that of the step.
    wide, narrow, none = (run.goal for run in led.runs[:3])
    assert abs(narrow - none) < 0.2 * abs(wide - none)


def test_the_page_on_sizing_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert len(blocks) == 3
    space: dict[str, object] = {"__name__": "sizing"}
    for block in blocks:
        exec(compile(block, str(PAGE), "exec"), space)
