"""SDO server of a simulated drive that answers late, not at all, or with an abort code of its choice."""

from collections import deque
from collections.abc import Callable, Sequence

from friction_hil_drivers.canopen.sdo.dialogue import DOWNLOAD, FRAME_BYTES, HEAD, SPECIFIER, UPLOAD, abort
from friction_hil_drivers.canopen.simulated.manners import SdoManner
from friction_hil_drivers.canopen.simulated.sdo import SdoServer
from friction_hil_drivers.cia402.simulated.dictionary import Dictionary

_ACCESS = {DOWNLOAD: "write", UPLOAD: "read"}
_NS = 1_000_000_000


class SlowSdoServer:
    """An `SdoServer` with manners.

    A request takes effect at once, and its answer is sent late. Answers keep their order: while one is late, those
    to later requests wait behind it, also where the client has given up the first one, because a drive that is busy
    reads its mailbox afterwards.

    ``delay_s``: delay of every answer, s. ``manners``: exceptions for some objects; of several that fit a request, the
    first counts. ``clock``: returns the time in which delays pass, ns: real time, also where the drive's own time
    stands still without SYNC.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        send: Callable[[bytes], None],
        delay_s: float,
        manners: Sequence[SdoManner],
        clock: Callable[[], int],
    ) -> None:
        self._server = SdoServer(dictionary, self._answer)
        self._send = send
        self._delay_ns = round(delay_s * _NS)
        self._manners = [(manner, [manner.times]) for manner in manners]  # with the times that are left
        self._clock = clock
        self._late: deque[tuple[int, bytes]] = deque()  # due at, answer
        self._extra_ns = 0  # for the request that is being served

    def reset(self) -> None:
        """Forget a transfer under way and the answers that were not sent."""
        self._server.reset()
        self._late.clear()

    def request(self, data: bytes) -> None:
        """Take a request."""
        manner = self._manner_of(data)
        if manner is not None and manner.is_silent:
            return
        self._extra_ns = 0 if manner is None else round(manner.delay_s * _NS)
        if manner is not None and manner.abort is not None:
            _, index, subindex = HEAD.unpack_from(data)
            self._answer(abort((index, subindex), manner.abort))
        else:
            self._server.request(data)

    @property
    def due_in_s(self) -> float | None:
        """Time until an answer is due, s; None if none waits."""
        return max(0.0, (self._late[0][0] - self._clock()) / _NS) if self._late else None

    def poll(self) -> None:
        """Send the answers that are due."""
        while self._late and self._late[0][0] <= self._clock():
            self._send(self._late.popleft()[1])

    def _answer(self, data: bytes) -> None:
        delay_ns = self._delay_ns + self._extra_ns
        if delay_ns == 0 and not self._late:
            self._send(data)
            return
        due_ns = self._clock() + delay_ns
        if self._late:
            due_ns = max(due_ns, self._late[-1][0])
        self._late.append((due_ns, data))

    def _manner_of(self, data: bytes) -> SdoManner | None:
        """Return the exception for a request, and count it."""
        if not self._manners or len(data) != FRAME_BYTES:
            return None
        command, index, subindex = HEAD.unpack_from(data)
        access = _ACCESS.get(command & SPECIFIER)
        if access is None:
            return None
        for manner, left in self._manners:
            if manner.fits(index, subindex, access) and left[0] != 0:
                if left[0] is not None:
                    left[0] -= 1
                return manner
        return None
