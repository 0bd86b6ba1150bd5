"""Steps whose controls obey commands in place of their own law."""

import casadi as ca
import numpy as np
import pytest

from halfshaft.cosim.cycle import Cycle
from halfshaft.cosim.simulate import parameters_of, run
from halfshaft.models.assembly import REQUESTED, assemble
from halfshaft.models.vehicle import Vehicle

CYCLE = Cycle.load("udds").between(160, 260)


def driven(vehicle, free, commands):
    """Return outputs by name of a run in which the parts `free` obey commands by name."""
    step = assemble(vehicle.model(), free=free)
    samples = CYCLE.sampled(1.0)
    p = parameters_of(vehicle, step, samples.v_start)
    given = [np.broadcast_to(commands[name], len(samples.t)) for name in step.commands]
    u = np.vstack([samples.v, samples.grade, samples.key_on, samples.dt, 0 * samples.t, *given])
    run_all = step.function.mapaccum(len(samples.t))
    _, y = run_all(step.start(p), u, ca.repmat(ca.DM(p), 1, len(samples.t)))
    return dict(zip(step.output_index, np.array(y), strict=True))


def test_a_control_that_is_told_what_it_decides_itself_does_the_same():
    vehicle = Vehicle.load("small-car-fuel-cell")
    law = run(vehicle, CYCLE)
    largest = vehicle.components()["fuel_cell"].P_largest
    commands = {"control.run": law["control.converter_on"], "control.share": law["control.P_converter"] / largest}
    assert 0 < law["control.converter_on"].mean() < 1 or np.ptp(commands["control.share"]) > 0
    told = driven(vehicle, {"control"}, commands)
    for name in ("fuel_cell.P_fuel", "battery.soc", "body.v"):
        assert told[name] == pytest.approx(law[name], rel=1e-9, abs=1e-12)


def test_gears_can_be_commanded_alone():
    vehicle = Vehicle.load("small-car-parallel")
    law = run(vehicle, CYCLE)
    gears = law["shift.gear"]
    assert np.ptp(gears) >= 2
    told = driven(vehicle, {"shift"}, {"shift.change": np.diff(gears, prepend=1)})
    for name in ("shift.gear", "engine.P_fuel", "battery.soc"):
        assert told[name] == pytest.approx(law[name], rel=1e-9, abs=1e-12)


def test_commands_are_requests_behind_all_others():
    model = Vehicle.load("small-car-parallel").model()
    assert model.commandable == ("shift", "control")
    step = assemble(model, free=model.commandable)
    assert [d.name for d in step.requests] == [*(d.name for d in REQUESTED), "shift.change", "control.run", "control.share"]
    assert (step.commands["control.share"].lowest, step.commands["control.share"].highest) == (0, 2)
    assert assemble(model).requests == REQUESTED


@pytest.mark.parametrize("name", ["series", "fuel-cell", "parallel", "parallel-balanced", "parallel-post", "mild-hybrid", "power-split"])
def test_every_hybrid_stops_its_source_on_command(name):
    vehicle = Vehicle.load(f"small-car-{name}")
    step = assemble(vehicle.model(), free=vehicle.model().commandable)
    needs = {c.needs for c in step.commands.values()} - {""}
    assert needs == {"run"}
    for command in step.commands.values():
        states = {d.name.partition(".")[2] for d in step.states}
        assert not command.memory or command.memory in states
    (burnt,) = (d.name for d in step.outputs if d.booking == "fuel")
    for on in (0.0, 1.0):
        told = driven(vehicle, vehicle.model().commandable, dict.fromkeys(step.commands, 0.0) | {"control.run": on, "control.share": 0.5})
        assert (told[burnt].sum() > 0) == bool(on)
