"""A configuration as text in which each key is explained, with comments in one column."""

import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from friction_hil.checked_yaml.section import Section
from friction_hil.checked_yaml.text import dump

FILL_IN = object()  # value of a key that only the user can know
FILL_IN_MARK = "FILL IN"  # of its comment

_WIDTH = 120
_COMMENT_COLUMN = 34
_UNITS = (  # rotary or linear, rotary, linear
    ("N m or N per s", "N m/s", "N/s"),
    ("N m or N", "N m", "N"),
    ("N m s/rad or N s/m", "N m s/rad", "N s/m"),
    ("rad/s or m/s per s", "rad/s^2", "m/s^2"),
    ("rad/s or m/s", "rad/s", "m/s"),
    ("rad or m", "rad", "m"),
)


class Page:
    """Lines of a configuration, with the units of a linear axis or of a rotary one."""

    def __init__(self, *, is_linear: bool) -> None:
        self.lines: list[str] = []
        self._is_linear = is_linear

    def blank(self) -> None:
        """Write an empty line."""
        self.lines.append("")

    def key(self, level: int, name: str, value: Any, comment: str = "") -> None:
        """Write a key; a group, whose keys follow, has the value None."""
        self._write(f"{'  ' * level}{name}:" + ("" if value is None else f" {_yaml(value)}"), comment)

    def of(self, level: int, section: type[BaseModel], name: str, value: Any, further: str = "") -> None:
        """Write a key of a section with its unit and meaning; None is null."""
        self._explained(level, name, value, self._meaning(section, name) + further)

    def group(self, level: int, section: type[BaseModel], keys: Mapping[str, Any], notes: Mapping[str, str]) -> None:
        """Write keys of a driver, also in groups."""
        for name, value in keys.items():
            if isinstance(value, dict):
                self.key(level, name, None)
                inner = section.model_fields[name].annotation
                assert isinstance(inner, type)
                own = {key.partition(".")[2]: text for key, text in notes.items() if key.startswith(f"{name}.")}
                self.group(level + 1, inner, value, own)
            else:
                self._explained(level, name, value, notes.get(name) or self._meaning(section, name))

    def _explained(self, level: int, name: str, value: Any, meaning: str) -> None:
        indent = "  " * level
        if value is FILL_IN:
            self._write(f"{indent}{name}:", f"{FILL_IN_MARK}: {meaning}")
        else:
            self._write(f"{indent}{name}: {_yaml(value)}", meaning)

    def _meaning(self, section: type[BaseModel], name: str) -> str:
        info = section.model_fields[name]
        meaning, extra = info.description or "", info.json_schema_extra
        unit = str(extra.get("unit", "")) if isinstance(extra, dict) else ""
        if issubclass(section, Section) and unit not in ("", "1"):
            meaning = f"{unit}; {meaning.removesuffix(f' [{unit}]')}"
        for either, rotary, linear in _UNITS:
            meaning = meaning.replace(either, linear if self._is_linear else rotary)
        return meaning

    def _write(self, code: str, comment: str) -> None:
        if not comment:
            self.lines.append(code)
            return
        column = max(_COMMENT_COLUMN, len(code) + 2)
        first, *rest = textwrap.wrap(comment, _WIDTH - column - 2, break_long_words=False, break_on_hyphens=False)
        self.lines.append(f"{code:{column}}# {first}")
        self.lines += [f"{'':{column}}# {line}" for line in rest]


def _yaml(value: Any) -> str:
    """Write a value on one line."""
    if isinstance(value, Path):
        value = str(value)
    if isinstance(value, dict):
        return "{" + ", ".join(f"{name}: {_yaml(each)}" for name, each in value.items()) + "}"
    text = dump([value]).strip()
    return " ".join(text.removeprefix("- ").removeprefix("[").removesuffix("]").split()) if text[0] == "[" else text[2:]
