"""What the three exchanges have in common: frames of the bus go to the axes until each of them has its feedback."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Protocol

from friction_hil.drive import Clock
from friction_hil.errors import DriveError
from friction_hil_drivers.canopen.cycle.health import Handler

if TYPE_CHECKING:
    from friction_hil_drivers.canopen.wire.cia301 import Frame
    from friction_hil_drivers.canopen.wire.frames import FrameBus

# In simulated time nothing but these would ever end a run without drives.
STEPPED_TIMEOUT_S = 10.0
STEPPED_TIMEOUTS = 3  # in a row


class Completed(Protocol):
    """What knows whether all feedback of a cycle is there."""

    @property
    def is_complete(self) -> bool:
        """True if it is."""


class Listener:
    """Listener on the bus, which nothing else may read during the cyclic phase.

    ``handlers``: of each axis, what takes the data of a frame, by identifier. ``sets``: of each axis. ``next_id``:
    identifier of the frame that begins the next cycle, where another controller sends it.
    """

    __slots__ = ("_bus", "_clock", "_handlers", "_has_next", "_next_id", "_sets", "_timeouts")

    def __init__(
        self,
        bus: "FrameBus",
        clock: Clock,
        handlers: Sequence[Mapping[int, Handler]],
        sets: Sequence[Completed],
        next_id: int = -1,
    ) -> None:
        self._bus, self._clock, self._sets = bus, clock, sets
        self._handlers = _joined(handlers)
        self._next_id = next_id
        self._has_next = False  # the next cycle has begun
        self._timeouts = 0  # incomplete cycles in a row, in simulated time

    def _take(self, can_id: int, data: bytes) -> None:
        handler = self._handlers.get(can_id)
        if handler is not None:  # else a frame of another node
            handler(data)

    def _take_waiting(self, frame: "Frame | None") -> None:
        """Take a frame, and those that have arrived since: emergencies, heartbeats, late feedback."""
        while frame is not None:
            self._take(*frame)
            frame = self._bus.receive(0.0)

    def _collect(self, deadline_ns: int) -> bool:
        """Take frames until every axis has its feedback; return False if it is too late, or the next cycle has begun.

        In simulated time it is never too late: frames are taken for as long as the bus waits.
        """
        clock, receive, find, next_id = self._clock, self._bus.receive, self._handlers.get, self._next_id
        is_real, now_ns = clock.is_real, clock.now_ns
        for number, one in enumerate(self._sets):
            while not one.is_complete:
                timeout = (deadline_ns - now_ns()) * 1e-9 if is_real else self._patience_s(number)
                if timeout <= 0.0:
                    return False
                frame = receive(timeout)
                if frame is not None:
                    can_id, data = frame
                    handler = find(can_id)
                    if handler is not None:
                        handler(data)
                    elif can_id == next_id:
                        self._has_next = True
                        return False
                elif not is_real:
                    break
        return True

    def _patience_s(self, axis: int) -> float:
        """Return the time to wait for a frame of an axis in simulated time, s."""
        return STEPPED_TIMEOUT_S

    def _require_frames(self, is_complete: bool, text: str, code: str) -> None:
        """End a run in simulated time in which nothing comes any more.

        Raises `DriveError`: several cycles in a row were incomplete.
        """
        self._timeouts = 0 if is_complete else self._timeouts + 1
        if self._timeouts >= STEPPED_TIMEOUTS:
            raise DriveError(text.format(STEPPED_TIMEOUTS * STEPPED_TIMEOUT_S), code=code)


def _joined(all_handlers: Sequence[Mapping[int, Handler]]) -> dict[int, Handler]:
    """Return the handler of each identifier; axes of one node share its heartbeats, emergencies and SDO answers."""
    joined: dict[int, Handler] = {}
    for handlers in all_handlers:
        for can_id, handler in handlers.items():
            before = joined.get(can_id)
            joined[can_id] = handler if before is None else partial(_both, before, handler)
    return joined


def _both(first: Handler, second: Handler, data: bytes) -> None:
    first(data)
    second(data)
