"""Which objects travel in which PDO, how they are packed, and what that costs on the wire."""

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from friction_hil.drive import Mode
from friction_hil.errors import DriveError
from friction_hil_drivers.canopen import objects
from friction_hil_drivers.canopen.objects import DataType, Object
from friction_hil_drivers.canopen.sdo import ObjectAccess, integer_format

SYNCHRONOUS = 1  # transmission type: with every SYNC
_INVALID = objects.PDO_INVALID

FEEDBACK = (
    (objects.STATUSWORD, objects.POSITION_ACTUAL, objects.TORQUE_ACTUAL),
    (objects.VELOCITY_ACTUAL, objects.MODE_DISPLAY),
)
COMMANDS = {
    Mode.CSP: (objects.CONTROLWORD, objects.TARGET_POSITION, objects.TORQUE_OFFSET),
    Mode.CSV: (objects.CONTROLWORD, objects.TARGET_VELOCITY, objects.TORQUE_OFFSET),
    Mode.CST: (objects.CONTROLWORD, objects.TARGET_TORQUE),
}


@dataclass(frozen=True, slots=True)
class MappedPdo:
    """One PDO in force: its identifier on the bus and the layout of its bytes."""

    cob_id: int
    entries: tuple[Object, ...]
    layout: struct.Struct


def pdo_layout(entries: Sequence[Object], widths: Sequence[int]) -> struct.Struct:
    """Layout of the bytes of a PDO that carries ``entries``, with their widths in bits on this drive."""
    signed = (DataType.INTEGER8, DataType.INTEGER16, DataType.INTEGER32)
    formats = [integer_format(bits, entry.type in signed) for entry, bits in zip(entries, widths, strict=True)]
    return struct.Struct("<" + "".join(formats))


def map_pdo(
    access: ObjectAccess,
    *,
    is_receive: bool,
    number: int,
    node: int,
    entries: Sequence[Object],
    event_ms: int = 0,
) -> MappedPdo:
    """Set up PDO ``number`` (from 0) of a drive and read back what it made of it.

    The widths are those that the drive itself gives its objects: a PDO mapped with another width is accepted
    by many drives and shifts every later field.

    Raises
    ------
    DriveError
        The drive lacks an object, or keeps another mapping than was written.
    """
    parameter = (objects.RPDO_PARAMETER if is_receive else objects.TPDO_PARAMETER) + number
    mapping = (objects.RPDO_MAPPING if is_receive else objects.TPDO_MAPPING) + number
    name = f"{'RPDO' if is_receive else 'TPDO'} {number + 1}"
    base = (objects.RPDO_BASES if is_receive else objects.TPDO_BASES)[number]
    cob_id = Object(parameter, f"COB-ID of {name}", DataType.UNSIGNED32, objects.PDO_COB_ID)
    kind = Object(parameter, f"transmission type of {name}", DataType.UNSIGNED8, objects.PDO_TRANSMISSION_TYPE)
    timer = Object(parameter, f"event timer of {name}", DataType.UNSIGNED16, objects.PDO_EVENT_TIMER)
    count = Object(mapping, f"number of objects in {name}", DataType.UNSIGNED8, 0)

    widths, words = [], []
    for entry in entries:
        bits = access.width(entry)
        if bits is None:
            raise DriveError(f"{access.axis}: {access.where} lacks object {entry}, which belongs into {name}")
        widths.append(bits)
        words.append(entry.index << 16 | entry.subindex << 8 | bits)
    layout = pdo_layout(entries, widths)
    if layout.size > 8:
        listed = ", ".join(map(str, entries))
        raise DriveError(f"{access.axis}: {listed} need {layout.size} bytes on this drive; {name} carries 8")

    access.write(cob_id, _INVALID | base + node)
    access.write(count, 0)
    for position, word in enumerate(words, 1):
        access.write(Object(mapping, f"object {position} of {name}", DataType.UNSIGNED32, position), word)
    access.write(count, len(words))
    access.write(kind, SYNCHRONOUS)
    if event_ms:
        access.try_write(timer, event_ms)
    access.write(cob_id, base + node)
    for position, word in enumerate(words, 1):
        kept = access.read(Object(mapping, f"object {position} of {name}", DataType.UNSIGNED32, position))
        if kept != word:
            raise DriveError(
                f"{access.axis}: {name} of {access.where} holds {kept:08X}h at position {position} "
                f"after {word:08X}h was written"
            )
    return MappedPdo(base + node, tuple(entries), layout)


def switch_off(access: ObjectAccess, *, is_receive: bool, number: int, node: int) -> None:
    """Switch off a PDO that is not used, where the drive has it."""
    parameter = (objects.RPDO_PARAMETER if is_receive else objects.TPDO_PARAMETER) + number
    base = (objects.RPDO_BASES if is_receive else objects.TPDO_BASES)[number]
    cob_id = Object(parameter, "COB-ID of an unused PDO", DataType.UNSIGNED32, objects.PDO_COB_ID)
    before = access.find(cob_id)
    if before is not None and not before & _INVALID:
        access.write(cob_id, _INVALID | base + node)


def frame_bits(size: int) -> int:
    """Bits of a CAN frame with an 11-bit identifier and ``size`` data bytes, with worst-case stuffing.

    Source: K. Tindell, A. Burns, A. Wellings, Control Engineering Practice 3(8), 1995; with the interframe
    space of 3 bits.
    """
    stuffed = 34 + 8 * size
    return stuffed + (stuffed - 1) // 4 + 13


def wire_time_s(bitrate: int, pdos: Sequence[MappedPdo]) -> float:
    """Time that one cycle's SYNC and ``pdos`` occupy the bus."""
    return (frame_bits(0) + sum(frame_bits(pdo.layout.size) for pdo in pdos)) / bitrate


def check_bus_load(bitrate: int, period_s: float, pdos: Sequence[MappedPdo]) -> str:
    """Refuse a cycle that does not fit on the wire with some room for SDO, heartbeats and emergencies; else say it.

    Raises
    ------
    DriveError
        With the arithmetic.
    """
    needed = wire_time_s(bitrate, pdos)
    if needed > 0.9 * period_s:
        sizes = " + ".join(f"{frame_bits(pdo.layout.size)}" for pdo in pdos)
        raise DriveError(
            f"a cycle needs {needed * 1e6:.0f} us on the bus at {bitrate} bit/s (SYNC {frame_bits(0)} + PDOs {sizes} "
            f"bits with worst-case stuffing), more than 90 % of the period of {period_s * 1e6:.0f} us",
            "take a longer period_s, a higher bit rate, or fewer axes",
        )
    return f"a cycle needs {needed * 1e6:.0f} us of {period_s * 1e6:.0f} us on the bus at {bitrate} bit/s"


def expected_pdos(mode: Mode) -> list[MappedPdo]:
    """PDOs of a drive whose objects have the standard's widths, for arithmetic before it was asked."""
    return [
        MappedPdo(0, entries, pdo_layout(entries, [entry.type.bits for entry in entries]))
        for entries in (*FEEDBACK, COMMANDS[mode])
    ]
