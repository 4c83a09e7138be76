"""A finding: the result of one check of the machine, the configuration, a bus or a drive."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from friction_hil.errors import FrictionHilError

NOT_REPORTED = "not reported by this system"


@dataclass(frozen=True, slots=True)
class Finding:
    """Result of one check."""

    check: str  # its name: what was examined, in a few words
    # warn: the daemon runs, but less well, or the system does not report what was checked; fail: it will not run, or
    # not safely
    result: Literal["pass", "warn", "fail"]
    detail: str  # what was found
    fix: str = ""  # remedy; empty if the check passed
    # under which ``friction_hil/doctor/README.md`` explains the finding, e.g. ``FH-310``; empty if the check passed
    code: str = ""

    def __str__(self) -> str:
        text = f"{self.detail}; {self.fix}" if self.fix else self.detail
        return f"{text} [{self.code}]" if self.code else text


def failure(check: str, error: FrictionHilError, code: str = "") -> Finding:
    """Return the finding for an error that would end a run; ``code`` takes the place of the error's own."""
    return Finding(check, "fail", error.detail, error.fix, code or error.code)


def complaints(findings: Iterable[Finding]) -> Iterator[str]:
    """Yield the text of each finding that did not pass."""
    return (str(finding) for finding in findings if finding.result != "pass")


def system_text(path: Path) -> str | None:
    """Return the content of a system file without surrounding blanks; None if it cannot be read."""
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return None
