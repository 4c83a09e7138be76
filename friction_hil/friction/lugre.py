"""LuGre friction: bristles that deflect and slip, with a Stribeck curve."""

import math
from typing import Any

from friction_hil.friction.curves import direction, gaussian_level, modified, sliding
from friction_hil.friction.elementary import approach, buffer, decay, toward
from friction_hil.friction.family import Family
from friction_hil.friction.parameters import COULOMB, STATIC, STRIBECK_VELOCITY, Parameter, defaulting, positive
from friction_hil.numerics.jit import Array, inlined

SIGMA0 = Parameter("sigma0", "sigma0", "N m/rad", "bristle stiffness", is_lower_allowed=False)
SIGMA1 = Parameter("sigma1", "sigma1", "N m s/rad", "bristle damping", default=0.0)
SIGMA2 = Parameter("sigma2", "sigma2", "N m s/rad", "viscous coefficient", default=0.0)
DAMPING_VELOCITY = Parameter(
    "damping_velocity",
    "vd",
    "rad/s",
    "velocity at which sigma1 has fallen to 1/e; .inf keeps it constant",
    is_lower_allowed=False,
    is_infinity_allowed=True,
    default=math.inf,
)
_BLOCK = 256


@inlined
def level_at(p: Array, velocity: float, extra: float, scale: float) -> float:
    """Compute the level g(v), N m."""
    return modified(gaussian_level(velocity, p[3], p[4], p[5]), extra, scale)


@inlined
def slipped(p: Array, level: float, velocity: float) -> float:
    """Compute the deflection that the bristles settle to, g / sigma0 sgn v, rad."""
    return level / p[0] * direction(velocity, 0.0)


@inlined
def approached(p: Array, level: float, velocity: float, dt: float) -> float:
    """Compute the fraction of the distance to that deflection covered in ``dt``, exact for a held velocity."""
    return approach(p[0] * abs(velocity) * dt / level)


@inlined
def damping(p: Array, velocity: float) -> float:
    """Compute the bristle damping sigma1 exp(-(v/vd)^2), N m s/rad."""
    fading = velocity / p[6]
    return p[1] * decay(fading * fading)


@inlined
def torque(p: Array, before: float, after: float, damping: float, velocity: float, dt: float) -> float:
    """Compute the torque of bristles whose deflection changed from ``before`` to ``after`` in ``dt``, N m."""
    return p[0] * after + damping * ((after - before) / dt) + p[2] * velocity


_level_at, _slipped, _approached, _damping, _torque = level_at, slipped, approached, damping, torque


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
    """Compute the torque of one sample, exact for ``velocity`` held over ``dt``; see `friction_hil.friction.kernel`.

    z+ = z + (1 - exp(-sigma0 abs(v) dt / g)) (g / sigma0 sgn v - z) is a weighted mean of the old and the settled
    deflection, hence stable and bounded at any ``dt``.
    """
    level = _level_at(p, level_velocity, extra, scale)
    before = s[0]
    after = toward(before, _slipped(p, level, velocity), _approached(p, level, velocity, dt))
    s[0] = after
    return _torque(p, before, after, _damping(p, level_velocity), level_velocity, dt)


@inlined
def run(p: Array, s: Array, velocity: Array, dt: float, applied_torque: float, torque: Array) -> bool:
    """Fill ``torque`` for every sample, with the same bits as `step`, but several times as fast.

    Results that do not depend on the state are computed first, each in its own loop, which the compiler vectorises.
    Little work remains for the loop over the state.
    """
    # a tuple, because stores to arrays cannot change it: the compiler then moves invariant terms out of the loops
    q: Any = (p[0], p[1], p[2], p[3], p[4], p[5], p[6])
    settled, fraction = buffer(p, _BLOCK), buffer(p, _BLOCK)
    damped, deflection = buffer(p, _BLOCK), buffer(p, _BLOCK + 1)
    is_fading = q[6] < math.inf
    if not is_fading:
        for k in range(_BLOCK):
            damped[k] = q[1]
    for begin in range(0, velocity.shape[0], _BLOCK):
        v = velocity[begin : begin + _BLOCK]
        for k in range(v.shape[0]):
            level = _level_at(q, v[k], 0.0, 1.0)
            settled[k] = _slipped(q, level, v[k])
            fraction[k] = _approached(q, level, v[k], dt)
        if is_fading:
            for k in range(v.shape[0]):
                damped[k] = _damping(q, v[k])
        z = s[0]
        deflection[0] = z
        for k in range(v.shape[0]):
            z = toward(z, settled[k], fraction[k])
            deflection[k + 1] = z
        s[0] = z
        for k in range(v.shape[0]):
            torque[begin + k] = _torque(q, deflection[k], deflection[k + 1], damped[k], v[k], dt)
    return False  # the velocities have not been checked


@inlined
def steady(p: Array, velocity: float, extra: float, scale: float) -> float:
    """Compute the torque at constant ``velocity``; 0 at rest."""
    return sliding(_level_at(p, velocity, extra, scale), p[2], velocity, velocity, 0.0)


FAMILY = Family(
    name="lugre",
    summary="bristle model: presliding, Stribeck curve, frictional lag",
    formula=(
        "dz/dt = v - sigma0 |v| / g(v) z;  g(v) = Fc + (Fs - Fc) exp(-(v/vs)^2);  "
        "F = sigma0 z + sigma1 exp(-(v/vd)^2) dz/dt + sigma2 v"
    ),
    source="Canudas de Wit, Olsson, Astrom, Lischinsky, IEEE Transactions on Automatic Control 40(3), 1995",
    parameters=(
        SIGMA0,
        SIGMA1,
        SIGMA2,
        positive(COULOMB),
        positive(defaulting(STATIC, "coulomb")),
        STRIBECK_VELOCITY,
        DAMPING_VELOCITY,
    ),
    states=("bristle deflection z [rad]",),
    example={
        "sigma0": 2000.0,
        "sigma1": 1.0,
        "sigma2": 2e-3,
        "coulomb": 0.08,
        "static": 0.12,
        "stribeck_velocity": 0.2,
        "damping_velocity": 0.2,
    },
    note=(
        "some texts print tau instead of sigma0 in dz/dt, which is dimensionally wrong. With a constant sigma1 the "
        "model is not passive above sigma1 |v| = 4 g(v); damping_velocity reduces sigma1 at higher velocities"
    ),
)
