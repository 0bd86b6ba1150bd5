"""The parallel hybrids a second time, by hand: loops and plain numbers, of the pieces of `twins` and some of their own.

Written from the block diagrams of the original, with the departures that halfshaft documents: an engine behind an open clutch is asked for
no torque, the motor is asked at its own speed whether it could pull the next gear, engines run hot.
"""

import math

from twins.chassis import Road
from twins.driveline import ENGAGED, OPEN, SLIPPING, Clutch, FinalDrive, Gearbox, Shift
from twins.electric import Accessories, Battery, Bus, Motor
from twins.engine import Engine, MechanicalAccessories
from twins.tables import clip
from twins.vehicles import seen, steps


class ParallelShift(Shift):
    """Shift logic that must not always raise a gear."""

    def choose(self, *x, may_raise=True):
        lines = self.up
        if not may_raise:
            self.up = lambda w, gear: -math.inf
        found = super().choose(*x)
        self.up = lines
        return found


class Coupler:
    """The engine's side gives what it gives; the motor is asked for the rest."""

    def __init__(self, p, engine_side):
        self.p, self.engine_side = p, engine_side

    def required(self, T, w, alpha):
        self.T_loss = self.p.tau_loss if w > 0 else 0.0
        self.T, self.w, self.alpha = T + self.T_loss, w, alpha
        return self.T, w, alpha

    def motor_required(self, T_engine, w_engine):
        n = self.p.n
        self.T_engine, self.w_engine, self.T_motor = T_engine, w_engine, (self.T - T_engine) / n
        self.seen = {f"{self.engine_side}.tau": T_engine, "motor.tau_required": self.T_motor}
        return self.T_motor, n * min(self.w, w_engine), n * self.alpha

    def available(self, T_motor, w_motor):
        n = self.p.n
        T, w = self.T_engine + n * T_motor - self.T_loss, min(self.w, self.w_engine, w_motor / n)
        self.seen |= {"coupler.tau": T, "coupler.omega": w}
        return T, w


class ParallelControl:
    """Electric assist, or balanced where there are loads of the engine to aim at."""

    def __init__(self, p, engine, motor, n_motor, v_start):
        self.p, self.engine, self.motor, self.n = p, engine, motor, n_motor
        self.w_idle, self.w_launch = p.omega_idle * p.idle_at_stop, max(p.launch_share * engine.w_top, 1.5 * p.omega_idle)
        self.clutch, self.on, self.powers = ENGAGED if v_start > 0 else OPEN, v_start > 0, []
        self.middle, self.half = (p.soc_high + p.soc_low) / 2, (p.soc_high - p.soc_low) / 2

    def may_raise(self, T_out, w_out, G, G_above, eta):
        """Say whether the motor could pull the next gear, or the engine was on, or the motor is near its top speed."""
        w = self.n * G_above * w_out
        pulls = self.motor.p.overtorque * self.motor.T_max(w) * w > w_out * T_out / clip(eta, 0.2, 1)
        return pulls or self.on or self.n * G * w_out > 0.95 * self.motor.top

    def decide(self, T, w, w_estimate, shifting, v, soc, P_battery, key_on):
        """Return the clutch's state, engine on, its speed and its torque."""
        p, T_max = self.p, self.engine.T_max
        assist = hasattr(p, "off_share")
        spins = p.idle_at_stop or ((T > 1e-3 or v > p.v_decel) and w > p.omega_idle)
        # The line from the lower to the upper end of the window, level above and extended below.
        slope = (p.v_launch_high - p.v_launch_low) / (p.soc_high - p.soc_low)
        v_launch = p.v_launch_high if soc >= p.soc_high else p.v_launch_low + slope * (soc - p.soc_low)
        fast = v >= v_launch or (soc < p.soc_low and not p.charge_depleting)
        if assist:
            worth = p.charge_depleting or soc < p.soc_low or T > p.off_share * T_max(w) or p.off_share < 1e-12
        else:
            worth = soc < p.soc_high and (soc < self.middle or T > p.load_low * T_max(w))
        last = self.powers[-3:]
        need = (sum(last) / len(last) if last else 0.0) >= P_battery
        on = bool(key_on) and ((spins and fast and bool(worth)) or (shifting and self.on) or need)
        self.powers.append((self.powers[-1] if self.powers else 0.0) if shifting else T * w)

        if not on or shifting or (T <= 1e-3 and (p.open_when_braking or w_estimate < p.omega_idle)):
            clutch = OPEN
        else:
            clutch = SLIPPING if T > 1e-3 and max(w_estimate, w) < self.w_launch and self.clutch != ENGAGED else ENGAGED
        self.on, self.clutch = on, clutch
        w_c = clip(self.w_launch if clutch == SLIPPING else w, self.w_idle, self.engine.w_top) if on else 0.0

        x = (self.middle - soc) / self.half
        if assist:
            T_e = T + p.charge_share * self.engine.p.torque_scale * min(self.engine.p.tau_max.values.tolist()) * x
        else:
            T_e = self.balanced(T, T_max(w_c), x)
        T_min = p.min_share * T_max(w_c) if soc < p.soc_low else 0.0
        T_e = max(T_e, T_min) if on else 0.0
        self.seen = {
            "control.clutch_state": clutch, "control.engine_on": float(on), "control.omega_command": w_c, "control.tau_command": T_e,
        }  # fmt: skip
        return clutch, on, w_c, T_e

    def balanced(self, T, T_max, x):
        p, f = self.p, clip(T / T_max, 0, 1)
        f_m, half = (p.load_low + p.load_high) / 2, (p.load_high - p.load_low) / 2
        s, y = math.copysign(x * x, x), (f_m - f) / half
        k = s + p.load_weight * math.copysign(y * y, y)
        if s > 0:
            if f >= p.load_high:
                return max(0.0, T)
            target = p.load_high if f > f_m else f_m
            return max(0.0, T + T_max * (target - f) * k)
        return max(0.0, T - T_max * (f_m - f) * k) if f > f_m else max(0.0, T)


def parallel(parameters, samples, *, behind_gearbox=False):
    """Return a row of every step; the motor stands before the gearbox, or behind it at the final drive."""
    p = parameters
    road, final, gearbox = Road(p["body"], p["wheel"], samples.v_start), FinalDrive(p["final_drive"]), Gearbox(p["gearbox"])
    engine, belt, ratios = Engine(p["engine"]), MechanicalAccessories(p["mechanical_accessories"]), p["gearbox"].ratios
    motor, accessories, bus = Motor(p["motor"]), Accessories(p["electric_accessories"], "electric_accessories"), Bus()
    battery, coupler = Battery(p["battery"], p["motor"].U_min), Coupler(p["coupler"], "gearbox" if behind_gearbox else "clutch")
    control = ParallelControl(p["control"], engine, motor, p["coupler"].n, samples.v_start)
    engine.own = engine.free = engine.command = control.w_idle
    shift, clutch = ParallelShift(p["shift"], ratios, engine.T_max), Clutch(engine.T_largest, control.w_launch)
    for v_request, grade, key_on, dt in steps(samples, road):
        P_battery, _ = battery.limits()
        T, w, alpha = final.required(*road.required(v_request, grade, dt))
        if behind_gearbox:
            T, w, alpha = coupler.required(T, w, alpha)
        here, above = (ratios[min(shift.gear + i, len(ratios)) - 1] for i in (0, 1))
        may_raise = behind_gearbox or control.may_raise(T, w, here, above, gearbox.eta)
        gear, G, shifting = shift.choose(T, w, road, gearbox, dt, belt.T, may_raise=may_raise)
        T, w, alpha = gearbox.required(T, w, alpha, gear, G, shifting)
        if not behind_gearbox:
            T, w, alpha = coupler.required(T, w, alpha)
        state, on, w_c, T_e = control.decide(T, w, shift.w_estimate, shifting, road.v_lim, battery.soc, P_battery, key_on)
        is_open, slips = state == OPEN, state == SLIPPING
        _, w_shaft = clutch.required(T, w, state)
        w_engine = engine.geared_speed(w_c, control.w_idle, on, is_open, slips, belt.T, G, road, dt)
        T_req = belt.required(0.0 if is_open else T_e, w_engine, control.w_idle, on)
        T, w = engine.geared(T_req, w_shaft, on, is_open, slips, road, dt)
        T, w = clutch.available(belt.available(T), w)
        if behind_gearbox:
            T, w = gearbox.available(T, w)
        P = accessories.required(motor.required(*coupler.motor_required(T, w), battery.U, road, shifting and not behind_gearbox), key_on)
        P = bus.available(battery.available(bus.required(P, 0.0), dt))
        T, w = coupler.available(*motor.available(accessories.available(P)))
        if not behind_gearbox:
            T, w = gearbox.available(T, w)
        road.available(*final.available(T, w))
        if behind_gearbox:
            final.seen = {}  # It takes its neighbour for the gearbox.
        yield seen(road, final, gearbox, shift, clutch, belt, engine, control, motor, accessories, bus, battery, coupler)


class MildControl:
    """Start, stop and help in the manner of the Insight's; the machine sits on the crankshaft."""

    def __init__(self, p, engine, motor, n_motor, v_start):
        self.p, self.engine, self.motor, self.n = p, engine, motor, n_motor
        self.w_idle, self.w_launch = p.omega_idle, max(p.launch_share * engine.w_top, 1.5 * p.omega_idle)
        self.clutch, self.on = ENGAGED if v_start > 0 else OPEN, v_start > 0

    def decide(self, T, w, w_estimate, shifting, road, a_request, gear, soc, key_on, dt):
        """Return the clutch's state, engine on, its speed, and the machine's torque at the crankshaft."""
        p, was_on = self.p, self.on
        stops = T <= 1e-3 and road.v_lim < p.v_decel and soc >= p.soc_low and not (shifting and was_on)
        self.on = bool(key_on) and not stops
        if not self.on or shifting or (T <= 1e-3 and (p.open_when_braking or w_estimate < p.omega_idle)):
            self.clutch = OPEN
        else:
            self.clutch = SLIPPING if T > 1e-3 and max(w_estimate, w) < self.w_launch and self.clutch != ENGAGED else ENGAGED
        w_c = clip(self.w_launch if self.clutch == SLIPPING else w, p.omega_idle, self.engine.w_top) if self.on else 0.0

        T = 0.0 if self.clutch == OPEN else T
        T_max, fade = self.n * self.motor.T_max(self.n * w_c), clip((soc - p.soc_low) / (p.soc_assist - p.soc_low), 0, 1)
        if not self.on:
            T_m = 0.0
        elif not was_on:
            T_m = clip(self.engine.J * (w_c - self.engine.own) / dt, 0, T_max)
        elif T > p.tau_full:
            T_m = fade * min(T_max, p.P_full / w_c)
        elif T >= p.tau_assist and gear > 1 and a_request >= p.a_assist and road.v_lim >= p.v_assist:
            T_m = fade * min(p.share_low * T_max + p.slope * (T - p.tau_assist), p.share_high * T_max)
        elif soc >= p.soc_high:
            T_m = 0.0
        else:
            T_m = p.slope_regen * (T - p.tau_regen) if T <= p.tau_regen else -p.P_alternator / w_c
        self.seen = {
            "control.clutch_state": self.clutch, "control.engine_on": float(self.on), "control.omega_command": w_c,
            "control.tau_machine": T_m,
        }  # fmt: skip
        return self.clutch, self.on, w_c, T_m


def mild(parameters, samples):
    """Return a row of every step of a mild hybrid."""
    p = parameters
    road, final, gearbox = Road(p["body"], p["wheel"], samples.v_start), FinalDrive(p["final_drive"]), Gearbox(p["gearbox"])
    engine, belt = Engine(p["engine"], p["control"].omega_idle), MechanicalAccessories(p["mechanical_accessories"])
    motor, accessories, bus = Motor(p["motor"]), Accessories(p["electric_accessories"], "electric_accessories"), Bus()
    battery, n, T_drag = Battery(p["battery"], p["motor"].U_min), p["coupler"].n, p["coupler"].tau_loss
    control = MildControl(p["control"], engine, motor, n, samples.v_start)
    T_largest = engine.T_largest + n * motor.p.overtorque * motor.p.torque_scale * max(motor.p.tau_max.values.tolist())
    shift, clutch = Shift(p["shift"], p["gearbox"].ratios, engine.T_max), Clutch(T_largest, control.w_launch)
    for v_request, grade, key_on, dt in steps(samples, road):
        battery.limits()
        a_request = (v_request - road.v) / dt
        T, w, alpha = final.required(*road.required(v_request, grade, dt))
        gear, G, shifting = shift.choose(T, w, road, gearbox, dt, belt.T)
        T, w, alpha = gearbox.required(T, w, alpha, gear, G, shifting)
        state, on, w_c, T_m = control.decide(T, w, shift.w_estimate, shifting, road, a_request, gear, battery.soc, key_on, dt)
        is_open, slips = state == OPEN, state == SLIPPING
        T, w_shaft = clutch.required(T, w, state)
        T_loss = T_drag if w_shaft > 0 else 0.0
        w_engine = engine.geared_speed(w_c, control.w_idle, on, is_open, slips, belt.T, G, road, dt)
        T_e, w_e = engine.geared(belt.required(T + T_loss - T_m, w_engine, control.w_idle, on), w_shaft, on, is_open, slips, road, dt)
        T_e = belt.available(T_e)
        T_rest = (T + T_loss - T_e) / n
        if not is_open and w_shaft - w_e > 1e-6 and w_engine > w_e * (1 - 1e-9):
            T_rest = min(T_rest, 0.0)  # It does not drive the engine beyond its top speed.
        rotor = motor.required(T_rest, n * w_e, 0.0 if is_open else n * alpha, battery.U, road)
        P = bus.available(battery.available(bus.required(accessories.required(rotor, key_on), 0.0), dt))
        T_a, w_a = motor.available(accessories.available(P))
        T, w = clutch.available(T_e + n * T_a - T_loss, min(w_shaft, w_e, w_a / n))
        road.available(*final.available(*gearbox.available(T, w)))
        yield seen(road, final, gearbox, shift, clutch, belt, engine, control, motor, accessories, bus, battery)
