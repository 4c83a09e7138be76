"""Position between the counts of a coarse encoder. Pure."""

import numpy as np

from friction_hil.numerics.jit import Array
from friction_hil.recordings.quality import resolution

_FAST = 2.0  # counts per sample: from there on a count says no more about time than the sample itself
_LEAST_FRACTION = 0.5  # of the samples that are slower: fewer, and the encoder is not coarse


def between_counts(position: Array) -> Array:
    """Return a position (n,), rad or m, with the time between counts used instead of their rounding.

    When a coarse encoder changes by one count, the axis is at the edge between the two counts, to within its travel in
    a sample. Between edges the position is interpolated without overshoot, so that a slow motion shows no staircase.
    Where the axis moves by several counts per sample the samples are kept.

    ``position`` is evenly sampled. It is returned as it is if its values are not quantised, or the encoder is not
    coarse for this motion.

    Source of the interpolation: F. N. Fritsch, J. Butland, SIAM Journal on Scientific and Statistical Computing 5(2),
    1984, as `scipy.interpolate.PchipInterpolator`. Of time stamps of edges: R. J. E. Merry, M. J. G. van de Molengraft,
    M. Steinbuch, Mechatronics 20(1), 2010.
    """
    step = resolution(position)
    if step is None:
        return position
    counts = np.round((position - position[0]) / step)
    moves = np.diff(counts)
    is_fast = np.abs(moves) >= _FAST
    edges = np.flatnonzero(np.abs(moves) == 1.0)
    if np.mean(~is_fast) < _LEAST_FRACTION or len(edges) < 2:
        return position
    from scipy.interpolate import PchipInterpolator  # imported here: few recordings need it

    samples = np.flatnonzero(np.append(is_fast, [False]) | np.append([False], is_fast))
    time = np.concatenate([edges + 0.5, samples])
    value = np.concatenate([0.5 * (counts[edges] + counts[edges + 1]), counts[samples]])
    order = np.argsort(time)
    inside = np.clip(np.arange(len(position)), time[order[0]], time[order[-1]])
    smooth: Array = position[0] + step * PchipInterpolator(time[order], value[order])(inside)
    return smooth
