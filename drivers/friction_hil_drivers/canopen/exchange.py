"""The cyclic phase: SYNC, feedback of every drive, command to every drive, in one thread."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from friction_hil.drive import Clock, Command, Feedback, Request
from friction_hil.errors import DriveError
from friction_hil_drivers.canopen import codes, objects
from friction_hil_drivers.canopen.axis import CanopenAxis

if TYPE_CHECKING:
    from friction_hil_drivers.canopen.frames import FrameBus

_COMMAND_FRACTION = 0.25  # of the period, kept for computing and sending what acts from the next SYNC on
_OPERATIONAL = bytes([objects.NmtState.OPERATIONAL])

# In simulated time nothing but these would ever end a run without drives.
STEPPED_TIMEOUT_S = 10.0
STEPPED_TIMEOUTS = 3  # in a row


class CyclicExchange:
    """Frames of every cycle between the daemon and its drives.

    Parameters
    ----------
    bus : FrameBus
        Nothing else may read or write it during the cyclic phase.
    axes : sequence of CanopenAxis
    clock : Clock
    period_s : float
        Period of the cycle, s.
    heartbeat_s : float
        Period of the daemon's heartbeat, s.
    master_node : int
        Node number under which the daemon sends it.
    dry_run : bool
        Send SYNC and nothing else.
    """

    def __init__(
        self,
        bus: "FrameBus",
        axes: Sequence[CanopenAxis],
        clock: Clock,
        *,
        period_s: float,
        heartbeat_s: float,
        master_node: int,
        dry_run: bool,
    ) -> None:
        self._bus = bus
        self._axes = axes
        self._clock = clock
        self._dry_run = dry_run
        self._reserve_ns = round(_COMMAND_FRACTION * period_s * 1e9)
        self._handlers = {can_id: handler for axis in axes for can_id, handler in axis.handlers.items()}
        self._heartbeat_id = objects.HEARTBEAT_BASE + master_node
        self._heartbeat_ns = round(heartbeat_s * 1e9)
        self._next_heartbeat_ns = 0
        self._timeouts = 0  # incomplete cycles in a row, in simulated time
        self._spare = axes[0].copy()
        self._spare_feedback, self._spare_command = Feedback(), Command(Request.ENABLE)

    def start(self) -> None:
        """Begin the cyclic phase: the drives watch the daemon's heartbeat from its first one on."""
        now = self._clock.now_ns()
        for axis in self._axes:
            axis.start(now)
        self._send_heartbeat(now)

    def receive(self, feedback: Sequence[Feedback], end_ns: int) -> None:
        """Send SYNC and collect the feedback of every drive until it is complete, or too late for this cycle.

        Parameters
        ----------
        feedback : sequence of Feedback
            Overwritten, one for each axis.
        end_ns : int
            Time of the next SYNC.
        """
        self._take_waiting_frames()
        now = self._clock.now_ns()
        for axis in self._axes:
            axis.begin_cycle(now)
        self._bus.send(objects.SYNC_ID, b"")
        self._collect(end_ns - self._reserve_ns)
        if not self._clock.is_real:
            self._require_answers()
        for axis, target in zip(self._axes, feedback, strict=True):
            axis.report(target, now)

    def send(self, commands: Sequence[Command]) -> None:
        """Send one command to each axis, and the daemon's heartbeat when it is due; a dry run sends nothing."""
        if not self._dry_run:
            for axis, command in zip(self._axes, commands, strict=True):
                if command.request is not Request.LISTEN:
                    for frame in axis.encode(command):
                        self._bus.send(*frame)
        now = self._clock.now_ns()
        if now >= self._next_heartbeat_ns:
            self._send_heartbeat(now)

    def warm_caches(self) -> None:
        """Decode and encode as in a cycle, on a copy of the first axis; nothing is sent."""
        axis, now = self._spare, self._next_heartbeat_ns
        axis.begin_cycle(now)
        for tpdo in axis.tpdos:
            axis.handlers[tpdo.cob_id](bytes(tpdo.layout.size))
        axis.report(self._spare_feedback, now)
        if not self._dry_run:
            axis.encode(self._spare_command)

    def _take_waiting_frames(self) -> None:
        """Take emergencies, heartbeats and late feedback that arrived since the last cycle."""
        while (frame := self._bus.receive(0.0)) is not None:
            handler = self._handlers.get(frame[0])
            if handler is not None:
                handler(frame[1])

    def _collect(self, deadline_ns: int) -> None:
        """Take frames until every axis is complete; in simulated time for as long as the bus waits."""
        clock, receive, handlers = self._clock, self._bus.receive, self._handlers
        for axis in self._axes:
            while not axis.is_complete:
                timeout = (deadline_ns - clock.now_ns()) * 1e-9 if clock.is_real else STEPPED_TIMEOUT_S
                if timeout <= 0.0:
                    return
                frame = receive(timeout)
                if frame is not None:
                    handler = handlers.get(frame[0])
                    if handler is not None:  # else a frame of another node
                        handler(frame[1])
                elif not clock.is_real:
                    return

    def _require_answers(self) -> None:
        """End a run in simulated time whose drives have stopped answering.

        Raises
        ------
        DriveError
            Several cycles in a row were incomplete.
        """
        is_complete = all(axis.is_complete for axis in self._axes)
        self._timeouts = 0 if is_complete else self._timeouts + 1
        if self._timeouts >= STEPPED_TIMEOUTS:
            waited_s = STEPPED_TIMEOUTS * STEPPED_TIMEOUT_S
            text = f"not every drive has answered SYNC for {waited_s:g} s: are they still running?"
            raise DriveError(text, code=codes.SYNC_NOT_ANSWERED)

    def _send_heartbeat(self, now: int) -> None:
        if not self._dry_run:
            self._bus.send(self._heartbeat_id, _OPERATIONAL)
        self._next_heartbeat_ns = now + self._heartbeat_ns
