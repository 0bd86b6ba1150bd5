"""A motor with its temperature; its key is always on."""

from .electric import Motor
from .tables import clip, ratio


class ThermalMotor(Motor):
    def __init__(self, p):
        super().__init__(p)
        self.T = p.T_start

    def required(self, T, w, alpha, U_before, road, shifting=False):
        p, w_before = self.p, self.w_lim
        self.w_lim, self.T_J = clip(w, 0, self.top), p.J * alpha
        self.w_map = min(w_before * road.ratio, self.top) if road.missed else self.w_lim
        T_lim = clip(T + self.T_J, p.overtorque * self.T_min(self.w_map), p.overtorque * self.T_max(self.w_map))
        # Hot, it gives less of what the envelope has at the speed asked for.
        left = clip((p.T_stop - self.T) / (p.T_stop - p.T_derate), 0.0, 1.0)
        T_hot = T_lim
        if left < 1:
            T_hot = clip(T_lim, left * p.overtorque * self.T_min(self.w_lim), left * p.overtorque * self.T_max(self.w_lim))
        on = self.w_lim > 1e-3 and not shifting
        self.T_map = T_hot if on else 0.0
        P = self.P(self.w_map, T_hot) if on else 0.0
        self.P_map = P / p.efficiency_scale if P >= 0 else P * p.efficiency_scale
        self.seen = {"motor.tau_limited": T_lim, "motor.P_map": self.P_map}
        self.v, self.dt = road.v, road.asked[1]
        return clip(self.P_map, -p.I_max * U_before, p.I_max * U_before)

    def available(self, P):
        p = self.p
        T_shaft = self.T_map * clip(ratio(P, self.P_map), 0, 1)
        heat = P - T_shaft * self.w_map
        area, cooler = p.A * p.torque_scale * p.speed_scale, p.T_ambient - self.T
        # Each power is that of the root of x^2 + 1e-24.
        h = 6 + 6 * (((cooler / 1000) ** 2 + 1e-24) ** 0.5) ** 0.25 + 60 * (((0.5 * self.v / 30) ** 2 + 1e-24) ** 0.5) ** 0.63
        net = max(heat, 0.0) + h * area * cooler + 0.9 * 5.67e-8 * area * (p.T_ambient**4 - self.T**4)
        coolant = min(max(net, 0.0), p.Q_coolant_max) if self.T >= p.T_coolant else 0.0
        self.T += self.dt * (net - coolant) / (p.mass * p.c_p)
        self.seen |= {"motor.P_in": P, "motor.tau": T_shaft - self.T_J, "motor.omega": self.w_lim, "motor.T": self.T, "motor.P_loss": heat}
        return T_shaft - self.T_J, self.w_lim
