"""The event-driven RPDO by which a drive watches the daemon, and the times of all watchdogs: written and read back."""

from typing import TYPE_CHECKING

from friction_hil_drivers.canopen.connect.mapping import PdoRecord
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.cia402 import objects
from friction_hil_drivers.cia402.objects import Object

if TYPE_CHECKING:
    from friction_hil_drivers.canopen.sdo.client import SdoClient

_EVENT_DRIVEN = (255, 254)
_LONGER_MS = (30, 50, 100, 200, 500, 1000)  # tried where a drive does not take a time
_TOO_SHORT = ("06090030h", "06090032h", "holds")  # refusals of a value, also as too low; or it holds another one
_TIME = 0xFFFF  # bits of a time in ms


def set_up_feed(access: "SdoClient", record: PdoRecord, identifier: int, timer_ms: int) -> int:
    """Let an RPDO carry the controlword alone, with a timer; return the timer's time, 0 if the drive refuses."""
    if access.find(record.cob_id) is None or access.find(record.event_timer) is None:
        return 0
    held_ms = 0
    word = record.word(objects.CONTROLWORD, objects.CONTROLWORD.type.bits)
    is_ready = (
        _holds_cob_id(access, record, cia301.PDO_INVALID | identifier)
        and (_carries(access, record, word) or _map(access, record, word))
        and any(access.try_write(record.transmission_type, kind) for kind in _EVENT_DRIVEN)
        and (held_ms := write_time(access, record.event_timer, timer_ms))
        and _holds_cob_id(access, record, identifier)
    )
    if not is_ready:
        _holds_cob_id(access, record, cia301.PDO_INVALID | identifier)
        return 0
    return held_ms


def make_event_driven(access: "SdoClient", record: PdoRecord, identifier: int, timer_ms: int) -> int:
    """Give the RPDO of the commands a timer that does not depend on SYNC; without success, 0, it is as before."""
    if access.find(record.event_timer) is None:
        return 0
    before = access.find(record.transmission_type)
    _holds_cob_id(access, record, cia301.PDO_INVALID | identifier)
    is_event_driven = any(access.try_write(record.transmission_type, kind) for kind in _EVENT_DRIVEN)
    held_ms = write_time(access, record.event_timer, timer_ms) if is_event_driven else 0
    if not held_ms and before is not None:
        access.try_write(record.transmission_type, before)
    access.write(record.cob_id, identifier)
    return held_ms


def _map(access: "SdoClient", record: PdoRecord, word: int) -> bool:
    return (
        access.try_write(record.mapping(0), 0)
        and access.try_write(record.mapping(1), word)
        and access.try_write(record.mapping(0), 1)
    )


def _carries(access: "SdoClient", record: PdoRecord, word: int) -> bool:
    return access.find(record.mapping(0)) == 1 and access.find(record.mapping(1)) == word


def _holds_cob_id(access: "SdoClient", record: PdoRecord, value: int) -> bool:
    """Write the COB-ID of an RPDO; other bits than those of the identifier and of its validity are the drive's."""
    relevant = cia301.PDO_INVALID | 0x7FF
    access.try_write(record.cob_id, value)
    found = access.find(record.cob_id)
    return found is not None and found & relevant == value & relevant


def write_time(access: "SdoClient", entry: Object, wanted_ms: int, further: int = 0) -> int:
    """Write a time, or the next longer one that the drive takes; return the time that it holds, 0 for none.

    ``further`` are other bits of the object. A shorter time than is wanted would trip while the loop bridges.
    """
    for time_ms in (wanted_ms, *(each for each in _LONGER_MS if each > wanted_ms)):
        is_kept = access.try_write(entry, further | time_ms)
        found = further | time_ms if is_kept else access.find(entry)
        if found is not None and found & ~_TIME == further and found & _TIME >= wanted_ms:
            return found & _TIME
        if not any(reason in access.why_not_written(entry) for reason in _TOO_SHORT):
            break
    return 0
