"""The options by which commands choose files, an axis and columns of recordings."""

import glob
import math
from collections.abc import Callable, Collection, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from friction_hil.errors import UsageError

if TYPE_CHECKING:
    from friction_hil.recordings import Recording

Command = TypeVar("Command", bound=Callable[..., Any])


def _columns(context: click.Context, parameter: click.Parameter, pairs: tuple[str, ...]) -> dict[str, str]:
    from friction_hil.recordings.mapping import parse_source

    columns: dict[str, str] = {}
    factors: dict[str, float] = context.meta.setdefault(__name__, {})
    for text in pairs:
        name, source = _pair(text, "torque=effort")
        _once(name, columns)
        try:
            columns[name], factor = parse_source(source)
        except UsageError as error:
            raise click.BadParameter(str(error)) from None
        if factor != 1.0:
            factors[name] = factor
    return columns


def _scale(context: click.Context, parameter: click.Parameter, pairs: tuple[str, ...]) -> dict[str, float]:
    factors: dict[str, float] = dict(context.meta.get(__name__, {}))
    for text in pairs:
        name, value = _pair(text, "torque=35.15")
        _once(name, factors)
        try:
            factors[name] = float(value)
        except ValueError:
            raise click.BadParameter(f"{text!r}: {value!r} is not a number") from None
        if not math.isfinite(factors[name]) or factors[name] == 0.0:
            raise click.BadParameter(f"{text!r}: a factor is finite and not zero")
    return factors


def _once(name: str, given: Collection[str]) -> None:
    if name in given:
        raise click.BadParameter(f"{name!r} is given twice")


def _pair(text: str, example: str) -> tuple[str, str]:
    name, sign, value = text.partition("=")
    if not (name and sign and value):
        raise click.BadParameter(f"{text!r} has not the form {example!r}")
    return name, value


# Eager ones are processed first: the factors of --column belong to --scale.
_OPTIONS = (
    click.option("--axis", metavar="NAME", help="Axis to take, where a recording has several."),
    click.option(
        "--column",
        "columns",
        multiple=True,
        is_eager=True,
        callback=_columns,
        metavar="NAME=SOURCE[*FACTOR]",
        help="Take column NAME from the file's SOURCE, e.g. torque=vir*35.15 or position=encoder*2*pi/4096. "
        "SOURCE may be a product of columns, SOURCE:int16 (int8, uint32, ...) a register that was read as another "
        "type: torque=load:int16*volts/885. May be repeated.",
    ),
    click.option(
        "--scale",
        multiple=True,
        callback=_scale,
        metavar="NAME=FACTOR",
        help="Multiply column NAME by FACTOR to make it SI, e.g. torque=35.15. May be repeated.",
    ),
    click.option(
        "--where",
        metavar="COLUMN",
        help="Let the torque count only in rows where COLUMN is not zero, e.g. torque_enable of a servo.",
    ),
)


def recording_options(command: Command) -> Command:
    """Add ``--axis`` (``axis``), ``--column`` (``columns``, a dict), ``--scale`` (``scale``, a dict), ``--where``."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def expanded(words: Iterable[str | Path]) -> list[str]:
    """Replace each pattern (``*``, ``?``, ``[..]``, ``**``) by the files that it matches, in order of name.

    The shell does that where a pattern is not quoted; a file that is called like a pattern is taken as it is.

    Raises
    ------
    UsageError
        A pattern matches nothing.
    """
    found: list[str] = []
    for word in map(str, words):
        if not glob.has_magic(word) or Path(word).exists():
            found.append(word)
            continue
        matches = sorted(path for path in glob.glob(word, recursive=True) if Path(path).is_file())
        if not matches:
            raise UsageError(f"{word}: no file matches")
        found += matches
    return list(dict.fromkeys(found))


def read_recordings(sources: Iterable[Path], axis: str | None, **options: Any) -> "list[Recording]":
    """Read the recordings of one axis from files and patterns of files; options are those of `recordings.read`.

    Raises
    ------
    UsageError
        A pattern matches nothing, or a file has several axes and none is chosen.
    RecordingError
        A file cannot be read.
    """
    from friction_hil import recordings

    found = []
    for source in expanded(sources):
        if axis is not None:
            found.append(recordings.read(source, axis, **options))
            continue
        several = recordings.read_all(source, **options)
        if len(several) > 1:
            raise UsageError(f"{source}: has the axes {', '.join(several)}; choose one with --axis")
        found += several.values()
    return found
