"""Velocity offset by which a drive that takes no torque gives the compensation with its own velocity loop.

The offset v is added to the demand of that loop (60B1h). With the gain k and the corner w of the integral part it makes
the torque k (v + I), dI/dt = w v, whatever the other loops do. So v = tau / k - I gives the torque tau: a step of tau
is a step of v that vanishes with the time constant 1 / w, because the integral part learns what is held.

I is what the offsets that were sent have left in the integral part. So what limit or slew cut is made up for later. The
torque of a period is its mean.

A drive that takes nothing but positions gets the offset by its set-point, which is shifted by p: its position loop and
its feed-forward of the set-point's velocity and acceleration make v = Kp p + Kv p' + (Ja / k) p'' of it.
"""

import math

import numpy as np

from friction_hil.compensator.limiter import limit_torque
from friction_hil.errors import UsageError
from friction_hil.numerics.jit import Array, StructuredArray, compiled, ready

SETTINGS = np.dtype(
    [
        ("period_s", "f8"),  # of the loop
        ("gain", "f8"),  # of the drive's velocity loop, N m s/rad
        ("corner", "f8"),  # angular frequency of its integral part, 1/s
        ("limit", "f8"),  # bound on the absolute offset, rad/s; the same as that of `slew` per second
        ("slew", "f8"),
        ("forget_s", "f8"),  # in which the integral is forgotten without compensation
    ]
)
STATE = np.dtype(
    [
        ("cycle", "f8"),  # of the last step; negative before the first
        ("sent", "f8"),  # offset of that cycle, rad/s
        ("integral", "f8"),  # rad/s
    ]
)


@compiled
def step(settings: StructuredArray, state: StructuredArray, cycle: float, torque: float) -> float:
    """Return the offset for ``torque``, N m, of the compensation in a cycle, rad/s or m/s."""
    c, r = settings[0], state[0]
    dt = c.period_s * (max(cycle - r.cycle, 0.0) if r.cycle >= 0.0 else 1.0)
    r.cycle = cycle
    r.integral += c.corner * dt * r.sent
    if torque == 0.0:  # the drive may have been without power since, its integral part at zero
        r.integral -= min(dt / c.forget_s, 1.0) * r.integral
    wanted = (torque / c.gain - r.integral) / (1.0 + 0.5 * c.corner * c.period_s)
    r.sent = limit_torque(wanted, r.sent, c.limit, c.slew * dt)
    return float(r.sent)


@compiled
def _replay(settings: StructuredArray, state: StructuredArray, cycle: Array, torque: Array, offset: Array) -> None:
    for k in range(cycle.shape[0]):
        offset[k] = step(settings, state, cycle[k], torque[k])


SHIFT = np.dtype(
    [
        ("period_s", "f8"),  # of the loop
        ("position_gain", "f8"),  # of the drive's position loop, 1/s; 0: the drive takes the velocity offset itself
        ("velocity_feedforward", "f8"),  # gain of its feed-forward of the set-point's velocity
        ("acceleration_s", "f8"),  # of its acceleration: torque over acceleration, over the gain of the velocity loop
        ("position", "f8"),  # of the last period, rad; and its rate, rad/s
        ("rate", "f8"),
    ]
)


@compiled
def shifted(shift: StructuredArray, velocity: float) -> float:
    """Return the shift of the set-point of a period that makes a velocity offset, rad or m."""
    s = shift[0]
    late = s.acceleration_s / s.period_s
    resisting = s.position_gain * s.period_s + s.velocity_feedforward + late
    s.rate = (velocity - s.position_gain * s.position + late * s.rate) / resisting
    s.position += s.period_s * s.rate
    return float(s.position)


class SetpointShift:
    """Shift of the position set-point of one axis that makes its velocity offset.

    ``position_gain``: of the drive's position loop, 1/s. ``velocity_feedforward``, ``inertia``: of its feed-forward of
    the set-point, kg m^2. ``velocity_gain``: as for `VelocityOffset`. Raises `UsageError`: a value is out of range.
    """

    __slots__ = ("_step", "record")

    def __init__(
        self,
        period_s: float,
        velocity_gain: float,
        position_gain: float,
        velocity_feedforward: float = 1.0,
        inertia: float = 0.0,
    ) -> None:
        if not 0.0 < position_gain < math.inf:
            raise UsageError(f"position_gain = {position_gain:g} must be finite and above zero")
        for name, value in {"velocity_feedforward": velocity_feedforward, "inertia": inertia}.items():
            if not 0.0 <= value < math.inf:
                raise UsageError(f"{name} = {value:g} must be finite, zero or above")
        self.record = np.array(
            [(period_s, position_gain, velocity_feedforward, inertia / velocity_gain, 0.0, 0.0)], SHIFT
        )
        self._step = shifted

    def next(self, velocity: float) -> float:
        """Return the shift of this period for a velocity offset, rad/s, as it is after limit and slew."""
        return self._step(self.record, velocity)

    def clear(self) -> None:
        """Begin at no shift."""
        self.record["position"] = self.record["rate"] = 0.0

    def compile(self) -> None:
        """Compile `next`."""
        self._step = ready(shifted)
        self.next(0.0)
        self.clear()


class VelocityOffset:
    """Velocity offset of one axis.

    ``velocity_gain``: of the drive's velocity loop, N m s/rad; ``integral_hz``: corner frequency of its integral part.
    ``limit``, ``slew``: bounds on the offset and its rate, SI. Raises `UsageError`: a value is out of range.
    """

    __slots__ = ("_step", "limit", "record", "slew", "state_record")

    def __init__(
        self, period_s: float, velocity_gain: float, integral_hz: float, limit: float, slew: float, forget_s: float
    ) -> None:
        given = {"velocity_gain": velocity_gain, "limit": limit, "slew": slew, "forget_s": forget_s}
        for name, value in given.items():
            if not 0.0 < value < math.inf:
                raise UsageError(f"{name} = {value:g} must be finite and above zero")
        if not 0.0 <= integral_hz < math.inf:
            raise UsageError(f"integral_hz = {integral_hz:g} must be finite, zero or above")
        self.limit, self.slew = limit, slew
        self.record = np.array([(period_s, velocity_gain, math.tau * integral_hz, limit, slew, forget_s)], SETTINGS)
        self.state_record = np.array([(-1.0, 0.0, 0.0)], STATE)
        self._step = step

    @property
    def state(self) -> Array:
        """Whole state as a flat array, a live view, as that of the compensator."""
        state: Array = self.state_record.view(np.float64)
        return state

    def step(self, cycle: float, torque: float) -> float:
        """Return the offset for the compensation of a cycle, N m; a cycle that is missed leaves a gap in ``cycle``."""
        return self._step(self.record, self.state_record, cycle, torque)

    def compile(self) -> None:
        """Compile `step`; the state stays as it is."""
        self._step = ready(step)
        state = self.state.copy()
        self.step(0.0, 0.0)
        self.state[:] = state

    def replay(self, cycle: Array, torque: Array) -> Array:
        """Return the offsets of many cycles, (n,) as both arguments."""
        offset = np.empty(cycle.size)
        _replay(self.record, self.state_record, cycle, torque, offset)
        return offset
