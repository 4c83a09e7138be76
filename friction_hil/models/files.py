"""Reading of model files, and of models given on the command line.

>>> from friction_hil.models.files import model_from_argument
>>> model_from_argument("coulomb:coulomb=0.08,viscous=2e-3").friction.parameters
{'coulomb': 0.08, 'static': 0.08, 'viscous': 0.002}
"""

import os
import re
from pathlib import Path
from typing import Any

from friction_hil import friction
from friction_hil.checked_yaml import text as yaml_text
from friction_hil.checked_yaml.files import read_section
from friction_hil.errors import ConfigurationError, Problem, UsageError, choices
from friction_hil.friction import FrictionModel
from friction_hil.models.model_file import ModelFile


def load(path: str | Path) -> FrictionModel:
    """Read the friction model of a model file (YAML).

    Raises
    ------
    ConfigurationError
        The file cannot be read or has mistakes; the message lists them with their lines.
    """
    return load_model_file(path).friction_model


def load_model_file(path: str | Path) -> ModelFile:
    """Read a model file.

    Raises `ConfigurationError`: the file cannot be read or has mistakes; ``problems`` lists them with their lines.
    """
    try:
        model_file = read_section(path, ModelFile)
    except ConfigurationError as error:
        if not {"axes", "friction"} <= {each.field for each in error.problems}:
            raise
        text = "this is a configuration; give a model file, e.g. the one that an axis of it has as 'model'"
        raise ConfigurationError([Problem(str(path), None, "", text)]) from error
    model_file._source_path = Path(path).absolute()
    return model_file


def model_from_argument(argument: str) -> ModelFile:
    """Parse the argument of ``--model``: a model file, or ``NAME:coulomb=0.08,viscous=2e-3`` (a rotary axis).

    It may also be an actuator of `friction_hil.models.library`.

    Raises `ConfigurationError`: the model file cannot be read or has mistakes; `UsageError`: the model or a parameter
    does not exist, or a value is invalid.
    """
    if argument.endswith((".yaml", ".yml")) or os.path.isfile(argument):
        return load_model_file(argument)
    from friction_hil.models import library  # imported here: it needs this module

    if argument in library.names():
        return library.load(argument)
    name, _, rest = argument.partition(":")
    if name not in friction.names():
        raise UsageError(
            f"--model {argument}: neither a file nor a friction model of this name exists; "
            f"{choices(name, (*friction.names(), *library.names()))}"
        )
    parameters: dict[str, Any] = {}
    for part in re.split(r",(?=\s*\w+\s*=)", rest) if rest else ():
        key, equals, text = part.partition("=")
        if not equals or key.strip() in parameters:
            wanted = f"write {name}:parameter=value,parameter=value" if not equals else "give each parameter once"
            raise UsageError(f"--model {argument}: {part.strip()!r} is not valid; {wanted}")
        value = yaml_text.parse(text, f"--model {argument}")
        if value.problems:
            raise ConfigurationError(value.problems)
        parameters[key.strip()] = value.value
    try:
        model = friction.create(name, **parameters)
    except UsageError as error:
        raise UsageError(f"--model {argument}: {error}") from None
    content = {"model": name, "parameters": dict(model.given)}
    return ModelFile.model_validate({"axis": "rotary", "friction": content})
