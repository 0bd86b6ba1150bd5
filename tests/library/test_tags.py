from dataclasses import fields
from typing import get_args

import pytest

from halfshaft.library.base.errors import InputError
from halfshaft.library.base.parameters import Parameters, param, spec_of
from halfshaft.library.base.tags import Tag, Tags
from halfshaft.library.files.catalog import component_kinds

TAGS = Tags({"one.soc": "charge", "two.soc": "charge", "one.m": "vehicle mass"})


def test_any_number_is_found():
    assert TAGS.all_of("charge") == ["one.soc", "two.soc"]
    assert TAGS.by_part("charge") == {"one": "one.soc", "two": "two.soc"}
    assert TAGS.all_of("gear") == []
    assert TAGS.the("vehicle mass") == "one.m"


@pytest.mark.parametrize(("tag", "found"), [("charge", "one.soc and two.soc is"), ("gear", "nothing is")])
def test_the_one_must_be_one(tag, found):
    with pytest.raises(InputError, match=f"one thing must be tagged '{tag}', here {found}"):
        TAGS.the(tag)


def tags_of(cls):
    """Return all tags of a component."""
    found = {v.tag for v in cls.variables} | {s.tag for s in cls.states} | {s.tag for s, _ in cls.plant_states}
    found |= {tag for port in cls.ports().values() for tag in port.tags.values()}
    return found | {spec_of(f).tag for f in fields(cls.parameters)}


def test_every_word_is_used_by_a_component_and_no_other():
    assert set().union(*map(tags_of, component_kinds().values())) == set(get_args(Tag))


@pytest.mark.parametrize("kind", component_kinds())
def test_what_a_component_books_and_limits_can_be_told_of(kind):
    cls = component_kinds()[kind]
    bookings = {v.booking for v in cls.variables}
    if "fuel" in bookings:
        assert tags_of(cls) >= {"fuel mass", "fuel density", "fuel heating value"}
    if "stored" in bookings:
        assert tags_of(cls) >= {"charge", "start charge"}
        assert cls.parameters.ratings is not Parameters.ratings
    assert all(v.warning for v in cls.variables if v.kind == "flag" and v.name.endswith("limited"))


def test_a_part_is_rated_at_nothing_unless_it_says_so():
    class Plain(Parameters):
        m: float = param("kg", "mass", 1.0)

    assert Plain().ratings() == {}
