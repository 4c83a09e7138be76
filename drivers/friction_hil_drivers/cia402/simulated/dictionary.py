"""Object dictionary of a simulated drive: values, access rights, limits and abort codes."""

from collections.abc import Callable, Iterable
from typing import Any

from friction_hil.errors import UsageError
from friction_hil_drivers.cia402.access import Abort, AbortError
from friction_hil_drivers.cia402.objects import Address, DataType, Object
from friction_hil_drivers.cia402.simulated.wire_types import Value, wire_type


class Entry:
    """One variable: a number, or the bytes of a string, a domain or an unknown type.

    ``on_read`` supplies the value of an entry that mirrors something live. ``on_write`` is called with the new
    value before it is stored, and may refuse it with `AbortError`.
    """

    __slots__ = (
        "access",
        "default",
        "has_default",
        "index",
        "is_mappable",
        "maximum",
        "minimum",
        "name",
        "on_read",
        "on_write",
        "subindex",
        "type",
        "value",
    )

    def __init__(
        self, index: int, subindex: int, name: str, kind: int, access: str = "rw", *, is_mappable: bool = False
    ) -> None:
        self.index, self.subindex, self.name = index, subindex, name
        self.type = wire_type(kind)
        self.access = access
        self.is_mappable = is_mappable
        self.minimum: float
        self.maximum: float
        self.minimum, self.maximum = self.type.bounds if self.type.bits else (0, 0)
        self.default: Value = 0 if self.type.bits else b""
        self.has_default = False  # a file gives one
        self.value: Any = self.default  # of type Value
        self.on_read: Callable[[], Value] | None = None
        self.on_write: Callable[[int], None] | None = None

    @property
    def is_readable(self) -> bool:
        """True if SDO may upload it, and a TPDO carry it."""
        return "r" in self.access or self.access == "const"

    @property
    def is_writable(self) -> bool:
        """True if SDO may download it, and an RPDO carry it."""
        return "w" in self.access

    def read(self) -> Value:
        """Return the current value."""
        return self.value if self.on_read is None else self.on_read()

    def connect(self, read: Callable[[], int], known: Object) -> None:
        """Make the entry mirror something live, that has the type of ``known`` where the drive uses another."""
        is_usual = self.type == wire_type(known.type)
        self.on_read = read if is_usual else lambda: self.type.fit(read())

    def reader(self) -> Callable[[], Value]:
        """Return a function that does what `read` does, for frequent reading."""
        return (lambda: self.value) if self.on_read is None else self.on_read

    def write(self, value: Any) -> None:
        """Store a new number, or raise `AbortError`."""
        if value > self.maximum:
            raise AbortError(Abort.TOO_HIGH)
        if value < self.minimum:
            raise AbortError(Abort.TOO_LOW)
        if self.on_write is not None:
            self.on_write(value)
        self.value = value

    def upload(self) -> bytes:
        """Return the current value as on the wire, or raise `AbortError`."""
        if not self.is_readable:
            raise AbortError(Abort.WRITE_ONLY)
        value = self.read()
        data = self.type.pack(value)
        if not data:
            raise AbortError(Abort.NO_DATA)
        return data

    def download(self, data: bytes) -> None:
        """Store a value as on the wire, or raise `AbortError`."""
        if not self.is_writable:
            raise AbortError(Abort.READ_ONLY)
        if not self.type.bits:
            self.value = bytes(data)
        elif len(data) * 8 != self.type.bits:
            raise AbortError(Abort.LENGTH)
        else:
            self.write(self.type.unpack(data))


class Dictionary:
    """Entries by index and sub-index.

    ``entries``: every entry that the device uses. ``hidden``: entries that SDO and PDO do not find; the device uses
    their defaults. ``shown``: entries that SDO and PDO find in the place of those that the device uses. ``is_foreign``:
    it follows a vendor's file.
    """

    def __init__(
        self,
        entries: Iterable[Entry],
        hidden: Iterable[Address] = (),
        shown: Iterable[Entry] = (),
        *,
        is_foreign: bool = False,
    ) -> None:
        self._entries = {(entry.index, entry.subindex): entry for entry in entries}
        found = self._entries | {(entry.index, entry.subindex): entry for entry in shown}
        self._visible = {address: found[address] for address in found.keys() - set(hidden)}
        self.indices = {index for index, _ in self._visible}
        self.is_foreign = is_foreign
        self.notes: list[str] = []

    def find(self, index: int, subindex: int) -> Entry:
        """Return an entry as SDO and PDO find it, or raise `AbortError`."""
        entry = self._visible.get((index, subindex))
        if entry is None:
            raise AbortError(Abort.NO_SUBINDEX if index in self.indices else Abort.NO_OBJECT)
        return entry

    def shows(self, known: Object) -> bool:
        """Return True if SDO and PDO find an object."""
        return known.address in self._visible

    def given(self, known: Object) -> int:
        """Return the value that a vendor's file gives an object; 0 if it gives none, or is the package's own."""
        entry = self._visible.get(known.address)
        value = entry.default if entry is not None and entry.has_default and self.is_foreign else 0
        return round(value) if isinstance(value, int | float) else 0

    def subindices(self, index: int, first: int, last: int) -> list[Entry]:
        """Return the integer entries of an index that SDO finds, or that the device uses if SDO finds none."""
        source = self._visible if index in self.indices else self._entries
        found = [source[index, subindex] for subindex in range(first, last + 1) if (index, subindex) in source]
        return [entry for entry in found if is_integer(entry)]

    def at_or_hidden(self, index: int, subindex: int, kind: DataType) -> Entry:
        """Return an entry that the device uses; where there is none, one that SDO and PDO do not find."""
        entry = self._entries.get((index, subindex))
        if entry is None or not is_integer(entry):
            entry = self._entries[index, subindex] = Entry(index, subindex, "not in the file", kind)
        return entry

    def of(self, known: Object) -> Entry:
        """Return an entry that the device itself uses, visible or not."""
        return self._entries[known.address]

    def entries(self, *known: Object) -> list[Entry]:
        """Return several entries that the device itself uses, visible or not."""
        return [self.of(one) for one in known]

    def at(self, index: int, subindex: int) -> Entry:
        """Return an entry that the device itself uses, visible or not."""
        return self._entries[index, subindex]

    def set_default(self, known: Object, value: int) -> None:
        """Set the default of an entry, limited to the range of its type."""
        entry = self.of(known)
        if entry.type.bits == 0:
            entry.default = entry.value = entry.type.fit(value)
            return
        low, high = entry.type.bounds
        entry.default = entry.value = min(max(value, low), high)

    def preset(self, index: int, subindex: int, value: int) -> None:
        """Set the default of any entry.

        Raises `UsageError`: there is no such entry of integers, or the value does not fit its type.
        """
        entry = self.check(index, subindex, value)
        entry.default = entry.value = value

    def change(self, index: int, subindex: int, value: int) -> None:
        """Change any entry as the device itself does, without asking its access rights; raises as `preset`."""
        self.check(index, subindex, value).value = value

    def check(self, index: int, subindex: int, value: int) -> Entry:
        """Return the entry if it exists and holds such a value; raises as `preset`."""
        entry = self._entries.get((index, subindex))
        where = f"simulation.canopen: {index:04X}h:{subindex:02X}"
        if entry is None or not entry.type.bits:
            raise UsageError(f"{where} is no integer object of the simulated drive")
        low, high = entry.type.bounds
        if not low <= value <= high:
            raise UsageError(f"{where} holds {low} to {high}, not {value}")
        return entry

    def reset(self, first: int, last: int) -> None:
        """Return the entries of the indices ``first`` to ``last`` to their defaults, without calling ``on_write``."""
        for entry in self._entries.values():
            if first <= entry.index <= last:
                entry.value = entry.default


def is_integer(entry: Entry) -> bool:
    """Return True for an entry that holds integers."""
    return entry.type.bits > 0 and not entry.type.is_real
