"""A friction network over whole arrays."""

import numpy as np

from friction_hil.friction import network
from friction_hil.friction.elementary import whole
from friction_hil.numerics.jit import Array, compiled

_SETTLING_SAMPLES, _LONG_S = 13, 1e9  # of a gated network, whose state follows the path
_MOST_SAMPLES, _SETTLED = 20_000, 1e-12  # of a narx, which takes samples of its own period; change over the bound
_step = network.step


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
    is_narx = p[network.STRUCTURE] == network.NARX
    dt = p[network.TRAINED_DT] if is_narx else _LONG_S
    least, most = (whole(p[network.FEEDBACKS] + p[network.LAGS]), _MOST_SAMPLES) if is_narx else (0, _SETTLING_SAMPLES)
    change = _SETTLED * p[network.BOUND] * p[network.TORQUE_SCALE] if is_narx else -1.0
    for k in range(velocity.shape[0]):
        if velocity[k] == 0.0:
            continue
        s[:] = 0.0
        settled, total, still = 0.0, 0.0, 0  # samples without a change: past torques and velocities are those of now
        for sample in range(most):
            before = settled
            settled = _step(p, s, velocity[k], velocity[k], dt, 0.0, load_torque, temperature)
            still = still + 1 if abs(settled - before) <= change else 0
            if still > least:
                break
            if is_narx and 2 * sample >= most:
                total += settled
                if sample == most - 1:  # it oscillates: its mean
                    settled = total / (most - (most + 1) // 2)
        torque[k] += settled
