"""TPDOs that answer the daemon's own SYNC, counted against it (`sync_answers`). No bus, no clock."""

from collections.abc import Sequence

from friction_hil.drive import Mode
from friction_hil.drive.codes import coded
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.connect.mapping import MappedPdo
from friction_hil_drivers.canopen.cycle.feedback_set import FeedbackSet
from friction_hil_drivers.canopen.cycle.health import Handler, NodeHealth
from friction_hil_drivers.canopen.cycle.sync_answers import SyncAnswers


class AnswerSet(FeedbackSet):
    """Feedback set of a drive whose TPDOs all answer each SYNC; it is complete when none of an earlier one is missing.

    As long as each TPDO comes once in a cycle, they are not counted.
    """

    __slots__ = ("_answers", "_comes_late", "_every", "_is_counted", "_is_reported", "_waits_for_older", "_why_no_sync")

    def __init__(self, tpdos: Sequence[MappedPdo], mode: Mode, health: NodeHealth) -> None:
        self._answers = SyncAnswers(len(tpdos))
        self._every = (1 << len(tpdos)) - 1
        self._is_counted = True
        self._is_reported = False  # the cycle is over, and the set was not complete
        self._comes_late = False  # TPDOs arrived after the end of their cycle
        self._why_no_sync = ""
        self._waits_for_older = True
        super().__init__(tpdos, [f"TPDO {number + 1}" for number in range(len(tpdos))], mode, health)

    @property
    def is_doubtful(self) -> bool:
        """True if only a cycle without SYNC shows whether the TPDOs are those of the last SYNC."""
        return self._answers.is_doubtful

    def start(self, *, is_real: bool) -> None:
        """Begin the cyclic phase; in simulated time no TPDO comes late, and one that is lost is not waited for."""
        self._waits_for_older = is_real

    def begin_cycle(self, now_ns: int, why_no_sync: str = "") -> None:
        """Forget the TPDOs that arrived before this cycle; ``why_no_sync`` is the reason for one without SYNC."""
        health = self._health
        health.now_ns = now_ns
        if health.twin.is_suspected:
            health.judge_twin()
        if self.is_complete and not self._is_counted and not why_no_sync:
            self._arrived, self.is_complete, self._comes_late = 0, False, False
            return
        if not self._is_counted:
            self._count()
        self._is_counted = bool(why_no_sync) or (self._is_counted and not self._answers.is_settled)
        if self._is_counted:
            self._answers.begin_cycle(has_sync=not why_no_sync)
        self._why_no_sync, self.wrong = why_no_sync, ""
        self._arrived, self.is_complete, self._is_reported = 0, False, False

    def end(self) -> bool:
        """End a cycle whose set is not complete; return True if it is that of the last SYNC as far as is known."""
        if not self._is_counted:
            self._count()
        self._is_reported = True
        return self._arrived == self._every and not self._answers.is_late and not self._why_no_sync

    def _count(self) -> None:
        """Count this cycle: a TPDO is missing, or came twice."""
        self._is_counted = True
        self._answers.begin_cycle(has_sync=True)
        for number in range(len(self.names)):
            if self._arrived >> number & 1:
                self._answers.take(number)

    def _handler(self, number: int, size: int) -> Handler:
        """Return what takes a TPDO; a closure is called faster than a partial."""
        bit, every, frames = 1 << number, self._every, self.frames

        def take(data: bytes) -> None:
            if not self._is_counted and len(data) == size:
                if self._arrived & bit:  # it has answered the last SYNC already
                    self._health.twin.take(self.names[number])
                    return
            elif not self._is_answer(number, size, data):
                return
            frames[number] = data  # the last one, if older ones came in this cycle too
            arrived = self._arrived = self._arrived | bit
            if arrived == every:
                self.is_complete = not (self._is_counted and self._waits_for_older and self._answers.open)

        return take

    def _is_answer(self, number: int, size: int, data: bytes) -> bool:
        """Count a TPDO; return True if it answers a SYNC and can be decoded."""
        if not self._is_counted:
            self._count()
        if len(data) != size:
            self._note_length(number, size, data)
        if self._answers.take(number):
            self._comes_late = self._is_reported
            return len(data) >= size
        self._health.twin.take(self.names[number])
        return False

    def _note_length(self, number: int, size: int, data: bytes) -> None:
        """Tell of a TPDO that has not the bytes of its mapping; one that has more is used."""
        text = f"{self.names[number]} of node {self._health.node} has {len(data)} bytes instead of {size}"
        self._health.notices.add(coded(text, codes.PDO_LENGTH))
        if len(data) < size:
            self.wrong = text

    def why_missing(self) -> str:
        """Return why the set of this cycle is not complete."""
        if self.wrong or (self._why_no_sync and not self._answers.is_late):
            return self.wrong or self._why_no_sync
        node = self._health.node
        if self._answers.is_late:
            text = f"the TPDOs of node {node} answer SYNC {self._answers.lag} cycles late"
            return coded(text, codes.FEEDBACK_LATE)
        text = f"{self.missing} of node {node} did not arrive in time"
        return coded(f"{text}: it arrived too late in its cycle", codes.FEEDBACK_LATE) if self._comes_late else text
