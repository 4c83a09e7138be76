"""Object dictionary of a simulated node, as an EDS describes it."""

import copy
import functools
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from canopen.objectdictionary import ODArray, ODVariable

from friction_hil_drivers.canopen.connect.eds import SIMULATED_SERVO, compact_arrays, load_eds
from friction_hil_drivers.canopen.simulated.pdo import pdo_numbers
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.cia402 import objects
from friction_hil_drivers.cia402.objects import Address, DataType
from friction_hil_drivers.cia402.simulated.dictionary import Dictionary, Entry, is_integer

_FIRST_OBJECT = 0x1000
_MOST_MS = 0xFFFF  # the lower half of a consumer entry
_UNICODE_STRING, _DOMAIN = 0x0B, 0x0F


def eds_dictionary(path: Path, node: int, missing: Iterable[int] = ()) -> Dictionary:
    """Build the dictionary that an EDS describes, at its defaults.

    ``path``: EDS of the entries that SDO and PDO find. Others that the device uses come from the EDS of this package.
    ``node``: for the entries that depend on the node's number. ``missing``: indices in the EDS that SDO and PDO do not
    find.

    Raises `UsageError`: the file is not an EDS.
    """
    own = {(entry.index, entry.subindex): copy.copy(entry) for entry in _own_entries(node)}
    lacking = frozenset(missing)
    if path == SIMULATED_SERVO:
        return Dictionary(own.values(), {address for address in own if address[0] in lacking})
    shown = {(entry.index, entry.subindex): entry for entry in _entries(path, node)}
    notes = [note for entry in shown.values() if (note := _doubt(entry))]
    hidden = {address for address in own | shown if address not in shown or address[0] in lacking}
    # the device works with its own entries where the file gives them a type that is no integer
    kept = {at: own[at] for at in own.keys() & shown.keys() if is_integer(own[at]) and not is_integer(shown[at])}
    notes += [f"{at[0]:04X}h:{at[1]:02X} is no integer in the file: it stays as it is" for at in kept]
    dictionary = Dictionary((own | shown | kept).values(), hidden, shown.values(), is_foreign=True)
    dictionary.notes = notes
    _fill_in(dictionary, own, node)
    return dictionary


def _fill_in(dictionary: Dictionary, own: dict[Address, Entry], node: int) -> None:
    """Give values to the objects that the file leaves empty and without which no node works (CiA 301)."""
    for known in (cia301.SYNC_COB_ID, cia301.EMERGENCY_COB_ID):
        if not dictionary.of(known).value & 0x7FF:
            dictionary.set_default(known, own[known.address].value)
    for parameter, mapping, bases in (
        (cia301.RPDO_PARAMETER, cia301.RPDO_MAPPING, cia301.RPDO_BASES),
        (cia301.TPDO_PARAMETER, cia301.TPDO_MAPPING, cia301.TPDO_BASES),
    ):
        for number in pdo_numbers(dictionary, parameter, mapping):
            entry = dictionary.at_or_hidden(parameter + number, cia301.PDO_COB_ID, DataType.UNSIGNED32)
            if not entry.value & 0x7FF:
                predefined = bases[number] + node if number < len(bases) else 0
                entry.default = entry.value = (entry.value | predefined) or cia301.PDO_INVALID
    dictionary.set_default(objects.CONTROLWORD, 0)
    if not dictionary.of(objects.INTERPOLATION_PERIOD).value:
        for known in (objects.INTERPOLATION_PERIOD, objects.INTERPOLATION_EXPONENT):
            dictionary.set_default(known, own[known.address].value)
    if not dictionary.of(objects.MAX_MOTOR_SPEED).value:
        dictionary.set_default(objects.MAX_MOTOR_SPEED, own[objects.MAX_MOTOR_SPEED.address].value)


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
