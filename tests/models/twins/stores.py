"""Stores besides the battery by its open-circuit voltage: each cell for itself, of which N in series make c strings."""

import math

from .electric import Battery
from .tables import Look, clip


class Cells:
    """`E` and `R` of a cell at the start of the step come from the subclass, and so does what leaves it."""

    def __init__(self, p, U_least):
        self.p, self.U_least, self.n = p, U_least, p.n_modules * p.capacity_scale
        self.T, self.soc = p.T_start, p.soc_start
        self.begin()
        self.U = p.n_modules * self.source()[0]

    def limits(self):
        p = self.p
        E, D_out, D_in = self.source()
        u_low = max(E / 2, self.U_least / p.n_modules, p.u_min)
        self.P_max = self.n * max(0.0, (E - u_low) * u_low / D_out) if self.soc > p.soc_empty else 0.0
        self.i_min = min(0.0, (E - p.u_max) / D_in)
        self.P_min = self.n * self.i_min * (E - self.i_min * D_in) if self.soc < p.soc_full else 0.0
        return self.P_max, self.P_min

    def available(self, P_asked, dt):
        p = self.p
        E, D_out, D_in = self.source()
        D = D_out if P_asked >= 0 else D_in
        power = 0.0 if self.soc >= p.soc_full and P_asked < 0 else min(P_asked, self.P_max) / self.n
        i = max((E - math.sqrt(max(E**2 - 4 * power * D, 0.0))) / (2 * D), self.i_min)
        u = E - D * i
        before = self.energy()
        heat = self.take(i, u, dt)
        R_th = p.R_th_fan + 1 / (2 * p.airflow * 1009) if self.T > p.T_fan else p.R_th_still
        stored = self.n * (before - self.energy()) / dt
        self.T += dt * (heat * p.capacity_scale - (self.T - p.T_ambient) / R_th) / (p.mass * p.c_p)
        self.soc = self.charge()
        self.U = p.n_modules * u
        self.seen |= {
            "battery.T": self.T, "battery.soc": self.soc, "battery.U": self.U, "battery.I": i * p.capacity_scale,
            "battery.P_stored": stored, "battery.P_loss": self.n * heat, "battery.P_out": self.n * u * i,
            "battery.P_battery_max": self.P_max, "battery.P_battery_min": self.P_min,
            "battery.P_discretisation": stored - self.n * (heat + u * i),
        }  # fmt: skip
        return self.n * u * i


class RCBattery(Cells):
    def begin(self):
        p = self.p
        self.u_oc, self.C_b, self.C_c = Look(p.u_oc), Look(p.C_bulk), Look(p.C_surface)
        self.R_e, self.R_c, self.R_t = Look(p.r_bulk), Look(p.r_surface), Look(p.r_terminal)
        self.v_b = self.v_c = self.u_oc(p.T_start, p.soc_start)

    def resistances(self):
        return (R(self.T, self.soc) for R in (self.R_e, self.R_c, self.R_t))

    def source(self):
        R_e, R_c, R_t = self.resistances()
        D = R_t + R_c * R_e / (R_e + R_c)
        return (R_c * self.v_b + R_e * self.v_c) / (R_e + R_c), D, D

    def energy(self):
        return (self.C_b(self.T) * self.v_b**2 + self.C_c(self.T) * self.v_c**2) / 2

    def take(self, i, u, dt):
        R_e, R_c, R_t = self.resistances()
        v_b, v_c = self.v_b, self.v_c
        i_e = (v_b - v_c + R_c * i) / (R_e + R_c)
        self.v_b += dt * (-v_b + v_c - R_c * i) / (self.C_b(self.T) * (R_e + R_c))
        self.v_c += dt * (v_b - v_c - R_e * i) / (self.C_c(self.T) * (R_e + R_c))
        self.seen = {"battery.v_bulk": self.v_b, "battery.v_surface": self.v_c}
        return i**2 * R_t + i_e**2 * R_e + (i_e - i) ** 2 * R_c

    def charge(self):
        socs = self.p.u_oc.points[1].tolist()
        volts = [self.u_oc(self.T, s) for s in socs]

        def inverse(v):
            if v <= volts[0]:
                return socs[0]
            for s_0, s_1, v_0, v_1 in zip(socs, socs[1:], volts, volts[1:], strict=False):
                if v < v_1:
                    return s_0 + (s_1 - s_0) * (v - v_0) / (v_1 - v_0)
            return socs[-1]

        return (20 * inverse(self.v_b) + inverse(self.v_c)) / 21


class Ultracapacitor(Cells):
    def begin(self):
        p = self.p
        self.C, self.R_out, self.R_in, self.eta = Look(p.C), Look(p.r_discharge), Look(p.r_charge), Look(p.eta_coulomb)
        self.v = p.soc_start * p.u_max

    def source(self):
        return self.v, self.R_out(self.T), self.R_in(self.T)

    def energy(self):
        return self.C(self.T) * self.v**2 / 2

    def take(self, i, u, dt):
        v, share = self.v, self.eta(self.T) if i < 0 else 1.0
        self.v -= dt * share * i / self.C(self.T)
        self.seen = {"battery.v": self.v}
        return v * share * i - u * i

    def charge(self):
        return clip(self.v / self.p.u_max, 0, 2)


def store_of(p, U_least):
    kind = RCBattery if hasattr(p, "C_bulk") else Ultracapacitor if hasattr(p, "C") else Battery
    return kind(p, U_least)
