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


def test_every_word_is_used_by_a_component_and_no_other():
    used = set()
    for cls in component_kinds().values():
        used |= {v.tag for v in cls.variables} | {s.tag for s in cls.states} | {s.tag for s, _ in cls.plant_states}
        used |= {tag for port in cls.ports().values() for tag in port.tags.values()}
        used |= {spec_of(f).tag for f in fields(cls.parameters)}
    assert used == set(get_args(Tag))


def test_a_part_is_rated_at_nothing_unless_it_says_so():
    class Plain(Parameters):
        m: float = param("kg", "mass", 1.0)

    assert Plain().ratings() == {}
