"""How late the cycles of the loop began: histogram and percentiles. Pure."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from friction_hil.live.window import Window
from friction_hil.numerics.jit import Array

# us; three bounds a decade, as people read them
BOUNDS_US = tuple(float(step * 10**decade) for decade in range(6) for step in (1, 2, 5))


@dataclass(frozen=True, slots=True, eq=False)
class Lateness:
    """Lateness of the cycles."""

    p50_us: float  # over the window, as the next two; NaN without any row
    p99_us: float
    max_us: float
    # (k,) upper bounds of the bins, `BOUNDS_US`; the last bin, beyond all of them, has none
    bounds_us: tuple[float, ...]
    counts: NDArray[np.int64]  # (k + 1,) rows of the window in each bin: above the bound before it, up to its own
    total_counts: NDArray[np.int64]  # (k + 1,) rows since this was attached
    total_us: float  # sum of the lateness since this was attached
    highest_us: float  # largest since this was attached; NaN without any row


class LatenessFigures:
    """Lateness over a window of ``size`` rows and since the start."""

    def __init__(self, size: int) -> None:
        self._window = Window(size)
        self._counts = np.zeros(len(BOUNDS_US) + 1, np.int64)
        self._sum, self._highest = 0.0, np.nan

    def take(self, late_us: Array) -> None:
        """Take the lateness of further rows (n,), us; rows without one do not count."""
        late_us = late_us[np.isfinite(late_us)]
        if not late_us.size:
            return
        self._window.extend(late_us)
        self._counts += _histogram(late_us)
        self._sum += float(late_us.sum())
        self._highest = float(np.fmax(self._highest, late_us.max()))

    def figures(self) -> Lateness:
        """Return the figures."""
        values = self._window.values()
        p50, p99, peak = np.percentile(values, (50, 99, 100)).tolist() if values.size else (np.nan,) * 3
        return Lateness(p50, p99, peak, BOUNDS_US, _histogram(values), self._counts.copy(), self._sum, self._highest)


def _histogram(late_us: Array) -> NDArray[np.int64]:
    return np.bincount(np.searchsorted(BOUNDS_US, late_us), minlength=len(BOUNDS_US) + 1).astype(np.int64)
