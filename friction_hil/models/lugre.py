"""LuGre friction: bristles that deflect, slip and carry the Stribeck curve."""

import math
from dataclasses import replace

from friction_hil.jit import Array, compiled
from friction_hil.models.curves import direction, stribeck_level
from friction_hil.models.family import Family
from friction_hil.models.parameters import COULOMB, STRIBECK_VELOCITY, Parameter

_SIGMA0 = Parameter("sigma0", "sigma0", "N m/rad", "bristle stiffness", is_lower_allowed=False)
_SIGMA1 = Parameter("sigma1", "sigma1", "N m s/rad", "bristle damping", default=0.0)
_SIGMA2 = Parameter("sigma2", "sigma2", "N m s/rad", "viscous coefficient", default=0.0)
_STATIC = Parameter(
    "static",
    "Fs",
    "N m",
    "break-away level; below coulomb it describes an axis without Stribeck hump",
    is_lower_allowed=False,
    default="coulomb",
)
_DAMPING_VELOCITY = Parameter(
    "damping_velocity",
    "vd",
    "rad/s",
    "velocity at which sigma1 has mostly faded; .inf keeps it constant",
    is_lower_allowed=False,
    is_infinity_allowed=True,
    default=math.inf,
)


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

    z+ = z_inf + (z - z_inf) exp(-sigma0 abs(v) dt / g) is a weighted mean of z and z_inf, hence stable and
    bounded at any ``dt``.
    """
    sigma0, sigma1, sigma2, coulomb, static, stribeck_velocity, damping_velocity = (
        p[0],
        p[1],
        p[2],
        p[3],
        p[4],
        p[5],
        p[6],
    )
    level = stribeck_level(level_velocity, coulomb, static, stribeck_velocity, 2.0)
    before = s[0]
    slipping = level / sigma0 * direction(velocity, 0.0)
    after = slipping + (before - slipping) * math.exp(-sigma0 * abs(velocity) * dt / level)
    s[0] = after
    fading = level_velocity / damping_velocity
    damping = sigma1 * math.exp(-fading * fading)
    return sigma0 * after + damping * ((after - before) / dt) + sigma2 * level_velocity


@compiled
def steady(p: Array, velocity: float) -> float:
    """Torque at constant ``velocity``; 0 at rest."""
    return stribeck_level(velocity, p[3], p[4], p[5], 2.0) * direction(velocity, 0.0) + p[2] * velocity


FAMILY = Family(
    name="lugre",
    summary="bristle model: presliding, Stribeck curve, frictional lag",
    formula=(
        "dz/dt = v - sigma0 |v| / g(v) z;  g(v) = Fc + (Fs - Fc) exp(-(v/vs)^2);  "
        "F = sigma0 z + sigma1 exp(-(v/vd)^2) dz/dt + sigma2 v"
    ),
    source="Canudas de Wit, Olsson, Astrom, Lischinsky, IEEE Transactions on Automatic Control 40(3), 1995",
    parameters=(
        _SIGMA0,
        _SIGMA1,
        _SIGMA2,
        replace(COULOMB, is_lower_allowed=False),
        _STATIC,
        STRIBECK_VELOCITY,
        _DAMPING_VELOCITY,
    ),
    states=("bristle deflection z [rad]",),
    note="some texts print tau in place of sigma0 in dz/dt, which is dimensionally wrong",
)
