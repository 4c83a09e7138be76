"""A simulated servo with plain attributes and methods, in SI units. The same calls give the same bits."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from friction_hil.errors import UsageError
from friction_hil.numerics.jit import Array, StructuredArray
from friction_hil.servo import mechanics, plant
from friction_hil.servo.assembly import controller_record, external_table, plant_record, servo_state
from friction_hil.servo.config import ServoConfig
from friction_hil.servo.records import MACHINE, MACHINE_STATE


def _field_index(name: str) -> int:
    """Return the index of a field in a flat view of the state."""
    fields = MACHINE_STATE.fields  # which begins with those of STATE
    assert fields is not None
    return fields[name][1] // 8


_ACTING_DEMAND = _field_index("acting_demand")
_DECELERATION = _field_index("deceleration")
_INTEGRAL = _field_index("integral")
_IS_LIMITED = _field_index("is_limited")
_LOAD_POSITION = _field_index("load_position")
_LOAD_VELOCITY = _field_index("load_velocity")
_MODE = _field_index("mode")
_PERIOD_STEPS = _field_index("period_steps")
_PHASE = _field_index("phase")
_POSITION = _field_index("position")
_POSITION_DEMAND = _field_index("position_demand")
_SHAFT_TORQUE = _field_index("shaft_torque")
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


@dataclass(frozen=True, slots=True)
class Energy:
    """Energy balance of a simulated servo, J: ``stored`` changes by the works less the heats."""

    # kinetic, and in coupling, gravity, spring and hysteresis of the gear; not in the bristles of dynamic friction
    stored: float
    motor_work: float  # of the motor's torque
    load_work: float  # of constant and external load torque
    friction_heat: float  # of friction at the motor; friction with bristles stores a part of it
    load_friction_heat: float  # of friction at the load; likewise
    coupling_heat: float  # dissipated by the coupling


class Temperatures(NamedTuple):
    """Temperatures, deg C; ``gear`` is that of the friction."""

    winding: float
    motor: float
    gear: float
    ambient: float


class Servo:
    """Motor, load, encoder and drive loops of one simulated axis.

    ``position``: initial one of motor and load, at rest, rad or m. ``external``, (n, 2): content of the file that
    ``mechanics.external.file`` names: times, s, that rise, and load torque, N m; this room reads no files. Raises
    `UsageError`: the configuration names such a file, and ``external`` is missing or invalid.
    """

    def __init__(self, config: ServoConfig, position: float = 0.0, external: Array | None = None) -> None:
        self.config = config
        self.steps_per_second = round(config.integration_hz)
        self._external = external_table(config, external)  # the record has its address
        self._plant = self._plant_record()
        self._is_rigid = self._plant.dtype != MACHINE
        self.counts_per_unit: float = self._plant[0]["counts_per_unit" if self._is_rigid else "load_counts_per_unit"]
        turn = config.encoder.position_counts / self.counts_per_unit  # rad or m
        self.load_counts_per_unit: float = config.encoder.counts_at_load / turn
        self._controller = controller_record(config, self.total_inertia)
        self._state = servo_state(config, self._plant, position)
        # a flat view of the record: access by index is five times faster than by field name
        self._s = self._state.view(np.float64)
        self._get = self._s.item
        self.set_period(1e-3)

    def _plant_record(self) -> StructuredArray:
        return plant_record(self.config, self._external)

    @property
    def total_inertia(self) -> float:
        """Of motor and load, without its variation, kg m^2 or kg."""
        return self.config.mechanics.total_inertia

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

        ``mode`` 8 (CSP): ``target`` is a position; 9 (CSV): a velocity; 10 (CST): a torque, SI; 0: power off, no
        torque, loops reset, the target is ignored. Offsets are added to the demands (60B1h, 60B2h).
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
            if not self._is_rigid:
                s[_ACTING_DEMAND] = 0.0

    def advance(self, steps: int) -> None:
        """Simulate ``steps`` integration steps."""
        plant.advance(self._plant, self._controller, self._state, steps)

    @property
    def records(self) -> tuple[StructuredArray, StructuredArray, StructuredArray]:
        """Plant, controller and state as the compiled functions of `friction_hil.servo.plant` take them, live."""
        return self._plant, self._controller, self._state

    @property
    def position(self) -> float:
        """Position measured by the encoder of the position loop, quantised to counts, rad or m."""
        if self._is_rigid:
            return math.floor(self._get(_POSITION) * self.counts_per_unit) / self.counts_per_unit
        return plant.measured_position(self._plant, self._state)

    @property
    def true_position(self) -> float:
        """Position of the motor without quantisation, rad or m."""
        return self._get(_POSITION)

    @property
    def load_position(self) -> float:
        """Position of the load without quantisation, rad or m; that of the motor on a rigid servo."""
        return self._get(_POSITION if self._is_rigid else _LOAD_POSITION)

    @property
    def load_velocity(self) -> float:
        """Velocity of the load, rad/s or m/s; that of the motor on a rigid servo."""
        return self._get(_VELOCITY if self._is_rigid else _LOAD_VELOCITY)

    @property
    def velocity(self) -> float:
        """Velocity that the drive estimates for its own loop, rad/s or m/s."""
        return self._get(_VELOCITY_ESTIMATE)

    @property
    def true_velocity(self) -> float:
        """Velocity of the motor, rad/s or m/s."""
        return self._get(_VELOCITY)

    @property
    def energy(self) -> Energy:
        """Energies since the start, J. Raises a `UsageError` if the servo is rigid: its kernel keeps no account."""
        if self._is_rigid:
            raise UsageError("a rigid servo keeps no account of its energy; give it a load, gravity or a spring")
        r = self._state[0]
        return Energy(
            stored=mechanics.stored_energy(self._plant, self._state),
            motor_work=float(r["motor_work"]),
            load_work=float(r["load_work"]),
            friction_heat=float(r["friction_heat"]),
            load_friction_heat=float(r["load_friction_heat"]),
            coupling_heat=float(r["coupling_heat"]),
        )

    @property
    def torque(self) -> float:
        """Torque that the drive reports: current times nominal torque constant, with the errors of its feedback."""
        if self._is_rigid:
            return self._get(_TORQUE)
        return plant.measured_torque(self._plant, self._state)

    @property
    def true_torque(self) -> float:
        """Torque at the shaft of the motor, N m or N."""
        return self._get(_TORQUE if self._is_rigid else _SHAFT_TORQUE)

    @property
    def temperatures(self) -> Temperatures | None:
        """Temperatures of motor and gear, deg C; None without ``thermal``."""
        if self.config.thermal is None:
            return None
        r = self._state[0]
        return Temperatures(*(float(r[f"{each}_temperature"]) for each in ("winding", "motor", "gear", "ambient")))

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
    def velocity_offset(self) -> float:
        """Velocity offset in force (60B1h), rad/s or m/s, as `torque_offset`."""
        return self._get(_VELOCITY_OFFSET)

    @velocity_offset.setter
    def velocity_offset(self, offset: float) -> None:
        self._s[_VELOCITY_OFFSET] = offset

    @property
    def torque_limit(self) -> float:
        """Bound on the absolute torque demand (6072h), N m or N."""
        return self._get(_TORQUE_LIMIT)

    @torque_limit.setter
    def torque_limit(self, limit: float) -> None:
        self._s[_TORQUE_LIMIT] = min(limit, self.config.motor.peak_torque)
