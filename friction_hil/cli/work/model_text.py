"""Text and tables of ``friction-hil models``: wrapped to the terminal, and ready to be copied."""

import os
import re
import textwrap
from typing import Any

import click

from friction_hil.checked_yaml.text import dump
from friction_hil.cli.work.tables import Table, console, lines
from friction_hil.models import FrictionModel
from friction_hil.printable import own_style

_PIPED_WIDTH = 100  # columns, if there is no terminal
_GLUE = "\ue000"  # a blank at which no line is broken


class Page:
    """Output as wide as the terminal."""

    def __init__(self) -> None:
        self._console = console()
        if not self._console.is_terminal and "COLUMNS" not in os.environ:
            self._console.width = _PIPED_WIDTH
        self.width = self._console.width

    def write(self, text: str, indent: int = 0) -> None:
        """Print a paragraph."""
        first = " " * indent
        following = first + "  "
        click.echo(
            textwrap.fill(text, self.width, initial_indent=first, subsequent_indent=following, break_on_hyphens=False)
        )

    def write_table(self, table: Table) -> None:
        """Print a table without the blanks at the ends of its lines."""
        for line in lines(table, self._console):
            click.echo(own_style(line.replace(_GLUE, " ")))

    def write_yaml(self, content: dict[str, Any], indent: int = 0) -> None:
        """Print YAML that can be copied: lines are broken only between the elements of a collection."""
        lines: list[str] = []
        for line in re.sub(r",\n +", ", ", dump(content)).splitlines():
            following = " " * (len(line) - len(line.lstrip()) + 2)
            lines += textwrap.wrap(
                line.replace(": ", f":{_GLUE}"),
                self.width - indent,
                subsequent_indent=following,
                break_long_words=False,
                break_on_hyphens=False,
                tabsize=1,
            )
        click.echo(textwrap.indent("\n".join(lines).replace(_GLUE, " "), " " * indent))


def value_text(value: Any) -> str:
    """Write a parameter's value or default; for a list of pairs only their number."""
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.6g}".replace("inf", ".inf")
    if isinstance(value, list):
        if not isinstance(value[0], list):
            return ", ".join(map(value_text, value))
        return f"{len(value)} pair{'' if len(value) == 1 else 's'}"
    return str(value)


def default_text(default: object) -> str:
    """Write a default as `` (=0.5)``, on one line with the name before it; nothing if there is none."""
    return "" if default is None else f"{_GLUE}(={value_text(default)})"


def unit_text(unit: str) -> str:
    """Write a unit as `` [N m]``, in one piece; nothing for a number without unit."""
    return f" [{unit.replace(' ', _GLUE)}]" if unit not in ("", "1") else ""


def in_units_of(model: FrictionModel | None, text: str) -> str:
    """Replace the units of a rotary axis in ``text`` by those of the model's axis."""
    if model is None or model.axis == "rotary":
        return text
    return text.replace("N m", "N").replace("rad", "m")
