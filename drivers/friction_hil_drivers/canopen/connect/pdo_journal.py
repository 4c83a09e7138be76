"""Journal of a CANopen node: the objects of a PDO belong together, and watchdogs are restored first."""

from collections.abc import Iterator, Sequence

from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.cia402.journal import Found, Journal, Step, number_of
from friction_hil_drivers.cia402.objects import DataType, Object

_MOST_ENTRIES = 64  # of a mapping; larger counts stand for multiplexed PDOs
_PDOS = range(0x1400, 0x1C00)  # communication records, and mapping records, whose index has a bit more
_WATCHDOGS = (0x1016, 0x100C, 0x100D)
_TO_MAPPING = 0x200


def pdo_record(index: int) -> int | None:
    """Return the communication record of the PDO that an object belongs to, None for another object."""
    return index & ~_TO_MAPPING if index in _PDOS else None


def mapping_entry(record: int, position: int) -> Object:
    """Return an entry of the mapping of a PDO; position 0 is their number."""
    if position == 0:
        return Object(record + _TO_MAPPING, "number of objects in a PDO", DataType.UNSIGNED8, 0)
    return Object(record + _TO_MAPPING, f"object {position} of a PDO", DataType.UNSIGNED32, position)


def restoration(found: Sequence[Found]) -> list[list[Step]]:
    """Return what is to be written, in groups: watchdogs first, then the last one that was changed.

    A PDO is one group, in the order that CiA 301 prescribes: PDO off, count 0, entries, count, parameters, PDO on.
    """
    groups: dict[int, list[Found]] = {}
    for one in found:
        record = pdo_record(one.entry.index)
        key = one.entry.index << 8 | one.entry.subindex if record is None else record << 8
        groups.setdefault(key, []).append(one)
    plans = [_pdo_steps(group) if group[0].entry.index in _PDOS else _steps(group) for group in groups.values()]
    last_first = [plan for plan in reversed(plans) if plan]
    # the daemon must be heard every few milliseconds until they are off, and the rest may take seconds
    return sorted(last_first, key=lambda plan: plan[0][0].index not in _WATCHDOGS)


def _steps(group: Sequence[Found]) -> list[Step]:
    return [(one.entry, one.found) for one in group if one.found is not None]


def _pdo_steps(group: Sequence[Found]) -> list[Step]:
    record = pdo_record(group[0].entry.index)
    assert record is not None
    values = {one.entry.address: one for one in group if one.found is not None}
    switch = values.pop((record, cia301.PDO_COB_ID), None)
    mapping = sorted((one for one in values.values() if one.entry.index != record), key=lambda one: one.entry.subindex)
    parameters = [one for one in values.values() if one.entry.index == record]
    steps: list[Step] = []
    if mapping and mapping[0].entry.subindex == 0:
        count = mapping[0]
        steps.append((count.entry, bytes(1)))
        steps += _steps(mapping[1:])  # those beyond the number too, as far as the drive shows them
        steps += _steps([count])
    steps += _steps(parameters)
    if switch is None or switch.found is None:
        return steps
    off = (number_of(switch.found) | cia301.PDO_INVALID).to_bytes(4, "little")
    before = [(switch.entry, off)] if steps else []
    return [*before, *steps, (switch.entry, switch.found)]


class CanopenJournal(Journal):
    """Values found in one node."""

    names = cia301.TABLE

    def _concerned(self, entry: Object) -> Iterator[Object]:
        """Yield what has to be known to undo a write: of a mapping all of it, of every PDO its switch."""
        record = pdo_record(entry.index)
        if record is not None:
            yield Object(record, "COB-ID of a PDO", DataType.UNSIGNED32, cia301.PDO_COB_ID)  # its switch
            if entry.index != record and (record + _TO_MAPPING, 0) not in self._found:
                count = mapping_entry(record, 0)
                yield count
                held = number_of(self._access.peek(count))
                yield from (mapping_entry(record, k) for k in range(1, held + 1) if held <= _MOST_ENTRIES)
        yield entry

    def _restoration(self) -> list[list[Step]]:
        return restoration(list(self._found.values()))

    def _is_unused(self, entry: Object) -> bool:
        """Return True for an entry of a mapping that has fewer entries again."""
        count = self._found.get((entry.index, 0))
        is_mapping = entry.index in _PDOS and entry.index & _TO_MAPPING and entry.subindex > 0
        return bool(is_mapping) and count is not None and entry.subindex > number_of(count.found)
