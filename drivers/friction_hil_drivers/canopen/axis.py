"""One drive in the cyclic phase: its frames decoded into feedback, its commands encoded. No bus, no clock."""

import struct
from collections.abc import Callable, Mapping

from friction_hil.drive import Command, DriveState, Feedback, Mode, Request
from friction_hil.errors import DriveError
from friction_hil_drivers.canopen import objects
from friction_hil_drivers.canopen.configure import ConfiguredDrive
from friction_hil_drivers.canopen.frames import Frame
from friction_hil_drivers.canopen.mapping import MappedPdo
from friction_hil_drivers.canopen.units import Unwrapper
from friction_hil_drivers.cia402 import profile

Handler = Callable[[bytes], bool]  # takes a frame's data; whether it is feedback of this cycle that was missing

_HEARTBEATS_TO_LOSS = 3
_EMERGENCY = struct.Struct("<HB")
_NMT_NAMES = {state.value: state.name.lower().replace("_", "-") for state in objects.NmtState}


class CanopenAxis:
    """Decodes and encodes the frames of one drive.

    Parameters
    ----------
    drive : ConfiguredDrive
        What the configuration found and mapped.
    node : int
        Its node number.
    heartbeat_s : float
        Period of the drive's heartbeat, s; three missing ones are a loss.
    """

    def __init__(self, drive: ConfiguredDrive, node: int, heartbeat_s: float) -> None:
        self._drive = drive
        self._heartbeat_s = heartbeat_s
        self.facts = drive.facts
        self.node = node
        self._units = drive.units
        self._mode = drive.mode
        self.tpdos = drive.tpdos
        self._rpdo = drive.rpdo
        self._heartbeat_loss_ns = round(_HEARTBEATS_TO_LOSS * heartbeat_s * 1e9)
        self._unwrapper = Unwrapper()
        self._controlword = profile.DISABLE_VOLTAGE

        self._all = (1 << len(drive.tpdos)) - 1
        self._arrived = 0
        self._received = [b"" for _ in drive.tpdos]
        self._state = DriveState.UNKNOWN
        self._position = self._velocity = self._torque = 0.0
        self._error = drive.error
        self._message = ""
        self._has_heartbeat = False
        self._heard_ns = 0
        self._now_ns = 0
        self.handlers = self._make_handlers()  # what to do with the data of a frame, by its identifier

    @property
    def pdos(self) -> tuple[MappedPdo, ...]:
        """All PDOs of a cycle."""
        return self.tpdos if self._rpdo is None else (*self.tpdos, self._rpdo)

    def double(self) -> "CanopenAxis":
        """Another decoder of the same drive."""
        return CanopenAxis(self._drive, self.node, self._heartbeat_s)

    def _make_handlers(self) -> Mapping[int, Handler]:

        def store(number: int, size: int) -> Handler:
            bit = 1 << number

            def handle(data: bytes) -> bool:
                is_new = len(data) >= size and not self._arrived & bit
                if is_new:
                    self._received[number] = data
                    self._arrived |= bit
                return is_new

            return handle

        table = {pdo.cob_id: store(number, pdo.layout.size) for number, pdo in enumerate(self.tpdos)}
        table[objects.EMERGENCY_BASE + self.node] = self._on_emergency
        table[objects.HEARTBEAT_BASE + self.node] = self._on_heartbeat
        return table

    def begin(self, now_ns: int) -> None:
        """Start watching; the first heartbeat may take its time."""
        self._heard_ns = self._now_ns = now_ns

    def expect(self, now_ns: int) -> int:
        """Forget what arrived before this cycle's SYNC; how many frames are to come."""
        self._arrived = 0
        self._now_ns = now_ns
        return len(self.tpdos)

    def fill(self, feedback: Feedback, now_ns: int) -> None:
        """Decode what arrived; without all of it the values stay those of the last complete cycle."""
        is_fresh = self._arrived == self._all
        if is_fresh:
            statusword, counts, torque = self.tpdos[0].layout.unpack_from(self._received[0])
            velocity, mode = self.tpdos[1].layout.unpack_from(self._received[1])
            units = self._units
            self._state = profile.drive_state(statusword)
            self._position = self._unwrapper.total(counts) / units.counts_per_unit
            self._velocity = velocity / units.velocity_per_unit
            self._torque = units.torque(torque)
            if self._state is DriveState.OPERATION_ENABLED and self._rpdo is not None and mode != self._mode:
                self._message = f"the drive is in mode {mode} and not in {self._mode.name} ({self._mode.value})"
        if self._has_heartbeat and now_ns - self._heard_ns > self._heartbeat_loss_ns:
            loss_ms = self._heartbeat_loss_ns / 1e6
            self._message = f"no heartbeat from node {self.node} for more than {loss_ms:.0f} ms"
        feedback.position = self._position
        feedback.velocity = self._velocity
        feedback.torque = self._torque
        feedback.state = self._state
        feedback.is_fresh = is_fresh
        feedback.error = self._error
        feedback.message = self._message

    def command_frame(self, command: Command) -> Frame:
        """Encode a command into this drive's RPDO.

        Raises
        ------
        ValueError
            A value is not finite.
        """
        rpdo, units = self._rpdo, self._units
        if rpdo is None:
            raise DriveError(f"{self.facts.name}: a drive that is only listened to gets no command")
        word = self._controlword = self._next_controlword(command.request)
        torque = units.torque_per_mille(command.torque)
        if self._mode is Mode.CSP:
            return rpdo.cob_id, rpdo.layout.pack(word, units.position_counts(command.position), torque)
        if self._mode is Mode.CSV:
            return rpdo.cob_id, rpdo.layout.pack(word, units.velocity_increments(command.velocity), torque)
        return rpdo.cob_id, rpdo.layout.pack(word, torque)

    def _next_controlword(self, request: Request) -> int:
        if request is not Request.RESET_FAULT:
            return profile.next_controlword(self._state, request)
        return profile.reset_controlword(self._state, self._controlword)

    def _on_emergency(self, data: bytes) -> bool:
        if len(data) >= _EMERGENCY.size:  # some drives send shorter ones
            code = _EMERGENCY.unpack_from(data)[0]
            self._error = profile.error_text(code) if code else ""
        return False

    def _on_heartbeat(self, data: bytes) -> bool:
        if not data:
            return False
        state = data[0] & 0x7F
        if state == objects.NmtState.BOOT_UP:
            self._message = f"node {self.node} restarted (boot-up message)"
        elif state != objects.NmtState.OPERATIONAL and self._has_heartbeat:
            self._message = f"node {self.node} left Operational: it is {_NMT_NAMES.get(state, state)}"
        elif state == objects.NmtState.OPERATIONAL:
            self._has_heartbeat = True
            self._heard_ns = self._now_ns
        return False
