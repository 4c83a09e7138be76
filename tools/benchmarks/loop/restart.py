"""What it costs the loop that a process beside it dies and is started again."""

import contextlib
import os
import signal
import time
from pathlib import Path

import numpy as np

from friction_hil.config import Realtime
from tools.benchmarks.loop.daemon import running
from tools.benchmarks.report import Row

DEATHS = 3
_APART_S = 5.5  # what dies sooner three times in a row is not started again
_AGAIN_S = 1.0  # until what was killed is there again
_DYING = ("supervisor", "worker", "server")  # one after the other: those that live start the others


def measure(folder: Path, axes: int) -> list[Row]:
    """Return the lateness of the cycles after a process was started again."""
    with running(folder, axes, 1e-3, Realtime().spin_us, (DEATHS + 1) * (_APART_S + len(_DYING) * _AGAIN_S)) as daemon:
        for _ in range(DEATHS):
            time.sleep(_APART_S)
            for name in _DYING:
                with contextlib.suppress(ProcessLookupError, KeyError):
                    os.kill(daemon.processes()[name], signal.SIGKILL)
                time.sleep(_AGAIN_S)
    (result,) = daemon.results
    after, others = result.after_restarts_us, result.late_us
    if not len(after):
        raise RuntimeError("no process was started again")
    return [
        Row(
            f"late after {len(after)} restarts, the latest (p99 of all cycles)",
            float(np.max(after)),
            "us",
            float(np.quantile(others, 0.99)),
        ),
        Row("rows lost", result.lost, ""),
    ]
