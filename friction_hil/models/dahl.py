"""Dahl friction: presliding as a spring that yields, without a Stribeck curve."""

import math
from dataclasses import replace

from friction_hil.jit import Array, compiled
from friction_hil.models.curves import direction
from friction_hil.models.family import Family
from friction_hil.models.parameters import COULOMB, VISCOUS, Parameter

_SIGMA0 = Parameter(
    "sigma0",
    "sigma0",
    "N m/rad",
    "presliding stiffness: slope of torque over position at zero torque",
    is_lower_allowed=False,
)
_EXPONENT = Parameter("exponent", "i", "1", "shape of the stress-strain curve", is_lower_allowed=False, default=1.0)


@compiled
def step(
    p: Array,
    s: Array,
    velocity: float,
    level_velocity: float,
    dt: float,
    applied_torque: float,
    epsilon: float,
) -> float:
    """Torque of one sample, exact for ``velocity`` held over ``dt``; see `friction_hil.models.kernel.step`.

    With w = 1 - (F/Fc) sgn v, which lies in [0, 2], Dahl's equation is dw/dx = -(sigma0/Fc) w^i along the
    path x travelled, and has a closed solution for any exponent.
    """
    sigma0, coulomb, exponent, viscous = p[0], p[1], p[2], p[3]
    if velocity != 0.0:
        sign = direction(velocity, 0.0)
        rest = 1.0 - s[0] * sign / coulomb
        path = sigma0 * abs(velocity) * dt / coulomb
        if exponent == 1.0:
            rest = rest * math.exp(-path)
        elif rest > 0.0:
            # w^p - p path, less one, in a form that keeps its digits where the exponent is close to 1
            power = 1.0 - exponent
            remaining = math.expm1(power * math.log(rest)) - power * path
            rest = math.exp(math.log1p(remaining) / power) if remaining > -1.0 else 0.0
        s[0] = coulomb * sign * (1.0 - rest)
    return s[0] + viscous * level_velocity


@compiled
def steady(p: Array, velocity: float) -> float:
    """Torque at constant ``velocity``; 0 at rest."""
    return p[1] * direction(velocity, 0.0) + p[3] * velocity


FAMILY = Family(
    name="dahl",
    summary="presliding spring that yields at the Coulomb level; any exponent",
    formula="dF/dx = sigma0 |1 - (F/Fc) sgn v|^i sgn(1 - (F/Fc) sgn v);  torque F + Fv v",
    source="P. Dahl, The Aerospace Corporation TOR-0158(3107-18)-1, 1968; AIAA Journal 14(12), 1976",
    parameters=(_SIGMA0, replace(COULOMB, is_lower_allowed=False), _EXPONENT, VISCOUS),
    states=("torque [N m]",),
)
