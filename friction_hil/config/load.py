"""Files and plain values to a checked configuration, with all mistakes at once."""

import os
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from friction_hil.checked_yaml import text as yaml_text
from friction_hil.checked_yaml.files import Origins, validated
from friction_hil.checked_yaml.text import Document, Steps
from friction_hil.config.axis import NAME_PATTERN, AxisConfig, split_options
from friction_hil.config.drivers import load_driver
from friction_hil.config.schema import Configuration
from friction_hil.errors import ConfigurationError, OptionError, Problem, choices

# Of a model that is still to be made. The inertia is there for those who ask whether one is known, and does nothing.
_WITHOUT_FRICTION = {
    "friction": {"model": "coulomb", "parameters": {"coulomb": 0.0}},
    "mechanics": {"inertia": sys.float_info.min},
}


def load(path: str | Path, *, needs_models: bool = True) -> Configuration:
    """Read a configuration file and the model files that it names.

    Parameters
    ----------
    path : path
    needs_models : bool
        Whether a model file that is not there is a mistake. Otherwise the axis gets a model without any friction, whose
        ``source_path`` is where the file shall stand; ``experiment.axis`` says whether it is a rotary axis.

    Raises
    ------
    ConfigurationError
        It cannot be read or has mistakes; ``problems`` has each with its line.
    """
    configuration = _configuration(yaml_text.read(path), Path(path).parent, needs_models=needs_models)
    configuration._source_path = Path(path).absolute()
    return configuration


def from_dict(data: Mapping[str, Any], source: str) -> Configuration:
    """Make a configuration of plain values, e.g. of those that a recording carries.

    Parameters
    ----------
    data
        As `self_contained` returns them, or as a file would have them.
    source
        Where they come from, for messages.

    Raises
    ------
    ConfigurationError
        They have mistakes.
    """
    return _configuration(Document(source, dict(data)), Path(source).parent)


def self_contained(configuration: Configuration) -> dict[str, Any]:
    """Plain values (JSON's, and infinity) that `from_dict` makes the same configuration of, without any file."""
    return configuration.model_dump(mode="json")


def file_problems(path: str | Path, configuration: Configuration) -> list[Problem]:
    """Mistakes for which ``configuration``, read from ``path``, could be loaded but not run.

    No bus is opened. A driver that has something to say of it, and of the files that its keys name, has a classmethod
    ``check_files``; see `friction_hil.drive.Driver`.
    """
    origins = _Origins(yaml_text.read(path))
    found: list[Problem] = []
    try:
        only_driver(configuration)
    except OptionError as mixed:
        found.append(origins.at_option(mixed))
    for driver in dict.fromkeys(axis.driver for axis in configuration.axes.values()):
        check = getattr(load_driver(driver), "check_files", None)
        axes = {name: axis for name, axis in configuration.axes.items() if axis.driver == driver}
        for name, key, error in () if check is None else check(configuration, axes):
            if isinstance(error, ConfigurationError):
                found += error.problems
            else:
                found.append(origins.locate(("axes", name, *key.split(".")), str(error)))
    return list(dict.fromkeys(found))


def only_driver(configuration: Configuration) -> str:
    """Driver of all axes.

    Raises
    ------
    OptionError
        There are several, which one run does not serve.
    """
    (first, axis), *others = configuration.axes.items()
    for name, other in others:
        if other.driver != axis.driver:
            text = (
                f"is {other.driver}, but that of {first} is {axis.driver}, and one run drives axes of one driver; "
                "make a configuration of each driver's axes"
            )
            raise OptionError(name, "driver", text)
    return axis.driver


def located(path: str | Path, error: OptionError) -> ConfigurationError:
    """Return the error with file and line of its key in the configuration that was read from ``path``."""
    return ConfigurationError([_Origins(yaml_text.read(path)).at_option(error)])


class _Origins(Origins):
    """Origins of the values of a configuration, in whose file the driver's keys stand beside those of the axis."""

    def locate(self, steps: Steps, message: str) -> Problem:
        if steps[:1] == ("axes",) and steps[2:3] == ("options",):
            steps = (*steps[:2], *steps[3:])
        return super().locate(steps, message)

    def at_option(self, error: OptionError) -> Problem:
        return self.locate(("axes", error.axis, *error.key.split(".")), error.text)


def _configuration(document: Document, directory: Path, *, needs_models: bool = True) -> Configuration:
    origins = _Origins(document)
    problems = list(document.problems)
    files: dict[Steps, Path] = {}
    value = document.value
    axes = value.get("axes") if isinstance(value, dict) else None
    if isinstance(axes, dict):
        reader = _ModelReader(directory, origins, problems, files, needs_models)
        value = {**value, "axes": {name: reader.axis(name, axis) for name, axis in axes.items()}}
    configuration = validated(Configuration, value, origins, problems)
    axes = {name: _anchored(axis, directory.absolute()) for name, axis in configuration.axes.items()}
    configuration = configuration.model_copy(update={"axes": axes})
    for steps, path in files.items():
        axis = configuration.axes[str(steps[1])]
        model_file = axis.model if steps[2] == "model" else axis.shadows[int(steps[3])].model
        model_file._source_path = path.absolute()
    return configuration


def _anchored(axis: AxisConfig, directory: Path) -> AxisConfig:
    """Let the relative paths among a driver's keys start from the directory of the configuration."""
    parts = {"options": axis.options, "simulation": axis.simulation}
    return axis.model_copy(
        update={name: _with_paths(part, directory) for name, part in parts.items() if part is not None}
    )


def _with_paths(part: BaseModel, directory: Path) -> BaseModel:
    changed: dict[str, Any] = {}
    for name in type(part).model_fields:
        value = getattr(part, name)
        if isinstance(value, Path):
            changed[name] = directory / value
        elif isinstance(value, BaseModel):
            changed[name] = _with_paths(value, directory)
    return part.model_copy(update=changed) if changed else part


class _ModelReader:
    """Puts the content of model files where a configuration names them."""

    def __init__(
        self,
        directory: Path,
        origins: _Origins,
        problems: list[Problem],
        files: dict[Steps, Path],
        needs_models: bool,
    ) -> None:
        self._directory = directory
        self._origins = origins
        self._problems = problems
        self._files = files
        self._needs_models = needs_models

    def axis(self, name: str, axis: Any) -> Any:
        """Return the plain values of an axis with its models inlined and the driver's keys apart."""
        if not isinstance(axis, dict):
            return axis
        inlined = dict(axis)
        if isinstance(axis.get("model"), str):
            steps: Steps = ("axes", name, "model")
            path = self._directory / axis["model"]
            if self._needs_models or os.path.isfile(path):
                inlined["model"] = self._read(axis["model"], steps)
            else:
                self._files[steps] = path
                inlined["model"] = {"axis": _kind(axis), **_WITHOUT_FRICTION}
        if isinstance(axis.get("shadows"), list):
            inlined["shadows"] = [
                self._shadow(item, ("axes", name, "shadows", index)) for index, item in enumerate(axis["shadows"])
            ]
        return split_options(inlined)

    def _shadow(self, item: Any, steps: Steps) -> Any:
        if isinstance(item, str):
            name = Path(item).stem
            if not re.fullmatch(NAME_PATTERN, name):
                message = f"{name!r} is no name for a shadow; give it one: {{name: ..., model: {item}}}"
                self._problems.append(self._origins.locate(steps, message))
            return {"name": name, "model": self._read(item, (*steps, "model"))}
        if isinstance(item, dict) and isinstance(item.get("model"), str):
            return {**item, "model": self._read(item["model"], (*steps, "model"))}
        return item

    def _read(self, name: str, steps: Steps) -> Any:
        path = self._directory / name
        if not os.path.isfile(path):  # unlike Path.is_file it says no to a name that is too long
            siblings = [str(Path(name).parent / item.name) for item in path.parent.glob("*.y*ml")]
            message = f"there is no model file {path} ('friction-hil tune' makes one); {choices(name, siblings)}"
            self._problems.append(self._origins.locate(steps, message))
            self._origins.broken.append(steps)
            return None
        try:
            document = yaml_text.read(path)
        except ConfigurationError as error:
            self._problems.extend(error.problems)
            self._origins.broken.append(steps)
            return None
        self._problems.extend(document.problems)
        self._origins.add(steps, document)
        self._files[steps] = path
        return document.value


def _kind(axis: dict[str, Any]) -> str:
    """Kind of an axis that has no model file yet; what is no kind is found when ``experiment`` is checked."""
    experiment = axis.get("experiment")
    return "linear" if isinstance(experiment, dict) and experiment.get("axis") == "linear" else "rotary"
