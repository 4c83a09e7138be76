"""TPDOs of one drive that belong together, because they were sampled at one SYNC. No bus, no clock."""

from collections.abc import Sequence

from friction_hil.drive import Mode
from friction_hil_drivers.canopen.connect.mapping import MappedPdo
from friction_hil_drivers.canopen.cycle.health import Handler, NodeHealth
from friction_hil_drivers.cia402 import objects
from friction_hil_drivers.cia402.objects import Object

_NO_STATE = 0x6F  # statusword that shows no state, of 8 bits too


class FeedbackSet:
    """The last data of each TPDO, and which of them came in this cycle.

    Those that come with every SYNC make a set complete. Others keep their last data, unless one of them has the
    position: then all are awaited. What comes twice makes the node's health suspect a second node.
    """

    __slots__ = (
        "_arrived",
        "_awaited",
        "_came",
        "_early",
        "_health",
        "_synchronous",
        "_tpdos",
        "frames",
        "handlers",
        "is_complete",
        "names",
        "wrong",
    )

    def __init__(self, tpdos: Sequence[MappedPdo], names: Sequence[str], mode: Mode, health: NodeHealth) -> None:
        self.names = names  # of the TPDOs, for messages
        self._tpdos, self._health = tpdos, health
        every = (1 << len(tpdos)) - 1
        self._synchronous = sum(1 << number for number, pdo in enumerate(tpdos) if pdo.is_synchronous)
        of_position = next(number for number, pdo in enumerate(tpdos) if objects.POSITION_ACTUAL in pdo.entries)
        self._awaited = self._synchronous if self._synchronous >> of_position & 1 else every
        self.frames = [_unheard(pdo, mode) for pdo in tpdos]
        self._came = 0  # since the last SYNC: bit n for TPDO n
        self._early = 0  # of these, what came once more
        self._arrived = 0  # of these, what was not handed over
        self.is_complete = False
        self.wrong = ""  # a TPDO of this cycle has not the bytes of its mapping
        self.handlers = {pdo.cob_id: self._handler(number, pdo.layout.size) for number, pdo in enumerate(tpdos)}

    def begin(self, *, has_early: bool = False) -> None:
        """Begin a new set; with ``has_early`` what came twice in the one before belongs to it."""
        if self._health.twin.is_suspected:
            self._health.judge_twin()
        self._came = self._arrived = self._early if has_early else 0
        self._early, self.wrong = 0, ""
        self._judge()

    def hand_over(self) -> list[bytes]:
        """Return the data of all TPDOs; the set is complete again once all that are awaited have come again."""
        self._arrived, self.is_complete = 0, False
        return list(self.frames)

    def value(self, entry: Object) -> int | None:
        """Return the value of an object as it came in this cycle, None if it did not."""
        for number, pdo in enumerate(self._tpdos):
            if entry in pdo.entries and self._arrived >> number & 1:
                value: int = pdo.layout.unpack(self.frames[number])[pdo.entries.index(entry)]
                return value
        return None

    def note_wrong(self, name: str, size: int, expected: int) -> None:
        """Note a PDO of another length than its mapping."""
        self.wrong = self.wrong or f"{name} has {size} bytes, but its entries {expected}"

    @property
    def missing(self) -> str:
        """Names of the TPDOs that are awaited, for messages."""
        lost = self._awaited & ~self._arrived
        return " and ".join(name for number, name in enumerate(self.names) if lost >> number & 1)

    def _handler(self, number: int, size: int) -> Handler:
        bit = 1 << number

        def take(data: bytes) -> None:
            if len(data) != size:
                self.note_wrong(self.names[number], len(data), size)
                return
            if self._came & self._synchronous & bit:
                self._health.twin.take(self.names[number])
                self._early |= bit
            self._came |= bit
            self._arrived |= bit
            self.frames[number] = data
            self._judge()

        return take

    def _judge(self) -> None:
        self.is_complete = self._arrived & self._awaited == self._awaited


def _unheard(pdo: MappedPdo, mode: Mode) -> bytes:
    """Return data in place of those of a TPDO that has not come yet: no state, and the mode that was set."""
    values = {objects.STATUSWORD: _NO_STATE, objects.MODE_DISPLAY: int(mode)}
    return pdo.layout.pack(*(values.get(entry, 0) for entry in pdo.entries))
