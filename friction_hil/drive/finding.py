"""Findings: result of one check, with its detail and its remedy."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from friction_hil.errors import FrictionHilError

NOT_TOLD = "not told by this system"


@dataclass(frozen=True, slots=True)
class Finding:
    """Result of one check.

    Attributes
    ----------
    check : str
        Subject of the check, in a few words.
    result : str
        ``fail``: the daemon will not run, or not safely; ``warn``: it runs, but worse, or this is unknown; ``pass``.
    detail : str
        Observation.
    fix : str
        Remedy; empty where none is needed.
    """

    check: str
    result: Literal["pass", "warn", "fail"]
    detail: str
    fix: str = ""

    def __str__(self) -> str:
        return f"{self.detail}; {self.fix}" if self.fix else self.detail


def failure(check: str, error: FrictionHilError) -> Finding:
    """Return the finding for an error that would end a run."""
    return Finding(check, "fail", error.detail, error.fix)


def complaints(findings: Iterable[Finding]) -> Iterator[str]:
    """Return the texts of all findings that did not pass."""
    return (str(finding) for finding in findings if finding.result != "pass")


def system_text(path: Path) -> str | None:
    """Return the stripped content of a file of the system; None if it cannot be read."""
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return None
