"""Exports into forms that cannot hold a model: the fit that loses least torque, and what it loses.

A form such as a Coulomb level with a viscous coefficient is fitted to the steady torque of the model by weighted least
squares. Parameters of like name are not copied: over the speeds at which an axis moves, the best Coulomb level of a
simulator is not the Coulomb level of a model with a Stribeck hump.
"""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize, nnls

from friction_hil.export.points import Points
from friction_hil.friction import FrictionModel
from friction_hil.models.model_file import ModelFile
from friction_hil.numerics.jit import Array
from friction_hil.numerics.readable import FORCE_UNITS

_NOTHING = 1e-9  # of the friction: a loss that is rounding
MEMORY = "The memory of the model."
_STARTS = 25  # Stribeck velocities that are tried before the search


@dataclass(frozen=True, slots=True, eq=False)
class Loss:
    """Torque of the model that an export does not hold, N m or N."""

    rms: float  # root of the weighted mean square of the difference between model and export
    relative: float  # `rms` over the root mean square torque of the model
    largest: float  # difference, model minus export, with its sign
    velocity: float  # where the largest difference is, rad/s or m/s
    temperature: float  # likewise, deg C; NaN for a model that does not depend on it
    # part of `rms` due to the difference between the directions of motion, which a symmetrical form loses
    between_directions: float
    origin: str  # what range and weights come from
    lost: tuple[str, ...]  # what else the export does not hold; sentences
    axis: str  # "rotary" or "linear"
    points: Points  # where model and export were compared
    difference: Array  # (n,), model minus export at the points

    def amount(self) -> str:
        """Return how much is lost in steady motion, in words."""
        torque = FORCE_UNITS[self.axis]
        return f"{self.rms:.3g} {torque} RMS, {100.0 * self.relative:.3g} % of the friction"

    def lines(self) -> list[str]:
        """Return what is lost, in sentences."""
        torque, speed = ("N m", "rad/s") if self.axis == "rotary" else ("N", "m/s")
        where = f"{self.velocity:.4g} {speed}"
        if np.isfinite(self.temperature):
            where += f" and {self.temperature:.4g} deg C"
        own = f" (between the directions alone: {self.between_directions:.3g} {torque})"
        if self.relative < _NOTHING:
            lost = ["Torque lost: none in steady motion."]
        else:
            lost = [
                f"Torque lost: {self.amount()}" + (own if self.between_directions > 1e-3 * self.rms else "") + ".",
                f"Largest: {self.largest:.3g} {torque} at {where}.",
            ]
        return [*lost, f"Fitted to steady motion over the {self.origin}.", *self.lost]

    def as_json(self) -> dict[str, Any]:
        """Return the loss as plain values."""
        return {
            "rms": self.rms,
            "relative": self.relative,
            "largest": self.largest,
            "velocity": self.velocity,
            "temperature": self.temperature if np.isfinite(self.temperature) else None,
            "between_directions": self.between_directions,
            "over": self.origin,
            "lost": list(self.lost),
        }


@dataclass(frozen=True, slots=True, eq=False)
class Converted:
    """An export that loses torque: its files by name, the fitted parameters by their names in it, and the loss."""

    files: dict[str, str]
    parameters: dict[str, Any]
    loss: Loss


@dataclass(frozen=True, slots=True)
class Viscous:
    """Coulomb level and viscous polynomial: F = coulomb sgn v + viscous[0] v + viscous[1] v |v| + viscous[2] v^3."""

    coulomb: float
    viscous: tuple[float, ...]

    def torque(self, velocity: Array, creep: float = 0.0) -> Array:
        """Return the torque at each velocity, (n,), where the Coulomb level is reached at the speed ``creep``."""
        torque = np.asarray(_columns(velocity, len(self.viscous)) @ np.array([self.coulomb, *self.viscous]))
        if creep > 0.0:
            torque -= self.coulomb * np.sign(velocity) * np.maximum(1.0 - np.abs(velocity) / creep, 0.0)
        return torque


@dataclass(frozen=True, slots=True)
class Stribeck:
    """`Viscous` with ``hump`` exp(-(|v|/velocity)^exponent) sgn v added; break-away is coulomb + hump."""

    sliding: Viscous
    hump: float
    velocity: float
    exponent: float

    def torque(self, velocity: Array) -> Array:
        """Return the torque at each velocity, (n,)."""
        return self.sliding.torque(velocity) + self.hump * _hump(velocity, self.velocity, self.exponent)


def fit_viscous(points: Points, torque: Array, powers: int = 1) -> Viscous:
    """Fit Coulomb level and ``powers`` viscous coefficients, none below zero, by weighted least squares."""
    solved, _ = _solve(points, torque, _columns(points.velocity, powers))
    return Viscous(float(solved[0]), tuple(float(each) for each in solved[1:]))


def fit_stribeck(
    points: Points, torque: Array, powers: int = 1, exponents: tuple[float, float] = (2.0, 2.0)
) -> Stribeck:
    """Fit a curve with a Stribeck hump by weighted least squares.

    For a velocity and an exponent of the hump the other parameters follow from a bounded linear problem (variable
    projection: Golub, Pereyra, SIAM J. Numer. Anal. 10(2), 1973), so that only these two are searched.

    ``powers``: number of viscous coefficients; ``exponents``: bounds of the exponent.
    """
    speeds = np.abs(points.velocity[points.weight > 0.0])
    bounds = [(float(np.log(speeds.min())), float(np.log(speeds.max()))), exponents]
    plain = _columns(points.velocity, powers)

    def solve(at: Sequence[float]) -> tuple[Array, float]:
        hump = _hump(points.velocity, float(np.exp(at[0])), float(at[1]))
        return _solve(points, torque, np.column_stack([plain, hump]))

    exponent = float(np.clip(2.0, *exponents))
    starts = [(each, exponent) for each in np.linspace(*bounds[0], _STARTS)]
    best = min(starts, key=lambda at: solve(at)[1])
    options = {"xatol": 1e-9, "fatol": 1e-16 * float(points.weight @ torque**2)}
    found = minimize(lambda at: solve(at)[1], best, method="Nelder-Mead", bounds=bounds, options=options)
    best = min((best, (float(found.x[0]), float(found.x[1]))), key=lambda at: solve(at)[1])
    solved, _ = solve(best)
    sliding = Viscous(float(solved[0]), tuple(float(each) for each in solved[1:-1]))
    return Stribeck(sliding, float(solved[-1]), float(np.exp(best[0])), float(best[1]))


def break_away(model: FrictionModel, points: Points) -> float:
    """Return the torque at which slow motion begins, the mean of both directions, N m or N."""
    slow = 1e-9 * float(np.max(np.abs(points.velocity)))
    load = 0.0 if model.depends_on_load else None
    return float(np.mean(np.abs(model.steady_state(np.array([-slow, slow]), load_torque=load))))


def judge(
    model_file: ModelFile,
    points: Points,
    exported: Callable[[Points], Array],  # torque of the export at points, (n,), N m or N
    lost: Sequence[str] = (),  # what else is lost
    # what the export holds, or `lost` says in other words: "presliding", "ripple", "directions", "load"
    carried: Collection[str] = (),
) -> Loss:
    """Compare an export with the model at the points."""
    model = model_file.friction_model
    mirror = replace(points, velocity=-points.velocity)
    torque = points.torque(model)
    difference = torque - exported(points)
    even = 0.5 * (difference + mirror.torque(model) - exported(mirror))
    even[(mirror.velocity < points.low) | (mirror.velocity > points.high)] = 0.0  # one direction only is in the range
    square, rms = float(points.weight @ torque**2), math.sqrt(float(points.weight @ difference**2))
    occupied = np.flatnonzero(points.weight > 0.0)
    at = occupied[np.argmax(np.abs(difference[occupied]))]
    return Loss(
        rms=rms,
        relative=rms / math.sqrt(square) if square > 0.0 else 0.0,
        largest=float(difference[at]),
        velocity=float(points.velocity[at]),
        temperature=float(points.temperature[at]),
        # a direction that is seldom taken counts little in rms
        between_directions=0.0 if "directions" in carried else min(rms, math.sqrt(float(points.weight @ even**2))),
        origin=points.origin,
        lost=(*lost, *not_steady(model_file, carried)),
        axis=model_file.axis,
        points=points,
        difference=difference,
    )


def not_steady(model_file: ModelFile, carried: Collection[str] = ()) -> list[str]:
    """Return sentences about the friction that no steady curve over velocity shows, with its size.

    Those about ``carried``, "presliding", "load" and "ripple", are left out.
    """
    model = model_file.friction_model
    torque, angle = ("N m", "rad") if model.axis == "rotary" else ("N", "m")
    lost = []
    if "presliding" in carried:
        pass
    elif (stiffness := model.presliding_stiffness) > 0.0:
        lost.append(
            f"Presliding: the torque builds up over about {model.level / stiffness:.3g} {angle} after a reversal."
        )
    elif not model.family.is_static or model.network is not None:
        lost.append(MEMORY)
    if "load" in carried:
        pass
    elif "load" in model.modifiers:
        factors = model.modifiers["load"]
        lost.append(f"Load: {factors['motoring']:g} (motoring) and {factors['driven']:g} (driven) of the load torque.")
    elif model.depends_on_load:
        lost.append("Load: the network's dependence on it; fitted without load.")
    ripple = [math.hypot(each["cosine"], each["sine"]) for each in model.modifiers.get("ripple", [])]
    if ripple and "ripple" not in carried:
        lost.append(f"Ripple over position: harmonics of up to {max(ripple):.3g} {torque}.")
    if "reversal" in model.modifiers:
        curve = model.modifiers["reversal"]
        most = max(map(abs, [*curve["positive"], *curve["negative"]]))
        lost.append(f"Torque over the distance since a reversal: up to {most:.3g} {torque} soon after it.")
    if model_file.mechanics.backlash > 0.0:
        lost.append(f"Backlash: {model_file.mechanics.backlash:.3g} {angle}.")
    return lost


def number(value: float) -> str:
    """Return a number as the exports write it: ten digits."""
    return f"{value:.10g}"


def _solve(points: Points, torque: Array, columns: Array) -> tuple[Array, float]:
    """Return the coefficients, none below zero, and the weighted sum of squares that is left."""
    root = np.sqrt(points.weight)
    matrix, target = columns * root[:, None], torque * root
    scale = np.linalg.norm(matrix, axis=0)
    scale[scale == 0.0] = 1.0
    solved = nnls(matrix / scale, target)[0] / scale
    left = matrix @ solved - target
    solved[solved * scale < _NOTHING * np.linalg.norm(target)] = 0.0  # no coefficients that are rounding
    return solved, float(left @ left)


def _columns(velocity: Array, powers: int) -> Array:
    speed = np.abs(velocity)
    return np.column_stack([np.sign(velocity), *(velocity * speed**power for power in range(powers))])


def _hump(velocity: Array, stribeck_velocity: float, exponent: float) -> Array:
    return np.sign(velocity) * np.exp(-((np.abs(velocity) / stribeck_velocity) ** exponent))
