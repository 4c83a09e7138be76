"""Level curves that several models share."""

import math

from friction_hil.jit import compiled


@compiled
def stribeck_level(velocity: float, coulomb: float, static: float, stribeck_velocity: float, exponent: float) -> float:
    """Friction level g(v) = Fc + (Fs - Fc) exp(-(abs(v)/vs)^delta), even in ``velocity``, in N m.

    Source: Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994. Some texts print a ratio of
    powers in place of the exponential, which is dimensionally wrong.
    """
    ratio = abs(velocity) / stribeck_velocity
    power = ratio * ratio if exponent == 2.0 else ratio**exponent
    return coulomb + (static - coulomb) * math.exp(-power)


@compiled
def direction(velocity: float, epsilon: float) -> float:
    """Sign of ``velocity``; a smooth one of width ``epsilon`` where that is above zero. Odd; 0 at 0."""
    if epsilon > 0.0:
        return math.tanh(velocity / epsilon)
    if velocity > 0.0:
        return 1.0
    if velocity < 0.0:
        return -1.0
    return 0.0


@compiled
def sticking(applied_torque: float, break_away: float) -> float:
    """Friction at rest: it balances ``applied_torque`` up to the break-away level, in N m."""
    return min(max(applied_torque, -break_away), break_away)
