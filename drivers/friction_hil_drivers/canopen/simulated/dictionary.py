"""Object dictionary of a simulated node: values, access rights, limits and abort codes."""

import copy
import functools
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from canopen.objectdictionary import ODArray, ODVariable

from friction_hil.errors import UsageError
from friction_hil_drivers.canopen import cia301
from friction_hil_drivers.canopen.eds import SIMULATED_SERVO, compact_arrays, load_eds
from friction_hil_drivers.canopen.simulated.wire_types import Value, wire_type
from friction_hil_drivers.cia402 import objects
from friction_hil_drivers.cia402.access import Abort
from friction_hil_drivers.cia402.objects import DataType, Object

_FIRST_OBJECT = 0x1000
_MOST_MS = 0xFFFF  # the lower half of a consumer entry
_UNICODE_STRING, _DOMAIN = 0x0B, 0x0F


class SdoAbortError(Exception):
    """Refusal of a transfer, with its abort code."""

    def __init__(self, code: Abort) -> None:
        super().__init__(f"{code:08X}h {code.name}")
        self.code = code


class Entry:
    """One variable: a number, or the bytes of a string, a domain or an unknown type.

    ``on_read`` supplies the value of an entry that mirrors something live. ``on_write`` is called with the new
    value before it is stored, and may refuse it with `SdoAbortError`.
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
        """Store a new number, or raise `SdoAbortError`."""
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
        data = self.type.pack(value)
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
            self.write(self.type.unpack(data))


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
        self.is_foreign = False
        self.notes: list[str] = []

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
            The file is not an EDS.
        """
        own = {(entry.index, entry.subindex): copy.copy(entry) for entry in _own_entries(node)}
        lacking = frozenset(missing)
        if path == SIMULATED_SERVO:
            return cls(own.values(), {address for address in own if address[0] in lacking})
        shown = {(entry.index, entry.subindex): entry for entry in _entries(path, node)}
        notes = [note for entry in shown.values() if (note := _doubt(entry))]
        hidden = {address for address in own | shown if address not in shown or address[0] in lacking}
        dictionary = cls((own | shown).values(), hidden)
        dictionary.is_foreign, dictionary.notes = True, notes
        dictionary._keep_apart(own, shown)
        dictionary._fill_in(own, node)
        return dictionary

    def _keep_apart(self, own: Mapping[tuple[int, int], Entry], shown: Mapping[tuple[int, int], Entry]) -> None:
        """Let the device work with its own entries where the file gives them a type that is no integer."""
        for address in own.keys() & shown.keys():
            if _is_integer(own[address]) and not _is_integer(shown[address]):
                self._entries[address] = own[address]
                self.notes.append(f"{address[0]:04X}h:{address[1]:02X} is no integer in the file: it stays as it is")

    def _fill_in(self, own: Mapping[tuple[int, int], Entry], node: int) -> None:
        """Give values to the objects that the file leaves empty and without which no node works (CiA 301)."""
        for known in (cia301.SYNC_COB_ID, cia301.EMERGENCY_COB_ID):
            if not self.of(known).value & 0x7FF:
                self.set_default(known, own[known.address].value)
        for parameter, mapping, bases in (
            (cia301.RPDO_PARAMETER, cia301.RPDO_MAPPING, cia301.RPDO_BASES),
            (cia301.TPDO_PARAMETER, cia301.TPDO_MAPPING, cia301.TPDO_BASES),
        ):
            for number in self.numbers(parameter, mapping, 0):
                entry = self.at_or_hidden(parameter + number, cia301.PDO_COB_ID, DataType.UNSIGNED32)
                if not entry.value & 0x7FF:
                    predefined = bases[number] + node if number < len(bases) else 0
                    entry.default = entry.value = (entry.value | predefined) or cia301.PDO_INVALID
        self.set_default(objects.CONTROLWORD, 0)
        if not self.of(objects.INTERPOLATION_PERIOD).value:
            for known in (objects.INTERPOLATION_PERIOD, objects.INTERPOLATION_EXPONENT):
                self.set_default(known, own[known.address].value)
        if not self.of(objects.MAX_MOTOR_SPEED).value:
            self.set_default(objects.MAX_MOTOR_SPEED, own[objects.MAX_MOTOR_SPEED.address].value)

    def find(self, index: int, subindex: int) -> Entry:
        """Return an entry as SDO and PDO find it, or raise `SdoAbortError`."""
        entry = self._visible.get((index, subindex))
        if entry is None:
            raise SdoAbortError(Abort.NO_SUBINDEX if index in self._indices else Abort.NO_OBJECT)
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
        source = self._visible if index in self._indices else self._entries
        found = [source[index, subindex] for subindex in range(first, last + 1) if (index, subindex) in source]
        return [entry for entry in found if _is_integer(entry)]

    def numbers(self, parameter: int, mapping: int, count: int) -> list[int]:
        """Return the numbers of the PDOs, counted from 0, whose records start at two indices."""
        if not self.is_foreign:
            return list(range(count))
        found = {parameter + number for number in range(512)} & self._indices
        return sorted(index - parameter for index in found if index - parameter + mapping in self._indices)

    def at_or_hidden(self, index: int, subindex: int, kind: DataType) -> Entry:
        """Return an entry that the device uses; where there is none, one that SDO and PDO do not find."""
        entry = self._entries.get((index, subindex))
        if entry is None or not _is_integer(entry):
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


@functools.cache
def _own_entries(node: int) -> tuple[Entry, ...]:
    """Return what the EDS of this package describes, to be copied: it takes longer to read than a drive to start."""
    return tuple(_entries(SIMULATED_SERVO, node))


def _entries(path: Path, node: int) -> Iterator[Entry]:
    dictionary = load_eds(path, node)
    compact = compact_arrays(path)
    for item in dictionary.values():
        if item.index < _FIRST_OBJECT:
            continue  # data types, listed for dummy mapping
        if isinstance(item, ODVariable):
            yield _entry(item)
        elif isinstance(item, ODArray) and item.index in compact:  # the entries of a record differ
            count = compact[item.index]
            item[0].default, item[0].access_type = count, "ro"
            yield from (_entry(item[subindex]) for subindex in range(count + 1))
        else:
            yield from (_entry(item[subindex]) for subindex in item)


def _entry(variable: ODVariable) -> Entry:
    entry = Entry(
        variable.index,
        variable.subindex,
        variable.name,
        _DOMAIN if variable.data_type is None else variable.data_type,
        variable.access_type,
        is_mappable=variable.pdo_mappable,
    )
    value: Any = variable.default if variable.value is None else variable.value
    entry.has_default = value is not None
    if not entry.type.bits:
        if isinstance(value, str):
            value = value.encode("utf-16-le" if variable.data_type == _UNICODE_STRING else "utf-8")
        entry.default = entry.value = entry.type.fit(b"" if value is None else value)
        return entry
    low, high = entry.type.bounds
    least = low if variable.min is None else max(low, variable.min)
    most = high if variable.max is None else min(high, variable.max)
    if least < most:  # equal, or the wrong way round, where an editor filled them in
        entry.minimum, entry.maximum = least, most
    entry.default = entry.value = 0 if value is None else value
    return entry


def _is_integer(entry: Entry) -> bool:
    return entry.type.bits > 0 and not entry.type.is_real


def _doubt(entry: Entry) -> str:
    """Cut a default that does not fit its type; return what to say about it, empty for nothing."""
    if entry.index == cia301.CONSUMER_HEARTBEAT.index and entry.subindex > 0 and entry.maximum <= _MOST_MS:
        return (
            f"{entry.index:04X}h:{entry.subindex:02X}: HighLimit={entry.maximum} leaves no room for a node "
            "(node << 16 | ms): no heartbeat can be watched"
        )
    value, fitting = entry.default, entry.type.fit(entry.default)
    entry.default = entry.value = fitting
    if entry.type.is_signed and isinstance(value, int) and value - (1 << entry.type.bits) == fitting:
        return ""  # hexadecimal
    if value == fitting or entry.type.is_real:
        return ""
    return f"{entry.index:04X}h:{entry.subindex:02X}: the default {value!r} does not fit its type; {fitting!r} is used"
