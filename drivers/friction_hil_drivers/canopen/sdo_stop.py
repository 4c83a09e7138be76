"""Stop of one node by SDO, for a drive that RPDOs do not reach. State machines of the cyclic phase: no bus, no clock.

A drive whose node left Operational ignores RPDOs and goes on with its last set-point; its SDO server still answers. The
stop writes 6040h = quick stop at once, waits for standstill, writes 6040h = disable voltage, and repeats that until
6041h, read back, shows no power. Nothing is believed that was not read back. Standstill is judged by position, 6064h:
a velocity 606Ch may have another unit than is assumed.
"""

from enum import IntEnum
from typing import NamedTuple

from friction_hil.drive import DriveState
from friction_hil_drivers.canopen import cia301
from friction_hil_drivers.canopen.cia301 import Frame
from friction_hil_drivers.canopen.dialogue import Download, Transfer, Upload
from friction_hil_drivers.cia402 import objects, profile
from friction_hil_drivers.cia402.objects import Object
from friction_hil_drivers.cia402.temperature import TemperatureRead
from friction_hil_drivers.cia402.units import wrap

ANSWER_NS = 50_000_000  # without an answer the request is repeated
_OBEY_NS = 100_000_000  # for the quick stop to begin; then voltage is disabled
_QUICK_STOP_NS = 2_000_000_000  # for the quick stop to end; then voltage is disabled all the same
_BLIND_NS = 500_000_000  # the same where 6064h does not answer, or nothing does
STANDSTILL_NS = 50_000_000
_VERIFY_NS = 100_000_000  # between two readings of a drive without power
_ERROR_CODE_ATTEMPTS = 5
_MOST_UNANSWERED = 2  # requests in a row; then the node may be in NMT state Stopped, which has no SDO


class _Step(IntEnum):
    COMMAND = 0  # write 6040h
    READ_STATE = 1
    READ_POSITION = 2
    WAIT = 3  # without power; read again later


class SdoStop:
    """Stop of one drive: quick stop, standstill, disable voltage, read back.

    Parameters
    ----------
    standstill : float
        Largest change of 6064h in `STANDSTILL_NS` that counts as standstill, counts.

    Attributes
    ----------
    state : DriveState
        As read back last; UNKNOWN before.
    is_proved : bool
        The last reading showed a drive without power.
    """

    __slots__ = (
        "_began_ns",
        "_is_disabling",
        "_is_heard",
        "_rested_at",
        "_standing_since_ns",
        "_standstill",
        "_step",
        "_unanswered",
        "_wait_until_ns",
        "is_proved",
        "state",
    )

    def __init__(self, standstill: float) -> None:
        self._standstill = standstill
        self.begin(0)

    def begin(self, now_ns: int) -> None:
        """Begin with the quick stop; what was read before does not count."""
        self.state = DriveState.UNKNOWN
        self.is_proved = False
        self._began_ns = self._wait_until_ns = now_ns
        self._rested_at: int | None = None  # position around which it has stood since
        self._standing_since_ns = now_ns
        self._is_disabling = self._is_heard = False
        self._unanswered = 0
        self._step = _Step.COMMAND

    @property
    def is_unanswered(self) -> bool:
        """True if the last requests were not answered."""
        return self._unanswered >= _MOST_UNANSWERED

    def request(self, now_ns: int) -> Transfer | None:
        """Return the transfer that is due."""
        elapsed_ns = now_ns - self._began_ns
        if elapsed_ns > _QUICK_STOP_NS or (elapsed_ns > _BLIND_NS and not self._is_heard):
            self._is_disabling = True
        if self._step is _Step.WAIT:
            if now_ns < self._wait_until_ns:
                return None
            self._step = _Step.READ_STATE
        if self._step is _Step.READ_STATE:
            return Upload(objects.STATUSWORD)
        if self._step is _Step.READ_POSITION:
            return Upload(objects.POSITION_ACTUAL)
        word = profile.DISABLE_VOLTAGE if self._is_disabling else profile.QUICK_STOP
        return Download(objects.CONTROLWORD, word)

    def take(self, transfer: Transfer, now_ns: int) -> None:
        """Take the transfer that was due last, once it is over."""
        if transfer.is_silent:
            self.state, self.is_proved = DriveState.UNKNOWN, False
            self._step = _Step.COMMAND
            self._unanswered += 1
            return
        self._is_heard, self._unanswered = True, 0
        if self._step is _Step.READ_STATE:
            self._take_state(transfer.value, now_ns)
        elif self._step is _Step.READ_POSITION:
            self._take_position(transfer.value, now_ns)
        else:
            self._step = _Step.READ_STATE

    def _take_state(self, statusword: int | None, now_ns: int) -> None:
        self.state = DriveState.UNKNOWN if statusword is None else profile.drive_state(statusword)
        self.is_proved = not self.state.is_powered and self.state is not DriveState.UNKNOWN
        if self.is_proved:
            self._step, self._wait_until_ns = _Step.WAIT, now_ns + _VERIFY_NS
        elif self.state is DriveState.FAULT_REACTION_ACTIVE and not self._is_disabling:
            self._step = _Step.READ_STATE  # it stops by itself
        elif self.state is DriveState.QUICK_STOP_ACTIVE and not self._is_disabling:
            self._step = _Step.READ_POSITION
        else:
            self._is_disabling = self._is_disabling or now_ns - self._began_ns > _OBEY_NS
            self._step = _Step.COMMAND

    def _take_position(self, position: int | None, now_ns: int) -> None:
        self._step = _Step.READ_STATE
        if position is None:
            is_over = now_ns - self._began_ns > _BLIND_NS
        elif self._rested_at is None or abs(wrap(position - self._rested_at)) > self._standstill:
            self._rested_at, self._standing_since_ns = position, now_ns
            return
        else:
            is_over = now_ns - self._standing_since_ns >= STANDSTILL_NS
        if is_over:
            self._is_disabling = True
            self._step = _Step.COMMAND


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
        See `SdoStop`.
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
