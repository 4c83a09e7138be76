"""SDO transfers with many nodes at once: one at a time for each node, all nodes side by side.

A script is a generator: it yields the transfers that it wants and pauses, and returns its result.
"""

import contextlib
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from friction_hil_drivers.canopen.sdo.dialogue import Transfer, Upload
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.canopen.wire.queue_full import QueueFullError
from friction_hil_drivers.cia402 import objects

if TYPE_CHECKING:
    from friction_hil_drivers.canopen.wire.cia301 import Frame
    from friction_hil_drivers.canopen.wire.frames import FrameBus

PATIENCE_S = 3.0  # storing parameters and a change of mapping take some drives more than a second
_SILENT_S = 0.25  # for an answer of a node that has kept silent for its whole time before
# between two requests: a queue of ten frames (SocketCAN's default) does not overflow, and a running master has room
_SPACING_S = 0.001

_R = TypeVar("_R")


@dataclass(frozen=True, slots=True)
class Pause:
    """A wait of a script, s."""

    duration_s: float


Script = Generator[Transfer | Pause, None, _R]

NODES = range(1, 128)
FIRST_ANSWER_S = 0.8  # of a node that may not exist: asked once


@dataclass(slots=True)
class _Turn:
    """What one script waits for."""

    transfer: Transfer | None  # None: a pause
    due: float  # end of the pause, or of the wait for an answer
    attempts: int


class Conversation:
    """Scripts with several nodes of a bus, which nothing else may read meanwhile.

    ``answer_s``: longest wait for an answer, s. ``attempts``: number of times that a request is sent to a silent node.
    ``meanwhile``: called before each wait; returns for how long it need not be called again, s. ``heard``: called with
    each frame that was read. ``asking``: called with identifier and data of each request before it is sent; what it
    raises ends the conversation.
    """

    def __init__(
        self,
        bus: "FrameBus",
        *,
        answer_s: float,
        attempts: int,
        meanwhile: Callable[[], float] | None = None,
        heard: "Callable[[Frame], None] | None" = None,
        asking: Callable[[int, bytes], None] | None = None,
    ) -> None:
        self._bus = bus
        self._heard = heard
        self._asking = asking
        self._meanwhile = meanwhile
        self._silent: set[int] = set()  # nodes that have not answered the request before
        self._answer_s = answer_s
        self._attempts = attempts
        self._turns: dict[int, _Turn] = {}
        self._waiting: deque[tuple[int, bytes]] = deque()  # requests to be sent: node, data
        self._next_send = 0.0

    def hold(self, scripts: Mapping[int, "Script[_R]"]) -> dict[int, _R]:
        """Run one script for each node to its end; return their results in the same order."""
        results: dict[int, _R] = {}
        for node, script in scripts.items():
            self._advance(node, script, results)
        while self._turns:
            self._send_due()
            longest_s = float("inf") if self._meanwhile is None else self._meanwhile()
            frame = self._bus.receive(min(self._patience(), longest_s))
            if frame is not None and self._heard is not None:
                self._heard(frame)
            if frame is not None and frame[0] - cia301.SDO_RESPONSE_BASE in self._turns:
                self._take(frame[0] - cia301.SDO_RESPONSE_BASE, frame[1])
            now = time.monotonic()
            for node, turn in list(self._turns.items()):
                if self._is_over(node, turn, now):
                    self._advance(node, scripts[node], results)
        return {node: results[node] for node in scripts}

    def _advance(self, node: int, script: "Script[_R]", results: dict[int, _R]) -> None:
        """Let a script go on to its next transfer or pause, or to its end."""
        try:
            wanted = next(script)
        except StopIteration as ended:
            results[node] = ended.value
            self._turns.pop(node, None)
            return
        if isinstance(wanted, Pause):
            self._turns[node] = _Turn(None, time.monotonic() + wanted.duration_s, 0)
            return
        self._turns[node] = _Turn(wanted, float("inf"), 1)
        self._waiting.append((node, wanted.first()))

    def _send_due(self) -> None:
        now = time.monotonic()
        if self._waiting and now >= self._next_send:
            node, data = self._waiting.popleft()
            if self._asking is not None:
                self._asking(cia301.SDO_REQUEST_BASE + node, data)
            # a request that the queue does not take is repeated as one that was lost on the bus
            with contextlib.suppress(QueueFullError):
                self._bus.send(cia301.SDO_REQUEST_BASE + node, data)
            self._next_send = now + _SPACING_S
            turn = self._turns.get(node)
            if turn is not None and turn.transfer is not None:
                turn.due = now + (min(self._answer_s, _SILENT_S) if node in self._silent else self._answer_s)

    def _patience(self) -> float:
        """Return the time until something is due, s."""
        due = min(turn.due for turn in self._turns.values())
        if self._waiting:
            due = min(due, self._next_send)
        return max(0.0, due - time.monotonic())

    def _take(self, node: int, data: bytes) -> None:
        transfer = self._turns[node].transfer
        following = None if transfer is None else transfer.take(data)
        if following is not None:
            self._waiting.append((node, following))

    def _is_over(self, node: int, turn: _Turn, now: float) -> bool:
        """Return True when a script may go on; send the request of a silent node again."""
        transfer = turn.transfer
        if transfer is None:
            return now >= turn.due
        if transfer.is_done:
            self._silent.discard(node)
            return True
        if now < turn.due:
            return False
        if turn.attempts < self._attempts:
            turn.attempts, turn.due = turn.attempts + 1, float("inf")
            self._waiting.append((node, transfer.first()))
            return False
        transfer.is_silent = True
        self._silent.add(node)
        return True


def device_types(talk: Conversation, nodes: Iterable[int] = NODES) -> dict[int, int | None]:
    """Return the device type (None: it has none) of each node that answers."""
    uploads = {node: Upload(objects.DEVICE_TYPE) for node in nodes}
    talk.hold({node: _carried_out(upload) for node, upload in uploads.items()})
    return {node: upload.value for node, upload in uploads.items() if not upload.is_silent}


def _carried_out(transfer: Transfer) -> "Script[None]":
    yield transfer
