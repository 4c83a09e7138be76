"""An axis of two masses, simulated independently of the product: the witness for the identification of mechanics.

    motor_inertia qm'' = torque - coupling - friction(qm')        coupling = stiffness p(qm - ql) + damping (qm' - ql')
    load_inertia  ql'' = coupling - friction(ql') - load

p is zero within the backlash; there the coupling is zero too. Friction on either side is LuGre's; for Coulomb friction
the bristles are very stiff. The drive has a cascade of position and velocity control at 8 kHz. Semi-implicit Euler
steps at 80 kHz: the resonances here, below 200 Hz, are right to 1e-4.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from friction_hil.numerics.jit import compiled
from friction_hil.recordings import Recording

Array = NDArray[np.float64]

LOOP_HZ = 8_000


@dataclass(frozen=True)
class Side:
    """LuGre friction of one side; without a stiffness the bristles are so stiff that it is Coulomb friction."""

    level: float = 0.0
    static: float | None = None
    stribeck_velocity: float = 0.1
    viscous: float = 0.0
    sigma0: float | None = None
    sigma1: float = 0.0

    def numbers(self, inertia: float) -> Array:
        sigma0 = 2e8 * inertia if self.sigma0 is None else self.sigma0
        sigma1 = 0.5 * math.sqrt(sigma0 * inertia) if self.sigma0 is None else self.sigma1
        static = self.level if self.static is None else self.static
        return np.array([sigma0, sigma1, self.level, static, self.stribeck_velocity, self.viscous])


@dataclass(frozen=True)
class Axis:
    """Two masses with a drive; SI. ``backlash`` is the whole width of the gap."""

    motor_inertia: float = 1.2e-4
    load_inertia: float = 0.8e-4
    resonance_hz: float = 60.0  # of the free axis; infinity for a rigid one
    damping_ratio: float = 0.03
    backlash: float = 0.0
    motor: Side = field(default_factory=lambda: Side(0.03, viscous=1e-3))
    load: Side = field(default_factory=lambda: Side(0.04))
    load_torque: float = 0.0
    encoder_error: tuple[float, float] = (0.0, 1.0)  # amplitude, order per revolution
    cogging: tuple[float, float] = (0.0, 1.0)
    counts: float = 2.0**20
    torque_noise: float = 5e-4
    position_gain: float = 80.0
    velocity_gain: float = 0.06
    integral_hz: float = 8.0

    @property
    def stiffness(self) -> float:
        reduced = self.motor_inertia * self.load_inertia / (self.motor_inertia + self.load_inertia)
        return reduced * math.tau**2 * self.resonance_hz**2

    @property
    def antiresonance_hz(self) -> float:
        return math.sqrt(self.stiffness / self.load_inertia) / math.tau

    @property
    def damping(self) -> float:
        return 2.0 * self.damping_ratio * self.stiffness / (math.tau * self.resonance_hz)


def record(axis: Axis, demand: Array, torque: Array | None = None, rate_hz: float = 1000.0, seed: int = 0) -> Recording:
    """Move the axis along ``demand`` (n, 2), position and velocity at 8 kHz; ``torque`` (n,) is added to the drive's.

    The measured torque is the mean over the sampling period.
    """
    random = np.random.default_rng(seed)
    is_rigid = math.isinf(axis.resonance_hz)
    inertia = axis.motor_inertia + (axis.load_inertia if is_rigid else 0.0)
    load = (0.0, 0.0, 0.0) if is_rigid else (axis.load_inertia, axis.stiffness, axis.damping)
    mechanics = np.array([inertia, *load, 0.5 * axis.backlash, axis.load_torque, *axis.cogging])
    drive = np.array([axis.position_gain, axis.velocity_gain, axis.integral_hz, math.tau / axis.counts])
    sides = axis.motor.numbers(inertia), axis.load.numbers(axis.load_inertia)
    added, encoder = np.zeros(len(demand)) if torque is None else torque, np.array(axis.encoder_error)
    every = round(LOOP_HZ / rate_hz)
    position, load, mean, truth = _run(mechanics, *sides, drive, encoder, demand, added, every, random.uniform())
    mean = mean + axis.torque_noise * random.standard_normal(len(mean))
    demanded = demand[every - 1 :: every, 0][: len(mean)] + truth
    columns = {"time_s": np.arange(1, len(mean) + 1) / rate_hz, "position": position, "torque": mean}
    columns |= {"position_demand": demanded, "load_position": load}
    return Recording("axis.csv", "x", columns)


@compiled
def _run(mechanics, motor, load, drive, encoder, demand, added, every, start):  # type: ignore[no-untyped-def]  # pragma: no cover
    jm, jl, k, c, half, load_torque, cogging, cogging_order = mechanics
    kp, kv, integral_hz, count = drive
    error, order = encoder
    dt = 1.0 / 80_000
    loop_s = 1.0 / 8_000
    n = len(demand) // every
    position, load_position, mean = np.empty(n), np.empty(n), np.empty(n)
    qm = ql = start
    vm = vl = zm = zl = 0.0
    u = integral = velocity = sum_u = 0.0
    seen = math.floor((qm + error * math.sin(order * qm)) / count) * count
    begin = seen
    for i in range(n * every):
        now = math.floor((qm + error * math.sin(order * qm)) / count) * count
        velocity += (1.0 - math.exp(-2.0 * math.pi * 1000.0 * loop_s)) * ((now - seen) / loop_s - velocity)
        seen = now
        want = kp * (begin + demand[i, 0] - now) + demand[i, 1] - velocity
        integral += 2.0 * math.pi * integral_hz * loop_s * want
        demanded = kv * (want + integral) + added[i]
        for _ in range(10):
            u += (demanded - u) * dt / 3e-4
            sum_u += u
            fm, zm = _friction(motor, vm, zm, dt)
            if jl > 0.0:
                fl, zl = _friction(load, vl, zl, dt)
                x = qm - ql
                coupling = 0.0
                if x > half:
                    coupling = max(k * (x - half) + c * (vm - vl), 0.0) if half > 0.0 else k * x + c * (vm - vl)
                elif x < -half:
                    coupling = min(k * (x + half) + c * (vm - vl), 0.0) if half > 0.0 else k * x + c * (vm - vl)
                vl += dt * (coupling - fl - load_torque) / jl
                ql += dt * vl
            else:
                coupling = load_torque
            vm += dt * (u - coupling - fm - cogging * math.sin(cogging_order * qm)) / jm
            qm += dt * vm
            if jl == 0.0:
                ql = qm
        if (i + 1) % every == 0:
            j = i // every
            position[j] = math.floor((qm + error * math.sin(order * qm)) / count) * count
            load_position[j] = math.floor(ql / count) * count
            mean[j] = sum_u / (10 * every)
            sum_u = 0.0
    return position, load_position, mean, begin


@compiled
def _friction(side, v, z, dt):  # type: ignore[no-untyped-def]  # pragma: no cover
    sigma0, sigma1, level, static, stribeck, viscous = side
    if level == 0.0:
        return viscous * v, 0.0
    g = level + (static - level) * math.exp(-((v / stribeck) ** 2))
    new = (z + dt * v) / (1.0 + dt * sigma0 * abs(v) / g)
    return sigma0 * new + sigma1 * (new - z) / dt + viscous * v, new


def sweeps(sweeps_of_plan: tuple, seconds: float) -> Array:  # type: ignore[type-arg]
    """Return the demand (n, 2) at 8 kHz of sweeps of the product's experiment."""
    from friction_hil.motion import experiment

    return np.column_stack(experiment.demand(np.arange(round(seconds * LOOP_HZ)) / LOOP_HZ, sweeps_of_plan))


def there_and_back(speed: float, travel: float, seconds: float) -> Array:
    """Return the demand (n, 2) at 8 kHz of constant speed back and forth, with corners of 20 ms."""
    from friction_hil.motion.trajectory import triangle_path

    path = triangle_path(0.5 * travel, 0.5 * speed / travel, 0.1)
    return np.array([path(i / LOOP_HZ)[:2] for i in range(round(seconds * LOOP_HZ))])
