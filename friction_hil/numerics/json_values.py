"""Values as JSON can hold them. Pure."""

import math
from collections.abc import Mapping
from pathlib import PurePath
from typing import Any


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
