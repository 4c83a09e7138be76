"""The options by which commands choose an axis and columns of recordings."""

import math
from collections.abc import Callable
from typing import Any, TypeVar

import click

Command = TypeVar("Command", bound=Callable[..., Any])


def _columns(context: click.Context, parameter: click.Parameter, pairs: tuple[str, ...]) -> dict[str, str]:
    return dict(_pair(text, "torque=effort") for text in pairs)


def _scale(context: click.Context, parameter: click.Parameter, pairs: tuple[str, ...]) -> dict[str, float]:
    factors = {}
    for text in pairs:
        name, value = _pair(text, "torque=35.15")
        try:
            factors[name] = float(value)
        except ValueError:
            raise click.BadParameter(f"{text!r}: {value!r} is not a number") from None
        if not math.isfinite(factors[name]) or factors[name] == 0.0:
            raise click.BadParameter(f"{text!r}: a factor is finite and not zero")
    return factors


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
