"""A vehicle over a cycle."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from halfshaft.app.options import Checks, CycleName, GradeFile, Gradient, Json, Mass, Shown, Smooth, Soc, Values, VehicleName
from halfshaft.app.output import VIA, busy, print_run, print_run_json, print_written
from halfshaft.app.program import app
from halfshaft.cosim.ways import Mode, Via


@app.command(
    "run",
    help="""Run a vehicle over a cycle.

    \b
    Examples:
      halfshaft run small-car-series --cycle us06
      halfshaft run small-car-electric --cycle udds --soc 0.9 --plot udds.png
      halfshaft run small-car-electric --cycle udds --mass 1500 --units us
      halfshaft run small-car-power-split --cycle us06 --flows flows.png
      halfshaft run my-car.toml --cycle trip.csv --grade road.csv --out trip.nc
      halfshaft run my-car.toml --cycle us06 --set engine.J="0.2 kg m^2" --json
      halfshaft run small-car-series --cycle udds --gradient body.c_d
    """,
)
def _run(
    vehicle: VehicleName,
    cycle: CycleName,
    via: Annotated[Via, typer.Option(help="The compiled step, an FMU of it through FMPy, or the forward-facing model.")] = "step",
    mode: Annotated[Mode, typer.Option(help="The paper's method; solved for the best end speed; the paper's benchmark.")] = "hybrid",
    dt: Annotated[float, typer.Option(metavar="S", help="Length of the step [s].")] = 1.0,
    grade: GradeFile = None,
    smooth: Smooth = None,
    mass: Mass = None,
    values: Values = None,
    soc: Soc = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE.nc", help="Write all time series to a netCDF file.")] = None,
    csv: Annotated[Path | None, typer.Option(metavar="FILE.csv", help="Write all time series to a CSV file.")] = None,
    plot: Annotated[Path | None, typer.Option(metavar="FILE.png", help="Draw the run (.png, .svg, .pdf).")] = None,
    flows: Annotated[Path | None, typer.Option(metavar="FILE.png", help="Draw where the energy flowed.")] = None,
    points: Annotated[Path | None, typer.Option(metavar="FILE.png", help="Draw the operating points of machines on their maps.")] = None,
    gradient: Gradient = None,
    units: Shown = "metric",
    as_json: Json = False,
) -> None:
    from halfshaft.cosim.cycle import Cycle
    from halfshaft.cosim.simulate import run

    checks = Checks()
    car = checks.vehicle(vehicle, mass, values, soc)
    trace = checks.take(lambda: Cycle.load(cycle, grade) if smooth is None else Cycle.load(cycle, grade).smoothed(smooth))
    checks.step(dt, trace)
    if mode != "hybrid" and via != "step":
        checks.problem(f"mode {mode} runs via step only, not via {via}")
    if gradient and via != "step":
        checks.problem(f"a gradient is found via step only, not via {via}")
    checks.numbers(car, gradient, "--gradient")
    if via in ("fmu2", "fmu3") and trace is not None and checks.step_fits:
        from halfshaft.cosim.fmu import fmu_problems

        checks.problem(*fmu_problems(3, trace, dt))
    checks.target(out, "--out")
    checks.target(csv, "--csv")
    for option, picture in (("--plot", plot), ("--flows", flows), ("--points", points)):
        checks.picture(picture, option)
    car, trace = checks.done(car), checks.done(trace)
    with busy(f"{VIA[via]}: {car.name} over {trace.name}"):
        result = run(car, trace, via=via, dt=dt, mode=mode, gradient=gradient or ())
    if out is not None:
        with busy(f"writing {out}"):
            result.save(out)
    if csv is not None:
        with busy(f"writing {csv}"):
            result.save_csv(csv)
    if plot is not None:
        from halfshaft.cosim.plot import plot_run

        with busy(f"drawing {plot}"):
            plot_run(result, units=units, path=plot)
    if flows is not None:
        from halfshaft.cosim.flow_plot import plot_flows

        plot_flows(result, path=flows)
    if points is not None:
        from halfshaft.cosim.points import plot_points

        plot_points(result, units=units, path=points)
    if as_json:
        print_run_json(result)
        return
    print_run(result, units)
    print_written(out, csv, plot, flows, points)
