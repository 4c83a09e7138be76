"""JSON on stdout."""

import json
import math
from collections.abc import Mapping
from pathlib import PurePath
from typing import Any

import click

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


def to_json(value: Any) -> Any:
    """Convert ``value`` to types of JSON: NaN and infinity to None, arrays to lists, paths to text."""
    if value is None or isinstance(value, bool | str):
        return str(value) if isinstance(value, str) else value
    if isinstance(value, int):
        return int(value)
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): to_json(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_json(item) for item in value]
    if isinstance(value, PurePath):
        return str(value)
    if hasattr(value, "tolist"):  # numpy
        return to_json(value.tolist())
    raise TypeError(f"{type(value).__name__} cannot be represented in JSON: {value!r}")
