import math
import os

import pytest

from halfshaft.library.base.errors import InputError
from halfshaft.library.files.catalog import component_kinds
from halfshaft.library.files.component_file import component_names, parse_quantity, read_component

HEAD = 'schema = 1\nkind = "motor"\nname = "m"\ntitle = "M"\nsource = "S"\n'
NUMBERS = 'omega_max = "3000 rpm"\nJ = "0.047 kg m^2"\nI_max = "300 A"\n'
AXIS = 'omega = {unit = "rpm", values = [0, 1500, 3000]}\n'
TAU_MAX = "[parameters.tau_max]\n" + AXIS + 'values = {unit = "N m", values = [150, 150, 40]}\n'
TAU_MIN = "[parameters.tau_min]\n" + AXIS + 'values = {unit = "N m", values = [-150, -150, -40]}\n'
TAU_AXIS = 'tau = {unit = "N m", values = [-150, 150]}\n'
POWER = "[parameters.P_electric]\n" + AXIS + TAU_AXIS + 'values = {unit = "kW", values = [[1, 1], [-20, 27], [-40, 54]]}\n'
MOTOR = HEAD + "[parameters]\n" + NUMBERS + TAU_MAX + TAU_MIN + POWER


def write(folder, text, name="m"):
    path = folder / f"{name}.toml"
    path.write_text(text)
    return path


def problems(path, derived=()):
    with pytest.raises(InputError) as e:
        read_component(path, derived)
    return list(e.value.problems)


def changed(folder, *pairs):
    text = MOTOR
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new, 1)
    return problems(write(folder, text))


def test_a_good_file_gives_parameters_in_si(tmp_path):
    file = read_component(write(tmp_path, MOTOR))
    p = file.parameters
    assert (file.kind, file.name, file.title, file.source) == ("motor", "m", "M", "S")
    assert p.omega_max == pytest.approx(100 * math.pi)
    assert p.P_electric(50 * math.pi, 150.0) == pytest.approx(27e3)
    assert p.overtorque == 1.0


def test_a_file_is_read_once_until_it_changes(tmp_path):
    path = write(tmp_path, MOTOR)
    first = read_component(path)
    assert read_component(path) is first
    # What vehicles share, none of them can change.
    with pytest.raises(ValueError, match="read-only"):
        first.values["tau_max"].values[0] = 0.0
    write(tmp_path, MOTOR.replace('title = "M"', 'title = "N"'))
    assert read_component(path).title == "N"
    assert read_component(path, ["omega_max"]) is not read_component(path)


@pytest.mark.parametrize("kind", component_kinds())
def test_every_kind_has_components_and_all_of_them_load(kind):
    names = component_names(kind)
    assert names
    for name in names:
        file = read_component(name, ["omega_locus"] if kind == "series-control" else ())
        assert (file.kind, file.name) == (kind, name)
        assert len(file.source) > 10 or kind in ("bus", "clutch", "fixed-gear")


def test_names_of_the_library_are_unique():
    names = component_names()
    assert len(names) == len(set(names)) == sum(len(component_names(kind)) for kind in component_kinds())


def test_motor_of_the_paper_has_the_figures_of_its_data_sheet():
    p = read_component("pm-32kw").parameters
    rpm = math.pi / 30
    assert p.tau_max.values.tolist() == [150, 150, 150, 150, 137, 112, 90, 76, 65, 60, 46, 42, 42]
    assert p.omega_max == pytest.approx(7500 * rpm, rel=1e-12)
    assert p.overtorque * p.tau_max(0.0) == pytest.approx(248.4375)
    assert p.P_electric(1200 * rpm, 25.0) == pytest.approx(3695.991357)
    assert (p.J, p.I_max, p.U_min) == (0.047, 300, 60)


def test_battery_has_the_figures_of_its_source():
    p = read_component("pb-25ah").parameters
    assert p.Q(293.15) == 25 * 3600
    assert p.u_oc(295.15, 0.5) == pytest.approx(12.37)
    assert p.r_discharge(295.15, 0.0) == pytest.approx(0.0407)
    assert p.T_fan == pytest.approx(308.15)
    assert p.u_oc.points[0].tolist() == pytest.approx([273.15, 295.15, 313.15])


def test_engine_fuel_is_in_kilogrammes_per_second():
    p = read_component("si-41kw").parameters
    assert p.H_fuel == pytest.approx(42.6e6)
    assert p.rho_fuel == pytest.approx(749)
    assert p.fuel.values.min() == pytest.approx(0.1254801167e-3)
    assert max(p.tau_max.points[0] * p.tau_max.values) == pytest.approx(41007.03)


def test_generator_power_is_efficiency_times_shaft_power():
    p = read_component("eta-95").parameters
    assert p.P_electric(300.0, 120.0) == pytest.approx(0.95 * 300 * 120)


def test_wheel_slip_is_over_adhesion():
    p = read_component("small-car-wheels").parameters
    assert p.slip(0.6715) == pytest.approx(0.05)
    assert p.mu_max == 1.0212
    assert p.share_driveline(10 * 0.44704) == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("value", "unit", "si"),
    [
        ("0.05 kg m^2", "kg.m^2", 0.05),
        ("0.05kg*m**2", "kg.m^2", 0.05),
        ("35 degC", "K", 308.15),
        ("20 %", "1", 0.2),
        ("20 percent", "1", 0.2),
        ("0.3", "1", 0.3),
        (0.3, "1", 0.3),
        ("60 rpm", "rad/s", 2 * math.pi),
        ("10 mph", "m/s", 4.4704),
        ("2 Ah", "C", 7200.0),
        ("1 g/s", "kg/s", 1e-3),
        ("-1e3 N m", "N.m", -1000.0),
    ],
)
def test_quantities_are_converted(value, unit, si):
    assert parse_quantity(value, unit, "x") == pytest.approx(si)


@pytest.mark.parametrize(
    ("value", "unit", "message"),
    [
        ("3 kg", "N.m", 'x = "3 kg", must be a torque such as N.m'),
        ("3", "N.m", "must have a unit such as N.m"),
        (3.0, "N.m", "must have a unit such as N.m"),
        (True, "1", "must be a number"),
        ("much", "m", "must be a number and a unit"),
        ("3 foo", "m", '"foo" is not a known unit'),
        ("inf m", "m", "must be a finite number"),
        ("nan", "1", "must be a finite number"),
        ("1e999 m", "m", "must be a finite number"),
        ("50 Hz", "rad/s", "must be an angular speed such as rad/s"),
        ("50 1/min", "rad/s", "must be an angular speed such as rad/s"),
        ("3 m**9**9**9**9", "m", "is not a unit"),
        ("3 __import__('os')", "m", "is not a unit"),
    ],
)
def test_what_is_no_quantity_is_refused(value, unit, message):
    with pytest.raises(InputError) as e:
        parse_quantity(value, unit, "x")
    assert message in str(e.value)


def test_invalid_toml_names_the_line(tmp_path):
    assert "at line 2" in problems(write(tmp_path, "schema = 1\nkind = \n"))[0]


def test_absurd_nesting_is_an_input_error(tmp_path):
    assert "not a TOML file" in problems(write(tmp_path, "x = " + "[" * 100_000))[0]


def test_a_missing_file_is_an_input_error(tmp_path):
    assert "cannot be read" in problems(tmp_path / "m.toml")[0]


def test_a_misspelt_component_names_the_nearest():
    with pytest.raises(InputError, match="'pm-32w': not in the library, did you mean 'pm-32kw'"):
        read_component("pm-32w")


def test_another_schema_is_refused(tmp_path):
    assert changed(tmp_path, ("schema = 1", "schema = 2")) == ["schema = 2, this version reads schema 1"]


def test_an_unknown_kind_names_the_nearest(tmp_path):
    assert changed(tmp_path, ('"motor"', '"moter"')) == ["kind = \"moter\" is not known, did you mean 'motor'?"]


def test_the_name_must_be_that_of_the_file(tmp_path):
    assert changed(tmp_path, ('name = "m"', 'name = "n"')) == ['name = "n", must be the name of the file, "m"']


def test_keys_of_the_wrong_type_and_missing_ones_are_named(tmp_path):
    assert changed(tmp_path, ('"M"', "3"), ('source = "S"\n', "")) == ["title = 3, must be a text", "source is missing"]


def test_a_misspelt_parameter_is_unknown_and_the_right_one_missing(tmp_path):
    assert changed(tmp_path, ("I_max", "I_maks")) == [
        "parameters.I_maks is not known, did you mean 'I_max'?",
        "parameters.I_max is missing: current limit of the controller",
    ]


def test_bounds_are_those_of_the_parameter(tmp_path):
    assert changed(tmp_path, ("0.047 kg", "-1 kg")) == ['parameters.J = "-1 kg m^2", must be >= 0 kg.m^2 and <= 100 kg.m^2']


def test_wrong_units_of_numbers_axes_and_values_are_named(tmp_path):
    found = changed(
        tmp_path, ("0.047 kg m^2", "3 kg"), ('"N m", values = [150', '"kg", values = [150'), ('"rpm", values', '"km/h", values')
    )
    assert found == [
        'parameters.tau_max.omega has unit "km/h", must be an angular speed such as rad/s',
        'parameters.tau_max.values has unit "kg", must be a torque such as N.m',
        'parameters.J = "3 kg", must be an inertia such as kg.m^2',
    ]


@pytest.mark.parametrize("bad", ["nan", "inf", '"no"', "true", "[1]"])
def test_an_entry_of_a_map_that_is_no_number_is_named_by_its_place(tmp_path, bad):
    (found,) = changed(tmp_path, ("[-20, 27]", f"[-20, {bad}]"))
    assert found.startswith("parameters.P_electric.values[2][2] = ")
    assert found.endswith("must be a finite number")


def test_an_unsorted_axis_names_both_values(tmp_path):
    assert changed(tmp_path, ("[0, 1500, 3000]", "[0, 1500, 1200]")) == [
        "parameters.tau_max.omega[3] = 1200 follows 1500, an axis must rise strictly"
    ]


def test_a_wrong_shape_names_the_axis(tmp_path):
    assert changed(tmp_path, ("[150, 150, 40]", "[150, 150]"), ("[-40, 54]", "[-40]")) == [
        "parameters.P_electric.values[3] has 1 entries, must have 2, one for each tau",
        "parameters.tau_max.values has 2 entries, must have 3, one for each omega",
    ]


def test_a_map_without_axis_or_values_is_refused(tmp_path):
    assert changed(tmp_path, (TAU_MAX, "[parameters.tau_max]\n")) == [
        "parameters.tau_max.omega is missing",
        "parameters.tau_max.values is missing",
    ]


def test_a_number_in_place_of_a_map_is_refused(tmp_path):
    assert changed(tmp_path, (TAU_MAX, ""), ("J =", "tau_max = 3\nJ =")) == [
        "parameters.tau_max = 3, must be a table with omega and values"
    ]


def test_many_bad_entries_are_counted(tmp_path):
    row = "[" + "nan, " * 20 + "]"
    axis = f"[{', '.join(str(i) for i in range(20))}]"
    found = changed(tmp_path, ("[0, 1500, 3000]", axis), ("[150, 150, 40]", row))
    assert found[-1] == "and 15 more like these"
    assert len(found) == 6


def test_bounds_hold_for_the_entries_of_a_map(tmp_path):
    head = HEAD.replace("motor", "gearbox-map").replace('"m"', '"g"')
    axes = "omega = {unit = 'rad/s', values = [0]}\ntau = {unit = 'N m', values = [0]}\ngear = [1]\n"
    table = f"[parameters.efficiency]\n{axes}values = [[[1.2]]]\n"
    found = problems(write(tmp_path, f"{head}[parameters]\nratios = [3, -1]\n{table}", "g"))
    assert len(found) == 2
    assert found[0].startswith("parameters.ratios[2] = -1, must be >= 0.01")
    assert found[1].startswith("parameters.efficiency.values[1][1][1] = 1.2, must be >= 0")


def test_contradictions_between_parameters_are_named(tmp_path):
    head = HEAD.replace("motor", "wheel").replace('"m"', '"w"')
    numbers = 'r = "0.3 m"\nJ = "1 kg m^2"\nf_0 = 0.01\nmu_max = 1\nfront_driven = 0\n'
    tables = (
        "[parameters.slip]\nadhesion = [0, 1]\nvalues = [0, 0.1]\n"
        "[parameters.tau_bearing]\nm = {unit = 'kg', values = [0]}\nvalues = {unit = 'N m', values = [0]}\n"
        "[parameters.share_driveline]\nv = {unit = 'm/s', values = [0]}\nvalues = [0.5]\n"
        "[parameters.share_front]\nv = {unit = 'm/s', values = [0]}\nvalues = [0.5]\n"
    )
    (found,) = problems(write(tmp_path, f"{head}[parameters]\n{numbers}{tables}", "w"))
    assert "at least one axle must be driven" in found


def test_what_other_parts_decide_may_be_left_open_only_when_said_so():
    with pytest.raises(InputError, match="omega_locus is missing"):
        read_component("series-thermostat")
    assert "omega_locus" not in read_component("series-thermostat", ["omega_locus"]).values


HOSTILE = "a\\u001b[31m*/\\u202e \\u0007\\n\\u0085\\u2028b"


def test_titles_and_sources_lose_control_characters(tmp_path):
    file = read_component(write(tmp_path, MOTOR.replace('"M"', f'"{HOSTILE}"').replace('"S"', f'"{HOSTILE}"')))
    assert (file.title, file.source) == ("a [31m*/ b",) * 2


@pytest.mark.parametrize("name", ["-m", "a*b", "a\\b", 'a"b', "a\x1bb", "a\u202eb", "a\nb", "x" * 101])
def test_names_are_of_a_checked_alphabet(tmp_path, name):
    text = MOTOR.replace('name = "m"', "name = " + '"' + "".join(f"\\U{ord(c):08x}" for c in name) + '"')
    (found,) = problems(write(tmp_path, text, name))
    assert "must be letters, digits, spaces" in found
    assert found.isprintable()


@pytest.mark.parametrize("name", ["m", "My car (2)", "prüfstand_3.5+", "公司"])
def test_names_of_any_language_are_read(tmp_path, name):
    assert read_component(write(tmp_path, MOTOR.replace('name = "m"', f'name = "{name}"'), name)).name == name


def test_messages_do_not_steer_the_terminal(tmp_path):
    with pytest.raises(InputError) as e:
        read_component(write(tmp_path, MOTOR.replace("J =", '"\\u001b[2J" =').replace('"300 A"', '"3 \\u202e"')))
    assert "\x1b" not in str(e.value)
    assert "\\x1b[2J is not known" in str(e.value)


DIGITS, HEX = "9" * 400, "0x" + "f" * 5000


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"0.047 kg m^2"', DIGITS, "parameters.J = a number of more than 29 digits, must have a unit such as"),
        ('"300 A"', HEX, "parameters.I_max = a number of more than 29 digits, must have a unit such as"),
        ('"300 A"', f'"{DIGITS} A"', "must be a number and a unit"),
        ('"300 A"', '"1e300 GA"', "must be >= 0.1 A and <= 1e+09 A and finite"),
        ('"300 A"', '"1e9 dBm"', "must be a current such as A"),
        ("[150, 150, 40]", f"[150, {DIGITS}, 40]", "values[2] = a number of more than 29 digits, must be a finite number"),
        ("[0, 1500, 3000]", f"[0, 1500, {HEX}]", "omega[3] = a number of more than 29 digits, must be a finite number"),
        ("[150, 150, 40]", "[1e300, 150, 40]", "parameters.tau_max.values[1] = 1e+300 GN m, must be a finite number"),
        ('"300 A"', "9" * 5000, "not a TOML file"),
        ("title", ".".join(["title"] * 5000), "title = {...}, must be a text"),
        ("J =", "overtorque =" + HEX + "\nJ =", "overtorque = a number of more than 29 digits, must be >= 0.01 and <= 100 and finite"),
        ("[0, 1500, 3000]", "[1500, 1500.0000000000001, 3000]", "must rise strictly"),
        ('[[1, 1], [-20, 27], [-40, 54]]', "[[1], [-20, 27], [-40, 54]]", "parameters.P_electric.values[1] has 1 entries"),
    ],
)  # fmt: skip
def test_numbers_that_no_float_holds_are_refused(tmp_path, old, new, message):
    text = MOTOR.replace('"N m", values = [150', '"GN m", values = [150') if "GN" in message else MOTOR
    assert any(message in p for p in problems(write(tmp_path, text.replace(old, new, 1))))


def test_a_ragged_map_beside_a_bad_axis_is_refused(tmp_path):
    text = MOTOR.replace("[-150, 150]}", "[150, -150]}").replace("[-20, 27]", "[-20]")
    assert problems(write(tmp_path, text)) == [
        "parameters.P_electric.tau[2] = -150 follows 150, an axis must rise strictly",
        "parameters.P_electric.values[2] has 1 entries, must have 2, one for each tau",
    ]
    text = MOTOR.replace("[-150, 150]}", "[]}").replace("[-20, 27]", "[-20]")
    assert "parameters.P_electric.values has lines of unequal length" in problems(write(tmp_path, text))


def test_axis_points_that_merge_on_conversion_are_refused(tmp_path):
    # Two neighbouring floats in degrees Celsius are one in kelvin.
    axis = "T = {unit = 'degC', values = [20, 20.000000000000004]}"
    text = HEAD.replace("motor", "battery").replace('"m"', '"b"') + f"[parameters.Q]\n{axis}\nvalues = {{unit = 'Ah', values = [1, 2]}}\n"
    assert "parameters.Q.T[2] = 20 follows 20, an axis must rise strictly" in problems(write(tmp_path, text, "b"))


def test_points_too_close_for_the_search_are_refused(tmp_path):
    text = MOTOR.replace("[0, 1500, 3000]", "[0, 1e-300, 3000]", 1)
    assert problems(write(tmp_path, text)) == ["parameters.tau_max: axis 1 has points too close to each other, or too far apart"]


def test_only_regular_files_of_a_bounded_size_are_read(tmp_path):
    os.mkfifo(tmp_path / "m.toml")
    assert problems(tmp_path / "m.toml") == ["is not a regular file"]
    with (tmp_path / "sparse.toml").open("wb") as file:
        file.truncate(10**10)
    assert problems(tmp_path / "sparse.toml") == ["has more than 10 MB, which is the most that is read"]
    assert problems(tmp_path / "a\0.toml") == ["cannot be read: embedded null byte"]
    (tmp_path / "latin.toml").write_bytes("title = 'Größe'".encode("latin-1"))
    assert problems(tmp_path / "latin.toml") == ["not a text file in UTF-8: invalid start byte at byte 12"]
