"""PDOs: which objects they carry, how they are set up in a drive, and how long a cycle of them occupies the bus."""

import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from friction_hil.drive import Mode
from friction_hil.errors import DriveError
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.cia402 import objects
from friction_hil_drivers.cia402.access import RefusedError
from friction_hil_drivers.cia402.codec import COMMANDS, FEEDBACK, block_layout
from friction_hil_drivers.cia402.objects import DataType, Object

if TYPE_CHECKING:
    from friction_hil_drivers.canopen.sdo.client import SdoClient

SYNCHRONOUS = 1  # transmission type: with every SYNC
LARGEST_BYTES = 8
_LARGEST_LOAD = 0.9  # of the period; the rest is for SDO, heartbeats and emergencies


@dataclass(frozen=True, slots=True)
class MappedPdo:
    """One PDO in force: its identifier on the bus and the layout of its bytes."""

    cob_id: int  # identifier of its frames
    entries: tuple[Object, ...]  # in the order of their bytes; of a TPDO those that are used: its layout skips others
    layout: struct.Struct
    number: int = 0  # of the PDO in the drive, from 0
    is_synchronous: bool = True  # an RPDO takes effect at the next SYNC; False: at once
    carried: Mapping[Object, bytes] = field(default_factory=dict)  # constants in an RPDO, which are not commanded


@dataclass(frozen=True, slots=True)
class PdoRecord:
    """Objects that configure one PDO of an axis."""

    is_receive: bool
    number: int  # of the PDO, from 0, separately for each direction and axis
    node: int
    axis: int = 0  # in a node with several (CiA 402-2): its profile stands 800h higher for each axis, its PDOs 64

    @property
    def name(self) -> str:
        """Name in messages: ``RPDO 1``."""
        return f"{'RPDO' if self.is_receive else 'TPDO'} {self._offset + 1}"

    @property
    def default_identifier(self) -> int | None:
        """Identifier of the PDO's frames in the pre-defined connection set, which has four for each direction."""
        bases = cia301.RPDO_BASES if self.is_receive else cia301.TPDO_BASES
        return bases[self.number] + self.node if self.axis == 0 and self.number < len(bases) else None

    @property
    def _offset(self) -> int:
        return cia301.PDOS_PER_AXIS * self.axis + self.number

    def address(self, entry: Object) -> int:
        """Return index and sub-index of an object on this axis: index << 8 | sub-index."""
        return objects.axis_index(entry.index, self.axis) << 8 | entry.subindex

    def word(self, entry: Object, bits: int) -> int:
        """Return the entry of a mapping object for an object of ``bits`` bits."""
        return self.address(entry) << 8 | bits

    def parameter(self, subindex: int, name: str, kind: DataType) -> Object:
        """Return an object of the communication record (1400h, 1800h)."""
        base = cia301.RPDO_PARAMETER if self.is_receive else cia301.TPDO_PARAMETER
        return Object(base + self._offset, f"{name} of {self.name}", kind, subindex)

    def mapping(self, position: int) -> Object:
        """Return an object of the mapping record (1600h, 1A00h); position 0 is the number of mapped objects."""
        index = (cia301.RPDO_MAPPING if self.is_receive else cia301.TPDO_MAPPING) + self._offset
        if position == 0:
            return Object(index, f"number of objects in {self.name}", DataType.UNSIGNED8, 0)
        return Object(index, f"object {position} of {self.name}", DataType.UNSIGNED32, position)

    def mapping_steps(self, words: Sequence[int]) -> Iterator[tuple[Object, int]]:
        """Yield what maps a PDO that is off: number of objects 0, the objects, their number (CiA 301)."""
        yield self.mapping(0), 0
        yield from ((self.mapping(position), word) for position, word in enumerate(words, 1))
        yield self.mapping(0), len(words)

    @property
    def cob_id(self) -> Object:
        """Entry with the identifier, and the bit that switches the PDO off."""
        return self.parameter(cia301.PDO_COB_ID, "COB-ID", DataType.UNSIGNED32)

    @property
    def transmission_type(self) -> Object:
        """Entry that says when the PDO is sent or takes effect."""
        return self.parameter(cia301.PDO_TRANSMISSION_TYPE, "transmission type", DataType.UNSIGNED8)

    @property
    def inhibit_time(self) -> Object:
        """Entry with the shortest time between two frames, in units of 100 us."""
        return self.parameter(cia301.PDO_INHIBIT_TIME, "inhibit time", DataType.UNSIGNED16)

    @property
    def event_timer(self) -> Object:
        """Entry with the event timer; of an RPDO, the time after which its absence is an error."""
        return self.parameter(cia301.PDO_EVENT_TIMER, "event timer", DataType.UNSIGNED16)


def switch_off(access: "SdoClient", record: PdoRecord) -> bool:
    """Switch off a PDO that is not used, where the drive has it; return False if the drive refuses."""
    before = access.find(record.cob_id)
    if before is None or before & cia301.PDO_INVALID:
        return True
    try:
        access.write(record.cob_id, cia301.PDO_INVALID | before)
    except RefusedError:
        return False
    return True


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
    """Return the load of the bus in words, or raise a `DriveError` if a cycle leaves no room for the rest."""
    needed = wire_time_s(bitrate, pdos)
    if needed > _LARGEST_LOAD * period_s:
        sizes = " + ".join(f"{frame_bits(pdo.layout.size)}" for pdo in pdos)
        text = (
            f"a cycle needs {needed * 1e6:.0f} µs on the bus at {bitrate} bit/s (SYNC {frame_bits(0)} + PDOs {sizes} "
            f"bits with worst-case stuffing), more than {100 * _LARGEST_LOAD:.0f} % of the period of "
            f"{period_s * 1e6:.0f} µs"
        )
        raise DriveError(text, "take a longer period_s, a higher bit rate, or fewer axes", code=codes.BUS_OVERLOAD)
    return f"a cycle needs {needed * 1e6:.0f} µs of {period_s * 1e6:.0f} µs on the bus at {bitrate} bit/s"


def expected_pdos(mode: Mode) -> list[MappedPdo]:
    """Return the PDOs of a drive whose objects have the standard's widths, to compute the load before connecting."""
    return [
        MappedPdo(0, entries, block_layout(entries, [entry.type.bits for entry in entries]))
        for entries in (*FEEDBACK, COMMANDS[mode])
    ]
