"""Free simulation of the identified axis in its closed loop, from the reference alone. Pure.

A prediction error compares torques along the measured motion. In a free run the model produces the motion as well, so
that its errors accumulate. This requires the control law that commanded the torque.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from friction_hil.errors import UsageError
from friction_hil.models.model_file import ModelFile
from friction_hil.numerics.jit import Array

Controller = Callable[[int, float, float], float]  # sample, position, velocity -> torque

_BALANCE = 1e-12  # relative difference below which applied torque and friction balance
_STEPS = 4  # integration steps per sample
_FAR = 1e12  # rad or m: the simulation is unstable beyond


@dataclass(frozen=True, slots=True, eq=False)
class FreeRun:
    """A simulated motion; arrays (n,), SI."""

    position: Array  # this and the velocity: at the beginning of each sample, where the controller reads them
    velocity: Array
    torque: Array  # commanded over the sample

    def relative_error(self, measured: Array, begin: int = 0) -> float:
        """Return norm(measured - torque) / norm(measured) from row ``begin`` on; ``measured`` is (n,)."""
        difference = measured[begin:] - self.torque[begin:]
        return float(np.linalg.norm(difference) / np.linalg.norm(measured[begin:]))


def cascade(demand: Array, position_gain: float, velocity_gain: float) -> Controller:
    """Return a P position controller over a P velocity controller.

    torque = velocity_gain (position_gain (demand - position) - velocity)

    ``demand``: (n,), rad or m. ``position_gain``: 1/s. ``velocity_gain``: N m s/rad or N s/m.
    """
    demands = demand.tolist()

    def torque(sample: int, position: float, velocity: float) -> float:
        return float(velocity_gain * (position_gain * (demands[sample] - position) - velocity))

    return torque


def simulate_axis(
    model: ModelFile,  # with an inertia above zero
    controller: Controller,  # takes the index of the sample, position and velocity; returns the torque
    samples: int,
    dt: float,  # s
    *,
    position: float = 0.0,  # at the beginning, rad or m
    velocity: float = 0.0,  # at the beginning, rad/s or m/s
) -> FreeRun:
    """Simulate the axis of a model file under a controller.

    inertia dv/dt = torque - offset - gravity(q) - friction is integrated by semi-implicit Euler, with the torque held
    over each sample. With static friction the axis sticks exactly: it stops when its velocity would change sign, and
    rests while friction balances the applied torque. Delay and lag of the torque are not simulated.

    Raises `UsageError`: the model has no inertia, or the motion grows without bound.
    """
    mechanics = model.mechanics
    inertia, offset, gravity = mechanics.inertia, mechanics.offset, mechanics.gravity
    if not inertia > 0.0:
        raise UsageError("a free run needs a model with an inertia above zero in its mechanics")
    friction = model.friction_model
    runner = friction.start("simulation")
    is_static = friction.family.is_static
    h = dt / _STEPS
    q, v = float(position), float(velocity)
    trace = np.empty((3, samples))
    for k in range(samples):
        torque = controller(k, q, v)
        trace[0, k], trace[1, k], trace[2, k] = q, v, torque
        for _ in range(_STEPS):
            load = gravity.at(q)
            applied = torque - offset - load
            resistance = runner.step(v, h, position=q, load_torque=load, applied_torque=applied)
            after = v + h * (applied - resistance) / inertia
            if is_static:
                stands = v == 0.0 and abs(applied - resistance) <= _BALANCE * abs(applied)
                if after * v < 0.0 or stands:
                    after = 0.0
            v = after
            q += h * v
        if not abs(q) < _FAR:
            raise UsageError(f"the free run grows without bound after {k} samples: controller and model do not fit")
    return FreeRun(trace[0], trace[1], trace[2])
