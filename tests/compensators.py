"""Compensators for tests, inputs for them, and a small simulated axis: drive, inertia, true friction, encoder."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import reduce
from operator import getitem
from typing import Any

import numpy as np
from hypothesis import strategies as st

import friction_hil as fh
from friction_hil.compensator import INPUTS, STATE, Compensator, CompensatorSettings
from friction_hil.numerics.jit import Array

PERIOD_S = 1e-3
INERTIA = 2e-4
EVERY_VELOCITY = ("difference", "tracking", "kalman", "drive")
EVERY_SOURCE = ("auto", "measured", "demand")

VISCOUS = fh.models.create("coulomb", coulomb=0.05, viscous=0.01)
LUGRE = fh.models.create("lugre", **fh.models.describe("lugre").example)
# nothing but a spring, whose torque shows the velocity that deflects it
SPRING = fh.models.create("lugre", sigma0=10.0, coulomb=1e9, stribeck_velocity=1.0)
MODELS = {name: fh.models.create(name, **fh.models.describe(name).example) for name in fh.models.names()}

Course = Callable[[float], float]  # of time


def compensator(model: fh.models.FrictionModel = VISCOUS, **changes: Any) -> Compensator:
    """Compensator of gain 1 that knows the inertia and fades in at once, with other settings as given."""
    given = {"period_s": PERIOD_S, "position_resolution": 1e-6, "torque_limit": 10.0, "inertia": INERTIA}
    given |= {"acceleration": 30.0, "gain": 1.0, "fade_s": 0.01}
    return Compensator(model, CompensatorSettings(**given | changes))


def resolution(bits: int) -> float:
    """Smallest step of an encoder, rad."""
    return 2.0 * math.pi / 2.0**bits


FINE = resolution(20)


def quantised(position: Any, step: float) -> Any:
    """Position as an encoder gives it."""
    return np.round(np.asarray(position) / step) * step


def field(one: Compensator, name: str) -> Any:
    """Value of a field of the state, such as ``cycle`` or ``limit_cycle.alternations``."""
    return reduce(getitem, name.split("."), one.state.view(STATE)[0])


def row(cycle: int, **given: float) -> tuple[float, ...]:
    """One cycle's inputs: at rest, no demand, fresh and enabled where nothing else is given."""
    usual = dict.fromkeys(INPUTS, 0.0) | {"cycle": float(cycle), "is_fresh": 1.0, "is_enabled": 1.0}
    demand = ("position_demand", "velocity_demand", "velocity_demand_ahead", "acceleration_demand_ahead")
    usual |= dict.fromkeys((*demand, "temperature", "load_torque"), math.nan)
    assert not set(given) - set(INPUTS)
    return tuple((usual | given).values())


def columns(cycles: int, start: int = 0, **given: Any) -> list[Array]:
    """`row` for many cycles, a number or an array for each input, as `Compensator.replay` takes them."""
    usual = dict(zip(INPUTS, row(0), strict=True)) | {"cycle": start + np.arange(cycles)}
    assert not set(given) - set(INPUTS)
    return [np.array(np.broadcast_to(one, cycles), dtype=float) for one in (usual | given).values()]


def feed(one, position, velocity, cycles, *, demand=None, lead_s=0.0, start=0, **given):
    """Feed a motion and its demanded velocity, all courses of time; return compensations and velocity estimates.

    The demanded position is not known, unless it is given.
    """
    times = [(start + k) * PERIOD_S for k in range(cycles)]
    if demand is not None:
        given["velocity_demand"] = [demand(t) for t in times]
        given["velocity_demand_ahead"] = [demand(t + lead_s) for t in times]
    motion = {"position": [position(t) for t in times], "velocity": [velocity(t) for t in times]}
    return one.replay(columns(cycles, start, **motion, **given))


def even(speed: float) -> tuple[Course, Course]:
    """Position and velocity of an even motion."""
    return (lambda t: speed * t), (lambda t: speed)


def replayed(one: Compensator, rows: Iterable[tuple[float, ...]]) -> list[float]:
    """Compensations by `Compensator.step`, row by row."""
    return [one.step(*each) for each in rows]  # type: ignore[arg-type]


_wild = st.floats(-1e6, 1e6)
_unknown = st.one_of(st.just(math.nan), _wild)


@st.composite
def wild_inputs(draw: Any, *, longest: int = 60) -> list[tuple[float, ...]]:
    """Rows of inputs of any size, with gaps, repeated cycles and set-points that come and go."""
    rows, cycle = [], 0
    for _ in range(draw(st.integers(1, longest))):
        cycle = max(cycle + draw(st.integers(-1, 40)), 0)  # none or fewer must not happen, but must not hurt
        values = [draw(each) for each in (_wild, _unknown, _unknown, _unknown, _unknown, _unknown)]
        rows.append((float(cycle), *values, float(draw(st.booleans())), float(draw(st.booleans()))))
        rows[-1] += (draw(_unknown), draw(_unknown), draw(_unknown))
    return rows


def opposite(inputs: tuple[float, ...]) -> tuple[float, ...]:
    """The same cycle seen in a mirror."""
    return (inputs[0], *(-value for value in inputs[1:7]), *inputs[7:9], -inputs[9], inputs[10], -inputs[11])


@dataclass(frozen=True)
class Run:
    """What a simulated axis did, by cycles, each (n,); ``state`` columns are the compensator's after each cycle."""

    t: Array
    position: Array
    velocity: Array
    friction: Array
    compensation: Array
    gain_factor: Array
    error: Array

    def after(self, t: float) -> "Run":
        """The part from a time on."""
        return Run(**{name: getattr(self, name)[self.t >= t] for name in self.__dataclass_fields__})


class Axis:
    """Inertia with friction, behind a drive with a lag of torque; the compensation acts a cycle late.

    Semi-implicit Euler, a static friction map stops the axis where its velocity would change sign. The drive is a
    position P over a velocity PI with feed-forward of velocity and acceleration, or, where no demand is given,
    gives no torque of its own. Its ``velocity_gain`` of 0.06 N m s/rad is a soft one, 0.2 a stiff one; the encoder's
    ``resolution`` is that of drive and compensator; ``load`` acts against positive motion.
    """

    STEPS, SAMPLES = 4, 8  # of integration in a sample of the drive; samples of the drive in a cycle
    LAG_S, POSITION_GAIN, INTEGRAL_HZ = 3e-4, 100.0, 100.0

    def __init__(self, friction, *, inertia=INERTIA, velocity_gain=0.06, resolution=FINE, load=0.0):
        self.friction, self.inertia, self.load = friction, inertia, load
        self.velocity_gain, self.resolution = velocity_gain, resolution
        self.runner = friction.start(purpose="simulation")
        self.position = self.velocity = self.torque = self.friction_torque = self.integral = 0.0
        self.cycle = 0

    def run(self, one, duration_s, *, demand=None, hand=None, is_telling=True, change=None):
        """Go on for a time with a compensator, or None.

        ``demand`` is the course of the position, of which the compensator is told or not (``is_telling``); ``hand``
        gives the torque from outside for time, position and velocity; ``change`` what the compensator gets for a row.
        """
        rows = []
        compensation = 0.0
        for _ in range(round(duration_s / PERIOD_S)):
            t = self.cycle * PERIOD_S
            position = float(quantised(self.position, self.resolution))
            acting, compensation = compensation, 0.0
            wanted = math.nan if demand is None else demand(t)
            if one is not None:
                told = {}
                if demand is not None and is_telling:
                    told = {
                        "position_demand": wanted,
                        "velocity_demand": _slope(demand, t),
                        "velocity_demand_ahead": _slope(demand, t + one.settings.lead_s),
                    }
                inputs = row(self.cycle, position=position, velocity=self.velocity, torque=self.torque, **told)
                compensation = one.step(*(inputs if change is None else change(inputs)))  # type: ignore[arg-type]
            values = (t, self.position, self.velocity, self.friction_torque, acting, 1.0, wanted - self.position)
            rows.append(values if one is None else (*values[:5], one.gain_factor, values[6]))
            for sample in range(self.SAMPLES):
                self._sample(t + sample * PERIOD_S / self.SAMPLES, acting, demand, hand)
            self.cycle += 1
        return Run(*np.array(rows).T)

    def _sample(self, t: float, compensation: float, demand: Any, hand: Any) -> None:
        """One sample of the drive."""
        dt = PERIOD_S / self.SAMPLES
        command = compensation
        if demand is not None:
            before, now, then = demand(t - dt), demand(t), demand(t + dt)
            encoder = round(self.position / self.resolution) * self.resolution
            speed = self.POSITION_GAIN * (now - encoder) + 0.5 * (then - before) / dt - self.velocity
            self.integral += self.velocity_gain * speed * self.INTEGRAL_HZ * dt
            acceleration = (then - 2.0 * now + before) / (dt * dt)
            command += self.velocity_gain * speed + self.integral + self.inertia * acceleration
        dt /= self.STEPS
        share = -math.expm1(-dt / self.LAG_S)
        is_static = self.friction.family.is_static
        outside = -self.load + (0.0 if hand is None else hand(t, self.position, self.velocity))
        for _ in range(self.STEPS):
            self.torque += share * (command - self.torque)
            applied = self.torque + outside
            friction = self.runner.step(self.velocity, dt, applied_torque=applied)
            velocity = self.velocity + (applied - friction) * dt / self.inertia
            if is_static and velocity * self.velocity < 0.0:
                velocity = 0.0
            self.velocity, self.friction_torque = velocity, friction
            self.position += dt * velocity


def _slope(course: Course, t: float) -> float:
    width = 0.1 * PERIOD_S
    return (course(t + width) - course(t - width)) / (2.0 * width)


def swing(amplitude: float, frequency_hz: float, rest_s: float = 0.0) -> Course:
    """Position that goes to and fro between 0 and twice the amplitude, and stays at 0 until ``rest_s``."""
    rate = 2.0 * math.pi * frequency_hz
    return lambda t: amplitude * (1.0 - math.cos(rate * (t - rest_s))) if t > rest_s else 0.0
