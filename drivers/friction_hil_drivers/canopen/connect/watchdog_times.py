"""How long a drive waits for the daemon before it stops, and how often the daemon is heard. Pure arithmetic.

A watchdog must not trip while the loop bridges `realtime.max_missed` periods, and should trip soon after that.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

HEARTBEATS_TO_LOSS = 3  # missing in a row, of a drive's heartbeat; and of the daemon's where heartbeat_s is given
REACTION_MS = 10  # from the end of a drive's time until it has no torque: its own cycle, and its reaction
_MARGIN_CYCLES = 2  # beside those that the loop bridges: the late cycle itself, and where in its cycle a frame is sent
_SHORTEST_TIMER_MS = 20
_SHORTEST_HEARTBEAT_MS = 20  # by default
_FEEDS_PER_TIMER = 4  # signs of life of the daemon within the time after which the drive stops
_LONGEST_MS = 0xFFFF


@dataclass(frozen=True, slots=True)
class WatchdogTimes:
    """Times of all watchdogs of an axis, and what they follow from: ``period_s``, s, and ``max_missed``."""

    timer_ms: int  # event timer of an RPDO
    feed_cycles: int  # the RPDO is sent every so many cycles
    heartbeat_ms: int  # period of the drive's heartbeat
    # 100Ch and 100Dh: their product is the time without the daemon's heartbeat or remote frames that is a loss
    guard_ms: int
    guards_to_loss: int
    beat_s: float  # period of these, s: whole cycles, not longer than guard_ms
    period_s: float
    max_missed: int
    is_demanded: bool = False  # the user has written max_missed

    @property
    def loss_ms(self) -> int:
        """Time without the daemon's heartbeats, or without guarding, that is a loss for the drive."""
        return self.guards_to_loss * self.guard_ms

    def behind_a_timer(self) -> "WatchdogTimes":
        """Return the times where an RPDO has a timer, which acts first: heartbeats need not be as frequent."""
        heartbeat_ms = self.heartbeat_ms
        return replace(self, guard_ms=heartbeat_ms, guards_to_loss=HEARTBEATS_TO_LOSS, beat_s=1e-3 * heartbeat_ms)

    def met_by(self, within_ms: int) -> int:
        """Return the smallest `max_missed` whose own time is as long as that of a drive."""
        most = max(1, math.floor(within_ms / (1e3 * self.period_s)))  # a larger one bridges longer than the drive waits
        return next(each for each in range(1, most + 1) if each == most or _timer_ms(self.period_s, each) >= within_ms)


def watchdog_times(
    period_s: float, max_missed: int, heartbeat_s: float | None = None, watchdog_s: float | None = None
) -> WatchdogTimes:
    """Return the times for a period of the loop, s, and the consecutive periods that it bridges.

    ``heartbeat_s``, ``watchdog_s``: period of heartbeats and event timer of the RPDO, s, where these are given.
    """
    own_ms = _timer_ms(period_s, max_missed)
    timer_ms = own_ms if watchdog_s is None else round(1e3 * watchdog_s)
    feed_cycles = _feed_cycles(period_s, max_missed, timer_ms)
    if heartbeat_s is None:
        # its loss, as that of the RPDO, is as soon as the bridged periods allow
        loss_ms = max(own_ms, timer_ms)
        guards_to_loss = _FEEDS_PER_TIMER
        guard_ms = min(-(-loss_ms // guards_to_loss), _LONGEST_MS // guards_to_loss)
        beat_s = period_s * _feed_cycles(period_s, max_missed, guard_ms * guards_to_loss)
        heartbeat_ms = max(_SHORTEST_HEARTBEAT_MS, math.ceil(_shortest_heartbeat_ms(period_s, max_missed) - 1e-9))
    else:
        heartbeat_ms, guards_to_loss = round(1e3 * heartbeat_s), HEARTBEATS_TO_LOSS
        guard_ms, beat_s = heartbeat_ms, 1e-3 * heartbeat_ms
    return WatchdogTimes(
        timer_ms=min(timer_ms, _LONGEST_MS),
        feed_cycles=feed_cycles,
        heartbeat_ms=min(heartbeat_ms, _LONGEST_MS // HEARTBEATS_TO_LOSS),
        guard_ms=min(guard_ms, _LONGEST_MS // guards_to_loss),
        guards_to_loss=guards_to_loss,
        beat_s=beat_s,
        period_s=period_s,
        max_missed=max_missed,
    )


def _timer_ms(period_s: float, max_missed: int) -> int:
    """Return the time of a watchdog that follows from what the loop bridges."""
    bridged_ms = _bridged_ms(period_s, max_missed)
    return max(_SHORTEST_TIMER_MS, math.ceil(bridged_ms + max(1e3 * period_s, bridged_ms / 8) - 1e-9))


def _feed_cycles(period_s: float, max_missed: int, within_ms: float) -> int:
    """Return every how many cycles a watchdog of so many milliseconds needs a sign of life."""
    feed_ms = min(within_ms - _bridged_ms(period_s, max_missed), within_ms / _FEEDS_PER_TIMER)
    return max(1, math.floor(1e-3 * feed_ms / period_s + 1e-9))


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
    between_ms = 1e3 * times.beat_s + (period_ms if times.guards_to_loss == HEARTBEATS_TO_LOSS else 0.0)
    if times.loss_ms < bridged_ms + between_ms - 1e-9:
        least_s = 1e-3 * math.ceil(_shortest_heartbeat_ms(period_s, max_missed) - 1e-9)
        yield (
            "heartbeat_s",
            f"the drive stops {times.loss_ms} ms after the last heartbeat ({times.guards_to_loss} x "
            f"{times.guard_ms} ms), but the loop bridges {bridged}, after up to {between_ms:g} ms without a "
            f"heartbeat: at least {least_s:g} s, or a smaller realtime.max_missed",
        )


def _bridged_ms(period_s: float, max_missed: int) -> float:
    return 1e3 * period_s * (max_missed + _MARGIN_CYCLES)


def _shortest_heartbeat_ms(period_s: float, max_missed: int) -> float:
    """Return the heartbeat whose loss outlasts the bridged periods: 3 h >= bridged + h + period."""
    return (_bridged_ms(period_s, max_missed) + 1e3 * period_s) / (HEARTBEATS_TO_LOSS - 1)
