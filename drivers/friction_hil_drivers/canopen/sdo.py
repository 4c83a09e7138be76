"""SDO client: a drive's object dictionary, read and written while the drive is being configured.

The canopen library (2.4.1) takes whatever arrives next for the answer to its request. A drive that answers late once is
then believed to have answered the following request, and so on: `MatchingSdo` accepts only the answer that belongs to a
request. No thread reads the bus: a request reads it until its answer came.
"""

import contextlib
import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import can
import canopen
import canopen.sdo.client

from friction_hil.errors import DriveError
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.codec import Frame
from friction_hil_drivers.canopen.conversation import PATIENCE_S
from friction_hil_drivers.canopen.dialogue import (
    ABSENT,
    HIDDEN,
    SEGMENT,
    Abort,
    Address,
    abort,
    abort_code,
    answered,
    describe,
)
from friction_hil_drivers.canopen.frames import FrameBus
from friction_hil_drivers.canopen.journal import Journal, hexadecimal
from friction_hil_drivers.canopen.object_reader import ObjectReader
from friction_hil_drivers.canopen.objects import Object
from friction_hil_drivers.canopen.sdo_answers import Request

_READ_ATTEMPTS = 3  # within the patience: reading again is harmless, and a frame may have been lost
_MOST_NOTES = 5
_MOST_WAITING = 1000  # frames read at once: a request has its time limit on a busy bus too


class MatchingSdo(canopen.sdo.client.SdoClient):
    """SDO client of the canopen library that compares index, sub-index and toggle bit of each answer.

    Answers that belong to no request, or to one that was given up, are dropped and kept in ``strays``. A server answers
    in order; so a request for an object that still owes an answer waits for that one first, because it could not tell
    the two apart.

    Parameters
    ----------
    node : int
        Node number of the server.
    pump : callable, optional
        Reads the bus for at most so many seconds and hands what arrived to `on_response`; without it, another thread
        must do that.
    now : callable, optional
        Clock, s.
    """

    def __init__(
        self, node: int, pump: Callable[[float], None] | None = None, now: Callable[[], float] = time.monotonic
    ) -> None:
        super().__init__(0x600 + node, 0x580 + node, canopen.ObjectDictionary())  # type: ignore[no-untyped-call]
        self._pump = pump
        self._now = now
        self.patience_s = PATIENCE_S
        self.attempts = 1
        self.strays: list[bytes] = []
        self._owed: Counter[Address] = Counter()
        self._transfer: Address = (0, 0)

    def request_response(self, sdo_request: bytes | bytearray) -> bytes:
        """Send a request and return its answer.

        Raises
        ------
        canopen.SdoAbortedError
            The server aborts the transfer.
        canopen.SdoCommunicationError
            It does not answer.
        """
        request = Request.of(sdo_request, self._transfer)
        self._transfer = request.address
        # a segment must not be sent twice: a server that had it already would abort
        attempts = 1 if request.is_segment else self.attempts
        wait_s = self.patience_s / attempts
        self._drop_strays()
        self._await_owed(request.key, wait_s)
        for _ in range(attempts):
            self._send(bytes(sdo_request))
            self._owed[request.key] += 1
            answer = self._await_answer(request, wait_s)
            if answer is not None:
                self._owed[request.key] -= 1
                code = abort_code(answer)
                if code is not None:
                    raise canopen.SdoAbortedError(code)
                return answer
        self._send(abort(request.address, Abort.TIME_OUT))
        raise canopen.SdoCommunicationError("no SDO response received")

    def abort(self, abort_code: int = 0x08000000) -> None:
        """Abort the transfer under way, naming its object as CiA 301 demands."""
        self._send(abort(self._transfer, abort_code))

    def _send(self, request: bytes) -> None:
        self.send_request(request)  # type: ignore[no-untyped-call]

    def _await_answer(self, request: Request, wait_s: float) -> bytes | None:
        end = self._now() + wait_s
        while (answer := self._next(end)) is not None:
            if request.is_answered_by(answer):
                return answer
            self._drop(answer)
        return None

    def _await_owed(self, address: Address, wait_s: float) -> None:
        """Wait for the answers to earlier requests for the same object."""
        end = self._now() + wait_s
        while self._owed[address] > 0 and (answer := self._next(end)) is not None:
            self._drop(answer)
        del self._owed[address]

    def _drop_strays(self) -> None:
        if self._pump is not None:
            self._pump(0.0)
        while not self.responses.empty():
            self._drop(self.responses.get())

    def _drop(self, answer: bytes) -> None:
        self.strays.append(answer)
        address = answered(answer)
        if address is None or self._owed[address] <= 0:
            address = SEGMENT  # or the abort of one
        self._owed[address] = max(0, self._owed[address] - 1)

    def _next(self, end: float) -> bytes | None:
        """Return the next answer, None where none came until ``end``."""
        while self.responses.empty() and (left := end - self._now()) > 0.0:
            if self._pump is not None:
                self._pump(left)
            else:
                time.sleep(min(left, 0.001))
        return None if self.responses.empty() else bytes(self.responses.get())


def _channel(node: int, network: Any, pump: Callable[[float], None] | None, now: Callable[[], float]) -> MatchingSdo:
    """Return the SDO channel of a node, which hears what its server sends."""
    channel = MatchingSdo(node, pump, now)
    channel.network = network
    network.subscribe(channel.tx_cobid, channel.on_response)
    return channel


class SdoClient(ObjectReader):
    """SDO client of one node.

    Parameters
    ----------
    node
        ``canopen.RemoteNode`` on a network that is being read, or the `MatchingSdo` of a node.
    axis : str
        Name of the axis, for messages.
    where : str
        Node and bus, for messages.
    pump, now : callable, optional
        See `MatchingSdo`.

    Attributes
    ----------
    axis_number : int
        Number of the axis in a node with several: objects of the profile are those of this axis.
    notes : list of str
        For the user: objects that the drive refuses to show, and answers that came late.
    refusals : dict
        By index and sub-index: why the drive refused to show an object, where it did not say that it has none.
    journal : Journal or None
        Keeps what the drive holds before it is written to.
    write_refusals : dict
        By address: why an object does not hold what was written last.
    is_read_only : bool
        True: every write is refused, as if by the drive, and nothing is sent.
    """

    def __init__(
        self,
        node: Any,
        axis: str,
        where: str,
        pump: Callable[[float], None] | None = None,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self._sdo = node if isinstance(node, MatchingSdo) else _channel(node.id, node.network, pump, now)
        self.axis = axis
        self.where = where
        self.axis_number = 0
        self.notes: list[str] = []
        self.refusals: dict[Address, str] = {}
        self.write_refusals: dict[Address, str] = {}
        self._hidden: set[Address] = set()
        self.journal: Journal | None = None
        self.is_read_only = False
        self._has_answered = False
        self._late = 0

    @property
    def patience_s(self) -> float:
        """Time within which the drive must answer a request, s."""
        return self._sdo.patience_s

    @contextlib.contextmanager
    def patience(self, seconds: float) -> Iterator[None]:
        """Wait no longer than so many seconds for an answer meanwhile."""
        before, self._sdo.patience_s = self._sdo.patience_s, seconds
        try:
            yield
        finally:
            self._sdo.patience_s = before

    def bytes_of(self, entry: Object) -> bytes | None:
        """See `ObjectReader.bytes_of`; an object that the drive refuses to show counts as absent, with a note."""
        entry = entry.of_axis(self.axis_number)
        try:
            return self._upload(entry)
        except canopen.SdoAbortedError as error:
            if error.code not in ABSENT:
                self.refusals[entry.address] = str(error)
                if error.code in HIDDEN:
                    self._hidden.add(entry.address)
                absent = "" if error.code == Abort.WRITE_ONLY else ": taken as absent"
                self._note(f"the drive does not show {entry} ({error}){absent}")
            return None

    def why_absent(self, entry: Object) -> str:
        """See `ObjectReader.why_absent`."""
        reason = self.refusals.get(entry.of_axis(self.axis_number).address)
        return f"does not show ({reason})" if reason else super().why_absent(entry)

    def why_hidden(self, entry: Object) -> str:
        """See `ObjectReader.why_hidden`."""
        address = entry.of_axis(self.axis_number).address
        return self.refusals[address] if address in self._hidden else ""

    def why_not_written(self, entry: Object) -> str:
        """Return why an object does not hold what was written last, "" where it was not refused."""
        return self.write_refusals.get(entry.of_axis(self.axis_number).address, "")

    def hidden_width(self, entry: Object) -> int | None:
        """Return the width in bits, as the standard has it, of an object that cannot be read; None for another."""
        return entry.type.bits if self.why_hidden(entry) else None

    def _upload(self, entry: Object) -> bytes:
        try:
            with self._attempts(_READ_ATTEMPTS):
                return bytes(self._sdo.upload(entry.index, entry.subindex))
        except canopen.SdoCommunicationError as error:
            if self._has_answered:
                raise self._answer_lost("reading", entry) from error
            text = (
                f"{self.axis}: no drive answers as {self.where} (reading {entry}): is the drive on, is this "
                "its node number, and is the bit rate right?"
            )
            raise DriveError(text, code=codes.NO_ANSWER) from error

    def write(self, entry: Object, value: int, bits: int | None = None) -> None:
        """Write an integer object, with the width that its type has or ``bits``.

        Raises
        ------
        DriveError
            The drive does not answer, or refuses; the message has the value.
        """
        low, high = entry.type.bounds
        if not low <= value <= high:
            text = f"{self.axis}: {value} does not fit into {entry} ({low} to {high})"
            raise DriveError(text, code=codes.OBJECT_SIZE)
        self.write_bytes(entry, value.to_bytes((bits or entry.type.bits) // 8, "little", signed=value < 0), str(value))

    def write_bytes(self, entry: Object, data: bytes, shown: str = "") -> None:
        """Write the content of an object; ``shown`` is its value in messages.

        Raises
        ------
        DriveError
            The drive does not answer, or refuses.
        """
        entry = entry.of_axis(self.axis_number)
        if self.is_read_only:
            text = f"{self.axis}: {entry} of {self.where} is not written: another master moves the drive"
            raise DriveError(text, code=codes.SDO_ABORT)
        if self.journal is not None:
            self.journal.before(entry, data)
        self.download(entry, data, shown)
        if self.journal is not None:
            self.journal.after(entry)

    def download(self, entry: Object, data: bytes, shown: str = "") -> None:
        """Write the content of an object without keeping what it held before; see `write_bytes`."""
        try:
            with self._attempts(1):
                self._sdo.download(entry.index, entry.subindex, data)
        except canopen.SdoAbortedError as error:
            self.write_refusals[entry.address] = f"refused {hexadecimal(data)} (abort {error.code:08X}h)"
            text = f"{self.axis}: writing {shown or data.hex()} to {entry} of {self.where}: {error}"
            raise DriveError(text, code=codes.SDO_ABORT) from error
        except canopen.SdoCommunicationError as error:
            raise self._answer_lost("writing", entry) from error

    def peek(self, entry: Object) -> bytes | None:
        """Return the content of an object, None where the drive does not show it for whatever reason; without a note.

        Raises
        ------
        DriveError
            The drive does not answer.
        """
        try:
            return self._upload(entry)
        except canopen.SdoAbortedError:
            return None

    def try_write(self, entry: Object, value: int) -> bool:
        """Write an object that the drive may lack or refuse; return True if it then holds the value.

        One that the drive does not show is left alone: it could be neither read back nor restored.

        Raises
        ------
        DriveError
            The drive does not answer.
        """
        address = entry.of_axis(self.axis_number).address
        if self.find(entry) is None and address in self.refusals:
            self.write_refusals[address] = f"cannot be read ({self.refusals[address]}) and is left as it is"
            return False
        try:
            self.write(entry, value)
        except DriveError as error:
            if error.code != codes.SDO_ABORT:
                raise  # a drive that does not answer has not refused
        found = self.find(entry)
        if found not in (None, value):
            self.write_refusals.setdefault(address, f"holds {found:#x} after {value:#x} was written")
        return found == value

    @contextlib.contextmanager
    def _attempts(self, attempts: int) -> Iterator[None]:
        """Send a request so many times at most; tell afterwards what arrived beside its answer."""
        self._sdo.attempts = attempts
        try:
            yield
            self._has_answered = True
        except canopen.SdoAbortedError:
            self._has_answered = True
            raise
        finally:
            for answer in self._sdo.strays:
                self._note_stray(answer)
            self._sdo.strays.clear()

    def _note_stray(self, answer: bytes) -> None:
        self._late += 1
        if self._late <= _MOST_NOTES:
            text = f"{self.where} sent {describe(answer)} when nothing waited for it (a late answer, or one to another "
            self._note(f"{text}SDO client); it was dropped")

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)

    def _answer_lost(self, verb: str, entry: Object) -> DriveError:
        text = f"{self.axis}: {self.where} stopped answering ({verb} {entry}; waited {self.patience_s:g} s)"
        return DriveError(text, code=codes.ANSWER_LOST)


class _Network(canopen.Network):
    """Network of the canopen library that sends on a frame bus."""

    def __init__(self, bus: FrameBus, asking: Callable[[int, bytes], None] | None) -> None:
        super().__init__(bus.bus)
        self._frames = bus
        self._asking = asking

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """Send a data frame; ``remote`` frames are not sent here."""
        if remote:
            raise ValueError("SDO has no remote frames")
        if self._asking is not None:
            self._asking(can_id, bytes(data))
        self._frames.send(can_id, bytes(data))


class SdoNetwork:
    """SDO clients of the nodes on one bus.

    Parameters
    ----------
    bus : FrameBus or can.BusABC
        Read while a request waits for its answer.
    heard : callable, optional
        Called with each frame that was read.
    asking : callable, optional
        Called with identifier and data of each request before it is sent; what it raises prevents that.
    now : callable, optional
        Clock, s.

    Attributes
    ----------
    meanwhile : callable or None
        Called before each wait for an answer; returns for how long it need not be called again, s.
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
        self._now = now
        self._network: Any = _Network(self._bus, asking)
        self.meanwhile: Callable[[], float] | None = None
        self._channels: dict[int, MatchingSdo] = {}  # a node with several axes has one

    def client(self, node: int, axis: str, where: str) -> SdoClient:
        """Return the SDO client of a node; `axis` and `where` are for its messages."""
        if node not in self._channels:
            self._channels[node] = _channel(node, self._network, self._pump, self._now)
        return SdoClient(self._channels[node], axis, where)

    @contextlib.contextmanager
    def reading(self) -> Iterator[None]:
        """Allow the clients to read the bus; nothing else may read it meanwhile."""
        yield

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
            self._network.notify(frame[0], bytearray(frame[1]), 0.0)
