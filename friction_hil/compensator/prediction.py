"""The deviation of the motion from the demand, predicted for the moment at which the torque acts.

On the falling part of a Stribeck curve the drive alone hardly damps the axis, or not at all: it swings with tens to
hundreds of hertz. The compensation can damp the swing, since an axis that runs ahead then gets less torque, but only
with the right phase. At 110 Hz a lead time of 2.3 ms is a quarter of a period: torque for the deviation that was
measured then takes the place of inertia, and makes the swing faster instead of smaller.

A swing can be predicted, though its frequency and damping, which depend on the drive's loops, are unknown: the
deviation when the torque acts is regressed on the last two deviations (an autoregressive predictor of order two, least
squares with forgetting). Jumps of stick-slip cannot: there, the last deviation is right, advanced by the delay of the
velocity estimate as far as its change is more than noise. The weight of the regression is the fraction of the variance
that its predictions explained, made before the outcome was known, times the fraction by which they beat the advanced
deviation.
"""

import math
from typing import Any

from friction_hil.numerics.jit import inlined

HORIZON = 8  # most cycles that are predicted
ROOM = HORIZON + 3  # deviations and predictions kept
_FORGETTING_CYCLES = 50.0  # several periods of such a swing
_NOISE_OF_CHANGE = 3.0  # square of the noise of a change from cycle to cycle over that of a velocity by difference


STATE = [
    ("deviations", "f8", (ROOM,)),  # measured less demanded velocity, newest first
    ("predictions", "f8", (ROOM,)),  # made in the same cycles
    ("before_square", "f8"),  # smoothed moments of the deviation `before` a prediction, the one a cycle `earlier`
    ("before_product", "f8"),  # and the one that `came`: before times earlier
    ("earlier_square", "f8"),
    ("before_came", "f8"),
    ("earlier_came", "f8"),
    ("came_square", "f8"),
    ("predicted_miss", "f8"),  # mean square error of the predictions, and of the advanced deviation
    ("advanced_miss", "f8"),
]


@inlined
def forget(r: Any) -> None:
    """Start anew, as if there had never been a deviation."""
    for k in range(ROOM):
        r.deviations[k] = r.predictions[k] = 0.0
    r.before_square = r.before_product = r.earlier_square = 0.0
    r.before_came = r.earlier_came = r.came_square = 0.0
    r.predicted_miss = r.advanced_miss = 0.0


@inlined
def remember(r: Any, deviation: float, cycles: float) -> None:
    """Shift the deviation of this cycle into the history; cycles that were missed had the deviation before."""
    for _ in range(min(int(cycles), ROOM)):
        for k in range(ROOM - 1, 0, -1):
            r.deviations[k], r.predictions[k] = r.deviations[k - 1], r.predictions[k - 1]
    r.deviations[0] = deviation


@inlined
def _averaged(mean: float, value: float) -> float:
    return mean + (value - mean) / _FORGETTING_CYCLES


@inlined
def predicted(c: Any, r: Any) -> float:
    """Learn from the newest deviation, and return the one expected when the torque acts."""
    d = r.deviations
    noise = c.noise * c.noise  # added to every variance, so that nothing is made of it
    whole = int(c.ahead_cycles)
    part = c.ahead_cycles - whole
    came = (1.0 - part) * d[1] + part * d[0]  # `ahead_cycles` after the deviation `before`
    before, earlier = d[whole + 1], d[whole + 2]
    change_square = r.before_square - 2.0 * r.before_product + r.earlier_square
    advance = min(c.delay_cycles, 1.0) * max(1.0 - _NOISE_OF_CHANGE * noise / (change_square + noise), 0.0)
    miss, advanced_miss = came - r.predictions[whole + 1], came - before - advance * (before - earlier)
    r.predicted_miss = _averaged(r.predicted_miss, miss * miss)
    r.advanced_miss = _averaged(r.advanced_miss, advanced_miss * advanced_miss)
    r.before_square = _averaged(r.before_square, before * before)
    r.before_product = _averaged(r.before_product, before * earlier)
    r.earlier_square = _averaged(r.earlier_square, earlier * earlier)
    r.before_came = _averaged(r.before_came, before * came)
    r.earlier_came = _averaged(r.earlier_came, earlier * came)
    r.came_square = _averaged(r.came_square, came * came)

    first, product, second = r.before_square + noise, r.before_product, r.earlier_square + noise
    determinant = first * second - product * product
    newest = (r.before_came * second - r.earlier_came * product) / determinant
    last = (r.earlier_came * first - r.before_came * product) / determinant
    prediction = newest * d[0] + last * d[1]
    advanced = d[0] + advance * (d[0] - d[1])
    if not math.isfinite(prediction):
        prediction = 0.0
    r.predictions[0] = prediction
    explained = 1.0 - r.predicted_miss / (r.came_square + noise)
    better = 1.0 - (r.predicted_miss + noise) / (r.advanced_miss + noise)
    if not (explained > 0.0 and better > 0.0):
        return float(advanced)
    return float(advanced + explained * better * (prediction - advanced))
