"""The two velocities that the friction model is given: one for its state, one for its level.

A feed-forward that cancels friction can also cancel what keeps the axis stable. To the motion's deviation from
the demand, the compensation must answer only with torque that takes energy out of that deviation:

* The *state*, and with it the direction, follows the reference velocity u = v_demand + a e: the demand, plus what
  makes up for a following error e. Driven by the measured velocity instead, the model would cancel the presliding
  spring through a late and quantised measurement, and push an axis that slips back along with its slip.
* The *level* follows the measured velocity, because a feed-forward cannot damp the falling part of a Stribeck
  curve: an axis that runs ahead gets less torque, one that falls behind more. Its sign stays that of u.
* The deviation is the one expected when the torque acts (`prediction`): late, it would excite what it is to damp.
* It counts as far as it is real, by the gain S / (S + S_gate) of a Wiener filter, S being its smoothed square, and
  as far as the following error is more than the rounding of the encoder.

Without a demand, the velocity when the torque acts is the estimate plus the change that its slope predicts, times
the fraction of such predictions that came true lately (`expected_change`): a reversal, too, is then answered in
time, not later by the whole delay.
"""

import math
from typing import Any

from friction_hil.compensator import prediction
from friction_hil.numerics.jit import inlined

AUTO, MEASURED, DEMAND = 0, 1, 2
SOURCES = {"auto": AUTO, "measured": MEASURED, "demand": DEMAND}

HORIZON = 8  # most cycles over which predictions are judged
HISTORY = 18  # cycles of demanded velocity kept, which bounds the delay of the velocity estimate
RECOVERY = 30.0  # a, 1/s: rate at which an axis is expected to make up for its following error
ROUNDING = 1.0 / 3.0  # mean square of the rounding of a position downwards, in counts squared
EVIDENCE_S = 0.5  # for which a following error is remembered
REVERSAL_COUNTS = 15.0  # distance in which a static map on an axis moved by hand reverses its direction
STIFFNESS_FRACTION = 0.25  # of the presliding spring, compensated where there is no demand
GATE_STRIBECK_RATIO = 0.06  # gate for deviations from the demand, in Stribeck velocities
SLOPE_COEFFICIENT = 0.2  # of the one-pole filter for the slope of the velocity
NOISE_RATIO = 6.0  # square of a count's velocity over that of the noise, both of a plain encoder difference
_SMOOTHING_CYCLES = 15.0
_JUDGING_CYCLES = 30.0  # over which predicted changes are compared with true ones


STATE = [
    ("deviation_square", "f8"),
    ("prediction", prediction.STATE),
    ("has_demand", "f8"),
    ("error", "f8"),  # demanded less measured position; 0 where unknown
    ("has_error", "f8"),
    ("evidence", "f8"),  # that the axis deviates by more than the rounding of the encoder, 0 to 1
    ("error_square", "f8"),
    ("guided_direction", "f8"),  # of a static map on an axis moved by hand, -1 to 1
    ("guided_velocity", "f8"),
    ("last_velocity", "f8"),
    ("slope", "f8"),  # of the velocity estimate, smoothed
    ("slopes", "f8", (HORIZON,)),  # newest first
    ("velocities", "f8", (HORIZON,)),  # of the same cycles
    ("change_square", "f8"),  # of the predicted change of velocity, smoothed
    ("change_product", "f8"),  # of the predicted and the true change, smoothed
    ("demands", "f8", (HISTORY,)),  # demanded velocity, newest first
]


@inlined
def forget(r: Any, demand: float) -> None:
    """Start anew, as if the demand had always been ``demand``."""
    r.deviation_square = 0.0
    prediction.forget(r.prediction)
    r.error = r.error_square = r.has_error = r.evidence = 0.0
    for k in range(HISTORY):
        r.demands[k] = demand


@inlined
def forget_changes(r: Any, velocity: float) -> None:
    """Start the prediction of changes anew from the present ``velocity``."""
    r.last_velocity = velocity
    r.slope = 0.0
    r.change_square = r.change_product = 0.0
    for k in range(HORIZON):
        r.slopes[k] = 0.0


@inlined
def begin(r: Any, velocity: float, demand: float) -> None:
    """Start anew with an estimated ``velocity``, as if the demand had always been ``demand``."""
    r.guided_velocity = velocity
    forget(r, demand)
    forget_changes(r, velocity)


@inlined
def remember(r: Any, velocity: float, demand: float, has_demand: bool, cycles: float) -> None:
    """Shift the demanded velocity into the history, once for each cycle that passed.

    ``velocity``: the estimate of the last cycle. With a demand that appears or disappears the past means nothing.
    """
    if has_demand and r.has_demand == 0.0:
        forget(r, demand)
    elif r.has_demand > 0.0 and not has_demand:
        forget_changes(r, velocity)
    for _ in range(min(int(cycles), HISTORY)):
        for k in range(HISTORY - 1, 0, -1):
            r.demands[k] = r.demands[k - 1]
        r.demands[0] = demand


@inlined
def see(r: Any, position: float, position_demand: float, has_demand: bool, is_fresh: bool) -> None:
    """Keep what is known of demand and following error in this cycle."""
    r.has_demand = 1.0 if has_demand else 0.0
    if is_fresh:
        r.has_error = 1.0 if math.isfinite(position_demand) else 0.0
        r.error = position_demand - position if r.has_error > 0.0 else 0.0


@inlined
def deviation(c: Any, r: Any, velocity: float) -> float:
    """Return measured less demanded velocity at the moment to which the estimate belongs."""
    whole = int(c.delay_cycles)
    part = c.delay_cycles - whole
    return float(velocity - (1.0 - part) * r.demands[whole] - part * r.demands[whole + 1])


@inlined
def reference_velocity(c: Any, r: Any, ahead: float) -> float:
    """Return the demanded velocity plus what makes up for the following error.

    Errors within one count are ignored. An axis that sticks beside a resting demand is helped to it, instead of
    hunting round it; but not by a static map, which would answer with a relay in place of a spring.
    """
    count_square = c.resolution * c.resolution
    real = 1.0 - count_square / r.error_square if r.error_square > count_square else 0.0
    if c.is_static > 0.0:
        real *= min(abs(ahead) / c.epsilon_of_demand, 1.0)
    return float(ahead + real * RECOVERY * r.error)


@inlined
def admitted(c: Any, r: Any) -> float:
    """Return the fraction of the deviation that is taken for real, 0 to 1.

    It is small where the deviation is small beside the Stribeck velocity, and where the following error is no more
    than the rounding of the encoder, whose mean square is a third of a count squared: what a coarse encoder then
    shows as deviation is noise.
    """
    real = 1.0
    if r.has_error > 0.0:
        real = min(max(2.0 * (r.error_square / (c.resolution * c.resolution) - ROUNDING), 0.0), 1.0)
    r.evidence = max(real, r.evidence * (1.0 - c.period_s / EVIDENCE_S))
    return float(r.evidence * r.deviation_square / (r.deviation_square + c.gate_square))


@inlined
def expected_change(c: Any, r: Any, v: float, dt: float) -> tuple[float, float]:
    """Return the expected change of velocity until the torque acts, and its ratio to the predicted change.

    The prediction extends the slope of the estimate: right in a motion led by hand, wrong in noise, in steps of the
    encoder and where the axis sticks. The ratio is the regression of true on predicted changes, the mean of their
    product over the mean square of the prediction, less the part of that square that the encoder could have caused.
    """
    cycles = int(c.judged_cycles)
    elapsed = int(dt / c.period_s + 0.5)  # more than 1 after missed periods
    before = cycles - elapsed  # of the prediction that was made for now
    if before >= 0:
        predicted = r.slopes[before] * cycles * c.period_s
        came = v - r.velocities[before]
        r.change_square += (predicted * predicted - r.change_square) / _JUDGING_CYCLES
        r.change_product += (predicted * came - r.change_product) / _JUDGING_CYCLES
    r.slope += SLOPE_COEFFICIENT * ((v - r.last_velocity) / dt - r.slope)
    r.last_velocity = v
    for _ in range(min(max(elapsed, 1), cycles)):
        for k in range(cycles - 1, 0, -1):
            r.slopes[k], r.velocities[k] = r.slopes[k - 1], r.velocities[k - 1]
        r.slopes[0], r.velocities[0] = r.slope, v
    if not (r.change_product > 0.0 and r.change_square > c.ahead_noise_square):
        return 0.0, 0.0
    ratio = min(r.change_product / r.change_square, 1.0) * (1.0 - c.ahead_noise_square / r.change_square)
    return ratio * c.ahead_s * r.slope, ratio


@inlined
def guided_velocities(c: Any, r: Any, measured: float, change: float, ratio: float, dt: float) -> tuple[float, float]:
    """Return the velocities for state and level of an axis that is moved by hand, without a demand.

    A hand cannot be told from the spring's own swing. A model spring that is too soft leaves the axis most of its
    own, whatever the delay. A static map has no spring; its direction follows with a hysteresis of
    `REVERSAL_COUNTS`. The level's velocity is smoothed the more, the less the predictions come true.
    """
    v = measured + change
    level = r.guided_velocity + ratio * (measured - r.guided_velocity) + change
    if c.is_static == 0.0:
        return STIFFNESS_FRACTION * v, level
    r.guided_direction = min(max(r.guided_direction + v * dt / (REVERSAL_COUNTS * c.resolution), -1.0), 1.0)
    return 3.0 * r.guided_direction * c.epsilon, level  # tanh 3 is almost 1


@inlined
def model_velocities(c: Any, r: Any, measured: float, ahead: float, dt: float) -> tuple[float, float]:
    """Return the velocities for the model's state and for its level.

    ``measured``: estimated velocity; ``ahead``: the one demanded when the torque will act, NaN without a demand;
    ``dt``: since the last cycle, s.
    """
    r.guided_velocity += c.guided_coefficient * (measured - r.guided_velocity)
    if not math.isfinite(ahead):
        change, ratio = expected_change(c, r, measured, dt)
        if c.source == MEASURED:
            # the state stays with the measured velocity: with a predicted one, the whole model spring would oscillate
            predicted = measured + change
            return measured, predicted if predicted * measured > 0.0 else 0.0
        return guided_velocities(c, r, measured, change, ratio, dt)
    d = deviation(c, r, measured)
    prediction.remember(r.prediction, d, dt / c.period_s + 0.5)
    r.deviation_square += (d * d - r.deviation_square) / _SMOOTHING_CYCLES
    if c.source == MEASURED:
        return ahead + d, ahead + d
    if c.source == DEMAND:
        return ahead, ahead
    r.error_square += (r.error * r.error - r.error_square) / _SMOOTHING_CYCLES
    u = reference_velocity(c, r, ahead)
    level = ahead + admitted(c, r) * prediction.predicted(c, r.prediction)
    if u > 0.0:
        level = max(level, 0.0)
    elif u < 0.0:
        level = min(level, 0.0)
    return u, level
