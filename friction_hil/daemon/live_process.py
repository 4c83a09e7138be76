"""Start of the server of live data: gives up the priority at which the loop started it, and becomes the command."""

import contextlib
import os
import sys
from pathlib import Path

_OOM_SCORE = "500"
_NICENESS = 5  # behind the companion, whose rows must not be lost


def main(arguments: list[str]) -> None:
    """Become ``friction-hil`` with these arguments, at ordinary priority."""
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    os.nice(_NICENESS)
    with contextlib.suppress(OSError):
        # a service protects the daemon from the kernel's search for memory; this process is to go first
        Path("/proc/self/oom_score_adj").write_text(_OOM_SCORE, encoding="ascii")
    os.execv(sys.executable, [sys.executable, "-P", "-m", "friction_hil", *arguments])


if __name__ == "__main__":
    main(sys.argv[1:])
