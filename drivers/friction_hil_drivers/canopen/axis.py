"""One drive in the cyclic phase: what it last reported, and what it is commanded. No bus, no clock.

A cycle is `begin_cycle`, the frames through `handlers`, `report`, `encode`, in this order.
"""

from collections.abc import Callable, Mapping
from functools import partial

from friction_hil.drive import Command, DriveState, Feedback
from friction_hil.drive.codes import coded
from friction_hil.errors import DriveError
from friction_hil_drivers.canopen import codes, objects
from friction_hil_drivers.canopen.codec import (
    CommandEncoder,
    FeedbackDecoder,
    Frame,
    Measurement,
    decode_emergency,
    decode_heartbeat,
    next_controlword,
)
from friction_hil_drivers.canopen.configure import ConfiguredDrive
from friction_hil_drivers.canopen.mapping import MappedPdo
from friction_hil_drivers.canopen.monitor import NodeMonitor
from friction_hil_drivers.cia402 import profile

Handler = Callable[[bytes], None]  # takes the data of a frame


class CanopenAxis:
    """State of one drive from cycle to cycle.

    Parameters
    ----------
    drive : ConfiguredDrive
        Result of the configuration.
    node : int
        Node number of the drive.
    heartbeat_s : float
        Period of the drive's heartbeat, s; three missing ones are a loss.

    Attributes
    ----------
    handlers : mapping of int to callable
        By identifier: takes the data of a frame of this drive.
    is_complete : bool
        Every TPDO of this cycle arrived.
    """

    def __init__(self, drive: ConfiguredDrive, node: int, heartbeat_s: float) -> None:
        self._drive = drive
        self._heartbeat_s = heartbeat_s
        self.facts = drive.facts
        self.node = node
        self.tpdos = drive.tpdos
        self._monitor = NodeMonitor(node, heartbeat_s)
        self._now_ns = 0
        self._decoder = FeedbackDecoder(drive.tpdos, drive.units, drive.mode, drive.period_s)
        self._encoder = CommandEncoder(drive.rpdos, drive.mode, drive.units)
        self._frames = [b""] * len(drive.tpdos)  # TPDOs of this cycle; empty: not arrived
        self.is_complete = False
        self._short = ""  # a TPDO of this cycle had too few bytes
        self._measured = Measurement()  # of the last complete cycle
        self._age_cycles = 0  # cycles since then
        self._error = drive.error
        self._message = ""
        self._controlword = profile.DISABLE_VOLTAGE
        self.handlers = self._make_handlers()

    def _make_handlers(self) -> Mapping[int, Handler]:
        handlers: dict[int, Handler] = {
            pdo.cob_id: partial(self._on_tpdo, number) for number, pdo in enumerate(self.tpdos)
        }
        handlers[objects.EMERGENCY_BASE + self.node] = self._on_emergency
        handlers[objects.HEARTBEAT_BASE + self.node] = self._on_heartbeat
        return handlers

    @property
    def pdos(self) -> tuple[MappedPdo, ...]:
        """All PDOs of a cycle."""
        return (*self.tpdos, *self._drive.rpdos)

    def copy(self) -> "CanopenAxis":
        """Return another axis for the same drive, as it was before its first cycle."""
        return CanopenAxis(self._drive, self.node, self._heartbeat_s)

    def start(self, now_ns: int) -> None:
        """Begin the cyclic phase."""
        self._now_ns = now_ns

    def begin_cycle(self, now_ns: int) -> None:
        """Forget the TPDOs that arrived before this cycle's SYNC."""
        self._now_ns = now_ns
        self._frames = [b""] * len(self.tpdos)
        self.is_complete = False
        self._short = ""
        self._age_cycles += 1

    def _on_tpdo(self, number: int, data: bytes) -> None:
        size = self.tpdos[number].layout.size
        if len(data) < size:
            self._short = f"TPDO {number + 1} of node {self.node} has {len(data)} bytes instead of {size}"
        elif not self._frames[number]:
            self._frames[number] = data
            self.is_complete = all(self._frames)

    def _on_emergency(self, data: bytes) -> None:
        error = decode_emergency(data)
        if error is not None:
            self._error = error

    def _on_heartbeat(self, data: bytes) -> None:
        state = decode_heartbeat(data)
        if state is not None:
            self._message = self._monitor.take(state, self._now_ns) or self._message

    def report(self, feedback: Feedback, now_ns: int) -> None:
        """Write the drive's feedback; without all TPDOs the values stay those of the last complete cycle."""
        is_fresh = self.is_complete
        if is_fresh:
            self._measured = self._decoder.decode(self._frames, self._measured, self._age_cycles)
            self._age_cycles = 0
            self._message = self._wrong_mode() or self._message
        # the latest fault is kept: each of these ends the run, even if its cause goes away
        self._message = self._monitor.check(now_ns) or self._message
        measured = self._measured
        feedback.position = measured.position
        feedback.velocity = measured.velocity
        feedback.torque = measured.torque
        feedback.state = measured.state
        feedback.is_fresh = is_fresh
        feedback.missing = "" if is_fresh else self._missing()
        feedback.error = self._error
        feedback.message = self._message

    def encode(self, command: Command) -> list[Frame]:
        """Encode a command for the drive's RPDOs.

        Raises
        ------
        ValueError
            A value is not finite.
        DriveError
            The axis is only listened to.
        """
        if not self._drive.rpdos:
            raise DriveError(f"{self.facts.name}: a drive that is only listened to gets no command")
        self._controlword = next_controlword(self._measured.state, command.request, self._controlword)
        return self._encoder.encode(self._controlword, command)

    def _wrong_mode(self) -> str:
        """Fault of an enabled drive that is not in the mode that was set, "" for none."""
        mode, found = self._drive.mode, self._measured.mode
        if self._measured.state is not DriveState.OPERATION_ENABLED or not self._drive.rpdos or found == mode:
            return ""
        return coded(f"the drive is in mode {found} and not in {mode.name} ({mode.value})", codes.WRONG_MODE)

    def _missing(self) -> str:
        """Why the feedback of this cycle is not complete."""
        lost = [f"TPDO {number + 1}" for number, data in enumerate(self._frames) if not data]
        return self._short or f"{' and '.join(lost)} of node {self.node} did not arrive in time"
