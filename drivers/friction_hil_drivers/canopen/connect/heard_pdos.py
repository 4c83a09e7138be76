"""What is heard on a bus beside the SYNC of another master: which frames, how often, how long. No bus, no clock."""

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from statistics import fmean, median

from friction_hil.errors import DriveError
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.connect.twins import FIX

_LEAST = 20  # frames from which on anything is said of their rhythm
_DOUBLE = 0.42  # share of frames that no SYNC precedes; a half where two nodes answer, a third where half are doubled
_PERIOD_TOLERANCE = 0.03


class HeardPdos:
    """Frames between SYNCs."""

    def __init__(self, sync_id: int) -> None:
        self._sync_id = sync_id
        self.stamps: list[int] = []  # times of the SYNCs, ns
        self.sizes: dict[int, Counter[int]] = {}  # number of frames of each length, by identifier
        self._steps: dict[int, Counter[int]] = {}  # SYNCs since the frame before, by identifier
        self._last: dict[int, int] = {}  # number of SYNCs when it came last

    def take(self, can_id: int, size: int, now_ns: int) -> None:
        """Take a frame."""
        self.sizes.setdefault(can_id, Counter())[size] += 1
        if can_id == self._sync_id:
            self.stamps.append(now_ns)
            return
        count = len(self.stamps)
        if can_id in self._last:
            self._steps.setdefault(can_id, Counter())[count - self._last[can_id]] += 1
        self._last[can_id] = count

    def require_one_sender(self, can_id: int, axis: str, node: int) -> None:
        """Raise a `DriveError` if a TPDO of node ``node`` comes twice with each SYNC."""
        steps = self._steps.get(can_id, Counter())
        if steps.total() >= _LEAST and steps[0] >= _DOUBLE * steps.total():
            text = (
                f"{axis}: {can_id:03X}h comes twice with each SYNC: two nodes have the number {node}, or an adapter or "
                "gateway repeats its frames"
            )
            raise DriveError(text, FIX, codes.TWO_NODES)

    def syncs_between(self, can_id: int) -> int:
        """Return with every how many SYNCs a frame comes, 1 where that is not known."""
        steps = self._steps.get(can_id, Counter())
        return max(1, int(median(steps.elements()))) if steps.total() >= _LEAST else 1

    def wrong_period(self, period_s: float) -> str:
        """Return how SYNC differs from the period ``period_s``, "" where it does not, or too few came."""
        intervals = [after - before for before, after in pairwise(self.stamps)]
        return wrong_period(intervals, period_s) if len(intervals) >= _LEAST else ""


def wrong_period(intervals_ns: Sequence[int], period_s: float) -> str:
    """Return how the time between SYNCs differs from the period ``period_s``, "" where it does not.

    Mean and median must differ: SYNCs that are lost change the mean alone, a busy computer the median alone.
    """
    both_s = 1e-9 * fmean(intervals_ns), 1e-9 * median(intervals_ns)
    is_longer, is_shorter = (
        all(sign * (value / period_s - 1.0) > _PERIOD_TOLERANCE for value in both_s) for sign in (1.0, -1.0)
    )
    if not (is_longer or is_shorter):
        return ""
    return f"comes every {1e3 * both_s[0]:.4g} ms and not every {1e3 * period_s:.4g} ms (period_s)"
