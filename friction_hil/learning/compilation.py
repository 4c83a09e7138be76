"""Compilation of what an estimate needs, which takes seconds for the first time on a machine."""

import contextlib
import math

import numpy as np

from friction_hil.identification.least_squares import NUMERICAL
from friction_hil.learning.estimate import Belief, estimate
from friction_hil.learning.window import Window

_COMPILED_S = 0.5


def compile_estimate(belief: Belief, period_s: float, resolution: float) -> None:
    """Compile what an estimate needs, and keep it for other processes.

    Parameters
    ----------
    belief : Belief
    period_s : float
        Period of the loop, s.
    resolution : float
        Step of the position, rad or m.
    """
    time_s = np.arange(round(_COMPILED_S / period_s)) * period_s
    position, nothing = np.sin(math.tau * time_s), np.zeros(time_s.size)
    window = Window(period_s, position, nothing, position, nothing, np.full(time_s.size, math.nan))
    with contextlib.suppress(*NUMERICAL):  # of this motion, which no axis makes, the result does not matter
        estimate(window, belief, resolution)
