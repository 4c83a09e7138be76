"""An arm: torques of its joints from their motion, and what they are linear in."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from friction_hil.dynamics import newton_euler
from friction_hil.dynamics.newton_euler import PARAMETERS, PRISMATIC
from friction_hil.errors import UsageError
from friction_hil.numerics.jit import Array, StructuredArray

_ONE: Any = newton_euler.inverse_dynamics
_FLOAT = np.dtype(np.float64)
_as_array, _empty_like = np.asarray, np.empty_like


@dataclass(frozen=True, slots=True, eq=False)
class Arm:
    """The rigid-body dynamics of an arm of n joints. `friction_hil.dynamics.load` makes it.

    Positions are in rad or m, torques in N m or N, for revolute or prismatic joints. All arrays have the joints in the
    order of ``joints``, with the signs that were given. NaN in a state gives NaN for it, and raises nothing.

    Attributes
    ----------
    joints : tuple of str
        Names of the joints.
    gravity_vector : numpy.ndarray
        Acceleration of gravity in the frame of the base, shape (3,), m/s^2.
    links : numpy.ndarray
        Records of what each joint moves, each after the one that carries it; for compiled code.
    path : str
        File from which it was loaded.
    """

    joints: tuple[str, ...]
    gravity_vector: Array
    links: StructuredArray
    path: str = ""

    def __len__(self) -> int:
        return len(self.joints)

    @property
    def is_linear(self) -> tuple[bool, ...]:
        """Whether each joint is prismatic."""
        return tuple(bool(each) for each in self._ordered("kind") == PRISMATIC)

    @property
    def armatures(self) -> Array:
        """Inertia of the rotor of each joint behind its gear, shape (n,), kg m^2 or kg."""
        return self._ordered("armature")

    @property
    def parameters(self) -> Array:
        """Standard inertial parameters of what each joint moves, shape (n, 10).

        They are m, m cx, m cy, m cz in kg and kg m, and Ixx, Ixy, Ixz, Iyy, Iyz, Izz in kg m^2, about a point of the
        joint's axis and in the axes of the file's link. What fixed and locked joints carry is in them.
        """
        return self._ordered("parameters")

    def with_parameters(self, parameters: ArrayLike, armatures: ArrayLike | None = None) -> "Arm":
        """Return the arm with other inertial parameters, e.g. identified ones.

        Parameters
        ----------
        parameters : array_like
            As in ``parameters``, shape (n, 10) or (10 n,).
        armatures : array_like, optional
            As in ``armatures``; by default they stay.

        Returns
        -------
        Arm
            The arm, which shares nothing with this one.

        Raises
        ------
        UsageError
            There are too few or too many numbers, or one is not finite.
        """
        n = len(self)
        given = np.asarray(parameters, float)
        rotors = self.armatures if armatures is None else np.asarray(armatures, float)
        if given.size != n * PARAMETERS or rotors.shape != (n,):
            raise UsageError(f"parameters must have the shape ({n}, {PARAMETERS}), and armatures ({n},)")
        if not (np.isfinite(given).all() and np.isfinite(rotors).all()):
            raise UsageError("parameters and armatures must be finite")
        links = self.links.copy()
        links["parameters"] = given.reshape(n, PARAMETERS)[links["order"]]
        links["armature"] = rotors[links["order"]]
        return replace(self, links=links)

    def inverse_dynamics(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike, out: Array | None = None) -> Array:
        """Return the torques that a motion takes: inertia, Coriolis, centrifugal and gravity; no friction.

        Parameters
        ----------
        q, dq, ddq : array_like
            Positions, velocities and accelerations, shape (n,) for one state or (rows, n) for many.
        out : numpy.ndarray, optional
            Array of float64 of the same shape that takes the result.

        Returns
        -------
        numpy.ndarray
            Torques or forces, in the shape of ``q``; ``out``, if given.

        Raises
        ------
        UsageError
            The shapes differ, or are not those of this arm's joints.
        """
        q, dq, ddq = _as_array(q, _FLOAT), _as_array(dq, _FLOAT), _as_array(ddq, _FLOAT)
        tau = _empty_like(q) if out is None else out
        if q.ndim == dq.ndim == ddq.ndim == tau.ndim == 1 and tau.dtype is _FLOAT:  # quick: for a loop
            if not _ONE.run(self.links, self.gravity_vector, q, dq, ddq, tau):
                raise self._wrong_shape(q, dq, ddq)
            return tau
        positions, velocities, accelerations = self._rows(q, dq, ddq)
        if tau.shape != q.shape or tau.dtype != _FLOAT:
            raise UsageError(f"out must be of float64 and of the shape {q.shape}, not {tau.dtype} {tau.shape}")
        newton_euler.inverse_dynamics_of_rows(
            self.links, self.gravity_vector, positions, velocities, accelerations, np.atleast_2d(tau)
        )
        return tau

    def gravity(self, q: ArrayLike, out: Array | None = None) -> Array:
        """Return the torques that hold the arm at rest against gravity.

        Parameters
        ----------
        q : array_like
            Positions, shape (n,) or (rows, n).
        out : numpy.ndarray, optional
            Array of float64 of the same shape that takes the result.

        Returns
        -------
        numpy.ndarray
            Torques or forces, in the shape of ``q``; ``out``, if given.

        Raises
        ------
        UsageError
            The shape is not that of this arm's joints.
        """
        q = np.asarray(q, np.float64)
        rest = np.zeros(q.shape)
        return self.inverse_dynamics(q, rest, rest, out)

    def inertia_matrix(self, q: ArrayLike) -> Array:
        """Return the inertia matrix, with the armatures on its diagonal.

        Parameters
        ----------
        q : array_like
            Positions, shape (n,) or (rows, n).

        Returns
        -------
        numpy.ndarray
            Shape (n, n) or (rows, n, n), kg m^2, kg m or kg.

        Raises
        ------
        UsageError
            The shape is not that of this arm's joints.
        """
        (rows,) = self._rows(q)
        n = len(self)
        matrices = np.empty((len(rows), n, n))
        newton_euler.inertia_matrices(self.links, rows, matrices)
        return matrices if np.ndim(q) == 2 else matrices[0]

    def regressor(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> Array:
        """Return the matrix that gives the torques from the inertial parameters, in which they are linear.

        ``inverse_dynamics(q, dq, ddq)`` is ``regressor(q, dq, ddq) @ parameters.ravel() + armatures * ddq``.

        Parameters
        ----------
        q, dq, ddq : array_like
            Positions, velocities and accelerations, shape (n,) or (rows, n).

        Returns
        -------
        numpy.ndarray
            Shape (n, 10 n) or (rows, n, 10 n).

        Raises
        ------
        UsageError
            The shapes differ, or are not those of this arm's joints.
        """
        n = len(self)
        positions, velocities, accelerations = self._rows(q, dq, ddq)
        y = np.empty((len(positions), n, PARAMETERS * n))
        newton_euler.regressors(self.links, self.gravity_vector, positions, velocities, accelerations, y)
        return y if np.ndim(q) == 2 else y[0]

    def _ordered(self, name: str) -> Array:
        """Return a field of the links in the order of the joints."""
        found = np.empty_like(self.links[name])
        found[self.links["order"]] = self.links[name]
        return found

    def _rows(self, *states: ArrayLike) -> tuple[Array, ...]:
        arrays = [np.asarray(each, np.float64) for each in states]
        if any(each.shape != arrays[0].shape or each.shape[-1:] != (len(self),) for each in arrays) or (
            arrays[0].ndim > 2
        ):
            raise self._wrong_shape(*arrays)
        return tuple(np.atleast_2d(each) for each in arrays)

    def _wrong_shape(self, *arrays: Array) -> UsageError:
        n, shapes = len(self), ", ".join(str(each.shape) for each in arrays)
        return UsageError(f"positions, velocities and accelerations must all be ({n},) or (rows, {n}), not {shapes}")
