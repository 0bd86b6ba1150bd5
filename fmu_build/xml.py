"""modelDescription.xml and buildDescription.xml, for FMI 2.0 and 3.0.

Value references are positions in the list of variables.  Every unit gets its exponents of the SI base units from pint.
"""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from typing import Any

from halfshaft.fmu_build.variables import CycleTable, Variable, Version
from halfshaft.library.errors import InputError
from halfshaft.models.assembly import Step

# Units that are nicer to read, as name and factor, by the unit that the FMU computes in.
_DISPLAY = {"m/s": ("km/h", 3.6), "rad/s": ("rpm", 9.549296585513721)}
_BASE = {
    "kilogram": "kg", "meter": "m", "second": "s", "ampere": "A",
    "kelvin": "K", "mole": "mol", "candela": "cd", "radian": "rad",
}  # fmt: skip
_VARIABILITY = {"independent": "continuous", "input": "continuous", "output": "continuous", "parameter": "fixed", "local": "constant"}


def timestamp() -> datetime:
    """Return the time that ``SOURCE_DATE_EPOCH`` sets, else the first of 1980, so that equal input makes equal files."""
    return datetime.fromtimestamp(int(os.environ.get("SOURCE_DATE_EPOCH") or 315532800), UTC)


def model_description(
    step: Step, table: Sequence[Variable], cycle: CycleTable | None, step_size: float, fmi: Version, token: str, source: str
) -> bytes:
    """Return the text of modelDescription.xml; `source` is the C file to compile."""
    attributes = {
        "fmiVersion": f"{fmi}.0",
        "modelName": f"{step.name}.{cycle.name}" if cycle else step.name,
        "description": f"{step.title}, driven over {cycle.name}" if cycle else step.title,
        {2: "guid", 3: "instantiationToken"}[fmi]: token,
        "generationTool": f"halfshaft {version('halfshaft')}",
        "generationDateAndTime": timestamp().strftime("%Y-%m-%dT%H:%M:%SZ"),
        "variableNamingConvention": "structured",
    }
    root = ET.Element("fmiModelDescription", attributes)
    interface = ET.SubElement(root, "CoSimulation", _capabilities(step, cycle, step_size, fmi))
    if fmi == 2:
        ET.SubElement(ET.SubElement(interface, "SourceFiles"), "File", name=source)
    units = ET.SubElement(root, "UnitDefinitions")
    for unit in sorted({v.unit for v in table}):
        _unit(units, unit)
    category = {"name": "logStatusError", "description": "what went wrong and why"}
    ET.SubElement(ET.SubElement(root, "LogCategories"), "Category", category)
    stop = step_size * (len(cycle.v_request) if cycle else 1)
    ET.SubElement(root, "DefaultExperiment", startTime="0", stopTime=repr(float(stop)), stepSize=repr(float(step_size)))
    listed = ET.SubElement(root, "ModelVariables")
    for reference, v in enumerate(table):
        _variable(listed, v, reference, fmi)
    _structure(ET.SubElement(root, "ModelStructure"), table, fmi)
    return _text(root)


def build_description(step: Step, source: str) -> bytes:
    """Return the text of buildDescription.xml, which FMI 3.0 has."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(root, "BuildConfiguration", modelIdentifier=step.name)
    file_set = ET.SubElement(configuration, "SourceFileSet", language="C99")
    ET.SubElement(file_set, "SourceFile", name=source)
    ET.SubElement(configuration, "Library", name="m", external="true", description="mathematics of the C library")
    return _text(root)


def _capabilities(step: Step, cycle: CycleTable | None, step_size: float, fmi: Version) -> dict[str, str]:
    common = {
        "modelIdentifier": step.name,
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
        "fixedInternalStepSize": repr(float(step_size)),
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


def _structure(parent: ET.Element, table: Sequence[Variable], fmi: Version) -> None:
    outputs = [reference for reference, v in enumerate(table) if v.causality == "output"]
    if fmi == 2:
        for element in (ET.SubElement(parent, "Outputs"), ET.SubElement(parent, "InitialUnknowns")):
            for reference in outputs:
                ET.SubElement(element, "Unknown", index=str(reference + 1))
    else:
        for kind in ("Output", "InitialUnknown"):
            for reference in outputs:
                ET.SubElement(parent, kind, valueReference=str(reference))


def _text(root: ET.Element) -> bytes:
    ET.indent(root)
    return bytes(ET.tostring(root, encoding="UTF-8", xml_declaration=True)) + b"\n"
