"""JSON on stdout."""

import json
from typing import Any

import click

from friction_hil.numerics.json_values import to_json

_printed: list[bool] = [False]  # a document has been printed by this command


def print_json_error(text: str) -> None:
    """Print an error as a JSON document, unless the command has printed its own; it is on stderr too."""
    if not _printed[0]:
        print_json({"error": text})


def forget_printed() -> None:
    """Begin another command."""
    _printed[0] = False


def print_json(value: Any) -> None:
    """Print one JSON document on stdout. NaN and infinity become null; numpy scalars and arrays are converted.

    Raises `TypeError`: ``value`` contains an object that JSON cannot represent.
    """
    _printed[0] = True
    click.echo(json.dumps(to_json(value), indent=2, ensure_ascii=False, allow_nan=False))
