"""SDO requests to one node in the cyclic phase, a step a cycle: a stop, the reason of a fault, the temperature.

A drive whose node left Operational ignores RPDOs and goes on with its last set-point; its SDO server still answers, and
by it the drive is stopped. No bus, no clock.
"""

from typing import NamedTuple

from friction_hil.drive import DriveState
from friction_hil_drivers.canopen.cycle.health import NodeCondition
from friction_hil_drivers.canopen.sdo.dialogue import Transfer, Upload
from friction_hil_drivers.canopen.stop.by_sdo import SdoStop
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.canopen.wire.cia301 import Frame
from friction_hil_drivers.cia402 import objects
from friction_hil_drivers.cia402.objects import Object
from friction_hil_drivers.cia402.temperature import TemperatureRead

ANSWER_NS = 50_000_000  # without an answer the request is repeated
_NMT_START_NS = 50_000_000  # between two attempts to bring a node back to Operational
_ERROR_CODE_ATTEMPTS = 5


class ErrorCodeRead:
    """Reading of 603Fh after a fault."""

    __slots__ = ("attempts_left", "code")

    def __init__(self) -> None:
        self.code: int | None = None  # as read; None before, or if the drive does not answer
        self.attempts_left = 0  # 0 once the code was read

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
    """SDO requests to one node in the cyclic phase, one at a time; the stop comes first, the temperature last.

    ``standstill``: see `friction_hil.drive.stop.DriveStop`. ``axis``: number of the axis in a node with several.
    """

    __slots__ = ("_axis", "_nmt_start_ns", "_node", "_pending", "error_code", "is_stopping", "stop", "temperature")

    def __init__(self, node: int, standstill: float, axis: int, temperature: TemperatureRead) -> None:
        self._node, self._axis = node, axis
        self.stop = SdoStop(standstill)
        self.error_code = ErrorCodeRead()
        self.temperature = temperature
        self.is_stopping = False  # the stop has begun and is not to be ended
        self._pending: _Pending | None = None
        self._nmt_start_ns = 0  # of the next attempt

    @property
    def state(self) -> DriveState:
        """State of a drive that is being stopped, as read back; UNKNOWN for another."""
        return self.stop.state if self.is_stopping else DriveState.UNKNOWN

    @property
    def is_proved_unpowered(self) -> bool:
        """True if a drive that is being stopped was read back without power."""
        return self.is_stopping and self.stop.is_proved

    def begin_stop(self, now_ns: int) -> None:
        """Begin to stop the drive, unless that has begun."""
        if not self.is_stopping:
            self.is_stopping, self._pending = True, None  # an answer that is under way is not waited for
            self.stop.begin(now_ns)

    def end_stop(self) -> None:
        """Leave the drive to RPDOs again."""
        self.is_stopping = False
        if self._pending is not None and self._pending.taker is self.stop:
            self._pending = None

    def frames(
        self, now_ns: int, condition: NodeCondition, *, is_out_of_reach: bool, is_answering: bool
    ) -> list[Frame]:
        """Return what is due: a request, unless an answer is awaited, and NMT start.

        A drive out of reach is being stopped until it answers SYNC again. If its node has left Operational, its
        configuration is in force, and RPDOs reach it again after NMT start; a Stopped node has no SDO. Where no
        heartbeat tells, a node that does not answer is taken to be Stopped. One that has restarted is left as it is.
        """
        if is_out_of_reach:
            self.begin_stop(now_ns)
        elif is_answering:
            self.end_stop()
        frame = self.next(now_ns)
        frames = [] if frame is None else [frame]
        has_left = condition is NodeCondition.NOT_OPERATIONAL
        is_startable = has_left or (self.stop.is_unanswered and condition is not NodeCondition.RESTARTED)
        if is_out_of_reach and is_startable and now_ns >= self._nmt_start_ns:
            self._nmt_start_ns = now_ns + _NMT_START_NS
            frames.insert(0, (cia301.NMT_ID, bytes((cia301.NmtCommand.START, self._node))))
        return frames

    def next(self, now_ns: int) -> Frame | None:
        """Return the request that is due; None while an answer is awaited, or if nothing is to be done."""
        if self._pending is not None:
            if now_ns < self._pending.deadline_ns:
                return None
            self._pending.transfer.is_silent = True
            self._finish(self._pending, now_ns)
        self._pending = self._due(now_ns)
        if self._pending is None:
            return None
        return cia301.SDO_REQUEST_BASE + self._node, self._pending.transfer.first()

    def _due(self, now_ns: int) -> _Pending | None:
        """Return the transfer that is due: the stop comes first, the temperature last."""
        takers: tuple[_Taker, ...] = (self.error_code, self.temperature)
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
