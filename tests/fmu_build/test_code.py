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
    flags = re.findall(r"^  (?:const )?int (\w+)(?: =|;)", code, re.M)
    assert len(flags) > 10
    made_numbers = re.compile(rf"\b(?:{'|'.join(flags)})\b \* | \* \b(?:{'|'.join(flags)})\b;|hs_max\((?:{'|'.join(flags)}), \(0x0")
    assert made_numbers.findall(code[code.index("hs_step_prepared") :]) == []
    # Whether a parameter is zero is known before the march.
    assert not re.search(r"= p\[\d+\] (\?|&&|\|\|)|!p\[", code[code.index("hs_step_prepared") :])


def test_tables_of_the_side_that_is_not_taken_are_not_looked_up():
    code = step_code(stepper_of(Vehicle.load("small-car-automatic")).step)
    step = code[code.index("static void hs_step_prepared") : code.index("static int hs_step(")]
    depths, depth = dict[str, list[int]](), 0
    for line in step.splitlines()[2:]:
        depth += line.count("{") - line.count("}")
        for table in re.findall(r"automatic_(\w+)_at\(", line):
            depths.setdefault(table, []).append(depth)
    # With the engine off no fuel is looked up; the pump's torque of all only where the engine cannot do what is asked of it.
    assert min(depths["engine_fuel"]) == 1
    assert min(depths["converter_pump_by_pump"]) >= 1
    assert max(depths["converter_pump_by_pump"]) >= 3
    assert min(depths["wheel_slip"]) == 0
