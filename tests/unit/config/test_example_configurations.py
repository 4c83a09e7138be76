"""The example configurations can be loaded, their comments are correct, and they agree with the schema."""

import json
import re
from pathlib import Path

import jsonschema
import pydantic
import pytest

from friction_hil.checked_yaml.section import keys
from friction_hil.checked_yaml.text import parse, read
from friction_hil.config import (
    AxisConfig,
    AxisExperiment,
    AxisLimits,
    Compensation,
    Configuration,
    Realtime,
    from_dict,
    json_schema,
    load,
    self_contained,
)
from friction_hil.models.files import load_model_file

DIRECTORY = Path(__file__).parents[3] / "config"
EXAMPLES = sorted(DIRECTORY.glob("*.yaml"))
MODELS = sorted((DIRECTORY / "models").glob("*.yaml"))
SCHEMA = json.loads((DIRECTORY / "schema.json").read_text())


def name_of(path):
    return path.name


def schema_errors(value, schema=SCHEMA):
    return [error.message for error in jsonschema.Draft202012Validator(schema).iter_errors(value)]


def test_there_are_examples():
    assert {path.stem for path in EXAMPLES} >= {"demo", "single_axis_csp", "cst_controller"}
    assert MODELS


@pytest.mark.parametrize("path", EXAMPLES, ids=name_of)
def test_it_fits_the_schema(path):
    assert schema_errors(read(path).value) == []
    assert schema_errors(self_contained(load(path))) == []


@pytest.mark.parametrize("path", MODELS, ids=name_of)
def test_a_model_file_loads(path):
    assert load_model_file(path).friction_model.parameters
    assert schema_errors(read(path).value, {**SCHEMA, **SCHEMA["$defs"]["ModelFile"]}) == []


def test_the_schema_is_current():
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    current = json_schema()
    if current["$comment"] != SCHEMA["$comment"]:
        pytest.skip(f"pydantic is {pydantic.VERSION} here, but schema.json was {SCHEMA['$comment']}")
    assert current == SCHEMA, "config/schema.json is stale: friction-hil config schema > config/schema.json"


@pytest.mark.parametrize(
    ("old", "new"),
    [
        *(("node: 1", "nod: 1"), ("node: 1", "node: 128"), ("mode: csp", "mode: cspp"), ("kind: sine", "kind: sinus")),
        *(("driver: canopen", "driver: canopn"), ("  amplitude: 0.5", "  amplitude: 0")),
        *(("models/lugre_axis.yaml", "3"), ("{coulomb: 0.05, viscous: 1e-3}", "{colomb: 0.05, viscous: 1e-3}")),
        *(("priority: 80", "priority: 100"), ("period_s: 1e-3", "period_s: 1 ms"), ("torque_slew", "torque_slow")),
    ],
)
def test_the_schema_finds_mistakes(old, new):
    text = (DIRECTORY / "single_axis_csp.yaml").read_text()
    assert schema_errors(parse(text.replace(old, new, 1), "mutated").value)


@pytest.mark.parametrize("name", ["single_axis_csp", "serial_modbus"])
def test_what_is_marked_as_default_is_the_default(name):
    path = DIRECTORY / f"{name}.yaml"
    lines = path.read_text().splitlines(keepends=True)
    kept = [line for line in lines if not re.search(r"#\s*default\b", line)]
    assert len(kept) < len(lines) - 8
    shorter = from_dict(parse("".join(kept), "shorter").value, str(path))
    assert self_contained(shorter) == self_contained(load(path))


def test_the_first_example_lists_every_key():
    path = DIRECTORY / "single_axis_csp.yaml"
    value, axis = read(path).value, load(path).axes["x"]
    for group, model in [
        (value, Configuration),
        (value["realtime"], Realtime),
        (value["axes"]["x"]["limits"], AxisLimits),
        (value["axes"]["x"]["compensation"], Compensation),
        (value["axes"]["x"]["trajectory"], type(axis.trajectory)),
        (value["axes"]["x"]["experiment"], AxisExperiment),
    ]:
        assert set(group) == set(keys(model))
    elsewhere = {"controller", "sidecar", "simulation"}
    assert set(value["axes"]["x"]) == {*keys(AxisConfig), *type(axis.options).model_fields} - elsewhere


def test_the_serial_example_lists_every_key_of_its_drivers():
    path = DIRECTORY / "serial_modbus.yaml"
    given, axis = read(path).value["axes"]["x"], load(path).axes["x"]
    assert set(given) >= set(type(axis.options).model_fields)
    assert set(given["line"]) == set(type(axis.options.line).model_fields)
    assert set(given["simulation"]["line"]) == set(type(axis.simulation.line).model_fields)
