"""Two nodes with one number: each request gets two answers. Counting, without bus and clock.

A node that answers late, after its request was repeated, or some of whose frames a bad bus doubles, is told from that
by the share of the requests that got an answer too many.
"""

from collections import Counter
from collections.abc import Iterable

from friction_hil.drive.codes import coded
from friction_hil.errors import DriveError
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.sdo.conversation import Pause, Script
from friction_hil_drivers.canopen.sdo.dialogue import SEGMENT, Upload, abort_code, answered, requested
from friction_hil_drivers.cia402 import objects
from friction_hil_drivers.cia402.objects import Address, Object

# Asked of each node before anything else: what never changes in a node, and tells two of them apart
IDENTITY = (objects.DEVICE_TYPE, objects.VENDOR_ID, objects.PRODUCT_CODE, objects.SERIAL_NUMBER)
SETTLE_S = 0.05  # after the last request: the second node may be slower than the first
# Where some answers came twice: asked so often that two nodes are told from frames that came twice by chance
SURE_REQUESTS = (objects.VENDOR_ID,) * 40
_DOUBTFUL, _SURE = 0.5, 0.8  # share of the requests that were answered twice
_LEAST = 3  # answers too many
_DOUBLE_CYCLES = 20  # with a TPDO too many, after which a second node sends them; a cycle without one takes three off

FIX = "give each node a number of its own, with one drive at a time on the bus: most are delivered with number 1"


class NodeAnswers:
    """Answers to the SDO requests to one node, whoever sent these."""

    def __init__(self) -> None:
        self._requests: Counter[Address] = Counter()
        self._answers: Counter[Address] = Counter()
        self._last: dict[Address, bytes] = {}
        self._contradiction = ""

    def begin(self) -> None:
        """Count anew from here on."""
        self._requests.clear()
        self._answers.clear()
        self._last.clear()

    def requested(self, data: bytes | bytearray) -> None:
        """Take a request to the node."""
        if (address := requested(data)) is not None:
            self._requests[address] += 1

    def answered(self, data: bytes) -> None:
        """Take an answer of the node."""
        address = answered(data) or SEGMENT
        self._answers[address] += 1
        before = self._last.setdefault(address, data)
        if before != data and self._answers[address] > self._requests[address] > 0:
            for entry in IDENTITY:
                if entry.address == address:
                    self._contradiction = f"{entry} is {_shown(before)} and {_shown(data)}"
        self._last[address] = data

    def _share(self) -> float:
        """Return the share of the answered requests that got an answer too many."""
        pairs = [(count, self._answers[address]) for address, count in self._requests.items()]
        surplus = sum(max(0, answers - count) for count, answers in pairs)
        answered = sum(min(count, answers) for count, answers in pairs)
        return surplus / answered if surplus >= _LEAST else 0.0

    @property
    def is_doubtful(self) -> bool:
        """True if so many answers came twice that it is worth to ask more often."""
        return bool(self._contradiction) or self._share() >= _DOUBTFUL

    def refusal(self, node: int, bus: str) -> DriveError | None:
        """Return why node ``node`` must not be touched, None where it is one node."""
        text = f"two nodes answer as node {node} on {bus}"
        if self._contradiction:
            text = f"{text}: {self._contradiction}"
        elif self._share() >= _SURE:
            text = f"{text}, or an adapter or gateway repeats its frames: each request gets two equal answers"
        else:
            return None
        return DriveError(text, FIX, codes.TWO_NODES)


def _shown(data: bytes) -> str:
    code = abort_code(data)
    return f"{int.from_bytes(data[4:8], 'little'):#x}" if code is None else f"refused ({code:08X}h)"


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


def ask(entries: Iterable[Object]) -> "Script[None]":
    """Ask a node for objects, and wait for the answers of a second one."""
    yield from (Upload(entry) for entry in entries)
    yield Pause(SETTLE_S)
