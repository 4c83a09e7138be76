"""Compiled simulation of a mass with friction: pushed by a force, or in a sampled loop with the compensator."""

import math
from dataclasses import dataclass

import numpy as np

from friction_hil import compensator as compensation
from friction_hil.compensator import Compensator, CompensatorSettings
from friction_hil.friction import FrictionModel, kernel
from friction_hil.friction.dispatch import family_step
from friction_hil.friction.elementary import part
from friction_hil.numerics.jit import Array, StructuredArray, compiled

PERIOD_S = 1e-3
GAIN = 0.9  # below 1, because over-compensation makes an axis unstable near standstill
_STEPS = 5  # integration steps per period
_RESOLUTION = 1e-7  # of the encoder, m
_BALANCE = 1e-12  # relative difference of force and friction below which they balance

MOVED = np.dtype(
    [
        ("kind", "f8"),
        ("friction", "f8", (kernel.PLAIN_ROOM,)),
        ("friction_state", "f8", (kernel.STATE_ROOM,)),  # in a record as in the compensator, to share compiled code
        ("is_static", "f8"),
        ("stick_velocity", "f8"),
        ("mass", "f8"),
        ("damper", "f8"),
        ("spring", "f8"),
        ("pull", "f8"),
        ("proportional", "f8"),
        ("integral", "f8"),
        ("derivative", "f8"),
        ("target", "f8"),
        ("demand", "f8"),  # demanded velocity for the compensator, m/s; NaN: none
        ("is_sampled", "f8"),  # 1 with encoder, controller and compensator
        ("is_compensated", "f8"),
        ("resolution", "f8"),
        ("period_s", "f8"),
        ("steps", "f8"),
    ]
)

_compensate = compensation.whole_step


@compiled
def _run(moved: StructuredArray, settings: StructuredArray, state: StructuredArray, force: Array, trace: Array) -> None:
    """Fill ``trace`` with position, velocity, friction and compensation, (4, n), one column per period.

    The motion is integrated by the semi-implicit Euler method. A static map stops the mass when its velocity would
    change sign, and when friction balances the force within the stick band; from then on friction balances the force
    up to break-away. ``force`` has one element per period, or one for all.
    """
    c = moved[0]
    kind, p, s, steps = int(c.kind), part(c.friction, kernel.HEADER), part(c.friction_state, 0), int(c.steps)
    dt = c.period_s / steps
    stride = 1 if force.shape[0] > 1 else 0
    x, v, friction, integral, command, torque = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(trace.shape[1]):
        given = command + force[k * stride]  # the command of the last period acts in this one
        if c.is_sampled > 0.0:
            measured = math.floor(x / c.resolution) * c.resolution
            # also needed without compensation, because the controller uses its velocity estimate
            torque = c.is_compensated * _compensate(
                settings,
                state,
                float(k),
                measured,
                0.0,
                0.0,
                c.target,
                c.demand,
                c.demand,
                1.0,
                1.0,
                0.0,
                math.nan,
                math.nan,
            )
            command = torque
            if math.isfinite(c.target):
                error = c.target - measured
                integral += c.period_s * error
                command += c.proportional * error + c.integral * integral - c.derivative * state[0].motion.velocity
        trace[3, k] = torque
        for j in range(steps):
            applied = given + c.spring * (c.pull * (k * c.period_s + j * dt) - x) - c.damper * v
            friction = family_step(kind, p, s, v, v, dt, 0.0, 1.0, applied, 0.0)
            after = v + dt * (applied - friction) / c.mass
            if c.is_static > 0.0:
                is_balanced = abs(applied - friction) <= _BALANCE * abs(applied)
                if after * v < 0.0 or (is_balanced and abs(v) <= c.stick_velocity):
                    after = 0.0
            v = after
            x += dt * v
        trace[0, k], trace[1, k], trace[2, k] = x, v, friction


@dataclass(frozen=True, slots=True)
class ClosedLoop:
    """Mass, drive and controller of an experiment with a closed loop."""

    mass: float  # kg
    duration_s: float
    spring: float = 0.0  # stiffness of a spring at the mass, N/m
    pull: float = 0.0  # speed at which the other end of the spring is pulled, m/s
    # proportional, integral and derivative gain of a position controller, N/m, N/(m s), N s/m
    pid: tuple[float, float, float] = (0.0, 0.0, 0.0)
    target: float = math.nan  # set-point of the controller, m; NaN without a controller
    # demanded velocity for the compensator, m/s; NaN if the compensator has only the measurement
    demand: float = math.nan


def push(friction: FrictionModel, mass: float, force: Array, dt: float, damper: float = 0.0) -> Array:
    """Simulate a mass, kg, initially at rest, under a ``force``, (n,), N, with a parallel ``damper``, N s/m.

    Returns (3, n): position, m, velocity, m/s, and friction, N.
    """
    moved = _moved(friction, mass=mass, damper=damper, period_s=dt, steps=1)
    trace = _trace(moved, friction, friction, force, force.size)
    return trace[:3]


def run(friction: FrictionModel, loop: ClosedLoop, assumed: FrictionModel | None) -> Array:
    """Simulate a mass in a closed loop.

    An encoder measures the mass at the beginning of each period of 1 ms. Controller and compensator compute their
    commands in that period, and the commands act in the next one, as in the daemon. The motion is integrated in
    five steps per period.

    ``friction`` acts on the mass; ``assumed`` is what the compensator evaluates, None: no compensation. Returns (4, n),
    one column per period: position, m, velocity, m/s, friction and compensation, N.
    """
    moved = _moved(
        friction,
        mass=loop.mass,
        spring=loop.spring,
        pull=loop.pull,
        proportional=loop.pid[0],
        integral=loop.pid[1],
        derivative=loop.pid[2],
        target=loop.target,
        demand=loop.demand,
        is_sampled=1.0,
        is_compensated=0.0 if assumed is None else 1.0,
        period_s=PERIOD_S,
        steps=_STEPS,
    )
    n = round(loop.duration_s / PERIOD_S)
    return _trace(moved, friction, friction if assumed is None else assumed, np.zeros(1), n)


def _moved(friction: FrictionModel, **values: float) -> StructuredArray:
    """Return the `MOVED` record of a mass; the friction model must have no modifiers."""
    record = np.zeros(1, MOVED)
    c = record[0]
    c["kind"], c["friction"], c["is_static"] = friction.kind, friction.values, friction.family.is_static
    state = friction.initial_state()
    c["friction_state"][: state.size] = state
    c["stick_velocity"] = friction.parameters.get("stick_velocity", 0.0)
    c["resolution"] = _RESOLUTION
    for name, value in values.items():
        c[name] = value
    return record


def _trace(moved: StructuredArray, friction: FrictionModel, assumed: FrictionModel, force: Array, n: int) -> Array:
    settings = CompensatorSettings(
        period_s=PERIOD_S, position_resolution=_RESOLUTION, torque_limit=1e3, gain=GAIN, fade_s=PERIOD_S
    )
    compensator = Compensator(assumed, settings)
    trace = np.empty((4, n))
    state = compensator.state.view(compensation.STATE)
    _run(moved, compensator.record, state, force, trace)
    return trace
