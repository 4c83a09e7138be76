"""Set-points of a simulated drive: targets, offsets and the limits on them, handed to the servo."""

import math

from friction_hil.drive import Mode
from friction_hil.errors import UsageError
from friction_hil.servo.servo import Servo
from friction_hil_drivers.canopen import objects
from friction_hil_drivers.canopen.simulated.dictionary import Abort, Dictionary, SdoAbortError
from friction_hil_drivers.canopen.simulated.units import SimulatedUnits, unwrapped
from friction_hil_drivers.canopen.units import wrap

NO_MODE = 0
_CSP, _CSV, _CST = Mode.CSP, Mode.CSV, Mode.CST


class Setpoints:
    """What the master wants, from the moment of `forget` on.

    What was written before that moment stays in the dictionary without effect, so that a drive neither jumps
    nor pushes when it is enabled or changes its mode: until then it holds its position, or gives no torque.
    """

    def __init__(self, servo: Servo, units: SimulatedUnits, dictionary: Dictionary) -> None:
        self._servo = servo
        self._units = units
        self._min_position = dictionary.of(objects.MIN_POSITION_LIMIT)
        self._max_position = dictionary.of(objects.MAX_POSITION_LIMIT)
        self._max_speed = dictionary.of(objects.MAX_MOTOR_SPEED)
        self._max_torque = dictionary.of(objects.MAX_TORQUE)
        self._period = dictionary.of(objects.INTERPOLATION_PERIOD)
        self._exponent = dictionary.of(objects.INTERPOLATION_EXPONENT)
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
            dictionary.of(known).on_write = lambda value, name=name: self._take(name, value)
        self._period_s = 0.0
        self.load()
        self.forget()

    def load(self) -> None:
        """Apply the settings as they stand in the dictionary."""
        self._limit_torque(self._max_torque.value)
        self._set_period(self._period.value, self._exponent.value)

    def forget(self) -> None:
        """Hold from here on: the present position, no velocity, no torque."""
        self._position: int | None = None  # as on the wire; None: no target came yet
        self._in_force = round(self._servo.position * self._units.counts)  # counts without wrap-around
        self._velocity = self._torque = 0
        self._position_offset = self._velocity_offset = self._torque_offset = 0
        self._is_first = True
        self.are_new = True  # something is to be activated
        self.are_limited = False  # a limit other than the torque's cut the last target

    def jumps_beyond(self, window: int) -> bool:
        """Whether the first target position is further than ``window`` counts from where the axis stands."""
        if not self._is_first or self._position is None:
            return False
        return abs(self._wanted_position() - self._in_force) > window

    def activate(self, mode: int) -> None:
        """Hand the set-points to the servo, which reaches them over the next interpolation periods."""
        self.are_new = self.are_limited = False
        velocity_offset = self._velocity_offset / self._units.counts
        torque_offset = self._torque_offset * self._units.torque
        if mode == _CSP:
            target = self._limited_position() / self._units.counts
            self._servo.command(_CSP, target, velocity_offset, torque_offset)
        elif mode == _CSV:
            limit = self._units.speed(self._max_speed.value)
            velocity = min(max(self._velocity, -limit), limit)
            self.are_limited = velocity != self._velocity
            self._servo.command(_CSV, velocity / self._units.counts, velocity_offset, torque_offset)
        elif mode == _CST:
            self._servo.command(_CST, self._torque * self._units.torque, 0.0, torque_offset)
        else:
            self._servo.command(NO_MODE, 0.0, 0.0, 0.0)

    def _take(self, name: str, value: int) -> None:
        setattr(self, name, value)
        self.are_new = True

    def _wanted_position(self) -> int:
        """Target and offset in counts without wrap-around, within the software position limits (607Dh)."""
        assert self._position is not None
        position = self._position
        low, high = self._min_position.value, self._max_position.value
        if low < high:
            position = min(max(position, low), high)
        self.are_limited |= position != self._position
        return unwrapped(wrap(position + self._position_offset), self._in_force)

    def _limited_position(self) -> int:
        """Next target: no further from the last one than the motor's highest speed takes it."""
        if self._position is None:
            return self._in_force
        self._is_first = False
        wanted = self._wanted_position()
        reach = math.ceil(self._units.speed(self._max_speed.value) * self._period_s)
        limited = min(max(wanted, self._in_force - reach), self._in_force + reach)
        self.are_limited |= limited != wanted
        self._in_force = limited
        return limited

    def _limit_torque(self, per_mille: int) -> None:
        self._servo.torque_limit = per_mille * self._units.torque

    def _write_period(self, mantissa: int) -> None:
        self._set_period(mantissa, self._exponent.value)
        if not self.has_period:
            self._set_period(self._period.value, self._exponent.value)
            raise SdoAbortError(Abort.VALUE)

    def _set_period(self, mantissa: int, exponent: int) -> None:
        """Take an interpolation period; one that the servo cannot do shows in `has_period`.

        The exponent may come before the mantissa that it belongs to, so it alone is no reason to refuse.
        """
        period_s = mantissa * 10.0**exponent
        try:
            self._servo.set_period(period_s)
        except UsageError:
            self.has_period = False
        else:
            self.has_period = True
            self._period_s = period_s
