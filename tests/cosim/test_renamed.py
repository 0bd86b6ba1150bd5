"""Vehicles whose parts are called otherwise run, and are told of, as those of the library."""

import json
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from typer.testing import CliRunner

from halfshaft.app.cli import app
from halfshaft.cosim.cycle import Cycle
from halfshaft.cosim.facts import energy_rows, facts, in_html
from halfshaft.cosim.plot import plot_run
from halfshaft.cosim.simulate import run
from halfshaft.models.model import Model
from halfshaft.models.powertrain import Derived, Powertrain, powertrains
from halfshaft.models.rules import GensetLocus, SumOfParts, TopSpeed
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.acceleration import accelerate

NAMES = {
    "body": "chassis", "wheel": "tyres", "final_drive": "axle_gear", "gearbox": "box", "shift": "lever", "clutch": "disc",
    "motor": "machine_a", "accessories": "hotel", "bus": "rail", "battery": "pack", "control": "brain", "engine": "ice",
    "generator": "machine_b",
}  # fmt: skip
KINDS = ("electric", "series", "conventional")


def connect_electric(m: Model) -> None:
    m.chain("chassis", "tyres", "axle_gear", "box", "machine_a", "hotel", "rail.battery", "pack")


def connect_series(m: Model) -> None:
    connect_electric(m)
    m.chain("rail.generator", "machine_b", "ice")


def connect_conventional(m: Model) -> None:
    m.chain("chassis", "tyres", "axle_gear", "box", "disc", "hotel", "ice")


MASS = Derived("chassis.m", (SumOfParts,))
RATIO = Derived("box.ratios", (TopSpeed,), {"motor": "machine_a", "wheel": "tyres", "final_drive": "axle_gear"})
LOCUS = Derived("brain.omega_locus", (GensetLocus,), {"engine": "ice", "generator": "machine_b"})
CONNECTED = {
    "electric": (connect_electric, (MASS, RATIO)),
    "series": (connect_series, (MASS, RATIO, LOCUS)),
    "conventional": (connect_conventional, (MASS,)),
}


@pytest.fixture(autouse=True, scope="module")
def other_powertrains():
    with pytest.MonkeyPatch.context() as patch:
        for kind, (connect, derived) in CONNECTED.items():
            roles = {NAMES[role]: kinds for role, kinds in powertrains()[kind].roles.items()}
            patch.setitem(powertrains(), f"other_{kind}", Powertrain(f"other_{kind}", "", roles, connect, derived))
        yield


def renamed(name):
    """Return the other name of what belongs to a part, or of a part."""
    part, dot, own = name.partition(".")
    return NAMES[part] + dot + own


def said(text):
    """Return a text of a run with the parts' other names; words of the language stay."""
    for part in ("motor", "engine"):
        text = re.sub(rf"\b{part} (at its top speed|never ran)", rf"{NAMES[part].replace('_', ' ')} \1", text)
    return re.sub(r"^battery (empty|as )", r"pack \1", text)


def pair(kind, values=(), parts=()):
    """Return a vehicle of the library with numbers and parts set, and the same with other names."""
    car = Vehicle.load(f"small-car-{kind}").with_parts(dict(parts)).with_values(dict(values))
    other = Vehicle(
        name=car.name,
        title=car.title,
        source=car.source,
        powertrain=f"other_{kind}",
        parts={renamed(role): part for role, part in car.parts.items()},
        given={renamed(name): x for name, x in car.given.items()},
        rules={renamed(target): rule for target, rule in car.rules.items()},
    )
    return car, other


#: What makes limits act: an empty pack, a cold one, slippery tyres, a short gear.
HARD = {
    "electric": ({"battery.soc_start": 0.1, "motor.speed_scale": 0.5, "gearbox.ratios_1": 6.673},),
    "series": ({"battery.soc_start": 0.01, "battery.T_start": 250.0, "wheel.mu_max": 0.25}, {"battery": "li-7ah"}),
    "conventional": ({"wheel.mu_max": 0.2, "engine.speed_scale": 0.5},),
}
#: Up a hill, to a stop on it, and on; the forward-facing model takes long.
HILL = Cycle(
    name="hill",
    time=np.array([0.0, 12, 20, 24, 28, 40]),
    speed=np.array([0.0, 12, 12, 0, 0, 14]),
    grade_by_distance=(np.array([0.0, 60, 90]), np.array([0.0, 0.0, 0.05])),
)


@cache
def runs(kind, via="step", hard=False, history=True):
    cycle = HILL if via == "forward" else Cycle.load("us06")
    return tuple(run(car, cycle, via=via, history=history) for car in pair(kind, *(HARD[kind] if hard else ())))


def compare(one, other):
    assert [renamed(d.name) for d in one.outputs] == [d.name for d in other.outputs]
    np.testing.assert_array_equal(one.history, other.history)
    assert {renamed(name): x for name, x in one.energies.items()} == other.energies
    assert {name if name == "time" else renamed(name): x for name, x in one.first.items()} == other.first
    assert one.figures == other.figures
    assert [said(text) for text in one.warnings] == list(other.warnings)
    assert facts(one) == facts(other)
    assert repr(one) == repr(other)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("via", ["step", "fmu3", "forward"])
def test_other_names_change_nothing(kind, via):
    compare(*runs(kind, via))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("history", [True, False])
def test_limits_are_told_as_ever(kind, history):
    one, other = runs(kind, hard=True, history=history)
    assert len(one.warnings) > 2
    compare(one, other)


def test_the_hard_runs_meet_every_warning():
    warnings = " ".join(text for kind in KINDS for text in runs(kind, hard=True)[1].warnings)
    for text in (
        "trace missed by", "grip limit reached, driving", "battery limit reached, empty: ", "not given", "pack as cold as",
        "machine a at its top speed: ", "ice at its top speed: ", "pack empty",
    ):  # fmt: skip
        assert text in warnings


@pytest.mark.parametrize("kind", KINDS)
def test_the_account_the_audit_and_the_table_are_the_same(kind):
    one, other = runs(kind)
    assert one.audit.failures == other.audit.failures == ()
    shown = {renamed(role).replace("_", " "): role.replace("_", " ") for role in pair(kind)[0].parts}
    assert energy_rows(one.account) == [row._replace(name=shown.get(row.name, row.name)) for row in energy_rows(other.account)]
    assert energy_rows(other.account)[0].name == ("pack" if kind == "electric" else "ice")
    assert in_html(one) == in_html(other)


@pytest.mark.parametrize("kind", KINDS)
def test_acceleration_takes_as_long(kind):
    one, other = (accelerate(car) for car in pair(kind))
    assert (one.time, one.time_hybrid) == (other.time, other.time_hybrid)
    assert repr(one) == repr(other)


@pytest.mark.parametrize("kind", KINDS)
def test_pictures_have_the_same_panels_and_lines(kind):
    def panels(result):
        return [(ax.get_ylabel(), len(ax.lines), len(ax.patches), len(ax.collections)) for ax in plot_run(result).axes]

    one, other = runs(kind)
    assert panels(one) == panels(other)
    assert len(panels(other)) >= 4


def test_a_note_on_maps_finds_the_gearbox_in_any_role():
    one, other = pair("electric", {"gearbox.ratios_1": 5.0})
    assert one.notes == other.notes != ()


def test_the_command_line_sets_mass_and_charge(tmp_path):
    for car in pair("electric"):
        path = car.save(tmp_path / f"{car.powertrain}.toml")
        done = CliRunner().invoke(app, ["run", str(path), "--cycle", "us06", "--mass", "1500", "--soc", "0.5", "--json"])
        assert done.exit_code == 0, done.output
        found = json.loads(done.stdout)
        assert found["soc_start"] == 0.5
        assert found["vehicle"] == car.powertrain
        body, battery = ("body", "battery") if car.powertrain == "electric" else ("chassis", "pack")
        expected = run(car.with_values({f"{body}.m": 1500, f"{battery}.soc_start": 0.5}), Cycle.load("us06"))
        assert found["motor_input_J"] == expected.summary["motor_input_J"]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("via", ["step", "forward"])
def test_the_order_of_the_parts_changes_nothing(kind, via, monkeypatch):
    usual = powertrains()[kind]
    backward = replace(usual, name="backward", roles=dict(reversed(usual.roles.items())))
    monkeypatch.setitem(powertrains(), "backward", backward)
    car = pair(kind)[0]
    one, other = (run(c, HILL, via=via) for c in (car, replace(car, powertrain="backward", parts=dict(reversed(car.parts.items())))))
    assert not other.outputs[0].name.startswith("body.")
    # Sums may be rounded otherwise, and IDAS weighs errors of a state by its place.
    rel, absolute = (1e-12, 1e-9) if via == "step" else (1e-4, 1e-2)
    for name, x in one.figures.items():
        if not name.endswith("_relative"):
            assert other.figures[name] == (x if x is None or isinstance(x, str) else pytest.approx(x, rel=rel, abs=absolute)), name
    assert abs(other.account.balance_relative) < (1e-9 if via == "step" else 1e-6)
