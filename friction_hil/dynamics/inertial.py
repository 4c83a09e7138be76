"""The ten standard inertial parameters of a body: mass, first moments, inertia about the origin of its frame."""

import numpy as np

from friction_hil.dynamics.rotations import Pose, cross_matrix
from friction_hil.numerics.jit import Array

_ROUNDED = 1e-4  # of the largest moment of inertia: files have three or four digits


def parameters_of(mass: float, center: Array, inertia: Array) -> Array:
    """Return the parameters of a mass whose inertia about its centre is given, in the axes of the frame."""
    k = cross_matrix(center)
    return joined(mass, mass * center, inertia - mass * k @ k)


def joined(mass: float, moments: Array, inertia: Array) -> Array:
    """Return the parameters of mass, first moments and inertia about the origin."""
    return np.array([mass, *moments, *inertia[0], inertia[1, 1], inertia[1, 2], inertia[2, 2]])


def inertia_of(six: Array) -> Array:
    """Return the matrix of xx, xy, xz, yy, yz, zz."""
    xx, xy, xz, yy, yz, zz = six
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def seen_from(pose: Pose, parameters: Array) -> Array:
    """Return parameters in the frame in which a body has a pose."""
    moments, shift = pose.rotation @ parameters[1:4], cross_matrix(pose.position)
    turned = pose.rotation @ inertia_of(parameters[4:]) @ pose.rotation.T
    k = cross_matrix(moments)
    inertia = turned - shift @ k - k @ shift - parameters[0] * shift @ shift
    return joined(float(parameters[0]), moments + parameters[0] * pose.position, inertia)


def mistake(mass: float, inertia: Array) -> str:
    """Return what is wrong with a mass and the inertia about its centre, or an empty text."""
    if mass < 0.0:
        return f"the mass {mass:g} kg is negative"
    moments = np.linalg.eigvalsh(inertia)
    if moments[0] < -_ROUNDED * abs(moments[2]):
        return f"the inertia has a negative principal moment, {moments[0]:.4g} kg m^2"
    if moments[0] + moments[1] < moments[2] * (1.0 - _ROUNDED):
        a, b, c = moments
        return (
            f"the principal moments {a:.4g}, {b:.4g} and {c:.4g} kg m^2 belong to no body: the largest one is more "
            "than the sum of the others"
        )
    return ""
