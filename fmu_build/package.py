"""The FMU as a file: description, C sources, library for this platform, documentation and licence."""

from __future__ import annotations

import os
import tempfile
import zipfile
from collections.abc import Mapping
from html import escape
from importlib.metadata import distribution
from pathlib import Path

from halfshaft.fmu_build.compiler import SUFFIX, shared_library
from halfshaft.fmu_build.interface import CycleTable, Model, Version, check, variables
from halfshaft.fmu_build.sources import sources
from halfshaft.fmu_build.xml import build_description, model_description, timestamp
from halfshaft.library.errors import InputError


def build_fmu(model: Model, code: str, path: Path | str, *, fmi: Version, step_size: float = 1.0, cycle: CycleTable | None = None) -> Path:
    """Write a co-simulation FMU and return its path.

    Without a cycle the FMU is driven: requested speed, grade and key are inputs.  With one it is self-contained.

    Parameters
    ----------
    model
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

    Raises
    ------
    InputError
        If the cycle does not fit or the file cannot be written.
    CompileError
        If there is no C compiler, or it refuses the code.

    """
    import fmpy  # noqa: PLC0415 - takes half a second

    check(model, step_size, cycle)
    table = variables(model, step_size, cycle)
    c = sources(model, code, table, cycle, fmi)
    library = shared_library(c.files[c.main], model.name, {name: text for name, text in c.files.items() if name != c.main})
    platform = fmpy.platform if fmi == 2 else fmpy.platform_tuple
    content = {
        "modelDescription.xml": model_description(model, table, cycle, step_size, fmi, c.token, c.main),
        f"binaries/{platform}/{model.name}{SUFFIX}": library.read_bytes(),
        "documentation/index.html": _documentation(model, cycle, step_size).encode(),
        **{f"sources/{name}": text.encode() for name, text in c.files.items()},
    }
    if fmi == 3:
        content["sources/buildDescription.xml"] = build_description(model, c.main)
    licence = distribution("halfshaft").read_text("licenses/LICENSE")
    if licence:
        content["documentation/licenses/halfshaft.txt"] = licence.encode()
    return _write(Path(path), content)


def _write(path: Path, content: Mapping[str, bytes]) -> Path:
    """Write an archive that depends on nothing but its content."""
    try:
        with tempfile.TemporaryDirectory(prefix=".fmu-", dir=path.parent) as folder:
            part = Path(folder, "part")
            with zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as archive:
                for name, data in sorted(content.items()):
                    entry = zipfile.ZipInfo(name, timestamp().timetuple()[:6])
                    entry.compress_type = zipfile.ZIP_DEFLATED
                    entry.create_system = 3
                    entry.external_attr = 0o644 << 16
                    archive.writestr(entry, data)
            os.replace(part, path)
    except OSError as error:
        raise InputError(str(path), [f"cannot be written: {error.strerror or error}"]) from error
    return path


_DRIVEN = """\
<p>Inputs: <code>v_request</code>, the requested speed at the <em>end</em> of the communication step; <code>grade</code> and
<code>key_on</code>, which hold during the step. To meet a speed trace exactly, set the value of the next point of the trace before each
step, or (FMI 2.0) the value at the start of the step together with its time derivative, which counts for that step only. In an FMI 3.0
master that sets inputs at the start of a step, such as FMPy, shift the trace: its first point, at the start time, is the speed at the
end of the first step. Within a communication step that is longer than the internal one, the request moves straight from its last value
to the one set now.</p>
<p>The model advances on a grid of internal steps of <code>step_size</code>, {step_size:g} s unless set before the initialization ends.
Communication steps may have any length; shorter ones hold the outputs until the next internal step is due.</p>
"""

_SELF_CONTAINED = """\
<p>The cycle {name} is part of the FMU: {n} internal steps of {step_size:g} s. After its end the last row is held. There are no inputs;
parameters can be set before the initialization ends.</p>
"""


def _documentation(model: Model, cycle: CycleTable | None, step_size: float) -> str:
    title = escape(model.title)
    if cycle:
        body = _SELF_CONTAINED.format(name=escape(cycle.name), n=len(cycle.v_request), step_size=step_size)
    else:
        body = _DRIVEN.format(step_size=step_size)
    head = f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title></head><body>\n'
    tail = "<p>All values are in SI units. <code>sources</code> holds the complete C99; the headers of the standard carry their own licence.</p>"
    return f"{head}<h1>{title}</h1>\n{body}{tail}\n</body></html>\n"
