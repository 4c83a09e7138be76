"""Heartbeats of a simulated node: the one it produces (1017h), and those it watches (1016h)."""

from friction_hil_drivers.canopen import objects
from friction_hil_drivers.canopen.simulated.dictionary import Abort, Dictionary, Entry, SdoAbortError

_MS = 1_000_000  # ns


class Producer:
    """Timer of this node's own heartbeat."""

    def __init__(self, dictionary: Dictionary) -> None:
        self._time = dictionary.of(objects.PRODUCER_HEARTBEAT)
        self._last_ns = 0

    @property
    def _interval_ns(self) -> int:
        return int(self._time.value) * _MS

    def is_due(self, now_ns: int) -> bool:
        """True if a heartbeat is to be sent now."""
        return self._interval_ns > 0 and now_ns - self._last_ns >= self._interval_ns

    def sent(self, now_ns: int) -> None:
        """Begin the next interval, in whole intervals since the last one: late service does not shift the grid."""
        self._last_ns += (now_ns - self._last_ns) // self._interval_ns * self._interval_ns

    def restart(self, now_ns: int) -> None:
        """Count from here: the boot-up message replaces the first heartbeat."""
        self._last_ns = now_ns


class Consumer:
    """Watches other nodes. A node is watched from its first heartbeat on."""

    def __init__(self, dictionary: Dictionary) -> None:
        index, count = objects.CONSUMER_HEARTBEAT.index, dictionary.of(objects.CONSUMER_HEARTBEAT_COUNT)
        self._entries = [dictionary.at(index, subindex) for subindex in range(1, count.value + 1)]
        for entry in self._entries:
            entry.on_write = lambda value, entry=entry: self._write(entry, value)
        self._deadlines_ns: dict[int, int] = {}  # by node
        self._missing: set[int] = set()

    def reset(self) -> None:
        """Wait for first heartbeats again."""
        self._deadlines_ns.clear()
        self._missing.clear()

    @property
    def are_all_present(self) -> bool:
        """True if no node is lost."""
        return not self._missing

    @property
    def nodes(self) -> list[int]:
        """Nodes that are watched."""
        return [entry.value >> 16 for entry in self._entries if _interval_ns(entry.value)]

    def heard(self, node: int, now_ns: int) -> None:
        """Take a heartbeat of ``node``."""
        for entry in self._entries:
            if entry.value >> 16 == node and (interval := _interval_ns(entry.value)):
                self._deadlines_ns[node] = now_ns + interval
                self._missing.discard(node)

    def take_lost(self, now_ns: int) -> list[int]:
        """Return the nodes whose heartbeat became overdue since the last call."""
        late = [node for node, deadline in self._deadlines_ns.items() if now_ns >= deadline]
        for node in late:
            del self._deadlines_ns[node]
            self._missing.add(node)
        return late

    def _write(self, entry: Entry, value: int) -> None:
        node = value >> 16
        if node > 127:
            raise SdoAbortError(Abort.VALUE)
        others = (other.value for other in self._entries if other is not entry)
        if _interval_ns(value) and any(_interval_ns(other) and other >> 16 == node for other in others):
            raise SdoAbortError(Abort.INCOMPATIBLE)
        for changed in (entry.value >> 16, node):
            self._deadlines_ns.pop(changed, None)
            self._missing.discard(changed)


def _interval_ns(entry: int) -> int:
    """Return the consumer time of an entry of 1016h, ns; 0 where the entry is unused."""
    return (entry & 0xFFFF) * _MS if entry >> 16 else 0
