"""What the drives' watchdogs wait for while the drives are left: heartbeats, remote frames, RPDOs. No bus, no clock.

From the last cycle until its watchdogs are off a drive may wait for seconds, because SDO is slow and other drives are
left first. If the daemon were silent meanwhile, a drive would end a good run with an emergency or a fault.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from friction_hil_drivers.canopen.cycle.axis import CanopenAxis

_FRAMES_PER_TIMER = 4
_IDLE_S = 1.0


@dataclass(slots=True)
class Timer:
    """A frame that the watchdogs wait for, and when it is due."""

    can_id: int
    data: bytes | None  # None: a remote frame
    period_ns: int
    node: int = 0  # of an RPDO or of node guarding
    next_ns: int = 0


class LastFrames:
    """Frames that are due while drives are left.

    None is due as long as a drive may have power: its watchdogs are to trip. The RPDOs say "disable voltage".
    ``axes``: as the cyclic phase has left them. ``timers``: of the heartbeat and of node guarding.
    """

    def __init__(self, axes: Sequence["CanopenAxis"], timers: Iterable[Timer]) -> None:
        self._may_have_power = {axis.facts.name for axis in axes if not axis.is_proved_unpowered}
        self._timers = list(timers)
        for axis in axes:
            within_ms = [means.within_ms for means in axis.watch.means if means.kind == "rpdo"]
            for can_id, data in axis.disabling_frames() if within_ms else ():
                self._timers.append(Timer(can_id, data, 1_000_000 * within_ms[0] // _FRAMES_PER_TIMER, axis.node))

    def note(self, axis: str, *, is_unpowered: bool) -> None:
        """Note what was read back of an axis."""
        if is_unpowered:
            self._may_have_power.discard(axis)
        else:
            self._may_have_power.add(axis)

    def left_operational(self, node: int) -> None:
        """Note that a node takes no RPDOs any more: their timers do not run."""
        self._timers = [timer for timer in self._timers if timer.node != node or timer.data is None]

    def left(self, node: int) -> None:
        """Note that a node is as it was found: remote frames would make it wait for more of them."""
        self._timers = [timer for timer in self._timers if timer.node != node]

    def due(self, now_ns: int) -> Iterator[tuple[int, bytes | None]]:
        """Yield the frames that are due, and count them as sent; a remote frame has None for its data."""
        if self._may_have_power:
            return
        for timer in self._timers:
            if now_ns >= timer.next_ns:
                timer.next_ns = now_ns + timer.period_ns
                yield timer.can_id, timer.data

    def wait_s(self, now_ns: int) -> float:
        """Return the time until a frame is due, s."""
        if self._may_have_power:
            return _IDLE_S
        return max(0, min(timer.next_ns for timer in self._timers) - now_ns) * 1e-9
