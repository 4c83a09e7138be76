"""Stop of one drive as a state machine: quick stop, standstill, disable, read back. No bus, no clock.

Whoever stops a drive asks for the step that is due, carries it out by whatever reaches the drive, and tells what came
of it: a loop that takes one step a cycle, or a command that waits for each answer. Nothing is believed that was not
read back. Standstill is judged by the position: a velocity may have another unit than is assumed.
"""

import math
from enum import Enum

from friction_hil.drive.port import DriveState

STANDSTILL_NS = 50_000_000  # for which the position rests
_OBEY_NS = 100_000_000  # for the quick stop to begin; then the drive is disabled
_QUICK_STOP_NS = 2_000_000_000  # for the quick stop to end; then the drive is disabled all the same
_BLIND_NS = 500_000_000  # the same where the position, or nothing at all, can be read
_READ_BACK_NS = 1_000_000_000  # for the power to go, for a command that waits for it
_VERIFY_NS = 100_000_000  # between two readings of a drive without power
_READINGS = 2  # without power, for a command that ends with them: one may be an old answer
_MOST_UNANSWERED = 2  # steps in a row: the drive is gone, or its node takes no requests


class StopState(Enum):
    """State of a stop; the values are the steps that are due in it."""

    QUICK_STOP = "command quick stop"
    STOPPING = "read the state: has the quick stop begun?"
    STANDSTILL = "read the position"
    DISABLE = "command disable"
    DISABLING = "read the state: has the power gone?"
    OFF = "read the state again"

    @property
    def reads_state(self) -> bool:
        """True if the step is to read the drive's state."""
        return self in (StopState.STOPPING, StopState.DISABLING, StopState.OFF)


_STOPPING = (StopState.QUICK_STOP, StopState.STOPPING, StopState.STANDSTILL)


class DriveStop:
    """Stop of one drive.

    ``standstill``: largest change of the position in 50 ms that counts as standstill, in counts, as the position.
    ``counter_range``: counts after which the position begins anew. ``has_quick_stop_state``: if False, the drive shows
    Operation enabled during a quick stop too.
    """

    __slots__ = (
        "_began_ns",
        "_counter_range",
        "_disabled_ns",
        "_due_ns",
        "_has_quick_stop_state",
        "_is_heard",
        "_readings",
        "_rested_at",
        "_standing_since_ns",
        "_standstill",
        "_unanswered",
        "at",
        "state",
    )

    def __init__(
        self, standstill: float, counter_range: float = math.inf, *, has_quick_stop_state: bool = True
    ) -> None:
        self._standstill, self._counter_range = standstill, counter_range
        self._has_quick_stop_state = has_quick_stop_state
        self.begin(0)

    def begin(self, now_ns: int, at: StopState = StopState.QUICK_STOP) -> None:
        """Begin, with the quick stop or with `StopState.DISABLE`; what was read before does not count."""
        self.at = at
        # of the drive, as read back last; UNKNOWN before, and after a step without an answer
        self.state = DriveState.UNKNOWN
        self._began_ns = self._due_ns = self._standing_since_ns = now_ns
        self._disabled_ns: int | None = None  # when the drive first took the command
        self._rested_at: float | None = None  # position around which it has stood since
        self._is_heard = False
        self._readings = self._unanswered = 0

    @property
    def is_proved(self) -> bool:
        """True if the last reading showed a drive without power."""
        return self._readings > 0

    @property
    def is_unanswered(self) -> bool:
        """True if the last steps were not answered."""
        return self._unanswered >= _MOST_UNANSWERED

    def is_over(self, now_ns: int) -> bool:
        """Return True if a command that waits has nothing to wait for any more."""
        is_late = self._disabled_ns is not None and now_ns - self._disabled_ns > _READ_BACK_NS
        return self._readings >= _READINGS or self.is_unanswered or (is_late and not self._readings)

    def step(self, now_ns: int) -> StopState | None:
        """Return the step that is due; None for none."""
        elapsed_ns = now_ns - self._began_ns
        if self.at in _STOPPING and (elapsed_ns > _QUICK_STOP_NS or (elapsed_ns > _BLIND_NS and not self._is_heard)):
            self.at = StopState.DISABLE
        return self.at if now_ns >= self._due_ns else None

    def take_silence(self) -> None:
        """Take that the drive did not answer: it is commanded again."""
        self.state, self._readings = DriveState.UNKNOWN, 0
        self._unanswered += 1
        self.at = StopState.QUICK_STOP if self.at in _STOPPING else StopState.DISABLE

    def take_command(self, now_ns: int) -> None:
        """Take that the drive has answered a command, whether it accepts or refuses it."""
        self._note_answer()
        if self.at is StopState.DISABLE and self._disabled_ns is None:
            self._disabled_ns = now_ns
        self.at = StopState.STOPPING if self.at is StopState.QUICK_STOP else StopState.DISABLING

    def take_state(self, state: DriveState, now_ns: int) -> None:
        """Take the state that was read."""
        self._note_answer()
        self.state = state
        if state.is_unpowered:
            self._readings += 1
            self.at, self._due_ns = StopState.OFF, now_ns + _VERIFY_NS
            return
        self._readings = 0
        if self.at is not StopState.STOPPING:
            self.at = StopState.DISABLE
        elif state is DriveState.FAULT_REACTION_ACTIVE:
            pass  # it stops by itself
        elif state is DriveState.QUICK_STOP_ACTIVE or not self._has_quick_stop_state:
            self.at = StopState.STANDSTILL
        else:
            is_disobeyed = now_ns - self._began_ns > _OBEY_NS
            self.at = StopState.DISABLE if is_disobeyed else StopState.QUICK_STOP

    def take_position(self, position: float | None, now_ns: int) -> None:
        """Take the position that was read; None where the drive does not tell it."""
        self._note_answer()
        if position is None:
            is_standing = now_ns - self._began_ns > _BLIND_NS
        elif self._is_moved(position):
            self._rested_at, self._standing_since_ns = position, now_ns
            is_standing = False
        else:
            is_standing = now_ns - self._standing_since_ns >= STANDSTILL_NS
        self.at = StopState.DISABLE if is_standing else StopState.STOPPING

    def _note_answer(self) -> None:
        self._is_heard, self._unanswered = True, 0

    def _is_moved(self, position: float) -> bool:
        if self._rested_at is None:
            return True
        moved = abs(position - self._rested_at)
        return min(moved, self._counter_range - moved) > self._standstill
