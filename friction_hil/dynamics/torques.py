"""Torques of an arm cycle by cycle, in memory that is made once: loads of its gears, what is fed forward. Compiled."""

import math

import numpy as np

from friction_hil.dynamics import newton_euler
from friction_hil.numerics.jit import Array, StructuredArray, compiled_for_one_sample, inner

# rows of a workspace, each with a number for each joint, in the order of the arm's
# motion that is demanded; torque that the gear carries, without that of the rotor, and all of it, N m or N
Q, DQ, DDQ, LOAD, WHOLE = range(5)
FED = 5  # torque to feed forward, N m or N
# inertia by which the drive itself feeds DDQ forward, kg m^2 or kg; NaN: the joint's own, whatever that is
LEFT = 6
_SCRATCH, _ROWS = 7, 8


def workspace(joints: int) -> tuple[Array, Array]:
    """Return the workspace (rows, joints) of an arm, all zero, and the memory of its links."""
    return np.zeros((_ROWS, joints)), np.zeros((joints, newton_euler.WIDTH))


@inner
def _inverse(links: StructuredArray, gravity: Array, q: Array, dq: Array, ddq: Array, known: Array, tau: Array) -> None:
    newton_euler.inverse(links, gravity, q, dq, ddq, known, tau)


@inner
def find_loads(links: StructuredArray, gravity: Array, work: Array, known: Array) -> None:
    """Set the loads of a motion; one that is not finite stays as it was."""
    ddq = work[DDQ]
    _inverse(links, gravity, work[Q], work[DQ], ddq, known, work[WHOLE])
    for i in range(len(links)):
        k = links[i]["order"]
        load = work[WHOLE, k] - links[i]["armature"] * ddq[k]
        if math.isfinite(load):
            work[LOAD, k] = load


@compiled_for_one_sample
def find_torques(links: StructuredArray, gravity: Array, work: Array, known: Array) -> None:
    """Set loads and torques to feed forward; one that is not finite stays as it was."""
    find_loads(links, gravity, work, known)
    ddq = work[DDQ]
    for k in range(len(links)):
        acceleration = ddq[k]
        if math.isfinite(work[LEFT, k]):
            torque = work[WHOLE, k] - work[LEFT, k] * acceleration
        else:
            ddq[k] = 0.0
            _inverse(links, gravity, work[Q], work[DQ], ddq, known, work[_SCRATCH])
            torque, ddq[k] = work[_SCRATCH, k], acceleration
        if math.isfinite(torque):
            work[FED, k] = torque
