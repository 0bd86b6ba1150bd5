"""Controls: the conventional car's clutch and engine, and the genset of a series hybrid."""

from .driveline import ENGAGED, OPEN, SLIPPING
from .tables import Look, clip


class ConventionalControl:
    def __init__(self, p, engine, v_start=0.0):
        self.p, self.engine = p, engine
        self.w_idle, self.w_launch = p.omega_idle * p.idle_at_stop, max(p.launch_share * engine.w_top, 1.5 * p.omega_idle)
        self.clutch, self.on = ENGAGED if v_start > 0 else OPEN, True

    def decide(self, T, w, w_estimate, shifting, key_on):
        """Return state of the clutch, engine on, and the engine's speed command."""
        p, asked = self.p, T > 1e-3
        if shifting or (not asked and (p.open_when_braking or w_estimate < p.omega_idle)):
            clutch = OPEN
        else:
            clutch = SLIPPING if asked and max(w_estimate, w) < self.w_launch and self.clutch != ENGAGED else ENGAGED
        self.on = bool(key_on and (p.idle_at_stop or clutch != OPEN)) or (shifting and self.on)
        self.clutch = clutch
        w_c = clip(self.w_launch if clutch == SLIPPING else w, self.w_idle, self.engine.w_top) if self.on else 0.0
        self.seen = {"control.clutch_state": clutch, "control.engine_on": float(self.on), "control.omega_command": w_c}
        return clutch, self.on, w_c


class SeriesControl:
    """Thermostat and power follower."""

    def __init__(self, p, engine, generator):
        self.p, self.generator = p, generator
        s, sq = engine.p.speed_scale, engine.p.speed_scale * engine.p.torque_scale
        self.w_of, ends = Look(p.omega_locus, s, sq), p.omega_locus.points[0]
        self.P_low, self.P_high = sq * float(ends[0]), sq * float(ends[-1])
        self.P_least, self.P_most = p.P_min_share * engine.P_largest, p.P_max_share * engine.P_largest
        self.on, self.t_on, self.t_off, self.P, self.turned = bool(p.on_start), p.on_start, 0.0, None, False
        # The demand of the last five seconds, in five parts, and the part that is being filled.
        self.parts, self.time, self.energy = [0.0] * 5, 0.0, 0.0

    def decide(self, P_bus, soc, P_max, P_min, key_on, dt):
        """Return engine on, whether the genset is ready, its speed command and its torque."""
        p = self.p
        middle, half = (p.soc_high + p.soc_low) / 2, (p.soc_high - p.soc_low) / 2
        short = P_bus >= P_max

        # Power that supplies the bus through the generator, and power that charges.
        P_1 = clip(P_bus, self.P_low, self.P_high)
        w_1 = self.w_of(P_1)
        eta = self.generator.power(P_1 / w_1, w_1) / P_1
        P_asked = P_1 / max(eta, 1e-6) if P_bus > 0 else 0.0
        P_charge = p.P_charge * clip((middle - soc) / half, -1, 1)
        P_asked += P_charge if P_bus > 0 else min(P_bus - P_min, P_charge)

        # Normal range and slew.
        P = max(P_asked, self.P_least)
        if soc >= p.soc_low and not short:
            P = min(P, self.P_most)
        if self.P is not None:
            P = clip(P, self.P - p.P_fall * dt, self.P + p.P_rise * dt)
        self.P = P

        # On or off.
        self.t_off += dt
        restart = self.t_off >= p.t_off_min - 1e-9 and sum(self.parts) / 5 >= 1.2 * self.P_least
        wanted = (self.on or restart or soc <= p.soc_low) and (soc <= p.soc_high or P_asked >= self.P_least)
        if p.charge_depleting and soc > middle:
            wanted = False
        no_room = self.P_least > P_bus - P_min and P_bus < 0
        on = bool(key_on) and (wanted or short) and not no_room
        if self.on and not on:
            self.t_off = -dt  # The step after a stop counts from 0.
        self.energy, self.time = self.energy + P_asked * dt, self.time + dt
        if self.time >= 1 - 1e-9:
            self.parts, self.energy, self.time = [self.energy, *self.parts[:4]], 0.0, 0.0

        # Operating point; in the first half second, at least one step, the engine spins up.
        P_g = clip(P, self.P_low, self.P_high)
        w_g = self.w_of(P_g)
        w_c = (w_g if self.turned else w_g / 2) if on else 0.0
        ready = on and self.t_on >= 0.5 - 1e-9
        self.on, self.turned, self.t_on = on, on, self.t_on + dt if on else 0.0
        T = P_g / w_g if ready else 0.0
        self.seen = {
            "control.engine_on": float(on), "control.clutch_open": float(not ready), "control.omega_command": w_c, "control.tau_genset": T,
            "control.P_engine_request": P_asked,
        }  # fmt: skip
        return on, ready, w_c, T
