"""Lateness of the loop's clock, compared with cyclictest of rt-tests.

Both wait for absolute deadlines of the monotonic clock, 1 ms apart, with locked memory and under SCHED_FIFO if that is
allowed. The clock is measured twice: sleeping only, and as the loop uses it, spinning before a deadline.
"""

import array
import math
import os
import shutil
import subprocess

from friction_hil.config.schema import Realtime
from friction_hil.daemon.realtime import RealClock, punctuality
from friction_hil.errors import FrictionHilError
from tools.benchmarks.report import Row, compare, note, percentile, rounds

ROUNDS = 7
CYCLES = 2000
PERIOD_NS = 1_000_000
HISTOGRAM_US = 20_000
QUANTILES = {"p50": 0.5, "p99": 0.99}


def run() -> list[Row]:
    """Measure both alternately.

    Raises
    ------
    FrictionHilError
        cyclictest is not installed, or it failed.
    """
    if shutil.which("cyclictest") is None:
        raise FrictionHilError("cyclictest is not installed: sudo apt install rt-tests")
    defaults = Realtime()
    priority = defaults.priority if is_fifo_allowed(defaults.priority) else 0
    if priority:
        note(f"both under SCHED_FIFO {priority}")
    else:
        note("SCHED_FIFO is not allowed here (root, or rtprio in /etc/security/limits.conf): ordinary scheduling")
    clocks = {"sleep": RealClock(spin_us=0), f"spin {defaults.spin_us} us": RealClock(defaults.spin_us)}
    ours: dict[str, list[list[float]]] = {name: [] for name in clocks}
    theirs: list[list[float]] = []
    for _ in rounds(ROUNDS, "clock and cyclictest"):
        theirs.append(cyclictest(priority))
        for name, clock in clocks.items():
            with punctuality(priority):
                ours[name].append(lateness(clock))
    return [
        compare(
            f"late {label}, {name} (cyclictest)",
            "us",
            [percentile(samples, quantile) for samples in series],
            [percentile(samples, quantile) for samples in theirs],
        )
        for name, series in ours.items()
        for label, quantile in QUANTILES.items()
    ]


def is_fifo_allowed(priority: int) -> bool:
    """True if this process may have ``priority`` under SCHED_FIFO."""
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except PermissionError:
        return False
    os.sched_setscheduler(0, *before)
    return True


def lateness(clock: RealClock) -> list[float]:
    """Return the lateness of each wake-up, us, ascending."""
    late = array.array("q", bytes(8 * CYCLES))
    deadline = clock.now_ns() + PERIOD_NS
    for cycle in range(CYCLES):
        clock.sleep_until(deadline)
        now = clock.now_ns()
        late[cycle] = now - deadline
        deadline += PERIOD_NS * max(1, math.ceil((now - deadline) / PERIOD_NS))
    return sorted(ns / 1000 for ns in late)


def cyclictest(priority: int) -> list[float]:
    """Return the lateness of each wake-up of cyclictest, us, ascending.

    cyclictest counts whole microseconds; the middle of each is returned.
    """
    scheduling = [f"--priority={priority}"] if priority else ["--policy=other"]
    command = ["cyclictest", "--quiet", "--threads=1", f"--interval={PERIOD_NS // 1000}", f"--loops={CYCLES}"]
    if priority:
        command.append("--mlockall")
    done = subprocess.run([*command, *scheduling, f"--histogram={HISTOGRAM_US}"], capture_output=True, text=True)
    samples: list[float] = []
    for line in done.stdout.splitlines():
        if line[:1].isdigit():
            late, count = line.split()
            samples += [int(late) + 0.5] * int(count)
    if done.returncode or not samples:
        raise FrictionHilError(f"cyclictest failed ({done.returncode}): {done.stderr.strip() or done.stdout.strip()}")
    samples += [float(HISTOGRAM_US)] * (CYCLES - len(samples))
    return samples
