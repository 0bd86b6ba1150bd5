"""The contract of every two-sided component, on the data of the library.

A case is one component with numbers and the signals of one situation.  `x` is what is free (a load point, and states where
there are any), `share` the part of the source's offer that comes back; all else are expressions of these.
"""

import inspect
from functools import cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import pytest

from halfshaft.library.base.links import TwoSided, continuous
from halfshaft.library.base.ports import Electric, Shaft, Tyre
from halfshaft.library.driveline.clutch import Clutch
from halfshaft.library.driveline.torque_converter import TorqueConverter
from halfshaft.library.electric.battery import Battery
from halfshaft.library.electric.motor import OMEGA_OFF
from halfshaft.library.electric.store import SOC_EMPTY
from halfshaft.library.electric.ultracapacitor import Ultracapacitor
from halfshaft.library.files.catalog import component_kinds
from halfshaft.library.files.component_file import component_names, read_component
from halfshaft.models.assembly import StepDirection, step_turning
from halfshaft.models.forward import PlantDirection, plant_turning

N = 200
DT = 0.7
TWO_SIDED = [kind for kind, component in component_kinds().items() if issubclass(component, TwoSided)]

share = ca.SX.sym("share")


class Case(NamedTuple):
    """Expressions of `x`; `inside` are points within the limits, `edges` where derivatives are at risk."""

    x: ca.SX
    asked: Any
    sent: Any
    delivered: Any
    plant: Any
    smooth: Any
    losses: ca.SX
    P_in: ca.SX
    P_out: ca.SX
    stored: ca.SX
    inside: np.ndarray
    edges: np.ndarray

    def at(self, what, points, offered=1.0):
        """Return an expression at points, one a column."""
        return ca.Function("f", [self.x, share], [ca.densify(ca.vertcat(*what))])(points.T, offered).full()


def offer(point):
    return point._replace(**{point._fields[0]: point[0] * share})


def random(seed):
    return np.random.default_rng(seed)


def loads(tau, omega, alpha):
    return np.column_stack(np.broadcast_arrays(tau, omega, alpha))


def component(name, **values):
    return read_component(name).component(read_component(name).build(**values)) if values else _component(name)


@cache
def _component(name):
    file = read_component(name)
    return file.component(file.parameters)


def chain_case(part, signals, inside, edges):
    """Return the case of a chain of links."""
    load, source = part.sides()
    x = ca.vertcat(*(ca.SX.sym(f) for f in load.kind._fields))
    point = load.kind(*ca.vertsplit(x))
    faces = {f.name: f for f in part.faces()}
    needed = {n: signals[n] for n in faces["required"].takes if n in signals}
    way = faces["required"].run(**{load.name: point}, **needed)
    sent = way[source.name]
    back = faces["available"].run(**{source.name: offer(sent), "_way": way["_way"], "dt": DT})
    turns = part.turns()

    def plant(**laws):
        known = {**signals, **laws, load.name: point}
        (flow,) = (f for f in part.plant_faces() if source.name in f.gives)
        if isinstance(part, Clutch | TorqueConverter):
            # Its plant face is a friction pair; the chain stands for itself.
            return continuous(part.chain(**needed), point)[0]
        return flow.run(**{n: known[n] for n in flow.takes if n in known})[source.name]

    return Case(
        x, point, sent, back[load.name], plant(), plant(turning=plant_turning, direction=PlantDirection()), ca.SX(back["P_loss"]),
        offer(sent).P, back[load.name].P, back["P_kinetic"] + back["P_discretisation"] if turns else ca.SX(0), inside, edges,
    )  # fmt: skip


def step_signals(**more):
    return {"turning": step_turning, "direction": StepDirection(), "shifting": 0.0, **more}


def motor_case(part, seed):
    rng = random(seed)
    p, top = part.p, part.p.omega_max * part.p.speed_scale
    omega = np.append(rng.uniform(0.01, 1, N - 2) * top, [top, 2 * OMEGA_OFF])
    alpha = rng.uniform(-60, 60, N)
    limits = np.array([[float(t) for t in part.limits(w)] for w in omega])
    # Both quadrants, up to the very envelope.
    part_of_limit = np.append(rng.uniform(0, 1, N - 2), [1, 1])
    tau = np.where(rng.random(N) < 0.5, limits[:, 0], limits[:, 1]) * part_of_limit
    signals = step_signals(trace_missed=0.0, speed_ratio=0.0, omega_before=0.0, U_supply=1e6)
    standing, over, idle = loads([0, 100, -100], 0.0, [0, 10, -10]), loads([1e3, -1e3, 0], 1.2 * top, 5.0), loads(0.0, omega[:5], 0.0)
    edges = np.vstack([standing, loads(limits[:5].ravel(), np.repeat(omega[:5], 2), 0.0), over, idle])
    return chain_case(part, signals, loads(tau - p.J * alpha, omega, alpha), edges)


def motor_generator_case(part, seed):
    rng = random(seed)
    top = part.omega_max
    omega = np.append(rng.uniform(0.01, 1, N - 2) * top, [top, 2 * OMEGA_OFF]) * rng.choice([-1, 1], N)
    alpha = rng.uniform(-60, 60, N)
    limits = np.array([[float(t) for t in part.limits(abs(w))] for w in omega])
    part_of_limit = np.append(rng.uniform(0, 1, N - 2), [1, 1])
    # All four quadrants; backward the limits are those of the mirror image.
    tau = np.sign(omega) * np.where(rng.random(N) < 0.5, limits[:, 0], limits[:, 1]) * part_of_limit
    edges = np.vstack([loads([0, 10, -10], 0.0, [0, 10, -10]), loads([1e3, -1e3, 0], [1.2 * top, -1.2 * top, -top], 5.0)])
    signals = {"turning": step_turning, "U_supply": 1e6}
    return chain_case(part, signals, loads(tau - part.p.J * alpha, omega, alpha), edges)


def gearbox_case(part, gear, seed):
    rng = random(seed)
    ratio = part.p.ratios[gear - 1]
    # The highest input speed of any engine or motor of the library is about 1000 rad/s.
    omega = np.append(rng.uniform(0, 1000, N - 20) / ratio, np.zeros(20))
    tau = rng.uniform(-300, 300, N) * ratio
    edges = loads([0, 0, 0, 1, -1, 500, -500], [0, 1, 50, 0, 0, 400, 400], 0.0)
    return chain_case(part, step_signals(ratio=ratio, gear=float(gear)), loads(tau, omega, rng.uniform(-50, 50, N)), edges)


def final_drive_case(part, seed):
    rng = random(seed)
    omega = np.append(rng.uniform(0, 150, N - 20), np.zeros(20))
    inside = loads(rng.uniform(-3e3, 3e3, N), omega, rng.uniform(-20, 20, N))
    return chain_case(part, step_signals(), inside, loads([0, 1, -1], 0, [0, 1, -1]))


def clutch_case(part, slipping):
    rng, engine = random(3), component("si-41kw")
    launch = 0.2 * engine.omega_max
    lowest, highest = (0, launch) if slipping else (0, engine.omega_max)
    tau = rng.uniform(0 if slipping else -1, 1, N) * engine.tau_largest
    signals = {"clutch_open": 0.0, "clutch_slipping": float(slipping), "omega_launch": launch, "engine": engine}
    edges = loads([0, engine.tau_largest, -engine.tau_largest, 1e4], [0, 0, launch, launch], 0.0)
    return chain_case(part, signals, loads(tau, rng.uniform(lowest, highest, N), rng.uniform(-50, 50, N)), edges)


def converter_case(part, geared, seed):
    rng, engine, own = random(seed), component("si-41kw"), 250.0
    signals = {
        "geared": float(geared), "clutch_open": 0.0, "engine": engine, "omega_own": own, "omega_idle": 80.0, "dt": DT, "trace_missed": 0.0,
        "speed_ratio": 0.0, "omega_before": 0.0, "ratio": 3.0, "tau_accessory_before": 2.0,
    }  # fmt: skip
    # Stall, drive, equal speeds and overrun, between what the engine gives with closed and with full throttle.
    omega = np.append(rng.uniform(0, 400, N - 20), np.zeros(20))
    tau = rng.uniform(-100, 150, N)
    if not geared:
        ends = [[float(part.within(tau, w, engine, own, 80.0, 2.0, DT)[0]) for tau in (-1e4, 1e4)] for w in omega]
        tau = np.array([low + (high - low) * share for (low, high), share in zip(ends, rng.uniform(1e-3, 1 - 1e-3, N), strict=True)])
        # Below idling speed the pump would turn too slowly.
        kept = np.array([float(part.omega_pump(t, w)) for t, w in zip(tau, omega, strict=True)]) > 80.0
        tau, omega = tau[kept], omega[kept]
        assert len(tau) > 0.8 * N
    edges = loads([0, 0, 50, -50, 1e4, -1e4], [0, 250, 0, 250, 0, 400], 0.0)
    return chain_case(part, signals, loads(tau, omega, rng.uniform(-50, 50, len(tau))), edges)


def cvt_case(part, ratio, seed):
    rng = random(seed)
    omega = np.append(rng.uniform(0, 600, N - 20) / ratio, np.zeros(20))
    inside = loads(rng.uniform(-130, 100, N) * ratio, omega, rng.uniform(-50, 50, N))
    return chain_case(part, step_signals(ratio=ratio), inside, loads([0, 0, 1, -1, 500, -500], [0, 50, 0, 0, 100, 100], 0.0))


def axle_case(part):
    rng = random(10)
    inside = loads(rng.uniform(-3e3, 3e3, N), rng.uniform(0, 150, N), rng.uniform(-20, 20, N))
    return chain_case(part, step_signals(), inside, loads([0, 1], 0, 0))


def drive(ratio, tau_max):
    """Return what stands behind an axle: a gear without losses, and a motor of one torque."""

    def tried(asked):
        return {"tau_rotor": asked.tau / ratio, "tau_limited": ca.fmin(ca.fmax(asked.tau / ratio, -tau_max), tau_max)}

    return tried


def divider_case(part, share, **drives):
    x = ca.SX.sym("x", 3)
    rng = random(11)
    inside = loads(rng.uniform(-3e3, 3e3, N), rng.uniform(0, 150, N), rng.uniform(-20, 20, N))
    signals = {"share_front": share, **{f"tau_{axle}_{way}": 2e3 for axle in ("front", "rear") for way in ("out", "in")}, **drives}
    return junction_case(part, x, Shaft(*ca.vertsplit(x)), {}, signals, inside, loads([0, 1], 0, 0))


def mechanical_case(part, engine_on):
    rng = random(4)
    signals = {"omega_engine": 200.0, "omega_idle": 80.0, "engine_on": engine_on}
    inside = loads(rng.uniform(-100, 100, N), 200.0, rng.uniform(-50, 50, N))
    return chain_case(part, signals, inside, loads([0, 1], 0, 0))


def electric_case(part, key_on):
    P = random(5).uniform(-5e4, 8e4, N)
    P[:4] = [0, -1, -700, 700]
    return chain_case(part, {"key_on": key_on}, P[:, None], np.array([[0.0], [-700.0], [-350.0]]))


def body_and_road(name, wheel, **values):
    body = component(name, **values)
    x = ca.SX.sym("x", 3)  # speed at the start, acceleration, grade
    v, a, grade = ca.vertsplit(x)
    asked = body.required(v + a * DT, v, grade, DT, wheel, step_turning)
    plant = body.motion(v + a * DT / 2, a, grade, wheel, step_turning)["tyre"]
    smooth = body.motion(v + a * DT / 2, a, grade, wheel, plant_turning)["tyre"]
    return body, x, asked, plant, smooth


def trips(seed):
    rng = random(seed)
    v = np.append(rng.uniform(0, 40, N - 30), np.zeros(30))
    v_end = np.maximum(v + rng.uniform(-4, 2.5, N) * DT, 0)
    v_end[-10:] = 0
    return np.column_stack([v, (v_end - v) / DT, rng.uniform(-0.1, 0.1, N)])


#: Standstill, also on a hill; the very stop; far beyond the grip; the first moment.
TRIP_EDGES = np.array([[0, 0, 0], [0, 0, 0.1], [0, 0, -0.1], [10, -10 / DT, 0], [0, 30, 0], [30, -30, 0], [0, 1, 0], [1e-9, 0, 0]])


def body_case(name, seed, **values):
    wheel = component("small-car-wheels")
    body, x, asked, plant, smooth = body_and_road(name, wheel, **values)
    v, a, grade = ca.vertsplit(x)
    tyre = asked["tyre"]
    back = body.available(offer(tyre), tyre.v, v, 0, 0, v + a * DT, grade, DT, step_turning, asked["_resistance"], asked["_asked"])
    end = back["next_v"]
    stored = back["P_kinetic"] + back["P_climb"] + back["P_mismatch"] + back["P_limit"]
    losses = ca.vertcat(back["P_aero"], back["P_roll"])
    delivered = Tyre(tyre.F, (v + end) / 2, (end - v) / DT)
    return Case(x, tyre, tyre, delivered, plant, smooth, losses, offer(tyre).P, ca.SX(0), stored, trips(seed), TRIP_EDGES)


def wheel_case(name, body_name, seed, **values):
    wheel = component(name, **values)
    body, x, asked, _, _ = body_and_road(body_name, wheel)
    v, a, grade = ca.vertsplit(x)
    tyre = asked["tyre"]

    def required(v_before):
        return wheel.required(tyre, v, grade, DT, body, v_before, step_turning)

    # The plant's wheels turn with the vehicle; so do these when they did one step earlier.
    way = required(required(0.0)["v_limited"] - DT * a)
    split = wheel.split(tyre.F, tyre.v)
    driven, other = split.axle - split.driveline, tyre.F - split.axle
    front, rear = (driven, other) if wheel.p.front_driven else (other, driven)
    back = wheel.available(offer(way["axle"]), DT, way["_asked"], way["_grip"], way["_split"], way["_way"])
    losses = ca.vertcat(back["P_brake"], back["P_slip"], back["P_bearing"])

    def plant(turning):
        return wheel.flow(tyre, front, rear, grade, body, turning)["axle"]

    # Tyres that hold less than their brakes take, which the step finds on its way back.
    loads = body.loads(a, grade)
    braked = sum(F < -wheel.p.mu_max * load for F, load in zip((front, rear), loads, strict=True))
    limited = ca.Function("limited", [x], [way["slip_limited"] + (way["v_limited"] != tyre.v) + braked])
    points = trips(seed)
    inside = points[limited(points.T).full().ravel() == 0]
    assert len(inside) > 0.6 * N
    return Case(
        x, tyre, way["axle"], back["tyre"], plant(step_turning), plant(plant_turning), losses, offer(way["axle"]).P, back["tyre"].P,
        back["P_kinetic"] + back["P_discretisation"], inside, TRIP_EDGES,
    )  # fmt: skip


def bus_case(part, generator):
    x = ca.SX.sym("P")
    return junction_case(
        part, x, Electric(x), {"generator": Electric(generator)}, {}, random(6).uniform(-5e4, 8e4, (N, 1)), np.zeros((1, 1))
    )


def planetary_case(part, seed):
    """Return the case of a planetary gear whose engine gives what it is asked for; the load and the engine's point are free."""
    x = ca.SX.sym("x", 6)  # torque, speed and acceleration of the ring, then of the carrier
    ring, carrier = Shaft(*ca.vertsplit(x[:3])), Shaft(*ca.vertsplit(x[3:]))
    rng = random(seed)
    free = [rng.uniform(-300, 300, N), rng.uniform(0, 600, N), rng.uniform(-60, 60, N)]
    free += [rng.uniform(-40, 100, N), rng.uniform(0, 420, N), rng.uniform(-200, 200, N)]
    able = part.sun_of(ring, carrier).tau
    signals = {"trace_missed": 0.0, "omega_reached": 0.0, "alpha_reached": 0.0, "tau_able": able}
    return junction_case(part, x, ring, {"carrier": carrier}, signals, np.column_stack(free), np.zeros((1, 6)))


def node_case(part, seed):
    """Return the case of a node of two loads."""
    x = ca.SX.sym("P", 2)
    both = dict(zip(("load", "other"), map(Electric, ca.vertsplit(x)), strict=True))
    way = part.required(**both)
    back = part.available(offer(way["supply"]), way["_asked"])
    plant, delivered = part.flow(**both)["supply"], [back[port].P for port in both]
    points = random(seed).uniform(-5e4, 8e4, (N, 2))
    return Case(
        x, [P.P for P in both.values()], way["supply"], delivered, plant, plant, ca.SX(0), offer(way["supply"]).P, sum(delivered), ca.SX(0),
        points, np.array([[0.0, 0.0], [-1.0, 1.0]]),
    )  # fmt: skip


def coupler_case(part, seed, **signals):
    rng = random(seed)
    x = ca.vertcat(*(ca.SX.sym(f) for f in Shaft._fields))
    inside = loads(rng.uniform(-200, 200, N), np.append(rng.uniform(0, 600, N - 20), np.zeros(20)), rng.uniform(-50, 50, N))
    return junction_case(part, x, Shaft(*ca.vertsplit(x)), {}, step_signals(**signals), inside, loads([0, 1, -1], 0, [0, 1, -1]))


def junction_case(part, x, load, offering, signals, inside, edges):
    """Return the case of a junction: all its sources give the same share of what they are asked for."""
    name, faces = part.load_port().name, {f.name: f for f in part.faces()}

    def run(face, **known):
        return face.run(**{n: known[n] for n in face.takes if n in known})

    known = {name: load, "dt": DT, **offering, **signals, **{f"_sent_{port}": point for port, point in offering.items()}}
    known |= run(faces["required"], **known)
    if "divide" in faces:
        known |= run(faces["divide"], **known)
    sent = {}
    for port in (port.name for port in part.asked_ports() if port.name not in offering):
        known |= run(faces[f"ask_{port}"], **known)
        sent[port] = known[port]
        known[port] = offer(sent[port])
    back = run(faces["available"], **known)

    def plant(**laws):
        divided = {f"{port.kind._fields[0]}_{port.name}": known[port.name][0] for port in part.free_ports() if port.name in sent}
        (flow,) = (f for f in part.plant_faces() if f.name == "flow")
        points = run(flow, **{name: load, **offering, **signals, **divided, **laws})
        return [value for port in sent for value in points[port]]

    P_in = sum(offer(point).P for point in sent.values()) + sum(point.P for point in offering.values())
    stored = sum(back.get(f"P_{book}", 0) for book in ("kinetic", "discretisation", "mismatch"))
    return Case(
        x, load, [value for point in sent.values() for value in point], back[name], plant(), plant(turning=plant_turning),
        ca.SX(back["P_loss"]), P_in, back[name].P, ca.SX(stored), inside, edges,
    )  # fmt: skip


def filled(part, soc, T):
    """Return the states of a store that hold a charge, at rest."""
    if isinstance(part, Battery):
        return {"charge_drawn": (1 - soc) * part.capacity(T)}
    if isinstance(part, Ultracapacitor):
        return {"v": ca.fmax(soc, SOC_EMPTY) * part.p.u_max}
    return dict.fromkeys(("v_bulk", "v_surface"), part.p.u_oc(T, soc))


def store_case(name, seed, **values):
    part, U_min = component(name, **values), (component("pm-32kw").p.U_min,)
    x = ca.SX.sym("x", 3)  # power, state of charge, temperature
    P, soc, T = ca.vertsplit(x)
    states = {**filled(part, soc, T), "T": T}

    def called(method, **known):
        known |= {"dc": Electric(P), "U_min": U_min, "dt": DT, **states}
        return method(**{n: known[n] for n in inspect.signature(method).parameters})

    source = part.source(**states)
    limits = part.limits_at(source, U_min)
    given = called(part.available, _limits=limits, _source=source)
    given |= called(part.store, _source=source, U=given["U"], I=given["I"])
    flow = called(part.flow, _source=source)
    flow |= called(part.drain, _source=source, _U=flow["_U"], I=flow["I"])
    ends = ca.vertcat(given["I"], given["U"], *((given[f"next_{n}"] - x) / DT for n, x in states.items()))
    rates = ca.vertcat(flow["I"], flow["U"], *(flow[f"der_{n}"] for n in states))
    rng = random(seed)
    soc_T = np.column_stack([rng.uniform(0.01, 0.99, N), rng.uniform(263, 323, N)])
    lowest, highest = ca.Function("limits", [soc, T], [limits.P_min, limits.P_max])(soc_T[:, :1].T, soc_T[:, 1:].T)
    lowest, highest = lowest.full().ravel(), highest.full().ravel()
    power = lowest + (highest - lowest) * rng.uniform(0.001, 0.999, N)
    power[:3] = 0
    at_limits = [np.column_stack([k * P[:5], soc_T[:5]]) for P in (lowest, highest) for k in (1, 2)]
    edges = np.vstack([*at_limits, [[1e3, 0.0, 293.15], [-1e3, 1.0, 293.15], [0, 0.5, 293.15]]])
    inside = np.column_stack([power, soc_T])
    P_loss, P_in, P_out = ca.SX(given["P_loss"]), given["P_stored"], given["dc"].P
    stored = ca.SX(given.get("P_discretisation", 0))
    return Case(x, (P,), (ends,), (P_out,), (rates,), (rates,), P_loss, P_in, P_out, stored, inside, edges)


SCALED_MOTOR = {"speed_scale": 0.8, "torque_scale": 1.3, "efficiency_scale": 0.95}


def two_sided_cases(kind):
    """Yield cases of all components of a two-sided kind, by name."""
    for seed, name in enumerate(component_names(kind)):
        if kind in ("motor", "motor-thermal"):
            yield name, lambda n=name, s=seed: motor_case(component(n), s)
        elif kind == "motor-generator":
            yield name, lambda n=name, s=seed: motor_generator_case(component(n), s)
        elif kind.startswith("gearbox"):
            for gear in {1, len(component(name).p.ratios)}:
                yield f"{name}-{gear}", lambda n=name, g=gear, s=seed: gearbox_case(component(n), g, s)
        elif kind == "final-drive":
            yield name, lambda n=name, s=seed: final_drive_case(component(n), s)
        elif kind == "clutch":
            for slipping in (0, 1):
                yield f"{name}-{'slipping' if slipping else 'engaged'}", lambda n=name, s=slipping: clutch_case(component(n), s)
        elif kind == "torque-converter":
            for locked in (0, 1):
                yield f"{name}-{'locked' if locked else 'open'}", lambda n=name, k=locked, s=seed: converter_case(component(n), k, s)
        elif kind == "cvt":
            for ratio in (component(name).p.ratios[0], 6.0):
                yield f"{name}-{ratio:g}", lambda n=name, r=ratio, s=seed: cvt_case(component(n), r, s)
        elif kind == "axle":
            yield name, lambda n=name: axle_case(component(n))
        elif kind == "mechanical-accessories":
            for on in (0.0, 1.0):
                yield f"{name}-{on:g}", lambda n=name, on=on: mechanical_case(component(n), on)
        elif kind == "electric-accessories":
            for on in (0.0, 1.0):
                yield f"{name}-{on:g}", lambda n=name, on=on: electric_case(component(n), on)


CASES = {key: make for kind in TWO_SIDED for key, make in two_sided_cases(kind)}
CASES |= {
    "motor-scaled": lambda: motor_case(component("pm-32kw", **SCALED_MOTOR), 20),
    "gearbox-scaled": lambda: gearbox_case(component("five-speed-polynomial", speed_scale=1.2, torque_scale=0.7, J=0.02), 2, 21),
    "gearbox-map-scaled": lambda: gearbox_case(component("five-speed-map", torque_scale=1.5, efficiency_scale=0.9, J=0.02), 2, 22),
    "final-drive-with-losses": lambda: final_drive_case(component("unity", i=3.7, tau_loss=2.0, J=0.01), 23),
    "accessories-with-both-loads": lambda: mechanical_case(component("mechanical-700w", tau_on=3.0, eta=0.8), 1.0),
    "converter-scaled": lambda: converter_case(component("four-speed-automatic-converter", capacity_scale=0.37), 0, 12),
    "cvt-scaled": lambda: cvt_case(component("cvt-50kw", efficiency_scale=0.9, torque_scale=1.2, speed_scale=0.8, J=0.02), 3.5, 13),
    "axle-divider": lambda: divider_case(component("axle-divider"), 0.57),
    "axle-divider, weak in front": lambda: divider_case(component("axle-divider"), 0.57, drive_front=drive(8.0, 30.0)),
    "axle-divider, weak in both": lambda: divider_case(
        component("axle-divider"), 0.57, drive_front=drive(8.0, 100.0), drive_rear=drive(5.0, 60.0)
    ),
    "planetary-gear": lambda: planetary_case(component("planetary-78-30"), 7),
    "electric-node": lambda: node_case(component("electric-node"), 9),
    "priority-node": lambda: node_case(component("priority-node"), 8),
    "bus": lambda: bus_case(component("bus"), 0.0),
    "bus-with-generator": lambda: bus_case(component("bus"), 12e3),
    "torque-coupler": lambda: coupler_case(component("torque-coupler", n=1.7), 7),
    "torque-coupler-with-drag": lambda: coupler_case(component("torque-coupler", n=0.8, tau_loss=2.0), 8),
    "crankshaft-coupler": lambda: coupler_case(component("crankshaft-coupler"), 9, tau_machine=12.0, clutch_open=0.0, omega_engine=0.0),
    "crankshaft-coupler-with-drag": lambda: coupler_case(
        component("crankshaft-coupler", n=1.4, tau_loss=0.5), 10, tau_machine=-5.0, clutch_open=0.0, omega_engine=0.0
    ),
    "body-without-drag": lambda: body_case("small-car", 24, c_d=0.0),
    "rear-wheels": lambda: wheel_case("small-car-wheels", "small-car", 25, front_driven=0.0, rear_driven=1.0),
    "all-wheels": lambda: wheel_case("small-car-wheels", "small-car", 26, rear_driven=1.0),
    "wheels-with-rolling-resistance-by-speed": lambda: wheel_case("small-car-wheels", "small-car", 27, f_1=1e-4),
    "battery-at-its-largest-power": lambda: store_case("nimh-93ah", 28, u_min=0.0),
}
CASES |= {f"body-{n}": lambda n=n, i=i: body_case(n, 30 + i) for i, n in enumerate(component_names("body"))}
WHEELS = [*component_names("wheel"), *component_names("wheel-j2452")]
CASES |= {f"wheels-{n}": lambda n=n, i=i: wheel_case(n, "small-car", 40 + i) for i, n in enumerate(WHEELS)}
CASES |= {f"body-{n}": lambda n=n, i=i: body_case(n, 46 + i, m=1500.0, F_1=1.5) for i, n in enumerate(component_names("coast-down-body"))}
CASES |= {"wheels-under-a-body-by-its-road-load": lambda: wheel_case("suv-wheels-j2452", "small-car-coast-down", 48)}
STORES = [name for kind in ("battery", "battery-rc", "ultracapacitor") for name in component_names(kind)]
CASES |= {f"battery-{n}": lambda n=n, i=i: store_case(n, 50 + i) for i, n in enumerate(STORES)}


@cache
def case_of(name):
    return CASES[name]()


every_case = pytest.mark.parametrize("name", CASES)


def test_every_two_sided_component_has_a_case():
    assert not [kind for kind in TWO_SIDED if not any(True for _ in two_sided_cases(kind))]


@every_case
def test_available_inverts_required(name):
    case = case_of(name)
    asked, delivered = case.at(case.asked, case.inside), case.at(case.delivered, case.inside)
    # The request is reached to the last bit, by short cuts past the way back.
    scale = np.abs(asked).max(axis=1, keepdims=True)
    np.testing.assert_allclose(delivered / scale.clip(1), asked / scale.clip(1), rtol=0, atol=1e-13)


@every_case
def test_the_way_back_itself_inverts_required(name):
    # A hair less than was sent for goes the long way.  The slopes of the laws there are below 1e4 in the scale taken.
    case = case_of(name)
    asked, delivered = case.at(case.asked, case.inside), case.at(case.delivered, case.inside, 1 - 1e-11)
    scale = np.abs(asked).max(axis=1, keepdims=True)
    np.testing.assert_allclose(delivered / scale.clip(1), asked / scale.clip(1), rtol=0, atol=1e-7)


@every_case
def test_the_plant_sends_the_same_point_as_the_step_where_no_limit_acts(name):
    case = case_of(name)
    points = case.inside
    if "wheels" in name:
        # At standstill the plant's friction brakes fade, a declared difference.
        points = points[points[:, 0] + points[:, 1] * DT > 0]
    if name.startswith("body-"):
        # At standstill the step's body is held by its brakes, a declared difference.
        points = points[points[:, 0] + points[:, 1] * DT / 2 > 0]
    sent, plant = case.at(case.sent, points), case.at(case.plant, points)
    scale = np.abs(sent).max(axis=1, keepdims=True)
    np.testing.assert_allclose(plant / scale.clip(1), sent / scale.clip(1), rtol=0, atol=1e-13)


@every_case
def test_losses_are_not_negative(name):
    case = case_of(name)
    losses = case.at([case.losses], case.inside)
    # Rounding of the powers that a loss is the difference of.
    assert losses.min() >= -1e-13 * np.abs(case.at([case.P_in], case.inside)).max()


@every_case
@pytest.mark.parametrize("offered", [1.0, 0.7, 0.0])
def test_power_balances_whatever_the_source_offers(name, offered):
    case = case_of(name)
    came, went, lost, stored = (case.at([e], case.inside, offered) for e in (case.P_in, case.P_out, case.losses, case.stored))
    scale = np.maximum(np.abs(came), np.abs(lost).sum(axis=0)).max()
    np.testing.assert_allclose((came - went - lost.sum(axis=0) - stored) / max(scale, 1.0), 0, atol=1e-13)


@every_case
def test_derivatives_are_finite_inside_at_standstill_and_at_the_limits(name):
    case = case_of(name)
    results = ca.vertcat(*case.sent, *case.delivered, *case.smooth, case.losses)
    jacobian = ca.Function("jacobian", [case.x, share], [ca.densify(ca.jacobian(results, case.x))])
    for points in (case.inside, case.edges):
        assert np.all(np.isfinite(jacobian(points.T, 1.0).full()))


def test_motor_controller_is_off_at_standstill():
    # The declared switch: no power, and what is left of the torque is the rotor's inertia.
    motor = component("pm-32kw")
    case = motor_case(motor, 0)
    standing = np.array([[50.0, 0.0, 10.0]])
    assert case.at(case.sent, standing) == 0
    assert case.at(case.delivered, standing)[0] == pytest.approx(-motor.p.J * 10.0)


def test_kinetic_power_of_a_rotor_is_its_change_of_energy():
    drive = component("unity", i=3.0, J=0.05)
    faces = {f.name: f for f in drive.faces()}
    mean, alpha = 40.0, 6.0
    way = faces["required"].run(output=Shaft(10.0, mean, alpha), turning=lambda speed: speed > 0)
    back = faces["available"].run(input=way["input"], _way=way["_way"], dt=DT)
    after, before = 3 * mean, 3 * (mean - alpha * DT)
    assert float(back["P_kinetic"]) == pytest.approx(0.05 * (after**2 - before**2) / (2 * DT))


@pytest.mark.parametrize("name", component_names("engine"))
def test_engines_lose_power_all_over_their_map(name):
    engine = component(name)
    rng = random(60)
    for omega in rng.uniform(engine.p.fuel.points[0][0], engine.omega_max, 30):
        tau = rng.uniform(float(engine.tau_closed(omega)), float(engine.tau_max(omega)))
        assert float(engine.fuel_flow(tau, omega)) * engine.p.H_fuel > max(tau * omega, 0)
