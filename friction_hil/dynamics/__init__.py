"""Rigid-body dynamics of an arm from its URDF or MJCF: what the motion of its joints takes in torque.

`load` reads the file; an `Arm` computes inverse dynamics, gravity, the inertia matrix, and the regressor in which its
ten inertial parameters per link are linear. Friction is not in it.
"""

from friction_hil.dynamics.arm import Arm
from friction_hil.dynamics.loading import Payload, load

__all__ = ["Arm", "Payload", "load"]
