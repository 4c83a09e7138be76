"""JSON with the comment of an export, for formats whose readers ignore keys that they do not know."""

import json
from collections.abc import Iterable, Mapping
from typing import Any

from friction_hil.export.lossy import Loss
from friction_hil.export.subject import Subject, provenance
from friction_hil.printable import on_one_line


def document(subject: Subject, loss: Loss, notes: Iterable[str], content: Mapping[str, Any]) -> str:
    """Return the text of a JSON file: the content, and under ``comment`` where it comes from and what it loses."""
    comment = [*provenance(subject), *map(on_one_line, (*loss.lines(), *notes))]
    return json.dumps({**content, "comment": comment}, indent=2) + "\n"


def rounded(value: float) -> float:
    """Return a number with the ten digits that exports write."""
    return float(f"{value:.10g}")
