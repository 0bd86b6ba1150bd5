"""The power split by hand: plain numbers, the step as one read of the equations, no faces and no links.

Written from the block diagrams of the original, with the departures that halfshaft documents: those of the electric car, a
generator whose torque counts at the ring, a motor that makes up for what the generator's envelope leaves, an engine that slows
down no faster than closed throttle allows, and speeds of the sun and the engine's limits that follow what the ring has reached
after a missed trace.  Flat road, front drive, no limit of the brakes themselves.
"""

import math
import runpy
from pathlib import Path

import numpy as np

_HAND = runpy.run_path(str(Path(__file__).with_name("twin.py")))
look, clip = _HAND["look"], _HAND["clip"]


class Machine:
    """A motor, or a generator that is its own mirror image backward."""

    def __init__(self, p):
        self.p, self.top = p, p.omega_max * p.speed_scale

    def limits(self, w):
        p = self.p
        return tuple(p.overtorque * p.torque_scale * look(t, w / p.speed_scale) for t in (p.tau_min, p.tau_max))

    def ask(self, T, w, alpha, U, w_map=None):
        """Return torque and power within all limits of the machine; `T` is that of the load."""
        p, side = self.p, -1 if w < 0 else 1
        self.side, self.T_J, self.w = side, p.J * alpha * side, min(abs(w), self.top)
        w_map = self.w if w_map is None else min(w_map, self.top)
        lowest, highest = self.limits(w_map)
        self.T = clip(side * T + self.T_J, lowest, highest)
        self.P_map = 0.0
        if self.w > 1e-3:
            s, q = p.speed_scale, p.torque_scale
            self.P_map = s * q * look(p.P_electric, w_map / s, self.T / q)
            self.P_map *= 1 / p.efficiency_scale if self.P_map >= 0 else p.efficiency_scale
        else:
            self.T = 0.0
        return clip(self.P_map, -p.I_max * U, p.I_max * U)

    def able(self):
        return self.side * (self.T - self.T_J)

    def give(self, P):
        share = clip(P / self.P_map, 0, 1) if self.P_map != 0 else 0.0
        return self.side * ((self.T if P == self.P_map else self.T * share) - self.T_J)


def drive(parameters, samples):
    """Return a record of every step; `parameters` are the vehicle's sets by role."""
    body, wheel, final, gear, eng, acc, pack, ctl = (
        parameters[r] for r in ("body", "wheel", "final_drive", "gear", "engine", "accessories", "battery", "control")
    )
    motor, generator = Machine(parameters["motor"]), Machine(parameters["generator"])
    m, W, aero, r = body.m, body.m * body.g, 0.5 * body.rho * body.c_d * body.A, wheel.r
    N, h, mu = pack.n_modules, body.h / body.wheelbase, wheel.mu_max
    teeth, to_ring = gear.r / gear.s, gear.r / (gear.r + gear.s)
    to_sun = 1 - to_ring
    S, Q = eng.speed_scale, eng.torque_scale
    J_e = max(eng.J, 1e-6)
    engine_top = S * eng.tau_max.points[0][-1]

    def T_max(w):
        return Q * look(eng.tau_max, w / S)

    def T_closed(w):
        return Q * look(eng.tau_closed, w / S)

    def best(P):
        return S * look(ctl.omega_best, P / S / Q)

    drawn = (1 - pack.soc_start) * pack.capacity_scale * look(pack.Q, pack.T_start)
    soc, T, v, v_lim_before = pack.soc_start, pack.T_start, samples.v_start, samples.v_start
    missed, ratio, w_motor_before, w_reached, a_reached = False, 0.0, 0.0, 0.0, 0.0
    own, on, off_for, fuel = 0.0, False, 0.0, 0.0
    U = N * look(pack.u_oc, T, soc)
    records = []
    for v_request, key, dt in zip(samples.v.tolist(), samples.key_on.tolist(), samples.dt.tolist(), strict=True):
        # What the request needs, and the grip of the front axle (drag with v_end^2 = v v_end).
        vbar, a = (v + v_request) / 2, (v_request - v) / dt
        F = m * a + W * (wheel.f_0 + wheel.f_1 * vbar) + aero * vbar**2 if vbar > 0 else 0.0
        rest = -W * wheel.f_0 - 0.5 * W * wheel.f_1 * v - 0.25 * aero * v**2 + m * v / dt
        slope = 0.75 * aero * v + 0.5 * W * wheel.f_1 + m / dt
        v_top = (mu * body.front_share * W + rest + mu * h * m * v / dt) / (slope + mu * h * m / dt)
        v_low = (-mu * body.front_share * W + rest - mu * h * m * v / dt) / (slope - mu * h * m / dt)
        v_lim = clip(vbar, (v_low + v) / 2, (v_top + v) / 2)
        W_f = body.front_share * W - h * m * 2 * (v_lim - v) / dt
        F_lim = clip(F, -mu * W_f, mu * W_f)

        # Wheel and final drive.
        regen, front = look(wheel.share_driveline, vbar), look(wheel.share_front, vbar)
        rear = clip(1 - regen - front, 0, 1)
        F_axle, F_drive = (F_lim, F_lim) if F_lim >= 0 else (F_lim * (1 - rear), F_lim * regen)
        rolls = (1 + math.copysign(look(wheel.slip, abs(F_axle) / W_f), F_axle)) / r
        w, w_alpha = v_lim * rolls, (v_lim - v_lim_before) / dt * rolls
        T_wheel = (look(wheel.tau_bearing, m) if w > 0 else 0.0) + wheel.J * w_alpha
        T_final = (final.tau_loss if w > 0 else 0.0) + final.J * w_alpha * final.i
        T_R, w_R, a_R = (F_drive * r + T_wheel) / final.i + T_final, w * final.i, w_alpha * final.i

        # The control: on or off, power, speed, torque.
        P_R = T_R * w_R
        wanted = P_R >= ctl.P_on or v >= ctl.v_on or soc <= ctl.soc_on
        on = bool(key) and wanted and (on or off_for >= ctl.t_off_min - 1e-9)
        off_for = 0.0 if on else off_for + dt
        w_K, a_K = (w_reached, a_reached) if missed else (w_R, a_R)
        all_out = on and P_R > ctl.P_full
        P = P_R + ctl.I_charge * (ctl.soc_target - soc) * U / ctl.eta_charge if on else 0.0
        w_most = min(to_ring * w_K + to_sun * generator.top, engine_top)
        w_least = to_ring * w_K - to_sun * generator.top
        w_least = max(w_least, ctl.omega_lowest) if w_least > 0 else 0.0
        w_best = best(P)
        w_best = best(P + w_best * eng.J * (w_best - own) / max(dt, ctl.t_inertia))
        w_c = w_most if all_out else max(clip(w_best, w_least, w_most), ctl.omega_lowest)
        J_all = max(eng.J + generator.p.J * (1 + teeth) ** 2, 1e-6)
        w_c = max(w_c if on else 0.0, own + dt * T_closed(own) / J_all)
        w_S = abs((1 + teeth) * w_c - teeth * w_K)
        g = generator.p
        T_most = min(T_max(w_c), g.torque_scale * look(g.tau_max, w_S / g.speed_scale) / to_sun)
        T_c = (T_most if all_out else min(P / max(w_c, ctl.omega_lowest), T_most)) if on else 0.0

        # The engine: within its torque, the rest speeds its rotor up.
        w_E = max(min(w_c, own + dt * T_max(own) / J_e, engine_top), 0.0)
        T_rotor, T_open = eng.J * (w_E - own) / dt, T_max(w_E) if on else 0.0
        T_E = max(T_open - T_rotor, 0.0) if T_c + T_rotor > T_open else max(T_c, T_closed(w_E) - T_rotor)
        T_burn = clip(T_c + T_rotor, T_closed(w_E), T_open)
        a_E = (w_E - own) / dt
        own = clip(own + dt * (T_burn - T_E) / J_e, min(w_E, own), max(w_E, own))
        flow = S * Q / eng.efficiency_scale * look(eng.fuel, w_E / S, T_burn / Q) if on else 0.0
        fuel += dt * flow

        # The gear: the sun carries its share, the motor what the ring lacks.
        w_S, a_S = (1 + teeth) * w_E - teeth * w_K, (1 + teeth) * a_E - teeth * a_K
        P_g = generator.ask(-to_sun * T_E, w_S, a_S, U)
        P_m = motor.ask(T_R + teeth * generator.able(), w_R, a_R, U, w_motor_before * ratio if missed else None)
        P_acc = acc.P_on / acc.eta if key else 0.0
        P_bus = P_m + P_g + P_acc

        # The battery, within its window.
        U_oc = N * look(pack.u_oc, T, soc)
        R_out, R_in = (N / pack.capacity_scale * look(t, T, soc) for t in (pack.r_discharge, pack.r_charge))
        U_min = max(0.5 * U_oc, motor.p.U_min, g.U_min, N * pack.u_min)
        P_max = max(0.0, (U_oc - U_min) * U_min / R_out) if soc > pack.soc_empty else 0.0
        I_min = min(0.0, (U_oc - N * pack.u_max) / R_in)
        P_out, R = min(P_bus, P_max), R_out if P_bus >= 0 else R_in
        P_out = 0.0 if soc >= pack.soc_full and P_bus < 0 else P_out
        current = 2 * P_out / (U_oc + math.sqrt(max(U_oc**2 - 4 * R * P_out, 0)))
        limited, current = P_out != P_bus or current < I_min, max(current, I_min)
        U = U_oc - R * current
        P_pack = U * current if limited else P_bus
        eta = 1.0 if current >= 0 else look(pack.eta_coulomb, T)
        stored = U_oc * eta * current
        R_th = pack.R_th_fan + 1 / (2 * pack.airflow * 1009) if T > pack.T_fan else pack.R_th_still
        drawn += dt * eta * current
        T += dt * ((stored - U * current) / N - (T - pack.T_ambient) / R_th) / (pack.mass * pack.c_p)
        capacity = pack.capacity_scale * look(pack.Q, T)
        soc = clip((capacity - drawn) / capacity, 0, 1)

        # And back: the accessories first; what is missing or too much is the motor's while it has any, else the generator's.
        P_both = P_pack - clip(P_pack - min(P_m + P_g, 0.0), 0.0, P_acc) if limited else P_m + P_g
        missing = P_m + P_g - P_both
        P_m_a = P_m - (min(missing, max(P_m, 0.0)) if missing >= 0 else max(missing, min(P_m, 0.0)))
        P_g_a = P_g if missing == 0 else P_both - P_m_a
        T_S, T_M, w_a = generator.give(P_g_a), motor.give(P_m_a), motor.w
        F_dl = (((T_M - teeth * T_S) - T_final) * final.i - T_wheel) / r
        F_friction = min(0.0, F_lim - F_dl) if F_lim < 0 else 0.0
        F_rear = -min(-F_friction * (1 - clip(front / (1 - regen), 0, 1)), mu * (W - W_f))
        F_front = -min(F_rear - F_friction, mu * W_f + F_dl)
        F_a, F_axle = F_dl + F_front + F_rear, F_dl + F_front
        v_w = r * w_a / final.i / (1 + math.copysign(look(wheel.slip, abs(F_axle) / W_f), F_axle))
        v_a = v_w if abs(w - w_a / final.i) > 1e-3 else v_lim

        # The speed that the force gives, bounded by that of the driveline.
        B = 2 * m / dt + W * wheel.f_1 * (v_a > 0)
        C = -2 * m * v / dt - max(F_a, -70 * m) + W * wheel.f_0 * (v_a > 0)
        v_force = (-B + math.sqrt(B**2 - 4 * aero * C)) / (2 * aero)
        v_m = max(v_force, v_a) if F_a < -m and v_request < v else min(v_force, v_a)
        v_end = 2 * v_m - v if 2 * v_m - v >= 1e-9 else 0.0
        missed, ratio = v_request - v_end > body.v_miss, v_end / v_w if v_w > 0 else 0.0
        a_reached, w_reached = (w_a * ratio - w_reached) / dt, w_a * ratio
        w_motor_before, v_lim_before, v = w_a, v_lim, v_end
        records.append((v, F_a, float(on), w_c, T_c, w_E, T_E, T_burn, fuel, w_S, T_S, P_g, P_g_a, T_M, P_m, P_m_a, stored, U, soc, T))
    return np.array(records)


#: Names of the columns that `drive` returns.
COLUMNS = (
    "body.v", "wheel.F", "control.engine_on", "control.omega_command", "control.tau_command", "engine.omega_engine", "engine.tau",
    "engine.tau_map", "engine.fuel_used", "generator.omega_required", "generator.tau", "generator.P_in_required", "generator.P_in", "motor.tau",
    "motor.P_in_required", "motor.P_in", "battery.P_stored", "battery.U", "battery.soc", "battery.T",
)  # fmt: skip
