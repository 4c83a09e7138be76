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
from friction_hil_drivers.canopen import cia301, codes
from friction_hil_drivers.canopen.cia301 import Frame
from friction_hil_drivers.canopen.conversation import PATIENCE_S
from friction_hil_drivers.canopen.dialogue import SEGMENT, Download, OwedAnswers, Transfer, Upload, abort, describe
from friction_hil_drivers.canopen.frames import FrameBus
from friction_hil_drivers.canopen.journal import Journal, hexadecimal
from friction_hil_drivers.cia402.access import ABSENT, HIDDEN, Abort, ObjectReader
from friction_hil_drivers.cia402.objects import Address, Object

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


class SdoClient(ObjectReader):
    """SDO client of one node.

    Parameters
    ----------
    channel : SdoChannel
    axis : str
        Name of the axis, for messages.
    where : str
        Node and bus, for messages.

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

    def __init__(self, channel: SdoChannel, axis: str, where: str) -> None:
        self._channel = channel
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

    def bytes_of(self, entry: Object) -> bytes | None:
        """See `ObjectReader.bytes_of`; an object that the drive refuses to show counts as absent, with a note."""
        entry = entry.of_axis(self.axis_number)
        upload = self._upload(entry)
        if upload.data is None and upload.abort_code not in ABSENT:
            reason = self.refusals[entry.address] = _words(upload)
            if upload.abort_code in HIDDEN:
                self._hidden.add(entry.address)
            absent = "" if upload.abort_code == Abort.WRITE_ONLY else ": taken as absent"
            self._note(f"the drive does not show {entry} ({reason}){absent}")
        return upload.data

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

    def _upload(self, entry: Object) -> Upload:
        upload = Upload(entry)
        self._carry_out(upload, _READ_ATTEMPTS)
        if not upload.is_silent:
            return upload
        if self._has_answered:
            raise self._answer_lost("reading", entry)
        text = (
            f"{self.axis}: no drive answers as {self.where} (reading {entry}): is the drive on, is this "
            "its node number, and is the bit rate right?"
        )
        raise DriveError(text, code=codes.NO_ANSWER)

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
        download = Download(entry, data)
        self._carry_out(download, 1)
        if download.is_silent:
            raise self._answer_lost("writing", entry)
        if not download.is_accepted:
            self.write_refusals[entry.address] = f"refused {hexadecimal(data)} (abort {download.abort_code:08X}h)"
            text = f"{self.axis}: writing {shown or data.hex()} to {entry} of {self.where}: {_words(download)}"
            raise DriveError(text, code=codes.SDO_ABORT)

    def peek(self, entry: Object) -> bytes | None:
        """Return the content of an object, None where the drive does not show it for whatever reason; without a note.

        Raises
        ------
        DriveError
            The drive does not answer.
        """
        return self._upload(entry).data

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
            self._note(f"{text}SDO client); it was dropped")

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)

    def _answer_lost(self, verb: str, entry: Object) -> DriveError:
        text = f"{self.axis}: {self.where} stopped answering ({verb} {entry}; waited {PATIENCE_S:g} s)"
        return DriveError(text, code=codes.ANSWER_LOST)


def _words(transfer: Transfer) -> str:
    """Return why a drive refuses a transfer."""
    return str(canopen.SdoAbortedError(transfer.abort_code))


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
        self._asking = asking
        self._now = now
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
