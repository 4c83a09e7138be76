"""Level curves and directions that several models share.

A model's *level* is the torque that its friction, without the viscous part, approaches while it slides. Load and
temperature change it in every model the same way: `modified`.
"""

from friction_hil.friction.elementary import decay, power, tanh
from friction_hil.numerics.jit import inlined


@inlined
def modified(level: float, extra: float, scale: float) -> float:
    """Level, in N m, that load has raised by ``extra`` N m and temperature has scaled; see `modifiers`."""
    return (level + extra) * scale


@inlined
def stribeck_level(velocity: float, coulomb: float, static: float, stribeck_velocity: float, exponent: float) -> float:
    """Level g(v) = Fc + (Fs - Fc) exp(-(abs(v)/vs)^delta), even in ``velocity``, in N m.

    Source: Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994. Some texts print a ratio of
    powers in place of the exponential, which is dimensionally wrong.
    """
    return coulomb + (static - coulomb) * decay(power(abs(velocity) / stribeck_velocity, exponent))


@inlined
def gaussian_level(velocity: float, coulomb: float, static: float, stribeck_velocity: float) -> float:
    """`stribeck_level` of exponent 2."""
    ratio = velocity / stribeck_velocity
    return coulomb + (static - coulomb) * decay(ratio * ratio)


@inlined
def direction(velocity: float, epsilon: float) -> float:
    """Sign of ``velocity``; a smooth one of width ``epsilon`` where that is above zero. Odd; 0 at 0."""
    if epsilon > 0.0:
        return tanh(velocity / epsilon)
    if velocity > 0.0:
        return 1.0
    if velocity < 0.0:
        return -1.0
    return 0.0


@inlined
def sliding(level: float, viscous: float, velocity: float, level_velocity: float, epsilon: float) -> float:
    """Torque of a level and of viscous friction, level sgn v + Fv v, in N m."""
    return level * direction(velocity, epsilon) + viscous * level_velocity


@inlined
def sticking(applied_torque: float, break_away: float) -> float:
    """Friction at rest: it balances ``applied_torque`` up to the ``break_away`` level, in N m."""
    if applied_torque > break_away:
        return break_away
    if applied_torque < -break_away:
        return -break_away
    return applied_torque
