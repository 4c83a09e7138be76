"""Watchdogs of a drive: what stops it when the daemon dies, set up and read back.

Three means, none of which depends on SYNC, which a dead daemon does not send any more:

- an event-driven RPDO with its event timer. It carries the controlword that is in force already and is sent every few
  cycles. The timer of a synchronous RPDO does not count: CiA 301 lets a drive look at it when SYNC comes.
- the heartbeat consumer, 1016h.
- life guarding, 100Ch and 100Dh, where there is no heartbeat consumer: the daemon asks with remote frames.
"""

import struct
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from friction_hil.drive import UnitRow
from friction_hil.drive.codes import coded
from friction_hil.errors import DriveError
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.connect.mapping import MappedPdo, PdoRecord
from friction_hil_drivers.canopen.connect.watchdog_times import REACTION_MS, WatchdogTimes
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.cia402 import objects
from friction_hil_drivers.cia402.objects import Object

if TYPE_CHECKING:
    from friction_hil_drivers.canopen.options import CanopenOptions
    from friction_hil_drivers.canopen.sdo.client import SdoClient

RpdoPlace = tuple[PdoRecord, int]  # an RPDO of the drive, and the identifier that its frames have or shall have

NOT_TRIED = "written and read back, not tried"
_REACTIONS = {1: "a fault", 2: "no voltage", 3: "a quick stop"}  # 6007h
_LEAVES_OPERATIONAL = {0: "Pre-operational", 2: "Stopped"}  # 1029h:01
_ERROR_BEHAVIOUR = cia301.COMMUNICATION_ERROR_BEHAVIOUR
_EVENT_DRIVEN = (255, 254)
_LONGER_MS = (30, 50, 100, 200, 500, 1000)  # tried where a drive does not take a time
_TOO_SHORT = ("06090030h", "06090032h", "holds")  # refusals of a value, also as too low; or it holds another one
_TIME = 0xFFFF  # bits of a time in ms
_WORD = struct.Struct("<H")


@dataclass(frozen=True, slots=True)
class Means:
    """One watchdog of a drive. Prints as ``RPDO 4 within 20 ms``."""

    kind: Literal["rpdo", "heartbeat", "guarding"]
    name: str
    within_ms: int  # time without the daemon after which it trips

    def __str__(self) -> str:
        return f"{self.name} within {self.within_ms} ms"

    @property
    def worst_ms(self) -> int:
        """Time after the daemon's last frame within which a drive that reacts has no torque."""
        return self.within_ms + REACTION_MS


@dataclass(frozen=True, slots=True)
class Watch:
    """What the cyclic phase does so that the drive's watchdogs do not trip."""

    rpdo_id: int = 0  # identifier of the watchdog RPDO, 0 for none
    feed_cycles: int = 1  # it is sent every so many cycles
    beat_s: float = 0.0  # period of the daemon's heartbeats, or of node guarding, s; 0 where neither is watched
    is_guarded: bool = False  # the drive is asked by remote frames
    means: tuple[Means, ...] = ()  # what watches the daemon
    is_reaction_known: bool = False  # a loss is known to take the torque (6007h)

    @property
    def acting(self) -> Means | None:
        """The one that acts first."""
        return min(self.means, key=lambda means: means.within_ms, default=None)

    def row(self, max_missed: int) -> UnitRow:
        """Return the row of the table that is shown before the first enable: what acts, and its worst time."""
        acting = self.acting
        if acting is None:
            value, source = "nothing takes the torque if the daemon dies", "a drive that does not watch it"
        elif self.is_reaction_known:
            value = f"{acting.name} takes the torque within {acting.worst_ms} ms of the daemon's last frame"
            source = f"its time of {acting.within_ms} ms and {REACTION_MS} ms for the reaction"
        else:
            value = f"{acting.name} acts, and whether that takes the torque is not known,"
            source = f"its time of {acting.within_ms} ms"
        confirmation = NOT_TRIED if self.means else "nothing is armed"
        return UnitRow("watchdog", value, source, confirmation, f"realtime.max_missed {max_missed}")


NOT_WATCHED = Watch()


class Feeder:
    """Content of the watchdog RPDO of one axis, from cycle to cycle. No bus, no clock.

    ``offset``: cycles before the first one, so that those of several axes fall into different cycles.
    """

    __slots__ = ("_cycles", "_in_force", "can_id", "left", "sent")

    def __init__(self, watch: Watch, offset: int) -> None:
        self.can_id = watch.rpdo_id  # 0 for none
        self._cycles = watch.feed_cycles
        self.left = offset + 1  # it is due once `next` was called so many times
        self.sent = self._in_force = 0  # controlword that the synchronous RPDO carried last, and the one before

    def taken_over(self) -> None:
        """SYNC was sent: what the synchronous RPDO carried before is in force."""
        self._in_force = self.sent

    def note(self, controlword: int) -> None:
        """Note the controlword of the synchronous RPDO that was just sent."""
        self.sent = controlword

    def next(self) -> bytes | None:
        """Return the RPDO's content if it is due in this cycle; it changes nothing in the drive."""
        self.left -= 1
        if self.left > 0:
            return None
        self.left = self._cycles
        return _WORD.pack(self._in_force)


def feeders(watches: Sequence[Watch]) -> list[Feeder]:
    """Return the feeders of several axes, spread over the cycles."""
    return [
        Feeder(watch, number * watch.feed_cycles // len(watches) if watch.rpdo_id else 0)
        for number, watch in enumerate(watches)
    ]


def watchdog_pdos(feed_cycles: Iterable[int]) -> list[MappedPdo]:
    """Return the watchdog RPDOs in the fullest cycle, for the load of the bus, from each axis's number of cycles."""
    cycles = list(feed_cycles)
    most = -(-len(cycles) // min(cycles)) if cycles else 0
    return [MappedPdo(0, (objects.CONTROLWORD,), _WORD)] * most


@dataclass(frozen=True, slots=True)
class Armed:
    """Result of `arm`."""

    watch: Watch
    notes: list[str]
    is_command_event_driven: bool = False  # RPDO 1 itself is the watchdog, and takes effect when it arrives


def arm(
    access: "SdoClient", options: "CanopenOptions", times: WatchdogTimes, command: RpdoPlace, free: Sequence[RpdoPlace]
) -> Armed:
    """Let the drive watch the daemon by everything that it has.

    ``command``: the RPDO with the controlword. ``free``: RPDOs that are not needed otherwise, switched off.

    Raises `DriveError`: the drive has no watchdog, and the configuration does not accept that; or it cannot meet what
    is demanded.
    """
    reaction = _reaction(access)
    leaves = "" if reaction else _leaves_operational(access)
    means: list[Means] = []
    notes: list[str] = []
    rpdo_id, is_command = 0, False
    if reaction:
        rpdo_id, is_command, found = _arm_rpdo(access, times, command, free)
        means += found
    of_heartbeat = times.behind_a_timer() if means else times
    is_guarded = False
    if reaction or leaves:
        consumer, notes = _arm_heartbeat(access, options.master_node, of_heartbeat)
        if not consumer:
            consumer = _arm_guarding(access, of_heartbeat)
            is_guarded = bool(consumer)
        means += consumer
    if not is_guarded:  # CiA 301: a node that produces heartbeats is not guarded
        access.try_write(cia301.PRODUCER_HEARTBEAT, times.heartbeat_ms)
    if is_command:
        notes.append(f"no other RPDO has a timer: {command[0].name} takes effect when it arrives, and not at SYNC")
    watch = Watch(rpdo_id, times.feed_cycles, of_heartbeat.beat_s, is_guarded, tuple(means), bool(reaction))
    rpdos = [command[0], *(record for record, _ in free)]
    notes.insert(0, _summary(access, options, rpdos, means, reaction, leaves))
    return Armed(watch, notes + _judge(access, times, watch), is_command)


def _judge(access: "SdoClient", times: WatchdogTimes, watch: Watch) -> list[str]:
    """Return a warning where the drive takes no times so short; raise a `DriveError` if the user has written them."""
    acting, longest_ms = watch.acting, max(times.timer_ms, times.loss_ms)
    if acting is None or acting.within_ms <= longest_ms:
        return []
    text = (
        f"if the daemon dies, {acting.name} stops the drive within {acting.worst_ms} ms, because it takes no time "
        f"shorter than {acting.within_ms} ms; realtime.max_missed {times.max_missed} asks for {longest_ms} ms"
    )
    if not times.is_demanded:
        return [coded(f"warning: {text}", codes.WATCHDOG_SLOW)]
    fix = f"the drive can meet realtime.max_missed {times.met_by(acting.within_ms)}; left out, it is a warning"
    raise DriveError(f"{access.axis}: {access.where}: {text}", fix, code=codes.MAX_MISSED_NOT_MET)


def _summary(
    access: "SdoClient",
    options: "CanopenOptions",
    rpdos: Sequence[PdoRecord],
    means: Sequence[Means],
    reaction: str,
    leaves: str,
) -> str:
    """Return what watches the daemon; raise a `DriveError` if nothing does, and that is not accepted."""
    if means:
        listed = ", ".join(map(str, means))
        text = f"the drive watches the daemon by {listed}; a loss is {reaction or leaves} ({NOT_TRIED}"
        if not reaction:
            text += f": the drive has no {objects.ABORT_CONNECTION_OPTION}, and whether leaving Operational stops it "
            text += "has not been seen; friction-hil doctor --try-watchdog shows it"
        return f"{text})"
    if options.is_watchdog_required:
        known = reaction or leaves
        causes = "; ".join(_missing_means(access, rpdos, reaction)) if known else _missing_reaction(access)
        text = f"{access.axis}: {access.where} cannot watch the daemon: {causes}. If the daemon dies, its "
        fix = "Set is_watchdog_required: false to accept that"
        raise DriveError(f"{text}torque stays. {fix}", code=codes.NO_WATCHDOG)
    return "the drive does NOT watch the daemon: if the daemon dies, its last torque stays"


def _missing_reaction(access: "SdoClient") -> str:
    """Return why the loss of the daemon is known to have no effect, whatever watches it."""
    known = (cia301.CONSUMER_HEARTBEAT_COUNT, cia301.GUARD_TIME)
    means = [entry.place for entry in known if access.find(entry) is not None]
    found = f"{' and '.join(means)} could watch it" if means else "it has neither 1016h nor 100Ch"
    reactions = [_state(access, entry) for entry in (objects.ABORT_CONNECTION_OPTION, _ERROR_BEHAVIOUR)]
    return f"{found}, but nothing says what its loss does: {', '.join(reactions)}"


def _missing_means(access: "SdoClient", rpdos: Sequence[PdoRecord], reaction: str) -> Iterator[str]:
    """Yield for each means why the drive does not watch by it."""
    if not reaction:
        yield f"a timer of an RPDO has no effect without 6007h: {_state(access, objects.ABORT_CONNECTION_OPTION)}"
    elif timed := [record for record in rpdos if access.find(record.event_timer) is not None]:
        tried = [entry for record in timed for entry in (record.transmission_type, record.event_timer)]
        tried += [record.mapping(position) for record in timed for position in (0, 1)]
        refusals = [f"{entry.place} {why}" for entry in tried if (why := access.why_not_written(entry))]
        yield f"no event-driven RPDO with a timer: {', '.join(refusals) or 'none is free'}"
    else:
        yield "no RPDO has a timer (1400h:05)"
    count = access.find(cia301.CONSUMER_HEARTBEAT_COUNT)
    if count:
        refused = []
        for entry in cia301.consumer_heartbeats(count):
            why = access.why_not_written(entry)
            if not why and access.find(entry) is None:
                why = "cannot be read, and is left as it is"
            refused += [f"{entry.place} {why}"] if why else []
        more = f", and {len(refused) - 1} more" if len(refused) > 1 else ""
        yield f"{refused[0]}{more}" if refused else "no entry of 1016h is free"
    else:
        yield _state(access, cia301.CONSUMER_HEARTBEAT_COUNT)
    yield ", ".join(_state(access, entry) for entry in (cia301.GUARD_TIME, cia301.LIFE_TIME_FACTOR))


def _state(access: "SdoClient", entry: Object) -> str:
    """Return what stands in the way at an object: that it is missing, hidden, or refuses what was written."""
    found, refusal = access.find(entry), access.why_not_written(entry)
    if found is None and (hidden := access.why_absent(entry)) == "lacks":
        return f"no {entry.index:04X}h"
    if refusal:
        return f"{entry.place} {refusal}"
    return f"{entry.place} {hidden}" if found is None else f"{entry.place} = {found}"


def _reaction(access: "SdoClient") -> str:
    """Let the drive react to a lost connection; return the reaction in words, "" if that is not known."""
    entry = objects.ABORT_CONNECTION_OPTION
    found = 1 if access.try_write(entry, 1) else access.find(entry)
    return f"{_REACTIONS[found]} (6007h = {found})" if found in _REACTIONS else ""


def _leaves_operational(access: "SdoClient") -> str:
    """Return how a drive without 6007h leaves Operational when a heartbeat is lost, "" if it does not say so."""
    entry = _ERROR_BEHAVIOUR
    found = access.find(entry)
    if found == 1 and access.try_write(entry, 0):
        found = 0
    return f"NMT {_LEAVES_OPERATIONAL[found]} (1029h:01 = {found})" if found in _LEAVES_OPERATIONAL else ""


def _arm_rpdo(
    access: "SdoClient", times: WatchdogTimes, command: RpdoPlace, free: Sequence[RpdoPlace]
) -> tuple[int, bool, list[Means]]:
    """Set up an event-driven RPDO; return its identifier (0: RPDO 1 or none), whether it is RPDO 1, and it."""
    for record, identifier in reversed(free):
        if held_ms := _set_up_feed(access, record, identifier, times.timer_ms):
            return identifier, False, [Means("rpdo", record.name, held_ms)]
    if held_ms := _make_event_driven(access, *command, times.timer_ms):
        return 0, True, [Means("rpdo", command[0].name, held_ms)]
    # some drives look at it without SYNC too: it is set, and does not count
    access.try_write(command[0].event_timer, times.timer_ms)
    return 0, False, []


def _arm_heartbeat(access: "SdoClient", master: int, times: WatchdogTimes) -> tuple[list[Means], list[str]]:
    """Let the drive watch the daemon's heartbeat by an entry of 1016h that is free; return it, and notes."""
    entries = cia301.consumer_heartbeats(access.find(cia301.CONSUMER_HEARTBEAT_COUNT) or 0)
    held = {entry: access.find(entry) for entry in entries}
    # one that cannot be read is left alone: it could not be restored, and the drive would miss the daemon afterwards
    found = {entry: value for entry, value in held.items() if value is not None}
    notes = []
    free = [entry for entry, value in found.items() if not all(cia301.watched_node(value))]
    for entry, value in found.items():
        node, time_ms = cia301.watched_node(value)
        if node == master:
            free = [entry]  # CiA 301 allows one entry for a node
        elif node and time_ms:
            text = f"{entry} is {value:08X}h: the drive watches node {node} too, within {time_ms} ms; it is kept"
            notes.append(text)
    if not free:
        return [], [*notes, "no entry of 1016h is free for the daemon"] if entries else []
    for entry in free:
        if held_ms := _write_time(access, entry, times.loss_ms, master << 16):
            return [Means("heartbeat", f"heartbeat (1016h:{entry.subindex:02X})", held_ms)], notes
    return [], notes


def _arm_guarding(access: "SdoClient", times: WatchdogTimes) -> list[Means]:
    """Let the drive watch for the daemon's remote frames; return it, nothing where it has no life guarding."""
    if access.find(cia301.GUARD_TIME) is None or access.find(cia301.LIFE_TIME_FACTOR) is None:
        return []
    if access.find(cia301.PRODUCER_HEARTBEAT) and not access.try_write(cia301.PRODUCER_HEARTBEAT, 0):
        return []  # CiA 301: a node that produces heartbeats is not guarded
    held_ms = _write_time(access, cia301.GUARD_TIME, times.guard_ms)
    if not (held_ms and access.try_write(cia301.LIFE_TIME_FACTOR, times.guards_to_loss)):
        access.try_write(cia301.GUARD_TIME, 0)
        return []
    return [Means("guarding", "node guarding (100Ch, 100Dh)", times.guards_to_loss * held_ms)]


def _set_up_feed(access: "SdoClient", record: PdoRecord, identifier: int, timer_ms: int) -> int:
    """Let an RPDO carry the controlword alone, with a timer; return the timer's time, 0 if the drive refuses."""
    if access.find(record.cob_id) is None or access.find(record.event_timer) is None:
        return 0
    held_ms = 0
    word = record.word(objects.CONTROLWORD, objects.CONTROLWORD.type.bits)
    is_ready = (
        _holds_cob_id(access, record, cia301.PDO_INVALID | identifier)
        and _maps(access, record, word)
        and any(access.try_write(record.transmission_type, kind) for kind in _EVENT_DRIVEN)
        and (held_ms := _write_time(access, record.event_timer, timer_ms))
        and _holds_cob_id(access, record, identifier)
    )
    if not is_ready:
        _holds_cob_id(access, record, cia301.PDO_INVALID | identifier)
        return 0
    return held_ms


def _make_event_driven(access: "SdoClient", record: PdoRecord, identifier: int, timer_ms: int) -> int:
    """Give the RPDO of the commands a timer that does not depend on SYNC; without success, 0, it is as before."""
    if access.find(record.event_timer) is None:
        return 0
    before = access.find(record.transmission_type)
    _holds_cob_id(access, record, cia301.PDO_INVALID | identifier)
    is_event_driven = any(access.try_write(record.transmission_type, kind) for kind in _EVENT_DRIVEN)
    held_ms = _write_time(access, record.event_timer, timer_ms) if is_event_driven else 0
    if not held_ms and before is not None:
        access.try_write(record.transmission_type, before)
    access.write(record.cob_id, identifier)
    return held_ms


def _maps(access: "SdoClient", record: PdoRecord, word: int) -> bool:
    """Let an RPDO carry one object alone, unless it does; return True if it does."""
    if access.find(record.mapping(0)) == 1 and access.find(record.mapping(1)) == word:
        return True
    return all(access.try_write(entry, value) for entry, value in record.mapping_steps([word]))


def _holds_cob_id(access: "SdoClient", record: PdoRecord, value: int) -> bool:
    """Write the COB-ID of an RPDO; other bits than those of the identifier and of its validity are the drive's."""
    relevant = cia301.PDO_INVALID | 0x7FF
    access.try_write(record.cob_id, value)
    found = access.find(record.cob_id)
    return found is not None and found & relevant == value & relevant


def _write_time(access: "SdoClient", entry: Object, wanted_ms: int, further: int = 0) -> int:
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
