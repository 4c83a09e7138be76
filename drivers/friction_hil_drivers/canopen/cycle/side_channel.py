"""SDO requests to one node in the cyclic phase, a step a cycle: a stop, the reason of a fault, the temperature.

A drive whose node left Operational ignores RPDOs and goes on with its last set-point; its SDO server still answers, and
by it the drive is stopped. No bus, no clock.
"""

from typing import NamedTuple

from friction_hil_drivers.canopen.sdo.dialogue import Transfer, Upload
from friction_hil_drivers.canopen.stop.by_sdo import SdoStop
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.canopen.wire.cia301 import Frame
from friction_hil_drivers.cia402 import objects
from friction_hil_drivers.cia402.objects import Object
from friction_hil_drivers.cia402.temperature import TemperatureRead

ANSWER_NS = 50_000_000  # without an answer the request is repeated
_ERROR_CODE_ATTEMPTS = 5


class ErrorCodeRead:
    """Reading of 603Fh after a fault.

    Attributes
    ----------
    code : int or None
        As read; None before, or if the drive does not answer.
    attempts_left : int
        More than 0 until the code was read.
    """

    __slots__ = ("attempts_left", "code")

    def __init__(self) -> None:
        self.code: int | None = None
        self.attempts_left = 0

    def begin(self) -> None:
        """Read the code again."""
        self.code, self.attempts_left = None, _ERROR_CODE_ATTEMPTS

    def request(self, now_ns: int) -> Transfer | None:
        """Return the transfer that is due."""
        return Upload(objects.ERROR_CODE) if self.attempts_left else None

    def take(self, transfer: Transfer, now_ns: int) -> None:
        """Take the transfer once it is over."""
        self.attempts_left -= 1
        if not transfer.is_silent:
            self.code, self.attempts_left = transfer.value, 0


_Taker = SdoStop | ErrorCodeRead | TemperatureRead


class _Pending(NamedTuple):
    """Transfer whose answer is awaited, and who takes it."""

    transfer: Transfer
    taker: _Taker
    deadline_ns: int


class CyclicSdo:
    """SDO requests to one node in the cyclic phase, one at a time; the stop comes first.

    Parameters
    ----------
    node : int
        Node number.
    standstill : float
        See `friction_hil.drive.stop.DriveStop`.
    axis : int
        Number of the axis in a node with several.
    temperature : TemperatureRead
        What is read when nothing else is to be asked.

    Attributes
    ----------
    stop : SdoStop
    is_stopping : bool
        The stop has begun and is not to be ended.
    error_code : ErrorCodeRead
    """

    __slots__ = (
        "_axis",
        "_pending",
        "_request_id",
        "_temperature",
        "error_code",
        "is_stopping",
        "stop",
    )

    def __init__(self, node: int, standstill: float, axis: int, temperature: TemperatureRead) -> None:
        self._request_id = cia301.SDO_REQUEST_BASE + node
        self._axis = axis
        self.stop = SdoStop(standstill)
        self.error_code = ErrorCodeRead()
        self.is_stopping = False
        self._pending: _Pending | None = None
        self._temperature = temperature

    def begin_stop(self, now_ns: int) -> None:
        """Begin to stop the drive."""
        self.is_stopping, self._pending = True, None  # an answer that is under way is not waited for
        self.stop.begin(now_ns)

    def end_stop(self) -> None:
        """Leave the drive to RPDOs again."""
        self.is_stopping = False
        if self._pending is not None and self._pending.taker is self.stop:
            self._pending = None

    def next(self, now_ns: int) -> Frame | None:
        """Return the frame that is due; None while an answer is awaited, or if nothing is to be done."""
        if self._pending is not None:
            if now_ns < self._pending.deadline_ns:
                return None
            self._pending.transfer.is_silent = True
            self._finish(self._pending, now_ns)
        self._pending = self._due(now_ns)
        return None if self._pending is None else (self._request_id, self._pending.transfer.first())

    def _due(self, now_ns: int) -> _Pending | None:
        """Return the transfer that is due: the stop comes first, the temperature last."""
        takers: tuple[_Taker, ...] = (self.error_code, self._temperature)
        for taker in (self.stop, *takers) if self.is_stopping else takers:
            if (due := taker.request(now_ns)) is not None:
                transfer = Upload(due) if isinstance(due, Object) else due
                transfer.entry = transfer.entry.of_axis(self._axis)
                return _Pending(transfer, taker, now_ns + ANSWER_NS)
        return None

    def take(self, data: bytes, now_ns: int) -> None:
        """Take a frame of the SDO server; what answers no request of this client is ignored."""
        pending = self._pending
        if pending is None:
            return
        if pending.transfer.take(data) is not None:
            pending.transfer.first()  # what comes in segments is no number: it counts as no answer
        if pending.transfer.is_done:
            self._finish(pending, now_ns)

    def _finish(self, pending: _Pending, now_ns: int) -> None:
        self._pending = None
        pending.taker.take(pending.transfer, now_ns)
