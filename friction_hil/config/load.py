"""Loading of a configuration from a file or from plain values, with all mistakes reported at once."""

import difflib
import os
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from friction_hil.checked_yaml import text as yaml_text
from friction_hil.checked_yaml.files import Origins, read_kind, validated
from friction_hil.checked_yaml.text import Document, FieldPath
from friction_hil.config.arm import read_arm
from friction_hil.config.axis import NAME_PATTERN, AxisConfig, split_options
from friction_hil.config.drivers import load_driver
from friction_hil.config.own_loop import NOMINAL_PERIOD_S, OWN_LOOP, REFUSAL, is_own_loop
from friction_hil.config.schema import Configuration
from friction_hil.config.simulation import check_joints
from friction_hil.errors import ConfigurationError, OptionError, Problem, UsageError

# Model of an axis whose model file does not exist yet. The tiny inertia has no effect; it satisfies the options that
# need an inertia above zero.
_WITHOUT_FRICTION = {
    "friction": {"model": "coulomb", "parameters": {"coulomb": 0.0}},
    "mechanics": {"inertia": sys.float_info.min},
}
_MOST_SIBLINGS = 100  # files of a folder that are looked at for one that may be meant
_HEAD_BYTES = 65536  # of a file, in which a model file has its key `friction`
_KEYS_OF_A_MODEL = ("friction", "axis", "mechanics")


def load(path: str | Path, *, needs_models: bool = True, period_s: float | None = None) -> Configuration:
    """Read a configuration file, and the model files and arms that it refers to.

    Unless ``needs_models``, a missing model file is no mistake: the axis gets a model without friction whose
    ``source_path`` is the path of the missing file, and whose kind of axis is ``experiment.axis``. ``period_s``: of the
    loop, s, where the file has none.

    Raises `ConfigurationError`: the file cannot be read or has mistakes; ``problems`` lists them with their lines.
    """
    document = yaml_text.read(path)
    configuration = _configuration(document, Path(path).parent, needs_models=needs_models, period_s=period_s)
    configuration._source_path = Path(path).absolute()
    if configuration.arm is not None:
        read_arm(configuration.arm, configuration.axes, _Origins(document).locate)
    check_joints(configuration, _Origins(document).locate)
    return configuration


def from_dict(data: Mapping[str, Any], source: str, *, reads_files: bool = True) -> Configuration:
    """Create a configuration from plain values, e.g. those in a recording; the files of arms are not read.

    ``data``: as returned by `self_contained`, or as in a file. ``source``: origin of the values, for messages.
    ``reads_files``: False for values inside a recording, which are whole: whoever made it must not choose which files
    are read. Raises `ConfigurationError`: the values have mistakes.
    """
    return _configuration(Document(source, dict(data)), Path(source).parent, reads_files=reads_files)


def self_contained(configuration: Configuration) -> dict[str, Any]:
    """Return plain values (JSON and infinity) from which `from_dict` creates the same configuration without files."""
    return configuration.model_dump(mode="json")


def file_problems(path: str | Path, configuration: Configuration) -> list[Problem]:
    """Return the mistakes because of which ``configuration``, read from ``path``, can be loaded but not run.

    No bus is opened. Drivers check the files named by their keys in the classmethod ``check_files``; see
    `friction_hil.drive.Driver`.
    """
    origins = _Origins(yaml_text.read(path))
    found: list[Problem] = []
    try:
        if not all(axis.driver == OWN_LOOP for axis in configuration.axes.values()):
            only_driver(configuration)
    except OptionError as mixed:
        found.append(origins.at_option(mixed))
    except UsageError:
        lacking = next(name for name, axis in configuration.axes.items() if axis.driver == OWN_LOOP)
        found.append(origins.locate(("axes", lacking, "driver"), "is missing: other axes have one"))
    for driver in dict.fromkeys(axis.driver for axis in configuration.axes.values()):
        kind = load_driver(driver)
        if configuration.bus is not None:
            found += [origins.locate(("bus", key), text) for key, text in kind.check_bus(configuration.bus)]
        axes = {name: axis for name, axis in configuration.axes.items() if axis.driver == driver}
        for name, key, error in kind.check_files(configuration, axes):
            if isinstance(error, ConfigurationError):
                found += error.problems
            else:
                found.append(origins.locate(("axes", name, *key.split(".")), str(error)))
    return list(dict.fromkeys(found))


def missing_models(path: str | Path, configuration: Configuration) -> list[Problem]:
    """Return a note for each model file that ``configuration``, read from ``path``, names and that is not there yet.

    See `load` with ``needs_models=False``.
    """
    document = yaml_text.read(path)
    origins = _Origins(document)
    notes = []
    for name, axis in configuration.axes.items():
        file = axis.model.source_path
        if file is not None and not os.path.lexists(file):
            given = document.value["axes"][name]["model"]
            notes.append(origins.locate(("axes", name, "model"), no_model_file(file, given)))
    return notes


def only_driver(configuration: Configuration) -> str:
    """Return the name of the driver of all axes.

    Raises `OptionError`: the axes have different drivers, which one run does not support; `UsageError`: one has none.
    """
    if configuration.is_own_loop:
        raise UsageError(f"{configuration.source_path or 'the configuration'} {REFUSAL}")
    (first, axis), *others = configuration.axes.items()
    for name, other in others:
        if other.driver != axis.driver:
            text = (
                f"is {other.driver}, but that of {first} is {axis.driver}, and one run drives axes of one driver; "
                "write one configuration per driver"
            )
            raise OptionError(name, "driver", text)
    return axis.driver


def located(path: str | Path, error: OptionError) -> ConfigurationError:
    """Return the error with file and line of its key in the configuration file ``path``."""
    return ConfigurationError([_Origins(yaml_text.read(path)).at_option(error)])


class _Origins(Origins):
    """Origins of the values of a configuration, in which ``options`` is not a key of its own."""

    def locate(self, steps: FieldPath, message: str) -> Problem:
        if steps[:1] == ("axes",) and steps[2:3] == ("options",):
            steps = (*steps[:2], *steps[3:])
        return super().locate(steps, message)

    def at_option(self, error: OptionError) -> Problem:
        return self.locate(("axes", error.axis, *error.key.split(".")), error.text)


def _configuration(
    document: Document,
    directory: Path,
    *,
    needs_models: bool = True,
    reads_files: bool = True,
    period_s: float | None = None,
) -> Configuration:
    origins = _Origins(document)
    problems = list(document.problems)
    files: dict[FieldPath, Path] = {}
    value = document.value
    axes = value.get("axes") if isinstance(value, dict) else None
    if isinstance(axes, dict):
        if value.get("bus") is not None:  # an axis without a driver has none
            lacking = [name for name, axis in axes.items() if isinstance(axis, dict) and "driver" not in axis]
            text = "is missing: it finds the drive on the bus, and has keys of its own"
            problems += [origins.locate(("axes", name, "driver"), text) for name in lacking]
            origins.broken += [("axes", name) for name in lacking]
        reader = _ModelReader(directory, origins, problems, files, needs_models, reads_files)
        value = {**value, "axes": {name: reader.axis(name, axis) for name, axis in axes.items()}}
    lacks_period = is_own_loop(value) and "period_s" not in value
    if lacks_period:
        value = {**value, "period_s": NOMINAL_PERIOD_S if period_s is None else period_s}
    elif period_s is not None and isinstance(value, dict) and value.get("period_s", period_s) != period_s:
        text = f"is {value['period_s']}, but the program gives {period_s:g} as the period of its loop: remove one"
        problems.append(origins.locate(("period_s",), text))
    configuration = validated(Configuration, value, origins, problems)
    configuration._lacks_period = lacks_period and period_s is None
    axes = {name: _anchored(axis, directory.absolute()) for name, axis in configuration.axes.items()}
    shared = {"arm": configuration.arm, "simulation": configuration.simulation}
    anchored = {name: part and _with_paths(part, directory.absolute()) for name, part in shared.items()}
    configuration = configuration.model_copy(update={"axes": axes, **anchored})
    for steps, path in files.items():
        axis = configuration.axes[str(steps[1])]
        model_file = axis.model if steps[2] == "model" else axis.shadows[int(steps[3])].model
        model_file._source_path = path.absolute()
    return configuration


def _anchored(axis: AxisConfig, directory: Path) -> AxisConfig:
    """Make the relative paths among a driver's keys relative to the directory of the configuration."""
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
    """Replacement of the names of model files in a configuration by their content."""

    def __init__(
        self,
        directory: Path,
        origins: _Origins,
        problems: list[Problem],
        files: dict[FieldPath, Path],
        needs_models: bool,
        reads_files: bool,
    ) -> None:
        self._directory = directory
        self._origins = origins
        self._problems = problems
        self._files = files
        self._needs_models, self._reads_files = needs_models, reads_files

    def axis(self, name: str, axis: Any) -> Any:
        """Return the plain values of an axis with its models inlined and the driver's keys under ``options``."""
        if not isinstance(axis, dict):
            return axis
        inlined = dict(axis)
        if isinstance(axis.get("model"), str):
            steps: FieldPath = ("axes", name, "model")
            path = self._directory / axis["model"]
            if self._needs_models or os.path.lexists(path) or "\0" in axis["model"]:
                inlined["model"] = self._read(axis["model"], steps)
            else:
                self._files[steps] = path
                inlined["model"] = {"axis": _kind(axis), **_WITHOUT_FRICTION}
        if isinstance(axis.get("shadows"), list):
            inlined["shadows"] = [
                self._shadow(item, ("axes", name, "shadows", index)) for index, item in enumerate(axis["shadows"])
            ]
        return split_options(inlined)

    def _shadow(self, item: Any, steps: FieldPath) -> Any:
        if isinstance(item, str):
            name = Path(item).stem
            if not re.fullmatch(NAME_PATTERN, name):
                message = f"{name!r} is not a valid name for a shadow; give a name: {{name: ..., model: {item}}}"
                self._problems.append(self._origins.locate(steps, message))
            return {"name": name, "model": self._read(item, (*steps, "model"))}
        if isinstance(item, dict) and isinstance(item.get("model"), str):
            return {**item, "model": self._read(item["model"], (*steps, "model"))}
        return item

    def _read(self, name: str, steps: FieldPath) -> Any:
        if not self._reads_files:
            self._problems.append(
                self._origins.locate(steps, f"must be the model itself: the file {name!r} is not read")
            )
            self._origins.broken.append(steps)
            return None
        path = self._directory / name
        if not os.path.isfile(path):  # unlike Path.is_file it returns False for a name that is too long
            self._problems.append(self._origins.locate(steps, no_model_file(path, name)))
            self._origins.broken.append(steps)
            return None
        try:
            document = read_kind(path, _KEYS_OF_A_MODEL)
        except ConfigurationError as error:
            self._problems.extend(error.problems)
            self._origins.broken.append(steps)
            return None
        self._problems.extend(document.problems)
        self._origins.add(steps, document)
        self._files[steps] = path
        return document.value


def no_model_file(path: Path, name: str) -> str:
    """Say that a model file is not there, how it is made, and which one in its folder may be meant.

    ``name``: the path as the configuration gives it.
    """
    text = f"there is no model file {path}; 'friction-hil tune' identifies the friction of the axis and writes it"
    try:
        models = [str(Path(name).parent / each.name) for each in model_files(path.parent)]
    except (OSError, ValueError):  # the name is not that of any file
        return text
    close = difflib.get_close_matches(name, models, n=1, cutoff=0.6)
    return f"{text}; did you mean {close[0]!r}?" if close else text


def model_files(folder: Path) -> list[Path]:
    """Return the files in a folder that look like model files; of very many files, only the first ones are looked at.

    Raises `OSError` or `ValueError`: the folder cannot be read, or its name is not that of any.
    """
    return [each for each in sorted(folder.glob("*.y*ml"))[:_MOST_SIBLINGS] if _is_model_file(each)]


def _is_model_file(path: Path) -> bool:
    """True for a file that looks like a model file, so that no other one is suggested in the place of one."""
    try:
        if not path.is_file():  # a pipe would be waited for
            return False
        with open(path, "rb") as file:
            return re.search(rb"^friction:", file.read(_HEAD_BYTES), re.MULTILINE) is not None
    except OSError:
        return False


def _kind(axis: dict[str, Any]) -> str:
    """Return the kind of an axis without a model file; a wrong kind is reported by the check of ``experiment``."""
    experiment = axis.get("experiment")
    return "linear" if isinstance(experiment, dict) and experiment.get("axis") == "linear" else "rotary"
