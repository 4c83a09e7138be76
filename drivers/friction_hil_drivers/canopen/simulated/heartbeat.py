"""Error control of a simulated node: its heartbeat (1017h), those it watches (1016h), node guarding (100Ch, 100Dh)."""

from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.cia402.access import Abort, AbortError
from friction_hil_drivers.cia402.simulated.dictionary import Dictionary, Entry

_MS = 1_000_000  # ns


class Producer:
    """Timer of this node's own heartbeat."""

    def __init__(self, dictionary: Dictionary) -> None:
        self._time = dictionary.of(cia301.PRODUCER_HEARTBEAT)
        self._last_ns = 0

    @property
    def _interval_ns(self) -> int:
        return int(self._time.value) * _MS

    @property
    def is_on(self) -> bool:
        """True if the node sends heartbeats."""
        return self._interval_ns > 0

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
        self._entries = dictionary.subindices(cia301.CONSUMER_HEARTBEAT.index, 1, 127)
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
            raise AbortError(Abort.VALUE)
        others = (other.value for other in self._entries if other is not entry)
        if _interval_ns(value) and any(_interval_ns(other) and other >> 16 == node for other in others):
            raise AbortError(Abort.INCOMPATIBLE)
        for changed in (entry.value >> 16, node):
            self._deadlines_ns.pop(changed, None)
            self._missing.discard(changed)


class LifeGuard:
    """Answers the master's remote frames, and misses them (CiA 301, node guarding and life guarding).

    The guarding begins with the first remote frame; the toggle bit of its answer is 0. Life time is the product of
    100Ch and 100Dh; 0 means that the node answers but misses nothing.
    """

    _TOGGLE = 0x80

    def __init__(self, dictionary: Dictionary) -> None:
        guard_time, factor = dictionary.entries(cia301.GUARD_TIME, cia301.LIFE_TIME_FACTOR)
        self._guard_time, self._factor = guard_time, factor
        self.is_supported = dictionary.shows(cia301.GUARD_TIME) and dictionary.shows(cia301.LIFE_TIME_FACTOR)
        for entry in (guard_time, factor):
            entry.on_write = self._change
        self.reset()

    def reset(self) -> None:
        """Wait for the first remote frame again."""
        self._toggle = 0
        self._heard_ns: int | None = None
        self.is_missing = False

    def answer(self, state: int, now_ns: int) -> bytes:
        """Return the answer to a remote frame, and begin the next life time."""
        self._heard_ns = now_ns
        self.is_missing = False
        toggle = self._toggle
        self._toggle ^= self._TOGGLE
        return bytes([state | toggle])

    def is_overdue(self, now_ns: int) -> bool:
        """Return True once when the life time has passed without a remote frame."""
        life_ns = int(self._guard_time.value) * int(self._factor.value) * _MS
        if self._heard_ns is None or life_ns == 0 or now_ns - self._heard_ns < life_ns:
            return False
        self._heard_ns = None
        self.is_missing = True
        return True

    def _change(self, _: int) -> None:
        """Begin again at the next remote frame; the toggle bit goes on."""
        self._heard_ns = None
        self.is_missing = False


def _interval_ns(entry: int) -> int:
    """Return the consumer time of an entry of 1016h, ns; 0 where the entry is unused."""
    return (entry & 0xFFFF) * _MS if entry >> 16 else 0
