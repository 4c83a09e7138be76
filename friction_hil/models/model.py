"""A friction model with its parameters: simulate a record, or run step by step."""

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from friction_hil.errors import UsageError
from friction_hil.jit import Array
from friction_hil.models import kernel
from friction_hil.models.family import Family

Purpose = Literal["feedforward", "simulation"]

# Where nobody tells the velocity noise: slow against any Stribeck velocity, fast against double rounding.
DEFAULT_VELOCITY_EPSILON = 1e-3


class FrictionModel:
    """A model of the library with values for its parameters; make it with `friction_hil.models.create`.

    Friction is positive when it opposes positive velocity: J dv/dt = tau - F - load.

    Attributes
    ----------
    family : Family
        Name, formula, source and parameter table.
    parameters : dict
        Every parameter by name, defaults filled in, SI.
    kind : int
        Number by which `friction_hil.models.kernel` knows the model.
    values : array
        The parameters in the kernel's order.
    notes : tuple of str
        What is unusual but allowed.
    """

    __slots__ = ("family", "kind", "notes", "parameters", "values")

    def __init__(self, family: Family, parameters: Mapping[str, float]) -> None:
        self.family = family
        self.parameters = dict(parameters)
        self.kind = kernel.KINDS[family.name]
        self.values = np.zeros(kernel.PARAMETER_ROOM)
        self.values[: len(self.parameters)] = list(self.parameters.values())
        self.notes: tuple[str, ...] = ()
        if self.parameters.get("static", np.inf) < self.parameters["coulomb"]:
            self.notes = ("static is below coulomb: this axis has no Stribeck hump",)

    def __repr__(self) -> str:
        return f"{self.family.name}({', '.join(f'{name}={value:g}' for name, value in self.parameters.items())})"

    @property
    def name(self) -> str:
        """Name of the family, as in the registry."""
        return self.family.name

    def initial_state(self) -> Array:
        """State at rest with nothing deflected."""
        return np.zeros(kernel.STATE_ROOM)

    def simulate(self, velocity: ArrayLike, dt: ArrayLike, *, applied_torque: ArrayLike = 0.0) -> Array:
        """Friction torque of a velocity record, from rest.

        Parameters
        ----------
        velocity : (n,) array
            Held over each sample, rad/s.
        dt : float or (n,) array
            Length of the sample(s), s, above zero.
        applied_torque : float or (n,) array
            What a static map balances while the velocity is zero, N m.

        Returns
        -------
        (n,) array
            Torque at the end of each sample, N m.

        Raises
        ------
        UsageError
            A shape does not fit, or a value is not finite.
        """
        v = _vector("velocity", velocity)
        steps = _per_sample("dt", dt, v.size)
        if not np.all(steps > 0.0):
            raise UsageError(f"dt must be above zero, in s; its smallest value is {steps.min():g}")
        applied = _per_sample("applied_torque", applied_torque, v.size)
        torque: Array = kernel.simulate(self.kind, self.values, self.initial_state(), v, steps, applied)
        return torque

    def steady_state(self, velocity: ArrayLike) -> Array:
        """Torque (n,) that the model settles on at each constant velocity (n,); 0 at rest."""
        torque: Array = kernel.steady_curve(self.kind, self.values, _vector("velocity", velocity))
        return torque

    def start(self, purpose: Purpose = "feedforward", velocity_epsilon: float | None = None) -> "Runner":
        """Start at rest, for one sample at a time.

        Parameters
        ----------
        purpose : {"feedforward", "simulation"}
            A feed-forward smooths a static map's jump at zero velocity; a simulation sticks exactly.
        velocity_epsilon : float, optional
            Width of that smoothing, rad/s: two or three times the velocity noise.
            `DEFAULT_VELOCITY_EPSILON` when not given.
        """
        if purpose not in ("feedforward", "simulation"):
            raise UsageError(f"purpose is 'feedforward' or 'simulation', not {purpose!r}")
        if purpose == "simulation":
            if velocity_epsilon is not None:
                raise UsageError("velocity_epsilon belongs to the purpose 'feedforward'; a simulation sticks exactly")
            return Runner(self, 0.0)
        epsilon = DEFAULT_VELOCITY_EPSILON if velocity_epsilon is None else float(velocity_epsilon)
        if not (np.isfinite(epsilon) and epsilon > 0.0):
            raise UsageError(f"velocity_epsilon must be finite and above zero, in rad/s, not {epsilon:g}")
        return Runner(self, epsilon)


class Runner:
    """A model in motion: its state, advanced by `step`."""

    __slots__ = ("_epsilon", "_kind", "_values", "state")

    def __init__(self, model: FrictionModel, epsilon: float) -> None:
        self._kind = model.kind
        self._values = model.values
        self._epsilon = epsilon
        self.state = model.initial_state()

    def step(self, velocity: float, dt: float, *, applied_torque: float = 0.0) -> float:
        """Advance over ``dt`` seconds with ``velocity`` held and return the torque, N m.

        The values are not checked, for speed: they must be finite and ``dt`` above zero.
        """
        return kernel.step(self._kind, self._values, self.state, velocity, velocity, dt, applied_torque, self._epsilon)


def _vector(name: str, values: ArrayLike) -> Array:
    try:
        array = np.ascontiguousarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise UsageError(f"{name} must be an array of numbers: {error}") from None
    if array.ndim != 1:
        raise UsageError(f"{name} must have one dimension, not shape {array.shape}")
    _require_finite(name, array)
    return array


def _per_sample(name: str, values: ArrayLike, samples: int) -> Array:
    try:
        array = np.atleast_1d(np.asarray(values, dtype=np.float64))
    except (TypeError, ValueError) as error:
        raise UsageError(f"{name} must be a number or an array of numbers: {error}") from None
    if array.shape not in ((1,), (samples,)):
        raise UsageError(f"{name} must be a number or have shape ({samples},), not {array.shape}")
    _require_finite(name, array)
    return np.ascontiguousarray(array)


def _require_finite(name: str, array: Array) -> None:
    wrong = np.flatnonzero(~np.isfinite(array))
    if wrong.size:
        raise UsageError(f"{name} must be finite; element {wrong[0]} is {array[wrong[0]]} ({wrong.size} in all)")


def as_dict(model: FrictionModel) -> dict[str, Any]:
    """What a model file says under ``friction``."""
    return {"model": model.name, "parameters": dict(model.parameters)}
