"""Elasto-plastic friction: LuGre with a purely elastic presliding range, in which it does not drift."""

import math

from friction_hil.friction import lugre
from friction_hil.friction.curves import direction
from friction_hil.friction.elementary import approach, cos, mean_decay, sin
from friction_hil.friction.family import Family
from friction_hil.friction.parameters import Parameter
from friction_hil.numerics.jit import Array, inlined

_level_at, _damping, _torque, _steady = lugre.level_at, lugre.damping, lugre.torque, lugre.steady

_BREAKAWAY_RATIO = Parameter(
    "breakaway_ratio",
    "r",
    "1",
    "fraction of the settled deflection up to which the bristles are purely elastic, z_ba / z_ss",
    upper=1.0,
    is_upper_allowed=False,
)
_SUBSTEPS = 32
_SETTLED = 50.0  # path, in settled deflections, after which the deflection has settled to double precision
_SUBSTEPS_PER_TRANSITION = 8


@inlined
def _deflected(y: float, path: float, ratio: float) -> float:
    """Compute the deflection after a ``path``; both are in settled deflections, positive in the direction of motion.

    dy/dx = 1 - alpha(y) y, where alpha is 0 up to ``ratio``, rises like a sine to 1 at y = 1, and stays 1. The first
    and the last part are solved exactly. The transition is integrated by Rosenbrock-Euler steps, exact for a linear
    equation and of second order, each at most an eighth of the transition. The 32nd step takes the rest of the path;
    its result is limited to between the solution for alpha = 1, which is a lower bound of the true one, and 1.
    """
    if y < ratio:
        elastic = ratio - y
        if path <= elastic:
            return y + path
        path = path - elastic
        y = ratio + 0.0 * y
    if path > _SETTLED:
        return 1.0 + 0.0 * y
    width, middle = 1.0 - ratio, 0.5 * (1.0 + ratio)
    longest = width / _SUBSTEPS_PER_TRANSITION
    angle_per_y = math.pi / width
    left = path
    for k in range(_SUBSTEPS):
        if left <= 0.0:
            break
        h = left
        if y < 1.0 and k < _SUBSTEPS - 1 and h > longest:
            h = longest
        alpha, slope = 1.0 + 0.0 * width, 0.0 * width
        if y < 1.0:
            angle = angle_per_y * (y - middle)
            alpha = 0.5 * sin(angle) + 0.5
            slope = 0.5 * angle_per_y * cos(angle)
        after = y + h * mean_decay(h * (alpha + slope * y)) * (1.0 - alpha * y)
        if h > longest:
            least = y + approach(h) * (1.0 - y)
            after = least if after < least else after
        y = 1.0 + 0.0 * after if after > 1.0 and y < 1.0 else after
        left = left - h
    return y


@inlined
def step(
    p: Array,
    s: Array,
    velocity: float,
    level_velocity: float,
    dt: float,
    extra: float,
    scale: float,
    applied_torque: float,
    epsilon: float,
) -> float:
    """Compute the torque of one sample; see `friction_hil.friction.kernel`."""
    level = _level_at(p, level_velocity, extra, scale)
    settled = level / p[0]
    before = s[0]
    after = before
    if velocity != 0.0:
        sign = direction(velocity, 0.0)
        after = settled * sign * _deflected(before * sign / settled, abs(velocity) * dt / settled, p[7])
    s[0] = after
    return _torque(p, before, after, _damping(p, level_velocity), level_velocity, dt)


@inlined
def steady(p: Array, velocity: float, extra: float, scale: float) -> float:
    """Compute the torque at constant ``velocity``; 0 at rest."""
    return _steady(p, velocity, extra, scale)


FAMILY = Family(
    name="elasto_plastic",
    summary="LuGre with an elastic range below break-away: no drift in presliding",
    formula=(
        "dz/dt = v (1 - alpha(z, v) sigma0 / g(v) sgn(v) z);  g(v) = Fc + (Fs - Fc) exp(-(v/vs)^2);  "
        "alpha = 0 where sgn z differs from sgn v or |z| < r g/sigma0, rising like a sine to 1 at g/sigma0;  "
        "F = sigma0 z + sigma1 exp(-(v/vd)^2) dz/dt + sigma2 v"
    ),
    source="Dupont, Hayward, Armstrong, Altpeter, IEEE Transactions on Automatic Control 47(5), 2002",
    parameters=(*lugre.FAMILY.parameters, _BREAKAWAY_RATIO),
    states=lugre.FAMILY.states,
    example={**lugre.FAMILY.example, "breakaway_ratio": 0.7},
)
