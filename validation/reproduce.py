"""Reproduces the paper: tables 2 to 5, figures 2, 3, 5, 6, 7, 9 and 10, and a report.

Four methods run side by side: the paper's *hybrid* method, its benchmark by *iteration*, our *refined* hybrid, and the
*forward*-facing model, which shares the parts but not the method.
"""

from __future__ import annotations

import itertools
import json
import os
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from halfshaft.cosim.compiled import MODES, Mode
from halfshaft.cosim.cycle import Cycle
from halfshaft.cosim.result import Result
from halfshaft.cosim.simulate import Via, run
from halfshaft.library.base.errors import InputError, SolveError
from halfshaft.models.vehicle import Vehicle
from halfshaft.studies.acceleration import accelerate
from halfshaft.validation import paper
from halfshaft.validation.figures import DARK, LIGHT, Drawing, acceleration_drawings, deviations_drawing, png, speeds_drawing
from halfshaft.validation.powertrains import TASKS, comparison, first_of_each
from halfshaft.validation.report import report

#: The current limit of figures 2 to 7 [A]: the paper's 57 kW at the 353 V that the loaded pack has.
I_MAX = 161.0

#: How often the runs of table 5 take turns.
TURNS = 3

#: How each method runs.
METHODS: dict[str, tuple[Mode, Via]] = {**{mode: (mode, "step") for mode in MODES}, "forward": ("hybrid", "forward")}

Table = dict[str, list[Any]]
#: Results by method and vehicle.
Runs = dict[str, dict[str, Result]]


def reproduce(out: Path | None = None, progress: Callable[[str], None] | None = None) -> dict[str, Any]:
    """Run what the paper ran.

    Parameters
    ----------
    out
        Folder for the figures, ``tables.json`` and ``report.html``; without it nothing is drawn or written.
    progress
        Is told what is being run.

    Returns
    -------
    dict
        ``tables`` by number: lists in the paper's order by method, ``paper`` and ``paper_iteration`` (``paper_forward``),
        and differences in per cent; ``powertrains``: every powertrain by the step and forward-facing; ``figures`` with the
        values that the paper names; ``notes`` on what did not run.

    Raises
    ------
    InputError
        If a file cannot be written.

    """
    steps = len(METHODS) + len(speed_tasks()) + len(first_of_each()) * len(TASKS) + (1 if out is None else 2)
    count = itertools.count(1)

    def say(what: str) -> None:
        if progress is not None:
            progress(f"step {next(count)} of {steps}: {what}")

    notes: list[str] = []
    cars = {f"{m} kg": Vehicle.load(f"paper-series-{m}") for m in paper.MASSES}
    us06 = Cycle.load("us06").scaled(paper.SPEED_1999)
    accelerations: Runs = {}
    cycles: Runs = {}
    two: Table = {}
    three: Table = {}
    four: Table = {}
    no_inertia = cars["1936 kg"].with_values({"motor.J": 0.0})
    for method, (mode, via) in METHODS.items():
        say(f"tables 2, 3 and 4: {method}")
        done = {name: accelerate(car, mode=mode, via=via) for name, car in cars.items()}
        accelerations[method] = {name: a.result for name, a in done.items()}
        cycles[method] = {name: run(car, us06, mode=mode, via=via) for name, car in cars.items()}
        two[method] = [a.time for a in done.values()]
        three[method] = [_motor_input(r) for r in cycles[method].values()]
        four[method] = [accelerate(no_inertia, mode=mode, via=via).time, _motor_input(run(no_inertia, us06, mode=mode, via=via))]
    tables = {
        "2": _compared(two, paper.TABLE_2),
        "3": _compared(three, paper.TABLE_3),
        "4": _compared(four, paper.TABLE_4),
        "5": _speed(say, notes),
    }
    powertrains = [row._asdict() for row in comparison(progress=say)]
    say("figures")
    limited = accelerate(cars["2393 kg"].with_values({"motor.I_max": I_MAX}), mode="hybrid").result
    result: dict[str, Any] = {
        "source": paper.SOURCE,
        "tables": tables,
        "figures": figure_facts(limited, accelerations, cycles),
        "powertrains": powertrains,
        "notes": notes,
    }
    if out is not None:
        drawings: dict[str, Drawing] = {
            **acceleration_drawings(limited),
            "9": speeds_drawing(accelerations["hybrid"], accelerations["iteration"]),
            "10": deviations_drawing(cycles["hybrid"]),
        }
        say("report")
        _write(out, result, drawings)
    return result


def _motor_input(r: Result) -> float:
    """Return the electrical energy into the motor, regenerated energy subtracted [kWh]."""
    return r.energies["motor.P_in"] / 3.6e6


def _percent(values: list[Any], reference: list[Any]) -> list[float | None]:
    return [None if x is None or not ref else 100 * (x / ref - 1) for x, ref in zip(values, reference, strict=True)]


def _compared(table: Table, printed: paper.Accuracy) -> Table:
    return {
        **table,
        "paper": list(printed.hybrid),
        "paper_iteration": list(printed.iteration),
        "difference": _percent(table["hybrid"], table["iteration"]),
        "difference_refined": _percent(table["refined"], table["iteration"]),
        "difference_forward": _percent(table["forward"], table["iteration"]),
        "paper_difference": list(printed.difference),
        "hybrid_to_paper": _percent(table["hybrid"], list(printed.hybrid)),
        "iteration_to_paper": _percent(table["iteration"], list(printed.iteration)),
    }


def speed_tasks() -> dict[str, Callable[[Via], Result]]:
    """Return the tasks of table 5 with the small conventional car: 50 s of full acceleration at 0.1 s, and two cycles at 1 s."""
    car = Vehicle.load("small-car-conventional")
    udds, hwfet = Cycle.load("udds"), Cycle.load("hwfet")
    return {
        "max. accel.": lambda via: accelerate(car, mode="hybrid", via=via, duration=50).result,
        "FUDS": lambda via: run(car, udds, via=via),
        "HFET": lambda via: run(car, hwfet, via=via),
    }


def _speed(say: Callable[[str], None], notes: list[str]) -> Table:
    """Return table 5: processor time of a whole run, history included, and how often one goes into the other.

    The runs take turns, so that both see the same machine: medians of `TURNS`, and the lowest and the highest ratio.
    """
    hybrid: list[float] = []
    forward: list[float | None] = []
    ratio: list[float | None] = []
    spread: list[tuple[float, float] | None] = []
    # Both models are built before they are timed.
    for name, task in speed_tasks().items():
        say(f"table 5: {name}")
        task("step")
        if not forward:
            task("forward")
        ours: list[float] = []
        theirs: list[float] = []
        for _ in range(TURNS):
            ours.append(statistics.median(_timed(task, "step") for _ in range(9)))
            try:
                theirs.append(_timed(task, "forward"))
            except SolveError as error:
                notes.append(f"table 5, {name}: the forward-facing model did not finish: {error}")
                break
        ratios = [f / h for f, h in zip(theirs, ours, strict=False)]
        hybrid.append(statistics.median(ours))
        forward.append(statistics.median(theirs) if theirs else None)
        ratio.append(statistics.median(ratios) if ratios else None)
        spread.append((min(ratios), max(ratios)) if ratios else None)
    return {
        "hybrid": hybrid,
        "forward": forward,
        "ratio": ratio,
        "ratio_spread": spread,
        "paper": list(paper.TABLE_5.hybrid),
        "paper_forward": list(paper.TABLE_5.forward),
        "paper_ratio": list(paper.TABLE_5.ratio),
    }


def _timed(task: Callable[[Via], Result], via: Via) -> float:
    start = time.thread_time()
    task(via)
    return time.thread_time() - start


def figure_facts(limited: Result, accelerations: Runs, cycles: Runs) -> dict[str, dict[str, float]]:
    """Return the values that the paper's text names for its figures, from our runs."""
    t, torques = limited.time, (limited["motor.tau_required"], limited["motor.tau_limited"])
    over_current = t[limited["motor.P_map"] > limited["motor.P_in_required"] + 1]
    end = np.flatnonzero(np.diff(over_current) > 0.15)
    over_speed = t[limited["motor.omega_required"] > limited["motor.omega"] + 1e-6]
    apart = [
        float(np.abs(r["body.v"] - accelerations["iteration"][name]["body.v"])[r["body.v"] < 100 / 3.6].max()) * 3.6
        for name, r in accelerations["hybrid"].items()
    ]
    behind = {f"miss_{name.split()[0]}_kmh": max(float(r["body.trace_miss"].max()), 0.0) * 3.6 for name, r in cycles["hybrid"].items()}
    return {
        "2": {"F_required_max_N": float(limited["body.F_required"].max()), "F_limited_max_N": float(limited["wheel.F_limited"].max())},
        "3": {"v_end_kmh": float(limited["body.v"][-1]) * 3.6, "v_limited_end_kmh": float(limited["wheel.v_limited"][-1]) * 3.6},
        "5": dict(zip(("tau_required_max_Nm", "tau_limited_max_Nm"), (float(tau.max()) for tau in torques), strict=True)),
        "6": {"t_top_speed_s": float(over_speed[0]), "omega_top": float(limited["motor.omega"].max())},
        "7": {
            "t_current_from_s": float(over_current[0]),
            "t_current_to_s": float(over_current[end[0]] if len(end) else over_current[-1]),
            "P_map_max_W": float(limited["motor.P_map"].max()),
            "P_required_max_W": float(limited["motor.P_in_required"].max()),
        },
        "9": {"largest_gap_kmh": max(apart)},
        "10": behind,
    }


def _write(out: Path, result: dict[str, Any], drawings: dict[str, Drawing]) -> None:
    """Write all files aside, then put each in its place."""
    light = {number: png(drawing, LIGHT) for number, drawing in drawings.items()}
    dark = {number: png(drawing, DARK) for number, drawing in drawings.items()}
    content = {f"figure-{number}.png": image for number, image in light.items()}
    content["tables.json"] = (json.dumps(result, indent=2) + "\n").encode()
    content["report.html"] = report(result, light, dark).encode()
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".new-", dir=out) as aside:
            for name, data in content.items():
                Path(aside, name).write_bytes(data)
            for name in content:
                os.replace(Path(aside, name), out / name)
    except OSError as error:
        raise InputError(str(out), [f"cannot be written: {error.strerror or error}"]) from error
