"""The published sizes of a hybrid, against what the library's step says of the same car; the other one is in `validation/`."""

import pytest

from halfshaft.validation.sizes import CARS, given_motor


def test_the_published_parallel_car_does_what_it_was_sized_for_and_needs_its_modules():
    found, published = given_motor("parallel"), CARS["parallel"]
    reached = {r.goal.title: r.before for r in found.goals}
    assert all(r.goal.met(r.before) for r in found.goals)
    # It was sized to 5.3 s, and content within 0.02 s; one module less would miss that.
    assert reached["40 to 60 mph [s]"] == pytest.approx(5.3, abs=0.02)
    assert found.after["store"] == published.sizes["battery.n_modules"]
    assert found.binds["store"] == "40 to 60 mph [s]"
    assert published.vehicle.mass == pytest.approx(published.mass, abs=1)
