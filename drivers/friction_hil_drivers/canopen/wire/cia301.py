"""What CANopen adds to the objects of a drive: objects of communication, PDO records, identifiers, NMT (CiA 301)."""

from dataclasses import replace
from enum import IntEnum

from friction_hil_drivers.cia402 import objects
from friction_hil_drivers.cia402.objects import Address, DataType, Object

Frame = tuple[int, bytes]  # identifier and data

SYNC_COB_ID = Object(0x1005, "COB-ID SYNC", DataType.UNSIGNED32)
COMMUNICATION_CYCLE_PERIOD = Object(0x1006, "communication cycle period", DataType.UNSIGNED32)  # us
GUARD_TIME = Object(0x100C, "guard time", DataType.UNSIGNED16)  # ms
LIFE_TIME_FACTOR = Object(0x100D, "life time factor", DataType.UNSIGNED8)
EMERGENCY_COB_ID = Object(0x1014, "COB-ID emergency", DataType.UNSIGNED32)
CONSUMER_HEARTBEAT_COUNT = Object(0x1016, "number of consumer heartbeat times", DataType.UNSIGNED8)
CONSUMER_HEARTBEAT = Object(0x1016, "consumer heartbeat time", DataType.UNSIGNED32, 1)  # node << 16 | ms
PRODUCER_HEARTBEAT = Object(0x1017, "producer heartbeat time", DataType.UNSIGNED16)  # ms
COMMUNICATION_ERROR_BEHAVIOUR = Object(0x1029, "communication error behaviour", DataType.UNSIGNED8, 1)

TABLE: dict[Address, Object] = objects.TABLE | {
    entry.address: entry for entry in list(globals().values()) if isinstance(entry, Object)
}

# PDO parameters: records of each kind, counted from these indices; four is what the simulated drive has
PDO_COUNT = 4
PDOS_PER_AXIS = 64
RPDO_PARAMETER = 0x1400
RPDO_MAPPING = 0x1600
TPDO_PARAMETER = 0x1800
TPDO_MAPPING = 0x1A00
PDO_COB_ID, PDO_TRANSMISSION_TYPE, PDO_INHIBIT_TIME, PDO_EVENT_TIMER = 1, 2, 3, 5  # sub-indices
LARGEST_SYNCHRONOUS = 240  # transmission type; of smaller ones 1 is "with every SYNC"
PDO_INVALID = 1 << 31  # bit of a COB-ID entry: this PDO (or EMCY) does not exist
PDO_NO_RTR = 1 << 30  # bit of a TPDO's COB-ID entry: it is not sent on request
PDO_EXTENDED = 1 << 29  # bit of a COB-ID entry: 29-bit identifier

# Identifiers of the pre-defined connection set; the node's number is added to the bases
NMT_ID = 0x000
SYNC_ID = 0x080
EMERGENCY_BASE = 0x080
TPDO_BASES = (0x180, 0x280, 0x380, 0x480)
RPDO_BASES = (0x200, 0x300, 0x400, 0x500)
SDO_RESPONSE_BASE = 0x580
SDO_REQUEST_BASE = 0x600
HEARTBEAT_BASE = 0x700


class NmtCommand(IntEnum):
    """Command specifier, first byte of an NMT message."""

    START = 0x01
    STOP = 0x02
    ENTER_PRE_OPERATIONAL = 0x80
    RESET_NODE = 0x81
    RESET_COMMUNICATION = 0x82


class NmtState(IntEnum):
    """Byte of a heartbeat."""

    BOOT_UP = 0x00
    STOPPED = 0x04
    OPERATIONAL = 0x05
    PRE_OPERATIONAL = 0x7F


NMT_WORDS = {state.value: state.name.lower().replace("_", "-") for state in NmtState}


def consumer_heartbeats(count: int) -> list[Object]:
    """Return the entries of 1016h, of which a drive has ``count``."""
    return [replace(CONSUMER_HEARTBEAT, subindex=number) for number in range(1, count + 1)]


def watched_node(value: int) -> tuple[int, int]:
    """Return the node and the time in an entry of 1016h, ms; the entry is not used if one of them is 0."""
    return value >> 16 & 0x7F, value & 0xFFFF


_NMT_STATE = 0x7F  # bits of a heartbeat's byte; the upper one is the toggle bit of node guarding


def decode_heartbeat(data: bytes) -> int | None:
    """Return the NMT state in a heartbeat, None for an empty message."""
    return data[0] & _NMT_STATE if data else None
