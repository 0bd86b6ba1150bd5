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
        self.p, C, R = p, Look(p.capacity, p.capacity_scale), Look(p.torque_ratio)
        ratios = p.capacity.points[0].tolist()
        self.curves = {}
        for name, factors in (("pump", [C(n) for n in ratios]), ("turbine", [C(n) * R(n) for n in ratios])):
            rows = []
            for n, f in zip(ratios, factors, strict=True):
                # A stalled pump at unit speed has the length 1 on the axis of torques, a turbine at that speed on the axis of speeds.
                length = math.hypot(n, math.sqrt(abs(f) / factors[0]))
                rows.append((n / length if f >= 0 else 2 - n / length, 1 / length))
            self.curves[name] = factors[0], *zip(*rows, strict=True)
        self.ratios, self.R = ratios, [R(n) for n in ratios]
        self.w_out = 0.0

    def place(self, side, T, w):
        """Return the length of the point (torque of one side, turbine's speed), and where it lies on that side's curve."""
        length = math.sqrt(w**2 + abs(T) / self.curves[side][0] + 1e-6)
        return length, w / length if T >= 0 else 2 - w / length

    def pump(self, side, T, w):
        """Return the pump's speed at the turbine's speed and the torque of one side."""
        length, place = self.place(side, T, w)
        return length * between(*self.curves[side][1:], place)

    def at_pump(self, T, w):
        """Return the pump's torque at a point of the turbine; beyond the data the ratio of torques stays."""
        places = self.curves["turbine"][1]
        return T / between(places, self.R, clip(self.place("turbine", T, w)[1], places[0], places[-1]))

    def torques(self, w_pump, w):
        """Return the torques of pump and turbine at their speeds: the curve backward, on the piece that the ratio of speeds falls in."""
        stall, _, lengths = self.curves["turbine"]
        length = w_pump * between(self.ratios, [1 / x for x in lengths], w / max(w_pump, 1.0))
        T = stall * (length**2 - w**2 - 1e-6) * (1 if w <= max(w_pump, 1.0) else -1)
        return self.at_pump(T, w), T

    def reached(self, T, engine, w, w_idle, dt):
        """Return the speed at the end of a step in which the engine brings this torque, the accessories' taken off, to the pump."""
        end = clip(self.pump("pump", T, w), w_idle, engine.w_top)
        gap = end - engine.own
        slope = max((T - self.torques(engine.own, w)[0]) * gap, 0.0) / (gap**2 + 0.1**2)
        # Implicit: J (w - own) / dt = slope (end - w).
        return max((engine.J / dt * engine.own + slope * end) / (engine.J / dt + slope), w_idle)

    def brought(self, T, w, engine, w_idle, T_acc, dt):
        """Return the torque of the turbine, cut to what the engine can bring in a step, and the pump's torque and speed."""

        def misses(w_pump, T_pump):
            """Return what the engine has too little of (> 0), or must give more than asked (< 0), to come to a speed."""
            T_e = T_pump + T_acc + engine.J * (w_pump - engine.own) / dt
            return max(T_e - engine.T_max(w_pump), 0.0) + min(T_e - engine.T_closed(w_pump), 0.0)

        w_p = self.pump("turbine", T, w)
        if w_idle <= w_p <= engine.w_top and not misses(w_p, self.at_pump(T, w)):
            return T, self.at_pump(T, w), w_p
        w_p = clip(w_p, w_idle, engine.w_top)
        miss = misses(w_p, self.torques(w_p, w)[0])
        if miss > 0:
            first = clip(self.pump("pump", engine.T_max(engine.own) - T_acc, w), w_idle, engine.w_top)
            w_p = min(w_p, self.reached(engine.T_max(first) - T_acc, engine, w, w_idle, dt))
        elif miss < 0:
            w_p = max(w_p, self.reached(engine.T_closed(engine.own) - T_acc, engine, w, w_idle, dt))
        T_p, T = self.torques(w_p, w)
        return T, T_p, w_p

    def required(self, T, w, G, locked, is_open, engine, road, w_idle, T_acc, dt):
        self.locked, self.is_open, self.w = locked, is_open, w
        w_t = self.w_out * road.ratio * G if road.missed and not (locked or is_open) else w  # (10)
        self.w_out = w / G
        self.seen = {"converter.tau_required": T, "converter.omega_required": w}
        T_p, w_p = T, w
        if is_open:
            T = T_p = 0.0
        elif not locked:
            T, T_p, w_p = self.brought(T, w_t, engine, w_idle, T_acc, dt)
        self.T_cut = T
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
            w_t, w_e = w_e, self.converter.pump("turbine", T_e, w_e)
            T_e = self.converter.at_pump(T_e, w_t)
            if T_e > self.engine.T_largest:
                w_e = min(w_e, self.converter.pump("pump", self.engine.T_largest, w_t))
            if w_e < w_idle:
                w_e, T_e = w_idle, self.converter.torques(w_idle, w_t)[0]
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
