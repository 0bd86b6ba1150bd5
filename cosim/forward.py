"""Runs the forward-facing model: a driver, the sampled controls, and IDAS between the samples.

At each sample the driver, a PI on speed with the trace's acceleration fed forward, asks for an acceleration; the step
itself, fed with the plant's state, is the controller that turns it into throttle, brakes, gear, clutch and engine
commands; these are held while IDAS integrates the plant to the next sample.  The integral of the driver rests while the
request is out of reach (anti-windup).
"""

from __future__ import annotations

import io
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr
from dataclasses import dataclass
from types import FrameType
from typing import Any

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
#: First step of an interval, over the interval: of its own accord IDAS begins with a tenth of that, and takes half as many steps more.
FIRST_STEP = 0.01
#: Shortest interval that is cut in two where the integrator stops at a kink of a table [s].
SHORTEST = 1e-6
#: No command asks for an acceleration [m/s^2] or divides a torque [N.m] beyond this.
Z_MOST = 1e6
#: Steps of Newton's method for the unknowns, the shortest share of a step, and when they are found: change and balance, relative.
NEWTON_STEPS, SHORTEST_SHARE, Z_EXACT, BALANCED = 50, 1e-3, 1e-11, 1e-6
#: An integrator and the arrays of `Direct` serve one thread, and what IDAS says is kept away from the whole process.
ONE_AT_A_TIME = threading.Lock()
#: How far from where they were the unknowns are looked for where they jump, and what counts as a jump, relative.
KICKS, JUMP = (0.3, -0.3, 3.0, -3.0), 1e-4


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

    def __init__(self, model: Model, title: str = "", reltol: float = 3e-8, driver: Driver = Driver()) -> None:
        self.stepper: Stepper = stepper(model, title)
        self.driver = driver
        self._interrupts = Interrupts()
        tables = all_tables(model)
        try:
            functions = compiled_tables(tables)
        except CompileError:
            functions = interpolants(tables)
        self.plant: Plant = assemble_plant(model, self.stepper.step, functions)
        places, the = [d.name for d in self.plant.states], self.stepper.step.tags.the
        #: Places of speed, distance and elevation in the state.
        self._motion = [places.index(the(tag)) for tag in ("speed", "distance", "elevation")]
        x, z, p, alg = (self.plant.dae[name] for name in ("x", "z", "p", "alg"))
        self._rates = Direct(ca.Function("rates", [x, z, p], [self.plant.dae["ode"]]))
        self._powers = Direct(ca.Function("powers", [x, z, p], [self.plant.dae["quad"]]))
        self._balance = Direct(ca.Function("balance", [z, x, p], [alg, ca.jacobian(alg, z)]))
        self._outputs = Direct(self.plant.outputs)
        # IDAS starts from rates of zero.  Seen from a frame that moves with the rates of the start they are zero, so that it
        # can begin at the solution and need not search for it.
        t, span, rates = ca.SX.sym("t"), ca.SX.sym("span"), ca.SX.sym("rates", x.numel())
        ode, alg, quad = (ca.substitute(self.plant.dae[name], x, x + rates * span * t) for name in ("ode", "alg", "quad"))
        moving = {"t": t, "x": x, "z": z, "p": ca.vertcat(p, rates, span)}
        moving |= {"ode": span * (ode - rates), "alg": alg, "quad": span * quad / ENERGY}
        options = {
            "reltol": reltol,
            "abstol": reltol,
            "calc_ic": False,
            "suppress_algebraic": True,
            "quad_err_con": True,
            "max_num_steps": 100000,
            "step0": FIRST_STEP,
        }
        self._advance = ca.integrator("advance", "idas", moving, 0, 1, options)

    def run(self, samples: Samples, parameters: Array) -> ForwardRun:
        """Drive over `samples` of the trace, which must be spaced by the driver's ``dt``.

        Raises
        ------
        SolveError
            If the integrator cannot go on; the message tells where.

        """
        with ONE_AT_A_TIME, self._interrupts.listened_to():
            return self._run(samples, parameters)

    def _run(self, samples: Samples, parameters: Array) -> ForwardRun:
        step, plant, driver = self.stepper.step, self.plant, self.driver
        tags = step.tags
        parameters = np.array(parameters, dtype=float)
        for names, least in ((tags.all_of("shift time"), driver.t_shift), (tags.all_of("hold time"), driver.t_hold)):
            for i in (step.parameter_index[name] for name in names):
                parameters[i] = max(parameters[i], least)
        memory = self.stepper.first(parameters)
        places = np.array([step.state_index[m] for m in plant.memories])
        held_at = np.array([step.output_index[name] for name in plant.held])
        miss = step.output_index[tags.the("miss")]
        speed, distance, elevation = self._motion
        brakes = [i for i, name in enumerate(plant.held) if tags.get(name) == "brake force"]
        m, g = (parameters[step.parameter_index[tags.the(tag)]] for tag in ("vehicle mass", "gravity"))

        x, z, integral = memory[places].copy(), np.zeros(plant.dae["z"].numel()), 0.0
        x_start = x.copy()
        v_before, n = samples.v_start, len(samples.t)
        quads = np.zeros(len(plant.powers))
        rows = np.empty((n, len(plant.shown)))
        for k in range(n):
            dt = samples.dt[k]
            error = v_before - x[speed]
            a_asked = (samples.v[k] - v_before) / dt + driver.k_p * error + driver.k_i * integral
            grade = np.interp(x[distance], *samples.grade_by_distance) if samples.grade_by_distance else samples.grade[k]
            memory[places] = x
            asked = max(0.0, x[speed] + a_asked * dt)
            stopped = samples.v[k] == 0 and x[speed] < driver.v_stop
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
            x, z, gained = self._interval(x, z, p, samples.t[k] - dt, dt)
            quads += gained
            (rows[k],) = self._outputs(x, z, p)
            v_before = samples.v[k]
        energies = {d.name: float(q) for d, q in zip(plant.powers, quads, strict=True)}
        # The states know these better than the integrals of their rates do.
        energies[tags.the("vehicle kinetic power")] = 0.5 * m * (x[speed] ** 2 - x_start[speed] ** 2)
        energies[tags.the("vehicle climbing power")] = m * g * (x[elevation] - x_start[elevation])
        return ForwardRun(samples.t, rows, energies, x)

    def _interval(self, x: Array, z: Array, p: Array, t: float, span: float) -> tuple[Array, Array, Array]:
        """Integrate over a time with held commands."""
        z = self._balanced(x, z, p, t)
        (rates,) = self._rates(x, z, p)
        try:
            # What IDAS says on the terminal is of no use to anybody.
            with redirect_stderr(io.StringIO()):
                r = self._advance(x0=x, z0=z, p=np.concatenate([p, rates, [span]]))
        except RuntimeError as error:
            self._interrupts.pass_on()
            if span < SHORTEST:
                end, gained = x + rates * span, self._powers(x, z, p)[0] * span
                over = self._balanced(end, z, p, t)
                if np.abs(over - z).max() > JUMP * max(1.0, np.abs(z).max()):
                    # Balances that fold back: the unknowns jump from one of their edges to the other, and the motion goes on.
                    return end, over, gained
                raise self._error(x, t, str(error).splitlines()[-1]) from None
            middle, z, first = self._interval(x, z, p, t, span / 2)
            end, z, second = self._interval(middle, z, p, t + span / 2, span / 2)
            return end, z, first + second
        self._interrupts.pass_on()
        return np.array(r["xf"]).ravel() + rates * span, np.array(r["zf"]).ravel(), np.array(r["qf"]).ravel() * ENERGY

    def _balanced(self, x: Array, guess: Array, p: Array, t: float) -> Array:
        """Return the unknowns that balance the commands."""
        z = self._newton(guess, x, p, 0.0)
        if z is None:
            z = self._led(x, guess, p)
        for kick in KICKS if z is None else ():
            if (z := self._newton(guess + kick, x, p, 0.0)) is not None:
                break
        if z is None or not np.all(np.abs(z) < Z_MOST):
            raise self._error(x, t, "no acceleration balances the commands")
        return z

    def _newton(self, z: Array, x: Array, p: Array, rest: float | Array) -> Array | None:
        """Return where the balances are `rest`, by Newton's method; each step is cut until the balances come nearer to it."""

        def off(z: Array) -> tuple[Array, Array]:
            balance, slope = self._balance(z, x, p)
            # CasADi has its matrices by columns.
            return balance - rest, slope.reshape(len(z), len(z), order="F")

        error, slope = off(z)
        for _ in range(NEWTON_STEPS):
            step = np.linalg.lstsq(slope, -error, rcond=None)[0]
            share, before = 1.0, np.abs(error).max()
            while True:
                error, slope = off(z + share * step)
                # A kink may ask for a shorter step; a function with jumps, for the shortest.
                if np.abs(error).max() <= (1 - 0.1 * share) * before or share < SHORTEST_SHARE:
                    break
                share /= 2
            z = z + share * step
            if not np.all(np.isfinite(z)):
                return None
            if np.abs(share * step).max() <= Z_EXACT * max(1.0, np.abs(z).max()):
                return z if np.abs(error).max() <= BALANCED * max(1.0, before) else None
        return None

    def _led(self, x: Array, z: Array, p: Array) -> Array | None:
        """Return the unknowns that balance the commands, led there from `z` by balances that fade from what they are at `z`."""
        first = self._balance(z, x, p)[0]
        faded, stride = 0.0, 0.25
        while faded < 1:
            further = min(1.0, faded + stride)
            found = self._newton(z, x, p, (1 - further) * first)
            if found is not None:
                z, faded, stride = found, further, 2 * stride
            elif (stride := stride / 4) < SHORTEST_SHARE:
                return None
        return z

    def _error(self, x: Array, t: float, message: str) -> SolveError:
        return SolveError(f"{self.plant.name}: the integrator stopped at t = {t:g} s, v = {x[self._motion[0]]:g} m/s: {message}")


class Direct:
    """A function of CasADi, called by arrays: making its matrices of them takes some thirty times as long as evaluating it."""

    def __init__(self, function: ca.Function) -> None:
        symbols = function.sx_in()
        f = ca.Function(function.name(), symbols, [ca.densify(x) for x in function.call(symbols)])
        self.arguments = [np.zeros(f.numel_in(i)) for i in range(f.n_in())]
        self.results = [np.zeros(f.numel_out(i)) for i in range(f.n_out())]
        #: What evaluates lives in it.
        self.buffer: Any
        self.buffer, self.evaluate = f.buffer()
        for i, x in enumerate(self.arguments):
            self.buffer.set_arg(i, x.data)
        for i, x in enumerate(self.results):
            self.buffer.set_res(i, x.data)

    def __call__(self, *arguments: Array) -> list[Array]:
        """Return all results, flat."""
        for own, x in zip(self.arguments, arguments, strict=True):
            own[:] = x
        self.evaluate()
        return [x.copy() for x in self.results]


class Interrupts:
    """Remembers an interrupt that comes while it listens, to be raised between two calls of CasADi, which swallows or garbles it within."""

    def __init__(self) -> None:
        self.came = False

    @contextmanager
    def listened_to(self) -> Iterator[None]:
        """Listen, where this is the thread that interrupts come to and they are not ignored."""
        self.came = False
        before = signal.getsignal(signal.SIGINT)
        if before is signal.SIG_IGN or threading.current_thread() is not threading.main_thread():
            yield
            return

        def note(number: int, frame: FrameType | None) -> None:
            # Who is impatient is heard at once.
            if self.came:
                signal.default_int_handler(number, frame)
            self.came = True

        signal.signal(signal.SIGINT, note)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)
        self.pass_on()

    def pass_on(self) -> None:
        """Raise the interrupt that came."""
        if self.came:
            raise KeyboardInterrupt
