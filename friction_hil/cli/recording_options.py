"""The options by which commands choose an axis and columns of recordings."""

import math
from collections.abc import Callable, Collection
from typing import Any, TypeVar

import click

Command = TypeVar("Command", bound=Callable[..., Any])


def _columns(context: click.Context, parameter: click.Parameter, pairs: tuple[str, ...]) -> dict[str, str]:
    columns: dict[str, str] = {}
    for text in pairs:
        name, source = _pair(text, "torque=effort")
        _once(name, columns)
        columns[name] = source
    return columns


def _scale(context: click.Context, parameter: click.Parameter, pairs: tuple[str, ...]) -> dict[str, float]:
    factors: dict[str, float] = {}
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


_OPTIONS = (
    click.option("--axis", metavar="NAME", help="Axis to take, where a recording has several."),
    click.option(
        "--column",
        "columns",
        multiple=True,
        callback=_columns,
        metavar="NAME=SOURCE",
        help="Take column NAME from the file's SOURCE, e.g. torque=effort. May be repeated.",
    ),
    click.option(
        "--scale",
        multiple=True,
        callback=_scale,
        metavar="NAME=FACTOR",
        help="Multiply column NAME by FACTOR to make it SI, e.g. torque=35.15. May be repeated.",
    ),
)


def recording_options(command: Command) -> Command:
    """Add ``--axis`` (``axis``), ``--column`` (``columns``, a dict) and ``--scale`` (``scale``, a dict)."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command
