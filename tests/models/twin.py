"""The battery electric car by hand: plain numbers, the step as one read of the equations, no faces and no links.

Written from the paper's equations and the block diagrams of the original, with the departures that halfshaft documents: no
cap on inertia torques, generating torques cut to the generating envelope, the same loss where a gearbox has no useful
ratio, reversed torque that loses its share too, and brakes that the tyres hold.  Flat road, one fixed gear, front drive, no
limit of the brakes themselves.
"""

import math
from itertools import product

import numpy as np


def look(t, *x):
    """Return the value of a piecewise linear table, clipped or extended outside as the table says."""
    at, shares = [], []
    for p, xi in zip(t.points, x, strict=True):
        if len(p) == 1:
            at, shares = [*at, (0,)], [*shares, (1.0,)]
            continue
        xi = min(max(xi, p[0]), p[-1]) if t.clip else xi
        i = min(max(int(np.searchsorted(p, xi, side="right")) - 1, 0), len(p) - 2)
        s = (xi - p[i]) / (p[i + 1] - p[i])
        at, shares = [*at, (i, i + 1)], [*shares, (1 - s, s)]
    return sum(math.prod(w) * float(t.values[i]) for i, w in zip(product(*at), product(*shares), strict=True))


def clip(x, lowest, highest):
    return min(max(x, lowest), highest)


def drive(parameters, speeds, dt, v=0.0):
    """Return a record of every step; `parameters` are the vehicle's sets by role, `speeds` the requests."""
    body, wheel, final, gearbox, motor, acc, pack = (
        parameters[r] for r in ("body", "wheel", "final_drive", "gearbox", "motor", "accessories", "battery")
    )
    m, W, aero, r, G = body.m, body.m * body.g, 0.5 * body.rho * body.c_d * body.A, wheel.r, gearbox.ratios[0]
    N, h = pack.n_modules, body.h / body.wheelbase
    drawn = (1 - pack.soc_start) * pack.capacity_scale * look(pack.Q, pack.T_start)
    soc, T, missed, ratio, w_motor_before, v_lim_before = pack.soc_start, pack.T_start, False, 0.0, 0.0, v
    U = N * look(pack.u_oc, T, soc)
    records = []
    for v_request in speeds:
        # What the request needs, and the grip of the front axle (drag with v_end^2 = v v_end).
        vbar, a = (v + v_request) / 2, (v_request - v) / dt
        roll = W * (wheel.f_0 + wheel.f_1 * vbar) if vbar > 0 else 0.0
        F = m * a + roll + aero * vbar**2
        mu, f_0, f_1 = wheel.mu_max, wheel.f_0, wheel.f_1
        rest = -W * f_0 - 0.5 * W * f_1 * v - 0.25 * aero * v**2 + m * v / dt
        slope = 0.75 * aero * v + 0.5 * W * f_1 + m / dt
        v_top = (mu * body.front_share * W + rest + mu * h * m * v / dt) / (slope + mu * h * m / dt)
        v_low = (-mu * body.front_share * W + rest - mu * h * m * v / dt) / (slope - mu * h * m / dt)
        v_lim = clip(vbar, (v_low + v) / 2, (v_top + v) / 2)
        W_f = body.front_share * W - h * m * 2 * (v_lim - v) / dt
        F_lim = clip(F, -mu * W_f, mu * W_f)

        # Wheel: brake split by speed, slip, bearings, inertia.
        regen, front = look(wheel.share_driveline, vbar), look(wheel.share_front, vbar)
        rear = clip(1 - regen - front, 0, 1)
        F_axle, F_drive = (F_lim, F_lim) if F_lim >= 0 else (F_lim * (1 - rear), F_lim * regen)
        roll_ratio = (1 + math.copysign(look(wheel.slip, abs(F_axle) / W_f), F_axle)) / r
        w, w_alpha = v_lim * roll_ratio, (v_lim - v_lim_before) / dt * roll_ratio
        T_wheel_loss = (look(wheel.tau_bearing, m) if w > 0 else 0.0) + wheel.J * w_alpha
        T_axle = F_drive * r + T_wheel_loss

        # Final drive and gearbox: loss of the efficiency map at the output point.
        T_final_loss = (final.tau_loss if w * final.i > 0 else 0.0) + final.J * w_alpha * final.i
        T_out, w_out, out_alpha = T_axle / final.i + T_final_loss, w * final.i, w_alpha * final.i
        T_gear = 0.0
        if w_out > 0:
            w_map = max(w_out, gearbox.omega_lookup) / gearbox.speed_scale
            e = gearbox.efficiency_scale * look(gearbox.efficiency, w_map, T_out / gearbox.torque_scale, 1.0)
            e = clip(e, gearbox.e_lowest, 1)
            T_gear = abs(T_out) * ((1 - e) / G if T_out < 0 else (1 - e) / (G * e) if e > 0 else G)
        T_in0, T_gear_J = T_out / G + T_gear, gearbox.J * out_alpha * G
        T_rotor, w_rotor = T_in0 + T_gear_J, w_out * G

        # Motor: top speed, envelope at the speed really reached, map, current.
        s, q, top = motor.speed_scale, motor.torque_scale, motor.omega_max * motor.speed_scale
        w_lim, T_J = clip(w_rotor, 0, top), motor.J * out_alpha * G
        w_est = min(w_motor_before * ratio, top) if missed else w_lim
        highest, lowest = (motor.overtorque * q * look(t, w_est / s) for t in (motor.tau_max, motor.tau_min))
        T_req = T_rotor + T_J
        T_lim = min(T_req, highest) if T_req >= 0 else max(T_req, lowest)
        P_map = s * q * look(motor.P_electric, w_est / s, T_lim / q)
        P_map = (P_map / motor.efficiency_scale if P_map >= 0 else P_map * motor.efficiency_scale) if w_lim > 1e-3 else 0.0
        P_motor = clip(P_map, -motor.I_max * U, motor.I_max * U)

        # Accessories and battery.
        P_acc = acc.P_on / acc.eta
        P_bus = P_motor + P_acc
        U_oc = N * look(pack.u_oc, T, soc)
        R_out, R_in = (N / pack.capacity_scale * look(t, T, soc) for t in (pack.r_discharge, pack.r_charge))
        U_min = max(0.5 * U_oc, motor.U_min, N * pack.u_min)
        P_max = max(0.0, (U_oc - U_min) * U_min / R_out) if soc > 1e-3 else 0.0
        I_min = min(0.0, (U_oc - N * pack.u_max) / R_in) if soc < 0.999 else 0.0
        P, R = min(P_bus, P_max), R_out if P_bus >= 0 else R_in
        P = 0.0 if soc >= 0.999 and P_bus < 0 else P
        current = max((U_oc - math.sqrt(U_oc**2 - 4 * R * P)) / (2 * R), I_min)
        U = U_oc - R * current
        eta = 1.0 if current >= 0 else look(pack.eta_coulomb, T)
        P_pack = U * current
        stored = U_oc * eta * current
        R_th = pack.R_th_fan + 1 / (2 * pack.airflow * 1009) if T > pack.T_fan else pack.R_th_still
        drawn += dt * eta * current
        T += dt * ((stored - P_pack) / N - (T - pack.T_ambient) / R_th) / (pack.mass * pack.c_p)
        capacity = pack.capacity_scale * look(pack.Q, T)
        soc = clip((capacity - drawn) / capacity, 0, 1)

        # And back: bus, accessories first, motor by ratio of powers, gearbox by ratio of torques, the rest by torque.
        P_load = min(P_pack, max(P_bus, 0.0))
        P_given = P_load - clip(P_load - min(P_motor, 0.0), 0.0, P_acc)
        T_a = (T_lim * clip(P_given / P_map, 0, 1) if P_map != 0 else 0.0) - T_J - T_gear_J
        T_out_a = G * T_a - (G * T_in0 - T_out) * (abs(T_a / T_in0) if T_out * T_in0 > 0 else 1)
        F_dl = ((T_out_a - T_final_loss) * final.i - T_wheel_loss) / r
        w_a = w_lim / G / final.i
        F_friction = min(0.0, F_lim - F_dl) if F_lim < 0 else 0.0
        # The rear axle is not driven: its grip is there for its brakes alone.  What they cannot take the front ones do.
        F_rear = -min(-F_friction * (1 - clip(front / (1 - regen), 0, 1)), mu * (W - W_f))
        F_front = -min(F_rear - F_friction, mu * W_f + F_dl)
        F_friction = F_front + F_rear
        F_a, F_axle = F_dl + F_friction, F_dl + F_front
        v_w = r * w_a / (1 + math.copysign(look(wheel.slip, abs(F_axle) / W_f), F_axle))
        v_a = v_w if abs(w - w_a) > 1e-3 else v_lim

        # The speed that the force gives, bounded by that of the driveline.
        moving = v_a > 0
        B = 2 * m / dt + W * f_1 * moving
        C = -2 * m * v / dt - max(F_a, -70 * m) + W * f_0 * moving
        v_force = (-B + math.sqrt(B**2 - 4 * aero * C)) / (2 * aero)
        v_m = max(v_force, v_a) if F_a < -m and v_request < v else min(v_force, v_a)
        v_end = 2 * v_m - v
        v_end = v_end if v_end >= 1e-9 else 0.0
        missed, ratio = v_request - v_end > body.v_miss, v_end / v_w if v_w > 0 else 0.0
        w_motor_before, v_lim_before, v = w_lim, v_lim, v_end
        records.append((v, F_a, T_a + T_gear_J, P_motor, P_given, P_pack, stored, U, soc, T))
    return np.array(records)


#: Names of the columns that `drive` returns.
COLUMNS = (
    "body.v", "wheel.F", "motor.tau", "motor.P_in_required", "motor.P_in", "bus.P_in_battery",
    "battery.P_stored", "battery.U", "battery.soc", "battery.T",
)  # fmt: skip
