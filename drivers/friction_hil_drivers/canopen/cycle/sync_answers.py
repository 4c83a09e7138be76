"""Which SYNC a TPDO answers. Counting, without bus and clock.

A synchronous TPDO of type 1 answers each SYNC once, but does not say which. As long as as many TPDOs came as SYNCs were
sent, the last TPDO answers the last SYNC. Fewer TPDOs mean that some were lost, or that all come late by whole cycles:
both look the same. A cycle in which SYNC is left out (a probe) decides it: what arrives then answers an earlier SYNC.
"""

_MOST_MISSING = 1000


class SyncAnswers:
    """Count of SYNCs and of the TPDOs that answer them, of one node."""

    __slots__ = ("_answered", "_count", "_is_probe", "_syncs", "_taken", "is_late", "open")

    def __init__(self, count: int) -> None:
        self._count = count  # TPDOs that answer each SYNC
        self._syncs = 0
        self._taken = [0] * count  # answers of each TPDO; those that are lost for good are among them
        self._answered = 0  # TPDOs that came in this cycle: bit n for TPDO n
        self._is_probe = False
        self.open = 0  # SYNCs not answered, summed over the TPDOs; 0: the last TPDOs answer the last SYNC
        self.is_late = False  # TPDOs answer an earlier SYNC than the last one; a probe has shown it

    @property
    def is_settled(self) -> bool:
        """True if the last TPDOs answer the last SYNC, and nothing else is known or to be found out."""
        return not (self.open or self.is_late or self._is_probe)

    @property
    def lag(self) -> int:
        """Number of SYNCs that were not answered yet, or never."""
        return self._syncs - min(self._taken)

    @property
    def is_doubtful(self) -> bool:
        """True if TPDOs came in this cycle, but fewer than SYNCs so far: lost, or late."""
        if not self.open or self._is_probe:
            return False
        return any(taken < self._syncs and self._answered >> number & 1 for number, taken in enumerate(self._taken))

    def begin_cycle(self, has_sync: bool) -> None:
        """Count a SYNC; a cycle without one is a probe."""
        if self._is_probe:
            self._end_probe()
        self._is_probe = not has_sync
        self._answered = 0
        if has_sync:
            self._syncs += 1
            self.open += self._count
            if self.open > _MOST_MISSING:
                self._forget_oldest()

    def _forget_oldest(self) -> None:
        """Wait for no more than the last 1000 answers of each TPDO."""
        oldest = self._syncs - _MOST_MISSING
        self._taken = [max(taken, oldest) for taken in self._taken]
        self._count_open()

    def _end_probe(self) -> None:
        """What was not answered by now is lost."""
        for number in range(self._count):
            if not self._answered >> number & 1:
                self._taken[number] = self._syncs
        self._count_open()
        if not self._answered:
            self.is_late = False

    def _count_open(self) -> None:
        self.open = self._count * self._syncs - sum(self._taken)

    def take(self, number: int) -> bool:
        """Count TPDO ``number``; return False if no SYNC is left that it could answer."""
        taken = self._taken
        if taken[number] == self._syncs:
            return False
        taken[number] += 1
        self.open -= 1
        self._answered |= 1 << number
        # caught up in a probe proves nothing: the next SYNC shows whether its answer comes in time
        if self._is_probe or self.is_late:
            self.is_late = self._is_probe or self.open > 0
        return True
