"""The XML files of an FMU: its variables, and how to build it."""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree import ElementTree as ET

from leastaction.exporters.shared import unused
from leastaction.findings import as_given
from leastaction.kinds import is_mapping
from leastaction.library import format_expression
from leastaction.model.model import LagrangianModel

__all__ = ["Variable", "build_description", "model_description", "variables"]


@dataclass(frozen=True)
class Variable:
    """One variable; its value reference is its place in the list."""

    name: str
    description: str
    causality: str
    variability: str
    initial: str | None = None
    start: float | None = None
    unit: str = ""


_UNITS = {
    "s": {"s": "1"},
    "rad": {"rad": "1"},
    "rad/s": {"rad": "1", "s": "-1"},
    "rad/s2": {"rad": "1", "s": "-2"},
    "m": {"m": "1"},
    "m/s": {"m": "1", "s": "-1"},
    "m/s2": {"m": "1", "s": "-2"},
    "N": {"kg": "1", "m": "1", "s": "-2"},
    "N.m": {"kg": "1", "m": "2", "s": "-2"},
}
"""Name of a unit -> exponents of its base units."""
_NAMES = {"position": {"m": "m", "rad": "rad"}, "force": {"N": "N", "N m": "N.m"}}
"""Quantity -> units that files state -> their names in an FMU."""
_SOURCES = ("model.c", "motion.c")  # in addition to the file of the version


def variables(model: LagrangianModel, max_step: float) -> list[Variable]:
    """Return all variables, in the sequence that ``motion.h`` fixes."""
    out: list[Variable] = []
    # Coordinates keep their names; names of other variables change if they clash.
    taken = {*model.coordinates, *(f"{c}_dot" for c in model.coordinates)}

    def add(name: str, *rest, keep: bool = False, **more) -> None:
        free = name if keep else unused(name, sorted(taken))
        taken.add(free)
        out.append(Variable(free, *rest, **more))

    unit_of, force_unit = _known_units(model)
    exact = {"initial": "exact", "start": 0.0, "keep": True}
    add("time", "time in seconds", "independent", "continuous", unit="s")
    for c, unit in unit_of.items():
        add(c, f"coordinate {c}", "output", "continuous", unit=unit, **exact)
    for c, unit in unit_of.items():
        add(f"{c}_dot", f"velocity of {c}", "output", "continuous", unit=unit and f"{unit}/s", **exact)
    for c, unit in unit_of.items():
        text = f"acceleration of {c}"
        add(f"{c}_dot_dot", text, "output", "continuous", initial="calculated", unit=unit and f"{unit}/s2")
    add("energy", "sum of qdot * dL/dqdot, minus L", "output", "continuous", initial="calculated")
    for c in model.coordinates:
        what = f"acceleration of {c}" if c in model.prescribed else f"generalised force on {c}"
        add(f"{c}_force", what, "input", "continuous", start=0.0, unit=force_unit[c])
    text = "longest internal step of the integration, in seconds"
    add("max_step", text, "parameter", "tunable", initial="exact", start=max_step, unit="s")
    groups = (
        ("lagrangian", "L", model.terms, model.expressions),
        ("dissipation", "the dissipation function", model.dissipation, model.dissipation_expressions),
    )
    widths = model.fit.smoothing_widths
    for name, whole, terms, expressions in groups:
        for k, (term, expr) in enumerate(zip(terms, expressions, strict=True), start=1):
            text = f"coefficient of {as_given(format_expression(expr), widths)} in {whole}"
            add(f"{name}_{k}", text, "parameter", "tunable", initial="exact", start=term.coefficient)
    return out


def _known_units(model: LagrangianModel) -> tuple[dict[str, str], dict[str, str]]:
    """Units of each coordinate and of its input, empty where the data stated none; an angle is in radians.

    The input is a force, or the acceleration of a prescribed coordinate.
    """
    stated = model.provenance.get("units")
    found: dict[str, dict[str, str]] = {}
    for quantity, names in _NAMES.items():
        own = stated.get(quantity) if is_mapping(stated) else None
        known = own if is_mapping(own) else {}
        # str: a model file may hold anything here, also what cannot be a key
        found[quantity] = {c: names.get(str(known.get(c)), "") for c in model.coordinates}
    position = {c: "rad" if c in model.angles else unit for c, unit in found["position"].items()}
    prescribed = {c: position[c] and f"{position[c]}/s2" for c in model.prescribed}
    return position, found["force"] | prescribed


def model_description(name: str, version: int, table: list[Variable], token: str) -> str:
    """Return modelDescription.xml of FMI 2.0 or 3.0."""
    head = {"fmiVersion": f"{version}.0", "modelName": name}
    head |= {"guid" if version == 2 else "instantiationToken": token, "generationTool": "leastaction"}
    root = ET.Element("fmiModelDescription", head)
    able = {"modelIdentifier": name, "canHandleVariableCommunicationStepSize": "true"}
    if version == 2:
        able |= {"canNotUseMemoryManagementFunctions": "true", "canGetAndSetFMUstate": "true"}
        sources = ET.SubElement(ET.SubElement(root, "CoSimulation", able), "SourceFiles")
        for file in ("fmi2.c", *_SOURCES):
            ET.SubElement(sources, "File", {"name": file})
    else:
        ET.SubElement(root, "CoSimulation", able | {"canGetAndSetFMUState": "true"})
    used = {variable.unit for variable in table}
    definitions = ET.SubElement(root, "UnitDefinitions")
    for unit, exponents in _UNITS.items():
        if unit in used:
            ET.SubElement(ET.SubElement(definitions, "Unit", {"name": unit}), "BaseUnit", exponents)
    categories = ET.SubElement(root, "LogCategories")
    for category in ("logStatusDiscard", "logStatusError"):
        ET.SubElement(categories, "Category", {"name": category})
    ET.SubElement(root, "DefaultExperiment", {"startTime": "0", "stopTime": "10", "stepSize": "0.01"})
    listed = ET.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(table):
        _list(listed, version, reference, variable)
    _structure(root, version, table)
    return _text(root)


def _list(listed: ET.Element, version: int, reference: int, variable: Variable) -> None:
    attributes = {
        "name": variable.name,
        "valueReference": str(reference),
        "description": variable.description,
        "causality": variable.causality,
        "variability": variable.variability,
    }
    if variable.initial is not None:
        attributes["initial"] = variable.initial
    value = {"unit": variable.unit} if variable.unit else {}
    if variable.start is not None:
        value["start"] = repr(variable.start)
    if version == 2:
        ET.SubElement(ET.SubElement(listed, "ScalarVariable", attributes), "Real", value)
    else:
        ET.SubElement(listed, "Float64", {**attributes, **value})


def _structure(root: ET.Element, version: int, table: list[Variable]) -> None:
    structure = ET.SubElement(root, "ModelStructure")
    outputs = [k for k, v in enumerate(table) if v.causality == "output"]
    unknowns = [k for k in outputs if table[k].initial == "calculated"]
    for tag, places in (("Output", outputs), ("InitialUnknown", unknowns)):
        group = ET.SubElement(structure, f"{tag}s") if version == 2 else structure
        for k in places:
            if version == 2:
                ET.SubElement(group, "Unknown", {"index": str(k + 1)})
            else:
                ET.SubElement(group, tag, {"valueReference": str(k)})


def build_description(name: str) -> str:
    """Return sources/buildDescription.xml of FMI 3.0."""
    root = ET.Element("fmiBuildDescription", {"fmiVersion": "3.0"})
    configuration = ET.SubElement(root, "BuildConfiguration", {"modelIdentifier": name})
    sources = ET.SubElement(configuration, "SourceFileSet", {"language": "C99"})
    for file in ("fmi3.c", *_SOURCES):
        ET.SubElement(sources, "SourceFile", {"name": file})
    ET.SubElement(configuration, "Library", {"name": "m"})
    return _text(root)


def _text(root: ET.Element) -> str:
    ET.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(root, encoding="unicode")}\n'
