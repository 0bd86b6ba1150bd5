"""The engine, behind a clutch and in a genset, and what hangs on its shaft."""

from .tables import Look, clip


class MechanicalAccessories:
    def __init__(self, p):
        self.p, self.T = p, 0.0

    def required(self, T, w_engine, w_idle, on):
        p = self.p
        # The torque is a memory too: shift logic and free spinning take that of the step before.
        self.T = p.tau_on + p.P_on / (p.eta * max(w_engine, w_idle, 1e-3)) if on and w_engine > 1e-9 else 0.0
        return T + self.T

    def available(self, T):
        return T - self.T


class Engine:
    """`J_shaft` is what else turns with it while it spins by itself."""

    def __init__(self, p, w_start=0.0, J_shaft=0.0):
        self.p = p
        s, q = p.speed_scale, p.torque_scale
        self.T_max, self.T_closed, self.fuel = (
            Look(p.tau_max, q, s),
            Look(p.tau_closed, q, s),
            Look(p.fuel, s * q / p.efficiency_scale, s, q),
        )
        self.w_top, self.T_largest = s * float(p.tau_max.points[0][-1]), q * float(p.tau_max.values.max())
        self.P_largest = s * q * max(T * w for T, w in zip(p.tau_max.values.tolist(), p.tau_max.points[0].tolist(), strict=True))
        self.J, self.J_shaft = p.J, J_shaft
        # Speed that the rotor has reached, that of the free engine, the command and the gear's ratio of the step before.
        self.own, self.free, self.command, self.G, self.fuel_used = w_start, w_start, w_start, 1.0, 0.0

    def spun(self, w_c, T_acc, dt):
        """Return the speed that an engine without load reaches on its way to the command."""
        J = max(self.J + self.J_shaft, 1e-6)
        T = clip(J * (w_c - self.own) / dt + T_acc, self.T_closed(self.own), self.T_max(self.own))
        self.free = max(self.free + dt * (T - T_acc) / J, 0.0)
        return self.free

    def geared_speed(self, w_c, w_idle, on, clutch_open, clutch_slips, T_acc, G, road, dt):
        """Return the speed of this step behind a clutch; `T_acc` is the accessories' torque in the step before."""
        spun = self.spun(w_c, T_acc, dt)
        w = spun if clutch_open else self.command * road.ratio * G / self.G if road.missed and not clutch_slips else w_c  # (10)
        w = max(min(w, self.w_top), w_idle * on)
        self.free, self.command, self.G, self.w_c = spun if clutch_open else w, w_c, G, w_c
        self.w = w
        return w

    def geared(self, T_req, w_shaft, on, clutch_open, clutch_slips, road, dt, ratio_change=0.0):
        """Return the torque that is available behind a clutch, and the speed."""
        w, highest, closed = self.w, self.T_max(self.w) if on else 0.0, self.T_closed(self.w)
        # What the vehicle's gain of speed asks of the rotor; load and rotor get the same share where it is too much.
        gain = 2 * (road.v_lim - road.v) / max(road.v_lim, 1e-9) + ratio_change
        T_J = 0.0 if clutch_slips else self.J * w_shaft * gain / dt
        T = T_req * highest / (T_req + T_J) if T_req + T_J > highest else max(T_req, closed - T_J)
        T = T_req if clutch_open else T
        T_map = closed if clutch_open and w > self.w_c + 1e-9 else T_req + self.J * (w - self.own) / dt
        self.burn(T, clip(T_map, closed, highest), on, clutch_open, dt)
        w_a = w if clutch_open else min(w_shaft, self.w_top)
        self.seen |= {"engine.omega": w_a}
        return T, w_a

    def behind_oil(self, w_c, w_idle, on, G, dt):
        """Return the speed of this step against a converter that is not locked."""
        w = min(w_c, self.own + dt * self.T_max(self.own) / max(self.J, 1e-6), self.w_top)
        self.w = max(w, w_idle * on)
        self.free, self.command, self.G, self.w_c = self.w, w_c, G, w_c
        return self.w

    def against_oil(self, T_req, on, dt):
        """Return torque and speed there: the rotor comes first."""
        highest, closed = self.T_max(self.w) if on else 0.0, self.T_closed(self.w)
        T_J = self.J * (self.w - self.own) / dt
        T = max(highest - T_J, 0.0) if T_req + T_J > highest else max(T_req, closed - T_J)
        self.burn(T, clip(T_req + T_J, closed, highest), on, False, dt)
        self.seen |= {"engine.omega": self.w}
        return T, self.w

    def genset(self, T_req, w_c, on, ready, dt):
        """Return torque and speed at the shaft of a generator."""
        if ready:
            w = clip(min(w_c, self.own + dt * self.T_max(self.own) / (self.J + self.J_shaft)), 0, self.w_top)
            self.free = w
        else:
            w = min(self.spun(w_c, 0.0, dt), self.w_top)
        highest, closed, rate = self.T_max(w) if on else 0.0, self.T_closed(w), (w - self.own) / dt
        T_rotor, T_J = self.J_shaft * rate, self.J * rate
        # It turns the generator's rotor along: with that alone while it spins, shut where it is too fast, else with that at least.
        T_req = max(T_req, T_rotor) if ready else T_rotor
        if not ready:
            T, T_map = T_req, closed if w > w_c + 1e-9 else T_req + T_J
        elif T_req + T_J > highest:
            T, T_map = max(highest - T_J, T_rotor), highest
        else:
            T, T_map = max(T_req, closed - T_J), T_req + T_J
        self.w = w
        self.burn(T, clip(T_map, closed, highest), on, not ready, dt)
        self.seen |= {"engine.omega": w}
        return T, w

    def burn(self, T, T_map, on, free, dt):
        # The rotor follows a jump of speed with the torque that the load leaves.
        own, w = self.own, self.w
        self.own = w if free else clip(own + dt * (T_map - T) / max(self.J, 1e-6), min(w, own), max(w, own))
        flow = self.fuel(w, T_map) if on else 0.0
        self.fuel_used += dt * flow
        self.seen = {
            "engine.omega_engine": w, "engine.tau": T, "engine.tau_map": T_map, "engine.fuel_flow": flow,
            "engine.fuel_used": self.fuel_used, "engine.P_fuel": flow * self.p.H_fuel,
            "engine.P_kinetic": self.J * (self.own**2 - own**2) / 2 / dt,
        }  # fmt: skip
