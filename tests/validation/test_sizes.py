"""The published sizes of two hybrids, against what the library's step says of the same cars."""

import pytest

from halfshaft.validation.sizes import CARS, given_motor


@pytest.mark.parametrize("name", CARS)
def test_a_published_size_does_what_it_was_sized_for_and_needs_its_modules(name):
    found = given_motor(name)
    for reached in found.goals:
        assert reached.goal.met(reached.before), reached.goal.title
    # One module less would miss a goal.
    assert found.after["store"] == CARS[name].sizes["battery.n_modules"]
    assert found.binds["store"].startswith("40 to 60 mph")
    assert CARS[name].vehicle.mass == pytest.approx(CARS[name].mass, abs=1)


def test_the_published_parallel_car_is_sized_to_the_tolerance_of_its_binding_goal():
    # It aimed at 5.3 s and was content within 0.02 s.
    (time,) = (r.before for r in given_motor("parallel").goals if r.goal.title.startswith("40 to 60"))
    assert time == pytest.approx(5.3, abs=0.02)
