"""Periods that a daemon has missed, or in which no feedback arrived, filled in: learning goes on across them.

A missed period leaves a row out, and makes the drive wait for its set-point. Until the axis has recovered, its error is
due to the computer, not to the friction model: these rows are marked, and no comparison of errors contains them.
"""

from collections.abc import Mapping

import numpy as np

from friction_hil.analysis.following import recovery
from friction_hil.learning import thresholds as th
from friction_hil.learning.window import RECORDED
from friction_hil.numerics.jit import Array

_MEASURED = ("position", "torque")  # not known without feedback; all else is


class Gaps:
    """Fills the gaps of one axis's rows."""

    def __init__(self, rows_per_tick: int, period_s: float) -> None:
        self._size, self._period_s = rows_per_tick, period_s
        self._before: dict[str, Array] | None = None  # last row of the tick before, (1,) each
        self._recovered = 0.0  # first cycle that is not disturbed by earlier gaps

    def fill(self, rows: Mapping[str, Array], following: Mapping[str, Array]) -> dict[str, Array] | None:
        """Return all rows of a tick, `friction_hil.learning.window.COLUMNS`; None if too many are missing.

        ``rows``: those of one tick that there are, (k,) each: `RECORDED`, and ``is_fresh``. ``following``: the row
        after them, (0,) or (1,), if there is one yet.
        """
        before, cycle = self._before, rows["cycle"]
        if before is not None and cycle[0] - before["cycle"][0] > self._size:  # a tick was not taken
            before = None
        self._before = {name: values[-1:] for name, values in rows.items()}
        is_fresh = rows["is_fresh"] == 1.0
        missed = np.diff(cycle, prepend=cycle[:1] - 1.0 if before is None else before["cycle"]) - 1.0
        until = np.maximum.accumulate(cycle + recovery(missed, is_fresh, self._period_s))
        is_disturbed = cycle < np.maximum(until, self._recovered)
        self._recovered = max(self._recovered, float(until[-1]))

        wanted = cycle[0] // self._size * self._size + np.arange(self._size)
        is_there = np.isin(wanted, cycle)
        is_measured = np.isin(wanted, cycle[is_fresh])
        marked = np.ones(self._size)
        marked[is_there] = is_disturbed
        is_begun = is_measured[0] or (before is not None and before["is_fresh"][0] == 1.0)
        if not is_begun or np.mean(~is_measured) > th.MOST_FILLED or np.mean(marked) > th.MOST_DISTURBED:
            return None
        if is_measured.all():
            return {**{name: rows[name] for name in RECORDED}, "is_disturbed": marked}
        parts = [rows, following] if before is None else [before, rows, following]
        known = {name: np.concatenate([part[name] for part in parts]) for name in rows}
        # an axis follows its demand also meanwhile: the error changes less than the position
        known["position"] = known["position"] - known["position_demand"]
        fresh = known["is_fresh"] == 1.0
        found = {}
        for name in RECORDED:
            given = fresh if name in _MEASURED else np.ones_like(fresh)
            found[name] = np.interp(wanted, known["cycle"][given], known[name][given])
            found[name][is_measured] = rows[name][is_fresh]
        found["position"][~is_measured] += found["position_demand"][~is_measured]
        found["is_disturbed"] = marked
        return found
