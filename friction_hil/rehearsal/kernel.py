"""Closed loop of the daemon and a simulated servo over a whole motion, compiled."""

import math
from typing import Any

import numpy as np

from friction_hil import compensator
from friction_hil.compensator import load
from friction_hil.compensator.limiter import limit_torque
from friction_hil.motion.controller import cascade
from friction_hil.numerics.jit import Array, StructuredArray, compiled
from friction_hil.servo import plant

MOST_DELAY_CYCLES = 4

DAEMON = np.dtype(
    [
        ("mode", "f8"),  # plant.CSP, plant.CSV or plant.CST
        ("is_compensated", "f8"),
        ("period_s", "f8"),
        ("period_steps", "f8"),  # integration steps in a period
        ("delay_steps", "f8"),  # from the sample to the beginning of the torque computed from it
        ("torque_limit", "f8"),
        ("torque_slew", "f8"),
        ("largest_static", "f8"),  # feed-forward of gravity and offset
        ("offset", "f8"),
    ]
)

TRACE = ("error", "compensation", "gain_factor", "demand", "load_error")

_compensate = compensator.whole_step


@compiled
def _latch(state: StructuredArray, target: float, torque_offset: float) -> None:
    """Give the drive a new set-point, as `friction_hil.servo.servo.Servo.command` does where none is missing."""
    r = state[0]
    r.phase = 0.0
    r.torque_offset = torque_offset
    r.target0, r.target1, r.target2 = r.target1, r.target2, target


@compiled
def _control(
    d: Any, controller: StructuredArray, integral: float, row: Array, r: Any, error: float
) -> tuple[float, float, float]:
    """Return the target of one cycle, the torque of the loop's own controller (CST), and its integral.

    ``r`` is the state of the compensator, which has the velocity and the offset of the motor; ``error`` includes it.
    """
    if d.mode == plant.CSP:
        return row[5] + r.offset_sent, 0.0, integral
    if d.mode == plant.CSV:
        return row[6] + r.offset_sent_velocity + controller[0].position_gain * error, 0.0, integral
    demand, velocity = row[1] + r.offset_now_velocity, r.motion.velocity
    torque, integral = cascade(controller, integral, error, demand, row[2], velocity, d.period_s, d.torque_limit)
    return 0.0, torque, integral


@compiled
def run(
    daemon: StructuredArray,
    own_controller: StructuredArray,
    servo: StructuredArray,
    controller: StructuredArray,
    state: StructuredArray,
    settings: StructuredArray,
    compensator_state: StructuredArray,
    demand: Array,
    trace: Array,
) -> None:
    """Simulate a motion.

    Parameters
    ----------
    daemon
        `DAEMON` record array of length 1.
    own_controller
        `friction_hil.motion.controller.CONTROLLER` of the daemon's loop.
    servo, controller, state
        Record arrays of a `friction_hil.servo.servo.Servo`.
    settings, compensator_state
        Record and state of a `friction_hil.compensator.Compensator`.
    demand
        (n, 7) array, a row for each cycle: position, velocity and acceleration now, velocity and acceleration when this
        cycle's torque acts, position and velocity as sent. SI.
    trace
        (5, n) array that is filled, in the order of `TRACE`: following error, compensation, gain factor of the
        compensator, demanded position, and demanded less true position of the load. The following error is that of the
        encoder, from the demand with the offset of the motor (`friction_hil.compensator.transmission`).
    """
    d, r = daemon[0], state[0]
    steps, delay = int(d.period_steps), int(d.delay_steps)
    whole, part = delay // steps, delay % steps
    targets, torques = np.zeros(MOST_DELAY_CYCLES + 2), np.zeros(MOST_DELAY_CYCLES + 2)  # newest first
    if d.mode == plant.CSP:
        targets[:] = r.position
    r.mode, r.target0, r.target1, r.target2 = d.mode, targets[0], targets[0], targets[0]
    integral = command = 0.0
    for k in range(demand.shape[0]):
        row = demand[k]
        position = plant.measured_position(servo, state)
        compensation = _compensate(
            settings,
            compensator_state,
            float(k),
            position,
            r.velocity_estimate,
            plant.measured_torque(servo, state),
            row[0],
            row[1],
            row[3],
            1.0,
            d.is_compensated,
            row[4],
            math.nan,
        )
        error = row[0] + compensator_state[0].offset_now - position
        target, own, integral = _control(d, own_controller, integral, row, compensator_state[0], error)
        if d.largest_static > 0.0:
            static = d.offset + load.gravity(settings[0], row[0] + settings[0].lead_s * row[1])
            own += min(max(static, -d.largest_static), d.largest_static)
        command = limit_torque(own + compensation, command, d.torque_limit, d.torque_slew * d.period_s)
        trace[0, k], trace[1, k], trace[2, k] = error, compensation, compensator_state[0].gain_factor
        trace[3, k], trace[4, k] = row[0], row[0] - plant.load_position(state)
        for j in range(MOST_DELAY_CYCLES + 1, 0, -1):
            targets[j], torques[j] = targets[j - 1], torques[j - 1]
        targets[0], torques[0] = target, command
        if part > 0:
            plant.advance(servo, controller, state, part)
        if d.mode == plant.CST:
            _latch(state, torques[whole], 0.0)
        else:
            _latch(state, targets[whole], torques[whole])
        plant.advance(servo, controller, state, steps - part)
