"""Exports to Structured Text do, in a strict interpreter, what this library does: every model, and the compensator."""

import math
import random
import re
from functools import cache
from xml.etree import ElementTree

import blark.parse
import numpy as np
import pytest

from friction_hil.compensator import INPUTS
from friction_hil.export import st
from tests.c_exports import subject
from tests.export_subjects import COMPENSATORS, EVERY_MODEL, compensations, cycles, model_torques, steps
from tests.structured_text import FaultError, Program, RefusedError

UNKNOWN = 1e30
MODEL_INPUTS = ("velocity", "elapsed", "position", "load_torque", "temperature", "applied_torque")


def text(model):
    return st.files(subject(model, "axis"))["axis.st"]


@cache
def compensator_files(name):
    each = COMPENSATORS[name]
    return st.files(subject(each.model, "axis", each))


@cache
def compensator_program(name):
    return Program(compensator_files(name)["axis.st"])


def given(names, row):
    """Inputs of a function block, with the number for what is unknown."""
    return {name: UNKNOWN if math.isnan(value) else value for name, value in zip(names, row, strict=True)}


def test_every_model_gives_the_torque_of_this_library():
    for name, model in EVERY_MODEL.items():
        block = Program(text(model)).start("axis_model")
        rows = steps()[:40] if model.network is not None else steps()[:700]
        got = [block(**given(MODEL_INPUTS, row))["friction"] for row in rows]
        wanted = model_torques(name)[: len(rows)]
        np.testing.assert_allclose(got, wanted, rtol=1e-12, atol=1e-12 * model.level, err_msg=name)


def test_the_whole_compensator_gives_the_torque_of_this_library():
    for name, each in COMPENSATORS.items():
        block = compensator_program(name).start("axis_compensator")
        rows = cycles() if name == "kalman" else cycles()[:800]
        last, got = -1.0, []
        for row in rows:
            inputs = given(INPUTS, row)
            flags = {flag: bool(inputs.pop(flag)) for flag in ("is_fresh", "is_enabled")}
            cycle = inputs.pop("cycle")
            got.append(block(cycles=int(cycle - last), **inputs, **flags)["compensation"])
            last = cycle
        error = np.abs(np.array(got) - compensations(name)[: len(rows)]) / each.model.level
        assert error.max() < 1e-12, name


def test_no_input_stops_the_controller():
    """Numbers of any size, also those that are none, in any order; the interpreter stops where a controller does."""
    chosen = random.Random(0)
    values = (0.0, 1e-300, -1e-12, 1.0, -1e3, 1e6, 9e15, -9e15, UNKNOWN, math.nan, math.inf, -math.inf)
    optional = [name for name in INPUTS if name not in ("cycle", "is_fresh", "is_enabled")]
    for name in ("kalman", "geared"):
        each = COMPENSATORS[name]
        block = compensator_program(name).start("axis_compensator")
        for _ in range(400):
            inputs = {one: chosen.choice(values) for one in optional}
            flags = {"is_fresh": chosen.random() > 0.1, "is_enabled": True}
            out = block(cycles=chosen.choice((1, 1, 2, 30, 0, -3, 2 * 10**9)), **inputs, **flags)
            assert abs(out["compensation"]) <= each.settings.torque_limit


def test_no_input_stops_a_model():
    """Likewise; the friction is finite where the inputs are, and no fault is told then."""
    chosen = random.Random(0)
    values = (0.0, 1e-300, -1e-12, 1.0, -1e3, 1e9, -1e13, 1e15, 1e38, -1e200, 1e308)
    for name in ("armstrong", "gms_modified", "lugre_modified", "table_modified", "net_narx", "bouc_wen_2", "residual"):
        block = Program(text(EVERY_MODEL[name])).start("axis_model")
        for _ in range(100):
            inputs = {each: chosen.choice(values) for each in MODEL_INPUTS}
            inputs["elapsed"] = abs(inputs["elapsed"]) or 1e-3
            assert math.isfinite(block(**inputs)["friction"]), (name, inputs)


def test_reset_begins_anew():
    block = compensator_program("tracking").start("axis_compensator")
    rows = [given(INPUTS, row) for row in cycles()[:300]]

    def run(reset):
        out = []
        for k, row in enumerate(rows):
            inputs = {name: value for name, value in row.items() if name not in ("cycle", "is_fresh")}
            inputs["is_enabled"] = bool(inputs["is_enabled"])
            out.append(block(reset=reset and k == 0, **inputs)["compensation"])
        return out

    first = run(False)
    assert run(True) == first
    assert run(False) != first


PLCOPEN, XHTML = "{http://www.plcopen.org/xml/tc6_0200}", "{http://www.w3.org/1999/xhtml}xhtml"
SECTIONS = {"inputVars": "VAR_INPUT", "outputVars": "VAR_OUTPUT", "inOutVars": "VAR_IN_OUT", "localVars": "VAR"}


def declared(parent):
    """Variables of an element of the project, as text."""
    lines = []
    for variable in parent.findall(f"{PLCOPEN}variable"):
        values = [each.get("value") for each in variable.iter(f"{PLCOPEN}simpleValue")]
        initial = f" := {values[0]}" if values else ""
        lines.append(f"{variable.get('name')} : {kind(variable.find(f'{PLCOPEN}type'))}{initial};")
    return "\n".join(lines)


def kind(parent):
    (own,) = parent
    if own.tag == f"{PLCOPEN}derived":
        return own.get("name")
    if own.tag != f"{PLCOPEN}array":
        return own.tag.removeprefix(PLCOPEN)
    (dimension,) = own.findall(f"{PLCOPEN}dimension")
    return f"ARRAY[{dimension.get('lower')}..{dimension.get('upper')}] OF {kind(own.find(f'{PLCOPEN}baseType'))}"


def text_of_project(xml):
    """A project as Structured Text again."""
    root, parts = ElementTree.fromstring(xml), []
    for one in root.iter(f"{PLCOPEN}dataType"):
        fields = declared(one.find(f"{PLCOPEN}baseType/{PLCOPEN}struct"))
        parts.append(f"TYPE {one.get('name')} :\nSTRUCT\n{fields}\nEND_STRUCT;\nEND_TYPE")
    for one in root.iter(f"{PLCOPEN}pou"):
        word = {"function": "FUNCTION", "functionBlock": "FUNCTION_BLOCK"}[one.get("pouType")]
        interface = one.find(f"{PLCOPEN}interface")
        result = interface.find(f"{PLCOPEN}returnType")
        parts.append(f"{word} {one.get('name')}" + ("" if result is None else f" : {kind(result)}"))
        for section in interface:
            name = SECTIONS.get(section.tag.removeprefix(PLCOPEN))
            if name:
                constant = " CONSTANT" if section.get("constant") == "true" else ""
                parts.append(f"{name}{constant}\n{declared(section)}\nEND_VAR")
        parts += [one.find(f"{PLCOPEN}body/{PLCOPEN}ST/{XHTML}").text, f"END_{word}"]
    return "\n".join(parts)


@pytest.mark.parametrize("name", ["kalman", "geared"])
def test_the_project_to_import_holds_the_same_program_as_the_text(name):
    both = compensator_files(name)

    def tokens(content):
        return re.sub(r"\(\*.*?\*\)|\s+", "", content, flags=re.DOTALL)

    assert tokens(text_of_project(both["axis.xml"])) == tokens(both["axis.st"])
    assert "Made by friction_hil" in ElementTree.fromstring(both["axis.xml"]).find(f".//{PLCOPEN}Comment").text


def test_a_parser_of_another_project_takes_the_text():
    """The same parser, which needs 13 s for it, was run over whole compensators by hand."""
    parsed = blark.parse.parse_source_code(text(EVERY_MODEL["dahl"]))
    assert parsed.exception is None
    names = {type(item).__name__ for item in parsed.transform().items}
    assert {"Function", "FunctionBlock", "DataTypeDeclaration"} <= names


BLOCK = "FUNCTION_BLOCK one\nVAR_INPUT\n x : LREAL;\nEND_VAR\nVAR_OUTPUT\n y : LREAL;\n k : DINT;\nEND_VAR\n{}\n"
ARRAY = "TYPE data :\nSTRUCT\n v : ARRAY[0..1] OF LREAL;\nEND_STRUCT;\nEND_TYPE\n"


def one(body, before=""):
    return Program(f"{before}{BLOCK.format(body)}END_FUNCTION_BLOCK\n").start("one")


@pytest.mark.parametrize(
    "body",
    ["y := k;", "y := 1;", "x := 1.0;", "z := 1.0;", "IF x THEN y := x; END_IF;", "y := x + k;", "y := EXP(k);",
     "y := x ? 1.0 : 2.0;", "y := 1E3;", "y := MAX(x, k);", "k := x;", "y := f(x := x);", "y := 1.0E39;",
     "IF NOT (x > 0.0) THEN y := x; END_IF;", "FOR k := 0 TO 3 DO y := x; END_FOR;"],
)  # fmt: skip
def test_the_interpreter_refuses_what_a_compiler_may_refuse(body):
    with pytest.raises(RefusedError):
        one(body)


@pytest.mark.parametrize(
    "body",
    ["y := 1.0 / x;", "y := 1.0E30 * (x + 1.0E30) * 1.0E30 * 1.0E30 * 1.0E30 * 1.0E30 * 1.0E30 * 1.0E30 * 1.0E30 * "
     "1.0E30 * 1.0E30;", "y := SQRT(x - 1.0);", "y := EXP(x + 1000.0);", "y := LN(x);",
     "k := 2147483647; k := k + 1;", "IF (x <> 0.0) AND (1.0 / x > 2.0) THEN y := x; END_IF;", "k := 1 / k;"],
)  # fmt: skip
def test_the_interpreter_stops_where_a_controller_may_stop(body):
    with pytest.raises((FaultError, ZeroDivisionError, OverflowError, ValueError)):
        one(body)(x=0.0)
