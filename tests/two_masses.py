"""A simulated axis of two masses: motor and load, coupled by a spring with a gap, with Coulomb friction on either side.

In plain Python and by no code of friction_hil: a witness for what the compensator does to the load.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

PERIOD_S = 1e-3
SAMPLES, STEPS = 8, 4  # samples of the drive in a period, steps of integration in a sample
DT = PERIOD_S / SAMPLES / STEPS
Motion = Callable[[float], tuple[float, float, float]]


@dataclass
class Side:
    """Motor or load: inertia, Coulomb friction, and motion."""

    inertia: float
    friction: float = 0.0
    position: float = 0.0
    velocity: float = 0.0

    def push(self, torque: float, extra: float = 0.0) -> None:
        """Advance by a step; friction stops the mass, and holds it up to its own size."""
        level = self.friction + extra
        moving = self.velocity if self.velocity != 0.0 else torque
        if self.velocity == 0.0 and abs(torque) <= level:
            return
        velocity = self.velocity + DT * (torque - math.copysign(level, moving)) / self.inertia
        self.velocity = 0.0 if velocity * self.velocity < 0.0 and abs(torque) <= level else velocity
        self.position += DT * self.velocity


@dataclass
class TwoMasses:
    """The axis with its drive: position P over velocity PI on the motor's encoder, with feed-forward."""

    motor: Side = field(default_factory=lambda: Side(1e-4, 0.02))
    load: Side = field(default_factory=lambda: Side(1e-4, 0.02))
    stiffness: float = 200.0
    damping: float = 0.02
    gap: float = 0.0
    weight: Callable[[float], float] = lambda position: 0.0  # torque against positive motion
    per_load: float = 0.0  # friction of the motor's side per torque that the transmission carries
    position_gain: float = 100.0
    velocity_gain: float = 0.1
    integral_hz: float = 10.0
    resolution: float = 2.0 * math.pi / 2**20
    integral: float = 0.0
    torque: float = 0.0

    def coupling(self) -> float:
        """Torque from motor to load; faces push, and never pull."""
        twist, rate = self.motor.position - self.load.position, self.motor.velocity - self.load.velocity
        if self.gap == 0.0:
            return self.stiffness * twist + self.damping * rate
        pressed = abs(twist) - 0.5 * self.gap
        if pressed <= 0.0:
            return 0.0
        push = self.stiffness * pressed + math.copysign(self.damping * rate, twist * rate)
        return math.copysign(max(push, 0.0), twist)

    def measured(self) -> float:
        """Position by the encoder at the motor."""
        return math.floor(self.motor.position / self.resolution) * self.resolution

    def period(self, demand: tuple[float, float, float], rate: tuple[float, float, float], feedforward: float) -> None:
        """Advance by a period; the demand moves on by ``rate``, its own change in a period."""
        dt = PERIOD_S / SAMPLES
        inertia = self.motor.inertia + self.load.inertia
        for sample in range(SAMPLES):
            part = sample / SAMPLES
            position, velocity, acceleration = (now + part * change for now, change in zip(demand, rate, strict=True))
            error = self.position_gain * (position - self.measured()) + velocity - self.motor.velocity
            self.integral += 2.0 * math.pi * self.integral_hz * dt * error
            command = self.velocity_gain * (error + self.integral) + inertia * acceleration + feedforward
            for _ in range(STEPS):
                self.torque += DT / 3e-4 * (command - self.torque)
                carried = self.coupling()
                self.motor.push(self.torque - carried, self.per_load * abs(carried))
                self.load.push(carried - self.weight(self.load.position))


def sine(amplitude: float, frequency: float) -> Motion:
    """Motion that begins at rest at zero, amplitude (1 - cos 2 pi f t)."""
    w = 2.0 * math.pi * frequency
    return lambda t: (
        amplitude * (1.0 - math.cos(w * t)),
        amplitude * w * math.sin(w * t),
        amplitude * w * w * math.cos(w * t),
    )


def follow(axis, one, motion, duration_s, *, enabled_from_s=0.0, **inputs):
    """Run an axis with a compensator, as the daemon does in csp with a delay of one cycle.

    Returns
    -------
    dict of (n,) arrays
        time, demand, motor and load position, load velocity, compensation, offset.
    """
    rows = []
    acting = 0.0
    lead_s = one.settings.lead_s
    for k in range(round(duration_s / PERIOD_S)):
        t = k * PERIOD_S
        now, ahead = motion(t), motion(t + lead_s)
        rows.append((t, now[0], axis.motor.position, axis.load.position, axis.load.velocity, acting))
        feedforward, drive = acting, (axis.measured(), axis.motor.velocity, axis.torque)
        demand = (now[0], now[1], ahead[1])
        acting = one.step(float(k), *drive, *demand, True, t >= enabled_from_s, ahead[2], **inputs)
        offset, rate = one.offset_now
        later = motion(t + PERIOD_S)
        shifted = (now[0] + offset, now[1] + rate, now[2])
        moved = (later[0] - now[0] + PERIOD_S * rate, later[1] - now[1], later[2] - now[2])
        rows[-1] += (offset,)
        axis.period(shifted, moved, feedforward)
    names = ("time", "demand", "motor", "load", "load_velocity", "compensation", "offset")
    return dict(zip(names, np.array(rows).T, strict=True))
