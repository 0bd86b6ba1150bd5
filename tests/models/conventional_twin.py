"""The driveline of the conventional car by hand, from gearbox to engine: plain numbers, no faces and no links.

Written from the block diagrams of the original, with the departures that halfshaft documents: gearbox maps with floors, a reversed
torque that loses its share too, a raised gear kept for a time, no sight of the next sample, and an engine whose rotor shares a torque
that is too small, and follows jumps of speed with what driving leaves.  Road and wheels are given: what they ask for and reach.
The gearbox has no inertia, the key is on.
"""

import runpy
from pathlib import Path

_HAND = runpy.run_path(str(Path(__file__).with_name("twin.py")))
look, clip = _HAND["look"], _HAND["clip"]

#: Names of the columns that `drive` returns.
COLUMNS = (
    "shift.gear", "shift.load", "control.clutch_state", "control.engine_on", "engine.omega_engine", "engine.tau_map", "engine.tau",
    "engine.fuel_flow", "gearbox.tau", "gearbox.omega",
)  # fmt: skip


def drive(parameters, road, dt):
    """Return a record of every step; `parameters` are the vehicle's sets by role.

    `road` yields in each step what is asked for at the gearbox (torque, speed), the vehicle's speed at the start, the limited mean speed,
    whether the grip limit acts, the speed reached, the mean speed that the driveline allows, and the miss.
    """
    body, gearbox, shift, acc, engine, control = (parameters[r] for r in ("body", "gearbox", "shift", "accessories", "engine", "control"))
    s, q = engine.speed_scale, engine.torque_scale
    w_top, T_largest = s * engine.tau_max.points[0][-1], q * engine.tau_max.values.max()
    idle, launch = control.omega_idle * control.idle_at_stop, max(control.launch_share * w_top, 1.5 * control.omega_idle)
    gear, raised, since, w_reached, eta, clutch, on = 1, False, 15.0, 0.0, 0.0, 1, True
    T_acc, own, free, command, G_before, missed, ratio = 0.0, idle, idle, idle, 1.0, False, 0.0
    J = max(engine.J, 1e-6)

    def T_max(w):
        return q * look(engine.tau_max, w / s)

    def T_closed(w):
        return q * look(engine.tau_closed, w / s)

    records = []
    for T_out, w_out, v, v_lim, slips, v_end, v_driveline, miss in road:
        # Shift logic: by the speed and the efficiency of the gear so far.
        G = gearbox.ratios[gear - 1]
        w_e = w_reached if (missed or slips) and dt <= 0.11 else w_out * G
        T_e = T_out / (clip(eta, 0.2, 1) * G) + T_acc
        load = 1.0 if slips else clip(T_e / max(T_max(w_e), 1e-9), 0, 1)
        may = since >= shift.t_hold - 1e-6
        up = may and load < look(shift.up, w_e, float(gear))
        down = may and load > look(shift.down, w_e, float(gear)) and not (raised and since < shift.t_raised - 1e-6)
        new = clip(gear + (1 if up else -1 if down else 0), 1, len(gearbox.ratios))
        since, raised = (0.0, new > gear) if new != gear else (since + dt, raised)
        gear, G, shifting = new, gearbox.ratios[new - 1], since < shift.t_shift - 1e-6

        # Gearbox.
        T_loss = 0.0
        if w_out > 0:
            w_map = max(w_out, gearbox.omega_lookup) / gearbox.speed_scale
            e = gearbox.efficiency_scale * look(gearbox.efficiency, w_map, T_out / gearbox.torque_scale, float(gear))
            e = clip(e, gearbox.e_lowest, 1)
            T_loss = abs(T_out) * (1 - e) / G / (e if T_out >= 0 else 1)
        T_in, w_in = T_out / G + T_loss, w_out * G
        eta = T_out / G / T_in if w_in > 0 and T_out * T_in > 0 else 0.0
        T_c = 0.0 if shifting else T_in

        # Clutch and engine: states, commands.
        opened = shifting or (T_c <= 1e-3 and bool(control.open_when_braking or w_e < control.omega_idle))
        slipping = not opened and T_c > 1e-3 and max(w_e, w_in) < launch and clutch != 3
        clutch = 1 if opened else 2 if slipping else 3
        on = bool(control.idle_at_stop) or not opened or (shifting and on)
        w_c = clip(launch if slipping else w_in, idle, w_top) if on else 0.0
        T_c, w_shaft = 0.0 if opened else T_c, launch if slipping else w_in

        # Engine: speed, accessories, torque, fuel.
        T_spin = min(T_max(own), J * (w_c - own) / dt + T_acc) if w_c >= own else T_closed(own)
        spun = max(free + dt * (T_spin - T_acc) / J, 0.0)
        w = spun if opened else command * ratio * G / G_before if missed and not slipping else w_c
        w = max(min(w, w_top), idle * on)
        free, command, G_before = spun if opened else w, w_c, G
        T_acc = acc.tau_on + acc.P_on / (acc.eta * max(w, idle, 1e-3)) if on and w > 1e-9 else 0.0
        T_req, highest, closed = T_c + T_acc, T_max(w), T_closed(w)
        T_J = 0.0 if slipping else engine.J * 2 * w_shaft * (v_lim - v) / max(v_lim, 1e-9) / dt
        T = T_req * highest / (T_req + T_J) if T_req + T_J > highest else max(T_req, closed - T_J)
        T = T_req if opened else T
        T_map = clip(closed if opened and w > w_c + 1e-9 else T_req + engine.J * (w - own) / dt, closed, highest)
        own = w if opened else clip(own + dt * (T_map - T) / J, min(w, own), max(w, own))
        flow = s * q / engine.efficiency_scale * look(engine.fuel, w / s, T_map / q) if on else 0.0

        # And back.
        T_back = 0.0 if opened else clip(T - T_acc, 0.0 if slipping else -T_largest, T_largest)
        w_back = w_in if clutch != 3 else min(w_shaft, w_top)
        share = abs(T_back / T_in) if T_out * T_in > 0 else 1.0
        T_given = G * T_back - share * (G * T_in - T_out)
        missed, ratio = miss > body.v_miss, v_end / v_driveline if v_driveline > 0 else 0.0
        w_reached = w_back * ratio
        records.append((gear, load, clutch, float(on), w, T_map, T, flow, T_given, w_back / G))
    return records
