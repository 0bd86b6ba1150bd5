from dataclasses import dataclass

import numpy as np
import pytest

from halfshaft.cosim.account import account
from halfshaft.cosim.compiled import stepper
from halfshaft.cosim.cycle import Cycle
from halfshaft.cosim.forward import Forward
from halfshaft.library.base.component import Component, From, Signal, State, Unknown, Variable, face, plant
from halfshaft.library.base.errors import InputError, WiringError
from halfshaft.library.base.links import TwoSided, drag, inertia
from halfshaft.library.base.parameters import Parameters, param
from halfshaft.library.base.ports import Electric, Port, Shaft
from halfshaft.library.base.tables import interpolants
from halfshaft.library.engine.engine import Engine
from halfshaft.models.assembly import all_tables, assemble
from halfshaft.models.forward import assemble_plant
from halfshaft.models.model import Model
from halfshaft.models.powertrains import series as series_hybrid
from halfshaft.models.powertrains.electric import electric
from halfshaft.models.vehicle import Vehicle
from halfshaft.models.wiring import Wiring

PARTS = Vehicle.load("small-car-electric").components()


@dataclass(frozen=True, kw_only=True)
class BearingParameters(Parameters):
    """Drag and inertia of an intermediate shaft."""

    tau: float = param("N.m", "drag torque", 0.0, ge=0)
    J: float = param("kg.m^2", "inertia", 0.0, ge=0)


@dataclass(frozen=True)
class Bearing(TwoSided):
    """A component that the package does not know."""

    p: BearingParameters
    parameters = BearingParameters
    output = Port(Shaft, "wheel")
    input = Port(Shaft, "source")

    def chain(self, turning):
        return drag(lambda shaft: self.p.tau * turning(shaft.omega)), inertia(self.p.J)


def electric_with_bearing(bearing):
    """Return the electric car with another part between gearbox and motor: parts and connections, no more."""
    names = list(PARTS)
    at = names.index("motor")
    m = Model("bearing", {n: PARTS[n] for n in names[:at]} | {"bearing": bearing} | {n: PARTS[n] for n in names[at:]})
    p = m.parts
    m.connect(p["body"].tyre, p["wheel"].tyre)
    m.connect(p["wheel"].axle, p["final_drive"].output)
    m.connect(p["final_drive"].input, p["gearbox"].output)
    m.connect(p["gearbox"].input, p["bearing"].output)
    m.connect(p["bearing"].input, p["motor"].shaft)
    m.connect(p["motor"].dc, p["accessories"].load)
    m.connect(p["accessories"].supply, p["bus"].load)
    m.connect(p["bus"].battery, p["battery"].dc)
    return m


def problems(make, *arguments):
    with pytest.raises(WiringError) as e:
        make(*arguments)
    return list(e.value.problems)


def with_extra(component):
    """Return the electric car with one more part, which has no port."""
    return electric.model({**PARTS, "extra": component(BearingParameters())})


@dataclass(frozen=True)
class Extra(Component):
    """Base of parts that hang on signals alone."""

    p: BearingParameters
    parameters = BearingParameters


HEAT = Variable("heat", "W", "heat")


def test_every_misfit_is_named_in_one_error_with_both_ends():
    m = electric.model(PARTS)
    p = m.parts
    m.connect(p["motor"].dc, p["gearbox"].output)
    m.connect(p["motor"].shaft, p["gearbox"].output)
    m.connect(p["bus"].battery, p["battery"].dc)
    assert problems(assemble, m) == [
        "cannot connect motor.dc (Electric) to gearbox.output (Shaft): the kinds differ",
        "cannot connect motor.shaft (Shaft) to gearbox.output (Shaft): both ports look toward the wheel",
        "cannot connect bus.battery (Electric) to battery.dc (Electric): bus.battery (Electric) is connected already",
    ]


def test_misfits_and_unknown_signals_come_together():
    m = electric.model({n: part for n, part in PARTS.items() if n != "shift"})
    m.connect(m.parts["motor"].dc, m.parts["gearbox"].output)
    found = problems(assemble, m)
    assert found[0].endswith("the kinds differ")
    assert any(problem.startswith("gearbox reads the signal ratio, which no part publishes") for problem in found)


def test_ports_that_are_left_open_are_named_but_for_optional_ones():
    m = Model("open", {n: PARTS[n] for n in PARTS})
    p = m.parts
    m.connect(p["body"].tyre, p["wheel"].tyre)
    found = [problem for problem in problems(assemble, m) if problem.endswith("is not connected")]
    assert "wheel.axle (Shaft) is not connected" in found
    assert "battery.dc (Electric) is not connected" in found
    assert not any("bus.generator" in problem or "tyre" in problem for problem in found)


def test_ends_may_be_named_in_either_order():
    m = Model("order", PARTS)
    m.connect(PARTS["wheel"].tyre, PARTS["body"].tyre)
    (c,) = m.connections
    assert (c.load, c.supply) == ("body", "wheel")


def test_a_part_of_another_model_cannot_be_connected():
    m = electric.model(PARTS)
    stranger = Bearing(BearingParameters())
    assert problems(m.connect, stranger.input, m.parts["motor"].shaft) == ["Bearing.input belongs to no part of this model"]


def test_a_signal_that_nobody_publishes_names_the_nearest():
    found = problems(assemble, electric.model({n: part for n, part in PARTS.items() if n != "shift"}))
    assert "gearbox reads the signal ratio, which no part publishes, did you mean 'speed_ratio'?" in found


def two_shifts():
    return electric.model({**PARTS, "second_shift": PARTS["shift"].__class__(PARTS["shift"].p)})


def test_where_several_parts_publish_a_signal_the_powertrain_says_which():
    assert problems(assemble, two_shifts()) == [
        "gearbox reads the signals ratio, gear of its shift, which shift and second_shift publish; "
        'the powertrain must say which: bind("gearbox", shift=...)'
    ]
    m = two_shifts()
    m.bind("gearbox", shift="second_shift")
    assert "motor.tau" in assemble(m).output_index


def test_a_binding_names_parts_and_owners_that_there_are():
    m = two_shifts()
    m.bind("gearbox", shift="motor", shft="shift")
    m.bind("motor", battery="batery")
    found = problems(assemble, m)
    assert found[:2] == [
        "batery is no part of this model, did you mean 'battery'?",
        "gearbox is bound to a shft, of which it reads nothing, did you mean 'shift'?",
    ]
    assert "gearbox reads the signals ratio, gear of its shift from motor, which does not publish ratio, gear" in found
    assert "motor reads the signal U_supply of its battery from batery, which is no such part" in found


def test_a_signal_has_the_unit_that_its_reader_expects():
    class Imperial(Extra):
        variables = (HEAT,)
        reads = (From("body", v="mph"),)

        @face("heat")
        def one(self, v):
            return {"heat": v}

    assert problems(assemble, with_extra(Imperial)) == ["extra reads the signal v in mph, body publishes it in m/s"]


def test_all_parts_that_publish_a_signal_can_be_read_at_once():
    class Sum(Extra):
        variables = (HEAT,)
        reads = (From("all", each=True, U_min="V"), From("none", each=True, omega_launch="rad/s"))

        @face("heat")
        def one(self, U_min, omega_launch):
            return {"heat": sum(U_min) + 100 * len(U_min) + len(omega_launch)}

    class Louder(Extra):
        signals = (Signal("U_min", "V", "another lowest voltage"),)

        @face("U_min")
        def law(self):
            return {"U_min": 7.0}

    step = assemble(electric.model({**PARTS, "second": Louder(BearingParameters()), "extra": Sum(BearingParameters())}))
    parameters = [d.start for d in step.parameters]
    _, outputs = step.function(step.start(parameters), [0, 0, 1, 1, 0], parameters)
    assert float(outputs[step.output_index["extra.heat"]]) == PARTS["motor"].p.U_min + 7 + 200


def test_parts_may_be_listed_in_any_order():
    plain = assemble(electric.model(PARTS))
    turned = assemble(electric.model(dict(reversed(PARTS.items()))))
    assert {d.name for d in turned.outputs} == {d.name for d in plain.outputs}
    one, other = marched(stepper(electric.model(PARTS)))[0], marched(stepper(electric.model(dict(reversed(PARTS.items())))))[0]
    assert all(np.array_equal(one[name], other[name]) for name in one)


@pytest.mark.parametrize("order", [1, -1])
def test_a_shift_logic_looks_at_the_machine_behind_its_gearbox(order):
    # An engine stands on the bus of a series hybrid, and has an envelope too.
    parts = Vehicle.load("small-car-series").components() | {"shift": Vehicle.load("small-car-conventional").components()["shift"]}
    wiring = Wiring(series_hybrid.series.model(dict(list(parts.items())[::order])), parts)
    assert wiring.read["shift"]["machine"] == ("part", "motor", "")


@dataclass(frozen=True)
class Trying(Bearing):
    """A bearing that wants to know what would be, were something else asked behind it."""

    variables = (Variable("tau_tried", "N.m", "what 7 N.m more would ask of the rotor"),)
    reads = (From("drive", along=("input",), tried=True, tau_rotor="N.m"),)

    @face("tau_tried")
    def tries(self, output, drive):
        return {"tau_tried": drive(output._replace(tau=output.tau + 7))["tau_rotor"]}


class TryingAnotherUnit(Trying):
    reads = (From("drive", along=("input",), tried=True, tau_rotor="N"),)


class TryingWhatIsNotBehind(Trying):
    reads = (From("drive", along=("input",), tried=True, gear="1"),)


class TryingWhatMayBeAbsent(Trying):
    reads = (From("drive", along=("input",), tried=True, optional=True, gear="1"),)

    @face("tau_tried")
    def tries(self, output, drive=None):
        return {"tau_tried": output.tau if drive is None else drive(output)["gear"]}


def test_a_part_may_try_what_would_be_asked_behind_it():
    vehicle = electric_with_bearing(Trying(BearingParameters(tau=2.0, J=0.01)))
    step = assemble(vehicle)
    out = {d.name: i for i, d in enumerate(step.outputs)}
    x, p = step.start([q.start for q in step.parameters]), [q.start for q in step.parameters]
    _, y = step.function(x, [1.0, 0.0, 1.0, 1.0, 0.0], p)
    y = np.array(y).ravel()
    # The step itself asks for the bearing's drag and inertia on the way; the trial asks the motor alone, for 7 N.m.
    alpha = y[out["motor.omega_required"]]
    drag = 2.0 + 0.01 * alpha
    motor = PARTS["motor"].p
    expected = y[out["motor.tau_required"]] - drag + 7 + motor.J * alpha
    assert y[out["bearing.tau_tried"]] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        (TryingAnotherUnit, "bearing reads the signal tau_rotor in N, motor publishes it in N.m"),
        (TryingWhatIsNotBehind, "bearing reads the signal gear of its drive, but nothing behind its input publishes it"),
    ],
)
def test_what_is_tried_is_checked_like_what_is_read(kind, said):
    with pytest.raises(WiringError) as refused:
        assemble(electric_with_bearing(kind(BearingParameters())))
    assert said in str(refused.value)


def test_what_is_tried_may_be_absent_behind_a_port():
    assert assemble(electric_with_bearing(TryingWhatMayBeAbsent(BearingParameters())))


def test_unknowns_are_counted_against_balances():
    class Divider(Extra):
        unknowns = (Unknown("tau_share", "N.m", "torque of one branch"),)
        variables = (HEAT,)
        reads = (From("body", v="m/s"),)

        @face("heat")
        def one(self, v):
            return {"heat": v}

        @plant("heat")
        def two(self, tau_share):
            return {"heat": tau_share}

    m = with_extra(Divider)
    assert problems(assemble_plant, m, assemble(m), interpolants(all_tables(m))) == [
        "the forward-facing model has the unknowns body.a, extra.tau_share, but balances of motor: a machine or clutch at the end "
        "of a chain gives one, a part that divides a flow brings one unknown"
    ]


def test_what_a_face_gives_must_be_declared():
    @dataclass(frozen=True)
    class Careless(Component):
        p: BearingParameters
        parameters = BearingParameters

        @face("heat")
        def warm(self, dt):
            return {"heat": dt}

    found = problems(assemble, electric.model({**PARTS, "careless": Careless(BearingParameters())}))
    assert found == ["careless.warm gives heat, which Careless does not declare"]


MEMORY = State("warm", "1", "whether it is warm")


class Reading(Extra):
    variables = (HEAT,)
    reads = (From("body", v="m/s"),)


class GivenTwice(Reading):
    @face("heat")
    def one(self, v):
        return {"heat": v}

    @face("heat")
    def other(self, v):
        return {"heat": 2 * v}


class NeverGiven(Extra):
    variables = (HEAT,)
    signals = (Signal("cold", "1", "whether it is cold"),)


class WithoutNext(Extra):
    states = (MEMORY,)


class Misspelt(Extra):
    variables = (HEAT,)
    reads = (From("shift", optional=True, shiftng="1"),)

    @face("heat")
    def one(self, dt, shiftng=0.0):
        return {"heat": dt * shiftng}


class Undeclared(Extra):
    variables = (HEAT,)
    reads = (From("shift", optional=True, shifting="1"),)

    @face("heat")
    def one(self, dt, shiftng=0.0):
        return {"heat": dt * shiftng}


class WithoutDefault(Extra):
    variables = (HEAT,)
    reads = (From("shift", optional=True, shifting="1"),)

    @face("heat")
    def one(self, shifting):
        return {"heat": shifting}


class Scattered(Extra):
    variables = (HEAT,)
    reads = (From("car", v="m/s", U_supply="V"),)

    @face("heat")
    def one(self, v, U_supply):
        return {"heat": v * U_supply}


class OfNoSuchClass(Extra):
    variables = (HEAT,)
    reads = (From("engine", Engine),)

    @face("heat")
    def one(self, engine):
        return {"heat": engine.omega_max}


class Absent(Reading):
    reads = (*Reading.reads, From("control", optional=True, clutch_slipping="1"))

    @face("heat")
    def one(self, v, clutch_slipping=1.0):
        return {"heat": v * clutch_slipping}


class Shadowing(Reading):
    variables = ()
    states = (State("v", "m/s", "a speed of its own"),)

    @face("next_v")
    def one(self, v):
        return {"next_v": v}


class NamedLikeARequest(Extra):
    states = (State("grade", "1", "a grade of its own"),)

    @face("next_grade")
    def one(self, grade):
        return {"next_grade": grade}


class StartsFromNothing(WithoutNext):
    @face("next_warm")
    def one(self, warm):
        return {"next_warm": warm}

    reads = (From("body", speed_ratio="1"),)

    def start(self, speed_rato):
        return {"warm": speed_rato}


class StartsShort(StartsFromNothing):
    reads = ()

    def start(self):
        return {}


class Burns(Extra):
    variables = (Variable("P_fuel", "W", "fuel", "fuel"),)

    @face("P_fuel")
    def one(self, dt):
        return {"P_fuel": dt}


class Misbooks(Extra):
    variables = (Variable("P_lost", "W", "lost", "lost"),)

    @face("P_lost")
    def one(self, dt):
        return {"P_lost": dt}


class ReturnsLess(Reading):
    @face("heat")
    def one(self, v):
        return {}


class ReturnsMore(Reading):
    @face("heat")
    def one(self, v):
        return {"heat": v, "light": v}


@pytest.mark.parametrize(
    ("component", "found"),
    [
        (GivenTwice, ["extra.one and extra.other both give heat; one of them must"]),
        (NeverGiven, ["extra declares heat, but no face gives heat", "extra declares cold, but no face gives cold"]),
        (WithoutNext, ["extra declares warm, but no face gives next_warm"]),
        (Misspelt, ["extra reads the signal shiftng, which no part publishes, did you mean 'shifting'?"]),
        (Undeclared, ["extra.one takes shiftng, which Undeclared neither has nor reads of another part, did you mean 'shifting'?"]),
        (WithoutDefault, ["extra.one takes shifting, which may be absent; it must have a default"]),
        (Scattered, ["extra reads signals of one car, which no part publishes all: v by body, U_supply by battery"]),
        (OfNoSuchClass, ["extra reads of a engine that is a Engine, but there is none"]),
        (Shadowing, ["extra declares the state v, which it reads of its body; its own would hide it"]),
        (NamedLikeARequest, ["extra declares the state grade, which every part can read as the request or law of that name"]),
        (
            StartsFromNothing,
            ["extra.start reads speed_rato, which is no state and no law of a part that it reads of, did you mean 'speed_ratio'?"],
        ),
        (StartsShort, ["extra.start gives no warm"]),
        (Burns, ["extra books fuel, but nothing of it is tagged fuel mass or fuel density or fuel heating value"]),
        (Misbooks, ["extra books lost, which is no line of the energy account, did you mean 'loss'?"]),
        (ReturnsLess, ["extra.one returns no heat, which it declares to give"]),
        (ReturnsMore, ["extra.one returns light, which it does not declare to give"]),
    ],
)
def test_each_slip_of_a_part_is_named_with_its_place(component, found):
    assert problems(assemble, with_extra(component)) == found


def test_a_signal_of_a_part_that_is_not_there_may_be_absent():
    assert "extra.heat" in assemble(with_extra(Absent)).output_index


def test_slips_of_several_parts_come_in_one_error():
    parts = {**PARTS, "one": GivenTwice(BearingParameters()), "two": WithoutNext(BearingParameters())}
    assert problems(assemble, electric.model(parts)) == [
        "one.one and one.other both give heat; one of them must",
        "two declares warm, but no face gives next_warm",
    ]


def test_a_two_sided_part_has_one_port_a_side():
    class Forked(Bearing):
        other = Port(Shaft, "source", optional=True)

    assert problems(assemble, electric_with_bearing(Forked(BearingParameters()))) == [
        "bearing has input and other toward the source; a Forked is two-sided and has one"
    ]


def test_a_chain_names_parts_and_ports_that_there_are():
    m = Model("open", PARTS)
    m.chain("body", "wheal", "final_drive")
    m.chain("bus.batery", "battery")
    m.chain("bus", "battery.bogus")
    assert m.check()[:4] == [
        "wheal is no part of this model, did you mean 'wheel'?",
        "wheal is no part of this model, did you mean 'wheel'?",
        "bus has no port batery, did you mean 'battery'?",
        "bus has the ports toward the source battery and generator; say which",
    ]
    assert "battery has no port bogus" in m.check()


def test_a_rotor_has_its_inertia_in_the_parameter_J():
    @dataclass(frozen=True, kw_only=True)
    class OtherParameters(Parameters):
        inertia: float = param("kg.m^2", "inertia", 0.1, ge=0)

    @dataclass(frozen=True)
    class Other(Bearing):
        p: OtherParameters
        parameters = OtherParameters

        def chain(self):
            return (inertia(self.p.inertia),)

    with pytest.raises(InputError, match="Other: has an inertia among its links; its parameter must be called J"):
        assemble(electric_with_bearing(Other(OtherParameters())))


def test_no_output_is_named_twice():
    @dataclass(frozen=True)
    class Doubled(Bearing):
        reads = (From("body", v="m/s"),)
        variables = (Variable("omega", "rad/s", "its speed, which the port shows as well"),)

        @face("omega")
        def one(self, v):
            return {"omega": v}

    assert problems(assemble, electric_with_bearing(Doubled(BearingParameters()))) == [
        "bearing.omega is an output twice: a variable or state, and what is shown of a port"
    ]


@dataclass(frozen=True)
class Impatient(Bearing):
    """Wants the voltage of this very step, which depends on its own torque."""

    reads = (From("battery", U="V"),)

    def chain(self, U):
        return (drag(self.p.tau * U),)


def test_a_loop_without_memory_is_refused_by_the_names_of_its_faces():
    (found,) = problems(assemble, electric_with_bearing(Impatient(BearingParameters())))
    head, _, loop = found.rpartition(": ")
    assert head == "undeclared loop, a memory must break it"
    *faces, again = loop.split(" -> ")
    assert faces[0] == again
    # It may be entered anywhere.
    i = faces.index("bearing.required")
    around = ["battery.available", "bus.ask_battery", "bus.required", "accessories.required", "motor.required"]
    assert faces[i:] + faces[:i] == ["bearing.required", *around]


def test_the_same_loop_through_a_memory_is_fine():
    @dataclass(frozen=True)
    class Patient(Bearing):
        reads = (From("battery", U_supply="V"),)

        def chain(self, U_supply):
            return (drag(self.p.tau * U_supply),)

    step = assemble(electric_with_bearing(Patient(BearingParameters())))
    assert "bearing.P_loss" in step.output_index


SHORT = Cycle(name="short", time=np.array([0.0, 20.0, 30.0, 45.0]), speed=np.array([0.0, 15.0, 15.0, 0.0]))


def marched(made, dt=1.0):
    samples = SHORT.sampled(dt)
    parameters = np.array([d.start for d in made.step.parameters])
    march = made.march(samples, parameters)
    names = [d.name for d in made.step.outputs]
    return {n: march.history[:, i] for i, n in enumerate(names)}, dict(zip(names, march.sums, strict=True)), samples


def test_a_new_part_without_drag_changes_nothing_in_the_step():
    plain, *_ = marched(stepper(electric.model(PARTS)))
    free, *_ = marched(stepper(electric_with_bearing(Bearing(BearingParameters()))))
    # The operations are the same but for the zeros that the new part adds.
    for name, series in plain.items():
        np.testing.assert_allclose(free[name], series, rtol=1e-12, atol=1e-12, err_msg=name)


def test_a_new_part_drags_in_the_step_and_its_energy_is_booked():
    made = stepper(electric_with_bearing(Bearing(BearingParameters(tau=2.0, J=0.05))))
    series, energies, samples = marched(made)
    assert np.all(np.abs(series["body.v"] - samples.v) < 1e-9)
    np.testing.assert_allclose(series["bearing.P_loss"], 2.0 * series["motor.omega"], rtol=1e-12)
    # Every rotor has the acceleration of the vehicle at the slip of the step.
    turns = PARTS["final_drive"].p.i * PARTS["gearbox"].p.ratios[0] / PARTS["wheel"].p.r
    alpha = np.diff(series["wheel.v_limited"], prepend=0.0) * (1 + series["wheel.slip"]) * turns
    tau_gearbox = series["bearing.tau"]
    np.testing.assert_allclose(series["motor.tau"], tau_gearbox + 2.0 * (series["motor.omega"] > 0) + 0.05 * alpha, atol=1e-9)
    # Sum of some hundred terms; the design asks for 1e-9.
    assert abs(account(made.step.outputs, energies).balance_relative) < 1e-12


def test_a_new_part_works_in_the_forward_facing_plant():
    made = Forward(electric_with_bearing(Bearing(BearingParameters(tau=2.0, J=0.05))))
    samples = SHORT.sampled(made.driver.dt)
    done = made.run(samples, np.array([d.start for d in made.stepper.step.parameters]))
    names = [d.name for d in made.plant.shown]
    series = {n: done.history[:, i] for i, n in enumerate(names)}
    moving = series["motor.omega"] > 1
    np.testing.assert_allclose(series["bearing.P_loss"][moving], 2.0 * series["motor.omega"][moving], rtol=1e-12)
    booked = account(made.plant.powers, done.energies)
    # The tolerance of the integrator is 1e-8; a few hundred starts of it add up.
    assert abs(booked.balance_relative) < 1e-6
    # The step asks for the same energy but for its discretisation.
    _, energies, _ = marched(made.stepper, dt=0.1)
    assert done.energies["battery.P_stored"] == pytest.approx(energies["battery.P_stored"], rel=0.01)
    assert done.energies["bearing.P_loss"] == pytest.approx(energies["bearing.P_loss"], rel=0.01)


def test_a_new_source_can_stand_in_for_the_battery():
    @dataclass(frozen=True)
    class Wire(Component):
        """An overhead line: gives whatever is asked for."""

        p: BearingParameters
        parameters = BearingParameters
        dc = Port(Electric, "wheel")
        variables = (Variable("P_stored", "W", "power from the line", "stored"), Variable("U_supply", "V", "voltage", signal=True))

        @face("U_supply")
        def voltage(self):
            return {"U_supply": 600.0}

        @face("dc", "P_stored")
        def available(self, dc):
            return {"dc": dc, "P_stored": dc.P}

    made = stepper(electric.model({**PARTS, "battery": Wire(BearingParameters())}))
    series, energies, samples = marched(made)
    assert np.all(np.abs(series["body.v"] - samples.v) < 1e-9)
    assert abs(account(made.step.outputs, energies).balance_relative) < 1e-12


@dataclass(frozen=True)
class Misspelt(Extra):
    """A part that tags a variable and a state with words that are none."""

    states = (State("soc", "1", "charge", shown=True, tag="chrage"),)
    variables = (Variable("gear", "1", "gear", tag="geer"),)

    @face("gear", "next_soc")
    def run(self, soc):
        return {"gear": 1.0, "next_soc": soc}


def test_an_unknown_tag_is_named_with_the_nearest():
    assert problems(assemble, with_extra(Misspelt)) == [
        "extra.soc has the tag 'chrage', which is not known, did you mean 'charge'?",
        "extra.gear has the tag 'geer', which is not known, did you mean 'gear'?",
    ]
