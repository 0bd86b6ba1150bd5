"""The fuel cell hybrid: its control, and the fuel cell in both forms."""

from .chassis import Road
from .driveline import FinalDrive, Gearbox
from .electric import Accessories, Bus, Motor
from .stores import store_of
from .tables import Look, clip
from .vehicles import columns, seen, shift_of, steps


class FuelCell:
    """By its net power."""

    def __init__(self, p):
        self.p, self.used = p, 0.0
        self.fuel = Look(p.fuel, p.P_scale / p.efficiency_scale, p.P_scale)
        self.P_largest = p.P_scale * float(p.fuel.points[0][-1])

    def convert(self, command, on):
        """Return power and fuel flow."""
        if not on:
            return 0.0, 0.0
        P = clip(command, 0.0, self.P_largest)
        return P, self.fuel(P)

    def available(self, command, on, dt):
        P, flow = self.convert(command, on)
        self.used += dt * flow
        self.seen = {
            "fuel_cell.P_out": P, "fuel_cell.fuel_flow": flow, "fuel_cell.fuel_used": self.used, "fuel_cell.P_fuel": flow * self.p.H_fuel,
            "fuel_cell.P_loss": flow * self.p.H_fuel - P,
        }  # fmt: skip
        return P


class Polarisation(FuelCell):
    """By the polarisation curve; the auxiliaries' power is that of the step before."""

    def __init__(self, p):
        self.p, self.used = p, 0.0
        self.i, U = p.U_cell.points[0].tolist(), p.U_cell.values.tolist()
        self.area = p.n_cells * p.A_cell
        self.P = [self.area * i * u for i, u in zip(self.i, U, strict=True)]
        self.U, self.fuel, self.aux = Look(p.U_cell), Look(p.fuel, self.area / p.utilisation), Look(p.P_aux)
        self.flow_before = 0.0
        self.P_largest = self.P[-1] - self.aux(self.fuel(self.i[-1]))

    def convert(self, command, on):
        aux = self.aux(self.flow_before) if self.flow_before > 0 else 0.0
        self.flow_before, P_net = 0.0, 0.0
        if on:
            P, k = clip(command + aux, self.P[0], self.P[-1]), 1
            while P > self.P[k]:
                k += 1
            i = self.i[k - 1] + (P - self.P[k - 1]) / (self.P[k] - self.P[k - 1]) * (self.i[k] - self.i[k - 1])
            self.flow_before = self.fuel(i)
            P_net = self.area * i * self.U(i) - self.aux(self.flow_before)
        return P_net, self.flow_before


class Control:
    def __init__(self, p, P_largest):
        self.p, self.P_low, self.P_high = p, p.P_min_share * P_largest, p.P_max_share * P_largest
        self.on, self.P, self.stopped, self.off = bool(p.on_start), None, False, 0.0
        # Energy asked for in whole seconds, and what has gone of the present one.
        self.seconds, self.energy, self.time = [], 0.0, 0.0

    def decide(self, P_bus, soc, P_max, P_min, key_on, dt):
        """Return whether the fuel cell is on, and its power."""
        p = self.p
        short = P_bus >= P_max
        x = clip(((p.soc_high + p.soc_low) / 2 - soc) / ((p.soc_high - p.soc_low) / 2), -1, 1)
        P_charge = p.P_charge * x
        if P_bus <= 0:
            P_charge = min(P_bus - P_min, P_charge)
        asked = max(P_bus, 0.0) + P_charge
        P = max(asked, self.P_low)
        if not short and soc >= p.soc_low:
            P = min(P, self.P_high)
        self.P = P if self.P is None else clip(P, self.P - p.P_fall * dt, self.P + p.P_rise * dt)

        self.off = 0.0 if self.stopped else self.off + dt
        may_start = self.off >= p.t_off_min - 1e-9 and sum(self.seconds[-5:]) / 5 >= 1.2 * self.P_low
        self.energy, self.time = self.energy + asked * dt, self.time + dt
        if self.time >= 1 - 1e-9:
            self.seconds, self.energy, self.time = [*self.seconds, self.energy], 0.0, 0.0
        want = (self.on or may_start or soc <= p.soc_low) and (soc <= p.soc_high or asked >= self.P_low)
        want = want and not (p.charge_depleting and soc > (p.soc_high + p.soc_low) / 2)
        no_room = P_bus < 0 and self.P_low > P_bus - P_min
        on = bool(key_on) and (((want or short) and not no_room) or bool(p.always_on))
        self.stopped, self.on = self.on and not on, on
        self.seen = {
            "control.converter_on": float(on), "control.P_converter": self.P if on else 0.0, "control.P_converter_request": asked,
        }  # fmt: skip
        return on, self.P


def drive(parameters, samples):
    """Return the time series of a fuel cell hybrid by name."""
    p = parameters
    road, final, gearbox = Road(p["body"], p["wheel"], samples.v_start), FinalDrive(p["final_drive"]), Gearbox(p["gearbox"])
    motor, accessories, bus = Motor(p["motor"]), Accessories(p["accessories"]), Bus()
    shift, battery = shift_of(p["shift"], p["gearbox"].ratios, motor.T_max), store_of(p["battery"], p["motor"].U_min)
    fuel_cell = (Polarisation if hasattr(p["fuel_cell"], "U_cell") else FuelCell)(p["fuel_cell"])
    control = Control(p["control"], fuel_cell.P_largest)
    rows = []
    for v_request, grade, key_on, dt in steps(samples, road):
        output = final.required(*road.required(v_request, grade, dt))
        gear, G, shifting = shift.choose(*output[:2], road, gearbox, dt)
        P_motor = motor.required(*gearbox.required(*output, gear, G, shifting), battery.U, road, shifting)
        P_bus, room = accessories.required(P_motor, key_on), battery.limits()
        on, command = control.decide(P_bus, battery.soc, *room, key_on, dt)
        P = battery.available(bus.required(P_bus, fuel_cell.available(command, on, dt)), dt)
        road.available(*final.available(*gearbox.available(*motor.available(accessories.available(bus.available(P))))))
        rows.append(seen(road, final, gearbox, shift, motor, accessories, bus, battery, fuel_cell, control))
    return columns(rows)
