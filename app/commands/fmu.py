"""FMUs of vehicles."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from halfshaft.app.options import Checks, CycleNameOrNone, GradeFile, Mass, Soc, Values, VehicleName
from halfshaft.app.output import busy, print_line
from halfshaft.app.program import app


@app.command(
    "fmu",
    help="""Write a vehicle as a co-simulation FMU.

    Without --cycle, requested speed, grade and key are inputs; with it, the FMU drives the cycle by itself.

    \b
    Examples:
      halfshaft fmu small-car-series --fmi 3 -o car.fmu
      halfshaft fmu small-car-electric --fmi 2 --cycle udds --dt 0.5 -o udds.fmu
    """,
)
def _fmu(
    vehicle: VehicleName,
    fmi: Annotated[Literal["2", "3"], typer.Option(help="Version of the standard.", show_default=False)],
    output: Annotated[Path, typer.Option("--out", "-o", metavar="FILE", help="The FMU to write.", show_default=False)],
    cycle: CycleNameOrNone = None,
    dt: Annotated[float, typer.Option(metavar="S", help="Length of the internal steps [s].")] = 1.0,
    grade: GradeFile = None,
    mass: Mass = None,
    values: Values = None,
    soc: Soc = None,
) -> None:
    from halfshaft.cosim.cycle import Cycle
    from halfshaft.cosim.fmu import build_fmu, fmu_problems

    version: Literal[2, 3] = 2 if fmi == "2" else 3
    checks = Checks()
    found = checks.vehicle(vehicle, mass, values, soc)
    trace = None if cycle is None else checks.take(lambda: Cycle.load(cycle, grade))
    if grade is not None and cycle is None:
        checks.problem("--grade goes with --cycle; without a cycle the grade is an input of the FMU")
    checks.step(dt, trace)
    if checks.step_fits:
        checks.problem(*fmu_problems(version, trace, dt))
    checks.target(output, "--out")
    if output.suffix.lower() != ".fmu":
        checks.problem(f"--out {output}: the name of an FMU ends in .fmu")
    car = checks.done(found)
    with busy(f"building {output}"):
        path = build_fmu(car, output, fmi=version, cycle=trace, dt=dt)
    what = f"drives {trace.name}" if trace else "driven by requested speed, grade and key"
    print_line(f"{path}: FMI {fmi}.0, {path.stat().st_size / 1024:.0f} KiB, {what}")
