"""Decimation of long signals for pictures: peaks stay."""

import numpy as np

from friction_hil.numerics.jit import Array


def bucket_size(rows: int, most_points: int) -> int:
    """Return the number of rows of which `decimated` keeps two, so that at most about ``most_points`` are left."""
    return 1 if rows <= most_points else -(-2 * rows // most_points)


def decimated(values: Array, size: int) -> Array:
    """Keep the smallest and the largest of each ``size`` values, (n,), in the order in which they occur.

    A ``size`` of 1 keeps all values. NaN is left out, except where a bucket holds nothing else. Each bucket gives two
    values; `decimated_time` gives their times.

    >>> import numpy as np
    >>> decimated(np.array([0.0, 5.0, -1.0, 2.0, 3.0, 4.0]), 3)
    array([ 5., -1.,  2.,  4.])
    """
    if size == 1:
        return values
    buckets = _buckets(values, size, np.nan)
    unknown = np.isnan(buckets)
    low, high = np.where(unknown, np.inf, buckets), np.where(unknown, -np.inf, buckets)
    at_low, at_high = low.argmin(axis=1), high.argmax(axis=1)
    rows = np.arange(len(buckets))
    pairs = np.stack([buckets[rows, np.minimum(at_low, at_high)], buckets[rows, np.maximum(at_low, at_high)]], axis=1)
    is_empty = unknown.all(axis=1)
    pairs[is_empty] = np.nan
    return pairs.ravel()


def decimated_time(time_s: Array, size: int) -> Array:
    """Return the times that belong to `decimated` values: the first and the middle row of each bucket.

    All signals share them; they differ from the times of the values by less than a bucket.
    """
    if size == 1:
        return time_s
    buckets = _buckets(time_s, size, time_s[-1])
    return buckets[:, [0, size // 2]].ravel()


def _buckets(values: Array, size: int, padding: float) -> Array:
    """Return values as rows of ``size``, the last one padded."""
    count = -(-len(values) // size)
    padded = np.full(count * size, padding)
    padded[: len(values)] = values
    return padded.reshape(count, size)
