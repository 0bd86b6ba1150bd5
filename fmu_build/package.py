"""The FMU as a file: description, C sources, library for this platform, documentation and licence."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from datetime import datetime
from html import escape
from importlib.metadata import distributions
from importlib.resources import files
from pathlib import Path

from halfshaft.fmu_build.compiler import SUFFIX, shared_library
from halfshaft.fmu_build.sources import sources
from halfshaft.fmu_build.variables import CycleTable, Version, check, identifier, variables
from halfshaft.fmu_build.xml import build_description, model_description, plain, timestamp
from halfshaft.library.files.writing import written_whole
from halfshaft.models.assembly import Step


def build_fmu(
    step: Step,
    code: str,
    path: Path | str,
    *,
    fmi: Version,
    step_size: float = 1.0,
    cycle: CycleTable | None = None,
    values: Mapping[str, float] | None = None,
    name: str = "",
    stop_time: float | None = None,
) -> Path:
    """Write a co-simulation FMU and return its path.

    Without a cycle the FMU is driven: requested speed, grade and key are inputs.  With one it is self-contained.

    Parameters
    ----------
    step
        The assembled step.
    code
        Its C, see `halfshaft.fmu_build.code`.
    path
        The file to write; it appears complete or not at all.
    fmi
        Version of the standard.
    step_size
        Length of the internal steps [s].
    cycle
        The cycle to compile in, one row per internal step.
    values
        Start values of parameters by name, where they are not those of the step.
    name
        Name of the model, unless it is that of the step; a cycle's is added.
    stop_time
        Length that a tool simulates by default [s]; with a cycle, the cycle's.

    Raises
    ------
    InputError
        If the cycle, a value or ``SOURCE_DATE_EPOCH`` does not fit, or the file cannot be written.
    CompileError
        If there is no C compiler, or it refuses the code.

    """
    import fmpy  # takes half a second

    check(step, step_size, cycle, values or {})
    time = timestamp()
    name = f"{name or step.name}.{cycle.name}" if cycle else name or step.name
    table = variables(step, step_size, cycle, values or {})
    c = sources(step, name, code, table, cycle, fmi)
    library = shared_library(c.files[c.main], identifier(name), {file: text for file, text in c.files.items() if file != c.main})
    platform = fmpy.platform if fmi == 2 else fmpy.platform_tuple
    content = {
        "modelDescription.xml": model_description(step, name, table, cycle, step_size, stop_time, fmi, c, time),
        f"binaries/{platform}/{identifier(name)}{SUFFIX}": library.read_bytes(),
        "documentation/index.html": _documentation(step, cycle, step_size).encode(),
        **{f"documentation/licenses/{file}": text.encode() for file, text in _licences().items()},
        **{f"sources/{file}": text.encode() for file, text in c.files.items()},
    }
    if fmi == 3:
        content["sources/buildDescription.xml"] = build_description(name, c.main)
    return _write(Path(path), content, time)


def _licences() -> dict[str, str]:
    """Return the licence, under the name that both standards look for, and those of the figures that are compiled in."""
    found = {"license.txt": "LICENSE", "NOTICE.txt": "NOTICE"}
    texts = {name: d.read_text(f"licenses/{file}") for d in distributions(name="halfshaft") for name, file in found.items()}
    figures = files("halfshaft.library").joinpath("data", "LICENSE-source.txt").read_text(encoding="utf-8")
    return {name: text for name, text in texts.items() if text} | {"LICENSE-source.txt": figures}


def _write(path: Path, content: Mapping[str, bytes], time: datetime) -> Path:
    """Write an archive that depends on nothing but its content and a time."""
    # An archive knows the years from 1980 to 2107.
    date = min(max(time.timetuple()[:6], (1980, 1, 1, 0, 0, 0)), (2107, 12, 31, 23, 59, 58))
    with written_whole(path) as part, zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in sorted(content.items()):
            entry = zipfile.ZipInfo(name, date)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.create_system = 3
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, data)
    return path


_DRIVEN = """\
<p>Inputs: <code>v_request</code>, the requested speed, <code>grade</code> and <code>key_on</code>, all at the <em>end</em> of the
communication step. To meet a trace exactly, set its next point before each step, or (FMI 2.0) its value at the start of the step
together with the time derivative, which counts for that step only. In an FMI 3.0 master that sets inputs at the start of a step, such as
FMPy, shift the trace: its first point, at the start time, is the value at the end of the first step. Within a communication step that is
longer than the internal one, the requested speed moves straight from its last value to the one set now; grade and key are held.</p>
<p>The model advances on a grid of internal steps of <code>step_size</code>, {step_size:g} s unless set before the initialization ends.
Communication steps may have any length; shorter ones hold the outputs until the next internal step is due.</p>
"""

_SELF_CONTAINED = """\
<p>The cycle {name} is part of the FMU: {n} internal steps of {step_size:g} s. After its end the last row is held. There are no inputs;
parameters can be set before the initialization ends.</p>
"""


def _documentation(step: Step, cycle: CycleTable | None, step_size: float) -> str:
    title = escape(plain(step.title))
    if cycle:
        body = _SELF_CONTAINED.format(name=escape(plain(cycle.name)), n=len(cycle.v_request), step_size=step_size)
    else:
        body = _DRIVEN.format(step_size=step_size)
    head = f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title></head><body>\n'
    tail = "<p>All values are in SI units. <code>sources</code> holds the complete C; the headers of the standard state their licence.</p>"
    return f"{head}<h1>{title}</h1>\n{body}{tail}\n</body></html>\n"
