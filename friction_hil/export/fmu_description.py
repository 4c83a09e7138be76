"""The variables of a functional mock-up unit, and the files of XML that describe it."""

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from friction_hil import __version__
from friction_hil.export.strict import UNKNOWN

_BASE = {  # exponents of SI base units of each unit, and what is added
    "rad": {"rad": "1"},
    "rad/s": {"rad": "1", "s": "-1"},
    "rad/s2": {"rad": "1", "s": "-2"},
    "m": {"m": "1"},
    "m/s": {"m": "1", "s": "-1"},
    "m/s2": {"m": "1", "s": "-2"},
    "N": {"kg": "1", "m": "1", "s": "-2"},
    "N.m": {"kg": "1", "m": "2", "s": "-2"},
    "degC": {"K": "1", "offset": "273.15"},
    "s": {"s": "1"},
}


@dataclass(frozen=True, slots=True)
class Variable:
    """A variable; ``start`` is that of inputs which are known, of outputs and of constants."""

    name: str
    unit: str
    text: str
    causality: Literal["input", "output", "local"]
    kind: Literal["Real", "Boolean"] = "Real"
    start: float = 0.0
    is_optional: bool = False

    def __post_init__(self) -> None:
        if self.is_optional:
            object.__setattr__(self, "start", UNKNOWN)

    @property
    def variability(self) -> str:
        """How it may change, in the words of the standard."""
        if self.causality == "local":
            return "constant"
        return "continuous" if self.kind == "Real" and self.causality == "input" else "discrete"


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit; ``period_s`` is None for one that advances by any step."""

    name: str
    variables: list[Variable]
    period_s: float | None

    def of(self, kind: str) -> list[Variable]:
        """Return the variables of a type, in the order of their value references."""
        return [each for each in self.variables if each.kind == kind]

    def reference(self, one: Variable) -> int:
        """Return the value reference; time has the first."""
        reals = self.of("Real")
        return 1 + (reals.index(one) if one.kind == "Real" else len(reals) + self.of("Boolean").index(one))

    def says(self) -> str:
        """Return what a step does."""
        unknown = f"Inputs with the start value {UNKNOWN:g} are unknown until they are set."
        if self.period_s is None:
            return f"A step of any length holds the velocity; the friction is that at its end. {unknown}"
        return (
            f"Every {self.period_s:g} s, at the beginning of the step in which it falls, a cycle takes the inputs; its "
            f"compensation is the output at the end of that step. {unknown}"
        )


def description(standard: str, unit: Unit, token: str, sources: Sequence[str], about: Sequence[str]) -> str:
    """Return modelDescription.xml for a version of the standard."""
    is_3 = standard == "3.0"
    root = ET.Element(
        "fmiModelDescription",
        {
            "fmiVersion": standard,
            "modelName": unit.name,
            "instantiationToken" if is_3 else "guid": token,
            "description": " ".join(each.strip() for each in about[:2]),
            "generationTool": f"friction_hil {__version__}",
            "variableNamingConvention": "flat",
        },
    )
    state = "State" if is_3 else "state"
    simulation = ET.SubElement(root, "CoSimulation", {
        "modelIdentifier": unit.name,
        "canHandleVariableCommunicationStepSize": "true",
        f"canGetAndSetFMU{state}": "true",
        f"canSerializeFMU{state}": "true",
        **({} if is_3 else {"canNotUseMemoryManagementFunctions": "true"}),
        **({"fixedInternalStepSize": repr(unit.period_s)} if is_3 and unit.period_s is not None else {}),
    })  # fmt: skip
    if not is_3:
        listed = ET.SubElement(simulation, "SourceFiles")
        for name in sources:
            ET.SubElement(listed, "File", {"name": name})
    definitions = ET.SubElement(root, "UnitDefinitions")
    for name in sorted({"s", *(each.unit for each in unit.variables if each.unit)}):
        ET.SubElement(ET.SubElement(definitions, "Unit", {"name": name}), "BaseUnit", _BASE[name])
    step = 1e-3 if unit.period_s is None else unit.period_s
    ET.SubElement(root, "DefaultExperiment", {"stepSize": repr(step)})
    _variables(ET.SubElement(root, "ModelVariables"), unit, is_3=is_3)
    structure = ET.SubElement(root, "ModelStructure")
    outputs = [each for each in unit.variables if each.causality == "output"]
    if is_3:
        for each in outputs:
            ET.SubElement(structure, "Output", {"valueReference": str(unit.reference(each)), "dependencies": ""})
    else:
        listed = ET.SubElement(structure, "Outputs")
        order = [each for kind in ("Real", "Boolean") for each in unit.of(kind)]
        for each in outputs:
            ET.SubElement(listed, "Unknown", {"index": str(order.index(each) + 2), "dependencies": ""})
    return _text(root)


def build(unit: Unit, sources: Sequence[str]) -> str:
    """Return buildDescription.xml of FMI 3.0."""
    root = ET.Element("fmiBuildDescription", {"fmiVersion": "3.0"})
    configuration = ET.SubElement(root, "BuildConfiguration", {"modelIdentifier": unit.name})
    listed = ET.SubElement(configuration, "SourceFileSet", {"language": "C99"})
    for name in sources:
        ET.SubElement(listed, "SourceFile", {"name": name})
    return _text(root)


def _variables(parent: ET.Element, unit: Unit, *, is_3: bool) -> None:
    _variable(parent, Variable("time", "s", "time", "local"), 0, "independent", is_3=is_3)
    for kind in ("Real", "Boolean"):
        for each in unit.of(kind):
            _variable(parent, each, unit.reference(each), each.causality, is_3=is_3)


def _variable(parent: ET.Element, one: Variable, reference: int, causality: str, *, is_3: bool) -> None:
    is_time = causality == "independent"
    general = {
        "name": one.name,
        "valueReference": str(reference),
        "description": one.text,
        "causality": causality,
        "variability": "continuous" if is_time else one.variability,
    }
    if one.causality == "output":
        general["initial"] = "exact"
    start = {} if is_time else {"start": _start(one)}
    given = {"unit": one.unit} if one.unit else {}
    if is_3:
        ET.SubElement(parent, "Float64" if one.kind == "Real" else "Boolean", {**general, **given, **start})
    else:
        scalar = ET.SubElement(parent, "ScalarVariable", general)
        ET.SubElement(scalar, one.kind, {**given, **start})


def _start(one: Variable) -> str:
    return repr(one.start) if one.kind == "Real" else str(bool(one.start)).lower()


def _text(root: ET.Element) -> str:
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
