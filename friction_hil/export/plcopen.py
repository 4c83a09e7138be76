"""Structured Text in the XML of PLCopen (TC6, 2.0), as CODESYS, TwinCAT and others import it."""

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable

from friction_hil import __version__
from friction_hil.export.st_printer import Declared, Pou

_PLCOPEN, _XHTML = "http://www.plcopen.org/xml/tc6_0200", "http://www.w3.org/1999/xhtml"
_SECTIONS = {
    "VAR_INPUT": ("inputVars", {}),
    "VAR_OUTPUT": ("outputVars", {}),
    "VAR_IN_OUT": ("inOutVars", {}),
    "VAR": ("localVars", {}),
    "VAR CONSTANT": ("localVars", {"constant": "true"}),
}
_KINDS = {"FUNCTION": "function", "FUNCTION_BLOCK": "functionBlock"}
_ELEMENTARY = ("LREAL", "DINT", "BOOL")
_WHEN = "1980-01-01T00:00:00"  # the same export gives the same bytes; the comment says where it comes from


def project(name: str, about: str, types: dict[str, list[Declared]], units: Iterable[Pou]) -> str:
    """Return a project with these structures and units; ``about`` is its comment."""
    root = ET.Element("project", {"xmlns": _PLCOPEN})
    header = {"companyName": "", "productName": "friction_hil", "productVersion": __version__}
    ET.SubElement(root, "fileHeader", {**header, "creationDateTime": _WHEN})
    content = ET.SubElement(root, "contentHeader", {"name": name})
    ET.SubElement(content, "Comment").text = about
    scales = ET.SubElement(content, "coordinateInfo")
    for language in ("fbd", "ld", "sfc"):
        ET.SubElement(ET.SubElement(scales, language), "scaling", {"x": "1", "y": "1"})
    all_types = ET.SubElement(root, "types")
    structures, pous = ET.SubElement(all_types, "dataTypes"), ET.SubElement(all_types, "pous")
    for structure, fields in types.items():
        base = ET.SubElement(ET.SubElement(structures, "dataType", {"name": structure}), "baseType")
        _variables(ET.SubElement(base, "struct"), fields)
    for unit in units:
        _unit(pous, unit)
    ET.SubElement(ET.SubElement(root, "instances"), "configurations")
    ET.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _unit(parent: ET.Element, unit: Pou) -> None:
    pou = ET.SubElement(parent, "pou", {"name": unit.name, "pouType": _KINDS[unit.kind]})
    interface = ET.SubElement(pou, "interface")
    if unit.result:
        _type(ET.SubElement(interface, "returnType"), unit.result)
    for section, variables in unit.sections.items():
        if variables:
            tag, attributes = _SECTIONS[section]
            _variables(ET.SubElement(interface, tag, attributes), variables)
    if unit.comment:
        _text(ET.SubElement(interface, "documentation"), unit.comment)
    _text(ET.SubElement(ET.SubElement(pou, "body"), "ST"), unit.statements())


def _variables(parent: ET.Element, variables: Iterable[Declared]) -> None:
    for each in variables:
        variable = ET.SubElement(parent, "variable", {"name": each.name})
        _type(ET.SubElement(variable, "type"), each.type)
        if each.initial:
            ET.SubElement(ET.SubElement(variable, "initialValue"), "simpleValue", {"value": each.initial})
        if each.comment:
            _text(ET.SubElement(variable, "documentation"), each.comment)


def _type(parent: ET.Element, kind: str) -> None:
    array = re.fullmatch(r"ARRAY\[(\d+)\.\.(\d+)\] OF (\w+)", kind)
    if array:
        whole = ET.SubElement(parent, "array")
        ET.SubElement(whole, "dimension", {"lower": array[1], "upper": array[2]})
        _type(ET.SubElement(whole, "baseType"), array[3])
    elif kind in _ELEMENTARY:
        ET.SubElement(parent, kind)
    else:
        ET.SubElement(parent, "derived", {"name": kind})


def _text(parent: ET.Element, text: str) -> None:
    ET.SubElement(parent, "xhtml", {"xmlns": _XHTML}).text = text
