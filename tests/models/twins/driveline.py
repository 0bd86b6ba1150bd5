"""Final drive, gearboxes, shift logic and clutch."""

from .tables import Look, clip


class FinalDrive:
    def __init__(self, p):
        self.p = p

    def required(self, T, w, alpha):
        i = self.p.i
        self.T_loss = (self.p.tau_loss if w * i > 0 else 0.0) + self.p.J * alpha * i
        return T / i + self.T_loss, w * i, alpha * i

    def available(self, T, w):
        self.seen = {"gearbox.tau": T, "gearbox.omega": w}
        return (T - self.T_loss) * self.p.i, w / self.p.i


class Gearbox:
    """Loss by an efficiency map, or by the polynomial of the Volkswagen gearbox where the parameters are its coefficients."""

    def __init__(self, p):
        self.p = p
        self.map = Look(p.efficiency, p.efficiency_scale, p.speed_scale, p.torque_scale, 1.0) if hasattr(p, "efficiency") else None
        # Of the step before, for the shift logic: output over input torque, and the speed that was offered at the input.
        self.eta, self.w_offered = 0.0, 0.0

    def loss(self, T, w, G, gear):
        p = self.p
        if w <= 0:
            return 0.0
        if self.map is None:
            w, T = w / p.speed_scale, abs(T) / p.torque_scale
            P = (p.c1 * G + p.c2) * w + (p.c3 / G + p.c4) * T + p.c5 * T * w + p.c6
            # The power fades to nothing below 0.2 rad/s, so that the torque stays finite.
            return max(0.0, P / max(w, 0.2) / G) * p.torque_scale
        e = clip(self.map(max(w, p.omega_lookup), T, float(gear)), p.e_lowest, 1)
        if T < 0:
            return -T * (1 - e) / G
        return T * (1 - e) / e / G if e > 0 else T * G

    def required(self, T, w, alpha, gear, G, shifting):
        self.G, self.T_out, self.T_J = G, T, self.p.J * alpha * G
        self.T_in = T / G + self.loss(T, w, G, gear)
        self.eta = T / G / self.T_in if w > 0 and T * self.T_in > 0 else 0.0
        self.seen = {"gearbox.tau_required": T, "gearbox.omega_required": w}
        return 0.0 if shifting else self.T_in + self.T_J, w * G, alpha * G

    def available(self, T, w):
        self.w_offered = w
        T -= self.T_J
        # The loss keeps its share of the input torque; where that is no ratio, or more came than was sent for, its size.
        share = min(abs(T / self.T_in), 1.0) if self.T_out * self.T_in > 0 else 1.0
        return self.G * T - share * (self.G * self.T_in - self.T_out), w / self.G


class FixedGear:
    def __init__(self, ratios):
        self.G = ratios[0]

    def choose(self, T, w, road, gearbox, dt, T_acc=0.0):
        return 1, self.G, False


class Shift:
    """Gear by load and speed; `T_max` is the machine's envelope, without overtorque."""

    def __init__(self, p, ratios, T_max):
        self.p, self.ratios, self.T_max, self.up, self.down = p, ratios, T_max, Look(p.up), Look(p.down)
        self.gear, self.raised, self.since = round(p.gear_start), False, 15.0

    def choose(self, T, w, road, gearbox, dt, T_acc=0.0):
        p, G = self.p, self.ratios[self.gear - 1]
        w_e = gearbox.w_offered * road.ratio if (road.missed or road.slips) and dt <= 0.11 else w * G
        T_e = T / (clip(gearbox.eta, 0.2, 1) * G) + T_acc
        load = 1.0 if road.slips else clip(T_e / max(self.T_max(w_e), 1e-9), 0, 1)
        held = self.since < p.t_hold - 1e-6
        up = not held and load < self.up(w_e, float(self.gear))
        down = not held and not up and load > self.down(w_e, float(self.gear))
        if self.raised and self.since < p.t_raised - 1e-6:
            down = False
        new = clip(self.gear + up - down, 1, len(self.ratios))
        self.since += dt
        if new != self.gear:
            self.since, self.raised, self.gear = 0.0, new > self.gear, new
        shifting = self.since < p.t_shift - 1e-6
        self.w_estimate = w_e
        self.seen = {"shift.gear": new, "shift.load": load, "shift.ratio": self.ratios[new - 1], "shift.shifting": float(shifting)}
        return new, self.ratios[new - 1], shifting


OPEN, SLIPPING, ENGAGED = 1, 2, 3


class Clutch:
    def __init__(self, T_largest, w_launch):
        self.T_largest, self.w_launch = T_largest, w_launch

    def required(self, T, w, state):
        self.state, self.w_out = state, w
        self.seen = {"clutch.tau_required": T, "clutch.omega_required": w}
        return 0.0 if state == OPEN else T, self.w_launch if state == SLIPPING else w

    def available(self, T, w):
        # A slipping clutch drives only: at launch the engine's side turns faster.
        T = 0.0 if self.state == OPEN else clip(T, 0.0 if self.state == SLIPPING else -self.T_largest, self.T_largest)
        w = w if self.state == ENGAGED else self.w_out
        self.seen |= {"clutch.tau": T, "clutch.omega": w}
        return T, w
