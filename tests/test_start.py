"""What a start of the program imports: heavy packages only where they are used."""

import os
import subprocess
import sys

import numpy as np
import pytest

from halfshaft.library.files import component_file as files

HEAVY = ("casadi", "fmpy", "h5netcdf", "halfshaft.cosim.forward", "matplotlib", "numpy", "pandas", "pint", "scipy", "xarray")


def imported(*arguments: str) -> set[str]:
    """Return which of the heavy packages a command imports, in a process of its own."""
    code = f"""
import sys
from halfshaft.app.cli import app
try:
    app({list(arguments)!r})
except SystemExit as end:
    assert not end.code, end.code
print("imported:", *(name for name in {HEAVY!r} if name in sys.modules))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env={**os.environ, "COLUMNS": "200"})
    return set(done.stdout.splitlines()[-1].split()[1:])


@pytest.mark.parametrize("arguments", [["--help"], ["run", "--help"], ["--version"]])
def test_help_imports_nothing_that_computes(arguments: list[str]) -> None:
    assert imported(*arguments) == set()


@pytest.mark.parametrize("vehicle", ["small-car-electric", "small-car-conventional", "small-car-series"])
def test_a_run_imports_what_it_computes_with(vehicle: str) -> None:
    assert imported("run", vehicle, "--cycle", "nycc") == {"casadi", "numpy"}


@pytest.mark.parametrize("unit", files.COMMON)
def test_common_units_have_the_digits_of_pint(unit: tuple[str, str]) -> None:
    values = np.random.default_rng(1).normal(size=1000) * 100
    quantity = files._units().Quantity(values, unit[0]).to(files._units().parse_units(unit[1]))
    assert np.array_equal(files._to_si(values, *unit), quantity.magnitude)
