"""Exports of friction models and compensators into other languages.

>>> import friction_hil as fh
>>> files = fh.export.files("coulomb:coulomb=0.1,viscous=0.01", to="c", name="axis_x")
>>> sorted(files)
['axis_x.c', 'axis_x.h']
"""

import importlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from friction_hil.errors import UsageError, choices

if TYPE_CHECKING:
    from friction_hil.compensator import Compensator
    from friction_hil.export.lossy import Converted
    from friction_hil.export.subject import Subject
    from friction_hil.models.model_file import ModelFile

# Each format is a module of this package.
LOSSLESS = {
    "c": "C99 source and header, for firmware",
    "st": "IEC 61131-3 Structured Text, for CODESYS, TwinCAT and others",
    "fmu": "functional mock-up units, FMI 2.0 and 3.0, for simulators",
}
LOSSY = {
    "urdf": "joint of URDF: friction and damping",
    "mjcf": "joint of MuJoCo: frictionloss, damping, armature",
    "mjcf_lugre": "joint of MuJoCo 4 with LuGre friction and cogging",
    "bam": "parameters of BAM, models m1 to m4",
    "isaaclab": "actuator values of Isaac Lab, for PhysX and Newton",
    "ax8000": "friction objects of Beckhoff's AX8000 and AMP8000 drives",
    "csv": "table of torque over velocity and temperature",
}
FORMATS = {**LOSSLESS, **LOSSY}
INSTEAD = {
    "modelica": "export with --to fmu: every Modelica tool imports a functional mock-up unit",
    "mujoco": "MuJoCo reads what --to mjcf writes",
}
_LONGEST_NAME = 40
# Formats whose files would have the name of another format's: by default theirs end in the name of the format.
_SHARED_SUFFIX = ("mjcf", "mjcf_lugre", "bam", "isaaclab", "ax8000")
_C_HEADERS = frozenset(
    (*("assert", "complex", "ctype", "errno", "fenv", "float", "inttypes", "iso646", "limits", "locale", "math"),
     *("setjmp", "signal", "stdarg", "stdbool", "stddef", "stdint", "stdio", "stdlib", "string", "tgmath", "time"),
     *("wchar", "wctype"))
)  # fmt: skip
# Names whose files or packages would hide those of the language
_TAKEN = {
    "c": _C_HEADERS,
    "fmu": _C_HEADERS | {"fmu", "fmi2", "fmi3"},
}

__all__ = ["FORMATS", "INSTEAD", "LOSSLESS", "LOSSY", "convert", "files", "identifier", "joint_files", "save", "write"]


def files(
    model: "ModelFile | str | Path", to: str, *, name: str = "", compensator: "Compensator | None" = None
) -> dict[str, str | bytes]:
    """Return the files of an export, by their names: texts, or bytes of what is no text.

    Parameters
    ----------
    model : ModelFile, str or Path
        Model file, its path, or a model with its parameters as ``--model`` takes it.
    to : str
        One of `FORMATS`.
    name : str, optional
        Name of the export, with which all names in it begin; by default that of the model file.
    compensator : Compensator, optional
        Compensator, made for the friction model of ``model``, that is exported beside the model.

    Raises
    ------
    ConfigurationError
        The model file cannot be read or has mistakes.
    UsageError
        The format or the name is wrong, or the compensator belongs to another model.
    TranslationError
        Something in the model or the compensator has no translation.
    """
    if to in LOSSY:
        if compensator is not None:
            raise UsageError(f"the format {to} holds no compensator")
        return dict(convert(model, to, name=name).files)
    subject = _subject(model, to, name, compensator)
    content: dict[str, str | bytes] = importlib.import_module(f"friction_hil.export.{to}").files(subject)
    return content


def joint_files(configuration: str | Path, *, name: str = "", joints: Sequence[str] | None = None) -> dict[str, str]:
    """Return the compensators of the joints of a loop in C, by the names of their files: one struct for all of them.

    The dynamics of ``arm`` are not in it: the caller gives the load of each joint.

    Parameters
    ----------
    configuration : str or Path
        Configuration as `friction_hil.Compensator.load` reads it, with ``period_s``.
    name : str, optional
        Name of the export, with which all names in it begin; by default that of the configuration.
    joints : sequence of str, optional
        Axes in the order of the arrays; by default all, in the order of the file.

    Raises
    ------
    ConfigurationError
        The configuration cannot be read or has mistakes.
    UsageError
        There is no period, the name is wrong, or a joint has settings that a loop of one's own cannot use.
    TranslationError
        Something in a model or compensator has no translation.
    """
    from friction_hil.config import load  # imported here: they are slow to load
    from friction_hil.export import c_joints
    from friction_hil.export.subject import Subject
    from friction_hil.own_loop.joints import make_joints

    path = Path(configuration)
    read = load(path)
    if read.lacks_period:
        raise UsageError(f"{path} has no period_s: the export needs that of the loop")
    made = make_joints(read.model_copy(update={"arm": None}), joints)
    chosen = _checked(name or identifier(path.stem), "c")
    subjects = [
        Subject(_checked(f"{chosen}_{joint}", "c"), made.configuration.axes[joint].model, path.name, one)
        for joint, one in zip(made.names, made.compensators, strict=True)
    ]
    return c_joints.files(chosen, subjects)


def convert(
    model: "ModelFile | str | Path",
    to: str,
    *,
    name: str = "",
    recording: str | Path | None = None,
    axis: str | None = None,
    speed: float | None = None,
) -> "Converted":
    """Return an export that loses torque: files, fitted parameters and what is lost.

    Parameters
    ----------
    model : ModelFile, str or Path
        See `files`.
    to : str
        One of `LOSSY`.
    name : str, optional
        Name of the joint, and of the file; by default that of the model file, with the format behind it where two
        formats would write the same file.
    recording : path, optional
        Recording whose speeds weigh the fit; by default all speeds of the range count alike.
    axis : str, optional
        Axis of a recording that has several.
    speed : float, optional
        Largest speed, rad/s or m/s, to which the fit is limited.

    Raises
    ------
    ConfigurationError
        The model file cannot be read or has mistakes.
    RecordingError
        The recording cannot be used.
    UsageError
        The format, the name or the speed is wrong.
    """
    if to not in LOSSY:
        raise UsageError(f"there is no format {to!r} that loses torque; {choices(to, LOSSY)}")
    from friction_hil.export.points import points

    subject = _subject(model, to, name, None)
    at = points(subject.model_file, recording, axis=axis, speed=speed)
    converted: Converted = importlib.import_module(f"friction_hil.export.{to}").convert(subject, at)
    if not name and to in _SHARED_SUFFIX:
        named = {f"{subject.name}_{to}{Path(file).suffix}": text for file, text in converted.files.items()}
        return replace(converted, files=named)
    return converted


def _subject(model: "ModelFile | str | Path", to: str, name: str, compensator: "Compensator | None") -> "Subject":
    from friction_hil.export.subject import Subject  # imported here: it is slow to load
    from friction_hil.models.files import model_from_argument

    if to not in FORMATS:
        raise UsageError(f"there is no format {to!r}; {INSTEAD.get(to) or choices(to, FORMATS)}")
    file = model_from_argument(str(model)) if isinstance(model, str | Path) else model
    origin = str(model) if isinstance(model, str | Path) else file.source_path.name if file.source_path else ""
    if compensator is not None and not _is_of(compensator, file):
        raise UsageError("the compensator was made for another model than the one that is exported")
    chosen = name or (identifier(file.source_path.stem) if file.source_path else "") or file.friction.model
    return Subject(_checked(chosen, to), file, origin, compensator)


def write(
    model: "ModelFile | str | Path",
    to: str,
    folder: str | Path = ".",
    *,
    name: str = "",
    compensator: "Compensator | None" = None,
    overwrite: bool = False,
) -> list[Path]:
    """Write the files of an export into a folder and return their paths; the other arguments are those of `files`.

    Raises
    ------
    UsageError
        There is no such folder, or a file exists and ``overwrite`` is False; nothing is written then.
    OSError
        A file cannot be written.
    """
    return save(files(model, to, name=name, compensator=compensator), folder, overwrite=overwrite)


def save(content: Mapping[str, str | bytes], folder: str | Path = ".", *, overwrite: bool = False) -> list[Path]:
    """Write the files of an export, texts or bytes by their names, into a folder; see `write`."""
    if not Path(folder).is_dir():
        raise UsageError(f"there is no folder {folder} to write to; create it first")
    paths = {Path(folder) / file: each for file, each in content.items()}
    for path in () if overwrite else paths:
        if path.exists():
            raise UsageError(f"{path} exists already; --force replaces it")
    for path, each in paths.items():
        path.write_bytes(each if isinstance(each, bytes) else each.encode())
    return list(paths)


def identifier(text: str) -> str:
    """Return a text as a name that any language takes, in small letters; empty if nothing of it can stay.

    >>> identifier("LeftArm 2.yaml")
    'left_arm_2_yaml'
    """
    words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", text)
    name = re.sub(r"[^a-z0-9]+", "_", words.lower()).strip("_")
    return (f"axis_{name}" if name[:1].isdigit() else name)[:_LONGEST_NAME].rstrip("_")


def _checked(name: str, to: str) -> str:
    # IEC 61131-3 has no two underlines in a row, and each name is continued with one
    if not re.fullmatch(r"[a-z][a-z0-9]*(_[a-z0-9]+)*", name) or len(name) > _LONGEST_NAME:
        raise UsageError(
            f"the name {name!r} of the export must be small letters and digits, with single underlines between them, "
            f"begin with a letter and have at most {_LONGEST_NAME} characters, such as {identifier(name) or 'axis_x'}"
        )
    if name in _TAKEN.get(to, ()):
        raise UsageError(
            f"the name {name!r} of the export is that of a file or type which {to} itself has; choose another one, "
            f"such as axis_{name}"
        )
    return name


def _is_of(compensator: "Compensator", file: "ModelFile") -> bool:
    own, given = compensator.model, file.friction_model
    return own.kind == given.kind and own.values.tobytes() == given.values.tobytes()
