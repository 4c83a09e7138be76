"""Two nodes with one number: each request gets two answers. Counting, without bus and clock.

A node that answers late, after its request was repeated, or some of whose frames a bad bus doubles, is told from that
by the share of the requests that got an answer too many.
"""

from collections import Counter
from collections.abc import Iterable

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


def ask(entries: Iterable[Object]) -> "Script[None]":
    """Ask a node for objects, and wait for the answers of a second one."""
    yield from (Upload(entry) for entry in entries)
    yield Pause(SETTLE_S)
