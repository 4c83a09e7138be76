"""Which objects the PDOs in a log of CAN frames carry: by the configuration, the log, the EDS, or this driver."""

import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from friction_hil.drive import DriveState, Mode
from friction_hil_drivers.canopen.connect.mapping import PdoRecord
from friction_hil_drivers.canopen.options import CanopenOptions
from friction_hil_drivers.canopen.sdo.dialogue import DOWNLOAD, HEAD, UPLOAD, expedited
from friction_hil_drivers.canopen.sidecar.options import mapping_words
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.canopen.wire.frame_log import FrameLog
from friction_hil_drivers.cia402 import objects, profile
from friction_hil_drivers.cia402.codec import COMMANDS, FEEDBACK, field_format
from friction_hil_drivers.cia402.objects import Object

if TYPE_CHECKING:
    from friction_hil_drivers.canopen.connect.eds import EdsObjects
    from friction_hil_drivers.cia402.access import ObjectReader

OWN = "that this driver sets up"
_NO_COB_ID = -1  # of no frame
_PDOS = 4  # of each direction
_MOST_OBJECTS = 8
_MOST_WORDS = 32  # different statuswords in a log
_MOST_MODES = 4
_KNOWN = 0.95  # of the statuswords
_ROUGH = 1.2  # change of the change of a position, relative to its change: a motion is smooth
_MOVING = 16.0  # counts a cycle


@dataclass(frozen=True, slots=True)
class LoggedPdo:
    """A PDO in the log."""

    name: str
    cob_id: int
    entries: tuple[tuple[Object | None, int], ...]  # objects in the order of their bytes, each with its width in bits
    first: int = 0  # places in the log between which this mapping was in force
    end: int = sys.maxsize

    @property
    def size(self) -> int:
        """Number of bytes."""
        return sum(bits for _, bits in self.entries) // 8

    def frames(self, log: FrameLog) -> NDArray[np.intp]:
        """Return the places of its frames in the log."""
        rows = log.rows_of(self.cob_id)
        return rows[(rows >= self.first) & (rows < self.end)]

    def other_length(self, log: FrameLog) -> str:
        """Return that most of its frames have another length, in words; empty if they have not."""
        rows = self.frames(log)
        lengths = log.lengths[rows]
        if not rows.size or 2 * np.count_nonzero(lengths == self.size) > rows.size:
            return ""
        common = int(np.bincount(lengths).argmax())
        carried = " + ".join(str(entry) if entry else f"{bits} bits" for entry, bits in self.entries)
        return f"{self.cob_id:03X}h carries {common} bytes, and not the {self.size} of {carried}"

    def values(self, log: FrameLog, rows: NDArray[np.intp]) -> dict[Object, NDArray[np.generic]]:
        """Return the values of those of its objects that are known, in some frames."""
        found, offset = {}, 0
        for entry, bits in self.entries:
            if entry is not None and bits in (8, 16, 32):
                content = log.data[rows, offset : offset + bits // 8].copy()
                found[entry] = content.view(f"<{field_format(entry, bits)}").ravel()
            offset += bits // 8
        return found


@dataclass(frozen=True, slots=True)
class LogMapping:
    """The PDOs of one axis, and where that stands; ``is_assumed`` if nothing says that it was in force."""

    pdos: tuple[LoggedPdo, ...]
    origin: str
    is_assumed: bool = False

    @property
    def feedback(self) -> tuple[LoggedPdo, ...]:
        """Those that the drive sends."""
        return tuple(pdo for pdo in self.pdos if pdo.name.startswith("TPDO"))

    def contradiction(self, log: FrameLog) -> str:
        """Return why the frames are not of this mapping; empty if nothing speaks against it."""
        found = next(filter(None, (pdo.other_length(log) for pdo in self.feedback)), "")
        return found or (_implausible(self, log) if self.is_assumed else "")

    def without_other_commands(self, log: FrameLog, problems: list[str]) -> "LogMapping":
        """Return the mapping without commands whose frames have another length, and report these."""
        wrong = {pdo.name: text for pdo in self.pdos if pdo not in self.feedback and (text := pdo.other_length(log))}
        problems += [f"{text}: these commands are left out" for text in wrong.values()]
        return replace(self, pdos=tuple(pdo for pdo in self.pdos if pdo.name not in wrong))


def mappings(
    log: FrameLog, options: CanopenOptions, mode: Mode, access: "ObjectReader", eds: "EdsObjects | None"
) -> list[LogMapping]:
    """Return the mappings that may be in force, the most certain first; what is stated excludes what is assumed."""
    if options.sidecar is not None:
        directions = ("TPDO", options.sidecar.tpdos), ("RPDO", (*options.sidecar.rpdos, options.sidecar.offset))
        stated = (
            LoggedPdo(f"{direction} {number}", pdo.cob_id, _entries(mapping_words(pdo)))
            for direction, pdos in directions
            for number, pdo in enumerate(pdos, 1)
        )
        return [LogMapping(tuple(stated), "of sidecar in the configuration")]
    found = []
    node, axis = options.node, options.axis_number
    logged = tuple(_logged(log, node, axis))
    if any(pdo.name.startswith("TPDO") for pdo in logged):
        return [LogMapping(logged, "in the SDO transfers of the log")]
    pairs = [
        *((PdoRecord(False, number, node, axis), entries) for number, entries in enumerate(FEEDBACK)),
        (PdoRecord(True, 0, node, axis), COMMANDS[mode]),
    ]
    own = tuple(
        LoggedPdo(record.name, identifier, tuple((entry, access.width(entry) or 0) for entry in entries))
        for record, entries in pairs
        if (identifier := record.default_identifier) is not None  # a second axis of a node has none
    )
    found.append(LogMapping(own, OWN, is_assumed=True))
    if eds is not None and (of_eds := tuple(_of_eds(eds, node, axis))):
        found.append(LogMapping(of_eds, f"of the EDS {options.eds}", is_assumed=True))
    return found


def _entries(words: Iterable[int], axis: int = 0) -> tuple[tuple[Object | None, int], ...]:
    return tuple(
        (cia301.TABLE.get((objects.first_axis_index(word >> 16, axis), word >> 8 & 0xFF)), word & 0xFF)
        for word in words
    )


def _logged(log: FrameLog, node: int, axis: int) -> Iterator[LoggedPdo]:
    """Yield the PDOs whose mapping was read or written while the log was made, each as it was for the most frames."""
    transfers = _transfers(log, node)
    for is_receive in (False, True):
        for number in range(_PDOS):
            record = PdoRecord(is_receive, number, node, axis)
            own = [each for each in transfers if each[1] in (record.mapping(0).index, record.cob_id.index)]
            candidates = [pdo for pdo in _in_force(record, own, len(log.times)) if pdo.frames(log).size]
            if candidates:
                yield max(candidates, key=lambda pdo: pdo.frames(log).size)


def _transfers(log: FrameLog, node: int) -> list[tuple[int, int, int, int]]:
    """Return row, index, sub-index and value of each object that was written to a node, or read from it."""
    found = []
    for base, specifier in (cia301.SDO_REQUEST_BASE, DOWNLOAD), (cia301.SDO_RESPONSE_BASE, UPLOAD):
        for row in log.rows_of(base + node).tolist():
            data = log.data[row, : log.lengths[row]].tobytes()
            if (content := expedited(data, specifier)) is not None:
                _, index, subindex = HEAD.unpack_from(data)
                found.append((row, index, subindex, int.from_bytes(content, "little")))
    return sorted(found)


def _in_force(record: PdoRecord, transfers: Sequence[tuple[int, int, int, int]], end: int) -> Iterator[LoggedPdo]:
    """Yield each mapping of a PDO that was complete for a while."""
    words: dict[int, int] = {}
    cob_id = record.default_identifier or _NO_COB_ID
    began, current = 0, tuple[int, ...]()
    for row, index, subindex, value in [*transfers, (end, 0, 0, 0)]:
        before = (cob_id, current)
        if index == record.cob_id.index and subindex == record.cob_id.subindex and not value & cia301.PDO_INVALID:
            cob_id = value & 0x7FF
        elif index == record.mapping(0).index:
            words[subindex] = value
            count = words.get(0, 0)
            is_complete = 0 < count <= _MOST_OBJECTS and all(place in words for place in range(1, count + 1))
            current = tuple(words[place] for place in range(1, count + 1)) if is_complete else ()
        if (cob_id, current) != before or index == 0:
            if before[1]:
                yield LoggedPdo(record.name, before[0], _entries(before[1], record.axis), began, row)
            began = row


def _of_eds(eds: "EdsObjects", node: int, axis: int) -> Iterator[LoggedPdo]:
    """Yield the PDOs that an EDS or DCF maps."""
    for is_receive in (False, True):
        for number in range(_PDOS):
            record = PdoRecord(is_receive, number, node, axis)
            count = eds.value(record.mapping(0)) or 0
            if not 0 < count <= _MOST_OBJECTS:
                continue
            words = [eds.value(record.mapping(place)) or 0 for place in range(1, count + 1)]
            given = eds.value(record.cob_id)
            if all(words):  # one that is off by default is on if it is in the log
                cob_id = (given or 0) & 0x7FF or record.default_identifier or _NO_COB_ID
                yield LoggedPdo(record.name, cob_id, _entries(words, axis))


def _implausible(mapping: LogMapping, log: FrameLog) -> str:
    """Return what shows that the objects are others than assumed; empty if they may be these."""
    for pdo in mapping.feedback:
        rows = pdo.frames(log)
        values = pdo.values(log, rows[log.lengths[rows] == pdo.size])
        where = f"as {' + '.join(str(entry) for entry, _ in pdo.entries)}, {pdo.cob_id:03X}h has"
        words = np.unique(values.get(objects.STATUSWORD, np.empty(0, np.uint16)))
        if words.size > _MOST_WORDS:
            return f"{where} {words.size} different statuswords"
        if words.size and _known_share(values[objects.STATUSWORD]) < _KNOWN:
            return f"{where} statuswords that no drive has"
        if np.unique(values.get(objects.MODE_DISPLAY, np.empty(0))).size > _MOST_MODES:
            return f"{where} more modes than a drive changes to"
        counts = values.get(objects.POSITION_ACTUAL)
        if counts is not None and len(counts) > 2 and _is_rough(counts):
            return f"{where} a position that jumps from cycle to cycle"
    return ""


def _known_share(statuswords: NDArray[np.generic]) -> float:
    words, counts = np.unique(statuswords, return_counts=True)
    known = [profile.drive_state(int(word)) is not DriveState.UNKNOWN for word in words]
    return float(counts[known].sum() / counts.sum())


def _is_rough(counts: NDArray[np.generic]) -> bool:
    steps = np.diff(np.unwrap(counts.astype(np.float64), period=2.0**32))
    size = float(np.median(np.abs(steps)))  # medians: a log may have gaps
    return size > _MOVING and float(np.median(np.abs(np.diff(steps)))) > _ROUGH * size
