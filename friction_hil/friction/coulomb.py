"""Coulomb friction with break-away and viscous friction: the classical static map."""

import math

from friction_hil.friction.curves import modified, sliding, sticking
from friction_hil.friction.family import Family
from friction_hil.friction.parameters import COULOMB, STATIC, VISCOUS, defaulting
from friction_hil.numerics.jit import Array, inlined


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
    if velocity == 0.0 and epsilon == 0.0:
        return sticking(applied_torque, modified(p[1], extra, scale))
    return sliding(modified(p[0], extra, scale), p[2], velocity, level_velocity, epsilon)


@inlined
def run(p: Array, s: Array, velocity: Array, dt: float, applied_torque: float, torque: Array) -> bool:
    """Fill ``torque`` for every sample, with the same bits as `step`; return True if every velocity is finite."""
    level, viscous = modified(p[0], 0.0, 1.0), p[2]
    stuck = sticking(applied_torque, modified(p[1], 0.0, 1.0))
    is_finite = True
    for k in range(velocity.shape[0]):
        v = velocity[k]
        is_finite &= math.isfinite(v)
        torque[k] = stuck if v == 0.0 else sliding(level, viscous, v, v, 0.0)
    return is_finite


@inlined
def steady(p: Array, velocity: float, extra: float, scale: float) -> float:
    """Compute the torque at constant ``velocity``; 0 at rest."""
    return sliding(modified(p[0], extra, scale), p[2], velocity, velocity, 0.0)


FAMILY = Family(
    name="coulomb",
    summary="Coulomb level, break-away level and viscous friction",
    formula="F = Fc sgn v + Fv v;  at rest F balances the applied torque up to Fs",
    source="Olsson, Astrom, Canudas de Wit, Gafvert, Lischinsky, European Journal of Control 4(3), 1998",
    parameters=(COULOMB, defaulting(STATIC, "coulomb"), VISCOUS),
    states=(),
    example={"coulomb": 0.08, "static": 0.12, "viscous": 2e-3},
)
