import numpy as np
import pytest

from halfshaft.library.files.component_file import component_names, read_component


@pytest.mark.parametrize("name", component_names("motor"))
def test_no_speed_gives_more_than_the_peak_power(name):
    p = read_component(name).build(overtorque=1.5, torque_scale=0.8, speed_scale=1.25)
    omega = np.linspace(0, p.omega_max, 2001)
    power = 1.5 * 0.8 * 1.25 * np.array([p.tau_max(float(x)) * x for x in omega])
    # The grid misses the corner by 1e-3 of the range at most.
    assert power.max() <= p.ratings()["traction power"] * (1 + 1e-12)
    assert power.max() == pytest.approx(p.ratings()["traction power"], rel=2e-3)


@pytest.mark.parametrize("name", component_names("battery"))
def test_a_pack_gives_its_energy_when_it_is_emptied_slowly(name):
    p = read_component(name).build(n_modules=10.0, capacity_scale=1.3)
    soc = np.linspace(1, 0, 1001)
    u = np.array([p.u_oc(p.T_start, float(x)) for x in soc])
    energy = 10 * 1.3 * p.Q(p.T_start) * np.sum((u[1:] + u[:-1]) / 2) / 1000
    assert p.ratings()["energy"] == pytest.approx(energy, rel=1e-4)
