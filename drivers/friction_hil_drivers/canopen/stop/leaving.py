"""Leaving drives: without power, and as they were found."""

import contextlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

from friction_hil.drive import Clock, DriveState
from friction_hil.drive.codes import coded
from friction_hil.errors import BusError, DriveError
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.sdo.conversation import PATIENCE_S, Conversation
from friction_hil_drivers.canopen.stop.by_sdo import disable_axes
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.canopen.wire.cia301 import decode_heartbeat
from friction_hil_drivers.canopen.wire.queue_full import QueueFullError
from friction_hil_drivers.cia402 import objects, profile

if TYPE_CHECKING:
    from friction_hil_drivers.canopen.sdo.client import SdoClient
    from friction_hil_drivers.canopen.stop.last_frames import LastFrames
    from friction_hil_drivers.canopen.wire.cia301 import Frame
    from friction_hil_drivers.canopen.wire.frames import FrameBus

_ATTEMPTS = 2  # within the patience: the same controlword again is harmless, and a frame may have been lost
_UNKNOWN = DriveState.UNKNOWN


def watchdog_frames(bus: "FrameBus", frames: "LastFrames", clock: Clock) -> Callable[[], float]:
    """Return a function that sends the frames that are due, and returns the time until the next one, s."""

    def send() -> float:
        now = clock.now_ns()
        for can_id, data in frames.due(now):
            # the next one is due soon, and a drive that misses several trips, as it should
            with contextlib.suppress(QueueFullError):
                if data is None:
                    bus.send_remote(can_id, 1)
                else:
                    bus.send(can_id, data)
        return frames.wait_s(now)

    return send


def switch_off(
    bus: "FrameBus",
    axes: Sequence[tuple[str, int, int]],  # as for `disable`
    meanwhile: Callable[[], float] | None,
    frames: "LastFrames | None",  # that the drives wait for meanwhile
    # as the TPDOs have just shown; counts where a node is still there, and only its SDO server is too slow
    told: Mapping[str, DriveState],
) -> tuple[dict[str, DriveState], BusError | None]:
    """Disable every drive, and stop the exchange of PDOs.

    A drive that does not answer, or keeps its power, goes on watching: it trips when the daemon is silent. In
    Pre-operational it would react as to a lost connection, so it is disabled first.

    Returns the state of each axis as read back, UNKNOWN where it was not, and why a node could not be sent to
    Pre-operational, if one could not: the other drives come first.
    """
    # the last RPDO would take effect at the next SYNC, which is not sent any more; this does at once
    while bus.receive(0.0) is not None:
        pass  # of before: it says nothing of now
    heard = _Heard()
    states = disable(bus, axes, meanwhile, heard.take)
    for name, node, _ in axes:
        if states[name] is _UNKNOWN and node in heard.nodes and told.get(name, _UNKNOWN).is_unpowered:
            states[name] = told[name]
    failure: BusError | None = None
    for node in dict.fromkeys(node for _, node, _ in axes):
        try:
            send_nmt(bus, cia301.NmtCommand.ENTER_PRE_OPERATIONAL, node)
        except BusError as error:
            failure = error  # the node goes on waiting for RPDOs
        else:
            if frames is not None:
                frames.left_operational(node)
    _note(frames, states)
    if unanswered := [axis for axis in axes if states[axis[0]] is _UNKNOWN]:
        # where the node was in the NMT state Stopped, it has SDO again
        states |= disable(bus, unanswered, meanwhile)
        _note(frames, states)
    return states, failure


class _Heard:
    """Nodes that have sent something since they were disabled, and have not restarted since."""

    def __init__(self) -> None:
        self.nodes: set[int] = set()

    def take(self, frame: "Frame") -> None:
        """Take a frame of the bus."""
        can_id, data = frame
        if cia301.HEARTBEAT_BASE < can_id <= cia301.HEARTBEAT_BASE + 127:
            node, is_there = can_id - cia301.HEARTBEAT_BASE, decode_heartbeat(data) != cia301.NmtState.BOOT_UP
            self.nodes = self.nodes | {node} if is_there else self.nodes - {node}
        elif cia301.SDO_RESPONSE_BASE < can_id <= cia301.SDO_RESPONSE_BASE + 127:
            self.nodes.add(can_id - cia301.SDO_RESPONSE_BASE)


def _note(frames: "LastFrames | None", states: dict[str, DriveState]) -> None:
    """Let the watchdogs trip where a drive was not read back without power."""
    if frames is not None:
        for name, state in states.items():
            frames.note(name, is_unpowered=state.is_unpowered)


def send_nmt(bus: "FrameBus", command: cia301.NmtCommand, node: int) -> None:
    """Send an NMT command to one node."""
    bus.send(cia301.NMT_ID, bytes((command, node)))


def disable(
    bus: "FrameBus",
    axes: Iterable[tuple[str, int, int]],  # name, node, number of the axis in its node
    meanwhile: Callable[[], float] | None = None,  # see `Conversation`, as for `heard`
    heard: Callable[["Frame"], None] | None = None,
) -> dict[str, DriveState]:
    """Write controlword 0 to drives and return what they report then, UNKNOWN where one does not answer.

    All nodes are asked at the same time, so that one that is gone does not hold up the others.
    """
    names: dict[int, dict[int, str]] = {}
    for name, node, number in axes:
        names.setdefault(node, {})[number] = name
    answer_s = PATIENCE_S / _ATTEMPTS
    talk = Conversation(bus, answer_s=answer_s, attempts=_ATTEMPTS, meanwhile=meanwhile, heard=heard)
    answers = talk.hold({node: disable_axes(list(numbers)) for node, numbers in names.items()})
    return {names[node][number]: state for node, states in answers.items() for number, state in states.items()}


def read_state(client: "SdoClient") -> DriveState:
    """Return the state that a drive reports, UNKNOWN where it does not answer."""
    try:
        return profile.drive_state(client.read(objects.STATUSWORD))
    except (DriveError, BusError):
        return DriveState.UNKNOWN


def restore(client: "SdoClient", state: DriveState | None = None) -> list[str]:
    """Write back what a drive held before; return what could not be restored, in messages.

    A drive that has power, or whose state is not known, is left as it is: its watchdogs among others must not be
    switched off.

    ``state``: as just read back; without it, the drive's state is read.
    """
    journal = client.journal
    if not journal or not journal.what_is_left():
        return []
    try:
        state = read_state(client) if state is None else state
        if state.is_unpowered:
            return [_message(client, text) for text in journal.restore()]
        reason = "the drive does not answer" if state is DriveState.UNKNOWN else f"its state is {state.words}"
    except (DriveError, BusError) as error:
        reason = error.detail.removeprefix(f"{client.axis}: ")
    return [_message(client, f"{', '.join(journal.what_is_left())}: {reason}")]


def _message(client: "SdoClient", text: str) -> str:
    return coded(f"{client.axis}: not restored in {client.where}: {text}", codes.NOT_RESTORED)
