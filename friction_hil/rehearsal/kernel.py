"""Closed loop of the daemon and simulated servos over a whole motion, compiled.

A cycle of an axis is a decision on a sample, which moves nothing, and its commands, which act after the delay of the
axis. Between the two, time passes: for one servo, or for those that share a mechanism.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from friction_hil import compensator
from friction_hil.compensator import load, velocity_offset
from friction_hil.compensator.limiter import limit_torque
from friction_hil.motion.controller import cascade
from friction_hil.numerics.jit import Array, StructuredArray, compiled, inlined
from friction_hil.servo import coupled, plant

MOST_DELAY_CYCLES = 4
_RISE_CYCLES = 50  # of a torque that holds the axis at the start

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

LOOP = np.dtype(
    [
        ("targets", "f8", (MOST_DELAY_CYCLES + 1,)),  # set-points of the cycles, newest first
        ("torques", "f8", (MOST_DELAY_CYCLES + 1,)),
        ("velocity_offsets", "f8", (MOST_DELAY_CYCLES + 1,)),
        ("integral", "f8"),  # of the loop's own controller
    ]
)

TRACE = ("error", "compensation", "gain_factor", "demand", "load_error")

_compensate = compensator.whole_step


class Axis(NamedTuple):
    """Records of an axis, each an array of length 1; of the axes of a mechanism, each an array of all of them."""

    daemon: StructuredArray  # `DAEMON`
    loop: StructuredArray  # `LOOP`
    own_controller: StructuredArray  # `friction_hil.motion.controller.CONTROLLER` of the daemon's loop
    servo: StructuredArray  # this and the next two: of a `friction_hil.servo.servo.Servo`
    controller: StructuredArray
    state: StructuredArray
    settings: StructuredArray  # record of a `friction_hil.compensator.Compensator`
    compensator_state: StructuredArray  # state of that compensator
    # of a `friction_hil.compensator.velocity_offset.VelocityOffset`; a gain of 0: the drive is given the torque
    offset_settings: StructuredArray
    offset_state: StructuredArray
    shift: StructuredArray  # of a `SetpointShift`; a position gain of 0: the drive takes the velocity offset


@inlined
def _begin(axis: Axis) -> None:
    """Hold the axis where it is."""
    d, r, loop = axis.daemon[0], axis.state[0], axis.loop[0]
    if d.mode == plant.CSP:
        loop.targets[:] = r.position
    r.mode, r.target0, r.target1, r.target2 = d.mode, loop.targets[0], loop.targets[0], loop.targets[0]


@compiled
def _control(
    d: Any, controller: StructuredArray, integral: float, row: Array, r: Any, error: float
) -> tuple[float, float, float]:
    """Return the target of one cycle, the torque of the loop's own controller (CST), and its integral.

    ``r`` is the state of the compensator, which has the velocity and the offset of the motor; ``error`` includes it.
    """
    if d.mode == plant.CSP:
        return row[5] + r.transmission.offset_sent, 0.0, integral
    if d.mode == plant.CSV:
        return row[6] + r.transmission.velocity_sent + controller[0].position_gain * error, 0.0, integral
    demand, velocity = row[1] + r.transmission.velocity_now, r.motion.velocity
    torque, integral = cascade(controller, integral, error, demand, row[2], velocity, d.period_s, d.torque_limit)
    return 0.0, torque, integral


@inlined
def _decide(axis: Axis, k: int, row: Array, trace: Array) -> None:
    """Sample the axis in cycle ``k``, compute its commands, and fill a column of the trace; see `run`."""
    d, loop, c, r = axis.daemon[0], axis.loop[0], axis.settings[0], axis.compensator_state[0]
    position = plant.measured_position(axis.servo, axis.state)
    compensation = _compensate(
        axis.settings,
        axis.compensator_state,
        float(k),
        position,
        axis.state[0].velocity_estimate,
        plant.measured_torque(axis.servo, axis.state),
        row[0],
        row[1],
        row[3],
        1.0,
        d.is_compensated,
        row[4],
        math.nan,
        math.nan,
    )
    error = row[0] + r.transmission.offset_now - position
    target, own, loop.integral = _control(d, axis.own_controller, loop.integral, row, r, error)
    if d.largest_static > 0.0:
        static = d.offset + load.gravity(c, row[0] + c.lead_s * row[1])
        own += min(max(static, -d.largest_static), d.largest_static)
    velocity = 0.0
    if axis.offset_settings[0].gain > 0.0:
        velocity = velocity_offset.step(axis.offset_settings, axis.offset_state, float(k), compensation)
        if axis.shift[0].position_gain > 0.0:
            target += round(velocity_offset.shifted(axis.shift, velocity) / c.resolution) * c.resolution
            velocity = 0.0
    else:
        own += compensation
    torque = limit_torque(own, loop.torques[0], d.torque_limit, d.torque_slew * d.period_s)
    trace[0, k], trace[1, k], trace[2, k] = error, compensation, r.limit_cycle.gain_factor
    trace[3, k], trace[4, k] = row[0], row[0] - plant.load_position(axis.state)
    for j in range(MOST_DELAY_CYCLES, 0, -1):
        loop.targets[j], loop.torques[j] = loop.targets[j - 1], loop.torques[j - 1]
        loop.velocity_offsets[j] = loop.velocity_offsets[j - 1]
    loop.targets[0], loop.torques[0], loop.velocity_offsets[0] = target, torque, velocity


@inlined
def _act(axis: Axis) -> None:
    """Give the drive the set-point that is due, as `friction_hil.servo.servo.Servo.command` does if none is missing."""
    d, r, loop = axis.daemon[0], axis.state[0], axis.loop[0]
    late = int(d.delay_steps) // int(d.period_steps)
    target, offset = loop.targets[late], loop.torques[late]
    if d.mode == plant.CST:
        target, offset = offset, 0.0
    r.phase = 0.0
    r.torque_offset, r.velocity_offset = offset, loop.velocity_offsets[late]
    r.target0, r.target1, r.target2 = r.target1, r.target2, target


@compiled
def run(axis: Axis, demand: Array, trace: Array) -> None:
    """Simulate a motion of one axis.

    ``axis``: records at rest; their states are those at the end afterwards. ``demand``: (n, 7), a row for each cycle:
    position, velocity and acceleration now, velocity and acceleration when this cycle's torque acts, position and
    velocity as sent, SI. ``trace``: (5, n), is filled, in the order of `TRACE`: following error, compensation, gain
    factor of the compensator, demanded position, and demanded less true position of the load. The following error is
    that of the encoder, from the demand with the offset of the motor (`friction_hil.compensator.transmission`).
    """
    steps = int(axis.daemon[0].period_steps)
    until = int(axis.daemon[0].delay_steps) % steps  # in the period, when a set-point takes effect
    _begin(axis)
    for k in range(demand.shape[0]):
        _decide(axis, k, demand[k], trace)
        plant.advance(axis.servo, axis.controller, axis.state, until)
        _act(axis)
        plant.advance(axis.servo, axis.controller, axis.state, steps - until)


@inlined
def _hold(axis: Axis, torque: float) -> None:
    """Let the integral part of the velocity loop hold the axis where it is, by a torque that has risen slowly."""
    if axis.own_controller[0].velocity_gain > 0.0:
        axis.loop[0].integral = torque / axis.own_controller[0].velocity_gain
    r, gain = axis.state[0], axis.controller[0].velocity_gain
    if not gain > 0.0:
        return
    position = r.position
    for k in range(1, _RISE_CYCLES + 1):
        r.integral = torque / gain * k / _RISE_CYCLES
        plant.advance(axis.servo, axis.controller, axis.state, int(axis.daemon[0].period_steps))
        r.position, r.velocity = position, 0.0


@compiled
def follow(
    axis: Axis, demand: Array, measured: Array, torque: float, correction: tuple[float, float], ahead: Array
) -> None:
    """Simulate a recorded motion of one axis, and correct position and velocity by what was measured, cycle by cycle.

    ``demand``: (n, 7), as for `run`. ``measured``: (n,), position; NaN: unknown, no correction. ``torque``: by which
    the axis is held at the start, N m or N. ``correction``: of position and velocity (1/s), times the difference of the
    position. ``ahead``: (n,), is filled with that difference, measured less predicted before the correction; NaN where
    it is unknown.
    """
    trace = np.empty((len(TRACE), demand.shape[0]))
    steps = int(axis.daemon[0].period_steps)
    until = int(axis.daemon[0].delay_steps) % steps
    _begin(axis)
    _hold(axis, torque)
    for k in range(demand.shape[0]):
        ahead[k] = measured[k] - axis.state[0].position
        if not math.isnan(ahead[k]):
            axis.state[0].position += correction[0] * ahead[k]
            axis.state[0].velocity += correction[1] * ahead[k]
        _decide(axis, k, demand[k], trace)
        plant.advance(axis.servo, axis.controller, axis.state, until)
        _act(axis)
        plant.advance(axis.servo, axis.controller, axis.state, steps - until)


@inlined
def _one(axes: Axis, i: int) -> Axis:
    """Return one of several axes."""
    return Axis(
        axes.daemon[i : i + 1],
        axes.loop[i : i + 1],
        axes.own_controller[i : i + 1],
        axes.servo[i : i + 1],
        axes.controller[i : i + 1],
        axes.state[i : i + 1],
        axes.settings[i : i + 1],
        axes.compensator_state[i : i + 1],
        axes.offset_settings[i : i + 1],
        axes.offset_state[i : i + 1],
        axes.shift[i : i + 1],
    )


@compiled
def run_coupled(mechanism: coupled.Coupled, axes: Axis, order: Any, demands: Array, traces: Array) -> None:
    """Simulate a motion of the axes of a mechanism, which are sampled at the same time.

    ``axes``: in the order of the mechanism, with one period. ``order``: indices of them by the moment in the period at
    which a set-point takes effect. ``demands`` and ``traces``: as for `run`, of each axis.
    """
    steps = int(axes.daemon[0].period_steps)
    for i in order:
        _begin(_one(axes, i))
    for k in range(demands.shape[1]):
        passed = 0
        for i in order:
            _decide(_one(axes, i), k, demands[i, k], traces[i])
        for i in order:
            until = int(axes.daemon[i].delay_steps) % steps
            coupled.advance(mechanism, until - passed)
            _act(_one(axes, i))
            passed = until
        coupled.advance(mechanism, steps - passed)
