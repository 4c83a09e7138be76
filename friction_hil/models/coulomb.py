"""Coulomb friction with break-away and viscous friction: the classical static map."""

from friction_hil.jit import Array, compiled
from friction_hil.models.curves import direction, sticking
from friction_hil.models.family import Family
from friction_hil.models.parameters import COULOMB, VISCOUS, Parameter

_STATIC = Parameter("static", "Fs", "N m", "break-away level at rest", default="coulomb")


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
    """Torque of one sample; see `friction_hil.models.kernel.step`."""
    coulomb, static, viscous = p[0], p[1], p[2]
    if velocity == 0.0 and epsilon == 0.0:
        return sticking(applied_torque, static)
    return coulomb * direction(velocity, epsilon) + viscous * level_velocity


@compiled
def steady(p: Array, velocity: float) -> float:
    """Torque at constant ``velocity``; 0 at rest."""
    return p[0] * direction(velocity, 0.0) + p[2] * velocity


FAMILY = Family(
    name="coulomb",
    summary="Coulomb level, break-away level and viscous friction",
    formula="F = Fc sgn v + Fv v;  at rest F balances the applied torque up to Fs",
    source="Olsson, Astrom, Canudas de Wit, Gafvert, Lischinsky, European Journal of Control 4(3), 1998",
    parameters=(COULOMB, _STATIC, VISCOUS),
    states=(),
)
