"""Axes to tune: from configuration files, or from a list whose entries add to common keys."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from friction_hil.checked_yaml import text as yaml_text
from friction_hil.errors import UsageError, choices


def read_axes(files: Sequence[Path], only: Sequence[str] = ()) -> dict[str, dict[str, Any]]:
    """Return the configurations of the axes in some files, as plain values, by name.

    Raises
    ------
    ConfigurationError, UsageError
        A file cannot be read, or no axis has a name of ``only``.
    """
    found: dict[str, dict[str, Any]] = {}
    for path in files:
        value = yaml_text.read(path).value
        if isinstance(value, dict) and "common" in value:
            for name, own in value["axes"].items():
                axis = {"axes": {"x": own}}
                found[name] = _merged(value["common"], axis)
        elif isinstance(value, dict):
            found[path.stem] = value
    for name in only:
        if name not in found:
            raise UsageError(f"no axis is called {name!r}; {choices(name, found)}")
    return {name: found[name] for name in only or found}


def _merged(common: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``common`` with the keys of ``own``; sections are merged."""
    merged = dict(common)
    for key, value in own.items():
        both = isinstance(value, Mapping) and isinstance(merged.get(key), Mapping)
        merged[key] = _merged(merged[key], value) if both else value
    return merged
