"""Stribeck friction: a static map whose level falls from break-away to Coulomb as sliding begins."""

from friction_hil.jit import Array, compiled
from friction_hil.models.curves import direction, sticking, stribeck_level
from friction_hil.models.family import Family
from friction_hil.models.parameters import COULOMB, STATIC, STRIBECK_EXPONENT, STRIBECK_VELOCITY, VISCOUS


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
    if velocity == 0.0 and epsilon == 0.0:
        return sticking(applied_torque, p[1])
    level = stribeck_level(level_velocity, p[0], p[1], p[2], p[3])
    return level * direction(velocity, epsilon) + p[4] * level_velocity


@compiled
def steady(p: Array, velocity: float) -> float:
    """Torque at constant ``velocity``; 0 at rest."""
    return stribeck_level(velocity, p[0], p[1], p[2], p[3]) * direction(velocity, 0.0) + p[4] * velocity


FAMILY = Family(
    name="stribeck",
    summary="static map with a Stribeck curve",
    formula="F = g(v) sgn v + Fv v;  g(v) = Fc + (Fs - Fc) exp(-(|v|/vs)^delta);  at rest F balances to Fs",
    source="Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994",
    parameters=(COULOMB, STATIC, STRIBECK_VELOCITY, STRIBECK_EXPONENT, VISCOUS),
    states=(),
    note="some texts print |v|^vs / |vs|^vs in place of the exponential, which is dimensionally wrong",
)
