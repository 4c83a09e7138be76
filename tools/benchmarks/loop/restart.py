"""What it costs the loop that a process beside it dies and is started again."""

import contextlib
import os
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
from friction_hil.daemon.spawner.client import Spawn, Spawner, spawn_directly

from friction_hil.config import Realtime
from friction_hil.daemon.latency import is_fifo_allowed
from friction_hil.daemon.realtime import punctuality
from tools.benchmarks.loop.daemon import running
from tools.benchmarks.report import Row, compare, rounds

STARTS = 30
DEATHS = 3
_APART_S = 5.5  # what dies sooner three times in a row is not started again
_DYING = ("supervisor", "worker", "server")


def measure(folder: Path, axes: int) -> list[Row]:
    """Return the time for which a start holds its caller up, and the lateness of the cycles after one."""
    return [*_starts(), *_deaths(folder, axes)]


def _starts() -> list[Row]:
    priority = Realtime().priority
    ours: list[float] = []
    theirs: list[float] = []
    # the spawner first: in the daemon it has no real-time priority either
    with contextlib.closing(Spawner()) as spawner, punctuality(priority if is_fifo_allowed(priority) else 0):
        for _ in rounds(STARTS, "starts"):
            ours.append(_held_up_us(spawner.spawn))
            theirs.append(_held_up_us(spawn_directly))
    return [
        compare("held up by the start of a process by the spawner (by itself)", "us", ours, theirs),
        compare("the same, longest", "us", [max(ours)], [max(theirs)]),
    ]


def _held_up_us(spawn: Spawn) -> float:
    began_s = time.perf_counter()
    process = spawn(["-c", "pass"], [], subprocess.DEVNULL)
    held_s = time.perf_counter() - began_s
    assert process.stdin is not None
    process.stdin.close()
    process.wait()
    return 1e6 * held_s


def _deaths(folder: Path, axes: int) -> list[Row]:
    with running(folder, axes, 1e-3, Realtime().spin_us, (DEATHS + 1) * _APART_S) as daemon:
        for _ in range(DEATHS):
            time.sleep(_APART_S)
            for name, pid in daemon.processes().items():
                if name in _DYING:
                    with contextlib.suppress(ProcessLookupError):
                        os.kill(pid, signal.SIGKILL)
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
