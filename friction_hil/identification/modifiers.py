"""Modifiers of a structure: load, temperature, nonlinear viscous friction, ripple; tried where the data show them."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from friction_hil.identification.data import Data
from friction_hil.identification.structures import Coordinate, Scales, Structure
from friction_hil.numerics.jit import Array

_LEAST_LOAD = 0.1  # of the friction level: a smaller change of the load says nothing
_LEAST_WARMING = 3.0  # K
_LEAST_PERIODS = 2.0  # of a ripple in the travel
_MOST_PERIODS = 300.0
_ORDERS = 400  # that are tried
_LEAST_RIPPLE = 0.05  # of the residual's energy that a harmonic explains
_HARMONICS = 2
_STATIC_CURVES = ("table", "power_law")  # they bend by themselves


def excited(
    structure: Structure,
    data: Data,
    scales: Scales,
    residual: Array,
    loads: Sequence[Array] | None,
    *,
    is_load_found: bool = False,
) -> Iterator[Structure]:
    """Structures with one modifier more, where the data are such that it could show.

    A load that is found itself, gravity, makes up the difference between friction that grows with it while the motor
    drives and while it is driven: sign(v) |load| changes sign with load v, so that half the difference times the
    load has no sign of its own. Then one value stands for both.
    """
    has = set(structure.modifiers)
    if "viscous" not in has and structure.family not in _STATIC_CURVES:
        yield _with(structure, "viscous", linear={"viscous.quadratic": "viscous.quadratic"})
    if "load" not in has and loads is not None and _ripples(loads) > _LEAST_LOAD * scales.level:
        names = ("load.motoring", "load.driven")
        owners = [names] if is_load_found else [(name,) for name in names]
        coordinates = [Coordinate(owner, 0.0, 10.0, False) for owner in owners]
        yield _with(structure, "load", coordinates=coordinates)
    warmth = [record.temperature for record in data.records if record.temperature is not None]
    if "temperature" not in has and len(warmth) == len(data.records):
        every = np.concatenate(warmth)
        if np.ptp(every) >= _LEAST_WARMING:
            coefficient = Coordinate(("temperature.coefficient",), -0.1, 0.1, False)
            reference = {"temperature.reference": float(np.median(every))}
            yield _with(structure, "temperature", coordinates=[coefficient], constants=reference)
    orders = ripple_orders(data, residual, structure.axis == "linear") if "ripple" not in has else []
    if orders:
        factor = 2.0 * math.pi if structure.axis == "linear" else 1.0
        linear = {
            f"ripple[{i}].{part}": f"ripple.{part}@{order * factor!r}"
            for i, order in enumerate(orders)
            for part in ("cosine", "sine")
        }
        constants = {f"ripple[{i}].order": order for i, order in enumerate(orders)}
        yield _with(structure, "ripple", linear=linear, constants=constants)


def _with(
    structure: Structure,
    name: str,
    *,
    coordinates: Sequence[Coordinate] = (),
    linear: dict[str, str] | None = None,
    constants: dict[str, float] | None = None,
) -> Structure:
    return replace(
        structure,
        coordinates=(*structure.coordinates, *coordinates),
        linear={**structure.linear, **(linear or {})},
        constants={**structure.constants, **(constants or {})},
        modifiers=(*structure.modifiers, name),
    )


def _ripples(loads: Sequence[Array]) -> float:
    """Spread of the size of the load, N m or N."""
    return float(np.std(np.abs(np.concatenate(list(loads)))))


def ripple_orders(data: Data, residual: Array, is_linear: bool) -> list[float]:
    """Orders of position harmonics that stand out in a residual (k,), largest first.

    On a rotary axis that turns by more than one revolution they are whole: what repeats with the shaft.
    """
    position = data.motion("position")
    turn = 1.0 if is_linear else 2.0 * math.pi
    travel = float(np.ptp(position)) / turn
    if not is_linear and travel >= 1.0:
        orders = np.arange(1.0, 65.0)
    else:
        orders = np.geomspace(_LEAST_PERIODS, _MOST_PERIODS, _ORDERS) / travel
    # what moves from row to row by half a period cannot be seen
    fastest = float(np.quantile(np.abs(np.diff(position)), 0.9)) / turn
    orders = orders[orders * fastest < 0.25] if fastest > 0.0 else orders
    found: list[float] = []
    left = residual - np.mean(residual)
    energy = float(left @ left)
    for _ in range(_HARMONICS):
        best, gain, after = 0.0, 0.0, left
        for order in orders:
            angle = order * 2.0 * math.pi / turn * position
            shapes = np.column_stack([np.cos(angle), np.sin(angle)])
            factors = np.linalg.solve(shapes.T @ shapes + 1e-9 * np.eye(2), shapes.T @ left)
            trial = left - shapes @ factors
            explained = float(left @ left - trial @ trial)
            if explained > gain:
                best, gain, after = float(order), explained, trial
        if gain < _LEAST_RIPPLE * energy:
            break
        found.append(best)
        left = after
    return found
