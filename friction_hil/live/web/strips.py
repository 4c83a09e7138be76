"""Strips of the page: rows thinned out so that every peak stays. Pure."""

import itertools
import math
from collections import deque
from typing import TypeAlias

import numpy as np

from friction_hil.numerics.jit import Array

Points: TypeAlias = tuple[list[float], list[list[float | None]]]  # times, and the values of each column

WINDOW_S = 20.0
BUCKET_S = 0.02  # of rows that become two points
_GAP_S = 0.1  # without rows, in which a line is broken
_DIGITS = 7


class Strips:
    """Columns over time, thinned out to two points a bucket: the least and the largest value, in their order.

    ``period_s``: of the rows; where a bucket holds two rows or fewer, all of them are kept.
    """

    def __init__(self, columns: int, period_s: float) -> None:
        self._columns = columns
        self._gap_s = max(_GAP_S, 3.0 * period_s)
        self._is_thin = 2.0 * period_s >= BUCKET_S
        self._time: Array = np.empty(0)
        self._values: Array = np.empty((0, columns))
        self._kept: deque[tuple[float, list[float | None]]] = deque()

    def take(self, time: Array, values: Array) -> Points:
        """Take further rows, and return the points of all buckets that are complete.

        ``time``: (n,) s, ascending. ``values``: (n, columns), NaN where one is not known.
        """
        is_known = np.isfinite(time)
        time = np.concatenate([self._time, time[is_known]])
        values = np.concatenate([self._values, values[is_known]])
        bucket = np.floor(time / BUCKET_S)
        end = len(time) if self._is_thin else int(np.searchsorted(bucket, bucket[-1])) if len(time) else 0
        self._time, self._values = time[end:], values[end:]
        points: list[tuple[float, list[float | None]]] = []
        if self._is_thin:
            points = [(float(t), _plain(row)) for t, row in zip(time[:end], values[:end], strict=True)]
        else:
            starts = [*np.flatnonzero(np.diff(bucket[:end], prepend=-np.inf)), end] if end else []
            for first, last in itertools.pairwise(starts):
                low, high = _extremes(values[first:last])
                points += [(float(time[first]), low), (float(time[last - 1]), high)]
        points = self._broken(points)
        self._kept.extend(points)
        while self._kept and self._kept[0][0] < self._kept[-1][0] - WINDOW_S:
            self._kept.popleft()
        return self._columnwise(points)

    def _broken(self, points: list[tuple[float, list[float | None]]]) -> list[tuple[float, list[float | None]]]:
        """Return the points with one without values in each gap, over which no line is drawn."""
        last = self._kept[-1][0] if self._kept else math.inf
        found: list[tuple[float, list[float | None]]] = []
        for time, values in points:
            if time - last > self._gap_s:
                found.append((0.5 * (last + time), [None] * self._columns))
            found.append((time, values))
            last = time
        return found

    def window(self) -> Points:
        """Return the points of the last ``WINDOW_S``."""
        return self._columnwise(list(self._kept))

    def _columnwise(self, points: list[tuple[float, list[float | None]]]) -> Points:
        times = [round(time, 4) for time, _ in points]
        return times, [[values[k] for _, values in points] for k in range(self._columns)]


def _extremes(part: Array) -> tuple[list[float | None], list[float | None]]:
    """Return the least and the largest value of each column, the earlier one first."""
    is_known = np.isfinite(part)
    least, most = np.where(is_known, part, np.inf).argmin(axis=0), np.where(is_known, part, -np.inf).argmax(axis=0)
    column = np.arange(part.shape[1])
    return _plain(part[np.minimum(least, most), column]), _plain(part[np.maximum(least, most), column])


def _plain(values: Array) -> list[float | None]:
    return [short(value) if np.isfinite(value) else None for value in values.tolist()]


def short(value: float) -> float:
    """Return a value with as many digits as a picture can show, and a page has to be sent."""
    return float(f"{value:.{_DIGITS}g}")
