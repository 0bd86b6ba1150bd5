"""The C of a step: what it must not spend time on."""

import re

import pytest

from halfshaft import Vehicle
from halfshaft.cosim.simulate import stepper_of
from halfshaft.fmu_build.code import step_code

CARS = ("electric", "conventional", "series", "power-split", "automatic", "cvt", "two-motor")


@pytest.mark.parametrize("vehicle", [f"small-car-{car}" for car in CARS])
def test_flags_choose_and_are_no_factors(vehicle):
    code = step_code(stepper_of(Vehicle.load(vehicle)).step)
    flags = re.findall(r"const int (\w+) = ", code)
    assert len(flags) > 10
    made_numbers = re.compile(rf"\b(?:{'|'.join(flags)})\b \* | \* \b(?:{'|'.join(flags)})\b;|hs_max\((?:{'|'.join(flags)}), \(0x0")
    assert made_numbers.findall(code[code.index("hs_step_prepared") :]) == []
    # Whether a parameter is zero is known before the march.
    assert not re.search(r"= p\[\d+\] (\?|&&|\|\|)|!p\[", code[code.index("hs_step_prepared") :])
