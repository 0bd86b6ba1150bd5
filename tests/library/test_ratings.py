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


@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind in ("battery-rc", "ultracapacitor") for name in component_names(kind)])
def test_capacitors_give_their_energy_when_they_are_emptied_slowly(kind, name):
    p = read_component(name).build(n_modules=10.0, capacity_scale=1.3)
    T = p.T_start
    full, empty, C = (p.u_max, 0, p.C(T)) if hasattr(p, "C") else (p.u_oc(T, 1.0), p.u_oc(T, 0.0), p.C_bulk(T) + p.C_surface(T))
    u = np.linspace(full, empty, 1001)
    assert p.ratings()["energy"] == pytest.approx(10 * 1.3 * C * -np.sum(np.diff(u) * (u[1:] + u[:-1]) / 2), rel=1e-9)


def resistance(p, soc):
    """Return voltage and resistance of a module that is discharged."""
    at = p.T_start, soc
    if hasattr(p, "C"):
        return soc * p.u_max, p.r_discharge(p.T_start)
    if hasattr(p, "r_bulk"):
        r_e, r_c = p.r_bulk(*at), p.r_surface(*at)
        return p.u_oc(*at), p.r_terminal(*at) + r_c * r_e / (r_c + r_e)
    return p.u_oc(*at), p.r_discharge(*at)


@pytest.mark.parametrize(
    ("kind", "name"), [(kind, name) for kind in ("battery", "battery-rc", "ultracapacitor") for name in component_names(kind)]
)
def test_no_terminal_voltage_gives_more_than_a_packs_own_power(kind, name):
    p = read_component(name).build(n_modules=10.0, capacity_scale=1.3)
    best = 0.0
    for soc in np.linspace(0, 1, 101):
        u, r = resistance(p, float(soc))
        at = np.linspace(max(p.u_min, 0.5 * u), u, 201) if u > p.u_min else np.array([u])
        best = max(best, float(np.max(10 * 1.3 * at * (u - at) / r)))
    assert p.P_own == pytest.approx(best, rel=0.01)


def test_a_fuel_cells_own_power_is_the_most_that_is_left_of_its_stack():
    for name in component_names("fuel-cell-polarisation"):
        p = read_component(name).build()
        net = []
        for i in np.linspace(*p.U_cell.inside(0), 201):
            area = p.n_cells * p.A_cell
            net.append(area * float(i) * p.U_cell(float(i)) - p.P_aux(area * p.fuel(float(i)) / p.utilisation))
        assert p.P_own == pytest.approx(max(net), rel=1e-3)
    for name in component_names("fuel-cell"):
        assert read_component(name).build(P_scale=0.7).P_own == pytest.approx(0.7 * read_component(name).build().P_own)
