"""The torque and slew limit. One function, called wherever a torque is bounded: here and in the daemon's loop."""

import math

from friction_hil.numerics.jit import inlined


@inlined
def limit_torque(wanted: float, previous: float, limit: float, largest_step: float) -> float:
    """Return the torque that is allowed in this cycle, N m.

    Parameters
    ----------
    wanted : float
        Torque asked for; a value that is not finite counts as zero.
    previous : float
        Torque of the last cycle.
    limit : float
        Bound on the absolute torque.
    largest_step : float
        Bound on the change since the last cycle, slew rate times elapsed time; infinity for none.
    """
    if not math.isfinite(wanted):
        wanted = 0.0
    wanted = min(max(wanted, -limit), limit)
    return min(max(wanted, previous - largest_step), previous + largest_step)
