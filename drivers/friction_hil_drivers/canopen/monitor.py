"""Supervision of one node by its heartbeats. No bus, no clock."""

from friction_hil.drive.codes import coded
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.objects import NmtState

HEARTBEATS_TO_LOSS = 3  # missing in a row

_STATE_NAMES = {state.value: state.name.lower().replace("_", "-") for state in NmtState}


class NodeMonitor:
    """Heartbeats of one node. Its loss is reported once a first heartbeat in Operational came.

    Parameters
    ----------
    node : int
        Node number.
    heartbeat_s : float
        Period of the node's heartbeat, s; three missing ones are a loss.
    """

    def __init__(self, node: int, heartbeat_s: float) -> None:
        self._node = node
        self._patience_ns = round(HEARTBEATS_TO_LOSS * heartbeat_s * 1e9)
        self._last_ns: int | None = None  # time of the last heartbeat in Operational

    def take(self, state: int, now_ns: int) -> str:
        """Take a heartbeat with the NMT state ``state``; return the fault that it reveals, "" for none."""
        if state == NmtState.OPERATIONAL:
            self._last_ns = now_ns
            return ""
        if state == NmtState.BOOT_UP:
            return coded(f"node {self._node} restarted (boot-up message)", codes.NODE_RESTARTED)
        if self._last_ns is None:
            return ""  # not yet in Operational
        name = _STATE_NAMES.get(state, state)
        return coded(f"node {self._node} left Operational: it is {name}", codes.NOT_OPERATIONAL)

    def check(self, now_ns: int) -> str:
        """Return the fault of a missing heartbeat, "" for none."""
        if self._last_ns is None or now_ns - self._last_ns <= self._patience_ns:
            return ""
        lost_ms = self._patience_ns / 1e6
        return coded(f"no heartbeat from node {self._node} for more than {lost_ms:.0f} ms", codes.HEARTBEAT_LOST)
