"""A friction network as functions of their own: one step, and whole arrays."""

import numpy as np

from friction_hil.friction import network
from friction_hil.numerics.jit import Array, compiled

_SETTLING_SAMPLES, _LONG_S = 13, 1e9
_step = network.step


@compiled
def step_apart(
    p: Array,
    s: Array,
    velocity: float,
    level_velocity: float,
    dt: float,
    position: float,
    load_torque: float,
    temperature: float,
) -> float:
    """Call `network.step` without inlining it; inlined into every family it would take minutes to compile."""
    return _step(p, s, velocity, level_velocity, dt, position, load_torque, temperature)


@compiled
def run(
    p: Array,
    s: Array,
    velocity: Array,
    dt: float,
    position: Array,
    load_torque: Array,
    temperature: Array,
    torque: Array,
) -> None:
    """Fill ``torque`` for every sample; the inputs after ``dt`` have one element, or one per sample."""
    position_stride = 1 if position.shape[0] > 1 else 0
    load_stride = 1 if load_torque.shape[0] > 1 else 0
    temperature_stride = 1 if temperature.shape[0] > 1 else 0
    for k in range(velocity.shape[0]):
        where, load = position[k * position_stride], load_torque[k * load_stride]
        torque[k] = _step(p, s, velocity[k], velocity[k], dt, where, load, temperature[k * temperature_stride])


@compiled
def add_steady_curve(p: Array, velocity: Array, load_torque: float, temperature: float, torque: Array) -> None:
    """Add the steady torque of the network at every constant ``velocity`` and position 0 to ``torque`` (n,)."""
    s = np.zeros(network.STATE_ROOM)
    for k in range(velocity.shape[0]):
        if velocity[k] == 0.0:
            continue
        s[:] = 0.0
        settled = 0.0
        for _ in range(_SETTLING_SAMPLES):
            settled = _step(p, s, velocity[k], velocity[k], _LONG_S, 0.0, load_torque, temperature)
        torque[k] += settled
