"""The torque and slew limit. One function, called wherever a torque is bounded: here and in the daemon's loop."""

import math

from friction_hil.numerics.jit import inlined


@inlined
def limit_torque(wanted: float, previous: float, limit: float, largest_step: float) -> float:
    """Return the torque that is allowed in this cycle, N m.

    ``wanted`` counts as zero if it is not finite. ``previous``: torque of the last cycle. ``limit``: bound on the
    absolute torque. ``largest_step``: bound on the change since the last cycle, slew rate times elapsed time; infinity
    for none.
    """
    if not math.isfinite(wanted):
        wanted = 0.0
    wanted = min(max(wanted, -limit), limit)
    return min(max(wanted, previous - largest_step), previous + largest_step)
