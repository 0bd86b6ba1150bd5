"""The road, the body, the wheels, the tyres and the brakes."""

import math

from .tables import Look, clip


class Road:
    """The vehicle on its road, from the request to the axle and back."""

    def __init__(self, body, wheel, v_start=0.0):
        self.body, self.wheel = body, wheel
        self.slip, self.T_bearing = Look(wheel.slip), Look(wheel.tau_bearing)(body.m)
        self.driveline, self.front = Look(wheel.share_driveline), Look(wheel.share_front)
        self.aero = 0.5 * body.rho * body.c_d * body.A
        # At the start of the step: speed, distance, elevation; of the step before: missed, end speed over that of the driveline.
        self.v, self.distance, self.elevation, self.missed, self.ratio = v_start, 0.0, 0.0, False, 0.0
        self.v_lim = v_start

    def slipping(self, F, W):
        return math.copysign(self.slip(abs(F) / W), F)

    def required(self, v_request, grade, dt):
        body, wheel, v, aero = self.body, self.wheel, self.v, self.aero
        m, g, mu, front, rear = body.m, body.g, wheel.mu_max, wheel.front_driven, wheel.rear_driven
        cos, sin = math.cos(math.atan(grade)), math.sin(math.atan(grade))
        roll_0, roll_1, climb = m * g * cos * wheel.f_0, m * g * cos * wheel.f_1, m * g * sin
        vbar, a = (v + v_request) / 2, (v_request - v) / dt
        F = m * a + roll_0 + roll_1 * vbar + climb + aero * vbar**2 if vbar > 0 else 0.0

        # The end speeds that the grip allows: drag with vbar^2 = (v^2 + 3 v v_end) / 4, weight on the driven axles with the transfer.
        share, transfer = front * body.front_share + rear * (1 - body.front_share), (front - rear) * body.h / body.wheelbase
        drag_v, drag_end = roll_0 + climb + roll_1 * v / 2 + aero * v**2 / 4, roll_1 / 2 + 0.75 * aero * v
        ends = []
        for grip in (-mu, mu):
            # grip W share - grip transfer (m (v_end - v) / dt + climb) = m (v_end - v) / dt + drag_v + drag_end v_end
            inertia = m * (1 + grip * transfer) / dt
            ends.append((grip * (m * g * cos * share - transfer * climb) - drag_v + inertia * v) / (inertia + drag_end))
        v_lim = max(min(vbar, (ends[1] + v) / 2), (ends[0] + v) / 2)
        moved = body.h / body.wheelbase * m * (2 * (v_lim - v) / dt + g * sin)
        W_front, W_rear = m * g * cos * body.front_share - moved, m * g * cos * (1 - body.front_share) + moved
        W_driven = front * W_front + rear * W_rear
        F_lim = clip(F, -mu * W_driven, mu * W_driven)

        by_driveline, by_front = self.driveline(vbar), self.front(vbar)
        by_rear = clip(1 - by_driveline - by_front, 0, 1)
        F_drive, F_axle = F_lim, F_lim
        if F_lim < 0:
            F_drive = F_lim * by_driveline
            F_axle = F_lim * (1 - (1 - front) * by_front - (1 - rear) * by_rear)
        slip = self.slipping(F_axle, W_driven)
        w, alpha = v_lim * (1 + slip) / wheel.r, (v_lim - self.v_lim) / dt * (1 + slip) / wheel.r
        T_loss, T_J = self.T_bearing if w > 0 else 0.0, wheel.J * alpha
        self.v_lim, self.slips = v_lim, F_lim != F
        # The same step's way back takes all of these.
        self.asked, self.slope = (v_request, dt, vbar, F_lim, w, T_loss + T_J), (roll_0, roll_1, climb, sin)
        self.loads, self.T_loss = (W_front, W_rear, W_driven), T_loss
        # What a driveline of its own may bring to an axle, driving and braking: the tyres' grip beside the friction brake that
        # the request plans; each axle bears half of the wheels' own torque.
        left, friction = 1 - by_driveline, F_lim - F_drive
        planned = (clip(by_front / left, 0, 1) if left > 0 else 0.6) * friction
        self.room = {
            axle: (wheel.r * (grip - brake) + (T_loss + T_J) / 2, -wheel.r * (grip + brake) + (T_loss + T_J) / 2)
            for axle, grip, brake in (("front", front * mu * W_front, planned), ("rear", rear * mu * W_rear, friction - planned))
        }
        self.seen = {
            "body.F_required": F, "wheel.F_limited": F_lim, "wheel.v_limited": v_lim, "wheel.slip_limited": float(self.slips),
            "wheel.slip": slip, "wheel.F_driveline_required": F_drive, "final_drive.omega_required": w,
        }  # fmt: skip
        return F_drive * wheel.r + T_loss + T_J, w, alpha

    def available(self, T, w_a):
        v_request, dt, vbar, F_lim, w, T_wheel = self.asked
        (roll_0, roll_1, climb, sin), (W_front, W_rear, W_driven) = self.slope, self.loads
        wheel, v, m, mu, aero = self.wheel, self.v, self.body.m, self.wheel.mu_max, self.aero
        F_dl = (T - T_wheel) / wheel.r
        # Brakes: what is missing, shared by speed; no axle more than its brakes or its tyres beside the driveline; the other the rest.
        front_driven, rear_driven = wheel.front_driven, wheel.rear_driven
        half = front_driven / (front_driven + rear_driven)
        room_front = clip(mu * W_front + half * F_dl, 0, wheel.F_brake_front_max)
        room_rear = clip(mu * W_rear + (1 - half) * F_dl, 0, wheel.F_brake_rear_max)
        F_friction = min(0.0, F_lim - F_dl) if F_lim < 0 else 0.0
        left = 1 - self.driveline(vbar)
        share = clip(self.front(vbar) / left, 0, 1) if left > 0 else 0.6
        F_rear = -min(-(1 - share) * F_friction, room_rear)
        F_front = -min(F_rear - F_friction, room_front)
        F_rear = -min(F_front - F_friction, room_rear)
        F_a, F_driven = F_dl + F_front + F_rear, F_dl + front_driven * F_front + rear_driven * F_rear
        v_w = wheel.r * w_a / (1 + self.slipping(F_driven, W_driven))
        v_a = v_w if abs(w - w_a) > 1e-3 else self.v_lim

        # The speed that the force gives, bounded by that of the driveline.
        moving = v_a > 0
        B = 2 * m / dt + roll_1 * moving
        C = -2 * m * v / dt - max(F_a, -70 * m) + roll_0 * moving + climb
        v_force = (-B + math.sqrt(max(B**2 - 4 * aero * C, 0))) / (2 * aero) if aero > 0 else -C / B
        v_m = max(v_force, v_a) if F_a < -m and v_request < v else min(v_force, v_a)
        v_end = 2 * v_m - v if 2 * v_m - v >= 1e-9 else 0.0
        v_m = (v + v_end) / 2
        P_brake = -(F_driven - F_dl) * wheel.r * w_a - (F_a - F_driven) * v_a
        self.distance, self.elevation = self.distance + v_m * dt, self.elevation + v_m * dt * sin
        self.missed, self.ratio, self.v = v_request - v_end > self.body.v_miss, v_end / v_w if v_w > 0 else 0.0, v_end
        self.seen |= {
            "body.v": v_end, "body.distance": self.distance, "body.elevation": self.elevation, "body.v_mean": v_m,
            "body.P_aero": aero * v_m**3, "body.P_roll": moving * (roll_0 + roll_1 * v_m) * v_m, "body.P_climb": climb * v_m,
            "body.P_kinetic": m * (v_end**2 - v**2) / 2 / dt, "body.trace_miss": v_request - v_end,
            "wheel.F": F_a, "wheel.v": v_a, "wheel.F_brake_front": F_front, "wheel.F_brake_rear": F_rear, "wheel.v_driveline": v_w,
            "wheel.P_brake": P_brake, "wheel.P_slip": F_driven * (wheel.r * w_a - v_a), "wheel.P_bearing": self.T_loss * w_a,
            "final_drive.tau": T, "final_drive.omega": w_a,
        }  # fmt: skip
