"""A machine of `friction_hil.servo` behind ideal drive loops, with encoder, delays and feed-forward. Compiled.

The loops see the true motion of the motor. All kernels are in this file, because the cache of numba notices only
changes of a kernel's own file and of the package.
"""

import math

import numpy as np

from friction_hil import compensator as compensation
from friction_hil.friction import kernel
from friction_hil.motion.controller import cascade
from friction_hil.numerics.jit import Array, StructuredArray, compiled
from friction_hil.servo import actuator, mechanics

MOST_DELAY_CYCLES = 8
NONE, TRUE_LATE, MEASURED, OURS = range(4)  # origins of the feed-forward torque
_UNLIMITED = 1e9  # N m: the drives of the benchmark do not saturate

CYCLE = np.dtype(
    [
        ("period_s", "f8"),
        ("samples", "f8"),  # of the drive, in one period
        ("delay_cycles", "f8"),  # from sampling the encoder to the start of the torque
        ("settling_cycles", "f8"),  # not scored
        ("resolution", "f8"),  # of the encoder, rad
        ("torque_step", "f8"),  # of the torque feedback, N m
    ]
)

FEEDFORWARD = np.dtype(
    [
        ("origin", "f8"),
        ("gain", "f8"),
        ("smoothing", "f8"),  # of the one-pole filter on the encoder difference
        ("epsilon", "f8"),
        ("kind", "f8"),
        ("friction", "f8", (kernel.PLAIN_ROOM,)),
    ]
)

TRACE = ("position", "velocity", "load_position", "load_velocity", "friction", "compensation")

_compensate = compensation.whole_step


@compiled
def advance(
    plant: StructuredArray,
    controller: StructuredArray,
    state: StructuredArray,
    position_demand: Array,
    velocity_demand: Array,
    acceleration_demand: Array,
    first: int,
    samples: int,
    feedforward: float,
    score: Array,
    trace: Array,
) -> None:
    """Run ``samples`` samples of the drive from number ``first`` on, with a ``feedforward`` torque held.

    ``plant`` and ``state`` are `MACHINE` and `MACHINE_STATE` records. The demands, (n,), are of the drive's samples.
    Adds to ``score`` the squared following error, and takes its largest; fills a column of ``trace``, (6, n), a
    sample, unless it has none.
    """
    c, r = plant[0], state[0]
    steps, dt = int(c.steps_per_control), c.step_s
    for i in range(first, first + samples):
        error = position_demand[i] - r.position
        score[0] += error * error
        score[1] = max(score[1], abs(error))
        if i < trace.shape[1]:
            trace[0, i], trace[1, i] = r.position, r.velocity
            trace[2, i], trace[3, i] = r.load_position, r.load_velocity
            trace[4, i], trace[5, i] = r.friction_torque, feedforward
        demand, r.integral = cascade(
            controller,
            r.integral,
            error,
            velocity_demand[i],
            acceleration_demand[i],
            r.velocity,
            steps * dt,
            _UNLIMITED,
        )
        demand += feedforward
        for _ in range(steps):
            mechanics.move(plant, state, actuator.shaft_torque(plant, state, demand), False)


@compiled
def run(
    plant: StructuredArray,
    controller: StructuredArray,
    state: StructuredArray,
    cycle: StructuredArray,
    feedforward: StructuredArray,
    feedforward_state: Array,
    settings: StructuredArray,
    compensator_state: StructuredArray,
    position_demand: Array,
    velocity_demand: Array,
    acceleration_demand: Array,
    velocity_ahead: Array,
    acceleration_ahead: Array,
    score: Array,
    trace: Array,
) -> None:
    """Simulate one case; ``score`` becomes the sum of squares and the peak of the following error.

    At the beginning of each period the encoder is read and a feed-forward torque computed, which acts ``delay_cycles``
    periods later for one period. The drive's own loops see the true motion.

    Parameters
    ----------
    plant, controller, state, cycle, feedforward
        Structured arrays of length 1: `MACHINE`, `CONTROLLER`, `MACHINE_STATE`, `CYCLE`, `FEEDFORWARD`.
    feedforward_state
        State of the model in ``feedforward``; changed in place.
    settings, compensator_state
        Structured array and state of a `Compensator`.
    position_demand, velocity_demand, acceleration_demand
        (n,) arrays at the drive's samples.
    velocity_ahead, acceleration_ahead
        (m,) arrays: demanded velocity and acceleration at the time when the torque of each period acts.
    score
        (2,) array.
    trace
        (6, n) array, see `TRACE`; (6, 0) for none.
    """
    c, f = cycle[0], feedforward[0]
    samples, delay = int(c.samples), int(c.delay_cycles)
    pending = np.zeros(MOST_DELAY_CYCLES + 1)  # the first acts in this period
    seen, velocity = math.floor(state[0].position / c.resolution) * c.resolution, 0.0
    for k in range(velocity_ahead.shape[0]):
        i = k * samples
        position = math.floor(state[0].position / c.resolution) * c.resolution
        velocity += f.smoothing * ((position - seen) / c.period_s - velocity)
        seen = position
        torque = 0.0
        if f.origin == TRUE_LATE:
            torque = f.gain * state[0].friction_torque
        elif f.origin == MEASURED:
            torque = f.gain * mechanics.friction_step(
                int(f.kind),
                f.friction,
                feedforward_state,
                velocity,
                velocity,
                c.period_s,
                position,
                0.0,
                math.nan,
                0.0,
                1.0,
                f.epsilon,
            )
        elif f.origin == OURS:
            torque = _compensate(
                settings,
                compensator_state,
                float(k),
                position,
                state[0].velocity,
                math.floor(state[0].torque / c.torque_step + 0.5) * c.torque_step,
                position_demand[i],
                velocity_demand[i],
                velocity_ahead[k],
                1.0,
                1.0,
                acceleration_ahead[k],
                math.nan,
                math.nan,
            )
        pending[delay] = torque
        if k == int(c.settling_cycles):
            score[:] = 0.0
        advance(
            plant,
            controller,
            state,
            position_demand,
            velocity_demand,
            acceleration_demand,
            i,
            samples,
            pending[0],
            score,
            trace,
        )
        for j in range(MOST_DELAY_CYCLES):
            pending[j] = pending[j + 1]
