from dataclasses import dataclass, field, fields

import casadi as ca
import numpy as np
import pytest

from halfshaft.library.base.errors import HalfshaftError, InputError
from halfshaft.library.base.parameters import Parameters, bind, numbers, param, params, spec_of, table, tables
from halfshaft.library.base.tables import Axis, Table
from halfshaft.library.chassis.body import BodyParameters
from halfshaft.library.chassis.wheel import WheelParameters
from halfshaft.library.control.series import SeriesControlParameters
from halfshaft.library.driveline.gearbox import PolynomialGearboxParameters
from halfshaft.library.files.catalog import component_kinds


@dataclass(frozen=True, kw_only=True)
class Spring(Parameters):
    """All sorts of parameters."""

    k: float = param("N/m", "stiffness", gt=0)
    share: float = param("1", "share", 0.5, ge=0, le=1)
    rates: tuple[float, ...] = params("1/s", "rates", (1.0, 2.0), ge=0)
    force: Table = table("N", "force", Axis("x", "m"), clip=True, ge=0)

    def check(self):
        return ["share must not be 0.25"] if self.share == 0.25 else []


FORCE = Table.of([0, 1], values=[0.0, 3.0])


def problems(make, **values):
    with pytest.raises(InputError) as e:
        make(**values)
    return list(e.value.problems)


def test_all_bad_numbers_are_named_in_one_error_with_value_unit_and_bound():
    found = problems(Spring, k=0, share=1.5, rates=(1.0, -2.0), force=Table.of([0, 1], values=[1.0, -3.0]))
    assert found == [
        "k = 0 N/m, must be > 0 N/m",
        "share = 1.5, must be >= 0 and <= 1",
        "rates = -2 1/s, must be >= 0 1/s",
        "force = -3 N, must be >= 0 N",
    ]


def test_bad_numbers_and_contradictions_come_together():
    assert problems(Spring, k=-1, share=0.25, force=FORCE) == ["k = -1 N/m, must be > 0 N/m", "share must not be 0.25"]


def test_the_error_names_the_parameter_set():
    with pytest.raises(InputError, match=r"Spring: k = -1 N/m, must be > 0 N/m") as e:
        Spring(k=-1, force=FORCE)
    assert isinstance(e.value, HalfshaftError)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf"), np.float64("nan")])
def test_no_number_may_be_infinite_or_not_a_number(value):
    assert len(problems(Spring, k=value, share=value, rates=(value, 1.0), force=FORCE)) == 3


def test_a_number_must_be_finite():
    assert problems(PolynomialGearboxParameters, ratios=(5.0,), c6=float("nan")) == ["c6 = nan W, must be >= -100000 W and <= 100000 W"]


@pytest.mark.parametrize(("share", "fits"), [(0, True), (1, True), (-1e-12, False), (1 + 1e-12, False)])
def test_bounds_with_equality_admit_their_ends(share, fits):
    if fits:
        assert Spring(k=1, share=share, force=FORCE).share == share
    else:
        assert len(problems(Spring, k=1, share=share, force=FORCE)) == 1


@pytest.mark.parametrize(
    ("bounds", "lowest", "highest"),
    [({"gt": 0}, 2.2250738585072014e-308, None), ({"gt": 2, "lt": 3}, 2.0000000000000004, 2.9999999999999996), ({"ge": 2, "le": 3}, 2, 3)],
)
def test_strict_bounds_have_a_number_next_to_them(bounds, lowest, highest):
    spec = spec_of(field(metadata=param("1", "a number", **bounds).metadata))
    assert (spec.lowest, spec.highest) == (lowest, highest)
    assert spec.holds(lowest)


def test_a_parameter_without_default_must_be_given():
    with pytest.raises(TypeError, match="k"):
        Spring(force=FORCE)


def test_a_parameter_set_cannot_be_changed():
    with pytest.raises(AttributeError):
        Spring(k=1, force=FORCE).k = 2


def test_numbers_are_listed_with_rows_numbered_from_one_and_tables_apart():
    p = Spring(k=1, force=FORCE)
    assert [(name, value) for name, _, value in numbers(p)] == [("k", 1.0), ("share", 0.5), ("rates_1", 1.0), ("rates_2", 2.0)]
    assert list(tables(p)) == [("force", FORCE)]


def test_binding_replaces_every_number_and_table_without_a_check():
    p = Spring(k=1, force=FORCE)
    symbols = {name: ca.SX.sym(name) for name, *_ in numbers(p)}
    bound = bind(p, symbols, {"force": FORCE.interpolant})
    assert bound.k is symbols["k"]
    assert bound.rates == (symbols["rates_1"], symbols["rates_2"])
    assert bound.force is FORCE.interpolant
    assert isinstance(bound, Spring)


@pytest.mark.parametrize("kind", component_kinds())
def test_every_parameter_of_every_kind_has_a_unit_and_a_meaning(kind):
    for f in fields(component_kinds()[kind].parameters):
        spec = spec_of(f)
        assert spec.unit
        assert len(spec.doc) > 3
        assert all(axis.name and axis.unit for axis in spec.axes)


@pytest.mark.parametrize("kind", component_kinds())
def test_every_port_state_and_variable_of_every_kind_is_named_once_and_described(kind):
    component = component_kinds()[kind]
    variables = component.all_variables(component(None))
    for names in ([s.name for s in component.states], [v.name for v in variables]):
        assert len(names) == len(set(names))
    for described in (*component.states, *variables):
        assert described.unit
        assert described.doc


def test_a_wheel_needs_a_driven_axle():
    small = {
        "slip": Table.of([0, 1], values=[0, 0.1]),
        "tau_bearing": Table.of([0, 1], values=[0, 1], clip=False),
        "share_driveline": Table.of([0], values=[0.5]),
    }
    found = problems(WheelParameters, r=0.3, J=1, f_0=0.01, mu_max=1, front_driven=0, share_front=Table.of([0], values=[0.5]), **small)
    assert found == ["front_driven and rear_driven are both 0, at least one axle must be driven"]


def test_a_window_must_be_a_window():
    locus = Table.of([1, 2], values=[100, 200])
    assert problems(SeriesControlParameters, soc_low=0.8, soc_high=0.8, omega_locus=locus) == ["soc_low = 0.8 must be below soc_high = 0.8"]


def test_symbols_pass_without_bounds():
    m = ca.SX.sym("m")
    assert BodyParameters(m=m, c_d=0.3, A=2.0).m is m


#: What a parameter is that a file leaves out, by its name: it scales, loses, weighs and delays nothing, and stands in the air of a room.
LEFT_OUT = {
    **dict.fromkeys(
        ("P_scale", "capacity_scale", "efficiency_scale", "speed_scale", "torque_scale", "overtorque", "eta", "eta_charge"), 1.0
    ),
    **dict.fromkeys(("J", "mass", "tau_loss", "b", "c", "f_1", "F_1", "P_on", "P_alternator", "t_hold", "t_shift"), 0.0),
    "T_ambient": 293.15,
    "T_start": 293.15,
    "g": 9.81,
    "rho": 1.2,
}


def left_out():
    """Return kind, field and default of every number that a file may leave out."""
    parameters = [(kind, f, f.default) for kind, component in component_kinds().items() for f in fields(component.parameters)]
    return [(kind, f, x) for kind, f, x in parameters if isinstance(x, float)]


def test_what_a_file_leaves_out_changes_nothing():
    known = {(kind, f.name): x for kind, f, x in left_out() if f.name in LEFT_OUT}
    assert {name for _, name in known} == set(LEFT_OUT)
    assert {place: x for place, x in known.items() if x != LEFT_OUT[place[1]]} == {}


def test_what_a_file_leaves_out_lies_inside_its_bounds():
    assert len(left_out()) > 100
    assert [(kind, f.name, x) for kind, f, x in left_out() if not spec_of(f).holds(x)] == []


#: What goes on in a straight line outside of its points; all else, which was measured, keeps the value of its edge.
GOES_ON = {"P_electric", "tau_max", "tau_min", "capacity", "tau_bearing", "up", "down"}


def test_maps_keep_their_edges_but_for_machines_bearings_and_shift_lines():
    maps = {(kind, f.name): spec_of(f) for kind, component in component_kinds().items() for f in fields(component.parameters)}
    going_on = {place for place, spec in maps.items() if spec.axes and not spec.clip}
    assert going_on == {(kind, name) for kind, name in maps if name in GOES_ON} - {("engine", "tau_max")}
