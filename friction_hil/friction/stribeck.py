"""Stribeck friction: a static map whose level falls from break-away to Coulomb with increasing velocity."""

import math

from friction_hil.friction.curves import modified, sliding, sticking, stribeck_level
from friction_hil.friction.elementary import is_differentiated
from friction_hil.friction.family import Family
from friction_hil.friction.parameters import COULOMB, STATIC, STRIBECK_EXPONENT, STRIBECK_VELOCITY, VISCOUS
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
    level = modified(stribeck_level(level_velocity, p[0], p[1], p[2], p[3]), extra, scale)
    return sliding(level, p[4], velocity, level_velocity, epsilon)


@inlined
def _fill(p: Array, velocity: Array, band: float, exponent: float, applied_torque: float, torque: Array) -> bool:
    coulomb, static, stribeck_velocity, viscous = p[0], p[1], p[2], p[4]
    stuck = sticking(applied_torque, modified(static, 0.0, 1.0))
    is_finite = True
    for k in range(velocity.shape[0]):
        v = velocity[k]
        is_finite &= math.isfinite(v)
        level = modified(stribeck_level(v, coulomb, static, stribeck_velocity, exponent), 0.0, 1.0)
        slipping = sliding(level, viscous, v, v, 0.0)
        torque[k] = stuck if v == 0.0 or abs(v) < band else slipping
    return is_finite


@inlined
def run_with_band(p: Array, velocity: Array, band: float, applied_torque: float, torque: Array) -> bool:
    """Fill ``torque`` for every sample; velocities below ``band``, rad/s, count as standstill.

    The usual exponent 2 is passed as a constant, so that the compiler eliminates the power and vectorises the loop.
    """
    if p[3] == 2.0 and not is_differentiated(p[3]):
        return _fill(p, velocity, band, 2.0, applied_torque, torque)
    return _fill(p, velocity, band, p[3], applied_torque, torque)


_run_with_band = run_with_band


@inlined
def run(p: Array, s: Array, velocity: Array, dt: float, applied_torque: float, torque: Array) -> bool:
    """Fill ``torque`` for every sample, with the same bits as `step`; return True if every velocity is finite."""
    return _run_with_band(p, velocity, 0.0, applied_torque, torque)


@inlined
def steady(p: Array, velocity: float, extra: float, scale: float) -> float:
    """Compute the torque at constant ``velocity``; 0 at rest."""
    level = modified(stribeck_level(velocity, p[0], p[1], p[2], p[3]), extra, scale)
    return sliding(level, p[4], velocity, velocity, 0.0)


FAMILY = Family(
    name="stribeck",
    summary="static map with a Stribeck curve",
    formula=(
        "F = g(v) sgn v + Fv v;  g(v) = Fc + (Fs - Fc) exp(-(|v|/vs)^delta);  "
        "at rest F balances the applied torque up to Fs"
    ),
    source="Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994",
    parameters=(COULOMB, STATIC, STRIBECK_VELOCITY, STRIBECK_EXPONENT, VISCOUS),
    states=(),
    example={"coulomb": 0.08, "static": 0.12, "stribeck_velocity": 0.2, "stribeck_exponent": 2.0, "viscous": 2e-3},
    note="some texts print |v|^vs / |vs|^vs instead of the exponential, which is dimensionally wrong",
)
