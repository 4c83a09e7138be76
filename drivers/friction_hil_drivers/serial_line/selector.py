"""Waiting for bytes on lines, until a moment."""

import contextlib
import select
from collections.abc import Collection, Sequence

from friction_hil_drivers.serial_line.ticker import Ticker

_TICK_MS = 10  # of the system: a time-out of so much costs nothing, a shorter one as much as all else of a wait


class LineSelector:
    """Waits for bytes on some lines.

    Parameters
    ----------
    period_ns : int, optional
        Of the moments until which is waited most often.
    """

    def __init__(self, period_ns: int | None = None) -> None:
        self._ticker: Ticker | None = None
        if period_ns is not None:
            with contextlib.suppress(OSError):  # each wait has its time-out then
                self._ticker = Ticker(period_ns)
        self._poll = select.poll()
        self._polled: list[int] = []

    def wait(self, descriptors: Sequence[int], until_ns: int, now_ns: int, *, is_periodic: bool) -> Collection[int]:
        """Wait for bytes, an end that was hung up, or the moment; it may end before, without a reason.

        Parameters
        ----------
        descriptors : sequence of int
            Open ones.
        until_ns, now_ns : int
            Of the monotonic clock.
        is_periodic : bool
            The moment is the same in each period.

        Returns
        -------
        collection of int
            The descriptors that have something.
        """
        wait_ns = until_ns - now_ns
        wait_ms = wait_ns // 1_000_000
        ticker = self._ticker
        if wait_ms < _TICK_MS:
            if not (is_periodic and ticker is not None and ticker.expires_before(until_ns, now_ns)):
                return select.select(descriptors, (), (), wait_ns * 1e-9 if wait_ns > 0 else 0.0)[0]
            wait_ms += _TICK_MS
        if descriptors != self._polled:
            self._register(descriptors)
        ready = dict(self._poll.poll(wait_ms))
        if ticker is not None and ticker.descriptor in ready:
            ticker.clear()
        return ready

    def _register(self, descriptors: Sequence[int]) -> None:
        self._poll = select.poll()
        for descriptor in descriptors:
            self._poll.register(descriptor, select.POLLIN)
        if self._ticker is not None:
            self._poll.register(self._ticker.descriptor, select.POLLIN)
        self._polled = list(descriptors)

    def forget(self) -> None:
        """Let what was waited for be over: no wait to come ends for it."""
        if self._ticker is not None:
            self._ticker.clear()

    def close(self) -> None:
        """Give back what it has. Safe to call twice."""
        if self._ticker is not None:
            self._ticker.close()
            self._ticker = None
            self._polled = []
