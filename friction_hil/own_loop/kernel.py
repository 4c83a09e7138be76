"""One cycle of all joints, compiled: the compensator's own step for each, between the checks that the daemon makes.

Kernels call an element of `JOINT` ``j``, that of `LOOP` ``loop``.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from friction_hil.checked_yaml.section import MOST_ACCELERATION, MOST_POSITION, MOST_TORQUE, MOST_VELOCITY
from friction_hil.compensator.kernel import whole_step
from friction_hil.daemon import velocity_check
from friction_hil.daemon.fast_steps import MOST_FAST_CYCLES
from friction_hil.dynamics import torques
from friction_hil.numerics.jit import Array, StructuredArray, compiled_for_one_sample, inlined

BoolArray = NDArray[np.bool_]
IntegerArray = NDArray[np.int64]
_compare = inlined(velocity_check.take)

# what the caller gives for each joint; NaN where nothing is given
GIVEN = ("q", "dq", "tau", "q_des", "dq_des", "ddq_des", "load", "temperature", "fresh")
DQ, TAU, LOAD = GIVEN.index("dq"), GIVEN.index("tau"), GIVEN.index("load")

JOINT = np.dtype(
    [
        # limits as `SafetyLimits` has them, SI; infinity for none
        ("jump", "f8"),  # longest way in a period; a longer one is a glitch
        ("slack", "f8"),  # of that, for rounding
        ("velocity_limit", "f8"),
        ("position_low", "f8"),
        ("position_high", "f8"),
        ("following_error", "f8"),
        ("needs_velocity", "f8"),  # 1: the estimator is that of the drive's own velocity
        ("needs_torque", "f8"),
        ("baseline_s", "f8"),  # without compensation at the start
        # what changes
        ("is_wanted", "f8"),  # 1: fade in, 0: fade out
        ("is_changing", "f8"),  # 1: the former settings make the next step, too
        ("position", "f8"),  # the last that could be used; NaN before the first
        ("periods", "f8"),  # since then
        ("is_usable", "f8"),  # the feedback of this cycle
        ("has_jumped", "f8"),  # that is why it is not
        ("stale_cycles", "f8"),  # in a row without usable feedback
        ("fast_cycles", "f8"),  # in a row with an estimate beyond the velocity limit
        ("reported_cycles", "f8"),  # the same, of the velocity that is given
        ("position_demand", "f8"),  # of the last cycle, NaN for none
        ("velocity_demand", "f8"),
        ("temperature", "f8"),  # measured, deg C
        ("check", velocity_check.SETTINGS),  # of the velocity that is given against the position
        ("seen", velocity_check.STATE),
    ]
)
LOOP = np.dtype(
    [
        ("period_s", "f8"),
        ("most_stale", "f8"),  # cycles in a row without usable feedback that are bridged
        ("has_velocity", "f8"),  # 1: velocities are given in this cycle, and must be finite
        ("has_torque", "f8"),
        ("is_on", "f8"),  # 0: a fault or the caller has faded all joints out
        ("has_begun", "f8"),  # each joint has had a position
        ("cycle", "f8"),
        ("change", "f8"),  # number of the last change of settings
        ("rows", "f8"),  # recorded so far, with those that were dropped
        ("rows_between_states", "f8"),
    ]
)
# columns of a recorded row, behind the compensator's inputs
RESULTS = ("compensation", "velocity_estimate", "load_estimate", "temperature_estimate", "change")

NONE, MISSING, JUMPS, FAST, CONTRADICTS, OUTSIDE, FOLLOWING, NOT_FINITE = range(8)  # why the compensation fades out
WRONG_SHAPE = -1
REASONS = 8  # a fault is the number of its joint times this, and its reason


@inlined
def _within(value: float, most: float) -> float:
    """Return a value, NaN where it is larger than any that a configuration may have."""
    return value if abs(value) <= most else math.nan


@inlined
def demand(
    position: float,
    velocity: float,
    acceleration: float,
    position_before: float,
    velocity_before: float,
    elapsed_s: float,
    lead_s: float,
) -> tuple[float, float]:
    """Return the demanded velocity now and when this cycle's torque acts, from what is known of it; NaN for none.

    ``position_before``, ``velocity_before``: of the cycle before, ``elapsed_s`` ago.
    """
    now = velocity
    if math.isnan(now):
        now = _within((position - position_before) / elapsed_s, MOST_VELOCITY)
    slope = acceleration
    if math.isnan(slope):
        slope = _within((now - velocity_before) / elapsed_s, MOST_ACCELERATION)
    ahead = now
    if math.isfinite(slope):
        ahead = _within(now + lead_s * slope, MOST_VELOCITY)
    return now, ahead


@inlined
def _take(j: Any, loop: Any, position: float, velocity: float, torque: float, is_fresh: bool, passed: float) -> None:
    """Take one cycle's feedback as `Supervisor.take` does."""
    is_finite = is_fresh and math.isfinite(position)
    if loop.has_velocity > 0.0 or j.needs_velocity > 0.0:
        is_finite = is_finite and math.isfinite(velocity)
    if loop.has_torque > 0.0 or j.needs_torque > 0.0:
        is_finite = is_finite and math.isfinite(torque)
    j.periods += passed
    is_near = not math.isfinite(j.position) or abs(position - j.position) <= j.jump * j.periods + j.slack
    j.has_jumped = 1.0 if is_finite and not is_near else 0.0
    if is_finite and is_near:
        j.is_usable, j.position, j.periods, j.stale_cycles = 1.0, position, 0.0, 0.0
    else:
        j.is_usable = 0.0
        j.stale_cycles += 1.0


@inlined
def _fault(
    j: Any, loop: Any, velocity: float, reported: float, position_demand: float, is_faulty: float, passed: float
) -> int:
    """Return why the compensation of a joint must end, as `Supervisor.find_fault` judges; `NONE` if it need not."""
    verdict = velocity_check.NO_WINDOW
    if loop.has_velocity > 0.0:
        for _ in range(int(passed) - 1):
            _compare(j.check, j.seen, math.nan, math.nan, False)
        verdict = _compare(j.check, j.seen, j.position, reported, j.is_usable > 0.0)
    j.fast_cycles = 0.0 if abs(velocity) <= j.velocity_limit else j.fast_cycles + 1.0
    if j.is_usable > 0.0:
        j.reported_cycles = j.reported_cycles + 1.0 if abs(reported) > j.velocity_limit else 0.0
    if j.stale_cycles > loop.most_stale:
        return JUMPS if j.has_jumped > 0.0 else MISSING
    is_confirmed = j.is_usable > 0.0 and j.reported_cycles > 0.0
    if j.fast_cycles > 0.0 and (is_confirmed or not math.isfinite(velocity) or j.fast_cycles >= MOST_FAST_CYCLES):
        return FAST
    if j.reported_cycles >= MOST_FAST_CYCLES:
        return FAST
    if verdict == velocity_check.CONTRADICTS and j.seen.contradictions >= velocity_check.WINDOWS_TO_FAULT:
        return CONTRADICTS
    if not j.position_low <= j.position <= j.position_high:
        return OUTSIDE
    if math.isfinite(position_demand) and not abs(position_demand - j.position) <= j.following_error:
        return FOLLOWING
    return NOT_FINITE if is_faulty > 0.0 else NONE


@compiled_for_one_sample
def find_loads(
    settings: StructuredArray,
    state: StructuredArray,
    joints: StructuredArray,
    places: IntegerArray,
    links: StructuredArray,
    gravity: Array,
    work: Array,
    known: Array,
    found: Array,
    elapsed_s: float,
    q: Array,
    q_des: Array,
    dq_des: Array,
    ddq_des: Array,
    given: Array,
) -> bool:
    """Set the loads of the joints of an arm that are not given, (n,), before a `step`; False: for a wrong shape.

    A joint without a demand counts as at rest where it was in the cycle before.
    """
    n = len(places)
    for size in (q.size, q_des.size, dq_des.size, ddq_des.size, given.size):
        if size != n:
            return False
    for k in range(n):
        i, j, lead_s = places[k], joints[k], settings[k].lead_s
        if i < 0:
            continue
        position, acceleration = _within(q_des[k], MOST_POSITION), _within(ddq_des[k], MOST_ACCELERATION)
        velocity = _within(dq_des[k], MOST_VELOCITY)
        _, ahead = demand(position, velocity, acceleration, j.position_demand, j.velocity_demand, elapsed_s, lead_s)
        if math.isfinite(position) and math.isfinite(ahead):
            work[torques.Q, i], work[torques.DQ, i] = position + lead_s * ahead, ahead
            work[torques.DDQ, i] = acceleration if math.isfinite(acceleration) else 0.0
        else:
            moved = (lead_s + elapsed_s) * state[k].motion.velocity
            work[torques.Q, i] = j.position + moved if math.isfinite(j.position) else q[k]
            work[torques.DQ, i] = work[torques.DDQ, i] = 0.0
    torques.find_loads(links, gravity, work, known)
    for k in range(n):
        found[k] = _within(given[k], MOST_TORQUE)
        if places[k] >= 0 and not math.isfinite(found[k]):
            found[k] = work[torques.LOAD, places[k]]
    return True


@compiled_for_one_sample
def step(
    settings: StructuredArray,
    state: StructuredArray,
    joints: StructuredArray,
    loops: StructuredArray,
    out: Array,
    rows: Array,
    flat_state: Array,
    states: Array,
    passed: float,
    has_velocity: float,
    has_torque: float,
    q: Array,
    dq: Array,
    tau: Array,
    q_des: Array,
    dq_des: Array,
    ddq_des: Array,
    loads: Array,
    temperatures: Array,
    fresh: BoolArray,
) -> int:
    """Compute a cycle of n joints into ``out``, (n,); return the first fault, 0, or `WRONG_SHAPE`: nothing is done.

    ``settings``, ``state``: (2 n,), behind those of the joints the ones before a change, for one more step.
    ``rows``: (capacity, n, columns) of the recording, used round and round; ``states``: (places, n, width), copies of
    ``flat_state``, (2 n, width), the memory of ``state``. ``passed``: periods since the call before. ``q`` to
    ``fresh``: (n,), see `GIVEN`.
    """
    loop, n = loops[0], out.shape[0]
    for size in (q.size, dq.size, tau.size, q_des.size, dq_des.size, ddq_des.size, loads.size, temperatures.size):
        if size != n:
            return WRONG_SHAPE
    if fresh.size != n:
        return WRONG_SHAPE
    loop.has_velocity, loop.has_torque = has_velocity, has_torque
    for k in range(n):
        position, velocity, torque = q[k], _within(dq[k], MOST_VELOCITY), _within(tau[k], MOST_TORQUE)
        _take(joints[k], loop, _within(position, MOST_POSITION), velocity, torque, fresh[k], passed)
    if loop.has_begun > 0.0:
        loop.cycle += passed
    else:
        for k in range(n):
            if not math.isfinite(joints[k].position):
                out[:] = 0.0
                return 0
        loop.has_begun = 1.0
        for k in range(n):
            joints[k].stale_cycles = 1.0 - joints[k].is_usable
    capacity = rows.shape[0]
    place, slot = 0, -1
    if capacity > 0:
        place = int(loop.rows % capacity)
        if loop.rows % loop.rows_between_states == 0.0:
            slot = int((loop.rows // loop.rows_between_states) % states.shape[0])
    elapsed_s = passed * loop.period_s
    first_fault = 0
    for k in range(n):
        j, c, r = joints[k], settings[k], state[k]
        is_fresh = j.is_usable
        reported = _within(dq[k], MOST_VELOCITY)
        velocity = reported if is_fresh > 0.0 else r.motion.velocity
        torque = _within(tau[k], MOST_TORQUE)
        position_demand = _within(q_des[k], MOST_POSITION)
        velocity_demand = _within(dq_des[k], MOST_VELOCITY)
        acceleration = _within(ddq_des[k], MOST_ACCELERATION)
        load, temperature = _within(loads[k], MOST_TORQUE), temperatures[k]
        velocity_demand, ahead = demand(
            position_demand, velocity_demand, acceleration, j.position_demand, j.velocity_demand, elapsed_s, c.lead_s
        )
        j.position_demand, j.velocity_demand, j.temperature = position_demand, velocity_demand, temperature
        is_due = loop.cycle * loop.period_s >= j.baseline_s
        is_enabled = 1.0 if loop.is_on > 0.0 and j.is_wanted > 0.0 and is_due else 0.0
        if j.is_changing > 0.0:
            j.is_changing = 0.0
            r.bridge.fixed = whole_step(
                settings[n + k : n + k + 1],
                state[n + k : n + k + 1],
                loop.cycle,
                j.position,
                velocity,
                torque,
                position_demand,
                velocity_demand,
                ahead,
                is_fresh,
                is_enabled,
                acceleration,
                temperature,
                load,
            )
        if slot >= 0:
            states[slot, k, :] = flat_state[k, :]
        out[k] = whole_step(
            settings[k : k + 1],
            state[k : k + 1],
            loop.cycle,
            j.position,
            velocity,
            torque,
            position_demand,
            velocity_demand,
            ahead,
            is_fresh,
            is_enabled,
            acceleration,
            temperature,
            load,
        )
        fault = _fault(j, loop, r.motion.velocity, reported, position_demand, r.is_faulty, passed)
        if fault > 0 and first_fault == 0:
            first_fault = k * REASONS + fault
        if capacity > 0:
            row = rows[place, k]
            row[0], row[1], row[2], row[3] = loop.cycle, j.position, velocity, torque
            row[4], row[5], row[6] = position_demand, velocity_demand, ahead
            row[7], row[8], row[9], row[10], row[11] = is_fresh, is_enabled, acceleration, temperature, load
            row[12], row[13], row[14] = out[k], r.motion.velocity, r.load_torque
            row[15], row[16] = r.temperature.given, loop.change
    if capacity > 0:
        loop.rows += 1.0
    return first_fault
