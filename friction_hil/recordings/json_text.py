"""JSON of other origin: numbers of any length become floats, and deep nesting is refused."""

import json
from typing import Any

_DIGITS_OF_INT64 = 19


def parse(text: str) -> Any:
    """Parse JSON text.

    Integers of more than 19 digits are floats, infinite if they are too large: the time to convert an integer grows
    with the square of its length. Raises `ValueError`: the text is not JSON (``json.JSONDecodeError``), or its lists
    and objects are nested too deeply.
    """
    try:
        return json.loads(text, parse_int=_integer)
    except RecursionError:
        raise ValueError("its lists and objects are nested too deeply") from None


def brief(value: Any) -> str:
    """Return the beginning of a value as JSON."""
    if isinstance(value, list | dict):
        return f"{'a list' if isinstance(value, list) else 'an object'} of {len(value)}"
    text = json.dumps(value[:40] if isinstance(value, str) else value)
    return text if len(text) <= 40 else text[:37] + "..."


def _integer(text: str) -> float:
    return int(text) if len(text) <= _DIGITS_OF_INT64 else float(text)
