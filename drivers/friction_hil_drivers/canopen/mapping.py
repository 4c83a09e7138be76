"""PDOs: which objects they carry, how they are set up in a drive, and how long a cycle of them occupies the bus."""

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from friction_hil.drive import Mode
from friction_hil.errors import DriveError
from friction_hil_drivers.canopen import codes, objects
from friction_hil_drivers.canopen.objects import DataType, Object

if TYPE_CHECKING:
    from friction_hil_drivers.canopen.sdo import SdoClient

SYNCHRONOUS = 1  # transmission type: with every SYNC
_INVALID = objects.PDO_INVALID
_LARGEST = 8  # bytes
_LARGEST_LOAD = 0.9  # of the period; the rest is for SDO, heartbeats and emergencies

FEEDBACK = (
    (objects.STATUSWORD, objects.POSITION_ACTUAL, objects.TORQUE_ACTUAL),
    (objects.VELOCITY_ACTUAL, objects.MODE_DISPLAY),
)
COMMANDS = {
    Mode.CSP: (objects.CONTROLWORD, objects.TARGET_POSITION, objects.TORQUE_OFFSET),
    Mode.CSV: (objects.CONTROLWORD, objects.TARGET_VELOCITY, objects.TORQUE_OFFSET),
    Mode.CST: (objects.CONTROLWORD, objects.TARGET_TORQUE),
}
TARGETS = {
    Mode.CSP: objects.TARGET_POSITION,
    Mode.CSV: objects.TARGET_VELOCITY,
    Mode.CST: objects.TARGET_TORQUE,
}
_FORMATS = {8: "b", 16: "h", 32: "i"}  # of `struct`, for signed integers by their width


@dataclass(frozen=True, slots=True)
class MappedPdo:
    """One PDO in force: its identifier on the bus and the layout of its bytes.

    Attributes
    ----------
    cob_id : int
        Identifier of its frames.
    entries : tuple of Object
        Objects in the order of their bytes. Of a TPDO those that are used; its layout skips the others.
    layout : struct.Struct
    number : int
        Number of the PDO in the drive, from 0.
    is_synchronous : bool
        An RPDO takes effect at the next SYNC; False: at once.
    carried : mapping of Object to bytes
        Constant content of those entries of an RPDO that are not commanded.
    """

    cob_id: int
    entries: tuple[Object, ...]
    layout: struct.Struct
    number: int = 0
    is_synchronous: bool = True
    carried: Mapping[Object, bytes] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class PdoRecord:
    """Objects that configure one PDO of a drive; ``number`` counts from 0, separately for each direction."""

    is_receive: bool
    number: int
    node: int

    @property
    def name(self) -> str:
        """Name in messages: ``RPDO 1``."""
        return f"{'RPDO' if self.is_receive else 'TPDO'} {self.number + 1}"

    @property
    def identifier(self) -> int:
        """Identifier of the PDO's frames, from the pre-defined connection set."""
        bases = objects.RPDO_BASES if self.is_receive else objects.TPDO_BASES
        return bases[self.number] + self.node

    def parameter(self, subindex: int, name: str, kind: DataType) -> Object:
        """Return an object of the communication record (1400h, 1800h)."""
        base = objects.RPDO_PARAMETER if self.is_receive else objects.TPDO_PARAMETER
        return Object(base + self.number, f"{name} of {self.name}", kind, subindex)

    def mapping(self, position: int) -> Object:
        """Return an object of the mapping record (1600h, 1A00h); position 0 is the number of mapped objects."""
        index = (objects.RPDO_MAPPING if self.is_receive else objects.TPDO_MAPPING) + self.number
        if position == 0:
            return Object(index, f"number of objects in {self.name}", DataType.UNSIGNED8, 0)
        return Object(index, f"object {position} of {self.name}", DataType.UNSIGNED32, position)

    @property
    def cob_id(self) -> Object:
        """Entry with the identifier, and the bit that switches the PDO off."""
        return self.parameter(objects.PDO_COB_ID, "COB-ID", DataType.UNSIGNED32)

    @property
    def event_timer(self) -> Object:
        """Entry with the event timer; of an RPDO, the time after which its absence is an error."""
        return self.parameter(objects.PDO_EVENT_TIMER, "event timer", DataType.UNSIGNED16)


def pdo_layout(entries: Sequence[Object], widths: Sequence[int]) -> struct.Struct:
    """Return the layout of a PDO that carries ``entries``, with their widths in bits on this drive."""
    formats = [
        _FORMATS[bits] if entry.type.is_signed else _FORMATS[bits].upper()
        for entry, bits in zip(entries, widths, strict=True)
    ]
    return struct.Struct("<" + "".join(formats))


def map_pdo(access: "SdoClient", record: PdoRecord, entries: Sequence[Object], event_ms: int = 0) -> MappedPdo:
    """Set up a PDO of a drive and check that the drive keeps the mapping.

    The widths are those that the drive itself gives its objects: a PDO mapped with another width is accepted
    by many drives and shifts every later field.

    Raises
    ------
    DriveError
        The drive lacks an object, or keeps another mapping than was written.
    """
    widths = _widths(access, record, entries)
    layout = pdo_layout(entries, widths)
    if layout.size > _LARGEST:
        listed = ", ".join(map(str, entries))
        text = f"{access.axis}: {listed} need {layout.size} bytes on this drive; {record.name} carries {_LARGEST}"
        raise DriveError(text, code=codes.OBJECT_SIZE)
    words = [entry.index << 16 | entry.subindex << 8 | bits for entry, bits in zip(entries, widths, strict=True)]
    _write_mapping(access, record, words, event_ms)
    _check_mapping(access, record, words)
    return MappedPdo(record.identifier, tuple(entries), layout)


def _widths(access: "SdoClient", record: PdoRecord, entries: Sequence[Object]) -> list[int]:
    widths = []
    for entry in entries:
        bits = access.width(entry)
        if bits is None:
            text = f"{access.axis}: {access.where} lacks object {entry}, which belongs into {record.name}"
            raise DriveError(text, code=codes.OBJECT_MISSING)
        widths.append(bits)
    return widths


def _write_mapping(access: "SdoClient", record: PdoRecord, words: Sequence[int], event_ms: int) -> None:
    """Write a mapping in the order that CiA 301 prescribes: PDO off, count 0, entries, count, PDO on."""
    access.write(record.cob_id, _INVALID | record.identifier)
    access.write(record.mapping(0), 0)
    for position, word in enumerate(words, 1):
        access.write(record.mapping(position), word)
    access.write(record.mapping(0), len(words))
    kind = record.parameter(objects.PDO_TRANSMISSION_TYPE, "transmission type", DataType.UNSIGNED8)
    access.write(kind, SYNCHRONOUS)
    if event_ms:
        access.try_write(record.event_timer, event_ms)
    access.write(record.cob_id, record.identifier)


def _check_mapping(access: "SdoClient", record: PdoRecord, words: Sequence[int]) -> None:
    for position, word in enumerate(words, 1):
        kept = access.read(record.mapping(position))
        if kept != word:
            text = (
                f"{access.axis}: {record.name} of {access.where} holds {kept:08X}h at position {position} "
                f"after {word:08X}h was written"
            )
            raise DriveError(text, code=codes.MAPPING_NOT_KEPT)


def switch_off(access: "SdoClient", record: PdoRecord) -> None:
    """Switch off a PDO that is not used, where the drive has it."""
    before = access.find(record.cob_id)
    if before is not None and not before & _INVALID:
        access.write(record.cob_id, _INVALID | record.identifier)


def frame_bits(size: int) -> int:
    """Return the bits of a CAN frame with an 11-bit identifier and ``size`` data bytes, with worst-case stuffing.

    Source: K. Tindell, A. Burns, A. Wellings, Control Engineering Practice 3(8), 1995; with the interframe
    space of 3 bits.
    """
    stuffed = 34 + 8 * size
    return stuffed + (stuffed - 1) // 4 + 13


def wire_time_s(bitrate: int, pdos: Sequence[MappedPdo]) -> float:
    """Return the time for which SYNC and ``pdos`` of one cycle occupy the bus, s."""
    return (frame_bits(0) + sum(frame_bits(pdo.layout.size) for pdo in pdos)) / bitrate


def check_bus_load(bitrate: int, period_s: float, pdos: Sequence[MappedPdo]) -> str:
    """Return the load of the bus in words, if a cycle fits with room for SDO, heartbeats and emergencies.

    Raises
    ------
    DriveError
        It does not; the message has the calculation.
    """
    needed = wire_time_s(bitrate, pdos)
    if needed > _LARGEST_LOAD * period_s:
        sizes = " + ".join(f"{frame_bits(pdo.layout.size)}" for pdo in pdos)
        text = (
            f"a cycle needs {needed * 1e6:.0f} us on the bus at {bitrate} bit/s (SYNC {frame_bits(0)} + PDOs {sizes} "
            f"bits with worst-case stuffing), more than {100 * _LARGEST_LOAD:.0f} % of the period of "
            f"{period_s * 1e6:.0f} us"
        )
        raise DriveError(text, "take a longer period_s, a higher bit rate, or fewer axes", code=codes.BUS_OVERLOAD)
    return f"a cycle needs {needed * 1e6:.0f} us of {period_s * 1e6:.0f} us on the bus at {bitrate} bit/s"


def expected_pdos(mode: Mode) -> list[MappedPdo]:
    """Return the PDOs of a drive whose objects have the standard's widths, to compute the load before connecting."""
    return [
        MappedPdo(0, entries, pdo_layout(entries, [entry.type.bits for entry in entries]))
        for entries in (*FEEDBACK, COMMANDS[mode])
    ]
