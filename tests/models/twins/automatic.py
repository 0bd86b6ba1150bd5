"""The automatic gearbox: torque converter, shift logic with lock-up, and the transmission without gears."""

import math

from .driveline import Gearbox, Shift
from .tables import Look, clip


def between(points, values, x):
    """Return the piecewise linear value, extended beyond both ends."""
    i = 0
    while i < len(points) - 2 and x >= points[i + 1]:
        i += 1
    return values[i] + (x - points[i]) / (points[i + 1] - points[i]) * (values[i + 1] - values[i])


class TorqueConverter:
    """Pump at the engine, turbine at the gearbox; torques over the square of the pump's speed by the ratio of speeds."""

    def __init__(self, p):
        self.p, self.C, self.R = p, Look(p.capacity, p.capacity_scale), Look(p.torque_ratio)
        ratios = p.capacity.points[0].tolist()
        self.curves = {}
        for name, factors in (("pump", [self.C(n) for n in ratios]), ("turbine", [self.C(n) * self.R(n) for n in ratios])):
            rows = []
            for n, f in zip(ratios, factors, strict=True):
                # A stalled pump at unit speed has the length 1 on the axis of torques, a turbine at that speed on the axis of speeds.
                length = math.hypot(n, math.sqrt(abs(f) / factors[0]))
                rows.append((n / length if f >= 0 else 2 - n / length, 1 / length))
            self.curves[name] = factors[0], *zip(*rows, strict=True)
        self.w_out = 0.0

    def pump(self, side, T, w):
        """Return the pump's speed at the turbine's speed and the torque of one side."""
        stall, places, lengths = self.curves[side]
        length = math.sqrt(w**2 + abs(T) / stall + 1e-6)
        return length * between(places, lengths, w / length if T >= 0 else 2 - w / length)

    def torques(self, w_pump, w):
        n = w / max(w_pump, 1.0)
        T = self.C(n) * w_pump**2
        return T, T * self.R(n)

    def reached(self, T, engine, w, w_idle, dt):
        """Return the speed at the end of a step in which the engine brings this torque, the accessories' taken off, to the pump."""
        end = clip(self.pump("pump", T, w), w_idle, engine.w_top)
        gap = end - engine.own
        slope = max((T - self.torques(engine.own, w)[0]) * gap, 0.0) / (gap**2 + 0.1**2)
        # Implicit: J (w - own) / dt = slope (end - w).
        return max((engine.J / dt * engine.own + slope * end) / (engine.J / dt + slope), w_idle)

    def required(self, T, w, G, locked, is_open, engine, road, w_idle, T_acc, dt):
        self.locked, self.is_open, self.w = locked, is_open, w
        w_t = self.w_out * road.ratio * G if road.missed and not (locked or is_open) else w  # (10)
        self.w_out = w / G
        self.seen = {"converter.tau_required": T, "converter.omega_required": w}
        if is_open:
            T = 0.0
        elif not locked:
            first = clip(self.pump("pump", engine.T_max(engine.own) - T_acc, w_t), w_idle, engine.w_top)
            most = self.reached(engine.T_max(first) - T_acc, engine, w_t, w_idle, dt)
            least = self.reached(engine.T_closed(engine.own) - T_acc, engine, w_t, w_idle, dt)
            T = min(max(T, self.torques(least, w_t)[1]), self.torques(most, w_t)[1])
        self.T_cut, w_p, T_p = T, w, T
        if not (locked or is_open):
            w_p = max(self.pump("turbine", T, w_t), w_idle)
            T_p = T / self.R(w_t / max(w_p, 1.0))
        self.T_p = T_p
        self.seen["converter.omega_pump"] = w_p
        return T_p, w_p

    def available(self, T, w):
        T = 0.0 if self.is_open else T * (self.T_cut / self.T_p if self.T_p != 0 else 1.0)
        w = w if self.locked and not self.is_open else self.w
        self.seen |= {"converter.tau": T, "converter.omega": w}
        return T, w


class AutomaticShift(Shift):
    """Gear by load and speed of the engine behind the converter, and the lock-up clutch."""

    def __init__(self, p, ratios, engine, converter):
        super().__init__(p, ratios, engine.T_max)
        self.engine, self.converter, self.locked, self.able = engine, converter, False, False

    def load(self, T, w, road):
        return 1.0 if road.slips else clip(T / max(self.T_max(w), 1e-9), -1, 1)

    def choose(self, T, w, road, gearbox, dt, T_acc, w_idle):
        p, G, eta = self.p, self.ratios[self.gear - 1], clip(gearbox.eta, 0.7, 1)
        w_e = gearbox.w_offered * road.ratio if (road.missed or road.slips) and dt <= 0.11 else w * G
        T_e = T / (eta * G)
        if not self.locked:
            w_t, most = w_e, max(w_idle, self.converter.pump("pump", self.engine.T_largest, w_e))
            w_e = clip(self.converter.pump("turbine", T_e, w_t), w_idle, most)
            T_e = self.converter.torques(w_e, w_t)[0]
        load = self.load(T_e + T_acc, w_e, road)
        gear, self.since = self.gear, self.since + dt
        if self.since - dt >= p.t_hold - 1e-6:
            if load < self.up(w_e, float(gear)):
                gear += 1
            elif load > self.down(w_e, float(gear)) and not (self.raised and self.since - dt < p.t_raised - 1e-6):
                gear -= 1
        gear = clip(gear, 1, len(self.ratios))
        if gear != self.gear:
            self.since, self.raised, self.gear = 0.0, gear > self.gear, gear
        G, before = self.ratios[gear - 1], self.able
        keeps = self.load(T / (eta * G) + T_acc, w * G, road) <= self.down(w * G, float(gear))
        self.able = bool(p.lockup[gear - 1]) and w * G > w_idle and keeps
        self.locked = self.able and before and not self.since < p.t_shift - 1e-6
        self.seen = {"shift.gear": gear, "shift.load": load, "shift.ratio": G, "shift.geared": float(self.locked)}
        return gear, G


class Cvt(Gearbox):
    def __init__(self, p):
        self.p, self.eta, self.w_offered = p, 0.0, 0.0
        self.map = Look(p.efficiency, p.efficiency_scale, p.speed_scale, p.torque_scale, 1.0)

    def loss(self, T, w, G, gear):
        if w <= 0:
            return 0.0
        e = clip(self.map(w * G, T / G, G), 1e-3, 1)
        return -T * (1 - e) / G if T < 0 else T * (1 - e) / e / G


class Locus:
    """The ratio at which the engine has the speed of least fuel for the power that was asked of it."""

    def __init__(self, p, ratios):
        self.p, self.ratios, self.locus, self.G = p, ratios, Look(p.omega_locus), ratios[0]

    def choose(self, T, w, cvt, engine, T_acc, dt):
        P = T * w / (cvt.eta if cvt.eta > 0 else 0.9) + T_acc * engine.own
        wanted = clip(self.locus(P) / max(w, 1e-3), self.ratios[1], self.ratios[0])
        most = 1 + self.p.rate * dt
        before, self.G = self.G, clip(wanted, self.G / most, self.G * most)
        self.change = (self.G - before) / self.G
        self.seen = {"shift.ratio": self.G}
        return self.G
