"""The power split: planetary gear, generator that turns both ways, control, and the node of its two machines.

Departures from the original that halfshaft documents: the generator's torque counts at the ring, and what its envelope leaves
open the motor makes up for; the engine's torque is no more than the generator holds; it changes its speed no faster than its own torques
let both rotors; after a missed trace the sun and the engine's limits follow what the ring has reached.
"""

from .chassis import Road
from .driveline import FinalDrive
from .electric import Accessories, Battery, Motor
from .tables import Look, clip, ratio
from .vehicles import columns, seen, steps


class MotorGenerator:
    """Backward, all is as in a mirror."""

    def __init__(self, p):
        self.p, s, q = p, p.speed_scale, p.torque_scale
        self.top, self.P = p.omega_max * s, Look(p.P_electric, s * q, s, q)
        self.T_top, self.T_max, self.T_min = Look(p.tau_max, q, s), *(Look(t, p.overtorque * q, s) for t in (p.tau_max, p.tau_min))

    def required(self, T, w, alpha, U_before):
        p, self.side = self.p, -1.0 if w < 0 else 1.0
        self.w = min(abs(w), self.top)
        self.T_J = self.side * p.J * alpha
        self.T = clip(self.side * T + self.T_J, self.T_min(self.w), self.T_max(self.w)) if self.w > 1e-3 else 0.0
        P = self.P(self.w, self.T) if self.w > 1e-3 else 0.0
        self.P_map = P / p.efficiency_scale if P >= 0 else P * p.efficiency_scale
        self.P_r, self.able = clip(self.P_map, -p.I_max * U_before, p.I_max * U_before), self.side * (self.T - self.T_J)
        self.seen = {
            "generator.omega_required": w, "generator.tau_required": T, "generator.tau_able": self.able,
            "generator.P_map": self.P_map, "generator.P_in_required": self.P_r,
        }  # fmt: skip
        return self.P_r

    def available(self, P):
        T = self.side * (self.T * clip(ratio(P, self.P_map), 0, 1) - self.T_J)
        self.seen |= {"generator.P_in": P, "generator.tau": T, "generator.omega": self.side * self.w}
        return T


class Engine:
    """Never parted from the gear: it speeds up by itself, and what is left of its torque is the carrier's."""

    def __init__(self, p):
        self.p, s, q = p, p.speed_scale, p.torque_scale
        self.T_max, self.T_closed = Look(p.tau_max, q, s), Look(p.tau_closed, q, s)
        self.fuel = Look(p.fuel, s * q / p.efficiency_scale, s, q)
        self.scale, self.top = (s, q), s * float(p.tau_max.points[0][-1])
        self.own, self.fuel_used = 0.0, 0.0

    def available(self, T_c, w_c, on, dt):
        """Return torque, speed and acceleration of the carrier."""
        J, own = self.p.J, self.own
        w = min(w_c, own + dt * self.T_max(own) / max(J, 1e-6), self.top)
        open_throttle, closed, T_J = self.T_max(w) if on else 0.0, self.T_closed(w), J * (w - own) / dt
        T_map = clip(T_c + T_J, closed, open_throttle)
        T = max(open_throttle - T_J, 0.0) if T_c + T_J > open_throttle else max(T_c, closed - T_J)
        self.own = clip(own + dt * (T_map - T) / max(J, 1e-6), min(w, own), max(w, own))
        flow = self.fuel(w, T_map) if on else 0.0
        self.fuel_used += dt * flow
        self.seen = {
            "engine.omega_engine": w, "engine.tau": T, "engine.tau_map": T_map, "engine.fuel_used": self.fuel_used,
            "engine.P_fuel": flow * self.p.H_fuel, "engine.P_kinetic": J * (self.own**2 - own**2) / 2 / dt,
        }  # fmt: skip
        return T, w, (w - own) / dt


class Control:
    def __init__(self, p, gear, engine, generator):
        self.p, self.gear, self.engine, self.generator = p, gear, engine, generator
        s, q = engine.scale
        self.best = Look(p.omega_best, s, s * q)
        self.on, self.off = False, 0.0

    def decide(self, T, w, w_turning, v, soc, U_before, key_on, dt):
        """Return the engine's torque, speed, and whether it is on."""
        p, engine, generator, (r, s) = self.p, self.engine, self.generator, self.gear
        P = T * w
        small = P < p.P_on and v < p.v_on and soc > p.soc_on
        self.on = bool(key_on) and not small and (self.on or self.off >= p.t_off_min - 1e-9)
        self.off = 0.0 if self.on else self.off + dt
        full = self.on and P > p.P_full
        asked = P + p.I_charge * (p.soc_target - soc) * U_before / p.eta_charge if self.on else 0.0

        # What the generator's top speed leaves to the engine.
        fastest = min((r * w_turning + s * generator.top) / (r + s), engine.top)
        slowest = (r * w_turning - s * generator.top) / (r + s)
        slowest = max(slowest, p.omega_lowest) if slowest > 0 else 0.0
        w_1 = self.best(asked)
        w_2 = self.best(asked + w_1 * engine.p.J * (w_1 - engine.own) / max(dt, p.t_inertia))
        w_c = fastest if full else max(clip(w_2, slowest, fastest), p.omega_lowest)
        J = max(engine.p.J + generator.p.J * ((r + s) / s) ** 2, 1e-6)
        w_c = clip(w_c if self.on else 0.0, *(engine.own + dt * T(engine.own) / J for T in (engine.T_closed, engine.T_max)))

        w_sun = ((r + s) * w_c - r * w_turning) / s
        most = min(engine.T_max(w_c), generator.T_top(abs(w_sun)) * (r + s) / s)
        T_c = most if full else min(asked / max(w_c, p.omega_lowest), most)
        T_c = T_c if self.on else 0.0
        self.seen = {
            "control.engine_on": float(self.on), "control.engine_full": float(full), "control.P_engine_request": asked,
            "control.omega_command": w_c, "control.tau_command": T_c,
        }  # fmt: skip
        return T_c, w_c, self.on


def shared(P_motor, P_generator, P):
    """Return what motor and generator get of a power that is not what they asked for together."""
    missing = P_motor + P_generator - P
    from_motor = min(missing, max(P_motor, 0.0)) if missing > 0 else max(missing, min(P_motor, 0.0))
    return P_motor - from_motor, P_generator - (missing - from_motor)


def drive(parameters, samples):
    """Return the time series of a power split by name."""
    p = parameters
    r, s = p["planetary"].r, p["planetary"].s
    road, final, motor = Road(p["body"], p["wheel"], samples.v_start), FinalDrive(p["final_drive"]), Motor(p["motor"])
    generator, engine, accessories = MotorGenerator(p["generator"]), Engine(p["engine"]), Accessories(p["accessories"])
    battery = Battery(p["battery"], max(p["motor"].U_min, p["generator"].U_min))
    control = Control(p["control"], (r, s), engine, generator)
    reached, gained = 0.0, 0.0
    rows = []
    for v_request, grade, key_on, dt in steps(samples, road):
        T, w, alpha = final.required(*road.required(v_request, grade, dt))
        w_turning, alpha_turning = (reached, gained) if road.missed else (w, alpha)
        command = control.decide(T, w, w_turning, road.v, battery.soc, battery.U, key_on, dt)
        T_E, w_E, alpha_E = engine.available(*command, dt)
        w_S, alpha_S = ((r + s) * w_E - r * w_turning) / s, ((r + s) * alpha_E - r * alpha_turning) / s
        P_G = generator.required(-s / (r + s) * T_E, w_S, alpha_S, battery.U)
        P_M = motor.required(T + r / s * generator.able, w, alpha, battery.U, road)
        battery.limits()
        P = accessories.available(battery.available(accessories.required(P_M + P_G, key_on), dt))
        P_M, P_G = shared(P_M, P_G, P)
        T_M, w_M = motor.available(P_M)
        road.available(*final.available(T_M - r / s * generator.available(P_G), w_M))
        gained, reached = (w_M * road.ratio - reached) / dt, w_M * road.ratio
        rows.append(seen(road, motor, generator, engine, accessories, battery, control))
    return columns(rows)
