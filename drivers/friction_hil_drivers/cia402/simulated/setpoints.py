"""Set-points of a simulated drive: targets, offsets and the limits on them, handed to the servo."""

import math

from friction_hil.drive import Mode
from friction_hil.errors import UsageError
from friction_hil.servo.servo import Servo
from friction_hil_drivers.cia402 import objects
from friction_hil_drivers.cia402.access import Abort, AbortError
from friction_hil_drivers.cia402.simulated.dictionary import Dictionary
from friction_hil_drivers.cia402.simulated.units import SimulatedUnits, unwrapped
from friction_hil_drivers.cia402.units import wrap

NO_MODE = 0
_CSP, _CSV, _CST = Mode.CSP, Mode.CSV, Mode.CST


class Setpoints:
    """Targets and offsets that the master wrote since `forget`.

    Values written before that stay in the dictionary without effect, so that a drive neither jumps nor pushes when it
    is enabled or changes its mode: until the next target it holds its position, or gives no torque.
    """

    def __init__(
        self, servo: Servo, units: SimulatedUnits, dictionary: Dictionary, *, is_reversed: bool = False
    ) -> None:
        self._servo = servo
        self._units = units
        self._sign = units.sign
        self._drive_sign = -units.sign if is_reversed else units.sign  # of velocity and torque
        self._min_position, self._max_position, self._max_speed, self._max_torque = dictionary.entries(
            objects.MIN_POSITION_LIMIT, objects.MAX_POSITION_LIMIT, objects.MAX_MOTOR_SPEED, objects.MAX_TORQUE
        )
        self._period, self._exponent = dictionary.entries(objects.INTERPOLATION_PERIOD, objects.INTERPOLATION_EXPONENT)
        self._max_torque.on_write = self._limit_torque
        self._period.on_write = self._write_period
        self._exponent.on_write = lambda value: self._set_period(self._period.value, value)
        for known, name in (
            (objects.TARGET_POSITION, "_position"),
            (objects.TARGET_VELOCITY, "_velocity"),
            (objects.TARGET_TORQUE, "_torque"),
            (objects.POSITION_OFFSET, "_position_offset"),
            (objects.VELOCITY_OFFSET, "_velocity_offset"),
            (objects.TORQUE_OFFSET, "_torque_offset"),
        ):
            entry = dictionary.of(known)
            if entry.type.is_signed:
                entry.on_write = lambda value, name=name: self._take(name, value)
            else:  # in a vendor's file
                entry.on_write = lambda value, name=name: self._take(name, wrap(value))
        self._period_s = 0.0
        self.load()
        self.forget()

    def load(self) -> None:
        """Apply the settings in the dictionary."""
        self._limit_torque(self._max_torque.value)
        self._set_period(self._period.value, self._exponent.value)

    def forget(self) -> None:
        """Hold the present position, without velocity and torque, until the next target."""
        self._position: int | None = None  # as on the wire; None: no target came yet
        self._in_force = round(self._sign * self._servo.position * self._units.counts)  # counts without wraps
        self._velocity = self._torque = 0
        self._position_offset = self._velocity_offset = self._torque_offset = 0
        self._is_first = True
        self.are_new = True  # not activated yet
        self.are_offsets_new = False  # offsets alone: they take effect at once, without a step of the interpolation
        self.are_limited = False  # a limit other than that of the torque cut the last target

    def jumps_beyond(self, window: int) -> bool:
        """True if the first target position is further than ``window`` counts from the position of the axis."""
        if not self._is_first or self._position is None:
            return False
        return abs(self._absolute(self._within_limits(self._position)) - self._in_force) > window

    def activate(self, mode: int) -> None:
        """Give the set-points to the servo, which reaches them over the next interpolation periods."""
        self.are_new = self.are_offsets_new = self.are_limited = False
        units, sign = self._units, self._drive_sign
        velocity_offset, torque_offset = self._offsets()
        if mode == _CSP:
            target = self._sign * self._next_position() / units.counts
            self._servo.command(_CSP, target, velocity_offset, torque_offset)
        elif mode == _CSV:
            wanted = sign * self._velocity / units.increments
            limit = units.speed(self._max_speed.value) / units.counts
            velocity = min(max(wanted, -limit), limit)
            self.are_limited = velocity != wanted
            self._servo.command(_CSV, velocity, velocity_offset, torque_offset)
        elif mode == _CST:
            self._servo.command(_CST, sign * self._torque * units.torque, 0.0, torque_offset)
        else:
            self._servo.command(NO_MODE, 0.0, 0.0, 0.0)

    def activate_offsets(self) -> None:
        """Give the offsets of torque and velocity to the servo, without a new target."""
        self.are_offsets_new = False
        self._servo.velocity_offset, self._servo.torque_offset = self._offsets()

    def _offsets(self) -> tuple[float, float]:
        """Return the offsets of velocity and torque, SI."""
        sign, units = self._drive_sign, self._units
        return sign * self._velocity_offset / units.increments, sign * self._torque_offset * units.torque

    def _take(self, name: str, value: int) -> None:
        setattr(self, name, value)
        if name in ("_torque_offset", "_velocity_offset"):
            self.are_offsets_new = True
        else:
            self.are_new = True

    def _within_limits(self, position: int) -> int:
        """Return a target position cut to the software position limits (607Dh)."""
        low, high = self._min_position.value, self._max_position.value
        return min(max(position, low), high) if low < high else position

    def _absolute(self, position: int) -> int:
        """Return a target position with its offset, in counts without wraps."""
        return unwrapped(wrap(position + self._position_offset), self._in_force)

    def _next_position(self) -> int:
        """Take the next target: no further from the last one than the motor's highest speed reaches."""
        if self._position is None:
            return self._in_force
        self._is_first = False
        within = self._within_limits(self._position)
        target = self._absolute(within)
        reach = math.ceil(self._units.speed(self._max_speed.value) * self._period_s)
        limited = min(max(target, self._in_force - reach), self._in_force + reach)
        self.are_limited = within != self._position or limited != target
        self._in_force = limited
        return limited

    def _limit_torque(self, per_mille: int) -> None:
        self._servo.torque_limit = per_mille * self._units.torque

    def _write_period(self, mantissa: int) -> None:
        self._set_period(mantissa, self._exponent.value)
        if not self.has_period:
            self._set_period(self._period.value, self._exponent.value)
            raise AbortError(Abort.VALUE)

    def _set_period(self, mantissa: int, exponent: int) -> None:
        """Set the interpolation period; `has_period` is False for one that the servo does not support.

        The exponent may be written before the mantissa that it belongs to, so it alone is never refused.
        """
        period_s = mantissa * 10.0**exponent
        try:
            self._servo.set_period(period_s)
        except UsageError:
            self.has_period = False
        else:
            self.has_period = True
            self._period_s = period_s
