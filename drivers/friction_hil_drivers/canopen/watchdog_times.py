"""How long a drive waits for the daemon before it stops, and how often the daemon is heard. Pure arithmetic.

A watchdog must not trip while the loop bridges `realtime.max_missed` periods, and should trip soon after that.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

HEARTBEATS_TO_LOSS = 3  # missing in a row
_MARGIN_CYCLES = 2  # beside those that the loop bridges: the late cycle itself, and where in its cycle a frame is sent
_SHORTEST_TIMER_MS = 20
_SHORTEST_HEARTBEAT_MS = 20  # by default
_FEEDS_PER_TIMER = 4
_LONGEST_MS = 0xFFFF


@dataclass(frozen=True, slots=True)
class WatchdogTimes:
    """Times of all watchdogs of an axis.

    Attributes
    ----------
    timer_ms : int
        Event timer of an RPDO.
    feed_cycles : int
        The RPDO is sent every so many cycles.
    heartbeat_ms : int
        Period of heartbeats in both directions, and of node guarding.
    """

    timer_ms: int
    feed_cycles: int
    heartbeat_ms: int

    @property
    def loss_ms(self) -> int:
        """Time without heartbeats, or without guarding, that is a loss."""
        return HEARTBEATS_TO_LOSS * self.heartbeat_ms


def watchdog_times(
    period_s: float, max_missed: int, heartbeat_s: float | None = None, watchdog_s: float | None = None
) -> WatchdogTimes:
    """Return the times for a period and a number of bridged cycles; those that are given as they are.

    Parameters
    ----------
    period_s : float
        Period of the loop, s.
    max_missed : int
        Consecutive periods that the loop bridges.
    heartbeat_s, watchdog_s : float, optional
        Period of heartbeats and event timer of the RPDO, s.
    """
    period_ms = 1e3 * period_s
    bridged_ms = _bridged_ms(period_s, max_missed)
    if heartbeat_s is None:
        heartbeat_ms = max(_SHORTEST_HEARTBEAT_MS, math.ceil(_shortest_heartbeat_ms(period_s, max_missed) - 1e-9))
    else:
        heartbeat_ms = round(1e3 * heartbeat_s)
    if watchdog_s is None:
        timer_ms = max(_SHORTEST_TIMER_MS, math.ceil(bridged_ms + max(period_ms, bridged_ms / 8) - 1e-9))
    else:
        timer_ms = round(1e3 * watchdog_s)
    feed_ms = min(timer_ms - bridged_ms, timer_ms / _FEEDS_PER_TIMER)
    feed_cycles = max(1, math.floor(feed_ms / period_ms + 1e-9))
    return WatchdogTimes(min(timer_ms, _LONGEST_MS), feed_cycles, min(heartbeat_ms, _LONGEST_MS // HEARTBEATS_TO_LOSS))


def contradictions(period_s: float, max_missed: int, times: WatchdogTimes) -> Iterator[tuple[str, str]]:
    """Yield which watchdog would trip while the loop still bridges missed periods: (key, calculation)."""
    period_ms = 1e3 * period_s
    bridged_ms = _bridged_ms(period_s, max_missed)
    bridged = f"realtime.max_missed {max_missed} + {_MARGIN_CYCLES} cycles of {period_ms:g} ms = {bridged_ms:g} ms"
    feed_ms = times.feed_cycles * period_ms
    if times.timer_ms < bridged_ms + feed_ms - 1e-9:
        least_s = 1e-3 * math.ceil(bridged_ms + feed_ms - 1e-9)
        yield (
            "watchdog_s",
            f"the drive stops {times.timer_ms} ms after the last command, but the loop bridges {bridged}, after up to "
            f"{feed_ms:g} ms without that command: at least {least_s:g} s, or a smaller "
            "realtime.max_missed",
        )
    between_ms = times.heartbeat_ms + period_ms
    if times.loss_ms < bridged_ms + between_ms - 1e-9:
        least_s = 1e-3 * math.ceil(_shortest_heartbeat_ms(period_s, max_missed) - 1e-9)
        yield (
            "heartbeat_s",
            f"the drive stops {times.loss_ms} ms after the last heartbeat ({HEARTBEATS_TO_LOSS} x "
            f"{times.heartbeat_ms} ms), but the loop bridges {bridged}, after up to {between_ms:g} ms without a "
            f"heartbeat: at least {least_s:g} s, or a smaller realtime.max_missed",
        )


def _bridged_ms(period_s: float, max_missed: int) -> float:
    return 1e3 * period_s * (max_missed + _MARGIN_CYCLES)


def _shortest_heartbeat_ms(period_s: float, max_missed: int) -> float:
    """Return the heartbeat whose loss outlasts the bridged periods: 3 h >= bridged + h + period."""
    return (_bridged_ms(period_s, max_missed) + 1e3 * period_s) / (HEARTBEATS_TO_LOSS - 1)
