"""modelDescription.xml and buildDescription.xml, for FMI 2.0 and 3.0.

Value references are positions in the list of variables.  Every unit gets its exponents of the SI base units from pint.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from typing import Any

from halfshaft.fmu_build.sources import Sources
from halfshaft.fmu_build.variables import CycleTable, Variable, Version, identifier
from halfshaft.library.base.errors import InputError
from halfshaft.library.files.writing import source_date
from halfshaft.models.assembly import Step

# Units that are nicer to read, as name and factor, by the unit that the FMU computes in.
_DISPLAY = {"m/s": ("km/h", 3.6), "rad/s": ("rpm", 9.549296585513721)}
_BASE = {
    "kilogram": "kg", "meter": "m", "second": "s", "ampere": "A",
    "kelvin": "K", "mole": "mol", "candela": "cd", "radian": "rad",
}  # fmt: skip
_VARIABILITY = {"independent": "continuous", "input": "continuous", "output": "continuous", "parameter": "fixed", "local": "constant"}


def timestamp() -> datetime:
    """Return the time that ``SOURCE_DATE_EPOCH`` sets, so that equal input makes equal files, else the present one.

    Raises
    ------
    InputError
        If the variable holds no time.

    """
    return source_date() or datetime.now(UTC)


def plain(text: str) -> str:
    """Return a text without what XML cannot hold, control characters above all."""
    return re.sub(r"[\x00-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]", "", text)


def model_description(
    step: Step,
    name: str,
    table: Sequence[Variable],
    cycle: CycleTable | None,
    step_size: float,
    stop_time: float | None,
    fmi: Version,
    c: Sources,
    time: datetime,
) -> bytes:
    """Return the text of modelDescription.xml."""
    attributes = {
        "fmiVersion": f"{fmi}.0",
        "modelName": name,
        "description": f"{step.title}, driven over {cycle.name}" if cycle else step.title,
        {2: "guid", 3: "instantiationToken"}[fmi]: c.token,
        "generationTool": f"halfshaft {version('halfshaft')}",
        "generationDateAndTime": time.strftime("%Y-%m-%dT%H:%M:%SZ"),
        "variableNamingConvention": "structured",
    }
    root = ET.Element("fmiModelDescription", attributes)
    interface = ET.SubElement(root, "CoSimulation", _capabilities(name, cycle, step_size, fmi))
    if fmi == 2:
        ET.SubElement(ET.SubElement(interface, "SourceFiles"), "File", name=c.main)
    units = ET.SubElement(root, "UnitDefinitions")
    for unit in sorted({v.unit for v in table}):
        _unit(units, unit)
    category = {"name": "logStatusError", "description": "what went wrong and why"}
    ET.SubElement(ET.SubElement(root, "LogCategories"), "Category", category)
    ET.SubElement(root, "DefaultExperiment", _experiment(step_size, step_size * len(cycle.v_request) if cycle else stop_time))
    listed = ET.SubElement(root, "ModelVariables")
    for reference, v in enumerate(table):
        _variable(listed, v, reference, fmi)
    _structure(ET.SubElement(root, "ModelStructure"), step, table, fmi)
    return _text(root)


def build_description(name: str, source: str) -> bytes:
    """Return the text of buildDescription.xml, which FMI 3.0 has."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(root, "BuildConfiguration", modelIdentifier=identifier(name))
    file_set = ET.SubElement(configuration, "SourceFileSet", language="C99")
    ET.SubElement(file_set, "SourceFile", name=source)
    ET.SubElement(configuration, "Library", name="m", external="true", description="mathematics of the C library")
    return _text(root)


def _experiment(step_size: float, stop_time: float | None) -> dict[str, str]:
    if stop_time is None:
        return {"startTime": "0", "stepSize": repr(float(step_size))}
    # A step as long as the whole is no step size to a strict reader.
    step = {"stepSize": repr(float(step_size))} if step_size < stop_time else {}
    return {"startTime": "0", "stopTime": repr(float(stop_time)), **step}


def _capabilities(name: str, cycle: CycleTable | None, step_size: float, fmi: Version) -> dict[str, str]:
    common = {
        "modelIdentifier": identifier(name),
        "needsExecutionTool": "false",
        "canBeInstantiatedOnlyOncePerProcess": "false",
        "canHandleVariableCommunicationStepSize": "true",
    }
    if fmi == 2:
        return common | {
            "canInterpolateInputs": str(cycle is None).lower(),
            "canNotUseMemoryManagementFunctions": "true",
            "canGetAndSetFMUstate": "true",
            "canSerializeFMUstate": "true",
        }
    return common | {
        "canGetAndSetFMUState": "true",
        "canSerializeFMUState": "true",
        **({"fixedInternalStepSize": repr(float(step_size))} if cycle else {}),
        "providesIntermediateUpdate": "false",
        "hasEventMode": "false",
    }


@cache
def _registry() -> Any:
    import pint  # takes half a second

    return pint.UnitRegistry()


def _unit(parent: ET.Element, unit: str) -> None:
    attributes = {}
    if unit != "1":
        # Our units write products with a point: "J/(kg.K)".
        try:
            base = _registry().Quantity(1.0, unit.replace(".", "*")).to_base_units()
            attributes = {_BASE[name]: f"{exponent:.0f}" for name, exponent in base.unit_items() if exponent == round(exponent)}
            if len(attributes) < len(base.unit_items()):
                raise ValueError("an exponent is not a whole number")
        except Exception as error:  # pint has many
            raise InputError(f"unit '{unit}'", [f"is not made of SI units: {error}"]) from error
        if base.magnitude != 1.0:
            attributes["factor"] = repr(float(base.magnitude))
    element = ET.SubElement(parent, "Unit", name=unit)
    ET.SubElement(element, "BaseUnit", attributes)
    if unit in _DISPLAY:
        name, factor = _DISPLAY[unit]
        ET.SubElement(element, "DisplayUnit", name=name, factor=repr(factor))


def _variable(parent: ET.Element, v: Variable, reference: int, fmi: Version) -> None:
    general = {"name": v.name, "valueReference": str(reference), "description": v.doc}
    general |= {"causality": v.causality, "variability": _VARIABILITY[v.causality]}
    number = {"unit": v.unit}
    if v.unit in _DISPLAY:
        number["displayUnit"] = _DISPLAY[v.unit][0]
    if v.lowest is not None:
        number["min"] = repr(float(v.lowest))
    if v.highest is not None:
        number["max"] = repr(float(v.highest))
    if v.causality == "output":
        general["initial"] = "calculated"
    elif v.causality != "independent":
        number["start"] = repr(float(v.start))
    if fmi == 2:
        ET.SubElement(ET.SubElement(parent, "ScalarVariable", general), "Real", number)
    else:
        ET.SubElement(parent, "Float64", general | number)


def _structure(structure: ET.Element, step: Step, table: Sequence[Variable], fmi: Version) -> None:
    """Say what outputs depend on.

    At a communication point they are what the last internal step left, whatever the inputs are now.  During the
    initialization those that show a state depend on the parameters that its start value is computed from.
    """
    first = 1 if fmi == 2 else 0
    parameters = [first + reference for reference, v in enumerate(table) if v.causality == "parameter" and v.name != "step_size"]
    sources: dict[int | None, list[int]] = {}
    for state, column in zip(*step.start.jac_sparsity(0, 0).get_triplet(), strict=True):
        sources.setdefault(state, []).append(parameters[column])
    initial = {str(first + reference): sources.get(v.state, []) for reference, v in enumerate(table) if v.causality == "output"}
    for kind in ("Output", "InitialUnknown"):
        parent = ET.SubElement(structure, f"{kind}s") if fmi == 2 else structure
        for number, known in initial.items():
            which = {"index" if fmi == 2 else "valueReference": number}
            dependencies = " ".join(map(str, sorted(known))) if kind == "InitialUnknown" else ""
            ET.SubElement(parent, "Unknown" if fmi == 2 else kind, which, dependencies=dependencies)


def _text(root: ET.Element) -> bytes:
    for element in root.iter():
        element.attrib.update({name: plain(text) for name, text in element.attrib.items()})
    ET.indent(root)
    return bytes(ET.tostring(root, encoding="UTF-8", xml_declaration=True)) + b"\n"
