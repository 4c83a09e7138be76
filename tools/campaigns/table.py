"""The figures of a campaign: one row for each fault."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from tools.campaigns.faults import Fault
from tools.campaigns.judge import Verdict
from tools.campaigns.machine import RATED_TORQUE, TORQUE, TORQUE_SLEW
from tools.campaigns.trial import Seen

HEADINGS = (
    "fault",
    "tries",
    f"torque, of {TORQUE:g} N m",
    f"slew, of {TORQUE_SLEW:g} N m/s",
    "runs ended",
    "zero torque after",
    "no power after",
    "cause named",
    "rows lost",
    "exit status",
    "",
)


@dataclass
class Row:
    """All tries of a fault."""

    fault: Fault
    tries: list[tuple[Seen, Verdict]] = field(default_factory=list)

    @property
    def failures(self) -> list[tuple[int, list[str]]]:
        """Number and problems of each try that failed."""
        return [(number, verdict.problems) for number, (_, verdict) in enumerate(self.tries) if verdict.problems]

    @property
    def frames(self) -> int:
        """Number of frames or telegrams that passed."""
        return sum(seen.frames for seen, _ in self.tries)

    def figures(self) -> dict[str, Any]:
        """Return the figures of the row; the largest of all tries, None where there is none."""
        seen = [each for each, _ in self.tries]
        verdicts = [verdict for _, verdict in self.tries]
        struck = [verdict for verdict in verdicts if not verdict.is_void]
        return {
            "fault": self.fault.name,
            "text": self.fault.text,
            "tries": len(seen),
            "void": len(verdicts) - len(struck),
            "torque": _largest(each.witness.largest_torque * RATED_TORQUE * 1e-3 for each in seen),
            "slew": _largest(each.witness.largest_step / each.witness.limits.step * TORQUE_SLEW for each in seen),
            "ended": sum(verdict.has_ended for verdict in struck),
            "zero_s": _largest(verdict.zero_s for verdict in struck),
            "unpowered_s": _largest(verdict.unpowered_s for verdict in struck),
            "named": dict(Counter(verdict.named for verdict in struck if verdict.named)),
            "lost": _largest(verdict.lost for verdict in struck),
            "status": dict(Counter(str(each.status) for each in seen)),
            "frames": self.frames,
            "failed": len(self.failures),
        }

    def cells(self) -> list[str]:
        """Return the figures as text."""
        found = self.figures()
        tries = f"{found['tries']}" + (f" ({found['void']} void)" if found["void"] else "")
        passed = "void" if found["void"] == found["tries"] else "ok"  # nothing was shown
        failed = f"FAIL {found['failed']}" if found["failed"] else passed
        return [
            found["fault"],
            tries,
            _number(found["torque"], "{:.3f}"),
            _number(found["slew"], "{:.2f}"),
            str(found["ended"]),
            _number(found["zero_s"], "{:.0f} ms", 1e3),
            _number(found["unpowered_s"], "{:.0f} ms", 1e3),
            ", ".join(f"{name} {count}" for name, count in sorted(found["named"].items(), reverse=True)) or "-",
            _number(found["lost"], "{:.0f}"),
            ", ".join(f"{name}" for name in sorted(found["status"])),
            failed,
        ]


def markdown(rows: Sequence[Row]) -> str:
    """Return the table as Markdown, with columns of equal width."""
    lines = [list(HEADINGS), *(row.cells() for row in rows)]
    widths = [max(len(line[k]) for line in lines) for k in range(len(HEADINGS))]
    texts = [
        "| " + " | ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) + " |" for line in lines
    ]
    texts.insert(1, "|" + "|".join("-" * (width + 2) for width in widths) + "|")
    return "\n".join(texts)


def _largest(values: Any) -> float | None:
    return max((value for value in values if value is not None), default=None)


def _number(value: float | None, form: str, factor: float = 1.0) -> str:
    return "-" if value is None else form.format(value * factor)
