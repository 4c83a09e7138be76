"""Power law: friction of harmonic drives and greased gears, which grows with a power of the velocity."""

import math

from friction_hil.friction.curves import direction, modified, sticking
from friction_hil.friction.elementary import power
from friction_hil.friction.family import Family
from friction_hil.friction.parameters import COULOMB, Parameter
from friction_hil.numerics.jit import Array, inlined

_FACTOR = Parameter("factor", "Fv", "N m (s/rad)^n", "factor of the power of the velocity")
_EXPONENT = Parameter("exponent", "n", "1", "power of the velocity; 1 is viscous friction", is_lower_allowed=False)


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
    level = modified(p[0], extra, scale)
    if velocity == 0.0 and epsilon == 0.0:
        return sticking(applied_torque, level)
    growing = p[1] * power(abs(level_velocity), p[2])
    return level * direction(velocity, epsilon) + growing * direction(level_velocity, 0.0)


@inlined
def run(p: Array, s: Array, velocity: Array, dt: float, applied_torque: float, torque: Array) -> bool:
    """Fill ``torque`` for every sample, with the same bits as `step`; return True if every velocity is finite."""
    level, factor, exponent = modified(p[0], 0.0, 1.0), p[1], p[2]
    stuck = sticking(applied_torque, level)
    is_finite = True
    for k in range(velocity.shape[0]):
        v = velocity[k]
        is_finite &= math.isfinite(v)
        sign = direction(v, 0.0)
        torque[k] = stuck if v == 0.0 else level * sign + factor * power(abs(v), exponent) * sign
    return is_finite


@inlined
def steady(p: Array, velocity: float, extra: float, scale: float) -> float:
    """Compute the torque at constant ``velocity``; 0 at rest."""
    return (modified(p[0], extra, scale) + p[1] * power(abs(velocity), p[2])) * direction(velocity, 0.0)


FAMILY = Family(
    name="power_law",
    summary="Coulomb level plus a power of the velocity: harmonic drives, grease",
    formula="F = (Fc + Fv |v|^n) sgn v;  at rest F balances the applied torque up to Fc",
    source="published speed-current curves of harmonic drive joints follow it with n near 0.5",
    parameters=(COULOMB, _FACTOR, _EXPONENT),
    states=(),
    example={"coulomb": 0.08, "factor": 0.02, "exponent": 0.5},
)
