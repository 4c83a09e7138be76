"""Recordings of the example machines: the servo in this process, without daemon and bus."""

import math
from pathlib import Path

import numpy as np

from friction_hil.config import AxisConfig, load
from friction_hil.config.external_torque import simulated_servo
from friction_hil.motion.trajectory import Path as MotionPath
from friction_hil.motion.trajectory import PathTime, Trajectory
from friction_hil.recordings import Recording
from friction_hil.servo.coupled_servos import CoupledServos
from friction_hil.servo.servo import Servo

FOLDER = Path(__file__).parents[1] / "config/machines"
PERIOD_S = 1e-3
_CSP = 8


def axis_of(name: str) -> AxisConfig:
    """Return the axis of an example machine."""
    (axis,) = load(FOLDER / f"{name}.yaml").axes.values()
    return axis


def record(axis: AxisConfig, path: MotionPath, duration_s: float) -> Recording:
    """Move the simulated drive of an axis along a path in CSP at 1 kHz; it reports its torque at the sample."""
    return _recorded({"x": simulated_servo(axis.simulation)}, "x", path, duration_s)["x"]


def record_mechanism(name: str, moved: str, path: MotionPath, duration_s: float) -> dict[str, Recording]:
    """Move one axis of an example machine as `record` does, while the drives of the others hold theirs."""
    machine = load(FOLDER / f"{name}.yaml")
    assert machine.simulation is not None
    mechanism = machine.simulation.mechanism
    servos = CoupledServos(mechanism, [machine.axes[each].simulation for each in mechanism.axes]).servos
    return _recorded(dict(zip(mechanism.axes, servos, strict=True)), moved, path, duration_s)


def _recorded(servos: dict[str, Servo], moved: str, path: MotionPath, duration_s: float) -> dict[str, Recording]:
    time = PathTime(1.0)
    time.start(0.0)
    trajectory = Trajectory(path, time)
    trajectory.begin_at(0.0)
    rows: dict[str, list[tuple[float, ...]]] = {name: [] for name in servos}
    for k in range(round(duration_s / PERIOD_S)):
        for name, servo in servos.items():
            rows[name].append((k * PERIOD_S, servo.position, servo.torque, servo.position_demand))
            servo.command(_CSP, trajectory.at(k * PERIOD_S).position if name == moved else 0.0)
        for servo in servos.values():
            servo.advance(round(servo.steps_per_second * PERIOD_S))
    names = ("time_s", "position", "torque", "position_demand")
    return {
        axis: Recording(
            "machine.csv",
            axis,
            {name: np.ascontiguousarray(values) for name, values in zip(names, np.array(own).T, strict=True)},
        )
        for axis, own in rows.items()
    }


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
