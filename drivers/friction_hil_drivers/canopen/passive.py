"""Listening to drives that another master moves: its SYNC, their TPDOs as they are mapped; nothing is sent."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING

from friction_hil.drive import Clock, Command, Feedback
from friction_hil.errors import DriveError
from friction_hil_drivers.canopen import codes, objects
from friction_hil_drivers.canopen.codec import FeedbackDecoder, Measurement, emergency_code, emergency_text
from friction_hil_drivers.canopen.exchange import STEPPED_TIMEOUT_S, STEPPED_TIMEOUTS
from friction_hil_drivers.cia402 import profile

if TYPE_CHECKING:
    from friction_hil_drivers.canopen.configure import ConfiguredDrive
    from friction_hil_drivers.canopen.frames import FrameBus

_RESERVE_FRACTION = 0.25  # of the period, kept for computing


class PassiveAxis:
    """Feedback of one drive from TPDOs that come when another master wants them. No bus, no clock.

    A set is complete when every TPDO has come; where they come with SYNC, a SYNC begins a new set, so that the values
    of a set are of one instant.

    Parameters
    ----------
    drive : ConfiguredDrive
    node : int
    """

    def __init__(self, drive: "ConfiguredDrive", node: int) -> None:
        self._tpdos = drive.tpdos
        self._is_synchronous = any(pdo.is_synchronous for pdo in drive.tpdos)
        self._decoder = FeedbackDecoder(drive.tpdos, drive.units, drive.mode, drive.period_s)
        self._node = node
        self._error = drive.error
        self._frames = [b""] * len(drive.tpdos)
        self._measured = Measurement()
        self._cycles = 0  # since the last complete set
        self._notices: list[str] = []
        self.handlers: dict[int, Callable[[bytes], None]] = {
            pdo.cob_id: partial(self._on_tpdo, slot) for slot, pdo in enumerate(drive.tpdos)
        }
        self.handlers[objects.EMERGENCY_BASE + node] = self._on_emergency

    @property
    def is_complete(self) -> bool:
        """True once every TPDO of a set came."""
        return all(self._frames)

    def on_sync(self) -> None:
        """Begin a new set; one that is complete waits until it is reported."""
        if self._is_synchronous and not self.is_complete:
            self._frames = [b""] * len(self._tpdos)

    def _on_tpdo(self, slot: int, data: bytes) -> None:
        if len(data) >= self._tpdos[slot].layout.size:
            self._frames[slot] = data

    def _on_emergency(self, data: bytes) -> None:
        self._notices.append(f"node {self._node}: {emergency_text(data)}")
        if code := emergency_code(data):
            self._error = profile.error_text(code)

    def report(self, feedback: Feedback) -> None:
        """Write the drive's feedback of this cycle."""
        self._cycles += 1
        feedback.is_fresh = self.is_complete
        feedback.missing = ""
        if self.is_complete:
            measured = self._measured = self._decoder.decode(self._frames, self._measured, self._cycles)
            self._frames = [b""] * len(self._tpdos)
            self._cycles = 0
            feedback.position, feedback.velocity = measured.position, measured.velocity
            feedback.torque, feedback.state = measured.torque, measured.state
        else:
            late = [f"TPDO {pdo.number + 1}" for pdo, data in zip(self._tpdos, self._frames, strict=True) if not data]
            feedback.missing = f"{' and '.join(late)} of node {self._node} did not come: its master has stopped?"
        feedback.error, feedback.message = self._error, ""
        feedback.notices += self._notices
        self._notices.clear()


class PassiveExchange:
    """The cyclic phase of a dry run beside another master; see `exchange.CyclicExchange`.

    Parameters
    ----------
    bus : FrameBus
    axes : sequence of PassiveAxis
    clock : Clock
    period_s : float
    """

    def __init__(self, bus: "FrameBus", axes: Sequence[PassiveAxis], clock: Clock, *, period_s: float) -> None:
        self._bus = bus
        self._axes = axes
        self._clock = clock
        self._reserve_ns = round(_RESERVE_FRACTION * period_s * 1e9)
        self._handlers = {can_id: handler for axis in axes for can_id, handler in axis.handlers.items()}
        self._handlers[objects.SYNC_ID] = self._on_sync
        self._timeouts = 0

    def start(self) -> None:
        """Begin the cyclic phase: nothing is to be done for it."""

    def send(self, commands: Sequence[Command]) -> None:
        """Send nothing."""

    def warm_caches(self) -> None:
        """Do nothing: no deadline of another master is missed by a late listener."""

    def receive(self, feedback: Sequence[Feedback], end_ns: int) -> None:
        """Take what the drives have sent, and what they send until shortly before the end of the cycle.

        Raises
        ------
        DriveError
            In simulated time, whose cycles are those of the other master, nothing came for a long time.
        """
        while (frame := self._bus.receive(0.0)) is not None:
            self._take(*frame)
        deadline_ns = end_ns - self._reserve_ns
        while not all(axis.is_complete for axis in self._axes):
            is_real = self._clock.is_real
            timeout = (deadline_ns - self._clock.now_ns()) * 1e-9 if is_real else STEPPED_TIMEOUT_S
            frame = self._bus.receive(timeout) if timeout > 0.0 else None
            if frame is not None:
                self._take(*frame)
            elif not is_real or timeout <= 0.0:
                break
        if not self._clock.is_real:
            self._require_frames()
        for axis, target in zip(self._axes, feedback, strict=True):
            axis.report(target)

    def _take(self, can_id: int, data: bytes) -> None:
        handler = self._handlers.get(can_id)
        if handler is not None:
            handler(data)

    def _on_sync(self, _: bytes) -> None:
        for axis in self._axes:
            axis.on_sync()

    def _require_frames(self) -> None:
        is_complete = all(axis.is_complete for axis in self._axes)
        self._timeouts = 0 if is_complete else self._timeouts + 1
        if self._timeouts >= STEPPED_TIMEOUTS:
            text = f"not every drive has sent its TPDOs for {STEPPED_TIMEOUTS * STEPPED_TIMEOUT_S:g} s"
            raise DriveError(text, code=codes.NOTHING_TO_HEAR)
