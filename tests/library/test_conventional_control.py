import pytest

from halfshaft.models.vehicle import Vehicle

PARTS = Vehicle.load("small-car-conventional").components()
OPEN, SLIPPING, ENGAGED = 1, 2, 3


def control(tau, omega, *, before=OPEN, estimate=None, **signals):
    part, engine = PARTS["control"], PARTS["engine"]
    speeds = {name: float(x) for name, x in part.law(engine).items()}
    known = {"shifting": 0.0, "key_on": 1.0, "on_before": 1.0, "decided": 0.0, **signals}
    given = part.control(
        tau_clutch=tau, omega_clutch=omega, omega_input_estimate=omega if estimate is None else estimate, engine=engine,
        omega_launch=speeds["omega_launch"], clutch_before=float(before), **known,
    )  # fmt: skip
    return {name: float(x) for name, x in given.items()}, speeds


def test_the_clutch_slips_below_the_launch_speed_until_it_is_engaged():
    _, speeds = control(30.0, 0.0)
    idle, launch = speeds["omega_idle"], speeds["omega_launch"]
    # 1200 rpm is 1.5 times idling speed; a fifth of the highest speed is a little less.
    assert launch == pytest.approx(1.5 * idle)
    assert launch > 0.2 * float(PARTS["engine"].omega_max)
    below, _ = control(30.0, 0.99 * launch)
    assert (below["clutch_state"], below["omega_command"]) == (SLIPPING, pytest.approx(launch))
    above, _ = control(30.0, 1.01 * launch)
    assert (above["clutch_state"], above["omega_command"]) == (ENGAGED, pytest.approx(1.01 * launch))
    assert control(30.0, 0.99 * launch, before=ENGAGED)[0]["clutch_state"] == ENGAGED
    # After a shift down the clutch may turn faster than the estimate, which is that of the old gear.
    assert control(30.0, 1.01 * launch, estimate=0.6 * launch)[0]["clutch_state"] == ENGAGED


def test_the_launch_speed_is_a_share_of_the_highest_where_that_is_more():
    parts = Vehicle.load("small-car-conventional").with_values({"control.launch_share": 0.4}).components()
    launch = float(parts["control"].law(parts["engine"])["omega_launch"])
    assert launch == pytest.approx(0.4 * float(parts["engine"].omega_max))


def test_the_clutch_opens_below_idling_speed_when_no_torque_is_asked_for():
    _, speeds = control(30.0, 0.0)
    idle = speeds["omega_idle"]
    assert control(-5.0, 0.99 * idle, before=ENGAGED)[0]["clutch_state"] == OPEN
    assert control(-5.0, 1.01 * idle, before=ENGAGED)[0]["clutch_state"] == ENGAGED
    assert control(30.0, 200.0, before=ENGAGED, shifting=1.0)[0]["clutch_state"] == OPEN
