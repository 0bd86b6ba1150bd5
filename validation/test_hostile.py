"""Twenty thousand broken files; run with ``make validate`` (some twenty minutes)."""

from __future__ import annotations

from pathlib import Path

import pytest

from halfshaft.validation.hostile import attempt

FILES, GROUP = 20_000, 500


@pytest.mark.parametrize("first", range(10**6, 10**6 + FILES, GROUP))
def test_whatever_a_file_holds_it_runs_or_is_refused(first: int, tmp_path: Path) -> None:
    outcomes = {attempt(tmp_path, seed) for seed in range(first, first + GROUP)}
    assert outcomes >= {"ran", "InputError"}
