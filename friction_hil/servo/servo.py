"""A simulated servo with plain attributes and methods, in SI units. The same calls give the same bits."""

import math

import numpy as np

from friction_hil.errors import UsageError
from friction_hil.motion.controller import CONTROLLER
from friction_hil.numerics.jit import StructuredArray
from friction_hil.servo import plant
from friction_hil.servo.config import ServoConfig


def _field_index(name: str) -> int:
    """Return the index of a field in a flat view of the state."""
    fields = plant.STATE.fields
    assert fields is not None
    return fields[name][1] // 8


_COUNTS = _field_index("counts")
_DECELERATION = _field_index("deceleration")
_INTEGRAL = _field_index("integral")
_IS_LIMITED = _field_index("is_limited")
_MODE = _field_index("mode")
_PERIOD_STEPS = _field_index("period_steps")
_PHASE = _field_index("phase")
_POSITION = _field_index("position")
_POSITION_DEMAND = _field_index("position_demand")
_TARGET0 = _field_index("target0")
_TARGET1 = _field_index("target1")
_TARGET2 = _field_index("target2")
_TORQUE = _field_index("torque")
_TORQUE_DEMAND = _field_index("torque_demand")
_TORQUE_LIMIT = _field_index("torque_limit")
_TORQUE_OFFSET = _field_index("torque_offset")
_VELOCITY = _field_index("velocity")
_VELOCITY_DEMAND = _field_index("velocity_demand")
_VELOCITY_OFFSET = _field_index("velocity_offset")
_VELOCITY_ESTIMATE = _field_index("velocity_estimate")


def _plant_record(config: ServoConfig, counts_per_unit: float) -> StructuredArray:
    friction = config.friction_model
    step_s = 1.0 / config.integration_hz
    lag = config.motor.torque_lag_s
    record = np.zeros(1, plant.PLANT)
    c = record[0]
    c["inertia"] = config.mechanics.inertia
    c["load_torque"] = config.mechanics.load_torque
    c["has_brake"] = config.mechanics.has_brake
    c["friction_kind"] = friction.kind
    c["is_friction_static"] = friction.family.is_static
    c["friction"] = friction.values
    c["stick_velocity"] = friction.parameters.get("stick_velocity", 0.0)
    c["step_s"] = step_s
    c["torque_lag_coefficient"] = 1.0 if lag == 0.0 else -math.expm1(-step_s / lag)
    c["counts_per_unit"] = counts_per_unit
    c["steps_per_control"] = round(config.integration_hz / config.loops.rate_hz)
    c["velocity_filter_coefficient"] = -math.expm1(
        -2.0 * math.pi * config.loops.velocity_filter_hz / config.loops.rate_hz
    )
    return record


def _controller_record(config: ServoConfig) -> StructuredArray:
    record = np.zeros(1, CONTROLLER)
    k = record[0]
    k["position_gain"] = config.loops.position_gain
    k["velocity_gain"] = config.loops.velocity_gain
    k["integral_hz"] = config.loops.integral_hz
    k["velocity_feedforward"] = config.loops.velocity_feedforward
    k["inertia"] = config.loops.inertia_feedforward * config.mechanics.inertia
    return record


class Servo:
    """Motor, load, encoder and drive loops of one simulated axis.

    Parameters
    ----------
    config : ServoConfig
        Mechanics, friction, encoder, motor and loops.
    position : float
        Initial position, at rest, rad or m.
    """

    def __init__(self, config: ServoConfig, position: float = 0.0) -> None:
        self.config = config
        revolution = 2.0 * math.pi if config.mechanics.axis == "rotary" else 1.0
        self.steps_per_second = round(config.integration_hz)
        self.counts_per_unit = config.encoder.counts / revolution
        self._plant = _plant_record(config, self.counts_per_unit)
        self._controller = _controller_record(config)
        self._state = np.zeros(1, plant.STATE)
        # a flat view of the record: access by index is five times faster than by field name
        self._s = self._state.view(np.float64)
        self._get = self._s.item
        self._s[_POSITION] = self._s[_POSITION_DEMAND] = position
        self._s[_COUNTS] = math.floor(position * self.counts_per_unit)
        self._s[_TORQUE_LIMIT] = config.motor.peak_torque
        self.set_period(1e-3)

    def set_period(self, period_s: float) -> None:
        """Set the interpolation period (60C2h), the time between two `command` calls, s."""
        steps = round(period_s * self.steps_per_second)
        if steps < 1 or abs(steps / self.steps_per_second - period_s) > 1e-9:
            raise UsageError(
                f"an interpolation period of {period_s:g} s is not a whole number of integration steps of "
                f"{1.0 / self.steps_per_second:g} s"
            )
        self._s[_PERIOD_STEPS] = steps

    def command(self, mode: int, target: float, velocity_offset: float = 0.0, torque_offset: float = 0.0) -> None:
        """Set the set-point of the next period.

        Parameters
        ----------
        mode : int
            8 (CSP): position; 9 (CSV): velocity; 10 (CST): torque; 0: power off, no torque, loops reset.
        target : float
            Position, velocity or torque, SI; ignored in mode 0.
        velocity_offset, torque_offset : float
            Offsets added to the demands (60B1h, 60B2h).
        """
        s, get = self._s, self._get
        if mode != get(_MODE):
            self._change_mode(mode)
        elif mode == plant.CSP:
            missed = round(get(_PHASE) / get(_PERIOD_STEPS)) - 1
            if missed == 1:  # it is placed on the straight line that the demand followed in the meantime
                s[_TARGET0], s[_TARGET1], s[_TARGET2] = (
                    get(_TARGET1),
                    get(_TARGET2),
                    2.0 * get(_TARGET2) - get(_TARGET1),
                )
            elif missed > 1:  # the demand stands, and starts from there
                standing = 0.5 * (get(_TARGET1) + get(_TARGET2))
                standing += plant.BRIDGED_PERIODS * (get(_TARGET2) - get(_TARGET1))
                s[_TARGET1] = s[_TARGET2] = standing
        s[_PHASE] = 0.0
        s[_VELOCITY_OFFSET], s[_TORQUE_OFFSET] = velocity_offset, torque_offset
        s[_TARGET0], s[_TARGET1], s[_TARGET2] = get(_TARGET1), get(_TARGET2), target

    def quick_stop(self, deceleration: float) -> None:
        """Reduce the demanded velocity to zero at ``deceleration`` (> 0, rad/s^2), then hold the position."""
        s = self._s
        if self._get(_MODE) in (plant.OFF, plant.CST):
            s[_VELOCITY_DEMAND] = self.velocity
            s[_POSITION_DEMAND] = self.position
        s[_MODE], s[_DECELERATION] = plant.QUICK_STOP, deceleration

    def _change_mode(self, mode: int) -> None:
        """Start a mode at the present position or velocity, so that the demand does not jump."""
        s = self._s
        start = {plant.CSP: self.position, plant.CSV: self.velocity}.get(mode, 0.0)
        s[_TARGET0] = s[_TARGET1] = s[_TARGET2] = start
        s[_MODE] = mode
        s[_INTEGRAL] = 0.0
        s[_POSITION_DEMAND] = self.position
        if mode == plant.OFF:
            s[_TORQUE_DEMAND] = 0.0

    def advance(self, steps: int) -> None:
        """Simulate ``steps`` integration steps."""
        plant.advance(self._plant, self._controller, self._state, steps)

    @property
    def position(self) -> float:
        """Position measured by the encoder, quantised to counts, rad or m."""
        return math.floor(self._get(_POSITION) * self.counts_per_unit) / self.counts_per_unit

    @property
    def true_position(self) -> float:
        """Position without quantisation, rad or m."""
        return self._get(_POSITION)

    @property
    def velocity(self) -> float:
        """Velocity that the drive estimates for its own loop, rad/s or m/s."""
        return self._get(_VELOCITY_ESTIMATE)

    @property
    def true_velocity(self) -> float:
        """Velocity of the mechanics, rad/s or m/s."""
        return self._get(_VELOCITY)

    @property
    def torque(self) -> float:
        """Motor torque after the torque lag, N m or N."""
        return self._get(_TORQUE)

    @property
    def position_demand(self) -> float:
        """Present position demand of the drive's loops, rad or m."""
        return self._get(_POSITION_DEMAND)

    @property
    def velocity_demand(self) -> float:
        """Present velocity demand of the drive's loops, rad/s or m/s."""
        return self._get(_VELOCITY_DEMAND)

    @property
    def torque_demand(self) -> float:
        """Torque demand after the torque limit, N m or N."""
        return self._get(_TORQUE_DEMAND)

    @property
    def following_error(self) -> float:
        """Demanded minus measured position, rad or m."""
        return self.position_demand - self.position

    @property
    def is_at_rest(self) -> bool:
        """True if the velocity estimate of the drive is below one count per control sample."""
        return abs(self.velocity) * self.counts_per_unit < self.config.loops.rate_hz

    @property
    def is_torque_limited(self) -> bool:
        """True if the torque limit reduced the demand in the last control sample."""
        return bool(self._get(_IS_LIMITED))

    @property
    def torque_offset(self) -> float:
        """Torque offset in force (60B2h), N m or N; a new one acts at once and leaves the interpolation as it is."""
        return self._get(_TORQUE_OFFSET)

    @torque_offset.setter
    def torque_offset(self, offset: float) -> None:
        self._s[_TORQUE_OFFSET] = offset

    @property
    def torque_limit(self) -> float:
        """Bound on the absolute torque demand (6072h), N m or N."""
        return self._get(_TORQUE_LIMIT)

    @torque_limit.setter
    def torque_limit(self, limit: float) -> None:
        self._s[_TORQUE_LIMIT] = min(limit, self.config.motor.peak_torque)
