"""Which velocities feed the friction model: the state goes with what is intended, the level with what is real.

A feed-forward that cancels friction can also cancel what keeps the axis stable. Of the motion's deviation from
the demand, the compensation may answer only with what takes energy out of it:

* The *state*, and with it the direction, follows the intent u = v_demand + a e: where the demand goes, and, if
  the axis has stayed behind or run ahead by e, where it has to go. Fed by the measured velocity instead, it would
  cancel the presliding spring through a late and quantised measurement, and push an axis that slips back along
  with its slip.
* The *level* follows the measured velocity, because a feed-forward cannot damp the falling part of a Stribeck
  curve: an axis that runs ahead gets less, one that falls behind more. It stays on the side of the intent.
* The measured deviation d is admitted as far as it is real, by the share r = S / (S + S_gate) of a Wiener filter,
  S its smoothed square.

Where no demand is known, the velocity of the moment of action is that of the estimate and the change that its slope
lets expect, by the share to which such predictions came true of late (`expected_change`): a reversal, too, is then
answered when it comes, not later by the whole delay.
"""

import math
from typing import Any

from friction_hil.numerics.jit import inlined

AUTO, MEASURED, DEMAND = 0, 1, 2
SOURCES = {"auto": AUTO, "measured": MEASURED, "demand": DEMAND}

HORIZON = 8  # cycles over which predictions are judged, at most
HISTORY = 18  # cycles of demanded velocity kept, which bounds the delay of the velocity estimate
RECOVERY = 30.0  # a, 1/s: how fast an axis is expected to make up for its following error
PLAY_COUNTS = 15.0  # in which a static map that is guided by hand changes its direction
STIFFNESS_SHARE = 0.25  # of the presliding spring that is compensated where no demand says what is intended
GATE_STRIBECK_SHARE = 0.06  # deviations from the demand, in Stribeck velocities, that matter
SLOPE_SHARE = 0.2  # one-pole coefficient for the slope of the velocity
NOISE_SHARE = 6.0  # square of a count's velocity over that of the noise, both of a plain encoder difference
_SMOOTHING_CYCLES = 15.0
_JUDGING_CYCLES = 30.0  # over which predictions are compared with what came


@inlined
def forget(r: Any, demand: float) -> None:
    """Begin anew, as if the demand had always been this."""
    r.deviation_square = 0.0
    r.error = 0.0
    r.error_square = 0.0
    for k in range(HISTORY):
        r.demands[k] = demand


@inlined
def forget_changes(r: Any) -> None:
    """Begin anew to predict, from the velocity of now."""
    r.last_velocity = r.motion.velocity
    r.slope = 0.0
    r.change_square = r.change_product = 0.0
    for k in range(HORIZON):
        r.slopes[k] = 0.0


@inlined
def remember(r: Any, demand: float, cycles: float) -> None:
    """Shift the demanded velocity into the history, once for each cycle that passed."""
    for _ in range(min(int(cycles), HISTORY)):
        for k in range(HISTORY - 1, 0, -1):
            r.demands[k] = r.demands[k - 1]
        r.demands[0] = demand


@inlined
def deviation(c: Any, r: Any) -> float:
    """Measured less demanded velocity, of the moment to which the estimate belongs."""
    whole = int(c.delay_cycles)
    part = c.delay_cycles - whole
    return float(r.motion.velocity - (1.0 - part) * r.demands[whole] - part * r.demands[whole + 1])


@inlined
def intended(c: Any, r: Any, ahead: float) -> float:
    """Velocity that the axis is meant to have: the demand's, and what makes up for the following error.

    Within one count there is no error. An axis that sticks beside a resting demand is helped to it, instead of
    hunting round it; but not by a static map, which would answer with a relay in place of a spring.
    """
    r.error_square += (r.error * r.error - r.error_square) / _SMOOTHING_CYCLES
    count_square = c.resolution * c.resolution
    real = 1.0 - count_square / r.error_square if r.error_square > count_square else 0.0
    if c.is_static > 0.0:
        real *= min(abs(ahead) / c.epsilon_of_demand, 1.0)
    return float(ahead + real * RECOVERY * r.error)


@inlined
def expected_change(c: Any, r: Any, dt: float) -> tuple[float, float]:
    """Change of the velocity until the torque acts, and the share of the predicted one that this is.

    Predicted by the slope of the estimate, which is right in a motion that a hand leads, wrong in noise, in steps of
    the encoder and where the axis sticks. The share is the regression of what came on what had been predicted,
    their product over the prediction's square, less the part of that square that the encoder could have caused.
    """
    v = r.motion.velocity
    cycles = int(c.judged_cycles)
    predicted = r.slopes[cycles - 1] * cycles * c.period_s
    came = v - r.velocities[cycles - 1]
    r.change_square += (predicted * predicted - r.change_square) / _JUDGING_CYCLES
    r.change_product += (predicted * came - r.change_product) / _JUDGING_CYCLES
    r.slope += SLOPE_SHARE * ((v - r.last_velocity) / dt - r.slope)
    r.last_velocity = v
    for k in range(cycles - 1, 0, -1):
        r.slopes[k], r.velocities[k] = r.slopes[k - 1], r.velocities[k - 1]
    r.slopes[0], r.velocities[0] = r.slope, v
    if not (r.change_product > 0.0 and r.change_square > c.ahead_noise_square):
        return 0.0, 0.0
    share = min(r.change_product / r.change_square, 1.0) * (1.0 - c.ahead_noise_square / r.change_square)
    return share * c.ahead_s * r.slope, share


@inlined
def guided(c: Any, r: Any, change: float, share: float, dt: float) -> tuple[float, float]:
    """Velocities of an axis that is moved by a hand: no demand says what is intended.

    Nothing tells a hand from the spring's own swing: too soft a spring in the model leaves the axis most of its
    own, at any delay. A static map has no spring; its direction follows in a play. The level's velocity is smoothed
    as far as the motion is not plain without that.
    """
    v = r.motion.velocity + change
    level = r.guided_velocity + share * (r.motion.velocity - r.guided_velocity) + change
    if c.is_static == 0.0:
        return STIFFNESS_SHARE * v, level
    r.play = min(max(r.play + v * dt / (PLAY_COUNTS * c.resolution), -1.0), 1.0)
    return 3.0 * r.play * c.epsilon, level  # tanh 3 is almost 1


@inlined
def velocities(c: Any, r: Any, ahead: float, dt: float) -> tuple[float, float]:
    """Velocities for the model's state and for its level.

    Parameters
    ----------
    c, r : record
        Settings and state of the compensator.
    ahead : float
        Demanded velocity when the torque will act; NaN where no demand is known.
    dt : float
        Time since the last cycle, s.
    """
    measured = r.motion.velocity
    r.guided_velocity += c.guided_share * (measured - r.guided_velocity)
    if not math.isfinite(ahead):
        change, share = expected_change(c, r, dt)
        if c.source == MEASURED:
            led = measured + change
            return measured, led if led * measured > 0.0 else 0.0  # the whole spring, led, would swing
        return guided(c, r, change, share, dt)
    d = deviation(c, r)
    r.deviation_square += (d * d - r.deviation_square) / _SMOOTHING_CYCLES
    if c.source == MEASURED:
        return ahead + d, ahead + d
    if c.source == DEMAND:
        return ahead, ahead
    u = intended(c, r, ahead)
    level = ahead + d * r.deviation_square / (r.deviation_square + c.gate_square)
    if u > 0.0:
        level = max(level, 0.0)
    elif u < 0.0:
        level = min(level, 0.0)
    return u, level
