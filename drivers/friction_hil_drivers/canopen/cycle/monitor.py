"""Supervision of one node by its heartbeats. No bus, no clock."""

from enum import IntEnum

from friction_hil.drive.codes import coded
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.connect.watchdog_times import HEARTBEATS_TO_LOSS
from friction_hil_drivers.canopen.wire.cia301 import NmtState

_STATE_NAMES = {state.value: state.name.lower().replace("_", "-") for state in NmtState}


class NodeCondition(IntEnum):
    """What the heartbeats say about a node."""

    GOOD = 0
    NOT_OPERATIONAL = 1  # its configuration is in force, but it ignores PDOs
    SILENT = 2  # no heartbeat
    RESTARTED = 3  # its configuration is lost; only a new start of the daemon ends this


class NodeMonitor:
    """Heartbeats of one node. Its loss is reported once a first heartbeat in Operational came.

    A heartbeat in any state shows that the node is alive; a state other than Operational is a fault of its own.

    Parameters
    ----------
    node : int
        Node number.
    heartbeat_s : float
        Period of the node's heartbeat, s; three missing ones are a loss.

    Attributes
    ----------
    condition : NodeCondition
    """

    __slots__ = ("_last_ns", "_node", "condition", "patience_ns")

    def __init__(self, node: int, heartbeat_s: float) -> None:
        self._node = node
        self.patience_ns = round(HEARTBEATS_TO_LOSS * heartbeat_s * 1e9)
        self._last_ns: int | None = None  # time of the last heartbeat, from the first one in Operational on
        self.condition = NodeCondition.GOOD

    def take(self, state: int, now_ns: int) -> str:
        """Take a heartbeat with the NMT state ``state``; return the fault that it reveals, "" for none."""
        if state == NmtState.BOOT_UP:
            self._last_ns = now_ns
            self.condition = NodeCondition.RESTARTED
            return coded(f"node {self._node} restarted (boot-up message)", codes.NODE_RESTARTED)
        if self._last_ns is None and state != NmtState.OPERATIONAL:
            return ""  # not yet in Operational
        self._last_ns = now_ns
        if self.condition is NodeCondition.RESTARTED:
            return ""
        if state == NmtState.OPERATIONAL:
            self.condition = NodeCondition.GOOD
            return ""
        self.condition = NodeCondition.NOT_OPERATIONAL
        name = _STATE_NAMES.get(state, state)
        return coded(f"node {self._node} left Operational: it is {name}", codes.NOT_OPERATIONAL)

    def is_another(self) -> None:
        """Note that the boot-up message was one of a second node with this number: this one has not restarted."""
        self.condition = NodeCondition.GOOD

    def answered(self) -> None:
        """Note that the node has answered SYNC: it is in Operational."""
        if self.condition is not NodeCondition.RESTARTED:
            self.condition = NodeCondition.GOOD

    def check(self, now_ns: int) -> str:
        """Return the fault of a missing heartbeat, "" for none."""
        if self._last_ns is None or now_ns - self._last_ns <= self.patience_ns:
            return ""
        if self.condition is not NodeCondition.RESTARTED:
            self.condition = NodeCondition.SILENT
        lost_ms = self.patience_ns / 1e6
        return coded(f"no heartbeat from node {self._node} for more than {lost_ms:.0f} ms", codes.HEARTBEAT_LOST)
