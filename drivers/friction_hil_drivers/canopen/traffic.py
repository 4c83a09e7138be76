"""What goes on on a bus, heard without sending: other masters, and the states of nodes."""

from collections.abc import Iterator

from friction_hil_drivers.canopen import objects

_NMT_WORDS = {
    objects.NmtState.BOOT_UP: "boot-up",
    objects.NmtState.STOPPED: "stopped",
    objects.NmtState.OPERATIONAL: "operational",
    objects.NmtState.PRE_OPERATIONAL: "pre-operational",
}


class Traffic:
    """Frames of others.

    Attributes
    ----------
    heard : dict of int to int
        State (content of the latest heartbeat) by node.
    """

    def __init__(self) -> None:
        self.heard: dict[int, int] = {}
        self._syncs = 0
        self._commanded: set[int] = set()  # nodes that get RPDOs
        self._asked: set[int] = set()  # nodes that get SDO requests
        self._managed = False

    def take(self, can_id: int, data: bytes) -> None:
        """Take one frame."""
        function, node = can_id & 0x780, can_id & 0x07F
        if can_id == objects.SYNC_ID:
            self._syncs += 1
        elif can_id == objects.NMT_ID:
            self._managed = True
        elif node == 0:
            return
        elif function == objects.HEARTBEAT_BASE and len(data) == 1:
            self.heard[node] = data[0] & 0x7F
        elif function == objects.SDO_REQUEST_BASE:
            self._asked.add(node)
        elif function in objects.RPDO_BASES:
            self._commanded.add(node)

    def nmt_of(self, node: int) -> str:
        """Return the state of a node in words, "" where it has not been heard."""
        state = self.heard.get(node)
        return (
            "" if state is None else _NMT_WORDS.get(objects.NmtState(state), "") if state in _NMT_WORDS else str(state)
        )

    def notes(self) -> Iterator[str]:
        """Yield what other masters do, each as a sentence."""
        if self._syncs:
            yield "another master sends SYNC on this bus: it may enable a drive again that is stopped here"
        if self._commanded:
            nodes = ", ".join(map(str, sorted(self._commanded)))
            yield f"another master sends RPDOs (identifiers of node {nodes} in the pre-defined connection set)"
        if self._managed:
            yield "another master sends NMT commands"
        if self._asked:
            nodes = ", ".join(map(str, sorted(self._asked)))
            yield f"another master reads or writes node {nodes} by SDO: answers may be mixed up there"
