import pytest

from halfshaft.library.base.errors import InputError
from halfshaft.library.base.ports import Electric, Shaft
from halfshaft.library.files.component_file import read_component
from halfshaft.models.assembly import step_turning
from halfshaft.models.vehicle import Vehicle


@pytest.mark.parametrize(("offered", "share"), [(0.5, 0.5), (1.5, 1.0), (-0.5, 0.0)])
def test_a_motor_gives_the_share_of_its_torque_for_which_power_comes(offered, share):
    file = read_component("pm-32kw")
    motor = file.component(file.parameters)
    faces = {f.name: f for f in motor.faces()}
    signals = {"trace_missed": 0.0, "speed_ratio": 0.0, "omega_before": 0.0, "U_supply": 1e4, "turning": step_turning, "shifting": 0.0}
    way = faces["required"].run(shaft=Shaft(60.0, 300.0, 0.0), **signals)
    P = float(way["dc"].P)
    assert P > 60 * 300
    back = faces["available"].run(dc=Electric(offered * P), _way=way["_way"], dt=1.0)
    # More power than was asked for makes no torque, nor does power that flows the other way.
    assert float(back["shaft"].tau) == pytest.approx(60 * share)


@pytest.mark.parametrize(("speed", "share"), [(0.9, 1), (0.995, 1), (0.9975, 0.5), (1, 0), (1.01, 0)])
def test_forward_facing_a_motors_torque_fades_below_its_top_speed(speed, share):
    file = read_component("pm-32kw")
    motor = file.component(file.parameters)
    omega = speed * motor.omega_max
    room = {"P": 0.0, "P_out": 1e6, "P_in": 1e6, "U": 1e4}
    assert float(motor.short(0.0, omega, throttle=1.0, **room)) == pytest.approx(share * float(motor.limits(omega)[1]), rel=1e-9, abs=1e-9)
    # The motor brakes all the same.
    assert float(motor.short(0.0, omega, throttle=-1.0, **room)) == pytest.approx(float(motor.limits(omega)[0]), rel=1e-9)


@pytest.mark.parametrize(
    ("car", "name", "allowed", "refused"),
    [("small-car-conventional", "engine.efficiency_scale", 2.5, 3.0), ("small-car-electric", "motor.efficiency_scale", 1.05, 1.1)],
)
def test_no_scale_lifts_an_efficiency_above_one(car, name, allowed, refused):
    assert Vehicle.load(car).with_values({name: allowed}).values[name] == allowed
    with pytest.raises(InputError, match=rf"efficiency_scale = {refused:g} lifts an efficiency of the map above 1"):
        Vehicle.load(car).with_values({name: refused})
