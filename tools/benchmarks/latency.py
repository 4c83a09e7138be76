"""Lateness of the loop's pacing, compared with cyclictest of rt-tests.

Both wait for absolute deadlines of the monotonic clock, 1 ms apart, with locked memory and under SCHED_FIFO if that is
allowed. The pacing is measured twice: sleeping only, and as the loop uses it, spinning before a deadline.
`friction-hil latency` measures the same once, for users.
"""

from friction_hil.config import Realtime
from friction_hil.daemon.latency import (
    INSTALL_CYCLICTEST,
    Latency,
    cyclictest,
    has_cyclictest,
    is_fifo_allowed,
    measure,
)
from friction_hil.daemon.realtime import RealClock, punctuality
from friction_hil.errors import FrictionHilError
from tools.benchmarks.report import Row, compare, note, rounds

ROUNDS = 7
CYCLES = 2000
PERIOD_S = 1e-3
QUANTILES = {"p50": 0.5, "p99": 0.99}


def run() -> list[Row]:
    """Measure both alternately.

    Raises
    ------
    FrictionHilError
        cyclictest is not installed, or it failed.
    """
    if not has_cyclictest():
        raise FrictionHilError(f"cyclictest is not installed: {INSTALL_CYCLICTEST}")
    defaults = Realtime()
    priority = defaults.priority if is_fifo_allowed(defaults.priority) else 0
    if priority:
        note(f"both under SCHED_FIFO {priority}")
    else:
        note("SCHED_FIFO is not allowed here (root, or rtprio in /etc/security/limits.conf): ordinary scheduling")
    clocks = {"sleep": RealClock(spin_us=0), f"spin {defaults.spin_us} us": RealClock(defaults.spin_us)}
    ours: dict[str, list[Latency]] = {name: [] for name in clocks}
    theirs: list[Latency] = []
    for _ in rounds(ROUNDS, "pacing and cyclictest"):
        theirs.append(cyclictest(priority, PERIOD_S, CYCLES))
        for name, clock in clocks.items():
            with punctuality(priority):
                ours[name].append(measure(clock, PERIOD_S, CYCLES))
    return [
        compare(
            f"late {label}, {name} (cyclictest)",
            "us",
            [each.percentile_us(quantile) for each in series],
            [each.percentile_us(quantile) for each in theirs],
        )
        for name, series in ours.items()
        for label, quantile in QUANTILES.items()
    ]
