"""Compilation of what learning needs, which takes half a minute for the first time on a machine."""

import contextlib
import math

import numpy as np

from friction_hil.errors import UsageError
from friction_hil.identification.least_squares import NUMERICAL
from friction_hil.learning.conversion import alternatives, converted
from friction_hil.learning.estimate import Belief, estimate, first_belief, left_over
from friction_hil.learning.layer import RIPPLE, Feature, Layer
from friction_hil.learning.residual import Residual
from friction_hil.learning.window import Window

_WINDOW_S, _SKIPPED_S = 3.0, 1.0


def compile_learning(belief: Belief, period_s: float, resolution: float) -> None:
    """Compile what estimates, a residual layer and other families need, and keep it for other processes.

    ``resolution``: step of the position, rad or m.
    """
    time_s = np.arange(round(_WINDOW_S / period_s)) * period_s
    position, nothing = np.sin(math.tau * time_s), np.zeros(time_s.size)
    torque = belief.model.level * np.sign(np.cos(math.tau * time_s))
    window = Window(period_s, position, torque, position, nothing, np.full(time_s.size, math.nan))
    ripple = Layer((Feature(RIPPLE, 1.0, "sine"),), (0.01 * belief.model.level,))
    # of this motion, which no axis makes, no result matters
    with contextlib.suppress(UsageError, *NUMERICAL):
        estimate(window, belief, resolution, _SKIPPED_S)
        Residual(belief.model).look(left_over(window, belief, resolution, _SKIPPED_S), None)
        ripple.on(belief.model).simulate(nothing, period_s, **window.inputs())
    for form in alternatives(belief.model):
        with contextlib.suppress(UsageError, *NUMERICAL):
            other = converted(belief.model, form, speed=math.tau, deflection=1e-3)
            estimate(window, first_belief(other, belief.mechanics, {}), resolution, _SKIPPED_S)
