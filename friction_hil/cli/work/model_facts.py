"""Friction models and modifiers as JSON objects."""

from typing import Any

from friction_hil.friction.modifiers import CURVES, HARMONIC, LOAD, SIDES, TEMPERATURE, VISCOUS
from friction_hil.friction.parameters import Parameter
from friction_hil.models import Family
from friction_hil.models.model_file import ModelFile


def describe_model(family: Family, own: ModelFile | None = None) -> dict[str, Any]:
    """Return all facts about a family of models, with the values of ``own`` if given, as in JSON."""
    model = None if own is None else own.friction_model
    parameters = [_parameter(each) for each in family.parameters]
    described: dict[str, Any] = {
        "name": family.name,
        "summary": family.summary,
        "is_static": family.is_static,
        "formula": family.formula.split(";  "),
        "parameters": parameters,
        "states": list(family.states),
        "note": family.note,
        "source": family.source,
        "example": dict(family.example),
    }
    if own is None or model is None:
        return described
    for parameter in parameters:
        parameter["value"] = model.parameters[parameter["name"]]
    return described | {
        "file": own.source_path,
        "axis": own.axis,
        "modifiers": model.modifiers,
        "network": None if model.network is None else model.network.as_dict(),
        "notes": list(model.notes),
    }


def describe_modifier(name: str) -> dict[str, Any]:
    """Return all facts about a modifier, as in JSON."""
    if name == "direction":
        sides = [
            {"name": side, "symbol": "", "unit": "", "bounds": "parameters of the model", "default": None}
            | {"is_required": False, "meaning": f"the model's parameters that differ in {side} motion"}
            for side in SIDES
        ]
        example: Any = {"positive": {"coulomb": 0.09}, "negative": {"coulomb": 0.07}}
        summary = "parameters of their own for each direction of motion"
        return {"name": name, "summary": summary, "parameters": sides, "is_list": False, "example": example}
    modifier = {each.name: each for each in (VISCOUS, LOAD, TEMPERATURE, HARMONIC, *CURVES)}[name]
    examples: dict[str, Any] = {
        "viscous": {"quadratic": 1e-5, "cubic": 0.0},
        "load": {"motoring": 0.1, "driven": 0.05},
        "temperature": {"reference": 40.0, "coefficient": -0.004},
        "ripple": [{"order": 7.0, "cosine": 0.001, "sine": 0.002}],
        "reversal": {"distance": [1e-5, 1e-4, 1e-3], "positive": [0.002, 0.001, 0.0]},
        "speed": {"velocity": [0.1, 1.0], "positive": [0.0, 0.002]},
    }
    return {
        "name": name,
        "summary": f"{modifier.summary}{'; a list of harmonics' if modifier is HARMONIC else ''}",
        "parameters": [_parameter(each) for each in modifier.parameters],
        "is_list": modifier is HARMONIC,
        "example": examples[name],
    }


def _parameter(parameter: Parameter) -> dict[str, Any]:
    return {
        "name": parameter.name,
        "symbol": parameter.symbol,
        "unit": parameter.unit,
        "bounds": parameter.bounds,
        "default": parameter.default,
        "is_required": parameter.default is None,
        "meaning": parameter.meaning,
    }
