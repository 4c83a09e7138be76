"""Static friction from a map: torques at constant speeds, without time, position or acceleration. Pure.

Each static family is fitted by least squares, its parameters positive. The one with the lowest corrected information
criterion is chosen (AICc; C. M. Hurvich, C.-L. Tsai, Biometrika 76(2), 1989), as a map has few points.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from friction_hil import friction as models
from friction_hil.errors import RecordingError, UsageError, choices
from friction_hil.identification import thresholds as th
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording

FAMILIES = ("coulomb", "stribeck", "power_law")
_SMALLEST = 1e-9  # of the largest torque: a parameter below is zero


@dataclass(frozen=True, slots=True)
class StaticFit:
    """One family on a map."""

    family: str
    parameters: dict[str, float]
    offset: float  # constant torque; 0 where the speeds have one sign
    standard_errors: dict[str, float]  # by parameter, with ``offset``; NaN where the map does not determine it
    rmse: float  # N m or N
    relative_error: float  # relative to the norm of the torques
    score: float  # AICc; lower is better


@dataclass(frozen=True, slots=True)
class StaticMap:
    """Result of `fit_map`: fits, the chosen one first, and the points."""

    fits: tuple[StaticFit, ...]
    velocity: Array
    torque: Array
    notes: tuple[str, ...]


def fit_map(recordings: Sequence[Recording], families: Sequence[str] = ()) -> StaticMap:
    """Fit static friction to the points of maps.

    Each recording has ``velocity`` and ``torque``; the order of the rows does not matter. ``families``: static ones;
    all of `FAMILIES` if empty.

    Raises `RecordingError`: a column is missing, there are too few speeds, or the torque drives the motion;
    `UsageError`: a family is not static.
    """
    for name in families:
        if name not in FAMILIES:
            raise UsageError(f"a map of speeds and torques shows no {name!r}; {choices(name, FAMILIES)}")
    for each in recordings:
        each.require("velocity", "torque")
    velocity, torque = (np.concatenate([each[name] for each in recordings]) for name in ("velocity", "torque"))
    known = np.isfinite(velocity) & np.isfinite(torque) & (velocity != 0.0)
    notes = [f"{np.count_nonzero(~known)} points without a speed or a torque do not count"] if not known.all() else []
    velocity, torque = velocity[known], torque[known]
    speeds = np.unique(np.abs(velocity))
    if len(speeds) < th.FEWEST_SPEEDS:
        raise RecordingError(
            f"{recordings[0].path}: {len(speeds)} speeds above zero; a map takes at least {th.FEWEST_SPEEDS}"
        )
    has_offset = bool(np.any(velocity > 0.0) and np.any(velocity < 0.0))
    if not has_offset:
        notes.append("all speeds have one sign: friction is taken to be the same in both directions, without offset")
    middle = float(np.mean(torque)) if has_offset else 0.0
    if float(np.mean((torque - middle) * np.sign(velocity))) <= 0.0:
        raise RecordingError(f"{recordings[0].path}: the torque has another sign than friction: --scale torque=-1")
    tried = [_fit(name, velocity, torque, has_offset) for name in families or FAMILIES]
    fits = sorted((each for each in tried if each is not None), key=lambda each: each.score)
    if not fits:
        raise RecordingError(f"{recordings[0].path}: {len(velocity)} points are too few for any model")
    return StaticMap(tuple(fits), velocity, torque, tuple(notes))


def _fit(family: str, velocity: Array, torque: Array, has_offset: bool) -> StaticFit | None:
    """Return the best fit from several starts; None if there are too few points."""
    from scipy.optimize import least_squares  # imported here: start-up time

    names, starts = _starts(family, np.abs(velocity), np.abs(torque))
    free = len(names) + has_offset
    if len(torque) < free + 2:
        return None

    def residual(at: Array) -> Array:
        values: dict[str, Any] = _limited(dict(zip(names, np.exp(at[: len(names)]).tolist(), strict=True)))
        predicted = models.create(family, **values).steady_state(velocity)
        return np.asarray(predicted + (at[-1] if has_offset else 0.0) - torque)

    low = [math.log(_SMALLEST * float(np.max(np.abs(torque))))] * len(names)
    bounds = (np.array([*low, *[-np.inf] * has_offset]), np.full(free, np.inf))
    found = [
        least_squares(residual, np.maximum([*np.log(start), *[0.0] * has_offset], bounds[0] + 1e-6), bounds=bounds)
        for start in starts
    ]
    best = min(found, key=lambda each: each.cost)
    values = _limited(dict(zip(names, np.exp(best.x[: len(names)]).tolist(), strict=True)))
    errors = _standard_errors(best.jac, best.fun, len(torque) - free)
    scales = [*values.values(), *[1.0] * has_offset]
    named = [*names, *["offset"] * has_offset]
    squares = max(2.0 * best.cost, 1e-300)
    count = len(torque)
    score = count * math.log(squares / count) + 2.0 * free + 2.0 * free * (free + 1) / max(count - free - 1, 1)
    return StaticFit(
        family,
        values,
        float(best.x[-1]) if has_offset else 0.0,
        {name: error * scale for name, error, scale in zip(named, errors, scales, strict=True)},
        math.sqrt(squares / count),
        math.sqrt(squares) / float(np.linalg.norm(torque)),
        score,
    )


def _limited(values: dict[str, float]) -> dict[str, float]:
    """Return parameters within what the families take."""
    if "exponent" in values:
        values["exponent"] = min(values["exponent"], 5.0)
    return values


def _standard_errors(jacobian: Array, residual: Array, freedom: int) -> list[float]:
    with np.errstate(all="ignore"):
        covariance = np.linalg.pinv(jacobian.T @ jacobian) * float(residual @ residual) / max(freedom, 1)
    known = np.linalg.norm(jacobian, axis=0) > 0.0
    errors = np.where(known, np.sqrt(np.diag(covariance)), np.nan)
    return [float(error) for error in errors]


def _starts(family: str, speed: Array, level: Array) -> tuple[list[str], list[list[float]]]:
    """Return the names of the parameters of a family, and starting values from the points."""
    slow, top = float(np.median(level[speed <= np.quantile(speed, 0.3)])), float(np.max(speed))
    lowest, rise = (
        float(np.min(level)) or slow,
        max(float(np.median(level[speed >= np.quantile(speed, 0.7)])) / top, 1e-9),
    )
    if family == "coulomb":
        return ["coulomb", "viscous"], [[slow, 0.1 * rise], [0.5 * slow, rise]]
    if family == "stribeck":
        names = ["coulomb", "static", "stribeck_velocity", "viscous"]
        widths = [fraction * top for fraction in (0.01, 0.05, 0.2)]
        return names, [[lowest, 1.3 * slow, width, part * rise] for width in widths for part in (0.1, 0.8)]
    return ["coulomb", "factor", "exponent"], [[0.7 * slow, rise, power] for power in (0.4, 0.8, 1.2)]
