"""Recordings of the example machines and of variants of them: the servo in this process, without daemon and bus."""

import math
from pathlib import Path

import numpy as np

from friction_hil.config import AxisConfig, load
from friction_hil.config.external_torque import simulated_servo
from friction_hil.motion.trajectory import Path as MotionPath
from friction_hil.motion.trajectory import PathTime, Trajectory
from friction_hil.recordings import Recording
from friction_hil.servo.servo import Servo

FOLDER = Path(__file__).parents[1] / "config/machines"
_CSP = 8


def axis_of(name: str) -> AxisConfig:
    """Return the axis of an example machine."""
    (axis,) = load(FOLDER / f"{name}.yaml").axes.values()
    return axis


def record(
    axis: AxisConfig,
    path: MotionPath,
    duration_s: float,
    *,
    period_s: float = 1e-3,
    ramp_s: float = 1.0,
    start: float = 0.0,
    has_load: bool = False,
    name: str = "machine.csv",
) -> Recording:
    """Move the simulated drive of an axis along a path in CSP; the torque is its mean over the period."""
    servo: Servo = simulated_servo(axis.simulation, start)
    servo.set_period(period_s)
    time = PathTime(ramp_s)
    time.start(0.0)
    trajectory = Trajectory(path, time)
    trajectory.begin_at(start)
    steps = round(servo.steps_per_second * period_s)
    rows = []
    for k in range(round(duration_s / period_s)):
        demanded = trajectory.at(k * period_s)
        rows.append((k * period_s, servo.position, servo.torque, servo.position_demand, servo.load_position))
        servo.command(_CSP, demanded.position, 0.0, 0.0)
        servo.advance(steps)
    columns = dict(
        zip(("time_s", "position", "torque", "position_demand", "load_position"), np.array(rows).T, strict=True)
    )
    if not has_load:
        del columns["load_position"]
    return Recording(name, "x", {key: np.ascontiguousarray(values) for key, values in columns.items()})


def true_frequencies(axis: AxisConfig) -> dict[str, float]:
    """Return the linear quantities of the machine behind the motor."""
    mechanics = axis.simulation.mechanics
    motor, load = mechanics.inertia, mechanics.load
    return {
        "motor_inertia": motor,
        "load_inertia": load.inertia,
        "inertia": motor + load.inertia,
        "stiffness": load.stiffness,
        "damping": load.damping,
        "antiresonance_hz": math.sqrt(load.stiffness / load.inertia) / math.tau,
        "resonance_hz": math.sqrt(load.stiffness / load.inertia + load.stiffness / motor) / math.tau,
    }
