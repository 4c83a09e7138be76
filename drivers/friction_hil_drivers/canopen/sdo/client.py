"""Blocking SDO client: a drive's object dictionary, read and written while the drive is being configured.

No thread reads the bus: a request reads it until its answer came.
"""

import time
from collections import deque
from collections.abc import Callable
from functools import partial

import can
import canopen

from friction_hil.errors import DriveError
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.sdo.conversation import PATIENCE_S
from friction_hil_drivers.canopen.sdo.dialogue import SEGMENT, Download, OwedAnswers, Transfer, Upload, abort, describe
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.canopen.wire.cia301 import Frame
from friction_hil_drivers.canopen.wire.frames import FrameBus
from friction_hil_drivers.cia402.access import Abort, AbortError
from friction_hil_drivers.cia402.client import ObjectClient
from friction_hil_drivers.cia402.objects import Object

_READ_ATTEMPTS = 3  # within the patience: reading again is harmless, and a frame may have been lost
_MOST_NOTES = 5
_MOST_WAITING = 1000  # frames read at once: a request has its time limit on a busy bus too


class SdoChannel:
    """Transfers with the SDO server of one node, one after the other.

    ``pump`` reads the bus for at most so many seconds, and puts the answers of the node into ``arrived``.
    """

    def __init__(self, send: Callable[[bytes], None], pump: Callable[[float], None], now: Callable[[], float]) -> None:
        self._send, self._pump, self._now = send, pump, now
        self.arrived: deque[bytes] = deque()
        self.owed = OwedAnswers()

    def carry_out(self, transfer: Transfer, attempts: int) -> None:
        """Carry out a transfer; the request that begins it is sent so many times at most."""
        request: bytes | None = transfer.first()
        while request is not None:
            answer = self._ask(transfer, request, attempts)
            if answer is None:
                transfer.is_silent = True
                self._send(abort(transfer.entry.address, Abort.TIME_OUT))
                return
            request = transfer.take(answer)

    def _ask(self, transfer: Transfer, request: bytes, attempts: int) -> bytes | None:
        """Send a request and return its answer; None if none comes."""
        address = transfer.awaited
        if address == SEGMENT:
            attempts = 1  # a server that had it already would abort
        wait_s = PATIENCE_S / attempts
        self._pump(0.0)
        while self.arrived:
            self.owed.drop(self.arrived.popleft())
        end = self._now() + wait_s
        while self.owed[address] > 0 and (answer := self._next(end)) is not None:
            self.owed.drop(answer)
        del self.owed[address]
        for _ in range(attempts):
            self._send(request)
            self.owed[address] += 1
            end = self._now() + wait_s
            while (answer := self._next(end)) is not None:
                if transfer.accepts(answer):
                    self.owed[address] -= 1
                    return answer
                self.owed.drop(answer)
        return None

    def _next(self, end: float) -> bytes | None:
        """Return the next answer, None where none came until ``end``."""
        while not self.arrived and (left := end - self._now()) > 0.0:
            self._pump(left)
        return self.arrived.popleft() if self.arrived else None


class SdoClient(ObjectClient):
    """SDO client of one node; see `ObjectClient`."""

    def __init__(self, channel: SdoChannel, axis: str, where: str) -> None:
        super().__init__(axis, where)
        self._channel = channel
        self._has_answered = False
        self._late = 0

    def read_object(self, entry: Object) -> bytes:
        """See `ObjectClient.read_object`."""
        upload = Upload(entry)
        self._carry_out(upload, _READ_ATTEMPTS)
        if upload.is_silent and not self._has_answered:
            text = (
                f"{self.axis}: no drive answers as {self.where} (reading {entry}): is the drive on, is this "
                "its node number, and is the bit rate right?"
            )
            raise DriveError(text, code=codes.NO_ANSWER)
        return self._content(upload, "reading")

    def write_object(self, entry: Object, data: bytes) -> None:
        """See `ObjectClient.write_object`."""
        download = Download(entry, data)
        self._carry_out(download, 1)
        self._content(download, "writing")

    def _content(self, transfer: Transfer, verb: str) -> bytes:
        """Return the content of a transfer that is over, or raise what it has come to."""
        if transfer.is_silent:
            text = f"{self.axis}: {self.where} stopped answering ({verb} {transfer.entry}; waited {PATIENCE_S:g} s)"
            raise DriveError(text, code=codes.ANSWER_LOST)
        if transfer.data is None:
            raise AbortError(transfer.abort_code, str(canopen.SdoAbortedError(transfer.abort_code)))
        return transfer.data

    def _carry_out(self, transfer: Transfer, attempts: int) -> None:
        """Carry out a transfer; tell afterwards what arrived beside its answers."""
        try:
            self._channel.carry_out(transfer, attempts)
            self._has_answered |= not transfer.is_silent
        finally:
            for answer in self._channel.owed.strays:
                self._note_stray(answer)
            self._channel.owed.strays.clear()

    def _note_stray(self, answer: bytes) -> None:
        self._late += 1
        if self._late <= _MOST_NOTES:
            text = f"{self.where} sent {describe(answer)} when nothing waited for it (a late answer, or one to another "
            self.note(f"{text}SDO client); it was dropped")


class SdoNetwork:
    """SDO clients of the nodes on one bus, which is read while a request waits for its answer.

    ``heard``: called with each frame that was read. ``asking``: called with identifier and data of each request before
    it is sent; what it raises prevents that. ``now``: clock, s.
    """

    def __init__(
        self,
        bus: "FrameBus | can.BusABC",
        heard: Callable[[Frame], None] | None = None,
        asking: Callable[[int, bytes], None] | None = None,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self._bus = FrameBus(bus, "of the SDO client") if isinstance(bus, can.BusABC) else bus
        self._heard = heard
        self._asking = asking
        self._now = now
        # called before each wait for an answer; returns for how long it need not be called again, s
        self.meanwhile: Callable[[], float] | None = None
        self._channels: dict[int, SdoChannel] = {}  # by the identifier of its answers; a node with several axes has one

    def client(self, node: int, axis: str, where: str) -> SdoClient:
        """Return the SDO client of a node; `axis` and `where` are for its messages."""
        channel = SdoChannel(partial(self._send, cia301.SDO_REQUEST_BASE + node), self._pump, self._now)
        channel = self._channels.setdefault(cia301.SDO_RESPONSE_BASE + node, channel)
        return SdoClient(channel, axis, where)

    def _send(self, can_id: int, data: bytes) -> None:
        if self._asking is not None:
            self._asking(can_id, data)
        self._bus.send(can_id, data)

    def _pump(self, timeout: float) -> None:
        """Take a frame that comes within ``timeout`` seconds, and those that wait already."""
        for _ in range(_MOST_WAITING):
            if self.meanwhile is not None:
                timeout = min(timeout, self.meanwhile())
            frame = self._bus.receive(timeout)
            if frame is None:
                return
            timeout = 0.0
            if self._heard is not None:
                self._heard(frame)
            if (channel := self._channels.get(frame[0])) is not None:
                channel.arrived.append(frame[1])
