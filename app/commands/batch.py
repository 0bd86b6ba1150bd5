"""Many vehicles of one structure."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.markup import escape

from halfshaft.app.options import Checks, CycleName, Json, Mass, Soc, Values, VehicleName
from halfshaft.app.output import busy, console, new_table, print_json, print_line, print_written
from halfshaft.app.program import app
from halfshaft.cosim.ways import Mode

if TYPE_CHECKING:
    import xarray as xr


@app.command(
    "batch",
    help="""Run thousands of vehicles that differ in numbers only.

    The vehicles stand in a CSV file: a column for each number, titled body.m or "motor.P_max [kW]", and a line for each
    vehicle. Parts, tests and corrections are varied by halfshaft sweep.

    \b
    Examples:
      halfshaft batch small-car-electric --cycle udds --table cars.csv
      halfshaft batch small-car-series --cycle us06 --table cars.csv --mode refined --out found.csv
    """,
)
def _batch(
    vehicle: VehicleName,
    cycle: CycleName,
    table: Annotated[Path, typer.Option(metavar="CSV", help="The numbers of the vehicles.", show_default=False)],
    mode: Annotated[Mode, typer.Option(help="How each step is solved.")] = "hybrid",
    dt: Annotated[float, typer.Option(metavar="S", help="Length of the step [s].")] = 1.0,
    threads: Annotated[int | None, typer.Option(metavar="N", help="As many as there are cores if not given.")] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Write a line for each vehicle (.csv), or a dataset (.nc).")] = None,
    mass: Mass = None,
    values: Values = None,
    soc: Soc = None,
    as_json: Json = False,
) -> None:
    from halfshaft.cosim.cycle import Cycle
    from halfshaft.studies.batch import run_batch
    from halfshaft.studies.table import read_table

    checks = Checks()
    given = checks.vehicle(vehicle, mass, values, soc)
    trace = checks.take(lambda: Cycle.load(cycle))
    checks.step(dt, trace)
    numbers = None if given is None else checks.take(partial(read_table, table, given))
    checks.target(out, "--out")
    if out is not None and out.suffix not in (".csv", ".nc"):
        checks.problem(f"--out {out}: must end in .csv or .nc")
    car, trace, numbers = checks.done(given), checks.done(trace), checks.done(numbers)
    n = len(next(iter(numbers.values())))
    with busy(f"{n} vehicles {car.name} over {trace.name}"):
        found = run_batch(car, numbers, trace, mode=mode, dt=dt, threads=threads)
        if out is not None:
            _write(found, out)
    if as_json:
        print_json({"vehicles": n, "lost": int(found["status"].sum()), "table": {str(k): x.values for k, x in found.variables.items()}})
        return
    _print(f"{n} vehicles {car.name} over {trace.name}", found)
    print_written(out)


def _write(found: xr.Dataset, out: Path) -> None:
    from halfshaft.library.files.writing import written_whole

    with written_whole(out) as part:
        if out.suffix == ".nc":
            part.write_bytes(found.to_netcdf(engine="h5netcdf"))
        else:
            found.to_dataframe().to_csv(part)


def _print(title: str, found: xr.Dataset) -> None:
    """Print where each figure is lowest and highest, and its mean."""
    out, shown = console(), new_table()
    out.print(f"[bold]{escape(title)}[/]", highlight=False, soft_wrap=True)
    for heading in ("figure", "lowest", "mean", "highest"):
        shown.add_column(heading, justify="left" if heading == "figure" else "right")
    for name, x in found.data_vars.items():
        if name not in ("status", "lost_by") and x.dtype.kind == "f" and x.notnull().any():
            shown.add_row(escape(str(name)), *(f"{float(v):.5g}" for v in (x.min(), x.mean(), x.max())))
    out.print(shown)
    if lost := int(found["status"].sum()):
        print_line(f"  ! {lost} vehicles lost a number and have no figures", "yellow")
