from dataclasses import replace

import numpy as np
import pytest

from halfshaft.library.base.errors import InputError
from halfshaft.library.base.tables import Table
from halfshaft.library.files.component_file import component_names, read_component

OPEN = ["omega_locus"]


def plain(values):
    """Return values whose tables compare by their bits."""
    return {name: x.key if isinstance(x, Table) else x for name, x in values.items()}


@pytest.mark.parametrize("name", component_names())
def test_every_component_of_the_library_comes_back_to_the_bit(tmp_path, name):
    file = read_component(name, OPEN)
    again = read_component(file.save(tmp_path / f"{name}.toml"), OPEN)
    assert (again.kind, again.name, again.title, again.source) == (file.kind, file.name, file.title, file.source)
    assert plain(again.values) == plain(file.values)
    assert again.to_toml() == file.to_toml()


def test_odd_numbers_and_texts_come_back(tmp_path):
    file = read_component("pm-32kw")
    odd = {**file.values, "J": 5e-324, "I_max": 0.1 + 2**-55, "overtorque": 1 / 3, "mass": 1e5 - 2**-37}
    odd["tau_max"] = Table.of([0.1, 0.1 + 2**-55], values=[-0.0, np.nextafter(1, 2)], clip=False)
    strange = replace(file, values=odd, title="Quotes \" ' and a backslash \\ or two", source="Größe, 公司")
    again = read_component(strange.save(tmp_path / "odd.toml"))
    assert (again.name, again.title, again.source) == ("odd", strange.title, strange.source)
    assert plain(again.values) == plain(odd)


def test_what_cannot_be_saved_is_said(tmp_path):
    file = read_component("pm-32kw")
    with pytest.raises(InputError, match=r"must end in \.toml"):
        file.save(tmp_path / "motor.json")
    with pytest.raises(InputError, match="there is no folder"):
        file.save(tmp_path / "none" / "motor.toml")
    with pytest.raises(InputError, match="in UTF-8"):
        file.save(tmp_path / "caf\udce9.toml")
