"""Rotations as 3x3 matrices, from the forms in which URDF and MJCF give them."""

from dataclasses import dataclass, field

import numpy as np

from friction_hil.numerics.jit import Array

_AXES = {"x": np.array([1.0, 0.0, 0.0]), "y": np.array([0.0, 1.0, 0.0]), "z": np.array([0.0, 0.0, 1.0])}


@dataclass(frozen=True, slots=True)
class Pose:
    """Where a frame is in another one."""

    rotation: Array = field(default_factory=lambda: np.eye(3))
    position: Array = field(default_factory=lambda: np.zeros(3))  # m

    def __matmul__(self, inner: "Pose") -> "Pose":
        return Pose(self.rotation @ inner.rotation, self.position + self.rotation @ inner.position)


def cross_matrix(v: Array) -> Array:
    """Return the matrix of the cross product with ``v``."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def about(axis: Array, angle: float) -> Array:
    """Return the rotation about an axis of length 1."""
    k = cross_matrix(axis)
    turned: Array = np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * k @ k
    return turned


def of_roll_pitch_yaw(angles: Array) -> Array:
    """Return the rotation about the fixed axes x, y and z, as URDF has it."""
    return of_euler(angles, "XYZ")


def of_euler(angles: Array, sequence: str) -> Array:
    """Return the rotation about axes that move with it (small letters) or are fixed (capitals), as MJCF has it."""
    rotation = np.eye(3)
    for letter, angle in zip(sequence, angles, strict=True):
        one = about(_AXES[letter.lower()], angle)
        rotation = rotation @ one if letter.islower() else one @ rotation
    return rotation


def of_quaternion(quaternion: Array) -> Array:
    """Return the rotation of a quaternion w, x, y, z of any length but 0."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    k = cross_matrix(np.array([x, y, z]))
    turned: Array = np.eye(3) + 2.0 * w * k + 2.0 * k @ k
    return turned


def of_z_axis(z: Array) -> Array:
    """Return the least rotation that turns the z axis into a direction."""
    z = z / np.linalg.norm(z)
    axis = np.cross(_AXES["z"], z)
    sine = float(np.linalg.norm(axis))
    axis = axis / sine if sine > 1e-12 else _AXES["x"]
    return about(axis, float(np.arctan2(sine, z[2])))


def of_x_and_y(x: Array, y: Array) -> Array:
    """Return the rotation whose first column is along ``x``, and the second one in the plane of both."""
    x = x / np.linalg.norm(x)
    y = y - (x @ y) * x
    y = y / np.linalg.norm(y)
    return np.column_stack([x, y, np.cross(x, y)])
