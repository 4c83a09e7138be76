"""Cascaded position and velocity control, for the simulated drive and for the loop's own controller."""

import math

import numpy as np

from friction_hil.numerics.jit import StructuredArray, compiled

CONTROLLER = np.dtype(
    [
        ("position_gain", "f8"),  # 1/s
        ("velocity_gain", "f8"),  # N m s/rad
        ("integral_hz", "f8"),  # corner of the velocity loop's integral action
        ("velocity_feedforward", "f8"),  # fraction of the demanded velocity
        ("inertia", "f8"),  # kg m^2 times the fraction of inertia feed-forward
    ]
)


@compiled
def cascade(
    c: StructuredArray,  # `CONTROLLER` record array of length 1
    integral: float,  # I before this sample, rad/s
    position_error: float,  # SI of the axis, as the next three; a velocity loop without position loop passes zero
    velocity_demand: float,
    acceleration_demand: float,
    velocity: float,
    dt: float,  # period of the controller, s
    limit: float,  # torque that the axis can give, N m; the integral stops where it alone would exceed it
) -> tuple[float, float]:
    """Return the torque of one controller sample.

    P position control over PI velocity control, with feed-forward of velocity and inertia:
    e = kp (q_d - q) + v_d - v;  tau = kv (e + I) + J a_d;  dI/dt = 2 pi f_i e.

    Returns the torque before limiting, N m, and the integral after this sample, rad/s.
    """
    r = c[0]
    error = r.position_gain * position_error + r.velocity_feedforward * velocity_demand - velocity
    integral += 2.0 * math.pi * r.integral_hz * dt * error
    if r.velocity_gain > 0.0:
        bound = limit / r.velocity_gain
        integral = min(max(integral, -bound), bound)
    return r.velocity_gain * (error + integral) + r.inertia * acceleration_demand, integral
