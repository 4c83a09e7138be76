"""The first motion of an axis with velocity targets (csv): slow in whatever unit the drive takes its targets. Pure.

A drive that turns ten or a thousand times as fast as its unit says must not be found out at full speed. So before the
first real target, the target grows exponentially from one increment, until the axis has moved by a small distance d,
whatever that target means: then it moves at d / tau, in any unit. The target is held, and over a short window compared
with the displacement and with the velocity that the drive reports. Then the axis goes back to where it began.

Phases: rest (until the axis stands) -> ramp -> settle -> window -> return -> done.

>>> from friction_hil.daemon.safety import SafetyLimits
>>> motion = FirstMotion("x", "rad", SafetyLimits(torque=0.3, velocity=10.0), 1e-3, 1e-5, 1e-5)
>>> position, fault = 0.0, None
>>> while fault is None:
...     fault = motion.take(position, motion.target)
...     position += 10.0 * motion.target * 1e-3  # ten times as fast as it should be
>>> position < motion.bound
True
>>> fault
'x: the first motion: the drive turns 10 times as fast as the unit of its velocity target says: 0.0001 rad/s for one \
increment instead of 1e-05; that looks like 0.0001 rad/s; correct velocity_unit [FH-123]'
"""

import math
from enum import IntEnum

from friction_hil.daemon.safety import SafetyLimits
from friction_hil.daemon.start_numbers import First
from friction_hil.drive.codes import FaultCode
from friction_hil.errors import UsageError

# Units that drives are known to have: rad/s, or m/s, for one increment
_ROTARY = {
    "rev/s": 2.0 * math.pi,
    "rpm": 2.0 * math.pi / 60.0,
    "rad/s": 1.0,
    "deg/s": math.pi / 180.0,
}
_LINEAR = {"m/s": 1.0, "mm/s": 1e-3}
_PREFIXES = (1.0, 0.1, 0.01, 1e-3, 1e-4)


class Phase(IntEnum):
    """Phase of the first motion."""

    REST = 0
    RAMP = 1
    SETTLE = 2
    WINDOW = 3
    RETURN = 4
    DONE = 5


class FirstMotion:
    """Move one axis a little, and see whether its velocity target means what its unit says.

    The resolutions are the smallest steps of the position and of the velocity target, SI. Raises `UsageError`: the
    position is too coarse for the position limits.
    """

    __slots__ = (
        "_cycles",
        "_direction",
        "_distance",
        "_fastest",
        "_integral",
        "_limits",
        "_mark",
        "_name",
        "_period_s",
        "_phase",
        "_position_step",
        "_repeats",
        "_start",
        "_steps",
        "_tau_s",
        "_total",
        "_unheard",
        "_unit",
        "_velocity_step",
        "_warning",
        "bound",
        "target",
    )

    def __init__(
        self,
        name: str,
        unit: str,
        limits: SafetyLimits,
        period_s: float,
        position_resolution: float,
        velocity_resolution: float,
    ) -> None:
        self._name, self._unit, self._limits = name, unit, limits
        self._period_s = period_s
        self._position_step, self._velocity_step = position_resolution, velocity_resolution
        span = limits.position_high - limits.position_low
        self._distance = max(
            min(First.BOUND_S * limits.velocity, First.BOUND_SPAN * span) / First.PARTS,
            First.LEAST_STEPS * position_resolution,
        )
        # distance beyond which the motion ends in any case, SI; stopping takes a little more
        self.bound = First.PARTS * self._distance
        if self.bound > 0.5 * span:
            raise UsageError(
                f"{name}: the position is too coarse (steps of {position_resolution:.3g} {unit}) for the first motion "
                f"of mode csv within the position limits: it needs {self.bound:.3g} {unit}"
            )
        self._tau_s = max(First.TAU_S, First.SHORTEST_CYCLES * period_s)
        self._fastest = min(First.FASTEST * self._distance / self._tau_s, limits.velocity)
        self._phase = Phase.REST
        self._cycles = 0  # in this phase
        self._total = 0  # cycles since the axis began to rest
        self._unheard = 0  # cycles without feedback before this one
        self._start = math.nan  # position at the beginning
        self._mark = math.nan  # position at the beginning of the phase
        self._integral = 0.0  # of the reported velocity, in the window
        self._direction = 1.0
        self._steps = 0  # the target, in increments
        self._repeats = First.REPEATS
        self.target = 0.0  # velocity of this cycle, SI
        self._warning: str | None = None

    @property
    def is_done(self) -> bool:
        """True once the unit of the velocity target is confirmed and the axis is back."""
        return self._phase is Phase.DONE

    def take(self, position: float, velocity: float, missed: int = 0, *, is_usable: bool = True) -> str | None:
        """Take one cycle's feedback and set the next target; return a fault as a message, or None.

        ``position``, ``velocity``: as the drive reports them, SI. ``missed``: periods since the cycle before that had
        none. ``is_usable``: False for a cycle without feedback.
        """
        if self._phase is Phase.DONE:
            return None
        self._cycles += 1 + missed
        self._total += 1 + missed
        self._unheard += missed
        if not is_usable:
            self._unheard += 1
            return None
        if math.isnan(self._mark):
            self._mark = position
        fault = self._advance(position, velocity)
        self._unheard = 0
        self.target = 0.0 if fault else self._direction * self._steps * self._velocity_step
        return fault

    def take_warning(self) -> str | None:
        """Return the warning of the motion, once: the axis is slower than its target although its unit is right."""
        warning, self._warning = self._warning, None
        return warning

    def _advance(self, position: float, velocity: float) -> str | None:
        if self._phase is Phase.REST:
            return self._rest(position)
        moved = self._direction * (position - self._start)  # along the first direction of the target
        if self._phase is Phase.RETURN:
            return self._return(position)
        if moved <= -self._distance:
            return self._wrong_direction(moved)
        if self._phase is Phase.WINDOW:
            self._integral += self._direction * velocity * self._period_s * (1 + self._unheard)
        if moved >= self.bound:
            return self._judge(position, moved)
        if self._phase is Phase.RAMP:
            return self._ramp(position, moved)
        if self._phase is Phase.SETTLE:
            if self._is_over(First.SETTLE_S):
                self._enter(Phase.WINDOW, position)
                self._integral = 0.0
        elif self._is_over(First.WINDOW_S):
            return self._judge(position, moved)
        return None

    def _rest(self, position: float) -> str | None:
        """Wait until the axis stands: a load may still settle on a drive that was just enabled."""
        if (
            abs(position - self._mark) > First.RESTING * self._distance
            and self._total * self._period_s < First.LONGEST_REST_S
        ):
            self._enter(Phase.REST, position)
        elif self._is_over(First.REST_S):
            if self._velocity_step > self._limits.velocity:
                text = (
                    f"one increment of the velocity target is {self._velocity_step:.4g} {self._unit}/s by its unit, "
                    f"more than limits.velocity ({self._limits.velocity:g} {self._unit}/s); correct velocity_unit"
                )
                return self._fault(FaultCode.VELOCITY_UNIT_WRONG, text)
            self._start = position
            room = self._limits.position_high - position, position - self._limits.position_low
            self._direction = 1.0 if room[0] >= room[1] else -1.0
            self._enter(Phase.RAMP, position)
            self._steps = 1
        return None

    def _ramp(self, position: float, moved: float) -> str | None:
        """Let the target grow until the axis has moved by d; at the largest target, wait for it to break loose."""
        most = max(1, int(self._fastest / self._velocity_step))
        grown = math.exp(min(self._cycles * self._period_s / self._tau_s, 60.0))
        self._steps = min(int(grown), most)
        if moved >= self._distance:
            self._enter(Phase.SETTLE, position)
        elif self._cycles * self._period_s >= self._tau_s * math.log(most + 1.0) + First.STUCK_S:
            if moved <= 2.0 * self._position_step:
                text = (
                    f"the axis does not move although {self._steps * self._velocity_step:.3g} {self._unit}/s is "
                    "demanded: brake, blocked axis, torque limit of the drive, or velocity_unit"
                )
                return self._fault(FaultCode.AXIS_DOES_NOT_MOVE, text)
            self._enter(Phase.SETTLE, position)
        return None

    def _judge(self, position: float, moved: float) -> str | None:
        """Compare target, displacement and reported velocity over the window."""
        asked = self._steps * self._velocity_step
        if self._phase is Phase.WINDOW and self._cycles >= 3:
            duration_s, way = self._cycles * self._period_s, self._direction * (position - self._mark)
            reported = self._integral
            tolerance = First.TOLERANCE * abs(way) + self._velocity_step * duration_s + 4.0 * self._position_step
            is_consistent = abs(reported - way) <= tolerance
        else:  # beyond the bound already: much too fast, the velocity is that of the whole motion
            way, reported, is_consistent = self._direction * (position - self._mark), math.nan, False
            duration_s = self._cycles * self._period_s
            if self._phase is Phase.RAMP and self._steps > 1:
                duration_s = self._tau_s  # the integral of an exponential
        found = way / duration_s
        slack = 2.0 * self._position_step / duration_s
        is_too_fast = found > (1.0 + First.TOLERANCE) * asked + slack
        if (
            is_too_fast
            and is_consistent
            and self._repeats > 0
            and found < First.OVERSHOOT * asked
            and moved < self.bound
        ):
            self._repeats -= 1
            self._integral = 0.0
            self._enter(Phase.WINDOW, position)
            return None
        if is_too_fast or (not is_consistent and found < (1.0 - First.TOLERANCE) * asked):
            return self._wrong_unit(found / asked)
        if not is_consistent and math.isfinite(reported):
            text = (
                f"the drive reports a velocity {reported / way:.3g} times the derivative of its position: unit of the "
                "reported velocity, or frozen or slipping encoder"
            )
            return self._fault(FaultCode.VELOCITY_UNIT_WRONG, text)
        if found < First.STANDING * asked:
            text = f"the axis does not move although {asked:.3g} {self._unit}/s is demanded: brake, or blocked axis"
            return self._fault(FaultCode.AXIS_DOES_NOT_MOVE, text)
        if found < (1.0 - First.TOLERANCE) * asked - slack:
            self._warning = (
                f"{self._name}: the first motion: the axis reaches only {found / asked:.0%} of a velocity target of "
                f"{asked:.3g} {self._unit}/s, though its unit is right: friction, or a velocity loop without integral"
            )
        self._enter(Phase.RETURN, position)
        self._steps = -self._steps
        return None

    def _return(self, position: float) -> str | None:
        """Go back to where the motion began, as far as the axis follows."""
        moved = self._direction * (position - self._start)
        if self._steps and (moved <= 0.0 or self._is_over(First.LONGEST_RETURN_S)):
            self._steps = 0
            self._cycles = 0
        elif not self._steps and self._is_over(First.SETTLE_S):
            self._enter(Phase.DONE, position)
        return None

    def _enter(self, phase: Phase, position: float) -> None:
        self._phase, self._cycles, self._mark = phase, 0, position

    def _is_over(self, time_s: float) -> bool:
        return self._cycles >= max(time_s / self._period_s - 1e-9, First.SHORTEST_CYCLES)

    def _wrong_direction(self, moved: float) -> str:
        text = (
            f"the axis moves in the wrong direction, by {moved:.3g} {self._unit} against its velocity target: sign of "
            "the encoder or of the motor in the drive, or a load that the drive does not hold"
        )
        return self._fault(FaultCode.WRONG_DIRECTION, text)

    def _wrong_unit(self, factor: float) -> str:
        step = self._velocity_step
        guess = likely_unit(factor * step, self._unit, self._position_step)
        looks = f"; that looks like {guess}" if guess else ""
        verb = "turns" if self._unit == "rad" else "moves"
        text = (
            f"the drive {verb} {factor:.3g} times as fast as the unit of its velocity target says: {factor * step:.3g} "
            f"{self._unit}/s for one increment instead of {step:.3g}{looks}; correct velocity_unit"
        )
        return self._fault(FaultCode.VELOCITY_UNIT_WRONG, text)

    def _fault(self, code: FaultCode, text: str) -> str:
        return code.append_to(f"{self._name}: the first motion: {text}")


def likely_unit(size: float, unit: str, position_resolution: float) -> str:
    """Return the unit of velocity whose increment is nearest to ``size``, "" if none is near.

    >>> likely_unit(0.0104, "rad", 1e-6)
    '0.1 rpm'
    """
    named = (_ROTARY if unit == "rad" else _LINEAR) | {"counts/s": position_resolution}
    sizes = {
        name if prefix == 1.0 else f"{prefix:g} {name}": prefix * base
        for name, base in named.items()
        for prefix in _PREFIXES
    }
    if not size > 0.0:
        return ""
    best = min(sizes, key=lambda name: (round(abs(math.log(sizes[name] / size)), 6), len(name)))
    return best if abs(math.log(sizes[best] / size)) <= First.LIKENESS else ""
