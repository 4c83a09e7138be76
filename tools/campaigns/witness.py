"""What the frames on the wire say of one axis: torque and its steps, power, and when each of them ended.

The wire decodes frames; the witness sees values alone, so that CAN and serial lines are judged by the same rules.
Torque is in per mille of the rated torque as on the wire, time in seconds of the campaign's clock.
"""

import math
from dataclasses import dataclass, field

# statusword & 6Fh of CiA 402: Operation enabled, Quick stop active, Fault reaction active (that one without bit 5)
_POWERED = (0x27, 0x07, 0x0F, 0x2F)
_ROUNDING = 0.5 + 1e-6  # per mille: the drive's resolution
_MOST_KEPT = 8


def is_powered(statusword: int) -> bool:
    """Return True for a state of CiA 402 in which the motor may have torque."""
    return statusword & 0x6F in _POWERED


def keeps_power(controlword: int) -> bool:
    """Return True for the commands enable operation and quick stop, with which a drive keeps its torque."""
    return controlword & 0x8F == 0x0F or controlword & 0x86 == 0x02


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of an axis, in the units of the wire."""

    torque: float  # per mille
    step: float  # per mille, from one command to the next


@dataclass(slots=True)
class Witness:
    """Takes commands of the daemon and answers of the drive as they pass.

    Attributes
    ----------
    largest_torque, largest_step : float
        Of all commands; a step is that between two commands in a row. One that ends in zero with the power taken away
        is none.
    zero_since_s : float or None
        Time of the command or write since which the torque that the drive was given is zero; 0: from the start.
    unpowered_since_s : float or None
        Time of the frame since which the drive has no power.
    unread : int
        Frames or telegrams that may be commands, and that could not be read.
    broken : list of str
        Limits that a command broke, the first ones in words.
    """

    limits: Limits
    largest_torque: float = 0.0
    largest_step: float = 0.0
    commands: int = 0
    unread: int = 0
    torque: float = 0.0
    controlword: int | None = None
    zero_since_s: float | None = 0.0
    unpowered_since_s: float | None = None
    statusword: int | None = None
    was_powered: bool = False
    emergencies: list[int] = field(default_factory=list)
    broken: list[str] = field(default_factory=list)

    def command(self, time_s: float, torque: float, controlword: int | None) -> None:
        """Judge a command of the daemon."""
        self.commands += 1
        step = abs(torque - self.torque)
        is_end = torque == 0.0 and controlword is not None and not keeps_power(controlword)
        if not is_end:
            self.largest_step = max(self.largest_step, step)
            if step > self.limits.step + 2.0 * _ROUNDING:
                self._break(time_s, f"a step of {step:.1f} per mille, from {self.torque:g} to {torque:g}")
        self.largest_torque = max(self.largest_torque, abs(torque))
        if abs(torque) > self.limits.torque + _ROUNDING or not math.isfinite(torque):
            self._break(time_s, f"a torque of {torque:g} per mille")
        self.torque = torque
        self.controlword = controlword
        self.took(time_s, torque)

    def took(self, time_s: float, torque: float) -> None:
        """Note what somebody gave the drive as torque."""
        if torque != 0.0:
            self.zero_since_s = None
        elif self.zero_since_s is None:
            self.zero_since_s = time_s

    def status(self, time_s: float, statusword: int) -> None:
        """Note the state that the drive reports."""
        self.statusword = statusword
        if is_powered(statusword):
            self.was_powered, self.unpowered_since_s = True, None
        elif self.unpowered_since_s is None:
            self.unpowered_since_s = time_s

    def forget_status(self) -> None:
        """Forget the state, so that the next one is a new answer of the drive."""
        self.statusword = None

    def _break(self, time_s: float, text: str) -> None:
        if len(self.broken) < _MOST_KEPT:
            limits = f"limits {self.limits.torque:.1f} and {self.limits.step:.1f} a command"
            self.broken.append(f"{time_s:.4f} s: {text} ({limits})")
