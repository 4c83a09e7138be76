"""Health of one node: heartbeats, NMT state, emergencies, a second node with its number. No bus, no clock."""

from collections.abc import Callable
from enum import IntEnum

from friction_hil.drive import Feedback
from friction_hil.drive.codes import coded
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.connect.watchdog_times import HEARTBEATS_TO_LOSS
from friction_hil_drivers.canopen.cycle.twin_watch import TwinWatch
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.canopen.wire.cia301 import NmtState, decode_heartbeat
from friction_hil_drivers.cia402 import profile
from friction_hil_drivers.cia402.notices import Notices
from friction_hil_drivers.cia402.profile import emergency_code, emergency_text
from friction_hil_drivers.cia402.temperature import NEVER_NS

Handler = Callable[[bytes], object]  # takes the data of a frame

_STATE_NAMES = {state.value: state.name.lower().replace("_", "-") for state in NmtState}


class NodeCondition(IntEnum):
    """What the heartbeats say about a node."""

    GOOD = 0
    NOT_OPERATIONAL = 1  # its configuration is in force, but it ignores PDOs
    SILENT = 2  # no heartbeat
    RESTARTED = 3  # its configuration is lost; only a new start of the daemon ends this


_GOOD = NodeCondition.GOOD


class NodeHealth:
    """What a node says beside its feedback.

    A heartbeat in any state shows that the node is alive; a state other than Operational is a fault of its own. Its
    loss is a fault once a first heartbeat in Operational came. Without ``heartbeat_s``, the period of the node's
    heartbeat, another controller supervises the node: then a restart is a notice.
    """

    __slots__ = (
        "_is_supervised",
        "_left_ns",
        "condition",
        "error",
        "fault",
        "lost_ns",
        "nmt_state",
        "node",
        "notices",
        "now_ns",
        "patience_ns",
        "twin",
    )

    def __init__(self, node: int, error: str = "", heartbeat_s: float | None = None) -> None:
        self.node = node
        self.error = error  # why the drive is in fault, in words
        self.fault = ""  # the first one, which is the cause
        self.notices = Notices()
        self.twin = TwinWatch(node)
        self.condition = _GOOD
        self.nmt_state: int | None = None  # as the last heartbeat has it
        self._is_supervised = heartbeat_s is not None
        self.patience_ns = round(HEARTBEATS_TO_LOSS * (heartbeat_s or 0.0) * 1e9)
        self.lost_ns = NEVER_NS  # after which a missing heartbeat is a loss
        self.now_ns = 0  # of the cycle
        self._left_ns = 0  # when it was last heard outside of Operational

    @property
    def handlers(self) -> dict[int, Handler]:
        """What takes the data of a frame, by identifier."""
        return {
            cia301.EMERGENCY_BASE + self.node: self.take_emergency,
            cia301.HEARTBEAT_BASE + self.node: self.take_heartbeat,
        }

    def judge_twin(self) -> None:
        """Judge what came twice in the cycle before."""
        if fault := self.twin.judge():
            self.note_fault(fault)

    def note_fault(self, fault: str) -> None:
        """Keep the first fault, which is the cause; those that follow are notices."""
        if not self.fault:
            self.fault = fault
        elif fault != self.fault:
            self.notices.add(fault)

    def end_fault(self) -> None:
        """Forget a fault that was reported and is over; a second node is there as long as nobody takes it away."""
        if not self.twin.is_found:
            self.fault = ""

    def take_emergency(self, data: bytes) -> None:
        """Take an emergency message."""
        self.notices.tell(emergency_text(data))
        if code := emergency_code(data):  # 0000h does not say why the drive was in fault
            self.error = profile.error_text(code)

    def take_heartbeat(self, data: bytes, *, is_answering: bool = False) -> bool:
        """Take a heartbeat; return True if the node has restarted.

        ``is_answering``: the node has answered the SYNC before; if it goes on to, another node was switched on.
        """
        state = decode_heartbeat(data)
        if state is None:
            return False
        self.nmt_state = state
        is_boot_up = state == NmtState.BOOT_UP
        text = f"node {self.node} restarted (boot-up message)"
        has_been_operational = self.lost_ns != NEVER_NS or state == NmtState.OPERATIONAL
        if is_boot_up and not self._is_supervised:
            self.notices.tell(text)
        elif is_boot_up:
            self.lost_ns, self._left_ns = self.now_ns + self.patience_ns, self.now_ns
            self.condition = NodeCondition.RESTARTED
            self.twin.booted(is_answering=is_answering)
            self.note_fault(coded(text, codes.NODE_RESTARTED))
        elif self._is_supervised and has_been_operational:
            self.lost_ns = self.now_ns + self.patience_ns
            if self.condition is not NodeCondition.RESTARTED:
                self._take_state(state)
        return is_boot_up

    def _take_state(self, state: int) -> None:
        if state == NmtState.OPERATIONAL:
            self.condition = _GOOD
            return
        self.condition, self._left_ns = NodeCondition.NOT_OPERATIONAL, self.now_ns
        name = _STATE_NAMES.get(state, state)
        self.note_fault(coded(f"node {self.node} left Operational: it is {name}", codes.NOT_OPERATIONAL))

    def judge(self, now_ns: int, *, is_answering: bool) -> None:
        """Judge the heartbeats at the end of a cycle; ``is_answering``: the node has answered its SYNC."""
        if now_ns > self.lost_ns:
            if self.condition is not NodeCondition.RESTARTED:
                self.condition = NodeCondition.SILENT
            lost_ms = self.patience_ns / 1e6
            text = f"no heartbeat from node {self.node} for more than {lost_ms:.0f} ms"
            self.note_fault(coded(text, codes.HEARTBEAT_LOST))
        if not is_answering:
            self.twin.missed()
        elif self.condition is not _GOOD and self._left_ns < now_ns:
            if fault := self.twin.answered():
                self.condition = _GOOD  # the boot-up message was one of a second node with this number
                self.note_fault(fault)
            if self.condition is not NodeCondition.RESTARTED:
                self.condition = _GOOD  # a node sends synchronous TPDOs in Operational only

    def report(self, feedback: Feedback) -> None:
        """Write error, fault and notices."""
        feedback.error, feedback.message = self.error, self.fault
        if self.notices.waiting:
            feedback.notices += self.notices.waiting
            self.notices.waiting.clear()
