"""Vehicles: parts put together, and the loop over the steps.

`parameters` are the vehicle's sets by role, `samples` the steps of a cycle.
"""

import copy
import math

import numpy as np
from scipy.optimize import brentq

from .automatic import AutomaticShift, Cvt, Locus, TorqueConverter
from .chassis import Road
from .control import ConventionalControl, SeriesControl
from .driveline import Clutch, FinalDrive, FixedGear, Gearbox, Shift
from .electric import Accessories, Battery, Bus, Generator, Motor
from .engine import Engine, MechanicalAccessories
from .tables import clip


def shift_of(p, ratios, T_max):
    return Shift(p, ratios, T_max) if hasattr(p, "up") else FixedGear(ratios)


def steps(samples, road):
    """Yield request, grade, key and length of each step; a grade over distance is that where the step starts."""
    for k, dt in enumerate(samples.dt.tolist()):
        grade = float(samples.grade[k])
        if samples.grade_by_distance is not None:
            distances, grades = (x.tolist() for x in samples.grade_by_distance)
            grade = grades[0]
            for a, b, g_a, g_b in zip(distances, distances[1:], grades, grades[1:], strict=False):
                if road.distance > a:
                    grade = g_a + (g_b - g_a) * (min(road.distance, b) - a) / (b - a)
        yield float(samples.v[k]), grade, bool(samples.key_on[k]), dt


def columns(rows):
    """Return an array for each name."""
    rows = list(rows)
    return {name: np.array([row[name] for row in rows]) for name in rows[0]}


def seen(*parts):
    return {name: x for part in parts for name, x in getattr(part, "seen", {}).items()}


def electric(parameters, samples):
    """Return a row of every step of an electric car, and of a series hybrid where there is a generator."""
    p = parameters
    road, final, gearbox = Road(p["body"], p["wheel"], samples.v_start), FinalDrive(p["final_drive"]), Gearbox(p["gearbox"])
    motor, accessories, bus = Motor(p["motor"]), Accessories(p["accessories"]), Bus()
    shift, battery = shift_of(p["shift"], p["gearbox"].ratios, motor.T_max), Battery(p["battery"], p["motor"].U_min)
    hybrid = "generator" in p
    if hybrid:
        generator, engine = Generator(p["generator"]), Engine(p["engine"], 0.0, p["generator"].J)
        control = SeriesControl(p["control"], engine, generator)
    for v_request, grade, key_on, dt in steps(samples, road):
        output = final.required(*road.required(v_request, grade, dt))
        gear, G, shifting = shift.choose(*output[:2], road, gearbox, dt)
        P_motor = motor.required(*gearbox.required(*output, gear, G, shifting), battery.U, road, shifting)
        P_bus, P_generator, room = accessories.required(P_motor, key_on), 0.0, battery.limits()
        if hybrid:
            on, ready, w_c, T = control.decide(P_bus, battery.soc, *room, key_on, dt)
            P_generator = generator.available(*engine.genset(T, w_c, on, ready, dt), battery.U, dt)
        P = bus.available(battery.available(bus.required(P_bus, P_generator), dt))
        road.available(*final.available(*gearbox.available(*motor.available(accessories.available(P)))))
        yield seen(road, final, gearbox, shift, motor, accessories, bus, battery, *((engine, generator, control) if hybrid else ()))


def conventional(parameters, samples):
    """Return a row of every step of a conventional car."""
    p = parameters
    road, final, gearbox = Road(p["body"], p["wheel"], samples.v_start), FinalDrive(p["final_drive"]), Gearbox(p["gearbox"])
    engine, accessories = Engine(p["engine"], p["control"].omega_idle * p["control"].idle_at_stop), MechanicalAccessories(p["accessories"])
    control = ConventionalControl(p["control"], engine, samples.v_start)
    shift, clutch = shift_of(p["shift"], p["gearbox"].ratios, engine.T_max), Clutch(engine.T_largest, control.w_launch)
    for v_request, grade, key_on, dt in steps(samples, road):
        output = final.required(*road.required(v_request, grade, dt))
        gear, G, shifting = shift.choose(*output[:2], road, gearbox, dt, accessories.T)
        T, w, _ = gearbox.required(*output, gear, G, shifting)
        state, on, w_c = control.decide(T, w, shift.w_estimate, shifting, key_on)
        is_open, slips = state == 1, state == 2
        T, w_shaft = clutch.required(T, w, state)
        w_engine = engine.geared_speed(w_c, control.w_idle, on, is_open, slips, accessories.T, G, road, dt)
        T_req = accessories.required(T, w_engine, control.w_idle, on)
        T, w = engine.geared(T_req, w_shaft, on, is_open, slips, road, dt)
        road.available(*final.available(*gearbox.available(*clutch.available(accessories.available(T), w))))
        yield seen(road, final, gearbox, shift, clutch, accessories, engine, control)


def automatic(parameters, samples):
    """Return a row of every step of a car with torque converter."""
    p = parameters
    road, final, gearbox = Road(p["body"], p["wheel"], samples.v_start), FinalDrive(p["final_drive"]), Gearbox(p["gearbox"])
    w_idle = p["control"].omega_idle
    engine, accessories, converter = Engine(p["engine"], w_idle), MechanicalAccessories(p["accessories"]), TorqueConverter(p["converter"])
    shift = AutomaticShift(p["shift"], p["gearbox"].ratios, engine, converter)
    for v_request, grade, key_on, dt in steps(samples, road):
        output = final.required(*road.required(v_request, grade, dt))
        gear, G = shift.choose(*output[:2], road, gearbox, dt, accessories.T, w_idle)
        T, w, _ = gearbox.required(*output, gear, G, False)
        T, w = converter.required(T, w, G, shift.locked, not key_on, engine, road, w_idle, accessories.T, dt)
        w_c = clip(w, w_idle, engine.w_top) if key_on else 0.0
        rigid = shift.locked or not key_on
        if rigid:
            w_engine = engine.geared_speed(w_c, w_idle, key_on, not key_on, False, accessories.T, G, road, dt)
        else:
            w_engine = engine.behind_oil(w_c, w_idle, key_on, G, dt)
        T_req = accessories.required(T, w_engine, w_idle, key_on)
        T, w = engine.geared(T_req, w, key_on, not key_on, False, road, dt) if rigid else engine.against_oil(T_req, key_on, dt)
        road.available(*final.available(*gearbox.available(*converter.available(accessories.available(T), w))))
        yield seen(road, final, gearbox, shift, converter, engine)


def cvt(parameters, samples):
    """Return a row of every step of a car with a continuous ratio."""
    p = parameters
    road, final, gearbox = Road(p["body"], p["wheel"], samples.v_start), FinalDrive(p["final_drive"]), Cvt(p["gearbox"])
    engine, accessories = Engine(p["engine"], p["control"].omega_idle * p["control"].idle_at_stop), MechanicalAccessories(p["accessories"])
    control, locus = ConventionalControl(p["control"], engine, samples.v_start), Locus(p["shift"], p["gearbox"].ratios)
    clutch = Clutch(engine.T_largest, control.w_launch)
    for v_request, grade, key_on, dt in steps(samples, road):
        output = final.required(*road.required(v_request, grade, dt))
        G = locus.choose(*output[:2], gearbox, engine, accessories.T, dt)
        T, w, _ = gearbox.required(*output, 0, G, False)
        state, on, w_c = control.decide(T, w, w, False, key_on)
        is_open, slips = state == 1, state == 2
        T, w_shaft = clutch.required(T, w, state)
        w_engine = engine.geared_speed(w_c, control.w_idle, on, is_open, slips, accessories.T, G, road, dt)
        T_req = accessories.required(T, w_engine, control.w_idle, on)
        T, w = engine.geared(T_req, w_shaft, on, is_open, slips, road, dt, locus.change)
        road.available(*final.available(*gearbox.available(*clutch.available(accessories.available(T), w))))
        yield seen(road, final, gearbox, locus, clutch, engine, control)


def beyond(drive, T, w, alpha, U, road, dt):
    """Return how much of a torque at an axle is more than its motor's envelope can drive or brake."""
    final, gearbox, shift, motor = (copy.copy(part) for part in drive)

    def rotor(T):
        output = final.required(T, w, alpha)
        gear, G, shifting = copy.copy(shift).choose(*output[:2], road, gearbox, dt)
        T_m, w_m, alpha_m = gearbox.required(*output, gear, G, shifting)
        one = copy.copy(motor)
        one.required(T_m, w_m, alpha_m, U, road, shifting)
        return T_m + one.T_J, one.seen["motor.tau_limited"]

    T_rotor, limit = rotor(T)
    if T_rotor == limit or T * T_rotor <= 0:
        return 0.0
    way = math.copysign(1.0, T)
    if way * rotor(0.0)[0] >= way * limit:
        return T  # At most all of it.
    if way * T_rotor < way * limit:
        return 0.0
    return T - brentq(lambda x: rotor(x)[0] - limit, 0.0, T, xtol=1e-300, rtol=1e-15)


def two_motor(parameters, samples):
    """Return a row of every step of an electric car with a motor on each axle."""
    p = parameters
    road, accessories, bus = Road(p["body"], p["wheel"], samples.v_start), Accessories(p["accessories"]), Bus()
    drives = {}
    for axle in ("front", "rear"):
        gearbox, motor = Gearbox(p[f"gearbox_{axle}"]), Motor(p[f"motor_{axle}"])
        shift = shift_of(p[f"shift_{axle}"], p[f"gearbox_{axle}"].ratios, motor.T_max)
        drives[axle] = FinalDrive(p[f"final_drive_{axle}"]), gearbox, shift, motor
    battery = Battery(p["battery"], max(p["motor_front"].U_min, p["motor_rear"].U_min))
    for v_request, grade, key_on, dt in steps(samples, road):
        T, w, alpha = road.required(v_request, grade, dt)
        # By the loads of the axles; what is beyond one motor's envelope the other is asked for, as far as its tyres hold it.
        shares = {"front": p["wheel"].front_driven * road.loads[0] / road.loads[2] * T}
        shares["rear"] = T - shares["front"]
        moved = {}
        for axle, other in (("front", "rear"), ("rear", "front")):
            most, least = road.room[other]
            lack = beyond(drives[axle], shares[axle], w, alpha, battery.U, road, dt)
            moved[axle] = clip(lack, min(least - shares[other], 0.0), max(most - shares[other], 0.0))
        T_front = shares["front"] - moved["front"] + moved["rear"]
        asked = []
        for (final, gearbox, shift, motor), torque in zip(drives.values(), (T_front, T - T_front), strict=True):
            output = final.required(torque, w, alpha)
            gear, G, shifting = shift.choose(*output[:2], road, gearbox, dt)
            asked.append(motor.required(*gearbox.required(*output, gear, G, shifting), battery.U, road, shifting))
        P_bus = accessories.required(sum(asked), key_on)
        battery.limits()
        P = accessories.available(bus.available(battery.available(bus.required(P_bus, 0.0), dt)))
        # Too little: those that drive get less, in proportion; too much is left: those that brake give less.
        lack = P - sum(asked)
        shares = [max(x, 0.0) if lack < 0 else min(x, 0.0) for x in asked]
        parts = [x / sum(shares) if sum(shares) != 0 else 0.5 for x in shares]
        given = [x if lack == 0 else x + lack * part for x, part in zip(asked, parts, strict=True)]
        ends = [
            final.available(*gearbox.available(*motor.available(x)))
            for (final, gearbox, _, motor), x in zip(drives.values(), given, strict=True)
        ]
        road.available(sum(T for T, _ in ends), min(w, *(w for _, w in ends)))
        row = {name.replace("final_drive.", "divider."): x for name, x in seen(road).items()}
        for axle, parts in drives.items():
            row |= {name.replace(".", f"_{axle}.", 1): x for name, x in seen(*parts).items()}
        yield row | {k: x for k, x in seen(accessories, bus, battery).items()}


TWINS = {
    "electric": electric, "series": electric, "conventional": conventional, "automatic": automatic, "cvt": cvt, "two_motor": two_motor,
}  # fmt: skip
