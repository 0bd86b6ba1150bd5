"""Pictures of the maps of components."""

import numpy as np
import pytest

from halfshaft.cosim.maps import plot_maps
from halfshaft.library.base.errors import InputError
from halfshaft.library.files.component_file import component_names, read_component


def panels(name):
    axes = plot_maps(read_component(name)).axes
    return [ax for ax in axes if ax.get_label() != "<colorbar>" and ax.axison]


def test_a_map_of_two_axes_has_its_envelopes_in_it():
    (ax,) = panels("ac-75kw")
    p = read_component("ac-75kw").parameters
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("omega [rad/s]", "tau [N.m]")
    black = [line.get_ydata() for line in ax.lines if line.get_color() != "white"]
    assert all(np.array_equal(y, t.values) for y, t in zip(black, (p.tau_max, p.tau_min), strict=True))


def test_an_axis_along_which_nothing_changes_is_left_out():
    first, *_, last = panels("pb-25ah")
    # The tables of this battery are the same at all temperatures.
    assert first.get_xlabel() == "soc"
    assert len(first.lines) == 1
    assert last.get_xlabel() == "T [\u00b0C]"
    assert last.lines[0].get_xdata().tolist() == pytest.approx([0, 22, 40])


def test_a_map_of_three_axes_has_a_panel_for_each_gear():
    assert [ax.get_title(loc="left")[:18] for ax in panels("five-speed-map")] == [f"efficiency, gear {i}" for i in range(1, 6)]


@pytest.mark.parametrize("name", [n for n in component_names() if n.endswith(("kw", "ah"))])
def test_maps_of_machines_and_batteries_are_drawn(name):
    assert panels(name)


def test_a_picture_is_written_whole_and_a_component_without_maps_says_so(tmp_path):
    plot_maps(read_component("si-41kw"), tmp_path / "map.png")
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(InputError) as e:
        plot_maps(read_component("small-car"), tmp_path / "map.bmp")
    assert e.value.problems == ("a plot is written as .png, .svg, .pdf, not as '.bmp'", "small-car has no maps to draw")
    assert e.value.where == str(tmp_path / "map.bmp")
    with pytest.raises(InputError, match=r"^plot: small-car has no maps to draw$"):
        plot_maps(read_component("small-car"))
