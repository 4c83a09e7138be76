"""Numbers of the checks at the beginning of a motion: value, unit, and what each is chosen for.

What they bring about is held by tests: ``test_first_motion``, ``test_follow_check`` and ``test_coupled_drives`` below
``tests/unit/daemon``, ``test_canopen_first_motion`` and ``test_velocity_trust`` below ``tests/unit/canopen``. They try
units, lags, loads, friction and periods over ranges, not single values.
"""


class First:
    """Of `friction_hil.daemon.first_motion`."""

    TAU_S = 0.1  # s: the target grows by e in it
    REST_S = 0.1  # s: without motion, before the target grows
    LONGEST_REST_S = 1.0  # s: a load that is still sinking then is no reason to wait on
    SETTLE_S = 0.06  # s: at the held target, before the comparison: loops of 30 ms
    WINDOW_S = 0.1  # s: of the comparison
    STUCK_S = 1.5  # s: at the largest target: friction may need that long to be overcome
    LONGEST_RETURN_S = 2.0  # s: an axis that does not follow back stays where it is
    SHORTEST_CYCLES = 10  # cycles: for each of these times, at long periods

    BOUND_S = 5e-3  # s: bound of the motion, as the way at the velocity limit in this time,
    BOUND_SPAN = 0.01  # 1: or this part of the range between the position limits
    PARTS = 8.0  # 1: the bound is so many times the distance d
    LEAST_STEPS = 12.0  # steps of the position: in d
    FASTEST = 3.0  # 1: largest target, times d / tau
    TOLERANCE = 0.3  # 1: of the velocity: slip-stick, filters, drives that settle slowly
    OVERSHOOT, REPEATS = 2.5, 3  # 1, windows: an axis that broke loose may overshoot; then the window is repeated
    STANDING = 0.05  # 1: part of the target; slower does not count as motion
    RESTING = 0.25  # 1: part of d; less does not count as motion while the axis rests
    LIKENESS = 0.12  # 1: tolerated relative error of a guess of the unit


class Follow:
    """Of `friction_hil.daemon.follow_check`."""

    PATH_PART = 0.5  # 1: of the path, or
    ERROR_PART = 0.8  # 1: of limits.following_error, that the demand covers before an axis is called standing
    LEAST_STEPS = 100.0  # steps of the position: in that distance
    MOVED = 0.05  # 1: part of the demand's range that counts as motion
    PATIENCE_S = 0.3  # s: after the demand has covered the distance
    PATIENCE_CYCLES = 20  # cycles: the same, at long periods

    FOLLOWED = 0.1  # 1: part of the path after which the axis counts as following,
    FOLLOWED_DISTANCE = 0.25  # 1: or part of the distance above, if that is more,
    FOLLOWED_ERROR = 0.5  # 1: if its error is less than this part of what it has moved
    RUNAWAY_S = 5e-3  # s: largest distance of a runaway, times the velocity limit
    DOUBLINGS = 3  # of the distance, up to that one
    GROWTH = 2.7  # 1: of v^2 when the distance doubles: 4 with the wrong sign, 2 under a constant load
    LEAST_RUNAWAY_STEPS = 80.0  # steps of the position: in the distance of a runaway


class Trust:
    """Of `friction_hil.daemon.velocity_trust`."""

    WINDOW_S, FEWEST_CYCLES, LEAST_STEPS = 0.02, 10, 12.0  # s, cycles, steps of the position: of a comparison, at least
    LONGEST_S = 1.0  # s: of a comparison; in a longer one, offsets would count
    TOLERANCE = 0.3  # 1: of displacement or integral: filters, slip-stick
    LAG_S = 0.01  # s: tolerated delay between the two
    ROUNDING_STEPS = 4.0  # steps of the position: tolerated
    CLEAR = 0.5  # 1: tolerance, as part of the displacement, above which a comparison shows nothing
    CONTRADICTIONS = 5  # in a row, before it is told
    RISE_S = 0.1  # s: of the first torque, from none to all
    MOVED_S, MOVED_STEPS = 1e-3, 4.0  # s, steps: motion is the way at the velocity limit in this time, or these steps
    AGAINST_S = 1e-4  # s: the same, against the torque: a load that falls needs all of it at once
    HELD_S = 0.03  # s: without such a motion, until the torque rises on
