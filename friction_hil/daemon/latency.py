"""Wake-up latency of this machine: how late a loop begins its cycles, measured with the pacing of the loop itself.

cyclictest of rt-tests measures the same in C: it waits for absolute deadlines of the monotonic clock without spinning.
"""

import array
import os
import shutil
import subprocess
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from friction_hil.daemon.pacing import Pacer
from friction_hil.drive import Clock
from friction_hil.errors import FrictionHilError

INSTALL_CYCLICTEST = "sudo apt install rt-tests"
_HISTOGRAM_US = 20_000  # of cyclictest
_LOOK_S, _MOST_MISSED = 1.0, 0.05
_HISTOGRAM_NS = 1_000_000


@dataclass(frozen=True, slots=True)
class Latency:
    """Wake-up latency of a loop."""

    late_us: NDArray[np.float64]  # (n,) from the deadline to each wake-up, us, ascending
    missed: int  # periods that passed without a wake-up

    def percentile_us(self, share: float) -> float:
        """Return the latency, us, that ``share`` of the wake-ups do not exceed; one of those that were measured."""
        return float(np.quantile(self.late_us, share, method="inverted_cdf"))

    @property
    def max_us(self) -> float:
        """Largest latency, us."""
        return float(self.late_us[-1])

    def histogram(self, edges_us: Iterable[float]) -> list[int]:
        """Return the number of wake-ups between each two edges, us; the last one counts from the last edge on."""
        counts = np.histogram(self.late_us, [*edges_us, np.inf])[0]
        return [int(count) for count in counts]


def measure(clock: Clock, period_s: float, cycles: int) -> Latency:
    """Wait for ``cycles`` periods as the loop does, and do nothing in them; ``clock`` spins as it was made to."""
    pacer = Pacer(clock, period_s, lambda _: None)
    late_ns = array.array("q", bytes(8 * cycles))
    cycle = missed = 0
    pacer.start()
    for k in range(cycles):
        cycle = pacer.wait(cycle) + 1
        late_ns[k] = pacer.overslept_ns
        missed += pacer.skipped
    return Latency(np.sort(np.array(late_ns) * 1e-3), missed)


def why_not_real_time(clock: Clock, period_s: float) -> str:
    """Look for a second whether simulated drives keep up with a period here; return why not, or nothing if they do.

    The priority is that of an ordinary process, as simulated drives have it beside a loop of higher priority.
    """
    cycles = round(_LOOK_S / period_s)
    found = measure(clock, period_s, cycles)
    share = found.missed / (found.missed + cycles)
    if share <= _MOST_MISSED:
        return ""
    missed = f"{100.0 * share:.0f} % of periods of {period_s * 1e3:g} ms"
    return f"this computer is too busy: an ordinary process misses {missed}"


def is_fifo_allowed(priority: int) -> bool:
    """True if this process may have ``priority`` under SCHED_FIFO."""
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except PermissionError:
        return False
    os.sched_setscheduler(0, *before)
    return True


def has_cyclictest() -> bool:
    """True if cyclictest is installed."""
    return shutil.which("cyclictest") is not None


def cyclictest(priority: int, period_s: float, cycles: int, *, is_fine: bool = False) -> Latency:
    """Measure with cyclictest, under SCHED_FIFO with ``priority`` or, if it is 0, with ordinary scheduling.

    With ``is_fine`` it counts nanoseconds, up to a millisecond, instead of microseconds up to 20 ms. Raises
    `FrictionHilError`: it failed.
    """
    scheduling = [f"--priority={priority}", "--mlockall"] if priority else ["--policy=other"]
    command = ["cyclictest", "--quiet", "--threads=1", f"--interval={period_s * 1e6:.0f}", f"--loops={cycles}"]
    counts = ["--nsecs", f"--histogram={_HISTOGRAM_NS}"] if is_fine else [f"--histogram={_HISTOGRAM_US}"]
    done = subprocess.run([*command, *scheduling, *counts], capture_output=True, text=True)
    found = parse_cyclictest(done.stdout, period_s, unit_us=1e-3 if is_fine else 1.0)
    if done.returncode or found is None:
        raise FrictionHilError(f"cyclictest failed ({done.returncode}): {done.stderr.strip() or done.stdout.strip()}")
    return found


def parse_cyclictest(text: str, period_s: float, unit_us: float = 1.0) -> Latency | None:
    """Return what cyclictest has measured, from the output of ``--histogram``; None if there is no wake-up in it.

    It counts whole microseconds, or units of ``unit_us``; the middle of each is returned. For wake-ups beyond the
    histogram it tells only their number and the largest: all of them count as that one.
    """
    samples: list[float] = []
    beyond, largest_us = 0, 0.0
    for line in text.splitlines():
        words = line.split()
        if line[:1].isdigit() and len(words) == 2:
            samples += [int(words[0]) + 0.5] * int(words[1])
        elif line.startswith("# Histogram Overflows:"):
            beyond = int(words[-1])
        elif line.startswith("# Max Latencies:"):
            largest_us = float(words[-1])
    samples += [largest_us] * beyond
    if not samples:
        return None
    late_us = unit_us * np.sort(np.array(samples))
    return Latency(late_us, int((late_us // (period_s * 1e6)).sum()))
