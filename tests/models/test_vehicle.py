from dataclasses import replace

import pytest

from halfshaft.library.base.errors import InputError
from halfshaft.library.base.parameters import tables
from halfshaft.models.powertrain import Derived, Powertrain, powertrains
from halfshaft.models.vehicle import Vehicle, vehicle_names

SERIES = Vehicle.load("small-car-series")

FILE = """schema = 1
kind = "vehicle"
name = "v"
title = "V"
base = "small-car-electric"
"""


def write(folder, text, name="v"):
    path = folder / f"{name}.toml"
    path.write_text(text)
    return path


def problems(action, *arguments):
    with pytest.raises(InputError) as e:
        action(*arguments)
    return list(e.value.problems)


@pytest.mark.parametrize("name", vehicle_names())
def test_every_vehicle_loads_and_fills_all_roles(name):
    vehicle = Vehicle.load(name)
    assert vehicle.name == name
    assert list(vehicle.components()) == list(powertrains()[vehicle.powertrain].roles)
    assert vehicle.values.keys() == vehicle.specs.keys()
    assert vehicle.source


@pytest.mark.parametrize("powertrain", powertrains().values(), ids=lambda p: p.name)
def test_a_powertrain_derives_from_roles_that_it_has(powertrain):
    for d in powertrain.derived:
        assert {d.role, *(d.of.get(name, name) for rule in d.rules for name in rule.needs or ())} <= powertrain.roles.keys()
    assert all(powertrain.kinds(role) for role in powertrain.roles)


def test_a_powertrain_says_all_that_is_wrong_with_its_names():
    with pytest.raises(InputError) as e:
        Powertrain("rear-motor", "", {"Body": ("body",)}, lambda m: None, (Derived("control.x", ()),), hybridisation=1.5)
    assert list(e.value.problems) == [
        "'rear-motor' must be of lower-case words with _ between them",
        "'Body' must be of lower-case words with _ between them",
        "control.x is derived, but there is no role control",
        "hybridisation = 1.5, must be >= 0 and <= 1",
    ]


def test_a_role_takes_kinds_and_families_that_there_are():
    one = Powertrain("one", "", {"gearbox": ("gearbox", "gearbox-map"), "battery": ("batery",)}, lambda m: None)
    assert one.misfits() == ["role battery takes batery, which is no kind or family, did you mean 'battery'?"]


@pytest.mark.parametrize("mass", [1459, 1936, 2393])
def test_the_papers_vehicles_differ_in_mass_only(mass):
    vehicle, lightest = Vehicle.load(f"paper-series-{mass}"), Vehicle.load("paper-series-1459")
    assert vehicle.values == {**lightest.values, "body.m": mass}
    assert vehicle.values["gearbox.ratios_1"] == 6.14
    assert vehicle.values["battery.n_modules"] == 27
    assert vehicle.values["body.v_miss"] == 0.447


@pytest.mark.parametrize(("name", "mass"), [("small-car-electric", 1144), ("small-car-series", 1373), ("small-car-conventional", 984)])
def test_small_cars_have_the_masses_of_the_source(name, mass):
    assert Vehicle.load(name).values["body.m"] == mass


def test_top_speed_rule_gives_the_ratio_of_the_source():
    # The source's figures have 12 digits; motor speeds there are rounded likewise.
    assert SERIES.values["gearbox.ratios_1"] == pytest.approx(6.67321332876, rel=1e-11)


def test_top_speed_rule_follows_wheel_motor_and_final_drive():
    ratio = SERIES.values["gearbox.ratios_1"]
    changed = SERIES.with_values({"wheel.r": 2 * 0.282, "motor.speed_scale": 1.5, "final_drive.i": 3.0})
    assert changed.values["gearbox.ratios_1"] == pytest.approx(ratio * 2 * 1.5 / 3)


def test_top_speed_rule_follows_another_motor():
    # 5.0049 is the source's default ratio with this motor.
    assert SERIES.with_parts({"motor": "pm-32kw"}).values["gearbox.ratios_1"] == pytest.approx(5.0049, abs=5e-5)


def test_a_number_that_is_set_wins_over_its_rule():
    changed = SERIES.with_values({"gearbox.ratios_1": 5.0}).with_values({"wheel.r": 0.3})
    assert changed.values["gearbox.ratios_1"] == 5.0
    assert "gearbox.ratios_1" in changed.explicit


def test_genset_locus_is_that_of_the_source():
    locus = SERIES.parameters["control"].omega_locus
    assert locus.values.tolist() == [104.5, 107, 154, 248, 326, 351, 374, 424, 487, 498, 596.9]
    assert locus.points[0][[0, 1, -1]].tolist() == pytest.approx([710.6, 4740.243, 41007.03])


def test_genset_locus_follows_the_generator():
    weak = SERIES.with_values({"generator.torque_scale": 0.3})
    assert weak.parameters["control"].omega_locus.values.tolist() != SERIES.parameters["control"].omega_locus.values.tolist()


def test_the_vehicle_itself_never_changes():
    SERIES.with_values({"body.m": 2000.0})
    assert SERIES.values["body.m"] == 1373


def test_values_may_be_texts_with_units():
    assert SERIES.with_values({"body.m": "1.5 t", "motor.J": "470 kg cm^2"}).values["motor.J"] == pytest.approx(0.047)


def test_all_bad_values_are_named_at_once():
    found = problems(SERIES.with_values, {"body.mm": 3, "motor.J": "3 kg", "wheel.r": -1, "body.c_d": float("nan")})
    assert found == [
        "body.mm is not known, did you mean 'body.m'?",
        'motor.J = "3 kg", must be an inertia such as kg.m^2',
        "wheel.r = -1, must be >= 0.05 m and <= 10 m",
        found[3],
    ]
    assert found[3].startswith("body.c_d = nan, must be >= 0")


def test_contradictions_within_a_part_are_named():
    assert problems(SERIES.with_values, {"control.soc_low": 0.9}) == ["control: soc_low = 0.9 must be below soc_high = 0.8"]


def test_a_gear_that_does_not_exist_cannot_be_set():
    assert problems(SERIES.with_values, {"gearbox.ratios_2": 3.0}) == ["gearbox.ratios_2 is not known, did you mean 'gearbox.ratios_1'?"]


def test_one_gear_of_several_can_be_set():
    values = Vehicle.load("small-car-conventional").with_values({"gearbox.ratios_3": 5.5}).values
    assert [values[f"gearbox.ratios_{i}"] for i in (2, 3, 4)] == [7.57, 5.5, 3.77]


def test_numbers_and_rules_of_a_part_go_when_it_is_replaced():
    changed = SERIES.with_parts({"gearbox": "single-polynomial", "battery": "nimh-93ah"})
    assert changed.values["gearbox.ratios_1"] == 6.14
    assert changed.explicit == {"generator.torque_scale"}


def test_parts_that_do_not_fit_are_named_at_once():
    found = problems(SERIES.with_parts, {"motor": "pb-25ah", "mator": "pm-32kw", "engine": "si-41w"})
    assert found == [
        "mator is not known, did you mean 'motor'?",
        f'motor = "pb-25ah" is of kind battery, must be {" or ".join(powertrains()["series"].kinds("motor"))}',
        "engine: component 'si-41w': not in the library, did you mean 'si-41kw'?",
    ]


def test_a_misspelt_vehicle_names_the_nearest():
    with pytest.raises(InputError, match="did you mean 'small-car-series'"):
        Vehicle.load("small-car-serie")


def test_a_file_can_change_another_vehicle(tmp_path):
    part = 'schema = 1\nkind = "body"\nname = "b"\ntitle = "B"\nsource = "S"\n[parameters]\nm = "900 kg"\nc_d = 0.2\nA = "1.9 m^2"\n'
    write(tmp_path, part, "b")
    vehicle = Vehicle.load(write(tmp_path, FILE + '[parts]\nbody = "b.toml"\n[set]\nwheel.r = "0.3 m"\n'))
    assert vehicle.values["body.m"] == 900
    assert vehicle.values["wheel.r"] == 0.3
    assert vehicle.values["gearbox.ratios_1"] == pytest.approx(6.67321332876 * 0.3 / 0.282)


def test_a_bad_file_names_every_problem(tmp_path):
    text = FILE.replace('title = "V"\n', "") + (
        '[parts]\nmotor = "pm-32w"\n[set]\nbody.mm = "3 kg"\nmotor.J = "1 kg m^2"\nwheel.r = 0.3\nfoo = 1\n'
        '[derive]\ngearbox.ratios = {rule = "top-sped"}\nbody.m = {rule = "top-speed", v = "30 m/s"}\n'
    )
    assert problems(Vehicle.load, write(tmp_path, text)) == [
        "title is missing",
        "parts.motor: component 'pm-32w': not in the library, did you mean 'pm-32kw'?",
        "set.foo is not known",
        "set.body.mm is not known, did you mean 'body.m'?",
        "set.wheel.r = 0.3, must have a unit such as m",
        'derive.body.m has rule "top-speed", must be sum-of-parts',
        'derive.gearbox.ratios has rule "top-sped", must be top-speed',
    ]


def test_a_rule_needs_its_parts_and_one_gear(tmp_path):
    rule = '[derive]\ngearbox.ratios = {rule = "top-speed", v = "30 m/s"}\n'
    (found,) = problems(Vehicle.load, write(tmp_path, FILE.replace("electric", "conventional") + rule))
    assert found == "derive.gearbox.ratios: no rule gives it in the powertrain conventional"
    found = problems(Vehicle.load, write(tmp_path, FILE + '[parts]\ngearbox = "five-speed-map"\n' + rule))
    assert found == ["gearbox.ratios has 5 entries, its rule gives 1"]


def test_settings_of_a_rule_are_checked(tmp_path):
    found = problems(Vehicle.load, write(tmp_path, FILE + '[derive]\ngearbox.ratios = {rule = "top-speed", v = "30 kg", slop = 1}\n'))
    assert found == [
        "derive.gearbox.ratios.slop is not known, did you mean 'slip'?",
        'derive.gearbox.ratios.v = "30 kg", must be a speed such as m/s',
    ]


def test_missing_parts_and_an_unknown_powertrain_are_named(tmp_path):
    head = 'schema = 1\nkind = "vehicle"\nname = "v"\ntitle = "V"\nsource = "S"\n'
    assert problems(Vehicle.load, write(tmp_path, head + 'powertrain = "elektric"\nparts = {}\n')) == [
        "powertrain = \"elektric\" is not known, did you mean 'electric'?"
    ]
    found = problems(Vehicle.load, write(tmp_path, head + 'powertrain = "electric"\nparts = {body = "small-car"}\n'))
    assert found == [f"parts.{role} is missing" for role in powertrains()["electric"].roles if role != "body"]


def test_a_vehicle_cannot_be_its_own_base(tmp_path):
    found = problems(Vehicle.load, write(tmp_path, FILE.replace("small-car-electric", "v.toml")))
    assert found == ["base leads back to the vehicle itself"]


def test_a_component_file_is_no_vehicle(tmp_path):
    assert 'kind = "body" is not known, must be vehicle' in problems(Vehicle.load, write(tmp_path, FILE.replace('"vehicle"', '"body"')))


def saved(vehicle):
    """Return all that makes a vehicle, comparable."""
    parts = {role: (p.kind, p.name, p.title, p.source) for role, p in vehicle.parts.items()}
    maps = {f"{role}.{n}": t.key for role, p in vehicle.parameters.items() for n, t in tables(p)}
    heads = vehicle.name, vehicle.title, vehicle.source, vehicle.powertrain
    return heads, parts, vehicle.given, vehicle.rules, vehicle.values, maps


@pytest.mark.parametrize("name", vehicle_names())
def test_every_vehicle_comes_back_to_the_bit(tmp_path, name):
    vehicle = Vehicle.load(name)
    assert saved(Vehicle.load(vehicle.save(tmp_path / f"{name}.toml"))) == saved(vehicle)


def test_a_saved_vehicle_keeps_what_was_changed(tmp_path):
    motor = SERIES.parts["motor"].save(tmp_path / "mine.toml")
    car = SERIES.with_parts({"motor": motor}).with_values({"body.m": "1.5 t", "motor.J": 1 / 3, "gearbox.ratios_1": 5.1})
    path = car.save(tmp_path / "car.toml")
    assert 'motor = "mine.toml"' in path.read_text()
    again = Vehicle.load(path)
    assert again.name == "car"
    assert saved(again)[1:] == saved(car)[1:]
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    assert Vehicle.load(write(elsewhere, car.to_toml(), car.name)).values == car.values


def test_a_vehicle_on_a_base_does_not_take_its_source(tmp_path):
    electric = Vehicle.load("small-car-electric")
    own = f"own figures, on the base small-car-electric ({electric.source})"
    assert Vehicle.load(write(tmp_path, FILE)).source == own
    assert Vehicle.load(write(tmp_path, FILE + 'source = "me"\n')).source == "me"
    assert electric.with_values({"body.m": 1000}).source == own
    assert electric.with_parts({"motor": "pm-32kw"}).with_values({"body.m": 1000}).source == own
    again = FILE.replace('"v"', '"w"').replace("small-car-electric", "v.toml")
    write(tmp_path, FILE)
    assert Vehicle.load(write(tmp_path, again, "w")).source == own


def test_a_file_without_end_of_bases_is_refused(tmp_path):
    (tmp_path / "deep").mkdir()
    text = FILE.replace("small-car-electric", "deep/../v.toml")
    assert problems(Vehicle.load, write(tmp_path, text)) == ["base leads back to the vehicle itself"]


@pytest.mark.parametrize("value", ["9" * 400, "0x" + "f" * 5000, "[1]", "{a = 1}", "1979-05-27", '"a\\u0000.toml"', '"\\u001b"', "nan"])
@pytest.mark.parametrize("line", ["[parts]\nmotor = ", "[set]\nbody.m = ", "[derive]\ngearbox.ratios.rule = ", "base = ", "powertrain = "])
def test_whatever_a_value_is_the_answer_is_an_input_error(tmp_path, line, value):
    text = FILE.replace('base = "small-car-electric"\n', "") if line == "base = " else FILE
    found = problems(Vehicle.load, write(tmp_path, text + line + value))
    assert all(text.isprintable() for text in found)


def test_texts_given_in_python_are_cleaned_too():
    assert replace(SERIES, title="a\x1b\n*/", source="\u202eb").title == "a */"
    with pytest.raises(InputError, match="must be letters, digits"):
        replace(SERIES, name="a\nb")


def test_a_vehicle_says_what_was_made_for_others():
    assert all(Vehicle.load(name).notes == () for name in vehicle_names())
    assert SERIES.with_parts({"motor": "pm-32kw"}).notes == (
        "the efficiency map of gearbox single-map is used at ratios that it was not made for: 5.005 in gear 1, made for 6.673",
    )
    assert SERIES.with_values({"gearbox.ratios_1": 6.7}).notes == ()
    car = Vehicle.load("small-car-conventional")
    assert car.with_parts({"engine": "ci-67kw"}).notes == (
        "the shift lines of shift-conventional end at 585 rad/s, engine ci-67kw at 471 rad/s: they were made for another engine",
    )
    assert car.with_parts({"engine": "si-95kw"}).notes == ()
