"""Experiment 9: reversal spikes on a circle of two equal servo axes, without and with compensation."""

import math
from functools import lru_cache
from typing import Any

import numpy as np

from friction_hil.compensator import Compensator, CompensatorSettings
from friction_hil.friction import FrictionModel
from friction_hil.motion.trajectory import circle_path
from friction_hil.numerics.jit import Array
from friction_hil.servo.config import ServoConfig, ServoMechanics, TrueFriction
from friction_hil.servo.plant import CSP
from friction_hil.servo.servo import Servo
from friction_hil.study.mass import PERIOD_S
from friction_hil.study.result import ExperimentResult, thin
from friction_hil.study.subjects import DEFAULT, StudySettings, matched

_DRIVE_DELAY = 1.5  # delay of the drive's interpolation behind its newest target, periods


def reversal(name: str, assumed: str | None, given: StudySettings = DEFAULT) -> ExperimentResult:
    """Compute the radius error of one lap over the angle.

    Both axes are the same servo a quarter of a lap apart, so that only one is simulated.
    """
    error = _following_error(name, assumed, given)
    lap = error.size
    angle = 2.0 * np.pi * np.arange(lap) / lap
    x = given.radius * np.cos(angle) - error
    y = given.radius * np.sin(angle) - np.roll(error, lap // 4)
    radius_error = np.hypot(x, y) - given.radius
    facts = {
        "peak_urad": 1e6 * float(np.abs(radius_error).max()),
        "rms_urad": 1e6 * float(np.sqrt(np.mean(radius_error**2))),
    }
    return ExperimentResult(facts, {"radius error": thin(angle, radius_error, lap)})


def _following_error(name: str, assumed: str | None, given: StudySettings) -> Array:
    """Simulate one lap, from reversal to reversal; return set-point minus true position, (lap,), rad."""
    lap = round(1.0 / (given.frequency * PERIOD_S))
    settling = lap // 2  # periods from the start, which is at a reversal, until the laps repeat
    friction = matched(name, given.servo_levels)
    config = ServoConfig(
        mechanics=ServoMechanics(axis="rotary"),
        friction=TrueFriction(model=name, parameters=friction.parameters),
    )
    lead_s = 1.5 * PERIOD_S + config.motor.torque_lag_s  # to the middle of the period in which the offset acts
    compensator = None if assumed is None else _compensator(matched(assumed, given.servo_levels), config, lead_s)
    motion = _motion(given.radius, given.frequency, lead_s, settling + lap)
    servo = Servo(config, position=given.radius)
    servo.command(CSP, given.radius)
    steps = round(servo.steps_per_second * PERIOD_S)
    target, offset = circle_path(given.radius, given.frequency, 0.0)(_DRIVE_DELAY * PERIOD_S)[0], 0.0
    error = np.empty(settling + lap)
    for k, (demand, ahead, acceleration, sent) in enumerate(motion):
        error[k] = demand[0] - servo.true_position
        servo.command(CSP, target, torque_offset=offset)
        # the feedback of this period determines the command at the beginning of the next
        if compensator is not None:
            feedback = float(k), servo.position, servo.velocity, servo.torque
            offset = compensator.step(*feedback, demand[0], demand[1], ahead, True, True, acceleration)
        target = sent
        servo.advance(steps)
    return np.roll(error[settling:], settling)


@lru_cache(maxsize=1)
def _motion(radius: float, frequency: float, lead_s: float, periods: int) -> list[tuple[Any, float, float, float]]:
    """Return, for each period, the demand, velocity and acceleration when its torque acts, and the position to send."""
    path, found = circle_path(radius, frequency, 0.0), []
    for k in range(periods):
        time = k * PERIOD_S
        _, ahead, acceleration = path(time + lead_s)
        found.append((path(time), ahead, acceleration, path(time + (1.0 + _DRIVE_DELAY) * PERIOD_S)[0]))
    return found


def _compensator(assumed: FrictionModel, config: ServoConfig, lead_s: float) -> Compensator:
    settings = CompensatorSettings(
        period_s=PERIOD_S,
        position_resolution=2.0 * math.pi / config.encoder.counts,
        torque_limit=config.motor.rated_torque,
        lead_s=lead_s,
        gain=1.0,
        fade_s=0.1,
    )
    return Compensator(assumed, settings)
