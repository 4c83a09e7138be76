"""The transition after a change of settings or model while the axis moves: no step of torque.

The first torque after a change is that of the former settings for the same cycle, so that a reversal in that very
cycle is no part of the difference. The difference d from the torque that the new settings ask for then vanishes over
the fade-in time. It is split by how far friction is developed in one direction, s = F / (level / 2) between -1 and 1,
into a part that changes sign with the friction and one that does not: d = (d s) s + d (1 - s^2). An axis that reverses
meanwhile thus gets a torque between those of old and new settings, and not a remainder that pushes it.

While the axis reverses, two models differ by far more than they do later: one builds its torque up sooner. A difference
that is found then, or between torques of opposite directions, one of which has reversed already, vanishes within 10 ms.
"""

import math
from typing import Any

from friction_hil.numerics.jit import inlined

STATE = [
    ("left", "f8"),  # of the difference at a change of settings, 1 to 0
    ("directed", "f8"),  # part of that difference which changes sign with the friction
    ("fixed", "f8"),  # part which does not; in the first cycle, the torque of the former settings
]
_REVERSING_S = 0.01
_CALM_S = 0.1  # a torque that changes by the friction level within less belongs to a reversal
BEGINNING = 2.0  # value of ``left`` that a change sets


@inlined
def cross(c: Any, r: Any, last: float, friction: float, wanted: float, dt: float) -> float:
    """Return the torque of this cycle, N m: ``wanted`` and what is left of the difference at the last change.

    ``last``: torque of the last cycle; ``friction``: of the model; ``wanted``: the same with gain and fades, N m.
    ``dt``: since the last cycle, s.
    """
    if r.left <= 0.0 or not math.isfinite(wanted):
        return wanted
    developed = min(max(2.0 * friction / c.level, -1.0), 1.0) if c.level > 0.0 else 0.0
    if r.left > 1.0:
        difference = r.fixed - wanted  # until now, it was the torque of the former settings
        is_reversing = abs(r.fixed - last) * _CALM_S > c.level * dt or r.fixed * wanted < 0.0
        r.left = min(_REVERSING_S / c.fade_s, 1.0) if is_reversing else 1.0
        difference /= r.left
        r.directed = difference * developed
        r.fixed = difference * (1.0 - developed * developed)
    else:
        r.left = max(r.left - dt / c.fade_s, 0.0)
    return float(wanted + r.left * (r.directed * developed + r.fixed))
