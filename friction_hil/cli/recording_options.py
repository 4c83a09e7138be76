"""Options that select an axis and the columns of recordings."""

import math
from collections.abc import Callable, Collection
from typing import Any, TypeVar

import click

from friction_hil.cli.completion import complete_axis
from friction_hil.errors import UsageError

Command = TypeVar("Command", bound=Callable[..., Any])


def _columns(context: click.Context, parameter: click.Parameter, pairs: tuple[str, ...]) -> dict[str, str]:
    columns: dict[str, str] = {}
    for text in pairs:
        name, source = _pair(text, "torque=effort")
        _refuse_repeated(name, columns)
        columns[name] = source
    from friction_hil.recordings.mapping import split_factors  # imported here: --help must not wait for numpy

    try:
        sources, context.meta[__name__] = split_factors(columns)
    except UsageError as error:
        raise click.BadParameter(str(error)) from None
    return sources


def _scale(context: click.Context, parameter: click.Parameter, pairs: tuple[str, ...]) -> dict[str, float]:
    factors: dict[str, float] = dict(context.meta.get(__name__, {}))
    for text in pairs:
        name, value = _pair(text, "torque=35.15")
        _refuse_repeated(name, factors)
        try:
            factors[name] = float(value)
        except ValueError:
            raise click.BadParameter(f"{text!r}: {value!r} is not a number") from None
        if not math.isfinite(factors[name]) or factors[name] == 0.0:
            raise click.BadParameter(f"{text!r}: a factor must be finite and not zero")
    return factors


def _refuse_repeated(name: str, given: Collection[str]) -> None:
    if name in given:
        raise click.BadParameter(f"{name!r} is given twice")


def _pair(text: str, example: str) -> tuple[str, str]:
    name, sign, value = text.partition("=")
    if not (name and sign and value):
        raise click.BadParameter(f"{text!r} does not have the form {example!r}")
    return name, value


# Eager options are processed first: --scale also takes the factors of --column.
_OPTIONS = (
    click.option(
        "--axis",
        metavar="NAME",
        shell_complete=complete_axis,
        help="Axis to read from a recording that has several.",
    ),
    click.option(
        "--column",
        "columns",
        multiple=True,
        is_eager=True,
        callback=_columns,
        metavar="NAME=SOURCE[*FACTOR]",
        help="Read column NAME from the column SOURCE of the file, e.g. torque=vir*35.15 or "
        "position=encoder*2*pi/4096. SOURCE may be a product of columns; SOURCE:int16 (int8, uint32, ...) reinterprets "
        "a register that was logged as another type: torque=load:int16*volts/885. A column of a matrix is "
        "position=q[:,3], one of a file beside the recording torque=torque.csv:tau, one of a text file without names "
        "position=column2. May be repeated.",
    ),
    click.option(
        "--scale",
        multiple=True,
        callback=_scale,
        metavar="NAME=FACTOR",
        help="Multiply column NAME by FACTOR to convert it to SI units, e.g. torque=35.15. May be repeated.",
    ),
    click.option(
        "--rate",
        "rate_hz",
        type=click.FloatRange(min=0.0, min_open=True),
        metavar="HZ",
        help="Sampling rate of a recording without time stamps, e.g. 1000.",
    ),
    click.option(
        "--where",
        metavar="COLUMN",
        help="Use the torque only of rows where COLUMN is not zero, e.g. torque_enable of a servo.",
    ),
)


def recording_options(command: Command) -> Command:
    """Add ``--axis``, ``--column`` (``columns``, a dict), ``--scale`` (dict), ``--rate`` (``rate_hz``), ``--where``."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command
