"""What was found when something was looked at, whether it is as it should be, and what would mend it."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from friction_hil.errors import FrictionHilError

NOT_TOLD = "not told by this system"


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that was looked at.

    Attributes
    ----------
    check : str
        What was looked at, in a few words.
    result : str
        ``fail``: the daemon will not run, or not safely; ``warn``: it runs, but worse, or nothing tells; ``pass``.
    detail : str
        What was found.
    fix : str
        What would mend it; empty where nothing needs to be mended.
    """

    check: str
    result: Literal["pass", "warn", "fail"]
    detail: str
    fix: str = ""

    def __str__(self) -> str:
        return f"{self.detail}; {self.fix}" if self.fix else self.detail


def failure(check: str, error: FrictionHilError) -> Finding:
    """Make a finding of what a run would end with."""
    return Finding(check, "fail", error.detail, error.fix)


def complaints(findings: Iterable[Finding]) -> Iterator[str]:
    """What is not as it should be, in words."""
    return (str(finding) for finding in findings if finding.result != "pass")


def system_text(path: Path) -> str | None:
    """Content of a file by which the system tells something, without blanks at its ends; None where it does not."""
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return None
