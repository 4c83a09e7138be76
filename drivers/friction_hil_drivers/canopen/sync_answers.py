"""Which SYNC a TPDO answers. Counting, without bus and clock.

A synchronous TPDO of type 1 answers each SYNC once, but does not say which. As long as as many TPDOs came as SYNCs were
sent, the last TPDO answers the last SYNC. Fewer TPDOs mean that some were lost, or that all come late by whole cycles:
both look the same. A cycle in which SYNC is left out (a probe) decides it: what arrives then answers an earlier SYNC.
"""

_MOST_MISSING = 1000


class SyncAnswers:
    """Count of SYNCs and of the TPDOs that answer them, of one node.

    Parameters
    ----------
    count : int
        Number of TPDOs that answer each SYNC.

    Attributes
    ----------
    is_late : bool
        TPDOs answer an earlier SYNC than the last one; a probe has shown it.
    """

    __slots__ = ("_is_probe", "_missing", "_open", "_was_answered", "is_late")

    def __init__(self, count: int) -> None:
        self._missing = [0] * count  # SYNCs without an answer, for each TPDO
        self._open = 0  # their sum
        self._was_answered = [False] * count  # in this cycle
        self._is_probe = False
        self.is_late = False

    @property
    def is_up_to_date(self) -> bool:
        """True if every SYNC was answered."""
        return not self._open

    @property
    def lag(self) -> int:
        """Number of SYNCs that were not answered yet, or never."""
        return max(self._missing)

    @property
    def is_doubtful(self) -> bool:
        """True if TPDOs came in this cycle, but fewer than SYNCs so far: lost, or late."""
        if not self._open or self._is_probe:
            return False
        return any(missing and answered for missing, answered in zip(self._missing, self._was_answered, strict=True))

    def begin_cycle(self, *, has_sync: bool) -> None:
        """Count a SYNC; a cycle without one is a probe."""
        if self._is_probe:
            self._end_probe()
        self._is_probe = not has_sync
        missing, answered = self._missing, self._was_answered
        for number in range(len(missing)):
            answered[number] = False
            if has_sync and missing[number] < _MOST_MISSING:
                missing[number] += 1
                self._open += 1

    def _end_probe(self) -> None:
        """What was not answered by now is lost."""
        for number, was_answered in enumerate(self._was_answered):
            if not was_answered:
                self._missing[number] = 0
        self._open = sum(self._missing)
        if not any(self._was_answered):
            self.is_late = False

    def take(self, number: int) -> bool:
        """Count TPDO ``number``; return False if no SYNC is left that it could answer."""
        if not self._missing[number]:
            return False
        self._missing[number] -= 1
        self._open -= 1
        self._was_answered[number] = True
        # caught up in a probe proves nothing: the next SYNC shows whether its answer comes in time
        self.is_late = self._is_probe or (self.is_late and self._open > 0)
        return True
