"""Experiment 9: reversal spikes on a circle of two equal servo axes, without and with compensation."""

import math

import numpy as np

from friction_hil.compensator import Compensator, CompensatorSettings
from friction_hil.motion.trajectory import circle_path
from friction_hil.numerics.jit import Array
from friction_hil.servo.config import ServoConfig, ServoMechanics, TrueFriction
from friction_hil.servo.plant import CSP
from friction_hil.servo.servo import Servo
from friction_hil.study.mass import PERIOD_S
from friction_hil.study.result import ExperimentResult, thin
from friction_hil.study.subjects import matched, servo_levels

RADIUS = 1.0  # rad
FREQUENCY = 0.5  # Hz
_LAP = round(1.0 / (FREQUENCY * PERIOD_S))
_SETTLING = _LAP // 2  # periods from the start, which is at a reversal, until the laps repeat
_DRIVE_DELAY = 1.5  # delay of the drive's interpolation behind its newest target, periods
LEVELS_AT = 2.0 * math.pi * FREQUENCY * RADIUS  # rad/s


def reversal(name: str, assumed: str | None) -> ExperimentResult:
    """Compute the radius error of one lap over the angle.

    Both axes are the same servo a quarter of a lap apart, so that only one is simulated.
    """
    error = _following_error(name, assumed)
    angle = 2.0 * np.pi * np.arange(_LAP) / _LAP
    x = RADIUS * np.cos(angle) - error
    y = RADIUS * np.sin(angle) - np.roll(error, _LAP // 4)
    radius_error = np.hypot(x, y) - RADIUS
    facts = {
        "peak_urad": 1e6 * float(np.abs(radius_error).max()),
        "rms_urad": 1e6 * float(np.sqrt(np.mean(radius_error**2))),
    }
    return ExperimentResult(facts, {"radius error": thin(angle, radius_error, _LAP)})


def _following_error(name: str, assumed: str | None) -> Array:
    """Simulate one lap, from reversal to reversal; return set-point minus true position, (lap,), rad."""
    levels = servo_levels(LEVELS_AT)
    friction = matched(name, levels)
    config = ServoConfig(
        mechanics=ServoMechanics(axis="rotary"),
        friction=TrueFriction(model=name, parameters=friction.parameters),
    )
    lead_s = 1.5 * PERIOD_S + config.motor.torque_lag_s  # to the middle of the period in which the offset acts
    compensator = None if assumed is None else _compensator(assumed, config, lead_s)
    path = circle_path(RADIUS, FREQUENCY, 0.0)
    servo = Servo(config, position=RADIUS)
    servo.command(CSP, RADIUS)
    steps = round(servo.steps_per_second * PERIOD_S)
    target, offset = path(_DRIVE_DELAY * PERIOD_S)[0], 0.0
    error = np.empty(_SETTLING + _LAP)
    for k in range(error.size):
        time = k * PERIOD_S
        demand = path(time)
        error[k] = demand[0] - servo.true_position
        servo.command(CSP, target, torque_offset=offset)
        # the feedback of this period determines the command at the beginning of the next
        if compensator is not None:
            _, ahead, acceleration = path(time + lead_s)
            feedback = float(k), servo.position, servo.velocity, servo.torque
            offset = compensator.step(*feedback, demand[0], demand[1], ahead, True, True, acceleration)
        target = path(time + (1.0 + _DRIVE_DELAY) * PERIOD_S)[0]
        servo.advance(steps)
    return np.roll(error[_SETTLING:], _SETTLING)


def _compensator(assumed: str, config: ServoConfig, lead_s: float) -> Compensator:
    settings = CompensatorSettings(
        period_s=PERIOD_S,
        position_resolution=2.0 * math.pi / config.encoder.counts,
        torque_limit=config.motor.rated_torque,
        lead_s=lead_s,
        gain=1.0,
        fade_s=0.1,
    )
    return Compensator(matched(assumed, servo_levels(LEVELS_AT)), settings)
