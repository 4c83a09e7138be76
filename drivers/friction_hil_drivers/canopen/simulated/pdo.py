"""Process data objects of a simulated node: parameters, mapping through SDO, packing (CiA 301)."""

import struct
from collections.abc import Sequence

from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.cia402.access import Abort, AbortError
from friction_hil_drivers.cia402.objects import DataType
from friction_hil_drivers.cia402.simulated.dictionary import Dictionary, Entry
from friction_hil_drivers.cia402.simulated.wire_types import Value, WireType

_MOST_ENTRIES = 64
_EVENT_DRIVEN = (254, 255)
_DUMMIES = range(0x0002, 0x0008)  # data types that may stand for "ignore" in an RPDO
_MS, _INHIBIT_UNIT = 1_000_000, 100_000  # ns


def pdo_numbers(dictionary: Dictionary, parameter: int, mapping: int) -> list[int]:
    """Return the numbers of the PDOs, counted from 0, whose records start at two indices."""
    if not dictionary.is_foreign:
        return list(range(cia301.PDO_COUNT))
    found = {parameter + number for number in range(512)} & dictionary.indices
    return sorted(index - parameter for index in found if index - parameter + mapping in dictionary.indices)


def _is_restricted(can_id: int) -> bool:
    """True if CiA 301 reserves this identifier."""
    return (
        can_id < 0x80
        or 0x101 <= can_id <= 0x180
        or 0x581 <= can_id <= 0x5FF
        or 0x601 <= can_id <= 0x67F
        or can_id >= 0x701
        or 0x6E0 <= can_id <= 0x6FF
    )


class _OddLayout:
    """Layout of a PDO with entries whose widths `struct` does not know."""

    def __init__(self, types: Sequence[WireType]) -> None:
        self._types = types
        self.size = sum(kind.bits for kind in types) // 8

    def pack(self, *values: Value) -> bytes:
        """Return the values one behind the other."""
        return b"".join(kind.pack(value) for kind, value in zip(self._types, values, strict=True))

    def unpack_from(self, data: bytes) -> tuple[Value, ...]:
        """Return the values in the first bytes of a frame."""
        values, start = [], 0
        for kind in self._types:
            end = start + kind.bits // 8
            values.append(kind.unpack(data[start:end]))
            start = end
        return tuple(values)


def _layout(entries: Sequence[Entry]) -> "struct.Struct | _OddLayout":
    types = [entry.type for entry in entries]
    return (
        struct.Struct("<" + "".join(kind.code for kind in types)) if all(t.code for t in types) else _OddLayout(types)
    )


class SimulatedPdo:
    """Base of both directions: one communication record, one mapping record.

    Writes to the records are checked at once and make the PDO stale; they take effect when the node calls `load`.
    """

    _is_receive: bool
    parameter_base: int
    mapping_base: int

    def __init__(self, number: int, dictionary: Dictionary) -> None:
        self._dictionary = dictionary
        parameter, mapping = self.parameter_base + number, self.mapping_base + number
        self._cob_id = dictionary.at_or_hidden(parameter, cia301.PDO_COB_ID, DataType.UNSIGNED32)
        self._type = dictionary.at_or_hidden(parameter, cia301.PDO_TRANSMISSION_TYPE, DataType.UNSIGNED8)
        self._event_timer = dictionary.at_or_hidden(parameter, cia301.PDO_EVENT_TIMER, DataType.UNSIGNED16)
        self._count = dictionary.at_or_hidden(mapping, 0, DataType.UNSIGNED8)
        self._mapped = dictionary.subindices(mapping, 1, _MOST_ENTRIES)
        self._cob_id.on_write = self._write_cob_id
        self._type.on_write = self._write_type
        self._event_timer.on_write = self._note
        self._count.on_write = self._write_count
        for entry in self._mapped:
            entry.on_write = self._write_mapping
        self.load()

    def load(self) -> None:
        """Apply the records as they are now."""
        self.is_stale = False
        self.can_id = self._cob_id.value & 0x7FF
        self.transmission_type = self._type.value
        self.is_synchronous = self.transmission_type <= cia301.LARGEST_SYNCHRONOUS
        self.event_timer_ns = self._event_timer.value * _MS
        try:
            mapping = [entry.value for entry in self._mapped[: self._count.value]]
            self._entries = [self._resolve(word, is_default=True) for word in mapping]
        except AbortError:  # the default mapping names an object that this drive lacks
            self._entries = []
        self._layout = _layout(self._entries)
        self.size = self._layout.size
        is_valid = not self._cob_id.value & cia301.PDO_INVALID and not _is_restricted(self.can_id)
        self.exists = is_valid and bool(self._entries)

    def _note(self, _: int) -> None:
        self.is_stale = True

    def _require_disabled(self) -> None:
        if not self._cob_id.value & cia301.PDO_INVALID:
            raise AbortError(Abort.UNSUPPORTED_ACCESS)

    def _write_cob_id(self, value: int) -> None:
        if not value & cia301.PDO_INVALID:
            if self._cob_id.value & 0x1FFFFFFF != value & 0x1FFFFFFF:
                self._require_disabled()
            if value & 0x3FFFF800 or _is_restricted(value & 0x7FF):
                raise AbortError(Abort.VALUE)
        self.is_stale = True

    def _write_type(self, value: int) -> None:
        if value > cia301.LARGEST_SYNCHRONOUS and value not in _EVENT_DRIVEN:
            raise AbortError(Abort.VALUE)
        self.is_stale = True

    def _write_count(self, value: int) -> None:
        self._require_disabled()
        if value > len(self._mapped):
            raise AbortError(Abort.TOO_HIGH)
        if sum(self._resolve(entry.value).type.bits for entry in self._mapped[:value]) > 64:
            raise AbortError(Abort.PDO_TOO_LONG)
        self.is_stale = True

    def _write_mapping(self, value: int) -> None:
        self._require_disabled()
        if self._count.value != 0:
            raise AbortError(Abort.UNSUPPORTED_ACCESS)
        if value != 0:
            self._resolve(value)

    def _resolve(self, word: int, *, is_default: bool = False) -> Entry:
        """Return the entry that a mapping word names; refuse one that a PDO of this direction cannot carry.

        Files are sloppy about what may be mapped: a mapping that is in force already is not asked for that.
        """
        index, subindex, bits = word >> 16, word >> 8 & 0xFF, word & 0xFF
        if self._is_receive and index in _DUMMIES:
            entry = Entry(index, subindex, "dummy", index)
        else:
            try:
                entry = self._dictionary.find(index, subindex)
            except AbortError as error:
                raise AbortError(Abort.NOT_MAPPABLE) from error
            may_be_mapped = entry.is_writable if self._is_receive else entry.is_readable
            if not (is_default or (entry.is_mappable and may_be_mapped)):
                raise AbortError(Abort.NOT_MAPPABLE)
        if bits == 0 or bits != entry.type.bits:
            raise AbortError(Abort.NOT_MAPPABLE)
        return entry


class Rpdo(SimulatedPdo):
    """Received: writes the entries mapped to it."""

    _is_receive = True
    parameter_base = cia301.RPDO_PARAMETER
    mapping_base = cia301.RPDO_MAPPING

    def load(self) -> None:
        """Apply the records as they are now, and start afresh."""
        super().load()
        self.stop()

    def stop(self) -> None:
        """Drop what was received and stop watching the deadline."""
        self.pending: bytes | None = None  # synchronous: takes effect at the next SYNC
        self.deadline_ns: int | None = None
        self.is_late = False
        self.is_too_short = False

    def write(self, data: bytes) -> None:
        """Write a frame's values. One that its entry refuses is left out: an RPDO has no answer."""
        for entry, value in zip(self._entries, self._layout.unpack_from(data), strict=True):
            try:
                entry.write(value)
            except AbortError:
                continue


class Tpdo(SimulatedPdo):
    """Transmitted: samples the entries mapped to it.

    Event-driven ones are sent when their content has changed or their event timer has expired, but not before the
    inhibit time has passed.
    """

    _is_receive = False
    parameter_base = cia301.TPDO_PARAMETER
    mapping_base = cia301.TPDO_MAPPING

    def __init__(self, number: int, dictionary: Dictionary) -> None:
        parameter = self.parameter_base + number
        self._inhibit = dictionary.at_or_hidden(parameter, cia301.PDO_INHIBIT_TIME, DataType.UNSIGNED16)
        self._inhibit.on_write = self._write_inhibit
        super().__init__(number, dictionary)

    def load(self) -> None:
        """Apply the records as they are now, and start afresh."""
        super().load()
        self._readers = [entry.reader() for entry in self._entries]
        self._inhibit_ns = self._inhibit.value * _INHIBIT_UNIT
        self.start()

    def start(self) -> None:
        """Begin to transmit: counters at zero, nothing sent yet."""
        self._syncs = 0
        self._sent: bytes | None = None
        self._sent_ns = 0

    def sample(self) -> bytes:
        """Return the content at this moment."""
        return self._layout.pack(*[read() for read in self._readers])

    def at_sync(self) -> bytes | None:
        """Return what to send at this SYNC, None for nothing."""
        if self.transmission_type == 0:
            data = self.sample()
            if data == self._sent:
                return None
            self._sent = data
            return data
        self._syncs += 1
        if self._syncs < self.transmission_type:
            return None
        self._syncs = 0
        return self.sample()

    def at_time(self, now_ns: int) -> bytes | None:
        """Return what an event-driven PDO sends at this moment, None for nothing."""
        if self._sent is not None and now_ns - self._sent_ns < self._inhibit_ns:
            return None
        data = self.sample()
        is_due = self.event_timer_ns > 0 and now_ns - self._sent_ns >= self.event_timer_ns
        if data == self._sent and not is_due:
            return None
        self._sent, self._sent_ns = data, now_ns
        return data

    def _write_inhibit(self, value: int) -> None:
        self._require_disabled()
        self.is_stale = True
