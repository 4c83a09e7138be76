"""Pieces of XML that the exports to simulators share."""

from collections.abc import Iterable, Mapping
from xml.sax.saxutils import quoteattr

from friction_hil.export.lossy import Loss, number
from friction_hil.export.subject import Subject, provenance
from friction_hil.printable import on_one_line


def head(subject: Subject, loss: Loss, notes: Iterable[str] = ()) -> str:
    """Return the comment of an export: where it comes from, what it loses, notes."""
    lines = [*provenance(subject), *map(on_one_line, (*loss.lines(), *notes))]
    body = "\n".join("  " + _without_double_hyphens(line) for line in lines)
    return f"<!--\n{body}\n-->"


def element(name: str, attributes: Mapping[str, object], *, is_open: bool = False) -> str:
    """Return the tag of an element; attributes that are None are left out."""
    given = ((key, number(value) if isinstance(value, float) else value) for key, value in attributes.items())
    words = [name, *(f"{key}={quoteattr(str(value))}" for key, value in given if value is not None)]
    return f"<{' '.join(words)}{'' if is_open else '/'}>"


def _without_double_hyphens(line: str) -> str:
    """XML has no two hyphens in a row within a comment, and none at its end."""
    while "--" in line:
        line = line.replace("--", "- -")
    return line + " " if line.endswith("-") else line
