"""Two nodes with one number, as they show in the cyclic phase. Counting, without bus and clock."""

from friction_hil.drive.codes import coded
from friction_hil_drivers.canopen import codes

_DOUBLE_CYCLES = 20  # with a TPDO too many, after which a second node sends them; a cycle without one takes three off


class TwinWatch:
    """Watches for a second node with the number of one in the cyclic phase."""

    __slots__ = ("_cycles", "_has_booted", "_node", "_surplus", "is_found", "is_suspected")

    def __init__(self, node: int) -> None:
        self._node = node
        self._surplus = ""  # TPDO of this cycle that came too often
        self._cycles = 0
        self._has_booted = False
        self.is_found = False  # a second node has shown itself
        self.is_suspected = False  # `judge` is to be called at the end of this cycle

    def take(self, tpdo: str) -> None:
        """Take a TPDO that answers no SYNC, because one has answered it already."""
        self._surplus, self.is_suspected = tpdo, True

    def judge(self) -> str:
        """Tell a second node, each of whose TPDOs is one too many, from a bus that doubles some; return the fault."""
        tpdo, self._surplus = self._surplus, ""
        self._cycles = self._cycles + 1 if tpdo else max(0, self._cycles - 3)
        self.is_suspected = self._cycles > 0
        if self._cycles < _DOUBLE_CYCLES:
            return ""
        self._cycles, self.is_found = 0, True
        text = f"{tpdo} of node {self._node} comes twice in each cycle: two nodes have this number, or an adapter or "
        return coded(f"{text}gateway repeats its frames", codes.TWO_NODES)

    def booted(self, *, is_answering: bool) -> None:
        """Take a boot-up message; ``is_answering``: the node has answered the SYNC before."""
        self._has_booted = is_answering

    def missed(self) -> None:
        """Note a cycle without an answer: the node itself has restarted."""
        self._has_booted = False

    def answered(self) -> str:
        """Note an answer to SYNC, which a node that has restarted does not give; return the fault, "" for none."""
        if not self._has_booted:
            return ""
        self._has_booted, self.is_found = False, True
        text = f"node {self._node} answers SYNC as before: a second node with this number was switched on"
        return coded(text, codes.TWO_NODES)
