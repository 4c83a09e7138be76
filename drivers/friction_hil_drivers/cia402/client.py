"""Objects of a drive, read and written while it is being configured, over whatever bus."""

import contextlib
from abc import abstractmethod

from friction_hil.errors import DriveError
from friction_hil_drivers.cia402 import codes
from friction_hil_drivers.cia402.access import (
    ABSENT,
    HIDDEN,
    Abort,
    AbortError,
    ObjectReader,
    RefusedError,
    hexadecimal,
)
from friction_hil_drivers.cia402.journal import Journal
from friction_hil_drivers.cia402.objects import Address, Object


class ObjectClient(ObjectReader):
    """Reads and writes the objects of one drive; a bus has `read_object` and `write_object`.

    ``axis`` and ``where``, which is node and bus, are for messages.
    """

    def __init__(self, axis: str, where: str) -> None:
        self.axis = axis
        self.where = where
        self.axis_number = 0  # in a node with several: objects of the profile are those of this axis
        self.notes: list[str] = []  # objects that the drive refuses to show, and what the bus has to tell
        self.refusals: dict[Address, str] = {}  # why an object is not shown, unless the drive says that it has none
        self.write_refusals: dict[Address, str] = {}  # why an object does not hold what was written last
        self._hidden: set[Address] = set()
        self.journal: Journal | None = None  # keeps what the drive holds before it is written to
        self.is_read_only = False  # True: every write is refused, as if by the drive, and nothing is sent

    @abstractmethod
    def read_object(self, entry: Object) -> bytes:
        """Return the content of an object as on the wire; raises an `AbortError` if the drive refuses."""

    @abstractmethod
    def write_object(self, entry: Object, data: bytes) -> None:
        """Write the content of an object; raises as `read_object`."""

    def bytes_of(self, entry: Object) -> bytes | None:
        """See `ObjectReader.bytes_of`; an object that the drive refuses to show counts as absent, with a note."""
        entry = entry.of_axis(self.axis_number)
        try:
            return self.read_object(entry)
        except AbortError as error:
            if error.code not in ABSENT:
                reason = self.refusals[entry.address] = str(error)
                if error.code in HIDDEN:
                    self._hidden.add(entry.address)
                absent = "" if error.code == Abort.WRITE_ONLY else ": taken as absent"
                self.note(f"the drive does not show {entry} ({reason}){absent}")
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

    def write(self, entry: Object, value: int, bits: int | None = None) -> None:
        """Write an integer object, with the width of its type or ``bits``; raises a `RefusedError` with the value."""
        low, high = entry.type.bounds
        if not low <= value <= high:
            text = f"{self.axis}: {value} does not fit into {entry} ({low} to {high})"
            raise DriveError(text, code=codes.OBJECT_SIZE)
        self.write_bytes(entry, value.to_bytes((bits or entry.type.bits) // 8, "little", signed=value < 0), str(value))

    def ensure(self, entry: Object, value: int, bits: int | None = None) -> None:
        """Write an integer object as `write` does; a refusal is no obstacle where the drive holds the value already."""
        try:
            self.write(entry, value, bits)
        except RefusedError:
            if self.find(entry) != value:
                raise

    def write_bytes(self, entry: Object, data: bytes, shown: str = "") -> None:
        """Write the content of an object; ``shown`` is its value in messages, as that of a `RefusedError`."""
        entry = entry.of_axis(self.axis_number)
        if self.is_read_only:
            raise RefusedError(f"{self.axis}: {entry} of {self.where} is not written: another master moves the drive")
        if self.journal is not None:
            self.journal.before(entry, data)
        self.download(entry, data, shown)
        if self.journal is not None:
            self.journal.after(entry)

    def download(self, entry: Object, data: bytes, shown: str = "") -> None:
        """Write the content of an object without keeping what it held before; see `write_bytes`."""
        try:
            self.write_object(entry, data)
        except AbortError as error:
            self.write_refusals[entry.address] = f"refused {hexadecimal(data)} (abort {error.code:08X}h)"
            text = f"{self.axis}: writing {shown or data.hex()} to {entry} of {self.where}: {error}"
            raise RefusedError(text) from error

    def peek(self, entry: Object) -> bytes | None:
        """Return the content of an object, None where the drive does not show it at all; without a note."""
        try:
            return self.read_object(entry)
        except AbortError:
            return None

    def try_write(self, entry: Object, value: int) -> bool:
        """Write an object that the drive may lack or refuse; return True if it then holds the value.

        One that the drive does not show is left alone: it could be neither read back nor restored.
        """
        address = entry.of_axis(self.axis_number).address
        if self.find(entry) is None and address in self.refusals:
            self.write_refusals[address] = f"cannot be read ({self.refusals[address]}) and is left as it is"
            return False
        with contextlib.suppress(RefusedError):
            self.write(entry, value)
        found = self.find(entry)
        if found not in (None, value):
            self.write_refusals.setdefault(address, f"holds {found:#x} after {value:#x} was written")
        return found == value

    def note(self, text: str) -> None:
        """Keep a note for the user, once."""
        if text not in self.notes:
            self.notes.append(text)
