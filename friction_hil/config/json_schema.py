"""JSON Schema of a configuration file, including the keys of the installed drivers."""

from collections.abc import Sequence
from typing import Any

import pydantic
from pydantic import BaseModel

from friction_hil import friction
from friction_hil.config.axis import driver_options
from friction_hil.config.drivers import DRIVERS, SIMULATED_DRIVES, driver_names
from friction_hil.config.own_loop import DEFAULTS, OWN_LOOP
from friction_hil.config.schema import Configuration
from friction_hil.friction.modifiers import CURVES, HARMONIC, LOAD, MAX_HARMONICS, SIDES, TEMPERATURE, VISCOUS
from friction_hil.friction.parameters import Choice, NumberList, Parameter, PointList

_PATH_OR_MODEL = {
    "description": "friction model: a model file (a path relative to this file), or its content",
    "anyOf": [{"type": "string"}, {"$ref": "#/$defs/ModelFile"}],
}


def json_schema() -> dict[str, Any]:
    """Return a JSON Schema 2020-12 of the configuration file, for editors.

    It cannot express checks that involve several keys; `friction_hil.config.load` makes the complete check. Raises
    `UsageError`: an installed driver is broken.
    """
    schema = Configuration.model_json_schema()
    definitions = schema["$defs"]
    common = definitions.pop("AxisConfig")
    del common["properties"]["options"]
    common["required"].remove("options")
    common["properties"]["model"] = _PATH_OR_MODEL
    shadow = definitions["Shadow"]
    shadow["properties"]["model"] = _PATH_OR_MODEL
    common["properties"]["shadows"]["items"] = {"anyOf": [{"type": "string"}, {"$ref": "#/$defs/Shadow"}]}
    definitions["Friction"] = _friction(definitions["Friction"])
    names = [*driver_names(), OWN_LOOP]
    schema["required"].remove("period_s")  # which the program of a loop of its own may give
    for name in names:
        definitions[f"AxisConfig_{name}"] = _axis(name, common, definitions)
    definitions["AxisConfig"] = {
        "type": "object",
        "properties": {"driver": {"description": common["properties"]["driver"]["description"], "enum": names}},
        "allOf": [
            {
                # an absent key agrees with any constant: an axis without a driver is that of a loop of one's own
                "if": {"properties": {"driver": {"const": name}}, "required": ["driver"] * (name != OWN_LOOP)},
                "then": {"$ref": f"#/$defs/AxisConfig_{name}"},
            }
            for name in names
        ],
    }
    # the schema differs between versions of pydantic
    pydantic_version = ".".join(pydantic.VERSION.split(".")[:2])
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$comment": f"written by 'friction-hil config schema' with pydantic {pydantic_version}",
        **schema,
    }


def _friction(general: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a friction model, with the parameters of each model of the registry."""
    names = friction.names()
    properties = general["properties"]
    properties["model"] = {"description": properties["model"]["description"], "enum": names}
    general_modifiers = {**properties["modifiers"], "additionalProperties": False, "properties": _modifiers()}
    properties["modifiers"] = general_modifiers
    choices = []
    for name in names:
        known = friction.describe(name).parameters
        side = {**_parameters(known), "required": []}
        sides = {"type": "object", "properties": dict.fromkeys(SIDES, side), "additionalProperties": False}
        choices.append(
            {
                "if": {"properties": {"model": {"const": name}}, "required": ["model"]},
                "then": {
                    "properties": {
                        "parameters": _parameters(known),
                        "modifiers": {"properties": {"direction": sides}},
                    }
                },
            }
        )
    return {**general, "properties": properties, "allOf": choices}


def _parameters(parameters: Sequence[Parameter]) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": {
            parameter.name: {"description": f"{parameter.meaning} [{parameter.unit}]", **_value(parameter)}
            for parameter in parameters
        },
        "required": [parameter.name for parameter in parameters if parameter.default is None],
        "additionalProperties": False,
    }


def _value(parameter: Parameter) -> dict[str, Any]:
    """Return the schema of a parameter's value."""
    if isinstance(parameter, Choice):
        return {"enum": list(parameter.words)}
    if isinstance(parameter, PointList):
        pair = {"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 2}
        return {"type": "array", "items": pair, "minItems": 1, "maxItems": parameter.most}
    number: dict[str, Any] = {"type": "number"}
    if parameter.lower is not None:
        number["minimum" if parameter.is_lower_allowed else "exclusiveMinimum"] = parameter.lower
    if parameter.upper is not None:
        number["maximum" if parameter.is_upper_allowed else "exclusiveMaximum"] = parameter.upper
    if isinstance(parameter, NumberList):
        return {"type": "array", "items": number, "minItems": parameter.least, "maxItems": parameter.most}
    return number


def _modifiers() -> dict[str, Any]:
    """Return the schema of the modifiers; the keys of ``direction`` depend on the model."""
    fixed = {
        each.name: {"description": each.summary, **_parameters(each.parameters)}
        for each in (LOAD, TEMPERATURE, VISCOUS, *CURVES)
    }
    harmonics = {"type": "array", "items": _parameters(HARMONIC.parameters), "maxItems": MAX_HARMONICS}
    return {
        "direction": {"description": "parameters that differ between the directions of motion"},
        **fixed,
        "ripple": {"description": HARMONIC.summary, **harmonics},
    }


def _axis(driver: str, common: dict[str, Any], definitions: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of an axis with this driver; the definitions it refers to are added to ``definitions``."""
    options = _model_schema(driver_options(driver, DRIVERS), driver, definitions)
    properties = {**common["properties"], **options.get("properties", {})}
    properties["driver"] = {**properties["driver"], "const": driver}
    if driver in driver_names(SIMULATED_DRIVES):
        simulation = _model_schema(driver_options(driver, SIMULATED_DRIVES), f"{driver}_simulation", definitions)
        properties["simulation"] = {"anyOf": [simulation, {"type": "null"}], "default": None}
    else:
        properties["simulation"] = {"type": "null", "description": "this driver has no simulated drive"}
    required = [*common["required"], *options.get("required", [])]
    if driver == OWN_LOOP:
        required = [name for name in required if name not in DEFAULTS]
    elif "driver" not in required:
        required.insert(0, "driver")
    return {**common, "title": f"Axis with driver {driver}", "properties": properties, "required": required}


def _model_schema(model: type[BaseModel], prefix: str, definitions: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a driver's model; its definitions get a prefix, because names of drivers may clash."""
    template = f"#/$defs/{prefix}_{{model}}"
    schema = model.model_json_schema(ref_template=template)
    for name, definition in schema.pop("$defs", {}).items():
        definitions[f"{prefix}_{name}"] = definition
    return schema
