"""Armstrong's seven-parameter model: frictional lag, rising static friction, and a spring while the axis sticks."""

from friction_hil.friction.curves import modified, sliding
from friction_hil.friction.elementary import buffer, whole
from friction_hil.friction.family import Family
from friction_hil.friction.parameters import COULOMB, STRIBECK_VELOCITY, VISCOUS, Parameter
from friction_hil.numerics.jit import Array, inlined

HISTORY = 32  # past velocities stored for the lag: every sample if they cover the lag, otherwise every few samples
_SLIDING, _DEFLECTION, _DWELL, _RISEN, _BREAK_AWAY, _NEWEST = range(6)
_LENGTHS, _VELOCITIES = 6, 6 + HISTORY
STATES = 6 + 2 * HISTORY
_RING = HISTORY - 1  # mask of a ring index: HISTORY is a power of two
_BLOCK = 64 * HISTORY  # samples that `run` processes at a time; longer blocks reduce the cost of the ring

_STATIC_RELEASED = Parameter(
    "static_released", "Fs_a", "N m", "break-away level just after motion", is_lower_allowed=False
)
_STATIC_RESTED = Parameter("static_rested", "Fs_inf", "N m", "break-away level after long rest", is_lower_allowed=False)
_LAG = Parameter("lag_s", "tL", "s", "delay of the friction behind the velocity")
_RISE = Parameter(
    "rise_s",
    "gamma",
    "s",
    "time at rest after which half of the rise to static_rested is reached",
    is_lower_allowed=False,
)
_STIFFNESS = Parameter("stiffness", "kt", "N m/rad", "stiffness while the axis sticks", is_lower_allowed=False)


@inlined
def _is_far_enough(length: float, lag: float) -> bool:
    """Return True if recorded velocities that are ``length`` seconds apart cover the ``lag``."""
    return length * (HISTORY - 3) >= lag


@inlined
def _record(s: Array, velocity: float, dt: float, lag: float) -> int:
    """Record ``velocity`` in the ring of ``s``, with the time since the previous one; return its ring index.

    The ring stores every sample if it then covers the lag. Otherwise the newest entry is overwritten until it is far
    enough from the previous one.
    """
    newest = whole(s[_NEWEST]) & _RING
    length = s[_LENGTHS + newest]
    if _is_far_enough(length, lag):
        newest = (newest + 1) & _RING
        s[_NEWEST] = newest
        s[_LENGTHS + newest] = dt
    else:
        s[_LENGTHS + newest] = length + dt
    s[_VELOCITIES + newest] = velocity
    return newest


@inlined
def _past(s: Array, newest: int, lag: float) -> tuple[int, float]:
    """Locate the time ``lag`` seconds ago in the ring; the oldest entry is the limit.

    Returns the number of entries back from ``newest``, and the fraction of the step from that entry to the one before
    it. The times are added up from the newest entry on, so that every sample has the same bits with a constant ``dt``.
    The loop has a single exit because the compiler generates slow code for more.
    """
    back, left = 0, lag
    length = s[_LENGTHS + newest]
    while left >= length and back < HISTORY - 2:
        left = left - length
        back += 1
        length = s[_LENGTHS + ((newest - back) & _RING)]
    return back, left / length if left < length else 1.0 + 0.0 * left


@inlined
def _between(later: float, earlier: float, fraction: float) -> float:
    """Interpolate from the velocity ``later`` back to ``earlier``."""
    return later + fraction * (earlier - later)


@inlined
def _lagging_velocity(s: Array, velocity: float, dt: float, lag: float) -> float:
    """Record ``velocity`` and return the velocity ``lag`` seconds ago, by linear interpolation; 0 before the start."""
    newest = _record(s, velocity, dt, lag)
    back, fraction = _past(s, newest, lag)
    later = (newest - back) & _RING
    earlier = (later - 1) & _RING
    return _between(s[_VELOCITIES + later], s[_VELOCITIES + earlier], fraction)


@inlined
def _fall(p: Array, velocity: float) -> float:
    """Compute the fraction of the level's rise above Coulomb that remains at ``velocity``."""
    ratio = velocity * (1.0 / p[4])
    return 1.0 / (1.0 + ratio * ratio)


@inlined
def _level(p: Array, static: float, fall: float) -> float:
    return p[0] + (static - p[0]) * fall


@inlined
def _torque(
    p: Array,
    s: Array,
    velocity: float,
    level_velocity: float,
    fall: float,
    dt: float,
    extra: float,
    scale: float,
) -> float:
    """Compute the torque of one sample from its `_fall`; advance the state except the ring."""
    if velocity * s[_SLIDING] <= 0.0:
        released = p[2]
        if s[_SLIDING] != 0.0:
            reached = _level(p, s[_BREAK_AWAY], fall)
            above = reached - released
            s[_RISEN] = above if above > 0.0 else 0.0 * above
            s[_DEFLECTION] = modified(reached, extra, scale) * s[_SLIDING] / p[7]
            s[_SLIDING] = 0.0
            s[_DWELL] = 0.0
        s[_DEFLECTION] = s[_DEFLECTION] + velocity * dt
        s[_DWELL] = s[_DWELL] + dt
        start = released + s[_RISEN]
        static = start + (p[3] - start) * s[_DWELL] / (s[_DWELL] + p[6])
        spring = p[7] * s[_DEFLECTION]
        if abs(spring) <= modified(static, extra, scale):
            return spring
        s[_SLIDING] = 1.0 if spring > 0.0 else -1.0
        s[_BREAK_AWAY] = static
    return modified(_level(p, s[_BREAK_AWAY], fall), extra, scale) * s[_SLIDING] + p[1] * level_velocity


@inlined
def step(
    p: Array,
    s: Array,
    velocity: float,
    level_velocity: float,
    dt: float,
    extra: float,
    scale: float,
    applied_torque: float,
    epsilon: float,
) -> float:
    """Compute the torque of one sample; see `friction_hil.friction.kernel`.

    While the axis sticks (also at the start), the torque is that of a spring, until it reaches the break-away level.
    The spring starts with the torque of the slip that has ended. If it started with zero torque, the axis would
    oscillate on it and break away again at once, and there would be no stick-slip. The break-away level rises with
    the time at rest, from the level at which the last slip ended, or from ``static_released`` if that is higher.
    """
    fall = _fall(p, _lagging_velocity(s, level_velocity, dt, p[5]))
    return _torque(p, s, velocity, level_velocity, fall, dt, extra, scale)


@inlined
def run(p: Array, s: Array, velocity: Array, dt: float, applied_torque: float, torque: Array) -> bool:
    """Fill ``torque`` for every sample, with the same bits as `step`.

    If the ring stores every sample, the lagging velocity is an element of ``velocity`` at a fixed distance. Then only
    the last `HISTORY` samples of a block have to be recorded; the block length is a multiple of the ring length.
    """
    lag = p[5]
    fall = buffer(p, _BLOCK)
    for begin in range(0, velocity.shape[0], _BLOCK):
        v = velocity[begin : begin + _BLOCK]
        if begin > 0 and v.shape[0] == _BLOCK and _is_far_enough(dt, lag):
            back, fraction = _past(s, whole(s[_NEWEST]) & _RING, lag)
            later, earlier = velocity[begin - back :], velocity[begin - back - 1 :]
            for k in range(_BLOCK):
                fall[k] = _fall(p, _between(later[k], earlier[k], fraction))
            for k in range(_BLOCK - HISTORY, _BLOCK):
                _record(s, v[k], dt, lag)
        else:
            for k in range(v.shape[0]):
                fall[k] = _fall(p, _lagging_velocity(s, v[k], dt, lag))
        for k in range(v.shape[0]):
            torque[begin + k] = _torque(p, s, v[k], v[k], fall[k], dt, 0.0, 1.0)
    return False  # the velocities have not been checked


@inlined
def steady(p: Array, velocity: float, extra: float, scale: float) -> float:
    """Compute the torque at constant ``velocity``, with the break-away level just after motion; 0 at rest."""
    return sliding(modified(_level(p, p[2], _fall(p, velocity)), extra, scale), p[1], velocity, velocity, 0.0)


FAMILY = Family(
    name="armstrong",
    summary="seven parameters: frictional lag and a break-away level that rises with the time at rest",
    formula=(
        "sliding: F = [Fc + (Fs(t2) - Fc) / (1 + (v(t - tL)/vs)^2)] sgn v + Fv v;  "
        "sticking: F = kt x, x starting at the torque of the last slip over kt, until |F| = Fs(t2);  "
        "Fs(t2) = Fs_a + (Fs_inf - Fs_a) t2 / (t2 + gamma), t2 the time at rest"
    ),
    source="Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30(7), 1994",
    parameters=(
        COULOMB,
        VISCOUS,
        _STATIC_RELEASED,
        _STATIC_RESTED,
        STRIBECK_VELOCITY,
        _LAG,
        _RISE,
        _STIFFNESS,
    ),
    states=(
        "direction of sliding, 0 while sticking",
        "deflection x [rad]",
        "time at rest t2 [s]",
        "Fs_a above static_released [N m]",
        "Fs at the last break-away [N m]",
        "past velocities [rad/s] and the times between them [s]",
    ),
    example={
        "coulomb": 0.08,
        "viscous": 2e-3,
        "static_released": 0.1,
        "static_rested": 0.13,
        "stribeck_velocity": 0.2,
        "lag_s": 0.005,
        "rise_s": 1.0,
        "stiffness": 2000.0,
    },
    level=lambda p: max(p["coulomb"], p["static_released"], p["static_rested"]),
    note=(
        "the source does not define the initial values of Fs_a and x at the end of a slip; here Fs_a is the level at "
        "which the slip ended, at least static_released, and x gives the torque of that moment"
    ),
)
