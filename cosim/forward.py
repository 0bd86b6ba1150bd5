"""Runs the forward-facing model: a driver, the sampled controls, and IDAS between the samples.

At each sample the driver, a PI on speed with the trace's acceleration fed forward, asks for an acceleration; the step
itself, fed with the plant's state, is the controller that turns it into throttle, brakes, gear, clutch and engine
commands; these are held while IDAS integrates the plant to the next sample.  The integral of the driver rests while the
request is out of reach (anti-windup).
"""

from __future__ import annotations

import io
from contextlib import redirect_stderr
from dataclasses import dataclass

import casadi as ca
import numpy as np

from halfshaft.cosim.compiled import Array, Stepper, stepper
from halfshaft.cosim.cycle import Samples
from halfshaft.fmu_build.code import compiled_tables
from halfshaft.library.base.errors import CompileError, SolveError
from halfshaft.library.base.tables import interpolants
from halfshaft.models.assembly import all_tables
from halfshaft.models.forward import Plant, assemble_plant
from halfshaft.models.model import Model

#: Energies are integrated in kJ: the absolute tolerance, 1e-4 J, is then far below what an interval turns over.
ENERGY = 1e3
#: Shortest interval that is cut in two where the integrator stops at a kink of a table [s].
SHORTEST = 1e-6
#: No command asks for an acceleration beyond this [m/s^2].
A_MOST = 1e6


@dataclass(frozen=True)
class Driver:
    """Gains of the PI on speed."""

    k_p: float = 2.0
    k_i: float = 0.4
    #: Time between samples of driver and controls [s].
    dt: float = 0.1
    #: Shortest time that a shift keeps the clutch open [s]; the hybrid model may shift in no time, a plant cannot.
    t_shift: float = 0.2
    #: Shortest time between two shifts [s]; in the step only a shift down after a shift up waits so long.
    t_hold: float = 2.0
    #: Below this speed [m/s] a driver who wants to stop leaves the pedals and holds the vehicle with all brakes.
    v_stop: float = 0.05


@dataclass(frozen=True)
class ForwardRun:
    """Shown variables at the samples, integrals of all powers, and the last state."""

    time: Array
    history: Array
    energies: dict[str, float]
    state: Array


class Forward:
    """The forward-facing model of a vehicle, ready to run."""

    def __init__(self, model: Model, title: str = "", reltol: float = 1e-7, driver: Driver = Driver()) -> None:
        self.stepper: Stepper = stepper(model, title)
        self.driver = driver
        tables = all_tables(model)
        try:
            functions = compiled_tables(tables)
        except CompileError:
            functions = interpolants(tables)
        self.plant: Plant = assemble_plant(model, self.stepper.step, functions)
        x, a, p = (self.plant.dae[name] for name in ("x", "z", "p"))
        self._rates = ca.Function("rates", [x, a, p], [self.plant.dae["ode"]])
        self._balance = ca.Function("balance", [a, x, p], [self.plant.dae["alg"]])
        # IDAS starts from rates of zero.  Seen from a frame that moves with the rates of the start they are zero, so that it
        # can begin at the solution and need not search for it.
        t, span, rates = ca.SX.sym("t"), ca.SX.sym("span"), ca.SX.sym("rates", x.numel())
        ode, alg, quad = (ca.substitute(self.plant.dae[name], x, x + rates * span * t) for name in ("ode", "alg", "quad"))
        moving = {"t": t, "x": x, "z": a, "p": ca.vertcat(p, rates, span)}
        moving |= {"ode": span * (ode - rates), "alg": alg, "quad": span * quad / ENERGY}
        options = {
            "reltol": reltol,
            "abstol": reltol,
            "calc_ic": False,
            "suppress_algebraic": True,
            "quad_err_con": True,
            "max_num_steps": 100000,
        }
        self._advance = ca.integrator("advance", "idas", moving, 0, 1, options)

    def run(self, samples: Samples, parameters: Array) -> ForwardRun:
        """Drive over `samples` of the trace, which must be spaced by the driver's ``dt``.

        Raises
        ------
        SolveError
            If the integrator cannot go on; the message tells where.

        """
        step, plant, driver = self.stepper.step, self.plant, self.driver
        parameters = np.array(parameters, dtype=float)
        for name, least in (("shift.t_shift", driver.t_shift), ("shift.t_hold", driver.t_hold)):
            if name in step.parameter_index:
                i = step.parameter_index[name]
                parameters[i] = max(parameters[i], least)
        memory = self.stepper.first(parameters)
        places = np.array([step.state_index[m] for m in plant.memories])
        held_at = np.array([step.output_index[name] for name in plant.held])
        miss = step.output_index["body.trace_miss"]
        distance = [d.name for d in plant.states].index("body.distance")
        elevation = [d.name for d in plant.states].index("body.elevation")
        speed = [d.name for d in plant.states].index("body.v")
        brakes = [i for i, name in enumerate(plant.held) if name.startswith("wheel.F_brake")]
        weight = np.array([step.parameter_index[f"body.{name}"] for name in ("m", "g")])

        x, a, integral = memory[places].copy(), 0.0, 0.0
        x_start = x.copy()
        v_before, n = samples.v_start, len(samples.t)
        quads = np.zeros(len(plant.powers))
        rows = np.empty((n, len(plant.shown)))
        for k in range(n):
            dt = samples.dt[k]
            error = v_before - x[0]
            a_asked = (samples.v[k] - v_before) / dt + driver.k_p * error + driver.k_i * integral
            grade = np.interp(x[distance], *samples.grade_by_distance) if samples.grade_by_distance else samples.grade[k]
            memory[places] = x
            asked = max(0.0, x[0] + a_asked * dt)
            stopped = samples.v[k] == 0 and x[0] < driver.v_stop
            if stopped:
                asked = 0.0
            # The step knows no negative speed.
            memory[places[speed]] = 0.0 if stopped else max(0.0, x[speed])
            memory, outputs = self.stepper(memory, np.array([asked, grade, samples.key_on[k], dt, 0.0]), parameters)
            held = outputs[held_at]
            if stopped:
                integral, held[brakes] = 0.0, -np.inf
            elif abs(outputs[miss]) < 1e-6:
                integral += error * dt
            p = np.concatenate([held, [grade, samples.key_on[k]], parameters])
            x, a, gained = self._interval(x, a, p, samples.t[k] - dt, dt)
            quads += gained
            rows[k] = np.array(self.plant.outputs(x, a, p)).ravel()
            v_before = samples.v[k]
        energies = {d.name: float(q) for d, q in zip(plant.powers, quads, strict=True)}
        m, g = parameters[weight]
        # The states know these better than the integrals of their rates do.
        energies["body.P_kinetic"] = 0.5 * m * (x[0] ** 2 - x_start[0] ** 2)
        energies["body.P_climb"] = m * g * (x[elevation] - x_start[elevation])
        return ForwardRun(samples.t, rows, energies, x)

    def _interval(self, x: Array, a: float, p: Array, t: float, span: float) -> tuple[Array, float, Array]:
        """Integrate over a time with held commands."""
        a = self._acceleration(x, a, p, t)
        rates = np.array(self._rates(x, a, p)).ravel()
        said = io.StringIO()
        try:
            with redirect_stderr(said):
                r = self._advance(x0=x, z0=a, p=np.concatenate([p, rates, [span]]))
        except RuntimeError as error:
            _interrupt(said)
            if span < SHORTEST:
                raise self._error(x, t, str(error).splitlines()[-1]) from None
            middle, a, first = self._interval(x, a, p, t, span / 2)
            end, a, second = self._interval(middle, a, p, t + span / 2, span / 2)
            return end, a, first + second
        _interrupt(said)
        return np.array(r["xf"]).ravel() + rates * span, float(r["zf"]), np.array(r["qf"]).ravel() * ENERGY

    def _acceleration(self, x: Array, guess: float, p: Array, t: float) -> float:
        """Return the acceleration that balances the commands, by regula falsi; the balance falls with it, but has kinks."""
        at, commands = ca.DM(x), ca.DM(p)

        def balance(a: float) -> float:
            return float(self._balance(a, at, commands))

        width, low = 0.01, guess
        at_low = balance(low)
        high = low + width * np.sign(at_low)
        while (at_high := balance(high)) * at_low > 0:
            width *= 4
            low, at_low, high = high, at_high, high + width * np.sign(at_high)
            if not abs(high) < A_MOST:
                raise self._error(x, t, "no acceleration balances the commands")
        while at_high != 0 and abs(high - low) > 1e-12:
            middle = high - at_high * (high - low) / (at_high - at_low)
            at_middle = balance(middle)
            if at_middle * at_high < 0:
                low, at_low = high, at_high
            else:
                at_low /= 2
            if middle == high:
                break
            high, at_high = middle, at_middle
        return float(high)

    def _error(self, x: Array, t: float, message: str) -> SolveError:
        return SolveError(f"{self.plant.name}: the integrator stopped at t = {t:g} s, v = {x[0]:g} m/s: {message}")


def _interrupt(said: io.StringIO) -> None:
    """Pass an interrupt on; CasADi swallows it within the integrator and only says so."""
    if "KeyboardInterrupt" in said.getvalue():
        raise KeyboardInterrupt
