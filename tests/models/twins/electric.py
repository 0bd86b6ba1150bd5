"""Motor, generator, accessories, bus and battery."""

import math

from .tables import Look, clip, ratio


class Motor:
    """Numbers of the equations are those of the paper."""

    def __init__(self, p):
        self.p = p
        s, q = p.speed_scale, p.torque_scale
        self.top, self.P = p.omega_max * s, Look(p.P_electric, s * q, s, q)
        self.T_max, self.T_min = (Look(t, q, s) for t in (p.tau_max, p.tau_min))
        self.w_lim = 0.0

    def required(self, T, w, alpha, U_before, road, shifting=False):
        p, w_before = self.p, self.w_lim
        self.w_lim, self.T_J = clip(w, 0, self.top), p.J * alpha  # (8)
        w_map = min(w_before * road.ratio, self.top) if road.missed else self.w_lim  # (10)
        T_lim = clip(T + self.T_J, p.overtorque * self.T_min(w_map), p.overtorque * self.T_max(w_map))  # (9)
        on = self.w_lim > 1e-3 and not shifting
        self.T_map = T_lim if on else 0.0
        P = self.P(w_map, T_lim) if on else 0.0  # (7)
        self.P_map = P / p.efficiency_scale if P >= 0 else P * p.efficiency_scale
        self.P_r = clip(self.P_map, -p.I_max * U_before, p.I_max * U_before)  # (6)
        self.seen = {
            "motor.tau_required": T, "motor.omega_required": w, "motor.tau_limited": T_lim, "motor.P_map": self.P_map,
            "motor.P_in_required": self.P_r,
        }  # fmt: skip
        return self.P_r

    def available(self, P):
        T = self.T_map * clip(ratio(P, self.P_map), 0, 1) - self.T_J  # (11)
        self.seen |= {"motor.P_in": P, "motor.tau": T, "motor.omega": self.w_lim}
        return T, self.w_lim


class Generator:
    def __init__(self, p):
        self.p = p
        s, q = p.speed_scale, p.torque_scale
        self.top, self.P, self.T_max = p.omega_max * s, Look(p.P_electric, s * q, s, q), Look(p.tau_max, p.overtorque * q, s)
        self.w_before = 0.0

    def power(self, T, w):
        return self.P(w, T)

    def available(self, T, w, U_before, dt):
        w_lim = clip(w, 0, self.top)
        T_rotor = min(T - self.p.J * (w - self.w_before) / dt, self.T_max(w_lim))
        P = clip(self.P(w_lim, T_rotor), 0, self.p.I_max * U_before)
        self.w_before = w
        self.seen = {"generator.P_in": T * w, "generator.P_out": P}
        return P


class Accessories:
    def __init__(self, p, role="accessories"):
        self.p, self.role = p, role

    def required(self, P, key_on):
        self.P_load, self.P_acc = P, self.p.P_on / self.p.eta if key_on else 0.0
        return P + self.P_acc

    def available(self, P):
        # Served first, but only with what the bus and a braking load offer.
        served = clip(P - min(self.P_load, 0.0), 0.0, self.P_acc)
        self.seen = {f"{self.role}.P_in": P, f"{self.role}.P_out": P - served}
        return P - served


class Bus:
    def required(self, P, P_generator):
        self.P_bus, self.P_generator = P, P_generator
        self.seen = {"bus.P_bus": P}
        return P - P_generator

    def available(self, P):
        # Never more than was asked for; nobody takes what a generator brings beyond that and the pack refuses.
        given = min(P + self.P_generator, max(self.P_bus, 0.0))
        self.seen |= {"bus.P_out": given, "bus.P_loss": P + self.P_generator - given}
        return given


class Battery:
    """`U_least` is the lowest voltage of what it feeds."""

    def __init__(self, p, U_least):
        self.p, self.U_least = p, U_least
        N, c = p.n_modules, p.capacity_scale
        self.U_oc, self.Q, self.eta = Look(p.u_oc, N), Look(p.Q, c), Look(p.eta_coulomb)
        self.R_out, self.R_in = Look(p.r_discharge, N / c), Look(p.r_charge, N / c)
        self.T, self.drawn = p.T_start, (1 - p.soc_start) * self.Q(p.T_start)
        self.soc, self.U = p.soc_start, self.U_oc(p.T_start, p.soc_start)

    def limits(self):
        """Find and return the largest discharging and charging power at the start of the step."""
        p, N, T, soc = self.p, self.p.n_modules, self.T, self.soc
        U_oc, R_in = self.U_oc(T, soc), self.R_in(T, soc)
        U_low = max(0.5 * U_oc, self.U_least, N * p.u_min)
        self.P_max = max(0.0, (U_oc - U_low) * U_low / self.R_out(T, soc)) if soc > p.soc_empty else 0.0
        self.I_min = min(0.0, (U_oc - N * p.u_max) / R_in)
        self.P_min = self.I_min * (U_oc - self.I_min * R_in) if soc < p.soc_full else 0.0
        return self.P_max, self.P_min

    def available(self, P_asked, dt):
        p, N = self.p, self.p.n_modules
        U_oc, R = self.U_oc(self.T, self.soc), self.R_out(self.T, self.soc) if P_asked >= 0 else self.R_in(self.T, self.soc)
        P = 0.0 if self.soc >= p.soc_full and P_asked < 0 else min(P_asked, self.P_max)
        # At half of U_oc, where the power is largest, rounding would decide on the root; the step keeps it above 1e-6 U_oc.
        root = math.sqrt(max(U_oc**2 - 4 * R * P, 1e-12 * U_oc**2))
        I = max(2 * P / (U_oc + root), self.I_min)  # noqa: E741
        self.U = U_oc - R * I
        eta = 1.0 if I >= 0 else self.eta(self.T)
        P_given, stored = self.U * I, U_oc * eta * I
        heat = R * I**2 if I >= 0 else R * I**2 - U_oc * I * (1 - eta)
        R_th = p.R_th_fan + 1 / (2 * p.airflow * 1009) if self.T > p.T_fan else p.R_th_still
        self.drawn += dt * eta * I
        self.T += dt * (heat / N - (self.T - p.T_ambient) / R_th) / (p.mass * p.c_p)
        capacity = self.Q(self.T)
        self.soc = clip((capacity - self.drawn) / capacity, 0, 1)
        self.seen = {
            "battery.charge_drawn": self.drawn, "battery.T": self.T, "battery.soc": self.soc, "battery.U": self.U, "battery.I": I,
            "battery.P_stored": stored, "battery.P_loss": heat, "battery.P_out": P_given, "battery.P_battery_max": self.P_max,
            "battery.P_battery_min": self.P_min,
        }  # fmt: skip
        return P_given
