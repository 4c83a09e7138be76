"""Object dictionary of a simulated node: values, access rights, limits and abort codes."""

import struct
from collections.abc import Callable, Iterable, Iterator
from enum import IntEnum
from pathlib import Path
from typing import Any

from canopen.objectdictionary import ODVariable

from friction_hil.errors import UsageError
from friction_hil_drivers.canopen.eds import SIMULATED_SERVO, load_eds
from friction_hil_drivers.canopen.objects import DataType, Object

Value = int | bytes
_FIRST_OBJECT = 0x1000
_TYPES = frozenset(DataType)


class Abort(IntEnum):
    """SDO abort codes (CiA 301)."""

    TOGGLE = 0x05030000
    COMMAND = 0x05040001
    OUT_OF_MEMORY = 0x05040005
    UNSUPPORTED_ACCESS = 0x06010000
    WRITE_ONLY = 0x06010001
    READ_ONLY = 0x06010002
    NO_OBJECT = 0x06020000
    NOT_MAPPABLE = 0x06040041
    PDO_TOO_LONG = 0x06040042
    INCOMPATIBLE = 0x06040043
    LENGTH = 0x06070010
    NO_SUBINDEX = 0x06090011
    VALUE = 0x06090030
    TOO_HIGH = 0x06090031
    TOO_LOW = 0x06090032
    NO_DATA = 0x08000024


class SdoAbortError(Exception):
    """Refusal of a transfer, with its abort code."""

    def __init__(self, code: Abort) -> None:
        super().__init__(f"{code:08X}h {code.name}")
        self.code = code


class Entry:
    """One variable: an integer, or the bytes of a string or domain.

    ``on_read`` supplies the value of an entry that mirrors something live. ``on_write`` is called with the new
    value before it is stored, and may refuse it with `SdoAbortError`.
    """

    __slots__ = (
        "access",
        "default",
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
        self.type = DataType(kind) if kind in _TYPES else DataType.VISIBLE_STRING
        self.access = access
        self.is_mappable = is_mappable
        self.minimum, self.maximum = self.type.bounds if self.type.bits else (0, 0)
        self.default: Value = 0 if self.type.bits else b""
        self.value: Any = self.default  # int or bytes
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

    def reader(self) -> Callable[[], Value]:
        """Return a function that does what `read` does, for frequent reading."""
        return (lambda: self.value) if self.on_read is None else self.on_read

    def write(self, value: int) -> None:
        """Store a new integer value, or raise `SdoAbortError`."""
        if value > self.maximum:
            raise SdoAbortError(Abort.TOO_HIGH)
        if value < self.minimum:
            raise SdoAbortError(Abort.TOO_LOW)
        if self.on_write is not None:
            self.on_write(value)
        self.value = value

    def upload(self) -> bytes:
        """Return the current value as on the wire, or raise `SdoAbortError`."""
        if not self.is_readable:
            raise SdoAbortError(Abort.WRITE_ONLY)
        value = self.read()
        data = value if isinstance(value, bytes) else struct.pack(f"<{self.type.code}", value)
        if not data:
            raise SdoAbortError(Abort.NO_DATA)
        return data

    def download(self, data: bytes) -> None:
        """Store a value as on the wire, or raise `SdoAbortError`."""
        if not self.is_writable:
            raise SdoAbortError(Abort.READ_ONLY)
        if not self.type.bits:
            self.value = bytes(data)
        elif len(data) * 8 != self.type.bits:
            raise SdoAbortError(Abort.LENGTH)
        else:
            self.write(struct.unpack(f"<{self.type.code}", data)[0])


class Dictionary:
    """Entries by index and sub-index.

    Parameters
    ----------
    entries : iterable of Entry
        Every entry that the device uses.
    hidden : iterable of (index, sub-index)
        Entries that SDO and PDO do not find; the device uses their defaults.
    """

    def __init__(self, entries: Iterable[Entry], hidden: Iterable[tuple[int, int]] = ()) -> None:
        self._entries = {(entry.index, entry.subindex): entry for entry in entries}
        self._visible = {address: self._entries[address] for address in self._entries.keys() - set(hidden)}
        self._indices = {index for index, _ in self._visible}

    @classmethod
    def from_eds(cls, path: Path, node: int, missing: Iterable[int] = ()) -> "Dictionary":
        """Build the dictionary that an EDS describes, at its defaults.

        Parameters
        ----------
        path : Path
            EDS of the entries that SDO and PDO find. Others that the device uses come from the EDS of this package.
        node : int
            For the entries that depend on the node's number.
        missing : iterable of int
            Indices in the EDS that SDO and PDO do not find.

        Raises
        ------
        UsageError
            The file is not an EDS, or a default does not fit its type.
        """
        own = {(entry.index, entry.subindex): entry for entry in _entries(SIMULATED_SERVO, node)}
        shown = own if path == SIMULATED_SERVO else {(e.index, e.subindex): e for e in _entries(path, node)}
        lacking = frozenset(missing)
        hidden = {address for address in own | shown if address not in shown or address[0] in lacking}
        return cls((own | shown).values(), hidden)

    def find(self, index: int, subindex: int) -> Entry:
        """Return an entry as SDO and PDO find it, or raise `SdoAbortError`."""
        entry = self._visible.get((index, subindex))
        if entry is None:
            raise SdoAbortError(Abort.NO_SUBINDEX if index in self._indices else Abort.NO_OBJECT)
        return entry

    def shows(self, known: Object) -> bool:
        """Return True if SDO and PDO find an object."""
        return known.address in self._visible

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
        low, high = entry.type.bounds
        entry.default = entry.value = min(max(value, low), high)

    def preset(self, index: int, subindex: int, value: int) -> None:
        """Set the default of any entry.

        Raises
        ------
        UsageError
            There is no such entry of integers, or the value does not fit its type.
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


def _entries(path: Path, node: int) -> Iterator[Entry]:
    for item in load_eds(path, node).values():
        if item.index < _FIRST_OBJECT:
            continue  # data types, listed for dummy mapping
        variables = [item] if isinstance(item, ODVariable) else [item[subindex] for subindex in item]
        yield from (_entry(variable, path) for variable in variables)


def _entry(variable: ODVariable, path: Path) -> Entry:
    kind = variable.data_type or DataType.VISIBLE_STRING
    entry = Entry(
        variable.index,
        variable.subindex,
        variable.name,
        kind,
        variable.access_type,
        is_mappable=variable.pdo_mappable,
    )
    value: Any = variable.default if variable.value is None else variable.value
    if not entry.type.bits:
        entry.default = entry.value = value.encode() if isinstance(value, str) else bytes(value or b"")
        return entry
    if variable.min is not None:
        entry.minimum = max(entry.minimum, variable.min)
    if variable.max is not None:
        entry.maximum = min(entry.maximum, variable.max)
    number = 0 if value is None else int(value)
    low, high = entry.type.bounds
    if entry.type.bits and low < 0 and number > high:
        number -= 1 << entry.type.bits  # hexadecimal defaults of signed entries
    if not low <= number <= high:
        raise UsageError(
            f"{path}: the default {number} of {entry.index:04X}h:{entry.subindex:02X} does not fit its type"
        )
    entry.default = entry.value = number
    return entry
