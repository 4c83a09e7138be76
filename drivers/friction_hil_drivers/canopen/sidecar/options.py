"""Keys under ``sidecar`` of an axis: PDOs of a drive whose master is another controller, as that one mapped them."""

import struct
from collections.abc import Iterator
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, model_validator

from friction_hil_drivers.canopen.connect.mapping import MappedPdo
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.cia402 import objects
from friction_hil_drivers.cia402.objects import DataType, Object

CobId = Annotated[int, Field(ge=0x81, le=0x77F)]
# an index alone, with the standard's width, or a word of a mapping object: index, sub-index, bits
MappingEntry = Annotated[int, Field(ge=0x1000, le=0xFFFFFFFF)]

_LARGEST_INDEX = 0xFFFF
_LARGEST_BITS = 64
_FORMATS = {8: "b", 16: "h", 32: "i"}

USED = (
    objects.CONTROLWORD,
    objects.STATUSWORD,
    objects.MODE_DISPLAY,
    objects.POSITION_DEMAND,
    objects.POSITION_ACTUAL,
    objects.TORQUE_ACTUAL,
    objects.TARGET_POSITION,
    objects.TORQUE_OFFSET,
)
_USED = {entry.address: entry for entry in USED}


class SidecarPdo(BaseModel):
    """One PDO on the bus."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    cob_id: CobId = Field(description="identifier of its frames, e.g. 0x181")
    entries: tuple[MappingEntry, ...] = Field(
        min_length=1,
        max_length=8,
        description="mapped objects in their order: words of the mapping object (0x60640020: index, sub-index, bits), "
        "or indices (0x6064) of objects with the standard's width",
    )

    @model_validator(mode="after")
    def _check(self) -> "SidecarPdo":
        bits = sum(_word(entry) & 0xFF for entry in self.entries)
        if bits > _LARGEST_BITS:
            raise ValueError(f"entries have {bits} bits, more than the {_LARGEST_BITS} of a PDO")
        mapped(self)
        return self


class SidecarTpdo(SidecarPdo):
    """A PDO that the drive sends."""

    is_synchronous: bool = Field(
        True, description="it comes with every SYNC (types 1 and, with changes, 0); false: only when something changes"
    )


class SidecarOptions(BaseModel):
    """PDOs of a drive that another controller moves (``bus.role: sidecar``)."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    tpdos: tuple[SidecarTpdo, ...] = Field(
        min_length=1, description="TPDOs of the drive; 6041h and 6064h must be in them; 6061h, 6062h, 6077h are used"
    )
    rpdos: tuple[SidecarPdo, ...] = Field(
        (), description="RPDOs that the master sends to the drive; 6040h and 607Ah in them are used"
    )
    offset: SidecarPdo = Field(
        description="RPDO of the drive for the torque offset alone (60B2h), which nobody else sends; type 254 or 255"
    )
    heartbeat_s: float | None = Field(
        None, ge=0.01, le=10.0, description="period of a heartbeat as node master_node, s; by default none is sent"
    )

    @model_validator(mode="after")
    def _check(self) -> "SidecarOptions":
        for problem in _mistakes(self):
            raise ValueError(problem)
        return self


def mapped(pdo: SidecarPdo) -> MappedPdo:
    """Return a PDO with those of its entries that the daemon uses; the layout passes over the others.

    Raises `ValueError`: the width of an entry is not known, or not possible.
    """
    entries: list[Object] = []
    layout = "<"
    for given in pdo.entries:
        word = _word(given)
        bits, entry = word & 0xFF, _USED.get((word >> 16, word >> 8 & 0xFF))
        if bits % 8 or not bits:
            raise ValueError(f"entry {given:#x} has {bits} bits; whole bytes are supported")
        if entry is None:
            layout += f"{bits // 8}x"
            continue
        if bits not in _FORMATS:
            raise ValueError(f"entry {given:#x}: {entry} has {bits} bits; 8, 16 or 32 are possible")
        entries.append(entry)
        layout += _FORMATS[bits] if entry.type.is_signed else _FORMATS[bits].upper()
    return MappedPdo(pdo.cob_id, tuple(entries), struct.Struct(layout))


def mapping_words(pdo: SidecarPdo) -> list[int]:
    """Return the words of a PDO's mapping object."""
    return [_word(given) for given in pdo.entries]


def _word(given: int) -> int:
    """Return the word of a mapping object: index, sub-index and bits."""
    if given > _LARGEST_INDEX:
        return given
    known = cia301.TABLE.get((given, 0))
    if known is None or known.type is DataType.VISIBLE_STRING:
        raise ValueError(
            f"entry {given:#06x}: the width of this object is not known here; write the word of the mapping object, "
            f"e.g. {given << 16 | 0x10:#x} for 16 bits"
        )
    return known.mapping


def _mistakes(options: SidecarOptions) -> Iterator[str]:
    feedback = {entry for pdo in options.tpdos for entry in mapped(pdo).entries}
    for entry in (objects.STATUSWORD, objects.POSITION_ACTUAL):
        if entry not in feedback:
            yield f"tpdos: none of them carries {entry}, which is needed"
    for tpdo in options.tpdos:
        if objects.POSITION_ACTUAL in mapped(tpdo).entries and not tpdo.is_synchronous:
            yield f"tpdos: {tpdo.cob_id:#x} carries {objects.POSITION_ACTUAL}, so it must come with every SYNC"
    if mapped(options.offset).entries != (objects.TORQUE_OFFSET,) or len(options.offset.entries) != 1:
        yield f"offset: entries must be {objects.TORQUE_OFFSET} alone: what else is in this RPDO belongs to the master"
    for pdo in (*options.rpdos, *options.tpdos):
        if objects.TORQUE_OFFSET in mapped(pdo).entries:
            yield f"{pdo.cob_id:#x} carries {objects.TORQUE_OFFSET} too: the master would overwrite the compensation"
    used = [pdo.cob_id for pdo in (*options.tpdos, *options.rpdos, options.offset)]
    for cob_id in used:
        if used.count(cob_id) > 1:
            yield f"cob_id {cob_id:#x} is given twice"
