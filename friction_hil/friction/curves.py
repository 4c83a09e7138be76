"""Level curves and direction functions that several models use.

The *level* of a model is the torque that its friction, without the viscous part, approaches while it slides. Load
and temperature change the level of every model by the same rule, `modified`.
"""

from friction_hil.friction.elementary import decay, power, tanh
from friction_hil.numerics.jit import inlined


@inlined
def modified(level: float, extra: float, scale: float) -> float:
    """Return the level, N m, raised by the load (``extra``, N m) and scaled by the temperature; see `modifiers`."""
    return (level + extra) * scale


@inlined
def stribeck_level(velocity: float, coulomb: float, static: float, stribeck_velocity: float, exponent: float) -> float:
    """Compute the level g(v) = Fc + (Fs - Fc) exp(-(abs(v)/vs)^delta), N m, even in ``velocity``.

    Source: Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994. Some texts print a ratio of
    powers instead of the exponential, which is dimensionally wrong.
    """
    return coulomb + (static - coulomb) * decay(power(abs(velocity) / stribeck_velocity, exponent))


@inlined
def gaussian_level(velocity: float, coulomb: float, static: float, stribeck_velocity: float) -> float:
    """Compute `stribeck_level` with exponent 2."""
    ratio = velocity / stribeck_velocity
    return coulomb + (static - coulomb) * decay(ratio * ratio)


@inlined
def direction(velocity: float, epsilon: float) -> float:
    """Return the sign of ``velocity``, 0 at 0; tanh(velocity / epsilon) if ``epsilon`` is above zero."""
    if epsilon > 0.0:
        return tanh(velocity / epsilon)
    if velocity > 0.0:
        return 1.0
    if velocity < 0.0:
        return -1.0
    return 0.0


@inlined
def sliding(level: float, viscous: float, velocity: float, level_velocity: float, epsilon: float) -> float:
    """Compute the torque of level and viscous friction, level sgn v + Fv v, N m."""
    return level * direction(velocity, epsilon) + viscous * level_velocity


@inlined
def sticking(applied_torque: float, break_away: float) -> float:
    """Compute the friction at rest, N m: it balances ``applied_torque`` up to the ``break_away`` level."""
    if applied_torque > break_away:
        return break_away
    if applied_torque < -break_away:
        return -break_away
    return applied_torque
