"""Application of changes by the loop: between two cycles, all of an entry or nothing of it."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from friction_hil.daemon.control.journal import JournalReader
from friction_hil.daemon.control.message import Action, Change
from friction_hil.daemon.control.packed import unpack
from friction_hil.drive import Feedback
from friction_hil.friction.kernel import PLAIN_ROOM

if TYPE_CHECKING:
    from friction_hil.daemon.axis import AxisLoop
    from friction_hil.daemon.log import RunLog
    from friction_hil.daemon.run import RunControl


class Changes:
    """Takes changes from the journal."""

    __slots__ = ("_axes", "_is_garbage_told", "_log", "_rooms", "_run", "journal", "last")

    def __init__(self, journal: JournalReader, axes: "Sequence[AxisLoop]", log: "RunLog", run: "RunControl") -> None:
        self.journal, self._axes, self._log, self._run = journal, axes, log, run
        self._is_garbage_told = False
        models = [one for axis in axes for one in (axis.compensator, *axis.shadows.values())]
        self._rooms = {PLAIN_ROOM, *(one.record[0]["friction"].size for one in models)}
        self.last = 0.0  # number of the last change of settings that was applied; 0 before the first

    def take(self, cycle: int, running_s: float, feedback: Sequence[Feedback]) -> None:
        """Take the change, if it is a whole one, and apply it or refuse it; ``running_s`` as for `AxisLoop.apply`."""
        try:
            block = self.journal.take(cycle)
            if block is None:
                return
            change = unpack(block, [axis.compensator.record for axis in self._axes], self._rooms)
        except ValueError as error:  # the process of the control socket never writes such a thing
            if not self._is_garbage_told:
                self._is_garbage_told = True
                self._log.warn(cycle, f"the journal of the control socket held garbage, which was ignored: {error}")
            return
        refusal = self._act(cycle, change, feedback)
        if not refusal:
            wanted = [(axis, one) for axis, one in zip(self._axes, change.axes, strict=False) if one is not None]
            for axis, one in wanted:
                axis.apply(one, running_s)
            if wanted:
                self.last = float(change.number)
                self._log.event(cycle, "change", str(change.number))
            self._log.act(cycle, change.text)
        self.journal.answer(change.number, cycle, refusal)

    def _act(self, cycle: int, change: Change, feedback: Sequence[Feedback]) -> str:
        """Do what the change asks of the run; return why that is refused, empty if it is not."""
        if change.action is Action.START:
            return self._run.start(feedback)
        if change.action is Action.STOP:
            return self._run.pause()
        if change.action is Action.RESET:
            return self._run.reset(cycle)
        return ""
