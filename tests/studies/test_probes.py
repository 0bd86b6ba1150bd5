"""Derivatives of what tests find: against differences of the tests themselves, and a balance of forces."""

import pytest
from typer.testing import CliRunner

from halfshaft import InputError, Vehicle
from halfshaft.app.cli import app
from halfshaft.studies.acceleration import AccelerationTest, TopSpeedTest
from halfshaft.studies.gradeability import GradeabilityTest
from halfshaft.studies.probes import task_gradient

CAR = Vehicle.load("small-car-electric").displaced({})


@pytest.mark.parametrize(
    ("task", "figure", "apart", "near"),
    [
        # Where a limit begins to act in another step, a difference is not straight; and a solved speed is found to 0.01 mm/s.
        (AccelerationTest(), "time_0_to_60_mph_s", 1e-3, 4e-3),
        (AccelerationTest(), "time_over_402.336_m_s", 1e-2, 2e-2),
        (TopSpeedTest(), "top_speed_mps", 1e-3, 3e-3),
        (GradeabilityTest(tolerance=1e-8), "grade_percent", 1e-3, 1e-3),
    ],
    ids=["time", "way", "top", "grade"],
)
def test_what_a_test_finds_changes_as_its_gradient_says(task, figure, apart, near):
    numbers = ["body.m", "motor.torque_scale", "body.c_d"]
    gradient = task_gradient(task, CAR, numbers, [figure])
    assert gradient.keys() == {figure}
    for name in numbers:
        value = CAR.values[name]
        up, down = (task(CAR.displaced({name: value * (1 + sign * apart)})).figures[figure] for sign in (1, -1))
        assert gradient[figure][name] == pytest.approx((up - down) / (2 * apart * value), rel=near, abs=1e-5 / (2 * apart * value)), name


def test_a_grade_falls_with_the_mass_as_the_forces_say():
    grade = GradeabilityTest(tolerance=1e-8)(CAR).figures["grade_percent"] / 100
    p, slope = CAR.values, task_gradient(GradeabilityTest(), CAR, ["body.m"])["grade_percent"]["body.m"] / 100
    # The force that is left beside the air's is that of climbing and rolling, which are in proportion to the mass: m (s + f c) = const.
    sine, cosine = grade / (1 + grade**2) ** 0.5, 1 / (1 + grade**2) ** 0.5
    per_mass = -(sine + p["wheel.f_0"] * cosine) / p["body.m"] / ((cosine - p["wheel.f_0"] * sine) * cosine**2)
    assert slope == pytest.approx(per_mass, rel=0.05)


def test_what_is_wrong_is_told_at_once_and_the_command_shows_what_a_per_cent_does():
    with pytest.raises(InputError) as error:
        task_gradient(TopSpeedTest(), CAR, ["body.mass", "motor.P"])
    assert len(error.value.problems) == 2
    with pytest.raises(InputError, match="top-speed finds no speed"):
        task_gradient(TopSpeedTest(), CAR, ["body.m"], ["speed"])
    done = CliRunner().invoke(app, ["test", "small-car-electric", "top-speed", "--gradient", "body.c_d"])
    assert done.exit_code == 0
    assert "1 % more of body.c_d" in done.output
    wrong = CliRunner().invoke(app, ["test", "small-car-electric", "top-speed", "--gradient", "body.cd"])
    assert wrong.exit_code
    assert "--gradient: body.cd is no number of the vehicle, did you mean 'body.c_d'?" in " ".join(wrong.stderr.split())
