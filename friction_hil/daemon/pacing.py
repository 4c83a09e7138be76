"""Pacing of the loop: deadlines, sleep, spin, warm caches, missed periods and lateness."""

import copy
from collections.abc import Callable

import numpy as np

from friction_hil.daemon.axis import AxisLoop
from friction_hil.daemon.row import AxisRow
from friction_hil.daemon.safety import LoopState
from friction_hil.drive import Clock, Command, Drives, DriveState, Feedback
from friction_hil.drive.phase_lock import PhaseLock

_HISTOGRAM_US = 20000
_EARLY = 0.15  # of the period: a locked loop is awake this long before SYNC, so that jitter does not let it come late


class Pacer:
    """Waits for the cycles of a loop and keeps the figures of its punctuality."""

    def __init__(self, clock: Clock, period_s: float, warm_caches: Callable[[int], None]) -> None:
        self._clock = clock
        self._period_ns = round(period_s * 1e9)
        # called with the number of the next cycle while there is time left before its deadline
        self._warm_caches = warm_caches
        self._start_ns = 0
        self._histogram = np.zeros(_HISTOGRAM_US + 1, dtype=np.int64)
        self.skipped = 0  # periods that were missed before the present cycle
        self.overslept_ns = 0  # from the deadline that was waited for to the wake-up
        self.late_us = 0.0  # lateness within the present cycle, us: missed periods do not count

    def start(self) -> None:
        """Let cycle 0 begin one period from now."""
        self._start_ns = self._clock.now_ns() + self._period_ns

    def wait(self, cycle: int) -> int:
        """Sleep until ``cycle`` begins; return the cycle in progress, a later one where periods were missed."""
        deadline_ns = self.deadline_ns(cycle)
        if self._clock.doze_until(deadline_ns):
            self._warm_caches(cycle)
        self._clock.sleep_until(deadline_ns)
        self.overslept_ns = self._clock.now_ns() - deadline_ns
        self.skipped, late_ns = divmod(self.overslept_ns, self._period_ns)
        self._histogram[min(late_ns // 1000, _HISTOGRAM_US)] += 1
        self.late_us = late_ns * 1e-3
        return cycle + self.skipped

    def deadline_ns(self, cycle: int) -> int:
        """Return the time at which ``cycle`` begins, ns."""
        return self._start_ns + cycle * self._period_ns

    def end_ns(self, cycle: int) -> int:
        """Return the time at which ``cycle`` ends, ns."""
        return self.deadline_ns(cycle + 1)

    def late_percentile_us(self, fraction: float) -> float:
        """Return the lateness, in whole microseconds, that ``fraction`` of the wake-ups do not exceed."""
        return float(np.searchsorted(np.cumsum(self._histogram), fraction * self._histogram.sum()))


class LockedPacer(Pacer):
    """Waits for the cycles of a loop whose drives another controller paces: each begins shortly before its SYNC."""

    def __init__(self, clock: Clock, period_s: float, warm_caches: Callable[[int], None], lock: PhaseLock) -> None:
        super().__init__(clock, period_s, warm_caches)
        self._lock = lock  # fed by the driver with the stamps of SYNC
        self._early_ns = round(_EARLY * self._period_ns)

    def start(self) -> None:
        """Let cycle 0 begin with the next SYNC that there is time to wait for."""
        self._lock.start(self._clock.now_ns() + self._early_ns)

    def deadline_ns(self, cycle: int) -> int:
        """Return the time at which ``cycle`` begins, ns; each SYNC may shift it."""
        return self._lock.sync_ns(cycle) - self._early_ns


def make_pacer(drives: Drives, clock: Clock, period_s: float, warm_caches: Callable[[int], None]) -> Pacer:
    """Return the pacer of a loop: locked to another controller where the drives have a ``phase_lock``."""
    lock = drives.phase_lock
    if lock is None or not clock.is_real:
        return Pacer(clock, period_s, warm_caches)
    return LockedPacer(clock, period_s, warm_caches, lock)


class ExchangeTimes:
    """Durations of the exchange with the drives while they are idle.

    In motion, missed periods are counted instead: an exchange that is too long must be known before.
    """

    def __init__(self, period_s: float) -> None:
        self._period_us = 1e6 * period_s
        self._times_us: list[float] = []

    def add(self, exchange_us: float) -> None:
        """Add the exchange of one idle cycle, us."""
        self._times_us.append(exchange_us)

    def warning(self) -> str | None:
        """Return a warning if feedback and command do not fit between two deadlines."""
        typical_us = float(np.median(self._times_us))
        if not typical_us > self._period_us:
            return None
        return (
            f"feedback and command take {typical_us:.0f} µs, more than the period of {self._period_us:.0f} µs: torques "
            "act whole periods later than they are computed for; take a longer period_s, a faster bus or fewer axes"
        )


class CacheWarmer:
    """Runs a cycle's code on copies of axis and row: caches that a sleep emptied cost as much as the work itself."""

    def __init__(self, drives: Drives, axis: AxisLoop, row: AxisRow) -> None:
        self._drives = drives
        self._axis = copy.deepcopy(axis)
        self._row = AxisRow(row.values.copy(), axis.shadow_names)
        self._feedback = Feedback(state=DriveState.OPERATION_ENABLED, is_fresh=True)
        self._command = Command()
        self.error: str | None = None  # first exception; nothing is warmed after it

    def warm(self, cycle: int) -> str | None:
        """Run the code of a cycle; nothing is sent, and nothing of the real axes changes. Return the error, if any."""
        try:
            self._drives.warm_caches()
            self._axis.compute(cycle, LoopState.RUNNING, 0.0, self._feedback, self._command, self._row)
        except MemoryError:
            raise
        except Exception as error:  # noqa: BLE001 - the cycle itself will fail too: the axes must come to rest
            self.error = f"{type(error).__name__}: {error}"
        return self.error
