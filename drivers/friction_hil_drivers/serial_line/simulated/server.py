"""Simulated serial lines: wire time, turn-around and faults between a port and its drives."""

import heapq
import itertools
import select
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Protocol

from friction_hil_drivers.serial_line.options import LineOptions
from friction_hil_drivers.serial_line.simulated.drive import SimulatedDrive
from friction_hil_drivers.serial_line.simulated.faults import Faults
from friction_hil_drivers.serial_line.simulated.options import LineFaults
from friction_hil_drivers.serial_line.simulated.port import Port
from friction_hil_drivers.serial_line.wire import character_s

SPLIT_NS = 1_000_000  # time between the pieces of a reply, as with a USB adapter
BOOT_S = 0.3
_IDLE_NS = 250_000  # longest sleep between requests, so that little is left to integrate at the next one
_STEP_NS = 100_000
_SYNC_TIMEOUT_S = 0.1
_S = 1e9  # ns


class Responder(Protocol):
    """Drives' end of a protocol on one line."""

    request_end: bytes  # end of each request, at which received bytes are divided; b"" if requests have none

    def take(self, received: bytearray) -> bytes | None:
        """Remove one whole request and return its reply, ``b""`` if none is due; None if the request is incomplete."""
        ...

    def forget(self) -> None:
        """Drop an incomplete request, after a silence on the line."""
        ...


class SimulatedLine:
    """Simulated line, on which the characters of requests and replies take time.

    Each direction has a time of its own, which is right for a master that does not send during a reply. With pace sync
    nothing takes time.
    """

    def __init__(
        self,
        port: Port,  # of the master
        responder: Responder,  # for all drives of the line
        drives: Sequence[SimulatedDrive],  # they are advanced to the end of a request before the responder answers it
        options: LineOptions,  # on a TCP connection only the drives' turn-around takes time
        faults: LineFaults,
        *,
        # between a request and its reply; an incomplete request is dropped after it; 0: requests end without one
        silence_chars: float,
        is_real: bool,  # False with pace sync
    ) -> None:
        self.port = port
        self.expected_ns: int | None = None  # expected beginning of the next cycle
        self.responder = responder
        self.drives = tuple(drives)
        self._is_real = is_real
        self._character_ns = character_s(options) * _S
        self._silence_ns = round(silence_chars * self._character_ns)
        self._reply_ns = self._silence_ns + round(options.turnaround_s * _S)
        self._faults = Faults(faults)
        self._delay_ns = round(faults.delay_s * _S)
        self._reboots = deque(sorted(faults.reboot_at_s))
        self._boot_s: float | None = None  # end of the time without supply
        self._arriving: deque[tuple[int, int, bytes]] = deque()  # end, time of reading, characters
        self._received = bytearray()
        self._heard_ns = 0  # end of the last received character
        self._departing: list[tuple[int, int, bytes]] = []  # heap: end, number, characters
        self._numbers = itertools.count()
        self._said_ns = 0  # end of the last sent character
        self._late: list[bytes] = []  # late replies with pace sync, sent after the next request

    @property
    def due_ns(self) -> int | None:
        """Time at which `work` has to be called next; None: not before bytes arrive."""
        moments = [queue[0][0] for queue in (self._arriving, self._departing) if queue]
        return min(moments, default=None)

    def hear(self, now_ns: int) -> None:
        """Read the bytes that have arrived at the port."""
        data = self.port.read()
        if data is None:
            self._arriving.clear()
            self._departing.clear()
            self._late.clear()
            self._forget()
        elif data:
            for piece in _divided(data, self.responder.request_end):
                begun_ns = max(now_ns, self._heard_ns)
                self._heard_ns = begun_ns + (round(len(piece) * self._character_ns) if self._is_real else 0)
                self._arriving.append((self._heard_ns, now_ns, piece))

    def work(self, now_ns: int, period_ns: int = 0) -> None:
        """Answer the requests that are complete by now, and send the replies that are due."""
        while self._arriving and self._arriving[0][0] <= now_ns:
            complete_ns, heard_ns, data = self._arriving.popleft()
            samples = self._samples
            self._answer(data, complete_ns)
            if self._samples != samples:
                self.expected_ns = heard_ns + period_ns
        while self._departing and self._departing[0][0] <= now_ns:
            self.port.write(heapq.heappop(self._departing)[2])
        if self._silence_ns and self._received and not self._arriving and now_ns > self._heard_ns + self._silence_ns:
            self._forget()

    def idle(self) -> None:
        """Drop an incomplete request: with pace sync, the line was silent for some time."""
        if self._silence_ns and self._received:
            self._forget()

    def advance_to(self, now_ns: int) -> None:
        """Advance the drives to ``now_ns`` after the start."""
        self.port.idle()
        for drive in self.drives:
            drive.advance_to(now_ns)
        if self._reboots or self._boot_s is not None:
            self._watch_supply()

    @property
    def _samples(self) -> int:
        return sum(drive.samples for drive in self.drives)

    def _answer(self, data: bytes, complete_ns: int) -> None:
        self.advance_to(complete_ns)
        self._received += data
        while self._received and (reply := self.responder.take(self._received)) is not None:
            for piece in self._late:
                self.port.write(piece)
            self._late.clear()
            if reply and self._boot_s is None:
                self._send(reply, complete_ns)
            if not self._is_real:
                self.advance_to(complete_ns)  # the request may have advanced the time

    def _send(self, reply: bytes, complete_ns: int) -> None:
        spoiled = self._faults.spoil(reply)
        if not self._is_real:
            if spoiled.is_late:
                self._late += spoiled.pieces
            else:
                for piece in spoiled.pieces:
                    self.port.write(piece)
            return
        begin_ns = max(complete_ns + self._reply_ns, self._said_ns)
        if spoiled.is_late:
            begin_ns += self._delay_ns
        for piece in spoiled.pieces:
            end_ns = begin_ns + round(len(piece) * self._character_ns)
            heapq.heappush(self._departing, (end_ns, next(self._numbers), piece))
            begin_ns = end_ns + SPLIT_NS
            if not spoiled.is_late:
                self._said_ns = end_ns

    def _forget(self) -> None:
        self._received.clear()
        self.responder.forget()

    def _watch_supply(self) -> None:
        """Switch the drives' supply off and on when it is time."""
        now_s = max(drive.time_s for drive in self.drives)
        if self._reboots and now_s >= self._reboots[0]:
            self._reboots.popleft()
            self._boot_s = now_s + BOOT_S
            self._departing.clear()
            self._late.clear()
            for drive in self.drives:
                drive.switch_off()
        elif self._boot_s is not None and now_s >= self._boot_s:
            self._boot_s = None
            for drive in self.drives:
                drive.switch_on()


def _divided(data: bytes, end: bytes) -> list[bytes]:
    """Split received bytes into one piece for each request."""
    if not end or data.find(end) in (-1, len(data) - len(end)):
        return [data]
    *whole, rest = data.split(end)
    return [part + end for part in whole] + ([rest] if rest else [])


def serve(
    lines: Sequence[SimulatedLine],  # all of this thread
    is_stopping: Callable[[], bool],  # called often
    *,
    period_ns: int,  # of the master
    # of busy waiting before each event, and around the expected beginning of the next cycle, so that the reply does not
    # wait for this process to wake up
    spin_ns: int,
    now_ns: Callable[[], int] = time.monotonic_ns,
) -> None:
    """Serve lines in step with a clock until ``is_stopping()`` is true."""
    start_ns = now_ns()
    now = advanced = 0
    while not is_stopping():
        wait_ns = min(_sleep_ns(line, now, spin_ns) for line in lines)
        descriptors = [descriptor for line in lines for descriptor in line.port.descriptors]
        ready = select.select(descriptors, (), (), wait_ns * 1e-9)[0]
        now = now_ns() - start_ns
        for line in lines:
            if ready and not set(ready).isdisjoint(line.port.descriptors):
                line.hear(now)
            line.work(now, period_ns)
        if now - advanced >= _STEP_NS:
            advanced = now
            for line in lines:
                line.advance_to(now)


def serve_in_steps(lines: Sequence[SimulatedLine], is_stopping: Callable[[], bool]) -> None:
    """Serve lines with pace sync: the result depends only on the requests."""
    while not is_stopping():
        descriptors = [descriptor for line in lines for descriptor in line.port.descriptors]
        ready = set(select.select(descriptors, (), (), _SYNC_TIMEOUT_S)[0])
        for line in lines:
            if not ready.isdisjoint(line.port.descriptors):
                line.hear(0)
                line.work(0)
            elif not ready:
                line.idle()


def _sleep_ns(line: SimulatedLine, now_ns: int, spin_ns: int) -> int:
    """Return the time that the process may sleep before the next event on a line, ns."""
    moments = [_IDLE_NS]
    if line.due_ns is not None:
        moments.append(line.due_ns - now_ns - spin_ns)
    if line.expected_ns is not None and line.expected_ns >= now_ns - spin_ns:
        moments.append(line.expected_ns - now_ns - spin_ns)
    return max(0, min(moments))
