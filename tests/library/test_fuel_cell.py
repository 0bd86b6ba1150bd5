from dataclasses import replace

import numpy as np
import pytest

from halfshaft.library.base.errors import InputError
from halfshaft.library.base.tables import Table
from halfshaft.library.files.component_file import component_names, read_component
from halfshaft.models.vehicle import Vehicle

NET, POLAR = (Vehicle.load(f"small-car-fuel-cell{end}").components()["fuel_cell"] for end in ("", "-polarisation"))
SYSTEMS = [*component_names("fuel-cell"), *component_names("fuel-cell-polarisation")]


def system(name):
    part = read_component(name)
    return part.component(part.component.parameters(**part.values))


def delivered(part, command, on=1.0, **memory):
    asked = part.ask(P_converter=command, converter_on=on, **memory)
    found = part.available(P_stack=asked["P_stack"], converter_on=on, fuel_used=0.0, dt=1.0)
    return float(found["dc"].P), float(found["P_fuel"]), float(found["P_loss"])


@pytest.mark.parametrize("name", SYSTEMS)
def test_every_system_loses_power_all_over_its_range(name):
    part = system(name)
    memory = {"flow_before": 0.0} if "flow_before" in [s.name for s in part.states] else {}
    P, fuel, loss = np.array([delivered(part, x, **memory) for x in np.linspace(0, 1.2 * float(part.P_largest), 50)]).T
    assert loss.min() > 0
    np.testing.assert_allclose(P + loss, fuel, rtol=1e-12)
    assert P.max() == pytest.approx(float(part.P_largest))
    assert delivered(part, 2e4, on=0.0, **memory) == (0.0, 0.0, 0.0)


def test_the_hydrogen_system_has_the_efficiency_of_its_source():
    # 59.6 % at 20 kW, 50.8 % at 50 kW, as printed; fuel to three digits.
    for P, eta in ((20e3, 0.596), (50e3, 0.508)):
        _, fuel, _ = delivered(NET, P)
        assert P / fuel == pytest.approx(eta, rel=2e-3)


def test_a_stack_gives_at_the_points_of_its_curve_what_is_asked_of_it():
    for i, U in zip(POLAR.p.U_cell.points[0], POLAR.p.U_cell.values, strict=True):
        P = POLAR.p.n_cells * POLAR.p.A_cell * i * U
        assert float(POLAR.current_density(P)) == pytest.approx(i, rel=1e-12)
    ends = POLAR.p.U_cell.points[0][[0, -1]]
    assert [float(POLAR.current_density(P)) for P in (0.0, 1e6)] == pytest.approx(ends.tolist())


def test_auxiliaries_take_their_power_a_step_late():
    first, fuel, _ = delivered(POLAR, 2e4, flow_before=0.0)
    second, *_ = delivered(POLAR, 2e4, flow_before=fuel / POLAR.p.H_fuel)
    assert first < 2e4 - 3000
    assert second == pytest.approx(2e4, rel=0.02)


def test_a_curve_must_be_one_that_a_power_has_one_current_on():
    with pytest.raises(InputError, match="U_cell falls so fast"):
        replace(POLAR.p, U_cell=Table.of([100.0, 1000.0, 2000.0], values=[0.9, 0.8, 0.3]))
    with pytest.raises(InputError, match="a cell gives more power than its fuel has at H_fuel = 6e"):
        replace(POLAR.p, H_fuel=6e7)
    with pytest.raises(InputError, match="lifts an efficiency of the map above 1"):
        replace(NET.p, efficiency_scale=1.7)
