"""The load of a compliant axis, driven through its coupling by a motor whose motion is known. Compiled, pure.

    load_inertia ql'' = coupling - level sign(ql') - load
    coupling = stiffness p + damping (q' - ql')

p is the twist q - ql beyond the backlash. Within the backlash the coupling is zero, and where there is backlash it
never pulls back. Coulomb friction acts implicitly, so that the load sticks exactly.

Source: J. J. Moreau, Unilateral contact and dry friction in finite freedom dynamics, 1988 (implicit friction of a time
step); E. Catmull, R. Rom, Computer Aided Geometric Design, 1974 (motion between samples).
"""

import math

import numpy as np

from friction_hil.numerics.jit import Array, compiled

_STEP = 0.25  # of a step times the natural frequency: the frequency is right to 0.3 %


def coupling_torque(
    position: Array,  # (n,) of the motor, evenly sampled, rad or m
    dt: float,  # s
    *,
    load_inertia: float,  # kg m^2 or kg, above zero
    stiffness: float,  # N m/rad or N/m, above zero
    damping: float,  # N m s/rad or N s/m
    backlash: float,  # whole width of the gap, rad or m
    level: float,  # Coulomb friction of the load, N m or N
    load: Array,  # (n,), torque on the load that opposes positive motion, N m or N, e.g. its weight
) -> tuple[Array, Array]:
    """Simulate the load and return the torque that it takes from the motor.

    Returns the torque at the samples, N m or N, and the part of the period before each sample in which the gap was
    open.
    """
    parts = max(1, math.ceil(math.sqrt(stiffness / load_inertia) * dt / _STEP))
    torque, is_free = np.empty(len(position)), np.empty(len(position))
    _simulate(position, dt, parts, load_inertia, stiffness, damping, 0.5 * backlash, level, load, torque, is_free)
    return torque, is_free


@compiled
def _simulate(
    position: Array,
    dt: float,
    parts: int,
    inertia: float,
    stiffness: float,
    damping: float,
    half: float,
    level: float,
    load: Array,
    torque: Array,
    is_free: Array,
) -> None:
    step = dt / parts
    count = len(position)
    hold = step * level / inertia
    q, v = position[0], 0.0
    torque[0], is_free[0] = 0.0, 0.0
    coupling = 0.0
    for i in range(1, count):
        begin, end = position[i - 1], position[i]
        slope = 0.5 * (end - position[max(i - 2, 0)])
        next_slope = 0.5 * (position[min(i + 1, count - 1)] - begin)
        rise = end - begin
        a, b = slope + next_slope - 2.0 * rise, 3.0 * rise - 2.0 * slope - next_slope
        free = 0
        for k in range(1, parts + 1):
            x = k / parts
            motor = begin + x * (slope + x * (b + x * a))
            speed = (slope + x * (2.0 * b + 3.0 * x * a)) / dt
            twist = motor - q
            if twist > half:
                coupling = stiffness * (twist - half) + damping * (speed - v)
                if half > 0.0 and coupling < 0.0:
                    coupling = 0.0
            elif twist < -half:
                coupling = stiffness * (twist + half) + damping * (speed - v)
                if half > 0.0 and coupling > 0.0:
                    coupling = 0.0
            elif half > 0.0:
                coupling = 0.0
                free += 1
            else:
                coupling = damping * (speed - v)
            v += step * (coupling - load[i]) / inertia
            v -= min(max(v, -hold), hold)
            q += step * v
        torque[i] = coupling
        is_free[i] = free / parts
