"""What the frames on the wire say of one axis: torque and its steps, power, and when each of them ended.

The wire decodes frames; the witness sees values alone, so that CAN and serial lines are judged by the same rules.
Torque is in per mille of the rated torque and positions in counts as on the wire, time in seconds of the campaign's
clock.

A torque within its limits can be wrong all the same. Where the axis slides, its friction is known within a factor: more
than `_MOST_FRICTION` times that is no compensation. Where it comes to rest or an encoder jumps, nothing is known of it.
"""

import math
from collections import deque
from dataclasses import dataclass, field

# statusword & 6Fh of CiA 402: Operation enabled, Quick stop active, Fault reaction active (that one without bit 5)
_POWERED = (0x27, 0x07, 0x0F, 0x2F)
_ROUNDING = 0.5 + 1e-6  # per mille: the drive's resolution
_MOST_KEPT = 8
_ENABLED = 0x27  # statusword & 6Fh: operation enabled
_ENABLE = 0x0F  # controlword & 8Fh: enable operation
_QUICK_STOP = 0x02  # controlword & 86h
_MOVING = 0.02  # of the largest speed: an axis that must not lose its power without a quick stop
_SLIDING = 0.05  # of the largest speed: friction has its level of sliding
_SLIDING_S = 0.05  # for so long
_MOST_FRICTION = 1.6
_LATE_PERIODS = 2.0  # by which commands may be nearer to each other than their periods
_COMMANDS = 12  # in which the slew is judged by time


def is_powered(statusword: int) -> bool:
    """Return True for a state of CiA 402 in which the motor may have torque."""
    return statusword & 0x6F in _POWERED


def keeps_power(controlword: int) -> bool:
    """Return True for the commands enable operation and quick stop, with which a drive keeps its torque."""
    return controlword & 0x8F == 0x0F or controlword & 0x86 == 0x02


def _difference(after: float, before: float) -> float:
    """Return the change of a position, counts, that wraps round as an integer of 32 bits."""
    return (after - before + 2.0**31) % 2.0**32 - 2.0**31


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of an axis, in the units of the wire."""

    torque: float  # per mille
    step: float  # per mille, from one command to the next
    period_s: float = 0.0  # 0: time is not judged
    speed: float = math.inf  # counts/s, of what the drive is asked for
    acceleration: float = math.inf  # counts/s^2, of set-points of position; of velocity by one period
    sliding: float = math.inf  # per mille: friction of sliding times the gain; infinity where more is commanded


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
    bends : list of str
        Set-points of position that lead elsewhere than those before, as they may where the daemon says that the
        computer is too slow for the motion to wait for missed periods.
    largest_friction, largest_bend : float
        Torque of sliding by the friction, and change of the set-points by its limit.
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
    bends: list[str] = field(default_factory=list)
    largest_friction: float = 0.0
    largest_bend: float = 0.0
    _torques: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=_COMMANDS))
    _positions: deque[float] = field(default_factory=lambda: deque(maxlen=2))
    _velocities: deque[float] = field(default_factory=lambda: deque(maxlen=1))
    _position: tuple[float, float] | None = None
    _zeroed: tuple[float, str] | None = None  # a velocity of zero, which a quick stop must follow
    _sliding: tuple[float, float] | None = None  # since when, and the speed then
    _speed: float = 0.0

    def command(
        self,
        time_s: float,
        torque: float | None,
        controlword: int | None,
        position: float | None = None,
        velocity: float | None = None,
    ) -> None:
        """Judge a command of the daemon; None for what it does not say."""
        self._judge_order(time_s, controlword)
        if torque is not None:
            self.commands += 1
            self._judge_torque(time_s, torque, controlword)
            self.torque = torque
            self.took(time_s, torque)
        if self._zeroed is not None and controlword is not None and controlword & 0x8F == _ENABLE:
            self._break(*self._zeroed)
        self._zeroed = None
        is_enabled = controlword is not None and controlword & 0x8F == _ENABLE and self._reports(_ENABLED)
        if not is_enabled:
            self._positions.clear()
            self._velocities.clear()
        else:
            self._judge_setpoints(time_s, position, velocity)
        self.controlword = controlword

    def _judge_torque(self, time_s: float, torque: float, controlword: int | None) -> None:
        step = abs(torque - self.torque)
        is_end = torque == 0.0 and controlword is not None and not keeps_power(controlword)
        if is_end:
            self._torques.clear()
        else:
            self.largest_step = max(self.largest_step, step)
            if step > self.limits.step + 2.0 * _ROUNDING:
                self._break(time_s, f"a step of {step:.1f} per mille, from {self.torque:g} to {torque:g}")
            self._judge_slew(time_s, torque)
        self.largest_torque = max(self.largest_torque, abs(torque))
        if abs(torque) > self.limits.torque + _ROUNDING or not math.isfinite(torque):
            self._break(time_s, f"a torque of {torque:g} per mille")
        if self._is_sliding(time_s):
            self.largest_friction = max(self.largest_friction, abs(torque) / self.limits.sliding)
            if abs(torque) > _MOST_FRICTION * self.limits.sliding + _ROUNDING:
                self._break(time_s, f"a torque of {torque:g} per mille against a friction of {self.limits.sliding:.1f}")

    def _judge_slew(self, time_s: float, torque: float) -> None:
        """Judge the slew in time: commands that follow each other at once are so many steps in one."""
        if not self.limits.period_s:
            return
        for before_s, before in self._torques:
            periods = (time_s - before_s) / self.limits.period_s + _LATE_PERIODS
            if abs(torque - before) > periods * self.limits.step + 2.0 * _ROUNDING:
                text = f"from {before:g} to {torque:g} per mille within {1e3 * (time_s - before_s):.1f} ms"
                self._break(time_s, text)
                self._torques.clear()
                break
        self._torques.append((time_s, torque))

    def _judge_setpoints(self, time_s: float, position: float | None, velocity: float | None) -> None:
        limits = self.limits
        if position is not None and limits.period_s:
            last = self._positions
            if last and position == last[-1]:
                return  # sent once more, because the drive has not taken it over
            step = _difference(position, last[-1]) if last else 0.0
            if abs(step) > limits.speed * limits.period_s + 1.0:
                self._break(time_s, f"a set-point {step:g} counts from the one before")
            elif len(last) == 2:
                bend = step - _difference(last[1], last[0])
                self.largest_bend = max(self.largest_bend, abs(bend) / (limits.acceleration * limits.period_s**2))
                if abs(bend) > limits.acceleration * limits.period_s**2 + 4.0:
                    text = f"a set-point {bend:g} counts from where the ones before led"
                    self._break(time_s, text, among=self.bends)
            last.append(position)
        if velocity is not None and limits.period_s:
            if self._velocities:
                step = abs(velocity - self._velocities[-1])
                self.largest_bend = max(self.largest_bend, step / (limits.acceleration * limits.period_s))
                if step > limits.acceleration * limits.period_s + 1.0 or abs(velocity) > limits.speed:
                    text = f"velocity set-points {self._velocities[-1]:g} and {velocity:g} in a row"
                    if velocity == 0.0:
                        self._zeroed = (time_s, text)
                    else:
                        self._break(time_s, text)
            self._velocities.append(velocity)

    def _judge_order(self, time_s: float, controlword: int | None) -> None:
        """Judge how power is taken from an axis that moves: by a quick stop, and then by disabling."""
        before = self.controlword
        if controlword is None or before is None or before & 0x8F != _ENABLE or keeps_power(controlword):
            return
        if self._reports(_ENABLED) and self._speed > _MOVING * self.limits.speed:
            self._break(time_s, f"controlword {controlword:04X}h without a quick stop before it, in motion")

    def feedback(self, time_s: float, position: float) -> None:
        """Note the position that the drive reports."""
        if self._position is not None and time_s > self._position[0]:
            self._speed = _difference(position, self._position[1]) / (time_s - self._position[0])
            is_plausible = self._least_sliding < abs(self._speed) < self.limits.speed
            if not is_plausible or (self._sliding is not None and self._sliding[1] * self._speed < 0.0):
                self._sliding = None
            elif self._sliding is None:
                self._sliding = (time_s, self._speed)
            self._speed = abs(self._speed)
        self._position = (time_s, position)

    @property
    def _least_sliding(self) -> float:
        """Speed, counts/s, from which the axis still slides when the torque acts that is commanded now."""
        slows = self.limits.acceleration * self.limits.period_s
        return _SLIDING * self.limits.speed + (slows if math.isfinite(slows) else 0.0)

    def forget_times(self) -> None:
        """Forget when commands came: whoever looks at the wire was late itself."""
        self._torques.clear()
        self._position = None
        self._sliding = None

    def _is_sliding(self, time_s: float) -> bool:
        is_known = self.limits.period_s and self._position is not None
        if not is_known or self._sliding is None or not math.isfinite(self.limits.sliding):
            return False
        is_recent = time_s - self._position[0] < _SLIDING_S if self._position is not None else False
        return is_recent and time_s - self._sliding[0] > _SLIDING_S and self._reports(_ENABLED)

    def _reports(self, state: int) -> bool:
        return self.statusword is not None and self.statusword & 0x6F == state

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

    def _break(self, time_s: float, text: str, among: list[str] | None = None) -> None:
        kept = self.broken if among is None else among
        if len(kept) < _MOST_KEPT:
            limits = f"limits {self.limits.torque:.1f} and {self.limits.step:.1f} a command"
            kept.append(f"{time_s:.4f} s: {text} ({limits})")
