"""Finding PDOs of a drive for the objects that a cycle needs: written where the drive lets them, kept where not.

What may be written differs: mappings that are fixed, fewer entries than eight, objects that only some PDOs take. So
each mapping is tried and read back; nothing is taken from the type of the drive.
"""

import contextlib
import itertools
import struct
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from friction_hil.errors import DriveError
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.connect.mapping import LARGEST_BYTES, SYNCHRONOUS, MappedPdo, PdoRecord
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.cia402 import codes as cia402_codes
from friction_hil_drivers.cia402 import objects
from friction_hil_drivers.cia402.access import RefusedError
from friction_hil_drivers.cia402.codec import field_format
from friction_hil_drivers.cia402.objects import DataType, Object

if TYPE_CHECKING:
    from friction_hil_drivers.canopen.sdo.client import SdoClient

_MOST_ENTRIES = 8  # of 8 bits each
_FIRST_RECORDS = 4  # looked for one by one; those behind them only as long as there are any
_DUMMIES = range(0x0001, 0x0008)  # data types that stand for bytes that mean nothing
_ZEROED = objects.ACTING_SETPOINTS  # before the mapping, by the driver


@dataclass(frozen=True, slots=True)
class FoundPdo:
    """A PDO as the drive has it."""

    record: PdoRecord
    cob_id: int  # content of the entry, with the bits 31 (invalid), 30 (no RTR) and 29 (29-bit identifier)
    transmission_type: int | None  # None where the drive has no such entry
    words: tuple[int, ...]  # index, sub-index and width of each entry


@dataclass(frozen=True, slots=True)
class Negotiated:
    """PDOs in force, and those that are not used."""

    pdos: tuple[MappedPdo, ...]
    unused: tuple[FoundPdo, ...]  # still as they were found
    notes: tuple[str, ...] = ()  # what is kept because the drive does not let it be changed


# Decisions


def grouped(
    entries: Sequence[Object], bits: Mapping[Object, int], most: int = _MOST_ENTRIES
) -> list[tuple[Object, ...]]:
    """Distribute objects over PDOs of eight bytes and ``most`` entries: each goes into the first with room for it."""
    groups: list[list[Object]] = []
    for entry in entries:
        for group in groups:
            if len(group) < most and sum(bits[one] for one in (*group, entry)) <= 8 * LARGEST_BYTES:
                group.append(entry)
                break
        else:
            groups.append([entry])
    return [tuple(group) for group in groups]


def covering(found: Sequence[FoundPdo], entries: Collection[Object]) -> list[FoundPdo] | None:
    """Return the fewest PDOs whose mappings contain all ``entries``; of equally few those with the fewest bytes.

    PDOs with a field that is not a whole number of bytes, or with more than eight bytes, do not count.
    """
    wanted = {pdo.record.address(one) for pdo in found for one in entries}
    usable = [pdo for pdo in found if _is_whole(pdo.words) and any(word >> 8 in wanted for word in pdo.words)]
    contents = {pdo.record: {word >> 8: word & 0xFF for word in pdo.words} for pdo in usable}
    for count in range(1, min(len(entries), len(usable)) + 1):
        fits = [
            chosen
            for chosen in itertools.combinations(usable, count)
            if all(any(_carries(contents[pdo.record], pdo.record, one) for pdo in chosen) for one in entries)
        ]
        if fits:
            return list(min(fits, key=lambda chosen: sum(word & 0xFF for pdo in chosen for word in pdo.words)))
    return None


def _carries(content: Mapping[int, int], record: PdoRecord, entry: Object) -> bool:
    """Return True if an object is in a mapping, with no fewer bits than the standard gives it."""
    bits = content.get(record.address(entry), 0)
    return bits in (8, 16, 32, 64) and bits >= entry.type.bits


def _is_whole(words: Sequence[int]) -> bool:
    widths = [word & 0xFF for word in words]
    return bool(widths) and all(bits and bits % 8 == 0 for bits in widths) and sum(widths) <= 8 * LARGEST_BYTES


def kept_layout(pdo: FoundPdo, entries: Collection[Object]) -> tuple[tuple[Object, ...], str]:
    """Return the entries of a mapping that stays as it is, and the format of its bytes for `struct`.

    ``entries``: objects that are used. Other entries of a TPDO are skipped by the format; of an RPDO they are bytes.
    """
    used, code = [], "<"
    by_address = {pdo.record.address(entry): entry for entry in entries}
    for position, word in enumerate(pdo.words):
        size = (word & 0xFF) // 8
        entry = by_address.get(word >> 8)
        if entry is not None and entry not in used and size in (1, 2, 4, 8):
            used.append(entry)
            code += field_format(entry, 8 * size)
        elif pdo.record.is_receive:
            used.append(_carried_object(pdo.record, word, position))
            code += f"{size}s"
        else:
            code += f"{size}x"
    return tuple(used), code


def _carried_object(record: PdoRecord, word: int, position: int) -> Object:
    """Return an object of a mapping that is not commanded; dummies are told apart by their position."""
    index, subindex = objects.first_axis_index(word >> 16, record.axis), word >> 8 & 0xFF
    if index in _DUMMIES:
        return Object(index, "nothing", DataType.UNSIGNED8, position)
    known = cia301.TABLE.get((index, subindex))
    return known or Object(index, "(no name here)", DataType.UNSIGNED32, subindex)


def free_identifier(pdo: FoundPdo, taken: Collection[int]) -> int:
    """Return the identifier for a PDO of the pre-defined connection set, else its own, else a free one of the set."""
    record, own = pdo.record, pdo.cob_id & 0x7FF
    candidates = [own] if own and not pdo.cob_id & cia301.PDO_EXTENDED else []
    if record.default_identifier is not None:
        candidates.insert(0, record.default_identifier)
    bases = cia301.RPDO_BASES if record.is_receive else cia301.TPDO_BASES
    candidates += [base + record.node for base in reversed(bases)]
    for identifier in candidates:
        if identifier not in taken:
            return identifier
    raise ValueError(f"every identifier for {record.name} is taken")


def _kept_note(pdo: FoundPdo, carried: Mapping[Object, bytes]) -> str:
    what = ", ".join(
        f"{entry} = {int.from_bytes(data, 'little', signed=entry.type.is_signed)}"
        for entry, data in carried.items()
        if entry.index not in _DUMMIES
    )
    beside = f", which carries {what} too: always sent with these values" if what else ""
    return f"{pdo.record.name} keeps the mapping that the drive has{beside}"


# Reading


def read_pdos(access: "SdoClient", *, is_receive: bool, node: int, axis: int = 0) -> list[FoundPdo]:
    """Read the PDOs of one direction that a drive has; nothing is written."""
    found = []
    for number in range(cia301.PDOS_PER_AXIS):
        record = PdoRecord(is_receive, number, node, axis)
        cob_id = access.find(record.cob_id)
        count = None if cob_id is None else access.find(record.mapping(0))
        if cob_id is not None and count is not None:
            positions = range(1, min(count, 64) + 1) if count < 254 else range(0)  # 254, 255: multiplexed PDOs
            words = tuple(access.find(record.mapping(position)) or 0 for position in positions)
            found.append(FoundPdo(record, cob_id, access.find(record.transmission_type), words))
        elif number >= _FIRST_RECORDS - 1:
            break
    return found


# Setting up


class PdoNegotiator:
    """Sets up the PDOs of one direction of a drive.

    ``node``, ``axis``: node number, and number of the axis in a node with several. ``taken``: identifiers of other
    PDOs; those of the PDOs set up here are added.
    """

    def __init__(
        self, access: "SdoClient", *, is_receive: bool, node: int, axis: int = 0, taken: set[int] | None = None
    ) -> None:
        self._access = access
        self._taken = set() if taken is None else taken
        self._is_receive, self._node, self._axis = is_receive, node, axis
        self._direction = "RPDO" if is_receive else "TPDO"
        self._values: dict[Object, bytes] = {}
        self._notes: list[str] = []
        self._refusals: dict[str, str] = {}

    def negotiate(
        self,
        entries: Sequence[Object],
        *,
        optional: Collection[Object] = (),
        values: Mapping[Object, bytes] | None = None,
    ) -> Negotiated:
        """Set up PDOs that carry ``entries``.

        A mapping that is there already is kept. Otherwise it is written; where the drive refuses that, mappings that it
        has are kept if they contain what is needed, else it is tried with fewer entries a PDO.

        ``entries``: in the order of the bytes. ``optional``: objects among them that are left out, with a note, if no
        PDO of the drive takes them; the first ones first. ``values``: content of objects in a kept RPDO that are not to
        be read from the drive.

        Raises `DriveError`: the drive lacks an object or has no PDO for it, or a fixed mapping has an entry whose value
        is not known.
        """
        self._values = dict(values or {})
        bits = self._widths(entries)
        droppable = [entry for entry in optional if entry in entries]
        for dropped in itertools.chain.from_iterable(
            itertools.combinations(droppable, count) for count in range(len(droppable) + 1)
        ):
            wanted = [entry for entry in entries if entry not in dropped]
            pdos = self._write_or_keep(wanted, bits)
            if pdos is not None:
                used = {pdo.number for pdo in pdos}
                unused = tuple(pdo for pdo in self._found() if pdo.record.number not in used)
                lost = [f"no TPDO of the drive takes {entry}" for entry in dropped]
                return Negotiated(tuple(pdos), unused, (*self._notes, *lost))
        raise self._refusal(entries)

    def _found(self) -> list[FoundPdo]:
        found = read_pdos(self._access, is_receive=self._is_receive, node=self._node, axis=self._axis)
        # where nothing may be written, a PDO that is off stays off
        return [pdo for pdo in found if not (self._access.is_read_only and pdo.cob_id & cia301.PDO_INVALID)]

    def _widths(self, entries: Sequence[Object]) -> dict[Object, int]:
        """Return the widths that the drive itself gives its objects."""
        access, widths = self._access, {}
        for entry in entries:
            bits = access.width(entry) or (access.hidden_width(entry) if self._is_receive else None)
            if bits is None:
                text = f"{access.axis}: {access.where} lacks object {entry}, which is needed in an {self._direction}"
                raise DriveError(text, code=cia402_codes.OBJECT_MISSING)
            if bits < entry.type.bits or bits > 64:
                text = f"{access.axis}: {entry} has {bits} bits in {access.where} and not {entry.type.bits}"
                raise DriveError(text, code=cia402_codes.OBJECT_SIZE)
            widths[entry] = bits
        return widths

    def _write_or_keep(self, entries: Sequence[Object], bits: Mapping[Object, int]) -> list[MappedPdo] | None:
        layouts: list[list[tuple[Object, ...]]] = []
        for most in (_MOST_ENTRIES, 3, 2, 1):
            groups = grouped(entries, bits, most)
            if groups not in layouts:
                layouts.append(groups)
        for groups in layouts:
            if (written := self._write(groups, bits)) is not None:
                return written
            if groups is layouts[0] and (kept := self._keep(entries)) is not None:
                return kept
        return None

    def _write(self, groups: Sequence[tuple[Object, ...]], bits: Mapping[Object, int]) -> list[MappedPdo] | None:
        """Write each group into the first PDO that takes it; None, with all as before, if one finds none."""
        if self._access.is_read_only:
            return None
        free = self._found()
        done: list[tuple[FoundPdo, MappedPdo]] = []
        for group in groups:
            for pdo in free:
                words = [pdo.record.word(entry, bits[entry]) for entry in group]
                if (cob_id := self._set_up(pdo, words)) is not None:
                    code = "<" + "".join(field_format(entry, bits[entry]) for entry in group)
                    done.append((pdo, self._in_force(pdo, cob_id, group, code)))
                    free.remove(pdo)
                    break
            else:
                self._give_up(done)
                return None
        return [mapped for _, mapped in done]

    def _set_up(self, pdo: FoundPdo, words: Sequence[int]) -> int | None:
        """Map a PDO, with the order that CiA 301 prescribes; return its COB-ID, None where the drive refuses."""
        record = pdo.record
        try:
            if pdo.words != tuple(words):
                if not pdo.cob_id & cia301.PDO_INVALID:
                    self._access.write(record.cob_id, cia301.PDO_INVALID | pdo.cob_id)
                for entry, value in record.mapping_steps(words):
                    self._access.write(entry, value)
                self._require_kept(record, words)
            return self._switch_on(pdo)
        except DriveError as error:
            self._note_refusal(record, error)
            self._restore(pdo)
            return None

    def _require_kept(self, record: PdoRecord, words: Sequence[int]) -> None:
        access = self._access
        for position, word in enumerate(words, 1):
            kept = access.read(record.mapping(position))
            if kept != word:
                text = (
                    f"{access.axis}: {record.name} of {access.where} holds {kept:08X}h at position {position} "
                    f"after {word:08X}h was written"
                )
                raise DriveError(text, code=codes.MAPPING_NOT_KEPT)

    def _switch_on(self, pdo: FoundPdo) -> int:
        """Make a PDO synchronous and switch it on; return its COB-ID, or raise a `DriveError` if it cannot be used."""
        access, record = self._access, pdo.record
        identifier = free_identifier(pdo, self._taken)
        cob_id = pdo.cob_id & cia301.PDO_NO_RTR | identifier
        kind = access.find(record.transmission_type)
        # it concerns event-driven PDOs alone, but some drives are delivered with 100 ms and may look at it always
        is_inhibited = not record.is_receive and bool(access.find(record.inhibit_time))
        if kind != SYNCHRONOUS or is_inhibited or access.find(record.cob_id) != cob_id:
            present = access.read(record.cob_id)
            if not present & cia301.PDO_INVALID:
                self._attempt(record.cob_id, cia301.PDO_INVALID | present)
            if kind != SYNCHRONOUS and not self._attempt(record.transmission_type, SYNCHRONOUS):
                self._require_usable_type(record, kind)
            if is_inhibited:
                self._attempt(record.inhibit_time, 0)
            if not self._attempt(record.cob_id, cob_id):
                self._attempt(record.cob_id, pdo.cob_id & ~cia301.PDO_INVALID)
        in_force = access.read(record.cob_id)
        if in_force & (cia301.PDO_INVALID | cia301.PDO_EXTENDED) or not in_force & 0x7FF:
            text = f"{access.axis}: {record.name} of {access.where} cannot be switched on: COB-ID {in_force:08X}h"
            raise DriveError(text, code=codes.MAPPING_NOT_KEPT)
        if in_force & 0x7FF in self._taken:
            text = f"{access.axis}: {record.name} of {access.where} keeps an identifier of another PDO, {in_force:03X}h"
            raise DriveError(text, code=codes.MAPPING_NOT_KEPT)
        return in_force

    def _require_usable_type(self, record: PdoRecord, kind: int | None) -> None:
        """Refuse a TPDO that does not come with every SYNC; an RPDO may take effect with SYNC or when it arrives."""
        if not record.is_receive and not self._access.is_read_only:
            text = (
                f"{self._access.axis}: {record.name} of {self._access.where} does not come with every SYNC: "
                f"its transmission type {kind} cannot be changed to {SYNCHRONOUS}"
            )
            raise DriveError(text, code=codes.MAPPING_NOT_KEPT)

    def _attempt(self, entry: Object, value: int) -> bool:
        """Write an object; return False if the drive refuses and does not hold the value already."""
        with contextlib.suppress(RefusedError):
            self._access.ensure(entry, value)
            return True
        return False

    def _in_force(self, pdo: FoundPdo, cob_id: int, entries: tuple[Object, ...], code: str) -> MappedPdo:
        identifier = cob_id & 0x7FF
        self._taken.add(identifier)
        kind = self._access.find(pdo.record.transmission_type)
        is_synchronous = kind is not None and kind <= cia301.LARGEST_SYNCHRONOUS
        number = pdo.record.number
        return MappedPdo(identifier, entries, struct.Struct(code), number, is_synchronous=is_synchronous)

    def _restore(self, pdo: FoundPdo) -> None:
        """Return a PDO to what it was before an attempt, as far as the drive lets it."""
        access, record = self._access, pdo.record
        present = replace(pdo, words=tuple(access.find(record.mapping(p)) or 0 for p in range(1, len(pdo.words) + 1)))
        if present.words != pdo.words or access.find(record.mapping(0)) != len(pdo.words):
            self._attempt(record.cob_id, cia301.PDO_INVALID | pdo.cob_id)
            for entry, value in record.mapping_steps(pdo.words):
                self._attempt(entry, value)
        if pdo.transmission_type is not None and access.find(record.transmission_type) != pdo.transmission_type:
            self._attempt(record.transmission_type, pdo.transmission_type)
        if access.find(record.cob_id) != pdo.cob_id:
            self._attempt(record.cob_id, pdo.cob_id)

    def _keep(self, entries: Sequence[Object]) -> list[MappedPdo] | None:
        """Keep mappings that contain ``entries``; None where there are none."""
        chosen = covering(self._found(), entries)
        if chosen is None:
            return None
        kept: list[MappedPdo] = []
        for pdo in chosen:
            used, code = kept_layout(pdo, entries)
            others = zip(used, pdo.words, strict=True) if pdo.record.is_receive else ()
            carried = {entry: self._value(pdo, entry, word) for entry, word in others if entry not in entries}
            try:
                cob_id = self._switch_on(pdo)
            except DriveError as error:
                self._note_refusal(pdo.record, error)
                self._give_up(zip(chosen, kept, strict=False))
                return None
            kept.append(replace(self._in_force(pdo, cob_id, used, code), carried=carried))
            self._notes.append(_kept_note(pdo, carried))
        return kept

    def _give_up(self, done: Iterable[tuple[FoundPdo, MappedPdo]]) -> None:
        """Return PDOs that were set up to what they were before."""
        for pdo, mapped in done:
            self._taken.discard(mapped.cob_id)
            self._restore(pdo)

    def _value(self, pdo: FoundPdo, entry: Object, word: int) -> bytes:
        """Return what an entry that is not commanded always carries: the object's present value."""
        access, size = self._access, (word & 0xFF) // 8
        if entry.index in _DUMMIES:
            return bytes(size)
        if entry in self._values:
            return self._values[entry].ljust(size, b"\0")[:size]
        try:
            data = access.bytes_of(entry)
        except RefusedError:
            data = None
        if data is None and entry in _ZEROED:
            return bytes(size)
        if data is None or len(data) != size:
            text = (
                f"{access.axis}: {pdo.record.name} of {access.where} has a fixed mapping, which carries {entry} too; "
                "its value cannot be read, so nothing harmless can be sent in its place"
            )
            raise DriveError(text, code=codes.UNKNOWN_ENTRY)
        return data

    def _note_refusal(self, record: PdoRecord, error: DriveError) -> None:
        if error.code not in (cia402_codes.SDO_ABORT, codes.MAPPING_NOT_KEPT, cia402_codes.OBJECT_MISSING):
            raise error  # no refusal: the drive does not answer
        self._refusals.setdefault(record.name, error.detail)

    def _refusal(self, entries: Sequence[Object]) -> DriveError:
        access = self._access
        wanted = ", ".join(map(str, entries))
        reasons = "; ".join(text.removeprefix(f"{access.axis}: ") for text in self._refusals.values())
        text = f"{access.axis}: no {self._direction}s of {access.where} carry {wanted}: {reasons or 'it has none'}"
        return DriveError(text, code=codes.NO_MAPPING)
