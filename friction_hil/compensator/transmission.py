"""Position offset of the motor that keeps the load on the demanded path, across gap and twist of the transmission.

The encoder is at the motor. The load stays behind it by half the gap, on the side of contact, and by the twist, the
torque that the transmission carries over its stiffness. That torque is computed from the demand: weight, inertia and
friction of the load. Its sign is the side of contact. Where friction prevails, that is the direction of the demand; a
weight can hold the contact on one side, and a load that is braked harder than its friction brakes it goes over to the
other side before it stops.

The offset goes to its new value as fast as the drive can follow: in the shortest time within a velocity and an
acceleration, by the discrete time-optimal control of a double integrator (J. Han, "From PID to active disturbance
rejection control", IEEE Trans. Ind. Electron. 56, 2009). The gain of the compensation applies to the twist as well:
with half of the true stiffness, or twice the friction, the error of the load is then no larger than without the offset.

The friction of the load reaches the motor through that spring: after a reversal the motor feels it as the spring is
wound up, or over the presliding of the friction where that is softer, and that much of it is compensated.
"""

import math
from typing import Any

from friction_hil.compensator import load
from friction_hil.numerics.jit import inlined

HISTORY = 16  # cycles of the offset that are kept: the longest lead
_HEADROOM = 0.5  # of what the path leaves of the velocity limit


STATE = [
    ("side", "f8"),  # on which the transmission is in contact, -1, 0 or 1
    ("direction", "f8"),  # of the last demanded motion, -1, 0 or 1
    ("offset", "f8"),  # of the position, the newest
    ("velocity", "f8"),
    ("offsets", "f8", (HISTORY,)),  # newest first
    ("velocities", "f8", (HISTORY,)),
    ("offset_now", "f8"),  # of the drive's demand now
    ("velocity_now", "f8"),
    ("velocity_ahead", "f8"),  # when this cycle's torque acts
    ("offset_sent", "f8"),  # for the set-point of this cycle
    ("velocity_sent", "f8"),
    ("wound_up", "f8"),  # torque of the load's friction that the coupling transmits to the motor
]


@inlined
def _target(c: Any, r: Any, position: float, velocity: float, acceleration: float) -> float:
    """Return the offset at which the load is on its path.

    At rest, friction holds the load: the twist stays, and the side of contact where the rest of the torque is less.
    """
    driven = load.gravity(c, position)
    if math.isfinite(acceleration):
        driven += c.load_inertia * acceleration
    if velocity != 0.0:
        r.direction = math.copysign(1.0, velocity)
    carried = driven + r.direction * c.load_friction
    if carried != 0.0 and (velocity != 0.0 or abs(driven) > c.load_friction):
        r.side = math.copysign(1.0, carried)
    twist = min(c.gain_positive, 1.0) * c.compliance  # of a unit of torque, as much as is taken up
    offset = r.side * 0.5 * c.gap + twist * carried
    return float(min(max(offset, -c.offset_limit), c.offset_limit))


@inlined
def _advance(c: Any, r: Any, target: float, bound: float) -> None:
    """Move the offset by one period towards ``target``, at no more than the velocity ``bound``."""
    dt = c.period_s
    step = c.offset_acceleration * dt * dt
    drift = dt * r.velocity
    miss = r.offset - target + drift
    if abs(miss) > step:
        push = drift + math.copysign(0.5 * (math.sqrt(step * (step + 8.0 * abs(miss))) - step), miss)
    else:
        push = drift + miss
    wanted = r.velocity - c.offset_acceleration * dt * min(max(push / step, -1.0), 1.0)
    wanted = min(max(wanted, -bound), bound)
    change = c.offset_acceleration * dt
    r.offset = min(max(r.offset + drift, -c.offset_limit), c.offset_limit)
    r.velocity = min(max(wanted, r.velocity - change), r.velocity + change)


@inlined
def _at(values: Any, cycles: float) -> float:
    """Return the value ``cycles`` ago, on the line between samples; the oldest that is kept before that."""
    back = min(max(cycles, 0.0), HISTORY - 2.0)
    whole = int(back)
    part = back - whole
    return float((1.0 - part) * values[whole] + part * values[whole + 1])


@inlined
def follow(
    c: Any,
    r: Any,
    cycles: float,
    position: float,
    velocity: float,
    acceleration: float,
    has_demand: bool,
    fade: float,
) -> None:
    """Advance the offset by ``cycles`` and find those of the other moments.

    The demand is that of the load when this cycle's torque acts; without it the offset returns to zero. ``fade``: that
    of the compensation, 0 to 1.
    """
    target, bound = 0.0, c.offset_velocity
    if has_demand:
        target = fade * _target(c, r, position, velocity, acceleration)
        bound = min(bound, max(_HEADROOM * (c.velocity_limit - abs(velocity)), 0.0))
    for _ in range(min(int(cycles), HISTORY)):
        for k in range(HISTORY - 1, 0, -1):
            r.offsets[k], r.velocities[k] = r.offsets[k - 1], r.velocities[k - 1]
        _advance(c, r, target, bound)
        r.offsets[0], r.velocities[0] = r.offset, r.velocity
    # the newest offset is that of the set-point which is sent now, or of the torque, whichever acts later
    lead = c.lead_s / c.period_s
    newest = max(lead, c.setpoint_cycles)
    r.offset_now, r.velocity_now = _at(r.offsets, newest), _at(r.velocities, newest)
    r.velocity_ahead = _at(r.velocities, newest - lead)
    sent = newest - c.setpoint_cycles
    r.offset_sent, r.velocity_sent = _at(r.offsets, sent), _at(r.velocities, sent)


@inlined
def felt_at_motor(c: Any, r: Any, friction: float, velocity: float, dt: float) -> float:
    """Return the part of the friction that the motor feels, with that of the load behind the spring of the coupling.

    The load's part changes by no more than what the motor's travel winds the spring up by. Friction that the model
    itself lets grow more slowly, over its presliding, passes as it is. A gap is left out of this: on which side of it
    the load is, its inertia decides as well.

    ``friction``: torque of the model, of motor and load, N m. ``velocity``: of the motor. ``dt``: since the last, s.
    """
    if math.isfinite(friction):
        most = abs(velocity) * dt / c.compliance
        r.wound_up += min(max(c.load_share * friction - r.wound_up, -most), most)
    return float((1.0 - c.load_share) * friction + r.wound_up)
